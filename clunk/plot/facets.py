"""Small multiples: the map of two axes for some values of a third, or rows and columns of them for a third and fourth.

All panels have the same axes and colours: one label has one colour, one colour bar is for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.text import Text

from clunk.plot.labelling import label_regions, more_labels, present, region_swatch
from clunk.plot.maps import (
    boundaries_note,
    finish_bar,
    known_values,
    line_colour,
    mark_undecided,
    paint_quantity,
    paint_regimes,
    quantity_label,
    quantity_norm,
    require_some,
    subtitle_of,
    title_of,
    undecided_notes,
    undefined_notes,
)
from clunk.plot.plane import View, at_option, axis_label, drawn_axes, scale_axes, value_text
from clunk.plot.raster import Raster
from clunk.plot.regions import Regions
from clunk.plot.style import (
    FAINT_INK,
    SIZE,
    PlotError,
    failed_notes,
    new_figure,
    note_columns,
    palette_of,
    set_notes,
    styled,
    symbol_text,
    wrap,
)
from clunk.results.labels import FAILED_CODE
from clunk.results.regimemap import Results
from clunk.study.axes import RUN, ResultAxis

Floats = npt.NDArray[np.float64]

MOST_VALUES = (12, 4)  # of one facet, of each of two

_NARROWEST = 2.0  # inches, of a panel
_HIGHEST = 2.2  # likewise
_AROUND = (0.9, 1.3)  # inches, for axes and titles
_NOTE = 0.18  # inches, of a row of notes
_MOST_NOTES = 16  # labels
_POINTS = 300  # across a panel: finer is not seen
_SETTINGS = ((8.5, False), (7.5, False), (7.5, True), (6.5, False), (6.5, True))  # sizes of labels, and turned or not
_MARGIN = 0.08  # inches, at the right of the titles


def facet_map(results: Results, facets: Sequence[str], quantity: str = "regimes") -> Figure:
    """A map of the regimes or of a quantity for each value of one facet, or of two: rows, then columns.

    Of many values those that `shown_values` chooses are drawn. Raises PlotError where a facet is no axis of several
    values, or not two axes are left for the maps.
    """
    if quantity != "regimes":
        quantity_label(quantity)  # refuses what is none
    axes = _facet_axes(results, facets)
    values = [shown_values(axis, len(axes)) for axis in axes]
    parts = [results.at(dict(zip(facets, place, strict=True))) for place in product(*values)]
    views = [View.of(part, 2) for part in parts]
    columns, rows = _arranged([len(each) for each in values])
    with styled():
        figure = new_figure(_size(columns, rows))
        title = figure.suptitle(title_of(results), fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
        inner = figure.add_subfigure(figure.add_gridspec(1, 1)[0])  # for a second title, and names of the axes
        grid = inner.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for ax in grid.flat[len(parts) :]:
            ax.remove()
        panels = [
            _Panel(ax, part, view, Regions(view.arrange(part.sequence), _POINTS))
            for ax, part, view in zip(grid.flat, parts, views, strict=False)
        ]
        for panel in panels:
            _scale(panel)
        _name_panels(grid, axes, values)
        inner.supxlabel(axis_label(views[0].x), fontsize=10.0)
        inner.supylabel(axis_label(views[0].y), fontsize=10.0)
        notes = _paint_regimes(panels) if quantity == "regimes" else _paint_quantity(inner, panels, results, quantity)
        line = _subtitle(results, axes, views[0], quantity, figure.get_figwidth())
        subtitle = inner.suptitle(line, fontsize=9.0, color=FAINT_INK, ha="left", parse_math=False)
        set_notes(figure, notes)
        if notes:
            figure.set_figheight(figure.get_figheight() + _NOTE * math.ceil(len(notes) / note_columns(figure, notes)))
        _freeze(figure, panels[0].ax, title, subtitle)
        if quantity == "regimes":
            for panel in panels:
                raster = Raster.of(panel.ax, panel.regions, panel.view)
                label_regions(raster, results.labels, leaders=False, settings=_SETTINGS)
        return figure


class _Panel(NamedTuple):
    """One map, and what it shows."""

    ax: Axes
    results: Results
    view: View
    regions: Regions


def shown_values(axis: ResultAxis, facets: int) -> Floats:
    """The values of a facet that are drawn, ascending: all, or evenly spaced ones with the first and the last."""
    values, most = np.sort(axis.values), MOST_VALUES[facets - 1]
    if len(values) <= most:
        return values
    return values[np.rint(np.linspace(0, len(values) - 1, most)).astype(np.intp)]


def _facet_axes(results: Results, facets: Sequence[str]) -> list[ResultAxis]:
    """The axes of the facets."""
    if len(facets) > len(MOST_VALUES):
        raise PlotError("Small multiples have one facet, or two for rows and columns; fix other axes with --at.")
    left = {results.axes[index].parameter: results.axes[index] for index in drawn_axes(results)}
    for facet in facets:
        if facet not in left:
            known = ", ".join(left)
            raise PlotError(f"--facet {facet}: it is no axis of several values; these are {known}.")
    if len(set(facets)) < len(facets):
        raise PlotError(f"--facet {facets[0]} is there twice; rows and columns need two axes.")
    maps = len(left) - len(facets)
    if maps < 2:
        raise PlotError(
            f"Each map of a family needs two axes, and beside the facets {maps or 'none'} of {', '.join(left)} is left."
        )
    if maps > 2:
        others = [name for name in left if name not in facets]
        also = " ".join(at_option(left[name]) for name in others[2:])
        raise PlotError(
            f"Each map of a family shows two axes, and beside the facets {maps} are left ({', '.join(others)}): "
            f"also give {also}, for example."
        )
    return [left[facet] for facet in facets]


def _arranged(counts: Sequence[int]) -> tuple[int, int]:
    """Columns and rows of the panels."""
    if len(counts) > 1:
        return counts[1], counts[0]
    columns = 2 if counts[0] in (2, 4) else 4 if counts[0] > 9 else min(counts[0], 3)
    return columns, math.ceil(counts[0] / columns)


def _size(columns: int, rows: int) -> tuple[float, float]:
    """Of the figure without its notes, width and height  [inches]."""
    panel = max((SIZE[0] - _AROUND[0]) / columns, _NARROWEST)
    return _AROUND[0] + columns * panel, _AROUND[1] + rows * min(0.85 * panel, _HIGHEST)


def _subtitle(results: Results, axes: Sequence[ResultAxis], view: View, quantity: str, width: float) -> str:
    """What is fixed in all panels, and what is not."""
    varying = {axis.parameter for axis in axes}
    if RUN in varying:
        varying |= {axis.parameter for axis in results.coordinates}
    more = [f"each map at one {' and '.join(map(_full_name, axes))}"]
    if quantity != "regimes":
        more.append(boundaries_note(results, quantity))
    return subtitle_of(results, [axis for axis in view.fixed if axis.parameter not in varying], more, width)


def _scale(panel: _Panel) -> None:
    """The axes of a panel, which is too small for many numbers."""
    ax = panel.ax
    scale_axes(ax, panel.view)
    ax.set_xlabel("")
    ax.set_ylabel("")
    ax.tick_params(labelsize=8.0)
    for line in (ax.xaxis, ax.yaxis):
        locator = line.get_major_locator()
        if isinstance(locator, ticker.MaxNLocator):
            locator.set_params(nbins=5)


def _name_panels(grid: npt.NDArray[Any], axes: Sequence[ResultAxis], values: Sequence[Floats]) -> None:
    """A panel's value over it; of two facets the columns' over the first row and the rows' beside the last column."""
    if len(axes) == 1:
        for ax, value in zip(grid.flat, values[0], strict=False):
            ax.set_title(_named(axes[0], value), loc="left", fontsize=9.0)
        empty = grid.size - len(values[0])
        for ax in grid[-2, grid.shape[1] - empty :] if empty else ():
            ax.tick_params(labelbottom=True)  # nothing is drawn under it
        return
    for ax, value in zip(grid[0], values[1], strict=True):
        ax.set_title(_named(axes[1], value), loc="left", fontsize=9.0)
    for ax, value in zip(grid[:, -1], values[0], strict=True):
        where = {"xytext": (5, 0), "textcoords": "offset points", "rotation": 270.0, "ha": "left", "va": "center"}
        ax.annotate(_named(axes[0], value), (1.0, 0.5), xycoords="axes fraction", fontsize=9.0, **where)


