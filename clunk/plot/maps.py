"""The figure of a plane: regions or a quantity over two axes, with lines, marks and names; one map or several."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colors, ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from clunk.analysis.ridge import ridge_of
from clunk.plot.labelling import SIZES, SMALL_SIZES, Raster, write_beside, write_names
from clunk.plot.layers import Layers, stacked
from clunk.plot.plane import cells_of, scale_axes, spaced_numbers
from clunk.plot.style import (
    CENTRED,
    FAILED_LOOK,
    FAINT_INK,
    HUES,
    INK,
    MOST_POINTS,
    SIZE,
    UNDEFINED,
    append_notes,
    bare,
    cells_phrase,
    freeze_layout,
    halo,
    new_figure,
    remark,
    set_titles,
    styled,
    swatch,
    symbol_text,
)
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import NUMBER, TEXT, WHOLE, YES_NO

POINT = 6.5  # points, diameter of a measured point
AGREES, DIFFERS = INK, "#b23500"
POINT_LOOKS: dict[bool, dict[str, Any]] = {  # of points that agree, and that do not
    True: {"marker": "o", "markersize": POINT, "markerfacecolor": AGREES, "markeredgecolor": "white"},
    False: {"marker": "$\\otimes$", "markersize": POINT + 2.0, "markerfacecolor": DIFFERS, "markeredgecolor": "none"},
}
_POINT_TEXT = 8.0, 6.5  # points, of a map and of a panel of several
_MOST_NOTES = 24
_DOUBT: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": INK, "alpha": 0.45, "markeredgewidth": 0.0}
_MAP = 330.0  # points, width of a map
_STRIP_DOT = 0.12  # of a strip's height: undecided cells are marked under their labels
_MOST_COLOURS = 12  # of whole numbers, each in a colour of its own
_PROBABLE = colors.LinearSegmentedColormap.from_list("probable", ["#f6f5f1", HUES[1]])
_WITH_THRESHOLDS = ("load.ratio", "load.initial_torque", "load.final_torque")
_VANISHING = 0.02  # of the backlash axis, within which it has to begin at zero to show where backlash vanishes
_NARROWEST, _HIGHEST = 2.0, 2.2  # inches, of a panel of several
_AROUND = (0.9, 1.3)  # inches, for their axes and titles
_WITHOUT_RIDGE = ("margin", "last_event_time")
_LONG = 0.5  # of the x axis, that a ridge without gaps and jumps has at least


class Colours(NamedTuple):
    """Colours of a quantity, and the name and ticks of its colour bar."""

    label: str
    norm: colors.Normalize
    cmap: str | colors.Colormap = "viridis"
    formatter: ticker.Formatter | None = None
    locator: ticker.Locator | None = None

    @classmethod
    def of(cls, layers: Layers) -> Colours:
        """Colours of a quantity's values; the margin's diverge from zero, a probability's begin at white."""
        assert layers.values is not None
        quantity, label = layers.quantity, layers.value_label
        low, high = float(np.nanmin(layers.values)), float(np.nanmax(layers.values))
        if quantity.type == YES_NO:
            return cls(label, colors.Normalize(0.0, 1.0), _PROBABLE, ticker.PercentFormatter(1.0, symbol=" %"))
        if quantity.name == "margin":
            return cls(label, colors.CenteredNorm(0.0, max(abs(low), abs(high)) or 1.0), "PuOr")
        if quantity.type == WHOLE and high - low <= _MOST_COLOURS:
            return cls(label, colors.BoundaryNorm(np.arange(low - 0.5, high + 1.0), 256))
        low = min(low, 0.0)
        norm = colors.Normalize(low, high if high > low else low + 1.0)
        return cls(label, norm, locator=ticker.MaxNLocator(integer=True) if quantity.type == WHOLE else None)

    def add_bar(self, figure: Figure | SubFigure, axes: Axes | Sequence[Axes], aspect: float = 28) -> None:
        """Draw the colour bar beside the axes."""
        shades = ScalarMappable(self.norm, self.cmap)
        bar = figure.colorbar(shades, ax=axes, pad=0.02, aspect=aspect, ticks=self.locator, format=self.formatter)
        bar.set_label(self.label)
        bar.outline.set_linewidth(0.6)
        if isinstance(bar.norm, colors.BoundaryNorm):
            bar.set_ticks(0.5 * (bar.norm.boundaries[1:] + bar.norm.boundaries[:-1]))
            bar.ax.yaxis.set_major_formatter(ticker.StrMethodFormatter("{x:.0f}"))
            bar.ax.tick_params(length=0.0)
            bar.minorticks_off()


