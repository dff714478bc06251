"""Thresholds under tolerances: quantiles as curves over one other axis, probabilities along the key without one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import colors
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.analysis.quantiles import QUANTILE, probabilities
from clunk.analysis.thresholds import DRAW, Thresholds
from clunk.plot import style
from clunk.plot.notes import set_notes, swatch
from clunk.plot.plane import scale_axis
from clunk.plot.thresholds import (
    arranged,
    bands,
    draw_curves,
    fill_bands,
    heading,
    outcome_fills,
    outcome_name,
    scale_plane,
    segments,
)
from clunk.results.labels import FAILED_CODE
from clunk.study.axes import ResultAxis

_LEAST = 0.002  # mean probability along the key of an outcome that is outlined and named


def curve_axes(axes: Sequence[ResultAxis]) -> tuple[ResultAxis, ...]:
    """The other axis, if there is one with several values. Raises PlotError where there are more."""
    several = [axis for axis in axes if len(axis.values) > 1 and axis.parameter not in (DRAW, QUANTILE)]
    if len(several) > 1:
        problem = f"Quantiles are drawn over one other axis, and the config has {len(several)} other axes"
        raise style.PlotError(f"{problem}; -o FILE.csv takes all.")
    return tuple(several)


@style.styled()
def quantile_figure(drawn: Thresholds, quantiles: Thresholds, nominal: Thresholds) -> Figure:
    """Bands over the other axis in which a share of the drawn drivelines has one outcome, darker for a larger share.

    drawn : thresholds of each draw
    quantiles : of these thresholds
    nominal : thresholds without tolerances, drawn as dashed curves

    Without another axis, the probability of each outcome along the key. Raises PlotError where there are more.
    """
    axes = curve_axes(nominal.axes)
    if not axes:
        return _draw_probabilities(drawn, nominal)
    figure = style.new_figure()
    ax = figure.subplots()
    draws = len(drawn.axes[0].values)
    style.set_titles(figure, ax, drawn.study.title, heading(f"share of {draws:,} drivelines", nominal))
    cells, (x,) = arranged(nominal, axes)
    fills = outcome_fills(quantiles)
    shares = quantiles.axes[-1].values
    shades = [colors.to_hex(mpl.colormaps["viridis"](depth)) for depth in np.linspace(0.85, 0.0, len(shares))]
    seen: set[int] = set()
    notes: list[Artist] = []
    for rank, k in enumerate(np.argsort(shares)):
        part = _of_quantile(quantiles, int(k))
        depth = (rank + 1.0) / len(shares)
        seen |= fill_bands(ax, part, x, cells, {code: _paler(fill, depth) for code, fill in fills.items()})
        draw_curves(ax, [points for _, points in segments(part, x.values, cells)], shades[rank])
        notes.append(Line2D([], [], color=shades[rank], linewidth=1.6, label=f"in {100.0 * shares[k]:g} %"))
    draw_curves(ax, [points for _, points in segments(nominal, x.values, cells)], style.INK, linestyles="--")
    notes.append(Line2D([], [], color=style.INK, linewidth=1.6, linestyle="--", label="without tolerances"))
    scale_plane(ax, x, quantiles.along)
    swatches = [swatch(outcome_name(quantiles, code), fills[code]["facecolor"]) for code in sorted(seen)]
    set_notes(figure, [*swatches, *notes])
    style.freeze_layout(figure, ax)
    return figure


def _of_quantile(quantiles: Thresholds, k: int) -> Thresholds:
    """The thresholds of one quantile, in the cells of the other axes."""
    count = len(quantiles.axes[-1].values)
    part = quantiles.cell % count == k
    return replace(
        quantiles,
        axes=quantiles.axes[:-1],
        lowest=quantiles.lowest[k::count],
        cell=quantiles.cell[part] // count,
        value=quantiles.value[part],
        below=quantiles.below[part],
        above=quantiles.above[part],
    )


def _paler(fill: dict[str, Any], depth: float) -> dict[str, Any]:
    """The look of a band, mixed with white; depth : 1 for the look itself."""
    colour = 1.0 - depth * (1.0 - np.array(colors.to_rgb(fill["facecolor"])))
    return fill | {"facecolor": colors.to_hex(tuple(colour))}


def _draw_probabilities(drawn: Thresholds, nominal: Thresholds) -> Figure:
    """Draw the probability of each outcome along the key, one upon the other."""
    edges, shares = probabilities(drawn)
    figure = style.new_figure()
    ax = figure.subplots()
    style.set_titles(
        figure, ax, drawn.study.title, heading(f"share of {len(drawn.axes[0].values):,} drivelines", nominal)
    )
    fills = outcome_fills(drawn)
    codes = [*range(len(drawn.words)), FAILED_CODE]
    bottom = np.zeros(len(shares))
    notes: list[Artist] = []
    for code, share in zip(codes, shares.T, strict=True):
        top = bottom + share
        ax.stairs(top, edges, baseline=bottom, fill=True, linewidth=0.0, **fills[code])
        if np.average(share, weights=np.diff(edges)) >= _LEAST:
            ax.stairs(top, edges, baseline=None, color=style.INK, linewidth=0.8)
            notes.append(swatch(outcome_name(drawn, code), fills[code]["facecolor"]))
        bottom = top
    _, without = bands(nominal, 0)
    for value in without:
        ax.axvline(value, color=style.INK, linewidth=1.2, linestyle="--")
    if without:
        notes.append(Line2D([], [], color=style.INK, linewidth=1.2, linestyle="--", label="without tolerances"))
    scale_axis(ax, "x", drawn.along)
    ax.set(xlim=drawn.along.values[[0, -1]], ylim=(0.0, 1.0), ylabel="Probability")
    set_notes(figure, notes)
    style.freeze_layout(figure, ax)
    return figure
