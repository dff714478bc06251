"""The figure of a map's quantity: a map, maps side by side, a strip along one axis, or runs as points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.plot.labelling import Raster, write_names
from clunk.plot.layers import Layers, hardness
from clunk.plot.maps import add_bar, cell_colours, facet_map, map_figure, notes_of, shades_of
from clunk.plot.plane import USUAL, axis_label, drawn_axes, scale_axis
from clunk.results.maps import AnyMap, Results, ToleranceMap
from clunk.results.quantities import TEXT, quantity_of
from clunk.study.arrays import Floats
from clunk.study.axes import RUN, ResultAxis


def draw(
    drawn: AnyMap,
    quantity: str,
    thresholds: Sequence[float] = (),
    *,
    facets: Sequence[str] = (),
    x: str | None = None,
    y: str | None = None,
) -> Figure:
    """The figure of a quantity, in the words of `clunk.results.quantities`.

    A map for two swept axes, a strip for one, points for runs of a sample or of axes that are walked together. More
    axes are taken by `facets`, or fixed beforehand (`Results.at`).

    thresholds : see `map_figure`
    facets : one axis or two, of which each value has its own map
    x, y : of runs the parameters, by default those of `parameter_choice`; x alone asks for the quantity over x

    Raises PlotError, and ClunkError where there is no such quantity.
    """
    described = quantity_of(quantity, drawn)
    curve = hardness(drawn) if described.type == TEXT else described.name
    if isinstance(drawn, Results) and _has_runs(drawn) and not facets:
        if y is not None and x is None:
            raise style.PlotError("y goes with x, which is missing.")
        chosen = parameter_choice(drawn) if x is None else (x,) if y is None else (x, y)
        return scatter(drawn, described.name if len(chosen) > 1 else curve, *chosen)
    if x is not None or y is not None:
        raise style.PlotError(
            "x and y are for axes that are walked together and for samples; of a map's two axes the load ratio or else "
            "the first is x."
        )
    if facets:
        return facet_map(drawn, facets, described.name)
    if len(drawn_axes(drawn)) > 1:
        return map_figure([Layers.of(drawn, 2, described.name)], thresholds=thresholds)
    return strip(drawn, curve)


def default_quantities(
    drawn: AnyMap, *, facets: Sequence[str] = (), x: str | None = None, y: str | None = None
) -> list[str]:
    """Quantities that are drawn where none is named: the regimes, and how hard the impacts are.

    Where one parameter is drawn from left to right and a quantity upwards, the labels are in the same picture. Of a
    tolerance map how probable double-sided impacts are, too.
    """
    is_map = len(drawn_axes(drawn)) > 1
    if _has_runs(drawn) and not facets:
        is_map = y is not None or (x is None and len(parameter_choice(drawn)) > 1)
    names = ["regimes", *["double_sided"] * isinstance(drawn, ToleranceMap), hardness(drawn)]
    return list(dict.fromkeys(names)) if is_map else names[-1:]


def _has_runs(drawn: AnyMap) -> bool:
    """Whether there are several runs, of a sample or of axes that are walked together."""
    return any(axis.parameter == RUN and len(axis.values) > 1 for axis in drawn.axes)


@style.styled()
def strip(drawn: AnyMap, quantity: str = "severity") -> Figure:
    """The labels along one swept axis as a coloured strip over the curve of a quantity; the most likely ones of draws.

    Raises PlotError unless one axis was swept and the quantity is defined in some cell.
    """
    layers, of_quantity = replace(Layers.of(drawn, 1), notes=()), Layers.of(drawn, 1, quantity)
    samples, values, (edges, codes) = layers.view.x.values, of_quantity.values, layers.bands
    assert values is not None
    figure = style.new_figure()
    band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
    fills = (*layers.colours, style.FAILED_FILL)
    for left, right, code in zip(edges[:-1], edges[1:], codes, strict=True):
        band.axvspan(left, right, facecolor=fills[code], linewidth=0.0, zorder=1)
    for edge in edges[1:-1]:
        band.axvline(edge, color=style.INK, linewidth=0.9, zorder=2)
        ax.axvline(edge, color=style.FAINT_INK, linewidth=0.6, linestyle=style.DASHED, zorder=1)
    for cells in np.split(
        np.arange(samples.size), np.flatnonzero(np.diff(layers.codes)) + 1
    ):  # it jumps between regimes
        ax.plot(
            samples[cells],
            values[cells],
            "o-",
            color=style.LINE_COLOURS[0],
            markersize=min(3.0, 300.0 / samples.size),
            clip_on=False,
            zorder=3,
        )
    scale_axis(ax, "x", layers.view.x)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylabel(of_quantity.value_label)
    ax.axhline(0.0, color=style.INK, linewidth=0.8, zorder=2)
    style.tidy(ax)
    band.set_yticks([])
    band.tick_params(bottom=False, labelbottom=False)
    style.lay_out(figure, band, layers.title, layers.subtitle())
    notes = notes_of(layers, write_names(Raster.of(band, layers), layers.names))
    if layers.boundaries is not None:
        changes = ", ".join(f"{value:.7g}" for value in layers.boundaries.vertices[:, 0])
        notes.append(style.remark(f"the label changes at {changes}"))
    style.add_notes(figure, notes)
    return figure


@style.styled()
def scatter(results: Results, quantity: str, x: str, y: str | None = None) -> Figure:
    """Every run as a point over two parameters, in the colour of its label or of a quantity.

    Without y the quantity is upwards, and each point in the colour of its label.

    Raises PlotError where x or y is not swept, points would lie on each other, or the quantity is defined nowhere.
    """
    if x == y:
        raise style.PlotError(f"x and y are both {x}; name two parameters.")
    axes = [_parameter(results, name) for name in (x, y) if name is not None]
    _require_points_apart(results, {x, RUN if y is None else y})
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
    size, is_cloud = max(2.0, 40.0 - 0.1 * order.size), order.size > style.MOST_POINTS
    ax.scatter(across, upward, size, colours[order], edgecolors=style.INK, linewidths=0.2, rasterized=is_cloud)
    for which, axis in zip("xy", axes, strict=False):
        ax.set(**{f"{which}label": axis_label(axis)})
    ax.margins(0.03)
    ax.grid(color="0.92", linewidth=0.6)
    ax.set_axisbelow(True)
    line = regimes.subtitle(f"{order.size:,} runs")
    style.lay_out(figure, ax, regimes.title, line, notes_of(regimes, regimes.names))
    return figure


def parameter_choice(results: AnyMap) -> tuple[str, ...]:
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


def _require_points_apart(results: Results, chosen: set[str]) -> None:
    """Raise PlotError where cells that differ in a dimension that is not drawn would lie on each other."""
    axes = [results.axes[index].parameter for index in drawn_axes(results)]
    shown = {name if name in axes else RUN for name in chosen}
    if hidden := " and ".join(name for name in axes if name not in shown):
        raise style.PlotError(
            f"Points that differ in {hidden} would lie on each other: choose one value (--at), or draw a map for each "
            "(--facet)."
        )


def _values_of(results: Results, axis: ResultAxis) -> Floats:
    """A parameter's value in every cell, in C order."""
    names = [each.parameter for each in results.axes]
    dimension = names.index(axis.parameter if axis.parameter in names else RUN)
    values: Floats = axis.values[np.indices(results.shape)[dimension]].ravel()
    return values
