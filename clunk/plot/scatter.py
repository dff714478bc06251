"""Runs of a sample as points: the regimes over two parameters, or a quantity over one parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.plot.layers import Layers
from clunk.plot.maps import Colours, new_plot, notes_of
from clunk.plot.plane import SurplusAxesError, axis_label, drawn_axes, set_log_scale
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats
from clunk.study.axes import RUN, ResultAxis

_ROOM = 0.03  # of an axis's span, beside the outermost points
_LOG_SPAN = 30.0  # of the largest value over the smallest, from which a scale may be logarithmic


@style.styled()
def scatter_map(results: Results, x: str, y: str, quantity: str = "regimes") -> Figure:
    """Every run as a point over two parameters, in the colour of its label or of a quantity.

    Raises PlotError where x or y is not swept, points would lie on each other, or the quantity is defined nowhere.
    """
    across, upward = _parameter(results, x), _parameter(results, y)
    _require_points_apart(results, (x, y))
    layers = Layers.of(results, 0, quantity)
    place = _values_of(results, across), _values_of(results, upward)
    figure, ax = new_plot(layers, f"{layers.codes.size:,} runs")
    if layers.shaded:
        _draw_values(figure, ax, layers, *place)
    else:
        _draw_regions(ax, layers, *place)
    crosses = [values[layers.failed] for values in place]
    ax.plot(*crosses, "x", color=style.FAILED_HATCH, markersize=4.0, zorder=2, gid="failed")
    _finish(figure, ax, (across, upward), notes_of(layers, layers.names))
    return figure


@style.styled()
def scatter_curve(results: Results, x: str, quantity: str) -> Figure:
    """A quantity of every run over one parameter, each point in the colour of its label.

    The runs may all have the same x, whose points then show their spread.

    Raises PlotError where x is not swept, other axes are left, or the quantity is defined nowhere.
    """
    across = _parameter(results, x)
    _require_points_apart(results, (x, RUN))
    layers, regimes = Layers.of(results, 0, quantity), Layers.of(results, 0)
    assert layers.values is not None
    figure, ax = new_plot(regimes, f"{layers.codes.size:,} runs")
    _draw_regions(ax, regimes, _values_of(results, across), layers.values)
    ax.set_ylabel(layers.value_label)
    _finish(figure, ax, (across,), notes_of(regimes, regimes.names))
    return figure


def parameter_choice(results: Results) -> tuple[str, ...]:
    """The two parameters over which a sample is drawn by default, or the only one.

    The grid's axes first, then load ratio and backlash, then the others in order.
    """
    axes = [results.axes[index].parameter for index in drawn_axes(results)]
    coordinates = [axis.parameter for axis in results.coordinates]
    usual = [name for name in ("load.ratio", "lash.backlash_deg") if name in coordinates]
    names = [name for name in axes if name != RUN] + usual + [name for name in coordinates if name not in usual]
    return tuple(names[:2])


def _parameter(results: Results, name: str) -> ResultAxis:
    """The axis of a parameter that changes. Raises PlotError where it does not."""
    changing = {axis.parameter: axis for axis in (*results.parameters, *results.axes) if len(axis.values) > 1}
    if name not in changing:
        raise style.PlotError(f"{name} does not change in these results; what does is {', '.join(changing)}.")
    return changing[name]


def _require_points_apart(results: Results, chosen: Sequence[str]) -> None:
    """Raise PlotError where cells that differ in a dimension that is not drawn would lie on each other."""
    if len(set(chosen)) < len(chosen):
        raise style.PlotError(f"x and y are both {chosen[0]}; name two parameters.")
    axes = {results.axes[index].parameter: results.axes[index] for index in drawn_axes(results)}
    shown = {name if name in axes else RUN for name in chosen}
    hidden = {name: axis for name, axis in axes.items() if name not in shown}
    if hidden:
        problem = f"Points that differ in {', '.join(hidden)} would lie on each other"
        raise SurplusAxesError(problem, list(hidden.values()), [RUN] if set(hidden) == {RUN} else [])


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
    return {"s": size**2, "rasterized": count > style.MOST_POINTS, **edges}


def _draw_regions(ax: Axes, layers: Layers, x: Floats, y: Floats) -> None:
    """Draw points in the colours of their labels, or of what is shown in their place."""
    known = ~layers.failed & np.isfinite(y)
    ax.scatter(x[known], y[known], c=np.array(layers.colours)[layers.codes[known]], **_look(x.size), zorder=3)


def _draw_values(figure: Figure, ax: Axes, layers: Layers, x: Floats, y: Floats) -> None:
    """Draw points in the colours of a quantity, and those without one behind them."""
    assert layers.values is not None
    shown, colours = np.isfinite(layers.values), Colours.of(layers)
    colours.add_bar(figure, ax)
    look = _look(x.size) | {"cmap": colours.cmap, "norm": colours.norm}
    ax.scatter(x[shown], y[shown], c=layers.values[shown], **look, zorder=3)
    undefined = ~shown & ~layers.failed
    ax.scatter(x[undefined], y[undefined], c=style.UNDEFINED, **_look(x.size), zorder=2)


def _finish(figure: Figure, ax: Axes, axes: tuple[ResultAxis, ...], notes: list[Artist]) -> None:
    """Set names, scales and limits of the drawn parameters' axes, and the notes under them."""
    for which, axis in zip("xy", axes, strict=False):
        low, high = float(axis.values.min()), float(axis.values.max())
        limits = low - _ROOM * (high - low), high + _ROOM * (high - low)
        if _is_skew(axis):
            set_log_scale(ax, which, low, high)
            limits = low * (low / high) ** _ROOM, high * (high / low) ** _ROOM
        ax.set(**{f"{which}lim": limits, f"{which}label": axis_label(axis)})
    ax.grid(color="0.92", linewidth=0.6)
    ax.set_axisbelow(True)
    style.freeze_layout(figure, ax, notes)


def _is_skew(axis: ResultAxis) -> bool:
    """Whether most values crowd at the lower end of a wide span, as those of a wide lognormal distribution do."""
    low, middle, high = np.quantile(axis.values, (0.0, 0.5, 1.0))
    return bool(low > 0.0 and high > _LOG_SPAN * low and middle < 0.2 * high)