def new_plot(layers: Layers, *facts: str) -> tuple[Figure, Axes]:
    """A figure with titles and empty axes; the facts go under the title."""
    figure = new_figure()
    ax = figure.add_subplot()
    set_titles(figure, ax, layers.title, layers.subtitle(*facts))
    return figure, ax


@styled()
def plane_map(layers: Layers, thresholds: Sequence[float] = ()) -> Figure:
    """A map over two axes: each region with its name inside (Figure 3.4), or a quantity as colour (Figure 3.7).

    Of how hard impacts are there is also the ridge: the backlash at which it is worst for each load ratio.

    thresholds : values of the x axis at which the number of impacts for vanishing backlash changes (report §3.2),
        marked where x is the load ratio or a load torque and y the backlash from zero on
    """
    figure, ax = new_plot(layers)
    scale_axes(ax, layers.view)
    colours = Colours.of(layers) if layers.shaded else None
    if colours is not None:
        colours.add_bar(figure, ax)
    elif layers.quantity.type == TEXT or layers.quantity.of_label("NI") is not None:
        _mark_thresholds(ax, layers, thresholds)
    freeze_layout(figure, ax)
    paint(ax, layers, colours)
    unnamed = write_on_map(ax, layers)
    if colours is not None and layers.quantity.type == NUMBER and layers.quantity.name not in _WITHOUT_RIDGE:
        _draw_ridge(ax, layers)
    append_notes(figure, [*notes_of(layers, unnamed), *_missing_labels([ax], [layers])])
    return figure


def paint(ax: Axes, layers: Layers, colours: Colours | None = None, *, linewidth: float = 0.9) -> None:
    """Fill the regions, or the cells with a quantity's colours, and draw lines and marks."""
    if colours is None and layers.paint is None and layers.boundaries is not None:
        for code, colour in enumerate(layers.colours):
            _fill(ax, layers, code, facecolor=colour, edgecolor=colour)
    else:
        _show_cells(ax, layers, colours)
    if layers.failed.any():
        _hatch_failed(ax, layers)
    light = colours is not None and layers.has_light_lines
    look: dict[str, Any] = {"colors": "white" if light else INK, "linewidths": linewidth * (0.65 if colours else 1.0)}
    lines = LineCollection(layers.lines, joinstyle="round", capstyle="projecting", gid="boundaries", zorder=3, **look)
    ax.add_collection(lines, autolim=False)
    mark_doubts(ax, layers)


def _fill(ax: Axes, layers: Layers, code: int, **look: Any) -> None:
    """Fill all traced regions with a code; the thin edge closes the seam between two of them."""
    rings = [ring for region, rings in layers.outlines if region == code for ring in rings]
    if rings:
        path = Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))
        ax.add_artist(
            PathPatch(path, zorder=1, gid=f"region {(*layers.names, FAILED)[code]}", **{"linewidth": 0.3} | look)
        )


