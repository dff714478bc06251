"""The figure of a map's quantity: a map, small multiples of it, a strip along one axis or path, or points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from clunk.plot import certainty
from clunk.plot.facets import facet_map
from clunk.plot.layers import quantities_of
from clunk.plot.maps import quantity_map, regime_map
from clunk.plot.plane import axis_span, drawn_axes
from clunk.plot.scatter import parameter_choice, scatter_curve, scatter_map
from clunk.plot.strips import strip
from clunk.plot.style import PlotError
from clunk.results.quantities import likely_name
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.axes import RUN
from clunk.study.measures import OF_IMPACTS


def draw(
    drawn: Results | ToleranceMap,
    quantity: str,
    thresholds: Sequence[float] = (),
    *,
    facets: Sequence[str] = (),
    x: str | None = None,
    y: str | None = None,
) -> Figure:
    """The figure of a quantity: of a regime map one of its `quantities_of`, of a tolerance map `certainty.QUANTITIES`.

    A map for two swept axes, a strip for one or for axes that are walked together, points for a sample. More axes are
    taken by `facets`, or fixed beforehand (`Results.at`). A tolerance map takes neither facets nor x and y.

    thresholds : see `regime_map`
    facets : one axis or two, of which each value has its own map
    x, y : of axes that are walked together x, by default the first that rises or falls throughout; of a sample both,
        where x alone asks for the quantity over x

    Raises PlotError.
    """
    if isinstance(drawn, ToleranceMap):
        return certainty.draw(drawn, quantity)
    known = quantities_of(drawn)
    if quantity not in known:
        likely = likely_name(quantity, known)
        hint = f"did you mean {likely!r}? There" if likely else "there"
        end = f"; impacts.quantities = [{quantity!r}] in the config measures it" if quantity in OF_IMPACTS else ""
        raise PlotError(f"There is no quantity {quantity!r}; {hint} are {', '.join(known)}{end}.")
    if y is not None and x is None:
        raise PlotError("y goes with x, which is missing.")
    if _has_runs(drawn) and not facets:
        return _draw_runs(drawn, quantity, x, y)
    if x is not None:
        raise PlotError(
            "x and y are for axes that are walked together and for samples; of a map's two axes the load ratio or else "
            "the first is x."
        )
    if facets:
        return facet_map(drawn, facets, quantity)
    if len(drawn_axes(drawn)) == 1:
        return strip(drawn, _curve_quantity(drawn, quantity))
    return regime_map(drawn, thresholds) if quantity == "regimes" else quantity_map(drawn, quantity)


def _draw_runs(results: Results, quantity: str, x: str | None, y: str | None) -> Figure:
    """The figure of axes that are walked together, or of a sample."""
    if _is_path(results):
        if y is not None:
            raise PlotError("y is for samples: axes that are walked together are a path, drawn along x.")
        return _path(results, _curve_quantity(results, quantity), x)
    chosen = parameter_choice(results) if x is None else (x,) if y is None else (x, y)
    if len(chosen) == 1:
        return scatter_curve(results, chosen[0], _curve_quantity(results, quantity))
    return scatter_map(results, chosen[0], chosen[1], quantity)


def default_quantities(
    drawn: Results | ToleranceMap, *, facets: Sequence[str] = (), x: str | None = None, y: str | None = None
) -> list[str]:
    """Quantities that are drawn where none is named: the regimes, and how hard the impacts are.

    Where one parameter is drawn from left to right and a quantity upwards, the labels are in the same picture. Q is not
    defined for the restitution model, V is.
    """
    if isinstance(drawn, ToleranceMap):
        return certainty.default_quantities(drawn)
    is_map = len(drawn_axes(drawn)) > 1
    if _has_runs(drawn) and not facets:
        is_map = not _is_path(drawn) and (y is not None or (x is None and len(parameter_choice(drawn)) > 1))
    return ["regimes", hardness(drawn)] if is_map else [hardness(drawn)]


def _has_runs(results: Results) -> bool:
    """Whether several runs are points of a path or of a sample."""
    return any(axis.parameter == RUN and len(axis.values) > 1 for axis in results.axes)


def hardness(results: Results) -> str:
    """The quantity that tells how hard impacts are."""
    return "severity" if np.isfinite(results.severity).any() else "approach_velocity"


def _curve_quantity(results: Results, quantity: str) -> str:
    """The quantity that goes upwards: with labels in the same picture there is one beside the regimes."""
    return hardness(results) if quantity == "regimes" else quantity


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
        is_coordinate = any(axis.parameter == x for axis in results.coordinates)
        problem = "neither rises nor falls throughout the runs" if is_coordinate else "does not change in these results"
        raise PlotError(f"{x} {problem}; x may be {' or '.join(along)}.")
    chosen = along[x or next(iter(along))]
    spans = [axis_span(axis) for axis in results.coordinates if axis is not chosen]
    axes = tuple(chosen if axis is run else axis for axis in results.axes)
    return strip(replace(results, axes=axes, coordinates=()), quantity, "; ".join(spans))
