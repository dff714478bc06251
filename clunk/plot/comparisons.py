"""Comparisons as figures: where two regime maps differ, and measured points on a regime map."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.analysis.comparison import Comparison
from clunk.analysis.trends import ExperimentComparison, Point
from clunk.plot.labelling import settle
from clunk.plot.layers import Layers
from clunk.plot.notes import cells_phrase, failed_notes, remark, swatch
from clunk.plot.painting import draw_boundaries, hatch_failed, new_map, paint_regimes
from clunk.plot.plane import View
from clunk.plot.raster import Raster
from clunk.plot.style import CENTRED, FAINT_INK, INK, capital, halo, palette_of, styled
from clunk.results.labels import FAILED
from clunk.results.regimemap import Results
from clunk.study.arrays import Bools, Floats
from clunk.study.problems import shorten
from clunk.study.summaries import percent

# After Okabe and Ito (2008): far apart also for the colour blind, and none of them near the grey of the rare ones.
_TRANSITION_COLOURS = ("#d55e00", "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9")
_RARE_COLOUR = "#a9adb0"
_MARK = (4.0, 8.0)  # points: a smaller square is not seen, a larger one hides what is around it
_DENSE = 0.1  # share of differing cells above which the labels stand on them instead of between them
_FAINT_LINE = "#8f989f"

_AGREES, _DIFFERS = INK, "#b23500"
_POINT = 6.5  # points, diameter of a measured point
_POINT_LOOKS: dict[bool, dict[str, Any]] = {  # of points that agree, and that do not
    True: {"marker": "o", "markersize": _POINT, "markerfacecolor": _AGREES, "markeredgecolor": "white"},
    False: {"marker": "$\\otimes$", "markersize": _POINT + 2.0, "markerfacecolor": _DIFFERS, "markeredgecolor": "none"},
}
_POINT_TEXT = 8.0  # points
_LINE = 92  # characters of the line under the title


@styled()
def difference_map(a: Results, comparison: Comparison) -> Figure:
    """The regimes of A, faint, and on them each cell that has another label in B, coloured by the two labels.

    a : the first of the maps that `comparison` compares

    Raises PlotError unless two axes were swept.
    """
    title = f"Differences: {a.title}" if len(set(comparison.titles.values())) == 1 else "Differences between two maps"
    layers = replace(Layers.of(a, 2), title=title)
    view, marks = layers.view, _marks(layers.view, comparison)
    dense = comparison.differing > _DENSE * a.sequence.size
    line: dict[str, Any] = {"color": INK, "linewidth": 0.7} if dense else {"color": _FAINT_LINE, "linewidth": 0.8}
    figure, ax = new_map(layers, "\n".join(_differences(comparison)))
    hatch_failed(ax, layers)
    draw_boundaries(ax, layers, **line)

    def take_marks(raster: Raster) -> None:
        if not dense:
            for mark in marks:
                raster.block(mark.x, mark.y, _mark_size(ax, figure, view))
            raster.clear_taken()

    notes: list[Artist] = [Line2D([], [], label="regimes of A", **line)]
    notes += [mark.handle() for mark in marks]
    notes += failed_notes(layers.failed, f"{FAILED} in A")
    settle(figure, ax, layers, notes, take_marks)
    for mark in sorted(marks, key=lambda mark: mark.colour != _RARE_COLOUR):  # rare ones cover no colour
        mark.draw(ax, _mark_size(ax, figure, view), dense=dense)
    for text in ax.texts:
        text.set(color=INK if dense else FAINT_INK, path_effects=halo())
    return figure


@styled()
def experiment_map(results: Results, comparison: ExperimentComparison) -> Figure:
    """The regime map with the measured points on it: filled where the labels agree, open and crossed where not.

    results : what `comparison` compares the measurements with

    Raises PlotError unless two axes were swept.
    """
    layers = Layers.of(results, 2)
    view = layers.view
    points = [point for point in comparison.points if point.computed is not None]
    values = np.array([[point.values[k] for k in view.keep] for point in points]).reshape(-1, 2)
    values = np.clip(values, [axis.values[0] for axis in view.axes], [axis.values[-1] for axis in view.axes])
    caveat = capital(textwrap.fill(comparison.experiment.caveat, _LINE))
    figure, ax = new_map(layers, f"points: measured, {comparison.experiment.name}\n{caveat}")
    paint_regimes(ax, layers, linewidth=0.7)
    placed: list[tuple[Point, float, float]] = []

    def take_points(raster: Raster) -> None:
        placed[:] = _place_points(raster, values, points)

    notes = [*_point_handles(comparison), *failed_notes(layers.failed)]
    palette = palette_of(results.labels)
    more: list[Artist] = []
    for _ in range(3):  # notes take height from the map, and less of the labels then has room
        unlabelled = settle(figure, ax, layers, [*notes, *more], take_points)
        missing: list[Artist] = [swatch(label, palette[label]) for label in unlabelled]
        if len(placed) < len(points):
            missing.append(remark("a point without a label: no room"))
        if len(missing) <= len(more):
            break
        more = missing
    draw_points(ax, values, points)
    for point, x, y in placed:
        _write_measured(ax, point, x, y)
    return figure


class _Mark(NamedTuple):
    """Cells that are marked alike."""

    label: str
    x: Floats
    y: Floats
    colour: str
    marker: str

    def draw(self, ax: Axes, size: float, *, dense: bool) -> None:
        """Draw squares of this many points; where they are an area, the regimes' boundaries run over it."""
        look: dict[str, Any] = {"color": self.colour, "marker": self.marker, "zorder": 2 if dense else 4}
        look["rasterized"] = len(self.x) > 4000  # a vector file with a path for each of them would take seconds to show
        look["clip_on"] = dense  # a single cell on the border of the map is a whole mark
        look["linewidths"] = 0.0 if self.marker == "s" else 1.0
        ax.scatter(self.x, self.y, s=size**2, gid="differs", **look)

    def handle(self) -> Line2D:
        """Make the entry in the notes."""
        return Line2D([], [], color=self.colour, marker=self.marker, markersize=7, linestyle="none", label=self.label)