def _show_cells(ax: Axes, layers: Layers, colours: Colours | None) -> None:
    """Draw the cells as they are, each in its colour, as an image with the pixels of a layout that is frozen."""
    box = ax.get_window_extent()
    across, upward = (np.linspace(0.0, 1.0, 2 * round(side) + 1)[1::2] for side in (box.width, box.height))
    to_data = (ax.transAxes - ax.transData).transform
    x = to_data(np.column_stack([across, np.zeros(across.size)]))[:, 0]
    y = to_data(np.column_stack([np.zeros(upward.size), upward]))[:, 1]
    columns, rows = (cells_of(axis, at) for axis, at in zip(layers.view.axes, (x, y), strict=True))
    if colours is None:
        cells = layers.region_colours.astype(np.uint8) if layers.paint is None else layers.paint
    else:
        assert layers.values is not None
        shades = ScalarMappable(colours.norm, colours.cmap)
        cells = np.asarray(shades.to_rgba(layers.values, bytes=True))[..., :3]
        cells[np.isnan(layers.values)] = list(bytes.fromhex(UNDEFINED[1:]))
    place: dict[str, Any] = {"extent": (0.0, 1.0, 0.0, 1.0), "transform": ax.transAxes, "aspect": "auto"}
    image = np.ascontiguousarray(np.swapaxes(cells[np.ix_(columns, rows)], 0, 1))
    ax.imshow(image, origin="lower", interpolation="none", zorder=0.5, gid="cells", **place)


def _hatch_failed(ax: Axes, layers: Layers) -> None:
    """Hatch the failed cells."""
    if layers.boundaries is not None and layers.paint is None:
        _fill(ax, layers, FAILED_CODE, **FAILED_LOOK)
        return
    x, y = layers.edges
    i, j = np.nonzero(layers.failed)
    corners = np.stack(
        [np.column_stack([x[i + di], y[j + dj]]) for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))], 1
    )
    path = Path.make_compound_path(*(Path(cell, closed=True) for cell in corners))
    ax.add_artist(PathPatch(path, linewidth=0.0, zorder=1, gid="failed", **FAILED_LOOK))


def mark_doubts(ax: Axes, layers: Layers) -> None:
    """Put a quiet dot on every undecided cell of a map, or under that of a strip, and where tracing left it open."""
    doubts = layers.doubts
    if not len(doubts):
        return
    is_map = doubts.shape[1] > 1
    upward = doubts[:, 1] if is_map else np.full(len(doubts), _STRIP_DOT)
    size = float(np.clip(0.5 * _MAP / max(layers.codes.shape), 1.2, 2.6))
    look: dict[str, Any] = _DOUBT | {"markersize": size, "zorder": 4, "rasterized": len(upward) > MOST_POINTS}
    look["transform"] = ax.transData if is_map else ax.get_xaxis_transform()
    ax.plot(doubts[:, 0], upward, gid="undecided", **look)


def write_on_map(ax: Axes, layers: Layers, *, small: bool = False) -> list[str]:
    """Draw the measured points with their labels, then write the regions' names; returns those without room.

    small : in a panel of several
    """
    if layers.shaded:
        return []
    raster = Raster.of(ax, layers)
    if layers.points:
        _draw_points(raster, layers, _POINT_TEXT[small])
    look: dict[str, Any] = {} if layers.paint is None else {"path_effects": halo()}
    return write_names(raster, layers.names, SMALL_SIZES if small else SIZES, **look)


def _draw_points(raster: Raster, layers: Layers, size: float) -> None:
    """Draw the measured points, and their labels where there is room."""
    places = np.array([(point.x, point.y) for point in layers.points])
    for point, (x, y) in zip(layers.points, places.tolist(), strict=True):
        look: dict[str, Any] = {"linestyle": "none", "clip_on": False, "zorder": 6}
        if not point.agrees:
            raster.ax.plot([x], [y], marker="o", color="white", markersize=POINT + 1.0, **look)
        raster.ax.plot([x], [y], gid="agrees" if point.agrees else "differs", **POINT_LOOKS[point.agrees], **look)
    before = len(raster.ax.texts)
    without = write_beside(raster, places, [point.label for point in layers.points], size, 0.5 * POINT + 1.5)
    written = [point for k, point in enumerate(layers.points) if k not in without]
    for text, point in zip(raster.ax.texts[before:], written, strict=True):
        text.set_color(AGREES if point.agrees else DIFFERS)


def _missing_labels(axes: Sequence[Axes], panels: Sequence[Layers]) -> list[Artist]:
    """A note where measured labels found no room beside their points."""
    written = sum(text.get_gid() == "measured" for ax in axes for text in ax.texts)
    missing = sum(len(layers.points) for layers in panels) > written
    return [remark("a point without a label: no room")] if missing else []


