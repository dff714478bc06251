"""Which figure shows which results: a map, small multiples of it, a strip along one axis or path, or points."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from clunk.plot.facets import facet_map
from clunk.plot.maps import QUANTITIES, quantity_map, regime_map, strip
from clunk.plot.plane import axis_span, drawn_axes
from clunk.plot.scatter import parameter_choice, scatter_curve, scatter_map
from clunk.plot.style import PlotError
from clunk.results.regimemap import Results
from clunk.study.axes import RUN


def draw(
    results: Results,
    quantity: str,
    thresholds: Sequence[float] = (),
    *,
    facets: Sequence[str] = (),
    x: str | None = None,
    y: str | None = None,
) -> Figure:
    """The figure of a quantity of `QUANTITIES`.

    A map for two swept axes, a strip for one or for axes that are walked together, points for a sample. More axes are
    taken by `facets`, or fixed beforehand (`Results.at`).

    thresholds : see `regime_map`
    facets : one axis or two, of which each value has its own map
    x, y : of axes that are walked together x, by default the first that rises or falls throughout; of a sample both,
        where x alone asks for the quantity over x

    Raises PlotError.
    """
    if quantity not in QUANTITIES:
        raise PlotError(f"There is no quantity {quantity!r}; there are {', '.join(QUANTITIES)}.")
    if y is not None and x is None:
        raise PlotError("--y goes with --x, which is missing.")
    along_run = _has_runs(results)
    if facets or not along_run:
        if x is not None:
            raise PlotError(
                "--x and --y are for axes that are walked together and for samples; of a map's two axes the load ratio "
                "or else the first is x."
            )
        if facets:
            return facet_map(results, facets, quantity)
    elif _is_walked(results) and len(drawn_axes(results)) == 1:
        if y is not None:
            raise PlotError("--y is for samples: axes that are walked together are a path, drawn along --x.")
        return _path(results, _curve_quantity(results, quantity), x)
    else:
        chosen = parameter_choice(results) if x is None else (x,) if y is None else (x, y)
        if len(chosen) == 1:
            return scatter_curve(results, chosen[0], _curve_quantity(results, quantity))
        return scatter_map(results, chosen[0], chosen[1], quantity)
    if len(drawn_axes(results)) == 1:
        return strip(results, _curve_quantity(results, quantity))
    if quantity == "regimes":
        return regime_map(results, thresholds)
    return quantity_map(results, quantity)


def default_quantities(
    results: Results, *, facets: Sequence[str] = (), x: str | None = None, y: str | None = None
) -> list[str]:
    """What to draw of some results: the regimes, and how hard the impacts are.

    Where one parameter is drawn from left to right and a quantity upwards, the labels are in the same picture. Q is not
    defined for the restitution model, V is. Of a refined map, only the regimes: most cells have nothing else.
    """
    keep = drawn_axes(results)
    if _has_runs(results) and not facets:
        sample = len(keep) > 1 or not _is_walked(results)
        two = sample and (y is not None or (x is None and len(parameter_choice(results)) > 1))
    else:
        two = len(keep) > 1
    if not two:
        return [_hardness(results)]
    return ["regimes"] if results.inferred.any() else ["regimes", _hardness(results)]


def _has_runs(results: Results) -> bool:
    return any(axis.parameter == RUN and len(axis.values) > 1 for axis in results.axes)


def _hardness(results: Results) -> str:
    return "severity" if np.isfinite(results.severity).any() else "approach_velocity"


def _curve_quantity(results: Results, quantity: str) -> str:
    """The quantity that goes upwards: with labels in the same picture there is one beside the regimes."""
    return _hardness(results) if quantity == "regimes" else quantity


def _is_walked(results: Results) -> bool:
    """Whether the runs are axes that are walked together, and no sample."""
    return bool(tomllib.loads(results.config)["sweep"]["design"] == "zip")


def _path(results: Results, quantity: str, x: str | None) -> Figure:
    """The strip along axes that are walked together."""
    rising = [
        axis for axis in results.coordinates if (np.diff(axis.values) > 0.0).all() or (np.diff(axis.values) < 0.0).all()
    ]
    run = results.axes[drawn_axes(results)[0]]
    known = {axis.parameter: axis for axis in (*rising, run)}
    if x is not None and x not in known:
        if x in {axis.parameter for axis in results.coordinates}:
            raise PlotError(f"{x} neither rises nor falls throughout the runs; --x may be {' or '.join(known)}.")
        raise PlotError(f"{x} does not change in these results; --x may be {' or '.join(known)}.")
    chosen = known[x] if x is not None else next(iter(known.values()))
    others = [axis_span(axis) for axis in results.coordinates if axis is not chosen]
    axes = tuple(chosen if axis is run else axis for axis in results.axes)
    return strip(replace(results, axes=axes, coordinates=()), quantity, "; ".join(others))
