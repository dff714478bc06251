"""Maps of results: regimes like the report's Figure 3.4, severities like its Figure 3.7, and strips along one axis."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colors, patheffects, ticker
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy import ndimage

from clunk.analysis.ridge import ridge_of
from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.labelling import label_and_note, region_swatch
from clunk.plot.plane import View, cell_edges, scale_axes, scale_axis, value_text
from clunk.plot.raster import Raster, corners_that_fit
from clunk.plot.regions import Bools, Regions, draw_boundaries, fill_regions, hatch_failed, regions_of
from clunk.plot.style import (
    FAILED_FILL,
    FAILED_HATCH,
    FAINT_INK,
    HUES,
    INK,
    MINUS,
    SIZE,
    PlotError,
    cells_phrase,
    failed_notes,
    freeze_layout,
    new_figure,
    palette_of,
    set_notes,
    set_titles,
    styled,
    symbol_text,
    tidy,
)
from clunk.results.labels import FAILED_CODE
from clunk.results.quantities import CELL_QUANTITIES
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.axes import ResultAxis

Floats = npt.NDArray[np.float64]


_DRAWN = [name for name, quantity in CELL_QUANTITIES.items() if quantity.words]
QUANTITIES = ["regimes", *_DRAWN]  # "regimes" is the map of labels
_WHOLE = ("primary_impacts", "touches")

_WITH_THRESHOLDS = ("load.ratio", "load.initial_torque", "load.final_torque")
_LINE = 92  # characters of a subtitle that the width of a figure takes
_UNDEFINED = "#efefec"
_STRIP_DOT = 0.12  # of a strip's height: undecided cells are marked under their labels
_DOT: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": INK, "markeredgewidth": 0.0}
_DIGIT = 0.0114  # width of a threshold's digit over the map's


def regime_map(results: Results, thresholds: Sequence[float] = ()) -> Figure:
    """Which sequence of impacts happens where, each region with its label inside (Figure 3.4).

    thresholds : values of the x axis at which the number of impacts for vanishing backlash changes (Table 3.1), marked
        where x is the load ratio or a load torque and y the backlash; along any other, they might not stay the same

    Raises PlotError unless two axes were swept.
    """
    view = View.of(results, 2)
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        map_titles(figure, ax, results, view)
        scale_axes(ax, view)
        codes = view.arrange(results.sequence)
        regions = regions_of(codes)
        paint_regimes(ax, view, regions, results.labels)
        if view.x.parameter in _WITH_THRESHOLDS and view.y.parameter == "lash.backlash_deg":
            _mark_thresholds(ax, thresholds)
        label_and_note(
            figure,
            ax,
            results.labels,
            codes,
            lambda: Raster.of(ax, regions, view),
            leaders=True,
            more=undecided_notes(mark_undecided(ax, view, results)),
        )
        return figure


def severity_map(results: Results) -> Figure:
    """How severe the impacts are, and at which backlash they are worst for each load ratio (Figure 3.7).

    Raises PlotError unless two axes were swept and Q is defined somewhere.
    """
    return quantity_map(results, "severity")


def quantity_map(results: Results, name: str) -> Figure:
    """A quantity of every cell as colour, under the regimes' boundaries; for the severity also its ridge.

    The margin's colours diverge from zero, where a run is as near to one label as to another. A refined sweep's map has
    the values of the cells that were run, and no ridge.

    Raises PlotError unless two axes were swept, `name` is a quantity and it is defined in some cell.
    """
    quantity_label(name)  # refuses what is none
    view = View.of(results, 2)
    codes = view.arrange(results.sequence)
    values = view.arrange(quantity_values(results, name))
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        map_titles(figure, ax, results, view, boundaries_note(results, name))
        scale_axes(ax, view)
        norm = quantity_norm(values, name)
        mesh = paint_quantity(ax, view, regions_of(codes), values, name, norm, line_colour(results, name))
        bar = figure.colorbar(mesh, ax=ax, pad=0.02, aspect=28)
        finish_bar(bar, name)
        inferred = view.arrange(results.inferred)
        notes = [*failed_notes(codes), *undefined_notes(name, np.isnan(values) & (codes != FAILED_CODE), inferred)]
        has_ridge = name == "severity" and not inferred.any()
        ridge = ridge_of(values) if has_ridge else np.full(len(view.x.values), np.nan)
        if np.isfinite(ridge).any():
            _draw_ridge(ax, view, ridge)
        set_notes(figure, notes)
        freeze_layout(figure, ax)
        if np.isfinite(ridge).any():
            _label_ridge(ax, view, ridge)
        return figure


def strip(results: Results, quantity: str = "severity", more: str = "") -> Figure:
    """Along one swept axis: the labels as a coloured strip over the curve of a quantity; `more` goes under the title.

    Raises PlotError unless one axis was swept, `quantity` is one and it is defined in some cell.
    """
    label = quantity_label(quantity)
    view = View.of(results, 1)
    codes = view.arrange(results.sequence)
    values = view.arrange(quantity_values(results, quantity))
    palette = palette_of(results.labels)
    with styled():
        figure = new_figure()
        band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
        map_titles(figure, band, results, view, more)
        samples = view.x.values
        edges = cell_edges(view.x)
        starts = np.concatenate(([0], np.flatnonzero(np.diff(codes)) + 1, [len(codes)]))
        for start, stop in pairwise(starts):
            left, right = max(edges[start], samples[0]), min(edges[stop], samples[-1])
            if len(samples) == 1:
                left, right = edges
            if codes[start] == FAILED_CODE:
                look: dict[str, Any] = {"facecolor": FAILED_FILL, "hatch": "////", "edgecolor": FAILED_HATCH}
            else:
                look = {"facecolor": palette[results.labels[codes[start]]], "edgecolor": "none"}
            band.axvspan(left, right, linewidth=0.0, zorder=1, **look)
            if start:
                band.axvline(left, color=INK, linewidth=0.9, zorder=2)
                ax.axvline(left, color=FAINT_INK, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
            # One line per regime: the quantity jumps between them.
            marker = {"marker": "o", "markersize": 3.0} if len(samples) <= 60 or stop - start == 1 else {}
            look = {"color": HUES[1], "linewidth": 1.5, "clip_on": False, "zorder": 3}
            ax.plot(samples[start:stop], values[start:stop], **look, **marker)
        scale_axis(ax, "x", view.x)
        ax.set_xlim(*((samples[0], samples[-1]) if len(samples) > 1 else edges))
        ax.set_ylabel(label)
        if not np.nanmin(values) < 0.0:
            ax.set_ylim(bottom=0.0)
        elif np.nanmax(values) > 0.0:
            ax.axhline(0.0, color=INK, linewidth=0.8, zorder=2)
        tidy(ax)
        band.set_yticks([])
        band.tick_params(bottom=False, labelbottom=False)
        label_and_note(
            figure,
            band,
            results.labels,
            codes,
            lambda: Raster.of_strip(band, codes, edges),
            leaders=False,
            more=undecided_notes(mark_undecided(band, view, results)),
        )
        return figure


def paint_regimes(ax: Axes, view: View, regions: Regions, labels: tuple[str, ...], linewidth: float = 0.9) -> None:
    """The regions in their labels' colours, and the lines between them."""
    fill_regions(ax, view, regions, labels)
    draw_boundaries(ax, view, regions, color=INK, linewidth=linewidth)