def notes_of(layers: Layers, names: Sequence[str] = (), *, counted: bool = True) -> list[Artist]:
    """Notes under a map: these names of regions with their colours, marks of cells, and further notes."""
    seen = [name for name in layers.names if name in names and name in layers.seen]
    notes: list[Artist] = [swatch(*layers.note(name, counted=counted)) for name in seen[:_MOST_NOTES]]
    if len(seen) > _MOST_NOTES:
        notes.append(remark(f"and {len(seen) - _MOST_NOTES} more"))
    if layers.failed.any():
        text = f"{FAILED}: {cells_phrase(int(np.count_nonzero(layers.failed)))}"
        notes.append(swatch(text, "none", **FAILED_LOOK))
    if layers.shaded and layers.values is not None and (np.isnan(layers.values) & ~layers.failed).any():
        text = "not known" if layers.quantity.name == "margin" else "not defined (no events)"
        notes.append(swatch(text, UNDEFINED))
    if layers.points:
        total, agreeing = len(layers.points), sum(point.agrees for point in layers.points)
        agrees = f"measured, agrees: {agreeing} of {total}" if counted else "measured, agrees"
        for agree, text in ((True, agrees), (False, "measured, differs")):
            notes.append(Line2D([], [], linestyle="none", label=text, **POINT_LOOKS[agree]))
    if layers.doubts_text:
        notes.append(Line2D([], [], **_DOUBT, markersize=3.0, label=layers.doubts_text))
    return [*notes, *(swatch(*note) if note.colour else remark(note.text) for note in layers.notes)]


