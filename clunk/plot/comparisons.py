"""Comparisons as figures: where two regime maps differ, and measured points on a regime map."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import patheffects
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from clunk.analysis.comparison import Comparison
from clunk.analysis.trends import ExperimentComparison, Point
from clunk.plot.labelling import present, region_swatch, settle
from clunk.plot.maps import map_titles
from clunk.plot.plane import View, scale_axes
from clunk.plot.raster import Raster
from clunk.plot.regions import Regions, draw_boundaries, fill_regions, hatch_failed
from clunk.plot.style import FAINT_INK, INK, PlotError, cells_phrase, failed_notes, new_figure, palette_of, styled
from clunk.results.labels import FAILED
from clunk.results.regimemap import Results
from clunk.study.problems import shorten
from clunk.study.summaries import percent

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

# After Okabe and Ito (2008): far apart also for the colour blind, and none of them near the grey of the others.
_TRANSITION_COLOURS = ("#d55e00", "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9")
_OTHERS_COLOUR = "#a9adb0"
_MARK = (4.0, 8.0)  # points: a smaller square is not seen, a larger one hides what is around it
_DENSE = 0.1  # share of differing cells above which the labels stand on them instead of between them
_FAINT_LINE = "#8f989f"

_AGREES_COLOUR, _DIFFERS_COLOUR = INK, "#b23500"
_POINT = 6.5  # points, diameter of a measured point
_POINT_TEXT = 8.0  # points
_LINE = 92  # characters of the line under the title


def difference_map(a: Results, b: Results, comparison: Comparison) -> Figure:
    """The regimes of A, faint, and on them each cell that has another label in B, coloured by the two labels.

    a, b : what `comparison` compares

    Raises PlotError unless two axes were swept.
    """
    if a.shape != comparison.differs.shape or b.shape != a.shape:
        raise PlotError("The comparison is of other maps than these two: the grids differ.")
    view = View.of(a, 2)
    codes = view.arrange(a.sequence)
    marks = _marks(view, comparison)
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        map_titles(figure, ax, replace(a, title=_title(comparison)), view, "\n".join(_what_differs(comparison)))
        scale_axes(ax, view)
        regions = Regions(codes)
        hatch_failed(ax, view, regions)
        dense = comparison.differing > _DENSE * a.sequence.size
        line: dict[str, Any] = {"color": INK, "linewidth": 0.7} if dense else {"color": _FAINT_LINE, "linewidth": 0.8}
        draw_boundaries(ax, view, regions, **line)

        def look() -> Raster:
            raster = Raster.of(ax, regions, view)
            if not dense:
                for mark in marks:
                    raster.block(mark.x, mark.y, _mark_size(ax, view))
                raster.clear_taken()
            return raster

        notes: list[Artist] = [Line2D([], [], label="regimes of A", **line)]
        notes += [mark.handle() for mark in marks]
        notes += failed_notes(codes, f"{FAILED} in A")
        settle(figure, ax, a.labels, look, notes)
        size = _mark_size(ax, view)
        for mark in sorted(marks, key=lambda mark: mark.colour != _OTHERS_COLOUR):  # the others cover no colour
            mark.draw(ax, size, dense=dense)
        halo = [patheffects.Stroke(linewidth=2.4, foreground="white"), patheffects.Normal()]
        for text in ax.texts:
            text.set_color(INK if dense else FAINT_INK)
            text.set_path_effects(halo)
        return figure


def experiment_map(results: Results, comparison: ExperimentComparison) -> Figure:
    """The regime map with the measured points on it: filled where the labels agree, open and crossed where not.

    results : what `comparison` compares the measurements with

    Raises PlotError unless two axes were swept.
    """
    view = View.of(results, 2)
    codes = view.arrange(results.sequence)
    points = [point for point in comparison.points if point.computed is not None]
    values = np.array([[point.values[k] for k in view.keep] for point in points]).reshape(-1, 2)
    values = np.clip(values, [axis.values[0] for axis in view.axes], [axis.values[-1] for axis in view.axes])
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        caveat = textwrap.fill(comparison.experiment.caveat, _LINE)
        caveat = caveat[:1].upper() + caveat[1:]
        map_titles(figure, ax, results, view, f"points: measured, {comparison.experiment.name}\n{caveat}")
        scale_axes(ax, view)
        regions = Regions(codes)
        fill_regions(ax, view, regions, results.labels)
        draw_boundaries(ax, view, regions, color=INK, linewidth=0.7)
        placed: list[tuple[Point, float, float]] = []

        def look() -> Raster:
            raster = Raster.of(ax, regions, view)
            placed[:] = _place_points(raster, values, points)
            return raster

        notes = [*_point_handles(comparison), *failed_notes(codes)]
        palette = palette_of(results.labels)
        more: list[Artist] = []
        for _ in range(3):  # notes take height from the map, and less of the labels then has room
            unlabelled = settle(figure, ax, results.labels, look, [*notes, *more])
            there = present(results.labels, codes)
            missing: list[Artist] = [region_swatch(label, palette[label]) for label in unlabelled if label in there]
            if len(placed) < len(points):
                missing.append(Patch(alpha=0.0, label="a point without a label: no room"))
            if len(missing) <= len(more):
                break
            more = missing
        _draw_points(ax, values, points)
        for point, x_, y_ in placed:
            ax.text(
                x_,
                y_,
                point.measured,
                fontsize=_POINT_TEXT,
                color=_AGREES_COLOUR if point.agrees else _DIFFERS_COLOUR,
                ha="center",
                va="center",
                parse_math=False,
                zorder=7,
                gid="measured",
                bbox={"boxstyle": "round,pad=0.12", "facecolor": "white", "alpha": 0.85, "edgecolor": "none"},
            )
        return figure


class _Mark(NamedTuple):
    """Cells that are marked alike."""

    label: str
    x: Floats
    y: Floats
    colour: str
    marker: str

    def draw(self, ax: Axes, size: float, *, dense: bool) -> None:
        """Squares of this many points; where they are an area, the regimes' boundaries run over it."""
        look: dict[str, Any] = {"linewidths": 0.0} if self.marker == "s" else {"linewidths": 1.0}
        ax.scatter(
            self.x,
            self.y,
            s=size**2,
            color=self.colour,
            marker=self.marker,
            rasterized=len(self.x) > 4000,  # a vector file with a path for each of them would take seconds to show
            clip_on=dense,  # a single cell on the border of the map is a whole mark
            zorder=2 if dense else 4,
            gid="differs",
            **look,
        )

    def handle(self) -> Line2D:
        """Its entry in the notes."""
        return Line2D([], [], color=self.colour, marker=self.marker, markersize=7, linestyle="none", label=self.label)


