"""Results as figures for people: regime maps like the report's Figure 3.4, severity maps like its Figure 3.7.

Cells are samples: a regime is known at the swept values and nowhere between. Regions are drawn from the first to the
last value, with smooth boundaries that pass between the same samples as they do in the data, so that every sample lies
in a region of its own label however small that is.
"""

from __future__ import annotations

import math
import os
import re
import secrets
import textwrap
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import colors, patheffects, style, ticker
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from scipy import ndimage

from clunk.results import FAILED, FAILED_CODE, ResultAxis, Results

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Codes = npt.NDArray[np.int16]
Scores = npt.NDArray[np.float32]

# Quantity of a cell -> (name, symbol, unit); "regimes" is the map of labels.
_QUANTITY = {
    "severity": ("Severity", "Q", "rad/s²"),
    "approach_velocity": ("Approach velocity", "V", "rad/s"),
    "primary_impacts": ("Primary impacts", "", ""),
    "touches": ("Touches, chatter included", "", ""),
    "last_event_time": ("Last event after the load step", "", "s"),
}
QUANTITIES: list[str] = ["regimes", *_QUANTITY]
_FORMATS = ("png", "svg", "pdf")

_SIZE = (7.0, 5.2)  # inches
_DPI = 150
_INK = "#1c2126"
_FAINT_INK = "#5b646c"
_FAILED_FILL, _FAILED_HATCH = "#d5d5d5", "#8a8a8a"
# One hue per number of double-sided impacts, tinted. Chosen so that the nine labels of Figure 3.4 stay apart under
# simulated protanopia, deuteranopia and tritanopia too (Machado et al. 2009; at least 6.8 in CIE L*a*b*).
_NO_IMPACT = "#f6f5f1"
_HUES = ("#b5b010", "#2f7fc1", "#dd6b1f", "#a84a72", "#1f9e83", "#6b7480", "#9a6a4a")
_TINTS = (0.30, 0.70)  # lightest and darkest member of a family; text stays readable on the darkest

_STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "axes.labelsize": 10.0,
    "axes.linewidth": 0.8,
    "axes.edgecolor": _INK,
    "axes.labelcolor": _INK,
    "text.color": _INK,
    "xtick.color": _INK,
    "ytick.color": _INK,
    "hatch.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "pdf.fonttype": 42,  # journals refuse Type 3
    "svg.hashsalt": "clunk",  # the same figure gives the same file
}


class PlotError(Exception):
    """Results that cannot be drawn as asked; its text is one sentence for the user."""


# --- figures


def draw(results: Results, quantity: str, thresholds: Sequence[float] = ()) -> Figure:
    """The figure of a quantity of `QUANTITIES`: a map for two swept axes, a strip for one. Raises PlotError."""
    if quantity not in QUANTITIES:
        raise PlotError(f"There is no quantity {quantity!r}; there are {', '.join(QUANTITIES)}.")
    if len(_drawn_axes(results)) == 1:
        if quantity == "regimes":  # Q is not defined under the restitution model
            quantity = "severity" if np.isfinite(results.severity).any() else "approach_velocity"
        return strip(results, quantity)
    if quantity == "regimes":
        return regime_map(results, thresholds)
    return quantity_map(results, quantity)


def regime_map(results: Results, thresholds: Sequence[float] = ()) -> Figure:
    """Which sequence of impacts happens where, each region with its label inside (Figure 3.4).

    thresholds : load ratios at which the number of impacts for vanishing backlash changes (Table 3.1), marked where
        load ratio and backlash are the axes; over any other, the thresholds might not be the same all along it

    Raises PlotError unless two axes were swept.
    """
    view = _View.of(results, 2)
    with _styled():
        figure = _figure()
        ax = figure.add_subplot()
        _titles(figure, ax, results, view)
        _scale_axes(ax, view)
        codes = view.arrange(results.sequence)
        regions = _Regions(codes)
        palette = _palette(results.labels)
        x, y = regions.fine_values(view)
        for code in regions.present:
            margin = regions.margin(code).T
            if code == FAILED_CODE:
                _hatch(ax, x, y, margin)
            elif margin.max() > 0.0:
                ax.contourf(x, y, margin, levels=[0.0, np.inf], colors=[palette[results.labels[code]]], zorder=1)
        _boundaries(ax, x, y, regions, color=_INK, linewidth=0.9)
        if (view.x.parameter, view.y.parameter) == ("load.ratio", "lash.backlash_deg"):
            _mark_thresholds(ax, thresholds)
        _label_and_note(figure, ax, results.labels, codes, lambda: _Raster.of(ax, regions, view), leaders=True)
        return figure


def severity_map(results: Results) -> Figure:
    """How severe the impacts are, and at which backlash they are worst for each load ratio (Figure 3.7).

    Raises PlotError unless two axes were swept and Q is defined somewhere.
    """
    return quantity_map(results, "severity")