@styled()
def several_maps(panels: Sequence[Layers], names: Sequence[Sequence[str]], line: str) -> Figure:
    """Maps over the same axes with the same colours, side by side.

    names : of the panels, one after the other; or of rows, and then of columns
    line : under the title
    """
    together = stacked(panels)
    rows, columns, size = grid_of([len(each) for each in names])
    figure = new_figure(size)
    figure.suptitle(together.title, fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
    inner = figure.add_subfigure(figure.add_gridspec(1, 1)[0])  # for a second title, and names of the axes
    grid = inner.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax in grid.flat[len(panels) :]:
        ax.remove()
    colours = Colours.of(together) if together.shaded else None
    axes = list(grid.flat[: len(panels)])
    for ax, layers in zip(axes, panels, strict=True):
        scale_axes(ax, layers.view)
        for axis in (ax.xaxis, ax.yaxis):
            if isinstance(locator := axis.get_major_locator(), ticker.MaxNLocator):
                locator.set_params(nbins=5)
        ax.tick_params(labelsize=8.0)
    inner.supxlabel(axes[0].get_xlabel(), fontsize=10.0)
    inner.supylabel(axes[0].get_ylabel(), fontsize=10.0)
    for ax in axes:
        ax.set(xlabel="", ylabel="")
    for ax, name in zip(axes, names[-1], strict=False):
        ax.set_title(name, loc="left", fontsize=9.0)
    for ax, name in zip(grid[:, -1], names[0] if len(names) > 1 else (), strict=False):
        where = {"xytext": (5, 0), "textcoords": "offset points", "rotation": 270.0, "ha": "left", "va": "center"}
        ax.annotate(name, (1.0, 0.5), xycoords="axes fraction", fontsize=9.0, **where)
    for ax in axes[max(0, len(axes) - columns) :]:
        ax.tick_params(labelbottom=True)  # nothing may be drawn under it
    if colours is not None:
        colours.add_bar(inner, axes, aspect=40)
    subtitle = inner.suptitle(line, fontsize=9.0, color=FAINT_INK, ha="left", parse_math=False)
    freeze_layout(figure, axes[0])
    subtitle.set_x(axes[0].get_position().x0)
    for ax, layers in zip(axes, panels, strict=True):
        paint(ax, layers, colours, linewidth=0.6)
        write_on_map(ax, layers, small=True)
    shown = together.seen if colours is None else []
    append_notes(figure, [*notes_of(together, shown, counted=False), *_missing_labels(axes, panels)])
    return figure


def grid_of(counts: Sequence[int]) -> tuple[int, int, tuple[float, float]]:
    """Number of rows and columns of maps side by side, and the figure's size without its notes  [inches].

    counts : of the maps; or of rows and of columns
    """
    columns = counts[-1] if len(counts) > 1 else 2 if counts[0] in (2, 4) else 4 if counts[0] > 9 else min(counts[0], 3)
    rows = counts[0] if len(counts) > 1 else math.ceil(counts[0] / columns)
    panel = max((SIZE[0] - _AROUND[0]) / columns, _NARROWEST)
    return rows, columns, (_AROUND[0] + columns * panel, _AROUND[1] + rows * min(0.85 * panel, _HIGHEST))


def _mark_thresholds(ax: Axes, layers: Layers, thresholds: Sequence[float]) -> None:
    """Triangles where the number of impacts for vanishing backlash changes, with their values above the map."""
    low, high = ax.get_xlim()
    bottom, top = ax.get_ylim()
    inside = sorted(value for value in thresholds if low <= value <= high)
    vanishes = layers.view.y.parameter == "lash.backlash_deg" and bottom <= _VANISHING * top
    if not (inside and vanishes and layers.view.x.parameter in _WITH_THRESHOLDS):
        return
    along = ax.get_xaxis_transform()
    ax.plot(inside, [0.0] * len(inside), "^", color=INK, markersize=5.5, transform=along, clip_on=False, zorder=6)
    above = ax.secondary_xaxis("top")
    above.set_xticks(inside, spaced_numbers(ax, inside))
    above.tick_params(direction="out", length=3.0, labelsize=8.5)
    above.minorticks_off()
    above.set_xlabel("▲ thresholds for vanishing backlash", loc="right", fontsize=8.5, color=FAINT_INK, labelpad=3.0)


def _draw_ridge(ax: Axes, layers: Layers) -> None:
    """Where a quantity is largest for each x: a line, if it goes through much of the map without gap or jump."""
    assert layers.values is not None
    view, ridge = layers.view, ridge_of(layers.values)
    known = np.isfinite(ridge)
    steady = known[1:] & known[:-1] & (np.abs(np.diff(ridge)) <= max(3.0, 0.05 * len(view.y.values)))
    pieces = np.split(np.arange(known.size), np.flatnonzero(~steady) + 1)
    at = max(pieces, key=len)
    to_axes = (ax.transData - ax.transAxes).transform
    points = np.column_stack([view.x.values[at], view.y.values[np.nan_to_num(ridge[at]).astype(np.intp)]])
    if np.ptp(to_axes(points)[:, 0]) < _LONG:
        return
    look: dict[str, Any] = {"color": "white", "linewidth": 1.4, "path_effects": halo(2.8, INK), "zorder": 4}
    ax.add_line(Line2D(*points.T, gid="ridge", label="ridge", **look))
    symbol = bare(view.x.symbol) or view.x.name
    text = f"largest {layers.quantity.symbol or 'value'} for each {symbol_text(symbol)}"
    # The name goes along the line, above its middle.
    middle = len(points) // 2
    pixels = ax.transData.transform(points)
    around = pixels[[max(0, middle - len(points) // 6), min(len(points) - 1, middle + len(points) // 6)]]
    slope = float(np.degrees(np.arctan2(*np.diff(around, axis=0)[0][::-1])))
    place: dict[str, Any] = CENTRED | {"va": "bottom", "rotation": slope, "rotation_mode": "anchor"}
    shift = 5.0 * np.array([-np.sin(np.radians(slope)), np.cos(np.radians(slope))])
    look = {"color": "white", "path_effects": halo(2.2, INK), "zorder": 5, "fontsize": 9.0, "gid": "ridge"}
    ax.annotate(text, points[middle], tuple(shift), textcoords="offset points", **place, **look)