def _marks(view: View, comparison: Comparison) -> list[_Mark]:
    """The most frequent transitions, each in its colour, then the others together, then cells that failed in B only."""
    codes_a, codes_b = view.arrange(comparison.codes_a), view.arrange(comparison.codes_b)
    rest = view.arrange(comparison.differs).copy()
    failed_in_b = view.arrange(comparison.failed_b & ~comparison.failed_a)
    shown = comparison.transitions
    if len(shown) > len(_TRANSITION_COLOURS):
        shown = shown[: len(_TRANSITION_COLOURS)]
    marks = []
    for transition, colour in zip(shown, _TRANSITION_COLOURS, strict=False):
        own = codes_a == comparison.labels.index(transition.a)
        own &= codes_b == comparison.labels.index(transition.b)
        rest &= ~own
        label = f"{transition.a} → {transition.b}: {cells_phrase(transition.cells)}"
        marks.append(_mark(view, own, label, colour, "s"))
    others = len(comparison.transitions) - len(shown)
    if others:
        label = f"{others} other transition{'' if others == 1 else 's'}: {cells_phrase(int(rest.sum()))}"
        marks.append(_mark(view, rest, label, _OTHERS_COLOUR, "s"))
    if failed_in_b.any():
        marks.append(_mark(view, failed_in_b, f"{FAILED} in B only: {cells_phrase(int(failed_in_b.sum()))}", INK, "x"))
    return marks


def _mark(view: View, cells: Bools, label: str, colour: str, marker: str) -> _Mark:
    i, j = np.nonzero(cells)
    return _Mark(label, view.x.values[i], view.y.values[j], colour, marker)


def _mark_size(ax: Axes, view: View) -> float:
    """Side of a mark in points: a cell's, as far as that can be seen and hides nothing."""
    box = ax.get_window_extent()
    figure = ax.get_figure(root=True)
    assert figure is not None
    cell = min(box.width / len(view.x.values), box.height / len(view.y.values)) * 72.0 / figure.dpi
    return float(np.clip(cell, *_MARK))