def quantity_map(results: Results, name: str) -> Figure:
    """A quantity of every cell as colour, under the regimes' boundaries; for the severity also its ridge.

    Raises PlotError unless two axes were swept, `name` is a quantity and it is defined in some cell.
    """
    label = _quantity_label(name)
    view = _View.of(results, 2)
    codes = view.arrange(results.sequence)
    values = view.arrange(_values(results, name))
    whole = name in ("primary_impacts", "touches")
    with _styled():
        figure = _figure()
        ax = figure.add_subplot()
        _titles(figure, ax, results, view, "light lines: boundaries of the regimes")
        _scale_axes(ax, view)
        ax.set_facecolor("#efefec")
        mesh = ax.pcolormesh(
            _edges(view.x.values),
            _edges(view.y.values),
            values.T,
            cmap="viridis",
            norm=_norm(values, whole=whole),
            rasterized=True,  # a vector file with a path for every cell would take seconds to show
            zorder=0.5,
        )
        bar = figure.colorbar(mesh, ax=ax, pad=0.02, aspect=28)
        _finish_bar(bar, label, whole=whole)
        regions = _Regions(codes)
        x, y = regions.fine_values(view)
        if FAILED_CODE in regions.present:
            _hatch(ax, x, y, regions.margin(FAILED_CODE).T)
        _boundaries(ax, x, y, regions, color="white", linewidth=0.6, alpha=0.75)
        notes = _failed_notes(codes)
        if np.isnan(values[codes != FAILED_CODE]).any():
            notes.append(Patch(facecolor="#efefec", edgecolor=_INK, linewidth=0.6, label="not defined (no events)"))
        ridge = ridge_of(values) if name == "severity" else np.full(len(view.x.values), np.nan)
        if np.isfinite(ridge).any():
            _draw_ridge(ax, view, ridge)
        _note(figure, notes)
        _freeze_layout(figure, ax)
        if np.isfinite(ridge).any():
            _label_ridge(ax, view, ridge)
        return figure