def paint_quantity(
    ax: Axes,
    view: View,
    regions: Regions,
    values: Floats,
    name: str,
    norm: colors.Normalize,
    color: str,
    linewidth: float = 0.6,
) -> QuadMesh:
    """A quantity as colour under the regimes' boundaries; values : (nx, ny)."""
    ax.set_facecolor(_UNDEFINED)
    mesh = ax.pcolormesh(
        cell_edges(view.x),
        cell_edges(view.y),
        values.T,
        cmap=colour_map(name),
        norm=norm,
        rasterized=True,  # a vector file with a path for every cell would take seconds to show
        zorder=0.5,
    )
    hatch_failed(ax, view, regions)
    draw_boundaries(ax, view, regions, color=color, linewidth=linewidth)
    return mesh


def boundaries_note(results: Results, name: str) -> str:
    """What the lines on a quantity's map are."""
    return f"{'dark' if line_colour(results, name) == INK else 'light'} lines: boundaries of the regimes"


def line_colour(results: Results, name: str) -> str:
    """In which the boundaries are seen on a quantity's map: dark on diverging colours, and where few cells have one."""
    return INK if name == "margin" or results.inferred.any() else "white"


def undefined_notes(name: str, undefined: Bools, inferred: Bools) -> list[Patch]:
    """What a cell without a value looks like, if there is any, and why it has none."""
    reasons = []
    if (undefined & ~inferred).any():
        reasons.append("not known" if name == "margin" else "not defined (no events)")
    if (undefined & inferred).any():
        reasons.append(f"not run: {np.count_nonzero(undefined & inferred):,} cells")
    return [region_swatch("; ".join(reasons), _UNDEFINED)] if reasons else []