def _title(comparison: Comparison) -> str:
    a, b = comparison.titles
    return f"Differences: {a}" if a == b else "Differences between two maps"


def _what_differs(comparison: Comparison) -> list[str]:
    """How many cells, and what was done otherwise; for the line under the title."""
    number = f"{comparison.differing:,} of {comparison.cells:,} cells differ"
    share = f" ({percent(comparison.differing, comparison.cells)})" if comparison.cells else ""
    lines = [number + share]
    if comparison.titles[0] != comparison.titles[1]:
        for letter, title in zip("AB", comparison.titles, strict=True):
            lines += textwrap.wrap(f"{letter}: {title}", _LINE)
    changes = [change for change in comparison.config_differences if change.key != "title"]
    if comparison.configs_equal:
        lines.append("A and B: the same config")
    elif 0 < len(changes) <= 3:
        listed = "; ".join(f"{each.key} = {_or_none(each.a)} → {_or_none(each.b)}" for each in changes)
        lines += textwrap.wrap(f"A → B: {listed}", _LINE)
    else:
        lines.append(f"A → B: {len(changes)} keys of the config differ")
    return lines


def _or_none(value: Any) -> str:
    return "(not given)" if value is None else shorten(value, 30)


def _point_handles(comparison: ExperimentComparison) -> list[Artist]:
    agrees = f"measured, agrees: {comparison.agreeing} of {comparison.counted}"
    if comparison.counted:
        agrees += f" ({percent(comparison.agreeing, comparison.counted)})"
    handles: list[Artist] = [
        Line2D([], [], linestyle="none", label=agrees, **_look(agrees=True)),
        Line2D([], [], linestyle="none", label="measured, differs", **_look(agrees=False)),
    ]
    if comparison.outside:
        handles.append(Patch(alpha=0.0, label=f"outside the map, not counted: {comparison.outside}"))
    return handles


def _look(*, agrees: bool) -> dict[str, Any]:
    if agrees:
        return {"marker": "o", "markersize": _POINT, "markerfacecolor": INK, "markeredgecolor": "white"}
    return {
        "marker": "$\\otimes$",
        "markersize": _POINT + 2.0,
        "markerfacecolor": _DIFFERS_COLOUR,
        "markeredgecolor": "none",
    }


def _draw_points(ax: Axes, values: Floats, points: Sequence[Point]) -> None:
    common: dict[str, Any] = {"linestyle": "none", "clip_on": False, "zorder": 6}
    for (x, y), point in zip(values, points, strict=True):
        if point.agrees:
            ax.plot([x], [y], gid="agrees", **_look(agrees=True), **common)
        else:
            ax.plot([x], [y], "o", color="white", markersize=_POINT + 1.0, **common)
            ax.plot([x], [y], gid="differs", **_look(agrees=False), **common)


# Where a label goes beside its point, the first that is free: right, left, above, below, then askew.
_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))


def _place_points(raster: Raster, values: Floats, points: Sequence[Point]) -> list[tuple[Point, float, float]]:
    """Where each measured label goes; (point, x, y) in data coordinates, without those that find no room.

    The places of points and labels are taken out of the raster's regions, so that no region's label goes there.
    """
    x, y = raster.pixels(values)
    half = raster.block(values[:, 0], values[:, 1], _POINT + 2.0)
    placed = []
    border = raster.border()
    height, width = raster.label.shape
    for column, row, point in zip(x, y, points, strict=True):
        across, upward = raster.measure(point.measured, _POINT_TEXT)
        best: tuple[float, float, float] | None = None
        for rank, (right, up) in enumerate(_SIDES):
            u = column + right * (half + 1 + 0.5 * across)
            v = row + up * (half + 1 + 0.5 * upward)
            left, low = math.floor(u - 0.5 * across), math.floor(v - 0.5 * upward)
            if left < 0 or low < 0 or left + across > width or low + upward > height:
                continue
            window = np.s_[low : low + upward, left : left + across]
            if raster.taken[window].any():
                continue
            cost = rank + 0.02 * np.count_nonzero(border[window])  # a boundary through a text is a little worse
            if best is None or cost < best[0]:
                best = cost, u, v
        if best is not None:
            _, u, v = best
            left, low = math.floor(u - 0.5 * across), math.floor(v - 0.5 * upward)
            raster.taken[low : low + upward, left : left + across] = True
            placed.append((point, *raster.data(u, v)))
    raster.clear_taken()
    return placed