def strip(results: Results, quantity: str = "severity") -> Figure:
    """Along one swept axis: the labels as a coloured strip over the curve of a quantity.

    Raises PlotError unless one axis was swept, `quantity` is one and it is defined in some cell.
    """
    label = _quantity_label(quantity)
    view = _View.of(results, 1)
    codes = view.arrange(results.sequence)
    values = view.arrange(_values(results, quantity))
    palette = _palette(results.labels)
    with _styled():
        figure = _figure()
        band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
        _titles(figure, band, results, view)
        samples = view.x.values
        edges = _edges(samples)
        starts = np.concatenate(([0], np.flatnonzero(np.diff(codes)) + 1, [len(codes)]))
        for start, stop in pairwise(starts):
            left, right = max(edges[start], samples[0]), min(edges[stop], samples[-1])
            if len(samples) == 1:
                left, right = edges
            if codes[start] == FAILED_CODE:
                look: dict[str, Any] = {"facecolor": _FAILED_FILL, "hatch": "////", "edgecolor": _FAILED_HATCH}
            else:
                look = {"facecolor": palette[results.labels[codes[start]]], "edgecolor": "none"}
            band.axvspan(left, right, linewidth=0.0, zorder=1, **look)
            if start:
                band.axvline(left, color=_INK, linewidth=0.9, zorder=2)
                ax.axvline(left, color=_FAINT_INK, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
            # One line per regime: the quantity jumps between them.
            marker = {"marker": "o", "markersize": 3.0} if len(samples) <= 60 or stop - start == 1 else {}
            look = {"color": _HUES[1], "linewidth": 1.5, "clip_on": False, "zorder": 3}
            ax.plot(samples[start:stop], values[start:stop], **look, **marker)
        _scale_axis(ax, "x", view.x)
        ax.set_xlim(*((samples[0], samples[-1]) if len(samples) > 1 else edges))
        ax.set_ylabel(label)
        if not np.nanmin(values) < 0.0:
            ax.set_ylim(bottom=0.0)
        ax.grid(axis="y", color="0.9", linewidth=0.6)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        band.set_yticks([])
        band.tick_params(bottom=False, labelbottom=False)
        _label_and_note(
            figure, band, results.labels, codes, lambda: _Raster.of_strip(band, codes, edges), leaders=False
        )
        return figure


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, SVG or PDF, by the suffix; the file appears whole or not at all. Raises PlotError."""
    path = Path(path)
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in _FORMATS:
        raise PlotError(f"{path} cannot be drawn: its name must end in {', '.join('.' + name for name in _FORMATS)}.")
    # Nothing of the moment goes into the file, so that the same results give the same bytes.
    metadata: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[suffix]
    options: dict[str, Any] = {"pil_kwargs": {"optimize": True}} if suffix == "png" else {}
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        with _styled(), temporary.open("xb") as target:
            figure.savefig(target, format=suffix, metadata=metadata, **options)
        temporary.replace(path)
    except OSError as error:
        raise PlotError(f"{path} cannot be written: {(error.strerror or str(error)).lower()}.") from error
    finally:
        with suppress(OSError):  # its directory may be what is missing
            temporary.unlink(missing_ok=True)


def ridge_of(values: Floats) -> Floats:
    """Index along the second axis of the largest value in each row of the first, where that is an interior maximum.

    values : (nx, ny); returns (nx,) float, NaN where the largest value is not positive, lies on the border of the map,
    beside a value that is not known, or within 0.1 % of either end's: on a plateau rounding would choose the place.
    """
    ridge = np.full(len(values), np.nan)
    for row, column in enumerate(values):
        if np.isnan(column).all():
            continue
        top = int(np.nanargmax(column))
        interior = 0 < top < len(column) - 1 and np.isfinite(column[[top - 1, top + 1]]).all()
        if interior and column[top] > 0.0 and not (column[[0, -1]] > 0.999 * column[top]).any():
            ridge[row] = top
    return ridge


# --- the results as a plane


@dataclass(frozen=True)
class _View:
    """The swept axes of some results, ascending, and how their arrays are turned to match."""

    axes: tuple[ResultAxis, ...]  # x and, for a map, y
    fixed: tuple[ResultAxis, ...]  # axes of one value
    keep: tuple[int, ...]
    order: tuple[npt.NDArray[np.intp], ...]

    @classmethod
    def of(cls, results: Results, dimensions: int) -> _View:
        keep = _drawn_axes(results)
        if len(keep) != dimensions:
            swept = ", ".join(results.axes[index].parameter for index in keep)
            if len(keep) > 2:
                raise PlotError(
                    f"These results sweep {len(keep)} axes ({swept}) and a map shows two: take the others out of the "
                    "config's [[sweep.axes]], fix each with --set KEY=VALUE, and sweep again."
                )
            kind = {1: "one axis", 2: "two axes"}
            raise PlotError(
                f"This figure needs {kind[dimensions]} and these results sweep {kind[len(keep)]} ({swept})."
            )
        if dimensions == 2 and results.axes[keep[1]].parameter == "load.ratio":
            keep = keep[::-1]
        order = tuple(np.argsort(results.axes[index].values, kind="stable") for index in keep)
        axes = []
        for index, ascending in zip(keep, order, strict=True):
            axis = results.axes[index]
            axes.append(ResultAxis(axis.parameter, axis.values[ascending], axis.name, axis.symbol, axis.unit))
        fixed = tuple(axis for index, axis in enumerate(results.axes) if index not in keep)
        return cls(tuple(axes), fixed, keep, order)

    @property
    def x(self) -> ResultAxis:
        return self.axes[0]

    @property
    def y(self) -> ResultAxis:
        return self.axes[1]

    def arrange(self, array: Array) -> Array:
        """An array of the results' shape as (nx,) or (nx, ny), ascending."""
        rest = tuple(axis for axis in range(array.ndim) if axis not in self.keep)
        turned = np.transpose(array, (*self.keep, *rest)).reshape([len(order) for order in self.order])
        return turned[np.ix_(*self.order)]


def _drawn_axes(results: Results) -> tuple[int, ...]:
    """Axes with more than one value; the first if there is none."""
    return tuple(index for index, axis in enumerate(results.axes) if len(axis.values) > 1) or (0,)


def _values(results: Results, name: str) -> Floats:
    values = np.where(results.sequence == FAILED_CODE, np.nan, getattr(results, name).astype(np.float64))
    if np.isnan(values).all():
        why = (
            "; under the restitution model accelerations are impulsive, and approach_velocity is the measure to plot"
            if name == "severity"
            else ""
        )
        raise PlotError(f"There is no {name} to draw: it is not defined in any cell{why}.")
    return values


def _is_geometric(values: Floats) -> bool:
    """Whether the values are spaced evenly in their logarithm, and not in themselves."""
    if len(values) < 3 or values[0] <= 0.0:
        return False
    steps = np.diff(np.log(values))
    return bool(np.allclose(steps, steps.mean(), rtol=1e-6) and values[-1] / values[0] > 3.0)


def _ruler(values: Floats) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """The scale of an axis and its inverse: halfway between two values of a geometric axis is their geometric mean."""
    return (np.log, np.exp) if _is_geometric(values) else (np.asarray, np.asarray)


def _edges(values: Floats) -> Floats:
    """(n + 1,) limits of cells centred on their values."""
    if len(values) == 1:
        half = 0.5 * (abs(values[0]) or 1.0)
        return np.array([values[0] - half, values[0] + half])
    to, back = _ruler(values)
    scaled = to(values)
    middle = 0.5 * (scaled[1:] + scaled[:-1])
    edges: Floats = back(np.concatenate(([2 * scaled[0] - middle[0]], middle, [2 * scaled[-1] - middle[-1]])))
    return edges


# --- regions


class _Regions:
    """The label between the samples: smooth boundaries, and every sample on its own side of them.

    Each label has a score at each sample, the smoothed indicator of its cells; between samples scores are interpolated
    and the highest wins. A sample that smoothing would hand to another label pushes its own score up until it does not;
    where that is not enough, and on lines and specks, nothing is smoothed. So a boundary never leaves the gap between
    two samples: what the data leave open is all that is smoothed.
    """

    _BLUR = 2.0  # standard deviation in cells
    _REACH = 0.8  # likewise, of a push: how far a boundary gives way for a sample on its wrong side
    _LEAD = 0.02  # score by which a pushed sample's own label wins
    _TIP_LEAD = 0.05  # and more on lines and tips, or they would shrink to nothing between their neighbours

    def __init__(self, codes: Codes) -> None:
        self.codes = codes  # (nx, ny)
        self.present: list[int] = [int(code) for code in np.unique(codes)]
        # As fine as the picture can show, at least the samples themselves.
        self.factor = tuple(int(np.clip(math.ceil(700 / count), 1, 8)) for count in codes.shape)
        self._push = np.zeros(codes.shape, np.float32)
        specks, tips = self._specks()
        self._bare = specks | ndimage.binary_dilation(codes == FAILED_CODE)
        for _ in range(8):
            deficit = self._deficit() + np.where(tips, self._TIP_LEAD, 0.0)
            if deficit.max() <= 0.0:
                break
            self._push += np.where(deficit > 0.0, deficit + self._LEAD, 0.0)
        self._bare |= self._deficit() > 0.0
        self.label, self._best, self._second = self._compete()
        for _ in range(8):
            wrong = self._wrong()
            if not wrong.any():
                break
            self._bare |= wrong
            self.label, self._best, self._second = self._compete()
        else:
            self._bare[:] = True
            self.label, self._best, self._second = self._compete()

    def margin(self, code: int) -> Scores:
        """By how much a label wins (positive) or loses at each fine point."""
        score = self._score(code)
        margin: Scores = score - np.where(self.label == code, self._second, self._best)
        return margin

    def fine_values(self, view: _View) -> tuple[Floats, ...]:
        """The parameter at the fine points, along each axis."""
        values = []
        for axis, factor in zip(view.axes, self.factor, strict=True):
            to, back = _ruler(axis.values)
            count = len(axis.values)
            fine = np.linspace(0.0, count - 1.0, (count - 1) * factor + 1)
            values.append(back(np.interp(fine, np.arange(count), to(axis.values))))
        return tuple(values)

    def _specks(self) -> tuple[Bools, Bools]:
        """Cells in no 2 x 2 block of their label: of regions without any block, and of the others' lines and tips."""
        specks = np.zeros(self.codes.shape, np.bool_)
        tips = np.zeros(self.codes.shape, np.bool_)
        for code in self.present:
            own = self.codes == code
            block = ndimage.binary_opening(own, np.ones((2, 2)))
            parts, count = ndimage.label(own, np.ones((3, 3)))
            thick = np.zeros(count + 1, np.bool_)
            thick[parts[block]] = True
            specks |= own & ~thick[parts]
            tips |= own & thick[parts] & ~block
        return specks, tips

    def _sample_score(self, code: int) -> Scores:
        own: Scores = (self.codes == code).astype(np.float32)
        if self._bare.all():
            return own
        score = ndimage.gaussian_filter(own, self._BLUR, mode="nearest", truncate=3.0)
        push = own * self._push
        if push.any():
            peak = 1.0 / (2.0 * math.pi * self._REACH**2)  # of the kernel
            score += ndimage.gaussian_filter(push, self._REACH, mode="constant", truncate=3.0) / peak
        chosen: Scores = np.where(self._bare, own, score)
        return chosen

    def _deficit(self) -> Scores:
        """By how much each sample's own label falls short of another's score there."""
        mine = np.empty(self.codes.shape, np.float32)
        other = np.full(self.codes.shape, -np.inf, np.float32)
        for code in self.present:
            score = self._sample_score(code)
            own = self.codes == code
            mine[own] = score[own]
            other[~own] = np.maximum(other, score)[~own]
        deficit: Scores = other - mine
        return deficit

    def _score(self, code: int) -> Scores:
        score: Scores = self._sample_score(code)
        for axis, factor in enumerate(self.factor):
            score = _refine(score, factor, axis)
        return score

    def _compete(self) -> tuple[Codes, Scores, Scores]:
        shape = tuple((count - 1) * factor + 1 for count, factor in zip(self.codes.shape, self.factor, strict=True))
        label = np.full(shape, self.present[0], np.int16)
        best = np.full(shape, -1.0, np.float32)
        second = np.full(shape, -1.0, np.float32)
        for code in self.present:
            score = self._score(code)
            wins = score > best
            second = np.where(wins, best, np.maximum(second, score))
            label[wins] = code
            best = np.maximum(best, score)
        return label, best, second

    def _wrong(self) -> Bools:
        """Samples that another label took, and corners of cells where a label won that none of the four has."""
        fx, fy = self.factor
        wrong: Bools = self.label[::fx, ::fy] != self.codes
        corner = [
            np.minimum(np.arange(size) // factor, count - 2)
            for size, factor, count in zip(self.label.shape, self.factor, self.codes.shape, strict=True)
        ]
        foreign = np.ones(self.label.shape, np.bool_)
        for dx in (0, 1):
            for dy in (0, 1):
                foreign &= self.label != self.codes[np.ix_(corner[0] + dx, corner[1] + dy)]
        if foreign.any():
            i, j = np.nonzero(foreign)
            for dx in (0, 1):
                for dy in (0, 1):
                    wrong[corner[0][i] + dx, corner[1][j] + dy] = True
        return wrong


def _refine(samples: Scores, factor: int, axis: int) -> Scores:
    """Linear interpolation at `factor` points per cell along one axis; the samples themselves are among them."""
    if factor == 1 or samples.shape[axis] == 1:
        return samples
    rows = np.moveaxis(samples, axis, 0)
    fine = np.empty(((len(rows) - 1) * factor + 1, *rows.shape[1:]), np.float32)
    for step in range(factor):
        weight = np.float32(step / factor)
        fine[step:-1:factor] = rows[:-1] * (1 - weight) + rows[1:] * weight
    fine[-1] = rows[-1]
    refined: Scores = np.moveaxis(fine, 0, axis)
    return refined


# --- labels on the map


class _Place(NamedTuple):
    """Where a text goes: centre in raster pixels, and how it is set."""

    x: float
    y: float
    size: float
    angle: float


# What is tried in turn: size in points, and whether the text may be turned.
_SETTINGS = ((10.5, False), (9.5, False), (9.5, True), (8.5, False), (8.5, True), (8.0, False), (8.0, True))
_ANGLES = tuple(angle for step in range(1, 10) for angle in (10.0 * step, -10.0 * step))[:-1]
_LEADER_SIZE = 8.5
_PIXEL = 2.0  # display pixels per raster pixel; finer would only be slower
_SMALLEST_LEADER = 2e-4  # of the map's area: a smaller region is only noted, a leader would point at nothing
_SMALLEST_REPEAT = 1e-3  # of the map's area: a further region of a label that has its text already
_MOST_PARTS = 4  # regions of one label that are looked at, the largest first
_MOST_NOTES = 24


@dataclass
class _Raster:
    """The map as pixels of its axes on the page, rows upwards, where it is seen what room a text has."""

    ax: Axes
    label: Codes  # (height, width)
    taken: Bools = field(init=False)

    def __post_init__(self) -> None:
        self.taken = np.zeros(self.label.shape, np.bool_)

    @classmethod
    def blank(cls, ax: Axes) -> _Raster:
        box = ax.get_window_extent()
        return cls(ax, np.zeros((int(box.height / _PIXEL), int(box.width / _PIXEL)), np.int16))

    @classmethod
    def of(cls, ax: Axes, regions: _Regions, view: _View) -> _Raster:
        """The labels as they are drawn."""
        box = ax.get_window_extent()
        width, height = int(box.width / _PIXEL), int(box.height / _PIXEL)
        across = box.x0 + (np.arange(width) + 0.5) * _PIXEL
        upward = box.y0 + (np.arange(height) + 0.5) * _PIXEL
        inverse = ax.transData.inverted()
        x = inverse.transform(np.column_stack((across, np.full(width, box.y0))))[:, 0]
        y = inverse.transform(np.column_stack((np.full(height, box.x0), upward)))[:, 1]
        columns = _fine_index(x, view.x.values, regions.factor[0])
        rows = _fine_index(y, view.y.values, regions.factor[1])
        return cls(ax, regions.label[np.ix_(columns, rows)].T)

    @classmethod
    def of_strip(cls, ax: Axes, codes: Codes, edges: Floats) -> _Raster:
        """The labels along one axis, which change halfway between samples."""
        blank = cls.blank(ax)
        height, width = blank.label.shape
        x = np.array([blank.data(column + 0.5, 0.0)[0] for column in range(width)])
        cell = np.clip(np.searchsorted(edges, x) - 1, 0, len(codes) - 1)
        return cls(ax, np.broadcast_to(codes[cell], (height, width)))

    def data(self, x: float, y: float) -> tuple[float, float]:
        """Data coordinates of a raster position."""
        box = self.ax.get_window_extent()
        point = self.ax.transData.inverted().transform((box.x0 + x * _PIXEL, box.y0 + y * _PIXEL))
        return float(point[0]), float(point[1])

    def measure(self, text: str, size: float) -> tuple[int, int]:
        """Width and height in raster pixels that a text takes, with room around it."""
        figure = self.ax.get_figure(root=True)
        assert figure is not None
        drawn = Text(0, 0, text, fontsize=size, parse_math=False, figure=figure)
        box = drawn.get_window_extent(figure.canvas.get_renderer())  # type: ignore[attr-defined]
        room = 0.22 * size * figure.dpi / 72.0
        return math.ceil((box.width + 2 * room) / _PIXEL), math.ceil((box.height + 2 * room) / _PIXEL)

    def take(self, text: str, place: _Place) -> None:
        """Mark a text's rectangle as taken."""
        width, height = self.measure(text, place.size)
        rows, columns = np.indices(self.label.shape)
        u, v = _turn(columns + 0.5 - place.x, rows + 0.5 - place.y, -place.angle)
        self.taken |= (np.abs(u) <= 0.5 * width) & (np.abs(v) <= 0.5 * height)


def _fine_index(values: Floats, samples: Floats, factor: int) -> npt.NDArray[np.intp]:
    to, _ = _ruler(samples)
    index = np.interp(to(np.clip(values, samples[0], samples[-1])), to(samples), np.arange(len(samples)))
    fine: npt.NDArray[np.intp] = np.rint(index * factor).astype(np.intp)
    return fine


def _turn(x: Any, y: Any, degrees: float) -> tuple[Any, Any]:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return c * x - s * y, s * x + c * y


def _label_and_note(
    figure: Figure, ax: Axes, labels: tuple[str, ...], codes: Codes, look: Callable[[], _Raster], *, leaders: bool
) -> None:
    """Write the labels into their regions, and under the axes those that find no room, with the failed cells.

    The notes take height from the map, and less of it then fits: laid out again until the notes are the same.
    """
    palette = _palette(labels)

    def note(names: list[str]) -> None:
        notes = []
        for label in names[:_MOST_NOTES]:
            cells = int(np.count_nonzero(codes == labels.index(label)))
            notes.append(
                Patch(facecolor=palette[label], edgecolor=_INK, linewidth=0.6, label=f"{label}: {_cells(cells)}")
            )
        if len(names) > _MOST_NOTES:
            notes.append(Patch(alpha=0.0, label=f"and {len(names) - _MOST_NOTES} labels more"))
        _note(figure, notes + _failed_notes(codes))

    noted: set[str] = set()
    unlabelled: list[str] = []
    for _ in range(4):
        note([label for label in labels if label in noted])
        _freeze_layout(figure, ax)
        for artist in [*ax.texts, *(line for line in ax.lines if line.get_gid() == "leader")]:
            artist.remove()
        unlabelled = _label_regions(look(), labels, leaders=leaders)
        if noted.issuperset(unlabelled):
            break
        noted.update(unlabelled)
    if noted != set(unlabelled):  # a label that found room in the end; the row keeps its height
        note(unlabelled)


def _label_regions(raster: _Raster, labels: tuple[str, ...], *, leaders: bool) -> list[str]:
    """Write each label into its region; returns, in order, those that found no room."""
    pointed: list[tuple[str, Bools]] = []
    written: set[str] = set()
    for code, text in enumerate(labels):
        parts, count = ndimage.label(raster.label == code)
        areas = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        for rank, part in enumerate(np.argsort(-areas, kind="stable")[:_MOST_PARTS] + 1):
            share = areas[part - 1] / parts.size
            if rank and share < _SMALLEST_REPEAT:
                break
            mask = parts == part
            place = _inside(raster, mask, text)
            if place is not None:
                _write(raster, text, place)
                written.add(text)
            elif leaders and share >= _SMALLEST_LEADER:
                pointed.append((text, mask))
    small = np.zeros(raster.label.shape, np.bool_)
    for _, mask in pointed:
        small |= mask
    for text, mask in pointed:
        if _point_at(raster, mask, text, small & ~mask):
            written.add(text)
    return [label for label in labels if label not in written]


def _inside(raster: _Raster, mask: Bools, text: str) -> _Place | None:
    """The roomiest place for a text wholly inside a region, as large and as level as it can be."""
    rows, columns = ndimage.find_objects(mask.astype(np.int8))[0]
    crop = np.pad(mask[rows, columns], 1)
    x0, y0 = columns.start - 1, rows.start - 1
    for size, turned in _SETTINGS:
        width, height = raster.measure(text, size)
        best: tuple[float, _Place] | None = None
        for angle in _ANGLES if turned else (0.0,):
            found = _roomiest(crop, width, height, angle)
            if found is not None:
                room, x, y = found
                score = room - 0.03 * abs(angle)  # a steeper text must be worth it
                if best is None or score > best[0]:
                    best = score, _Place(x0 + x, y0 + y, size, angle)
        if best is not None:
            return best[1]
    return None


def _roomiest(mask: Bools, width: int, height: int, angle: float) -> tuple[float, float, float] | None:
    """(room, x, y): the centre of a turned rectangle inside a mask that may be moved furthest in any direction."""
    if angle == 0.0:
        turned = mask
    else:
        reach = math.hypot(*mask.shape) / 2
        count = 2 * math.ceil(reach)
        v, u = np.indices((count, count)) + 0.5 - count / 2
        x, y = _turn(u, v, angle)
        column = np.floor(x + mask.shape[1] / 2).astype(np.intp)
        row = np.floor(y + mask.shape[0] / 2).astype(np.intp)
        within = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
        turned = np.zeros((count, count), np.bool_)
        turned[within] = mask[row[within], column[within]]
    fits = _fits(turned, width, height)
    if not fits.any():
        return None
    room = ndimage.distance_transform_edt(np.pad(fits, 1))[1:-1, 1:-1]
    # Of many places as good, as along a band, the one nearest the region's middle.
    middle = ndimage.center_of_mass(turned)
    rows, columns = np.nonzero(room >= 0.93 * room.max())
    nearest = np.argmin(np.hypot(rows + 0.5 * height - middle[0] - 0.5, columns + 0.5 * width - middle[1] - 0.5))
    row, column = rows[nearest], columns[nearest]
    u, v = column + 0.5 * width, row + 0.5 * height  # from the rectangle's corner to its centre
    x, y = _turn(u - turned.shape[1] / 2, v - turned.shape[0] / 2, angle)
    return float(room.max()), float(x + mask.shape[1] / 2), float(y + mask.shape[0] / 2)


def _fits(mask: Bools, width: int, height: int) -> Bools:
    """Where the lower left corner of a rectangle may be so that all of it is in the mask."""
    rows, columns = mask.shape[0] - height + 1, mask.shape[1] - width + 1
    if rows < 1 or columns < 1:
        return np.zeros((1, 1), np.bool_)
    total = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int64)
    np.cumsum(np.cumsum(mask, axis=0), axis=1, out=total[1:, 1:])
    inside = total[height:, width:] - total[:-height, width:] - total[height:, :-width] + total[:-height, :-width]
    fits: Bools = inside == width * height
    return fits


def _write(raster: _Raster, text: str, place: _Place) -> None:
    x, y = raster.data(place.x, place.y)
    raster.ax.text(
        x,
        y,
        text,
        fontsize=place.size,
        rotation=place.angle,
        ha="center",
        va="center",
        parse_math=False,
        clip_on=False,
        zorder=5,
    )
    raster.take(text, place)


def _point_at(raster: _Raster, mask: Bools, text: str, avoid: Bools) -> bool:
    """Write a label beside a region too small for it, in the nearest free room, with a line to the region.

    avoid : other regions that are pointed at, which the line must not cross
    """
    blocked = raster.taken | ndimage.binary_dilation(avoid)
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    anchor = np.array([column + 0.5, row + 0.5])
    # Free is what no text has taken and no boundary crosses.
    label = raster.label
    border = np.zeros(label.shape, np.bool_)
    border[1:] |= label[1:] != label[:-1]
    border[:, 1:] |= label[:, 1:] != label[:, :-1]
    free = ~(ndimage.binary_dilation(border) | raster.taken | mask)
    width, height = raster.measure(text, _LEADER_SIZE)
    rows, columns = np.nonzero(_fits(free, width, height))
    if not rows.size:
        return False
    centres = np.column_stack((columns + 0.5 * width, rows + 0.5 * height))
    # A line from the side of a text reads better than one from above or below, and needs a little length to be seen.
    gap = np.maximum(np.abs(centres - anchor) - 0.5 * np.array([width, height]), 0.0)
    distance = np.hypot(*gap.T)
    distance[distance < 6.0] += 40.0
    for index in np.argsort(distance, kind="stable")[:4000:20]:
        centre = centres[index]
        line = anchor + np.linspace(0.0, 1.0, 200)[:, None] * (centre - anchor)
        column_, row_ = np.floor(line.T).astype(np.intp)
        if blocked[row_, column_].any():
            continue
        raster.ax.annotate(
            text,
            xy=raster.data(*anchor),
            xytext=raster.data(*centre),
            fontsize=_LEADER_SIZE,
            ha="center",
            va="center",
            parse_math=False,
            zorder=5,
            arrowprops={"arrowstyle": "-", "color": _INK, "linewidth": 0.8, "shrinkA": 0.0, "shrinkB": 0.0},
        )
        raster.ax.plot(*raster.data(*anchor), "o", color=_INK, markersize=2.6, zorder=5, gid="leader")
        raster.take(text, _Place(float(centre[0]), float(centre[1]), _LEADER_SIZE, 0.0))
        raster.taken[row_, column_] = True
        return True
    return False


# --- colours


def _palette(labels: tuple[str, ...]) -> dict[str, str]:
    """A light tint for every label: the hue tells the number of double-sided impacts, the depth what follows them."""
    families: dict[int, list[str]] = {}
    for label in labels:
        families.setdefault(_double_sided(label), []).append(label)
    palette: dict[str, str] = {}
    for double_sided, members in families.items():
        hue = np.array(colors.to_rgb(_HUES[double_sided % len(_HUES)]))
        impacts = sorted((label for label in members if label != "NI"), key=lambda label: (_excursions(label), label))
        # Three depths at least, so that a family of one or two is light and the same label looks alike across maps.
        depths = np.linspace(*_TINTS, max(3, len(impacts)))
        for label, depth in zip(impacts, depths, strict=False):
            palette[label] = colors.to_hex(1.0 - depth * (1.0 - hue))
    if "NI" in labels:
        palette["NI"] = _NO_IMPACT
    return palette


def _double_sided(label: str) -> int:
    return sum(int(count) for count in re.findall(r"DS\((\d+)\)", label))


def _excursions(label: str) -> int:
    return sum(int(count) for count in re.findall(r"\((\d+)\)", label))


def _norm(values: Floats, *, whole: bool) -> colors.Normalize:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if whole and high - low <= 12:  # one colour per number
        return colors.BoundaryNorm(np.arange(low - 0.5, high + 1.0), 256)
    if low >= 0.0:
        low = 0.0
    return colors.Normalize(low, high if high > low else low + 1.0)


# --- parts of a figure


@contextmanager
def _styled() -> Iterator[None]:
    """The house's look, whatever a user's matplotlibrc says."""
    with style.context(["default", _STYLE]):
        yield


def _figure() -> Figure:
    figure = Figure(figsize=_SIZE, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _titles(figure: Figure, ax: Axes, results: Results, view: _View, more: str = "") -> None:
    title = textwrap.fill(results.title, 78) or "Impact regimes"
    figure.suptitle(title, fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
    fixed = "; ".join(f"{axis.name} = {axis.values[0]:g} {axis.unit.removeprefix('1')}".rstrip() for axis in view.fixed)
    line = "; ".join(part for part in (_load(results), fixed, more) if part)
    ax.set_title(line, loc="left", fontsize=9.0, color=_FAINT_INK, parse_math=False)


def _load(results: Results) -> str:
    """What the load is, in words: an ideal step is a worst case, and a reader should know."""
    try:
        profile = tomllib.loads(results.config)["load"]["profile"]
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return ""
    return "ideal torque step (tip-out)" if profile == "tip-out" else f"load: {profile}"


def _freeze_layout(figure: Figure, ax: Axes) -> None:
    """Settle where everything is, so that labels can be fitted to it."""
    figure.set_layout_engine("constrained")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    title = figure._suptitle  # type: ignore[attr-defined]
    if title is not None:
        title.set_x(ax.get_position().x0)


def _scale_axes(ax: Axes, view: _View) -> None:
    _scale_axis(ax, "x", view.x)
    _scale_axis(ax, "y", view.y)
    ax.set_xlim(view.x.values[0], view.x.values[-1])
    ax.set_ylim(view.y.values[0], view.y.values[-1])
    ax.tick_params(direction="out")


def _scale_axis(ax: Axes, which: str, axis: ResultAxis) -> None:
    label = _axis_label(axis)
    if which == "x":
        ax.set_xlabel(label)
    else:
        ax.set_ylabel(label)
    line = ax.xaxis if which == "x" else ax.yaxis
    if not _is_geometric(axis.values):
        line.set_major_locator(ticker.MaxNLocator(10, steps=[1, 2, 5, 10]))
    else:
        (ax.set_xscale if which == "x" else ax.set_yscale)("log")
        # Plain numbers, and some of them between the powers of ten, which a short axis has few of.
        decades = math.log10(axis.values[-1] / axis.values[0])
        line.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0) if decades < 3 else (1.0,)))
        line.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))
        line.set_minor_formatter(ticker.NullFormatter())


