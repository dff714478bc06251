"""The figure of a map's quantity: a map, maps side by side, a strip along one axis or path, or points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from clunk.plot.layers import MOST_LABELS, Layers, hardness
from clunk.plot.maps import map_figure
from clunk.plot.plane import axis_span, drawn_axes, value_text
from clunk.plot.scatter import parameter_choice, scatter
from clunk.plot.strips import likelihood_curves, strip
from clunk.plot.style import PlotError, bare, symbol_text
from clunk.results.quantities import LABEL, TEXT, quantity_of
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import AnyMap, ToleranceMap
from clunk.study.arrays import Floats
from clunk.study.axes import RUN, ResultAxis

MOST_VALUES = (12, 4)  # of one facet, of each of two


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

    A map for two swept axes, a strip for one or for axes that are walked together, points for a sample. More axes are
    taken by `facets`, or fixed beforehand (`Results.at`). A tolerance map takes neither x nor y.

    thresholds : see `map_figure`
    facets : one axis or two, of which each value has its own map
    x, y : of axes that are walked together x, by default the first that rises or falls throughout; of a sample both,
        where x alone asks for the quantity over x

    Raises PlotError, and ClunkError where there is no such quantity.
    """
    described = quantity_of(quantity, drawn)
    curve = hardness(drawn) if described.type == TEXT else described.name
    if y is not None and x is None:
        raise PlotError("y goes with x, which is missing.")
    if facets or isinstance(drawn, ToleranceMap) or not _has_runs(drawn):
        if x is not None:
            raise PlotError(
                "x and y are for axes that are walked together and for samples; of a map's two axes the load ratio or "
                "else the first is x."
            )
        if facets:
            return facet_map(drawn, facets, described.name)
        if len(drawn_axes(drawn)) > 1:
            return map_figure([Layers.of(drawn, 2, described.name)], thresholds=thresholds)
        return likelihood_curves(drawn) if isinstance(drawn, ToleranceMap) else strip(drawn, curve)
    if _is_path(drawn):
        if y is not None:
            raise PlotError("y is for samples: axes that are walked together are a path, drawn along x.")
        return _path(drawn, curve, x)
    chosen = parameter_choice(drawn) if x is None else (x,) if y is None else (x, y)
    return scatter(drawn, described.name if len(chosen) > 1 else curve, *chosen)


def facet_map(results: AnyMap, facets: Sequence[str], quantity: str = LABEL) -> Figure:
    """A map of the regimes or of a quantity for each value of one facet, or of two: rows, then columns.

    Of many values those that `shown_values` chooses are drawn. Raises PlotError where a facet is no axis of several
    values, or not two axes are left for the maps.
    """
    changing = {results.axes[index].parameter: results.axes[index] for index in drawn_axes(results)}
    if len(facets) > len(MOST_VALUES) or len(set(facets)) < len(facets):
        raise PlotError("Small multiples have one facet, or two different ones for rows and columns.")
    for facet in facets:
        if facet not in changing:
            raise PlotError(f"{facet} is no axis of several values; these are {', '.join(changing)}.")
    axes = [changing[facet] for facet in facets]
    values = [shown_values(axis, len(axes)) for axis in axes]
    slices = [results.at(dict(zip(facets, place, strict=True))) for place in product(*values)]
    most = 0 if len(np.unique(results.sequence)) > MOST_LABELS else MOST_LABELS  # all panels alike
    panels = [Layers.of(each, 2, quantity, most) for each in slices]
    varying = {*facets, *(axis.parameter for axis in results.coordinates if RUN in facets)}
    fixed = [axis for axis in panels[0].view.fixed if axis.parameter not in varying]
    names = [
        "\n".join(symbol_text(value_text(axis, value, symbol=True)) for axis, value in zip(axes, place, strict=True))
        for place in product(*values)
    ]
    fact = f"each map at one {' and '.join(f'{axis.name} {bare(axis.symbol)}'.rstrip() for axis in axes)}"
    line = replace(panels[0], caveats=tuple(results.caveats)).subtitle(fact, fixed=fixed)
    return map_figure(panels, names, line, columns=len(values[1]) if len(values) > 1 else 0)


def shown_values(axis: ResultAxis, facets: int) -> Floats:
    """The values of a facet that are drawn, ascending: all, or evenly spaced ones with the first and the last."""
    values, most = np.sort(axis.values), MOST_VALUES[facets - 1]
    if len(values) <= most:
        return values
    return values[np.rint(np.linspace(0, len(values) - 1, most)).astype(np.intp)]


def default_quantities(
    drawn: AnyMap, *, facets: Sequence[str] = (), x: str | None = None, y: str | None = None
) -> list[str]:
    """Quantities that are drawn where none is named: the regimes, and how hard the impacts are.

    Where one parameter is drawn from left to right and a quantity upwards, the labels are in the same picture. Of a
    tolerance map how probable double-sided impacts are, too.
    """
    is_map = len(drawn_axes(drawn)) > 1
    if isinstance(drawn, ToleranceMap):
        hard = ["severity"] * bool(np.isfinite(drawn.severity_mean).any())
        return ["regimes", "double_sided", *hard] if is_map else ["regimes"]
    if _has_runs(drawn) and not facets:
        is_map = not _is_path(drawn) and (y is not None or (x is None and len(parameter_choice(drawn)) > 1))
    return ["regimes", hardness(drawn)] if is_map else [hardness(drawn)]


def _has_runs(results: Results) -> bool:
    """Whether several runs are points of a path or of a sample."""
    return any(axis.parameter == RUN and len(axis.values) > 1 for axis in results.axes)


def _is_path(results: Results) -> bool:
    """Whether the runs are axes that are walked together, and nothing else was swept."""
    return results.setting("sweep.design") == "zip" and len(drawn_axes(results)) == 1


def _path(results: Results, quantity: str, x: str | None) -> Figure:
    """The strip along axes that are walked together."""
    run = results.axes[drawn_axes(results)[0]]
    steps = [(axis, np.sign(np.diff(axis.values))) for axis in results.coordinates]
    monotonic = [axis for axis, signs in steps if abs(signs.sum()) == signs.size]
    along = {axis.parameter: axis for axis in (*monotonic, run)}
    if x is not None and x not in along:
        raise PlotError(f"{x} does not rise or fall throughout the runs; x may be {' or '.join(along)}.")
    chosen = along[x or next(iter(along))]
    spans = [axis_span(axis) for axis in results.coordinates if axis is not chosen]
    axes = tuple(chosen if axis is run else axis for axis in results.axes)
    return strip(replace(results, axes=axes, coordinates=()), quantity, "; ".join(spans))