def mark_undecided(ax: Axes, view: View, results: Results) -> int:
    """A dot on every cell whose margin is below its tolerance; how many there are."""
    cells = np.nonzero(view.arrange(results.quality) & QUALITY_UNDECIDED)
    count = len(cells[0])
    if count:
        across = view.x.values[cells[0]]
        upward = view.y.values[cells[1]] if len(view.axes) > 1 else np.full(count, _STRIP_DOT)
        size = float(
            np.clip(0.6 * 330.0 / max(map(len, (axis.values for axis in view.axes))), 1.3, 3.0)
        )  # a map: 330 pt
        transform = ax.transData if len(view.axes) > 1 else ax.get_xaxis_transform()
        ax.plot(across, upward, **_DOT, markersize=size, transform=transform, zorder=4, gid="undecided")
    return count


def undecided_notes(count: int) -> list[Line2D]:
    """The note that says what the dots are; nothing where there is none."""
    return [Line2D([], [], **_DOT, markersize=3.0, label=f"undecided: {cells_phrase(count)}")] if count else []


def quantity_values(results: Results, name: str) -> Floats:
    """A quantity of every cell, NaN where it failed. Raises PlotError where it is not defined in any."""
    values = known_values(results, name)
    require_some(values, name)
    return values


def known_values(results: Results, name: str) -> Floats:
    """A quantity of every cell, NaN where it failed, or was inferred, which tells only how many impacts there are."""
    unknown = results.sequence == FAILED_CODE
    if name != "primary_impacts":
        unknown |= results.inferred
    values: Floats = np.where(unknown, np.nan, getattr(results, name).astype(np.float64))
    return values


def require_some(values: Floats, name: str) -> None:
    """Raises PlotError where none of a quantity's values is known."""
    if np.isnan(values).all():
        why = {
            "severity": "; under the restitution model accelerations are impulsive, and approach_velocity is the "
            "measure to plot",
            "margin": "; only the exact method knows it: sweep with --set solver.method=exact",
        }.get(name, "")
        raise PlotError(f"There is no {name} to draw: it is not defined in any cell{why}.")


def quantity_label(name: str) -> str:
    """A quantity's name, symbol and unit. Raises PlotError where it is none."""
    if name not in _DRAWN:
        raise PlotError(f"There is no quantity {name!r} to draw; there are {', '.join(_DRAWN)}.")
    return CELL_QUANTITIES[name].plot_label


def map_titles(figure: Figure, ax: Axes, results: Results | ToleranceMap, view: View, more: str = "") -> None:
    """The results' title, and under it the load, the values of the axes that are not drawn, and what more there is."""
    set_titles(figure, ax, title_of(results), subtitle_of(results, view.fixed, [more]))


def title_of(results: Results | ToleranceMap) -> str:
    """What stands over a figure of these results."""
    return results.title.strip() or "Impact regimes"


def subtitle_of(
    results: Results | ToleranceMap, fixed: Sequence[ResultAxis], more: Sequence[str] = (), width: float = SIZE[0]
) -> str:
    """What stands under it: the load, the values of what is fixed, and what more there is; in lines.

    width : of the figure  [inches]
    """
    parts = [_load(results), *(value_text(axis, axis.values[0]) for axis in fixed), *more]
    lines = [""]
    for part in filter(None, parts):
        if lines[-1] and len(lines[-1]) + len(part.split("\n")[0]) > _LINE * width / SIZE[0]:
            lines.append("")
        lines[-1] += f"; {part}" if lines[-1] else part
    return ";\n".join(lines)


def _load(results: Results | ToleranceMap) -> str:
    """What the load is, in words: an ideal step is a worst case, and a reader should know."""
    try:
        profile = tomllib.loads(results.config)["load"]["profile"]
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return ""
    return "ideal torque step (tip-out)" if profile == "tip-out" else f"load: {profile}"