def _axis_label(axis: ResultAxis) -> str:
    name = axis.name or axis.parameter
    unit = "" if axis.unit in ("", "1") else f"[{axis.unit}]"
    return " ".join(part for part in (_plain(name[:1].upper() + name[1:]), _symbol(axis.symbol), _plain(unit)) if part)


def _quantity_label(name: str) -> str:
    if name not in _QUANTITY:
        raise PlotError(f"There is no quantity {name!r} to draw; there are {', '.join(_QUANTITY)}.")
    title, symbol, unit = _QUANTITY[name]
    return " ".join(part for part in (title, symbol, f"[{unit}]" if unit else "") if part)


def _plain(text: str) -> str:
    """Text in which a dollar sign is a dollar sign."""
    return text.replace("$", r"\$")


def _symbol(symbol: str) -> str:
    """σr as σ with the subscript r, Td/Ts likewise."""
    return re.sub(r"(?<!\w)([^\W\d_])([^\W\d_]|\d{1,2})(?!\w)", r"\1$_\\mathregular{\2}$", _plain(symbol))


def _hatch(ax: Axes, x: Floats, y: Floats, margin: Array) -> None:
    filled = ax.contourf(x, y, margin, levels=[0.0, np.inf], colors=[_FAILED_FILL], hatches=["//////"], zorder=1)
    filled.set_edgecolor(_FAILED_HATCH)
    filled.set_linewidth(0.0)


