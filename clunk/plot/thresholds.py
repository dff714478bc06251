"""Thresholds as curves: over one other axis with the outcomes between them, over two in panels.

Under tolerances they are quantiles, as curves over one other axis, or probabilities along the key without one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import colors
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy.optimize import linear_sum_assignment

from clunk.analysis.quantiles import QUANTILE, probabilities
from clunk.analysis.thresholds import DRAW, Thresholds, word_text
from clunk.plot import style
from clunk.plot.maps import grid_of
from clunk.plot.plane import cell_edges, scale_axis, value_text
from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Floats, Positions
from clunk.study.axes import ResultAxis

_MOST_PANELS = 6
_LEAST = 0.002  # mean probability along the key of an outcome that is outlined and named
_NARROWEST = 0.002  # of the axis, a band that is seen


def curve_axes(axes: Sequence[ResultAxis], *, toleranced: bool = False) -> tuple[ResultAxis, ...]:
    """The axes with several values, x first, then that of the panels.

    Raises PlotError where there are not one or two; of toleranced thresholds, where there are more than one.
    """
    several = [axis for axis in axes if len(axis.values) > 1 and axis.parameter not in (DRAW, QUANTILE)]
    if not (len(several) <= 1 if toleranced else 1 <= len(several) <= 2):
        count = "no other axis" if not several else f"{len(several)} other axes"
        what, most = ("Quantiles", "one other axis") if toleranced else ("Thresholds", "one or two other axes")
        raise style.PlotError(f"{what} are drawn over {most}, and the config has {count}; -o FILE.csv takes all.")
    return tuple(sorted(several, key=lambda axis: -len(axis.values)))


@style.styled()
def threshold_figure(thresholds: Thresholds) -> Figure:
    """The outcomes as coloured bands over the other axis, exact upwards, and the thresholds as curves between them.

    Of two other axes the longer is x, and values of the other have a panel each.

    Raises PlotError where there is no other axis with several values, or more than two.
    """
    axes = curve_axes(thresholds.axes)
    cells, (x, *others) = _arranged(thresholds, axes)
    count = len(others[0].values) if others else 1
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_PANELS)).round().astype(int))
    columns, size = grid_of(chosen.size)
    figure, panels = style.new_panels(chosen.size, columns, size if others else style.SIZE)
    fills = _outcome_fills(thresholds)
    seen: set[int] = set()
    names = [value_text(other, other.values[at], symbol=True) for other in others for at in chosen]
    line = _heading("thresholds of", thresholds)
    for ax, name in zip(panels, names, strict=False):
        ax.set_title(name, loc="left", fontsize=9.0)
    for ax, at in zip(panels, chosen, strict=True):
        column = cells[:, at] if others else cells
        seen |= _fill_bands(ax, thresholds, x, column, fills)
        _draw_curves(ax, [points for _, points in _segments(thresholds, x.values, column)], style.INK)
        _scale_plane(ax, x, thresholds.along)
        ax.label_outer()
    notes = [style.swatch(_outcome_name(thresholds, code), fills[code]["facecolor"]) for code in sorted(seen)]
    style.lay_out(figure, panels[0], thresholds.study.title, line, notes)
    return figure


def _arranged(thresholds: Thresholds, axes: Sequence[ResultAxis]) -> tuple[Positions, list[ResultAxis]]:
    """Positions along these axes, which have all that have several values, and the axes, all in ascending order."""
    cells = np.arange(thresholds.lowest.size).reshape(thresholds.shape)
    order = [np.argsort(axis.values, kind="stable") for axis in thresholds.axes]
    cells = cells[np.ix_(*order)]
    front = [thresholds.axes.index(axis) for axis in axes]
    cells = np.moveaxis(cells, front, range(len(front))).reshape([len(axis.values) for axis in axes])
    return cells, [ResultAxis(a.parameter, np.sort(a.values), a.name, a.symbol, a.unit) for a in axes]


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


def _segments(thresholds: Thresholds, x: Floats, cells: Positions) -> Iterator[tuple[tuple[int, int], Floats]]:
    """Yield the pieces of curves between neighbouring cells: codes below and above, and both ends, (2, 2) float64.

    A threshold goes on in the one of the same change that is nearest, all together; alone, it is both points.
    """
    parts = [thresholds.of_cell(cell) for cell in cells.tolist()]
    columns = [_by_change(thresholds, part) for part in parts]
    for k, column in enumerate(columns):
        before = columns[k - 1] if k else {}
        after = columns[k + 1] if k + 1 < len(columns) else {}
        for change, values in column.items():
            if change not in before and change not in after:
                yield from ((change, np.array([[x[k], value]] * 2)) for value in values)
            following = after.get(change, values[:0])
            for i, j in zip(*linear_sum_assignment(np.abs(values[:, None] - following)), strict=True):
                yield change, np.array([[x[k], values[i]], [x[k + 1], following[j]]])


def _by_change(thresholds: Thresholds, part: slice) -> dict[tuple[int, int], Floats]:
    changes = list(zip(thresholds.below[part].tolist(), thresholds.above[part].tolist(), strict=True))
    values = thresholds.value[part]
    return {change: values[[each == change for each in changes]] for change in dict.fromkeys(changes)}


def _fill_bands(
    ax: Axes, thresholds: Thresholds, x: ResultAxis, cells: Positions, fills: Mapping[int, Mapping[str, Any]]
) -> set[int]:
    """Fill the intervals of the key with one outcome as bands over x; those without a fill stay empty.

    Returns the codes of the outcomes that have a band.
    """
    seen: set[int] = set()
    edges = np.clip(cell_edges(x), x.values[0], x.values[-1])
    low, high = thresholds.along.values[[0, -1]]
    columns = [_bands(thresholds, cell) for cell in cells.tolist()]
    for codes, group in groupby(range(len(columns)), key=lambda k: columns[k][0]):
        alike = list(group)
        across = np.array([edges[alike[0]], *x.values[alike], edges[alike[-1] + 1]])
        between = np.array([columns[k][1] for k in alike]).reshape(len(alike), len(codes) - 1).T
        levels = np.pad(between, ((0, 0), (1, 1)), "edge")
        levels = np.vstack([np.full(across.size, low), levels, np.full(across.size, high)])
        for code, lower, upper in zip(codes, levels[:-1], levels[1:], strict=True):
            if code in fills:
                ax.fill_between(across, lower, upper, linewidth=0.0, antialiased=False, zorder=1, **fills[code])
                seen.add(code)
    return seen


def _scale_plane(ax: Axes, x: ResultAxis, along: ResultAxis) -> None:
    """Scale both axes to their values: the other axis from left to right, the key upwards."""
    scale_axis(ax, "x", x)
    scale_axis(ax, "y", along)
    ax.set(xlim=(x.values[0], x.values[-1]), ylim=(along.values[0], along.values[-1]))


def _draw_curves(ax: Axes, pieces: Sequence[Floats], colour: str, **look: Any) -> None:
    """Draw pieces of curves, (2, 2) float64 each, and those of no length as points."""
    lines: dict[str, Any] = {"colors": colour, "linewidths": 1.4, "capstyle": "round", "zorder": 3} | look
    ax.add_collection(LineCollection(pieces, **lines))
    alone = np.array([ends[0] for ends in pieces if (ends[0] == ends[1]).all()]).reshape(-1, 2)
    ax.plot(*alone.T, ".", color=colour, markersize=4.0, zorder=3)


def _outcome_name(thresholds: Thresholds, code: int) -> str:
    """An outcome for people: yes and no for whether something holds."""
    word = thresholds.word(code)
    return ("no", "yes")[word] if isinstance(word, bool) else word_text(word)


def _outcome_fills(thresholds: Thresholds) -> dict[int, dict[str, Any]]:
    """Look of the band of each code: the tints of the labels, or shades of one hue."""
    words = zip(thresholds.words, style.shades(len(thresholds.words)), strict=True)
    fills = [style.colour_of(word) if isinstance(word, str) else shade for word, shade in words]
    colours = dict(enumerate(fills)) | {FAILED_CODE: style.FAILED_FILL}
    return {code: {"facecolor": fill} for code, fill in colours.items()}


@style.styled()
def quantile_figure(drawn: Thresholds, quantiles: Thresholds, nominal: Thresholds) -> Figure:
    """Bands over the other axis in which a share of the drawn drivelines has one outcome, darker for a larger share.

    drawn : thresholds of each draw
    quantiles : of these thresholds
    nominal : thresholds without tolerances, drawn as dashed curves

    Without another axis, the probability of each outcome along the key. Raises PlotError where there are more.
    """
    axes = curve_axes(nominal.axes, toleranced=True)
    if not axes:
        return _draw_probabilities(drawn, nominal)
    figure = style.new_figure()
    ax = figure.subplots()
    draws = len(drawn.axes[0].values)
    cells, (x,) = _arranged(nominal, axes)
    fills = _outcome_fills(quantiles)
    shares = quantiles.axes[-1].values
    shades = [colors.to_hex(mpl.colormaps["viridis"](depth)) for depth in np.linspace(0.85, 0.0, len(shares))]
    seen: set[int] = set()
    notes: list[Artist] = []
    for rank, k in enumerate(np.argsort(shares)):
        part = _of_quantile(quantiles, int(k))
        depth = (rank + 1.0) / len(shares)
        seen |= _fill_bands(
            ax,
            part,
            x,
            cells,
            {code: fill | {"facecolor": style.tint(fill["facecolor"], depth)} for code, fill in fills.items()},
        )
        _draw_curves(ax, [points for _, points in _segments(part, x.values, cells)], shades[rank])
        notes.append(Line2D([], [], color=shades[rank], linewidth=1.6, label=f"in {100.0 * shares[k]:g} %"))
    _draw_curves(ax, [points for _, points in _segments(nominal, x.values, cells)], style.INK, linestyles="--")
    notes.append(Line2D([], [], color=style.INK, linewidth=1.6, linestyle="--", label="without tolerances"))
    _scale_plane(ax, x, quantiles.along)
    swatches = [style.swatch(_outcome_name(quantiles, code), fills[code]["facecolor"]) for code in sorted(seen)]
    heading = _heading(f"share of {draws:,} drivelines", nominal)
    style.lay_out(figure, ax, drawn.study.title, heading, [*swatches, *notes])
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


def _draw_probabilities(drawn: Thresholds, nominal: Thresholds) -> Figure:
    """Draw the probability of each outcome along the key, one upon the other."""
    edges, shares = probabilities(drawn)
    figure = style.new_figure()
    ax = figure.subplots()
    fills = _outcome_fills(drawn)
    codes = [*range(len(drawn.words)), FAILED_CODE]
    bottom = np.zeros(len(shares))
    notes: list[Artist] = []
    for code, share in zip(codes, shares.T, strict=True):
        top = bottom + share
        ax.stairs(top, edges, baseline=bottom, fill=True, linewidth=0.0, **fills[code])
        if np.average(share, weights=np.diff(edges)) >= _LEAST:
            ax.stairs(top, edges, baseline=None, color=style.INK, linewidth=0.8)
            notes.append(style.swatch(_outcome_name(drawn, code), fills[code]["facecolor"]))
        bottom = top
    _, without = _bands(nominal, 0)
    for value in without:
        ax.axvline(value, color=style.INK, linewidth=1.2, linestyle="--")
    if without:
        notes.append(Line2D([], [], color=style.INK, linewidth=1.2, linestyle="--", label="without tolerances"))
    scale_axis(ax, "x", drawn.along)
    ax.set(xlim=drawn.along.values[[0, -1]], ylim=(0.0, 1.0), ylabel="Probability")
    heading = _heading(f"share of {len(drawn.axes[0].values):,} drivelines", nominal)
    style.lay_out(figure, ax, drawn.study.title, heading, notes)
    return figure