def _mark_thresholds(ax: Axes, thresholds: Sequence[float]) -> None:
    """Triangles where the number of impacts for vanishing backlash changes, with their values above the map."""
    low, high = ax.get_xlim()
    inside = sorted(value for value in thresholds if low <= value <= high)
    if not inside:
        return
    along = ax.get_xaxis_transform()
    ax.plot(inside, [0.0] * len(inside), "^", color=INK, markersize=5.5, transform=along, clip_on=False, zorder=6)
    top = ax.secondary_xaxis("top")
    top.set_xticks(inside, _spaced_numbers(ax, inside))
    top.tick_params(direction="out", length=3.0, labelsize=8.5)
    top.minorticks_off()
    top.set_xlabel("▲ thresholds for vanishing backlash", loc="right", fontsize=8.5, color=FAINT_INK, labelpad=3.0)


def _spaced_numbers(ax: Axes, values: Sequence[float]) -> list[str]:
    """Ascending values as text, empty where it would run into the one before."""
    texts = [f"{value:{'.2f' if abs(value) >= 0.1 else '.2g'}}".replace("-", MINUS) for value in values]
    across = ax.transAxes.inverted().transform(ax.transData.transform([(value, 0.0) for value in values]))[:, 0]
    end = -np.inf
    for k, middle in enumerate(across):
        half = 0.5 * _DIGIT * len(texts[k])
        if middle - half < end + 0.5 * _DIGIT:
            texts[k] = ""
        else:
            end = middle + half
    return texts


def colour_map(name: str) -> str:
    """The colours of a quantity; the margin's diverge from zero."""
    return "PuOr" if name == "margin" else "viridis"


def quantity_norm(values: Floats, name: str) -> colors.Normalize:
    """From the values of a quantity, of any shape, to its colours."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if name == "margin":
        return colors.CenteredNorm(0.0, max(abs(low), abs(high)) or 1.0)
    if name in _WHOLE and high - low <= 12:  # one colour per number
        return colors.BoundaryNorm(np.arange(low - 0.5, high + 1.0), 256)
    if low >= 0.0:
        low = 0.0
    return colors.Normalize(low, high if high > low else low + 1.0)


def finish_bar(bar: Colorbar, name: str) -> None:
    """Name, frame and ticks of a quantity's colour bar."""
    bar.set_label(quantity_label(name))
    bar.outline.set_linewidth(0.6)
    if isinstance(bar.norm, colors.BoundaryNorm):
        bar.set_ticks(0.5 * (bar.norm.boundaries[1:] + bar.norm.boundaries[:-1]))
        bar.ax.yaxis.set_major_formatter(ticker.StrMethodFormatter("{x:.0f}"))
        bar.ax.tick_params(length=0.0)
        bar.minorticks_off()
    elif name in _WHOLE:
        bar.locator = ticker.MaxNLocator(integer=True)
        bar.update_ticks()


def _draw_ridge(ax: Axes, view: View, ridge: Floats) -> None:
    """The ridge as a line, broken where it leaves the map or jumps from one hill to another."""
    known = np.isfinite(ridge)
    y = np.where(known, view.y.values[np.where(known, ridge, 0).astype(np.intp)], np.nan)
    jump = np.abs(np.diff(ridge)) > max(3.0, 0.05 * len(view.y.values))
    x = np.insert(view.x.values, np.flatnonzero(jump) + 1, np.nan)
    y = np.insert(y, np.flatnonzero(jump) + 1, np.nan)
    outline = [patheffects.Stroke(linewidth=2.8, foreground=INK), patheffects.Normal()]
    line = Line2D(x, y, color="white", linewidth=1.4, path_effects=outline, zorder=4, gid="ridge", label="ridge")
    ax.add_line(line)


def _label_ridge(ax: Axes, view: View, ridge: Floats) -> None:
    """Name the ridge beside its middle, off the line itself."""
    raster = Raster.blank(ax)
    known = np.flatnonzero(np.isfinite(ridge))
    points = np.column_stack((view.x.values[known], view.y.values[ridge[known].astype(np.intp)]))
    across, upward = raster.pixels(points)
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
    rows, columns = np.nonzero(corners_that_fit(clear, columns_needed, rows_needed))
    if not rows.size:
        return
    centres = np.column_stack((columns + 0.5 * columns_needed, rows + 0.5 * rows_needed))
    middle = len(known) // 2
    nearest = centres[np.argmin(np.hypot(*(centres - [across[middle], upward[middle]]).T))]
    ax.text(
        *raster.data(*nearest),
        f"largest Q for each {symbol_text(symbol)}",
        fontsize=9.0,
        color="white",
        ha="center",
        va="center",
        zorder=5,
        path_effects=[patheffects.Stroke(linewidth=2.2, foreground=INK), patheffects.Normal()],
    )