def _marks(view: View, comparison: Comparison) -> list[_Mark]:
    """The most frequent transitions, each in its colour, then the rest together, then cells that failed in B only."""
    codes_a, codes_b = view.arrange(comparison.codes_a), view.arrange(comparison.codes_b)
    rest = view.arrange(comparison.differs).copy()
    failed_in_b = view.arrange(comparison.failed_b & ~comparison.failed_a)
    marks = []
    for transition, colour in zip(comparison.transitions, _TRANSITION_COLOURS, strict=False):
        code_a, code_b = comparison.labels.index(transition.a), comparison.labels.index(transition.b)
        cells = (codes_a == code_a) & (codes_b == code_b)
        rest &= ~cells
        marks.append(_mark(view, cells, f"{transition.a} → {transition.b}", colour))
    rare = len(comparison.transitions) - len(marks)
    if rare:
        marks.append(_mark(view, rest, f"{rare} other transition{'' if rare == 1 else 's'}", _RARE_COLOUR))
    if failed_in_b.any():
        marks.append(_mark(view, failed_in_b, f"{FAILED} in B only", INK, "x"))
    return marks


def _mark(view: View, cells: Bools, text: str, colour: str, marker: str = "s") -> _Mark:
    """Marks of some cells, with their number behind the text."""
    i, j = np.nonzero(cells)
    return _Mark(f"{text}: {cells_phrase(i.size)}", view.x.values[i], view.y.values[j], colour, marker)


def _mark_size(ax: Axes, figure: Figure, view: View) -> float:
    """Side of a mark in points: a cell's, as far as that can be seen and hides nothing."""
    box = ax.get_window_extent()
    cell = min(box.width / len(view.x.values), box.height / len(view.y.values)) * 72.0 / figure.dpi
    return float(np.clip(cell, *_MARK))


def _differences(comparison: Comparison) -> list[str]:
    """Number of differing cells, titles and config of both maps; for the line under the title."""
    lines = [f"{comparison.differing:,} of {comparison.cells:,} cells differ"]
    if comparison.cells:
        lines[0] += f" ({percent(comparison.differing, comparison.cells)})"
    if comparison.titles["a"] != comparison.titles["b"]:
        for letter, title in comparison.titles.items():
            lines += textwrap.wrap(f"{letter.upper()}: {title}", _LINE)
    changes = [change for change in comparison.config_differences if change.key != "title"]
    if comparison.configs_equal:
        lines.append("A and B: the same config")
    elif 0 < len(changes) <= 3:
        listed = "; ".join(f"{each.key} = {_shortened(each.a)} → {_shortened(each.b)}" for each in changes)
        lines += textwrap.wrap(f"A → B: {listed}", _LINE)
    else:
        lines.append(f"A → B: {len(changes)} keys of the config differ")
    return lines