def _full_name(axis: ResultAxis) -> str:
    symbol = axis.symbol.split("=")[0].strip()
    return f"{axis.name or axis.parameter} ({symbol})" if symbol else axis.name or axis.parameter


def _named(axis: ResultAxis, value: float) -> str:
    return symbol_text(value_text(axis, value, symbol=True))


def _freeze(figure: Figure, ax: Axes, title: Text, subtitle: Text) -> None:
    """Settle where everything is, with both titles over the left edge of the first panel."""
    figure.draw_without_rendering()
    left = ax.get_window_extent().x0
    room = figure.bbox.width - left - _MARGIN * figure.dpi
    if wrap(figure, title, room):
        figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for text in (title, subtitle):
        text.set_x(left / figure.bbox.width)


def _paint_regimes(panels: Sequence[_Panel]) -> list[Artist]:
    """The regimes of all panels, and their notes."""
    labels = panels[0].results.labels
    for panel in panels:
        paint_regimes(panel.ax, panel.view, panel.regions, labels, linewidth=0.6)
    undecided = sum(mark_undecided(panel.ax, panel.view, panel.results) for panel in panels)
    codes = np.stack([panel.regions.codes for panel in panels])
    palette = palette_of(labels)
    there = present(labels, codes)
    # many labels are of few cells each, and hardly seen
    rare = sorted(there, key=lambda label: -int(np.count_nonzero(codes == labels.index(label))))[_MOST_NOTES:]
    swatches: list[Artist] = [region_swatch(label, palette[label]) for label in there if label not in rare]
    if rare:
        swatches.append(more_labels(len(rare)))
    return [*swatches, *failed_notes(codes), *undecided_notes(undecided)]


def _paint_quantity(inner: SubFigure, panels: Sequence[_Panel], results: Results, name: str) -> list[Artist]:
    """A quantity of all panels, its colour bar, and their notes."""
    values = np.stack([panel.view.arrange(known_values(panel.results, name)) for panel in panels])
    require_some(values, name)
    norm, color = quantity_norm(values, name), line_colour(results, name)
    for panel, own in zip(panels, values, strict=True):
        mesh = paint_quantity(panel.ax, panel.view, panel.regions, own, name, norm, color, linewidth=0.4)
    finish_bar(inner.colorbar(mesh, ax=[panel.ax for panel in panels], pad=0.02, aspect=40), name)
    codes = np.stack([panel.regions.codes for panel in panels])
    inferred = np.stack([panel.view.arrange(panel.results.inferred) for panel in panels])
    return [*failed_notes(codes), *undefined_notes(name, np.isnan(values) & (codes != FAILED_CODE), inferred)]
