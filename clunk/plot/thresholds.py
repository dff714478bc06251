"""Thresholds as curves over one other axis, with the outcomes between them.

Under tolerances they are quantiles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.analysis.quantiles import QUANTILE
from clunk.analysis.thresholds import DRAW, Thresholds, word_text
from clunk.plot import style
from clunk.plot.plane import cell_edges, scale_panels, value_text
from clunk.results.labels import FAILED_CODE
from clunk.study.axes import ResultAxis

_NARROWEST = 0.002  # of the axis, a band that is seen
_ALL = slice(None)
_WITHOUT: dict[str, Any] = {"color": style.INK, "linewidth": 1.2, "linestyle": "--", "label": "without tolerances"}


def other_axis(axes: Sequence[ResultAxis]) -> ResultAxis:
    """The axis with several values beside the key. Raises PlotError where there is none, or more than one."""
    several = [axis for axis in axes if len(axis.values) > 1 and axis.parameter not in (DRAW, QUANTILE)]
    if len(several) > 1:
        names = " and ".join(axis.parameter for axis in several)
        raise style.PlotError(f"Thresholds are drawn over one other axis: take one value of {names} (--at).")
    if not several:
        raise style.PlotError("There is no other axis to draw thresholds over; -o FILE.csv takes them.")
    return several[0]


@style.styled()
def threshold_figure(thresholds: Thresholds) -> Figure:
    """The outcomes as coloured bands over the other axis, exact upwards, and the thresholds as curves between them.

    Raises PlotError where there is not one other axis with several values.
    """
    x = other_axis(thresholds.axes)
    figure = style.new_figure()
    ax = figure.subplots()
    fills = _outcome_fills(thresholds)
    seen = _draw_bands(ax, thresholds, x, fills)
    scale_panels(figure, [ax], (x, thresholds.along))
    line = _heading("thresholds of", thresholds)
    style.lay_out(figure, ax, thresholds.study.title, line, _notes(thresholds, sorted(seen), fills))
    return figure


def _heading(drawn: str, thresholds: Thresholds) -> str:
    """Second line of a figure's title: the quantity drawn, the outcome, and the axes of one value."""
    fixed = [value_text(axis, axis.values[0]) for axis in thresholds.axes if len(axis.values) == 1]
    return "; ".join([f"{drawn}: {thresholds.outcome.heading_with_unit}", *fixed])


def _bands(thresholds: Thresholds, cell: int) -> tuple[tuple[int, ...], list[float]]:
    """Codes of a cell's intervals that are wide enough to be seen, and the thresholds between them."""
    narrowest = _NARROWEST * float(np.ptp(thresholds.along.values))
    codes: list[int] = []
    begins: list[float] = []
    for begin, end, code in thresholds.intervals(cell):
        if end - begin >= narrowest and codes[-1:] != [code]:
            codes.append(code)
            begins.append(begin)
    return tuple(codes), begins[1:]


def _draw_bands(
    ax: Axes, thresholds: Thresholds, x: ResultAxis, fills: Mapping[int, str], every: slice = _ALL, **look: Any
) -> set[int]:
    """Fill the intervals of the key with one outcome as bands over x, and draw the thresholds between them.

    fills : colour of each code; those without one stay empty
    every : of the thresholds' cells, those that are drawn

    Returns the codes of the outcomes that have a band.
    """
    seen: set[int] = set()
    low, high = thresholds.along.values[[0, -1]]
    cells = np.arange(thresholds.lowest.size)[every][np.argsort(x.values, kind="stable")]
    x = replace(x, values=np.sort(x.values), words=())
    edges = np.clip(cell_edges(x), x.values[0], x.values[-1])
    columns = [_bands(thresholds, cell) for cell in cells.tolist()]
    for codes, group in groupby(range(len(columns)), key=lambda k: columns[k][0]):
        alike = list(group)
        across = np.array([edges[alike[0]], *x.values[alike], edges[alike[-1] + 1]])
        between = np.array([columns[k][1] for k in alike]).reshape(len(alike), len(codes) - 1).T
        levels = np.pad(between, ((0, 0), (1, 1)), "edge")
        line: dict[str, Any] = {"color": style.INK, "linewidth": 1.4, "zorder": 3} | look
        ax.plot(across, levels.T, **line)
        levels = np.vstack([np.full(across.size, low), levels, np.full(across.size, high)])
        for code, lower, upper in zip(codes, levels[:-1], levels[1:], strict=True):
            if code in fills:
                look_of_band: dict[str, Any] = {"facecolor": fills[code], "linewidth": 0.0, "antialiased": False}
                ax.fill_between(across, lower, upper, zorder=1, **look_of_band)
                seen.add(code)
    return seen


def _notes(thresholds: Thresholds, codes: Sequence[int], fills: Mapping[int, str]) -> list[Artist]:
    """The outcomes with their colours, for people: yes and no for whether something holds."""
    words = {code: thresholds.word(code) for code in codes}
    names = {code: ("no", "yes")[word] if isinstance(word, bool) else word_text(word) for code, word in words.items()}
    return [style.swatch(name, fills[code]) for code, name in names.items()]


def _outcome_fills(thresholds: Thresholds) -> dict[int, str]:
    """Colour of the band of each code: the tints of the labels, or shades of one hue."""
    words = zip(thresholds.words, style.shades(len(thresholds.words)), strict=True)
    fills = [style.colour_of(word) if isinstance(word, str) else shade for word, shade in words]
    return dict(enumerate(fills)) | {FAILED_CODE: style.FAILED_FILL}


@style.styled()
def quantile_figure(quantiles: Thresholds, nominal: Thresholds) -> Figure:
    """Bands over the other axis in which a share of the drawn drivelines has one outcome, darker for a larger share.

    nominal : thresholds without tolerances, drawn as dashed curves

    Raises PlotError where there is not one other axis with several values.
    """
    x, study = other_axis(nominal.axes), quantiles.study
    assert study.sweep is not None
    line = _heading(f"share of {study.sweep.sampling.count:,} drivelines", nominal)
    figure = style.new_figure()
    ax = figure.subplots()
    fills = _outcome_fills(quantiles)
    shares = quantiles.axes[-1].values  # the last axis is that of the quantiles
    seen: set[int] = set()
    notes: list[Artist] = []
    for (rank, k), colour in zip(enumerate(np.argsort(shares)), cycle(style.LINE_COLOURS[1:]), strict=False):
        paler = {code: style.tint(fill, (rank + 1.0) / len(shares)) for code, fill in fills.items()}
        seen |= _draw_bands(ax, quantiles, x, paler, slice(k, None, len(shares)), color=colour)
        notes.append(Line2D([], [], color=colour, linewidth=1.6, label=f"in {100.0 * shares[k]:g} %"))
    _draw_bands(ax, nominal, x, {}, **_WITHOUT)
    scale_panels(figure, [ax], (x, quantiles.along))
    notes = [*_notes(quantiles, sorted(seen), fills), *notes, Line2D([], [], **_WITHOUT)]
    style.lay_out(figure, ax, study.title, line, notes)
    return figure