def _shortened(value: Any) -> str:
    """A value of the config as text of 30 characters at most."""
    return "(not given)" if value is None else shorten(value, 30)


def _point_handles(comparison: ExperimentComparison) -> list[Artist]:
    """Notes that explain the points, with how many of them agree."""
    agrees = f"measured, agrees: {comparison.agreeing} of {comparison.counted}"
    if comparison.counted:
        agrees += f" ({percent(comparison.agreeing, comparison.counted)})"
    handles: list[Artist] = [
        Line2D([], [], linestyle="none", label=text, **_POINT_LOOKS[agree])
        for text, agree in ((agrees, True), ("measured, differs", False))
    ]
    if comparison.outside:
        handles.append(remark(f"outside the map, not counted: {comparison.outside}"))
    return handles


def _write_measured(ax: Axes, point: Point, x: float, y: float) -> None:
    """Write a measured label beside its point."""
    box = {"boxstyle": "round,pad=0.12", "facecolor": "white", "alpha": 0.85, "edgecolor": "none"}
    colour = _AGREES if point.agrees else _DIFFERS
    look: dict[str, Any] = CENTRED | {"color": colour, "bbox": box, "zorder": 7}
    ax.text(x, y, point.measured, fontsize=_POINT_TEXT, parse_math=False, gid="measured", **look)


def draw_points(ax: Axes, values: Floats, points: Sequence[Point]) -> None:
    """Draw the measured points."""
    common: dict[str, Any] = {"linestyle": "none", "clip_on": False, "zorder": 6}
    for (x, y), point in zip(values, points, strict=True):
        if not point.agrees:
            ax.plot([x], [y], marker="o", color="white", markersize=_POINT + 1.0, **common)
        ax.plot([x], [y], gid="agrees" if point.agrees else "differs", **_POINT_LOOKS[bool(point.agrees)], **common)


# Where a label goes beside its point, the first that is free: right, left, above, below, then askew.
_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))


def _place_points(raster: Raster, values: Floats, points: Sequence[Point]) -> list[tuple[Point, float, float]]:
    """Places of the measured labels, (point, x, y) in data coordinates, without those that find no room.

    The places of points and labels are taken out of the raster's regions, so that no region's label goes there.
    """
    x, y = raster.pixels(values)
    half = raster.block(values[:, 0], values[:, 1], _POINT + 2.0)
    border = raster.border()
    placed = []
    for column, row, point in zip(x, y, points, strict=True):
        centre = _beside(raster, border, (column, row), half + 1, raster.measure(point.measured, _POINT_TEXT))
        if centre is not None:
            placed.append((point, *raster.data(*centre)))
    raster.clear_taken()
    return placed


def _beside(
    raster: Raster, border: Bools, place: tuple[float, float], distance: float, size: tuple[int, int]
) -> tuple[float, float] | None:
    """Take the best free rectangle beside a point; returns its centre, None where nothing is free.

    place, distance, size : of the point, from it to the rectangle, and of that  [raster pixels]
    """
    best, centre, taken = math.inf, None, None
    for rank, side in enumerate(_SIDES):
        u, v = (at + way * (distance + 0.5 * extent) for at, way, extent in zip(place, side, size, strict=True))
        left, low = math.floor(u - 0.5 * size[0]), math.floor(v - 0.5 * size[1])
        if left < 0 or low < 0 or left + size[0] > border.shape[1] or low + size[1] > border.shape[0]:
            continue
        window = np.s_[low : low + size[1], left : left + size[0]]
        cost = rank + 0.02 * np.count_nonzero(border[window])  # a boundary through a text is a little worse
        if cost < best and not raster.taken[window].any():
            best, centre, taken = cost, (u, v), window
    if taken is not None:
        raster.taken[taken] = True
    return centre