def _boundaries(ax: Axes, x: Floats, y: Floats, regions: _Regions, **look: Any) -> None:
    if len(regions.present) == 1:
        return
    linewidth = look.pop("linewidth")
    for code in regions.present:
        margin = regions.margin(code).T
        if margin.min() < 0.0 < margin.max():
            ax.contour(x, y, margin, levels=[0.0], colors=[look["color"]], linewidths=linewidth, zorder=3)


def _failed_notes(codes: Codes) -> list[Patch]:
    failed = int(np.count_nonzero(codes == FAILED_CODE))
    if not failed:
        return []
    look: dict[str, Any] = {"facecolor": _FAILED_FILL, "edgecolor": _FAILED_HATCH, "hatch": "//////", "linewidth": 0.6}
    return [Patch(label=f"{FAILED}: {_cells(failed)}", **look)]


def _cells(count: int) -> str:
    return f"{count} cell{'' if count == 1 else 's'}"


def _note(figure: Figure, handles: list[Patch]) -> None:
    """A row of swatches under the axes, in place of one that is there."""
    for old in list(figure.legends):
        old.remove()
    if handles:
        widest = max(len(str(handle.get_label())) for handle in handles)
        columns = max(1, int((_SIZE[0] - 0.4) / (0.45 + 0.075 * widest)))  # inches: a swatch, a character
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False, handlelength=1.6)


