"""Runs of a sample as points: the regimes over two parameters, or a quantity over one parameter."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.plot.layers import Layers
from clunk.plot.maps import add_bar, cell_colours, notes_of, shades_of
from clunk.plot.plane import USUAL, SurplusAxesError, axis_label, drawn_axes
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats
from clunk.study.axes import RUN, ResultAxis


@style.styled()
def scatter(results: Results, quantity: str, x: str, y: str | None = None) -> Figure:
    """Every run as a point over two parameters, in the colour of its label or of a quantity.

    Without y the quantity is upwards, and each point in the colour of its label.

    Raises PlotError where x or y is not swept, points would lie on each other, or the quantity is defined nowhere.
    """
    axes = [_parameter(results, name) for name in (x, y) if name is not None]
    _require_points_apart(results, x, RUN if y is None else y)
    layers = Layers.of(results, 0, quantity)
    regimes = Layers.of(results, 0) if y is None else layers
    places = [_values_of(results, axis) for axis in axes]
    figure = style.new_figure()
    ax = figure.add_subplot()
    shades = shades_of([layers]) if regimes.shaded else None
    if shades is not None:
        add_bar(figure, [ax], shades, layers)
    if y is None:
        assert layers.values is not None
        places.append(layers.values)
        ax.set_ylabel(layers.value_label)
    colours = cell_colours(regimes, shades) / 255.0
    order = np.argsort(~regimes.failed, kind="stable")  # failed ones are behind the others
    across, upward = (values[order] for values in places)
    ax.scatter(across, upward, c=colours[order], **_look(order.size))
    for which, axis in zip("xy", axes, strict=False):
        ax.set(**{f"{which}label": axis_label(axis)})
    ax.margins(0.03)
    ax.grid(color="0.92", linewidth=0.6)
    ax.set_axisbelow(True)
    line = regimes.subtitle(f"{order.size:,} runs")
    style.lay_out(figure, ax, regimes.title, line, notes_of(regimes, regimes.names))
    return figure


def parameter_choice(results: Results) -> tuple[str, ...]:
    """The two parameters over which a sample is drawn by default, or the only one.

    The grid's axes first, then load ratio and backlash, then the others in order.
    """
    axes = [results.axes[index].parameter for index in drawn_axes(results)]
    coordinates = [axis.parameter for axis in results.coordinates]
    names = [name for name in axes if name != RUN] + sorted(coordinates, key=lambda name: name not in USUAL)
    return tuple(names[:2])


def _parameter(results: Results, name: str) -> ResultAxis:
    """The axis of a parameter that changes. Raises PlotError where it does not."""
    changing = {axis.parameter: axis for axis in (*results.parameters, *results.axes) if len(axis.values) > 1}
    if name not in changing:
        raise style.PlotError(f"{name} does not change in these results; what does is {', '.join(changing)}.")
    return changing[name]


def _require_points_apart(results: Results, x: str, y: str) -> None:
    """Raise PlotError where cells that differ in a dimension that is not drawn would lie on each other."""
    if x == y:
        raise style.PlotError(f"x and y are both {x}; name two parameters.")
    axes = [results.axes[index].parameter for index in drawn_axes(results)]
    shown = {name if name in axes else RUN for name in (x, y)}
    if hidden := " and ".join(name for name in axes if name not in shown):
        raise SurplusAxesError(
            f"Points that differ in {hidden} would lie on each other: choose one value (--at), or draw a map for each "
            "(--facet)."
        )


def _values_of(results: Results, axis: ResultAxis) -> Floats:
    """A parameter's value in every cell, in C order."""
    names = [each.parameter for each in results.axes]
    dimension = names.index(axis.parameter if axis.parameter in names else RUN)
    shape = [-1 if k == dimension else 1 for k in range(len(names))]
    return np.broadcast_to(axis.values.reshape(shape), results.shape).ravel()


def _look(count: int) -> dict[str, Any]:
    """Look of the points: seen one by one in a small sample, and as a cloud in a large one."""
    size = float(np.clip(6.5 * (256.0 / count) ** 0.35, 1.6, 6.5))
    edges = {"edgecolors": style.INK, "linewidths": 0.5 if size > 3.0 else 0.0}
    return {"s": size**2, "rasterized": count > style.MOST_POINTS, "zorder": 3, **edges}