def _mark_thresholds(ax: Axes, thresholds: Sequence[float]) -> None:
    """Triangles where the number of impacts for vanishing backlash changes, with their values above the map."""
    low, high = ax.get_xlim()
    inside = [value for value in thresholds if low <= value <= high]
    if not inside:
        return
    along = ax.get_xaxis_transform()
    ax.plot(inside, [0.0] * len(inside), "^", color=_INK, markersize=5.5, transform=along, clip_on=False, zorder=6)
    top = ax.secondary_xaxis("top")
    top.set_xticks(inside, [f"{value:.2f}" for value in inside])
    top.tick_params(direction="out", length=3.0, labelsize=8.5)
    top.minorticks_off()
    top.set_xlabel("▲ thresholds for vanishing backlash", loc="right", fontsize=8.5, color=_FAINT_INK, labelpad=3.0)


def _finish_bar(bar: Colorbar, label: str, *, whole: bool) -> None:
    bar.set_label(label)
    bar.outline.set_linewidth(0.6)
    if isinstance(bar.norm, colors.BoundaryNorm):
        bar.set_ticks(0.5 * (bar.norm.boundaries[1:] + bar.norm.boundaries[:-1]))
        bar.ax.yaxis.set_major_formatter(ticker.StrMethodFormatter("{x:.0f}"))
        bar.ax.tick_params(length=0.0)
        bar.minorticks_off()
    elif whole:
        bar.locator = ticker.MaxNLocator(integer=True)
        bar.update_ticks()


def _draw_ridge(ax: Axes, view: _View, ridge: Floats) -> None:
    """The ridge as a line, broken where it leaves the map or jumps from one hill to another."""
    known = np.isfinite(ridge)
    y = np.where(known, view.y.values[np.where(known, ridge, 0).astype(np.intp)], np.nan)
    jump = np.abs(np.diff(ridge)) > max(3.0, 0.05 * len(view.y.values))
    x = np.insert(view.x.values, np.flatnonzero(jump) + 1, np.nan)
    y = np.insert(y, np.flatnonzero(jump) + 1, np.nan)
    outline = [patheffects.Stroke(linewidth=2.8, foreground=_INK), patheffects.Normal()]
    line = Line2D(x, y, color="white", linewidth=1.4, path_effects=outline, zorder=4, gid="ridge", label="ridge")
    ax.add_line(line)


def _label_ridge(ax: Axes, view: _View, ridge: Floats) -> None:
    """Name the ridge beside its middle, off the line itself."""
    raster = _Raster.blank(ax)
    known = np.flatnonzero(np.isfinite(ridge))
    points = np.column_stack((view.x.values[known], view.y.values[ridge[known].astype(np.intp)]))
    box = ax.get_window_extent()
    across, upward = (ax.transData.transform(points) - [box.x0, box.y0]).T / _PIXEL
    height, width = raster.taken.shape
    for start, stop in pairwise(range(len(known))):
        steps = np.linspace(0.0, 1.0, 60)
        column = (across[start] + steps * (across[stop] - across[start])).astype(np.intp)
        row = (upward[start] + steps * (upward[stop] - upward[start])).astype(np.intp)
        raster.taken[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] = True
    clear = ndimage.distance_transform_edt(~raster.taken) > 3.0
    symbol = view.x.symbol.split("=")[0].strip() or view.x.name
    text = f"largest Q for each {symbol}"
    columns_needed, rows_needed = raster.measure(text, 9.0)
    rows, columns = np.nonzero(_fits(clear, columns_needed, rows_needed))
    if not rows.size:
        return
    centres = np.column_stack((columns + 0.5 * columns_needed, rows + 0.5 * rows_needed))
    middle = len(known) // 2
    nearest = centres[np.argmin(np.hypot(*(centres - [across[middle], upward[middle]]).T))]
    ax.text(
        *raster.data(*nearest),
        f"largest Q for each {_symbol(symbol)}",
        fontsize=9.0,
        color="white",
        ha="center",
        va="center",
        zorder=5,
        path_effects=[patheffects.Stroke(linewidth=2.2, foreground=_INK), patheffects.Normal()],
    )
