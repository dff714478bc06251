"""Small multiples: the map of two axes for some values of a third, or rows and columns of them for a third and fourth.

All panels have the same axes and colours: one label has one colour, one colour bar is for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.text import Text

from clunk.plot.labelling import label_regions, present, region_swatch
from clunk.plot.maps import (
    boundaries_note,
    finish_bar,
    known_values,
    mark_undecided,
    paint_quantity,
    paint_regimes,
    quantity_label,
    quantity_norm,
    require_some,
    subtitle_of,
    title_of,
    undecided_notes,
    undefined_note,
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
    palette_of,
    set_notes,
    styled,
    symbol_text,
    wrap,
)
from clunk.results import FAILED_CODE, RUN, ResultAxis, Results

MOST_VALUES = (12, 4)  # of one facet, of each of two

_PANEL = (2.0, 1.7)  # inches, at least
_AROUND = (0.9, 1.9)  # inches, for axes, titles and notes
_POINTS = 300  # across a panel: finer is not seen
_SETTINGS = ((8.5, False), (7.5, False), (7.5, True), (6.5, False), (6.5, True))  # sizes of labels, and turned or not
_MARGIN = 0.08  # inches, at the right of the titles


def facet_map(results: Results, facets: Sequence[str], quantity: str = "regimes") -> Figure:
    """A map of the regimes or of a quantity for each value of one facet, or of two: rows, then columns.

    Of many values those that `shown_values` chooses are drawn. Raises PlotError where a facet is no axis of several
    values, or not two axes are left for the maps.
    """
    if quantity != "regimes":
        quantity_label(quantity)
    axes = _facet_axes(results, facets)
    columns, rows = _arranged([len(shown_values(axis, len(axes))) for axis in axes])
    places = product(*(shown_values(axis, len(axes)) for axis in axes))
    panels = [results.at(dict(zip(facets, place, strict=True))) for place in places]
    views = [View.of(panel, 2) for panel in panels]
    with styled():
        width = max(SIZE[0], _AROUND[0] + columns * _PANEL[0])
        figure = new_figure((width, _AROUND[1] + rows * _PANEL[1] * (width - _AROUND[0]) / columns / _PANEL[0]))
        title = figure.suptitle(title_of(results), fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
        inner = figure.add_subfigure(figure.add_gridspec(1, 1)[0])
        grid = inner.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for ax in grid.flat[len(panels) :]:
            ax.remove()
        drawn = list(grid.flat[: len(panels)])
        for ax, view in zip(drawn, views, strict=True):
            _scale(ax, view)
        _name_panels(grid, axes)
        first = views[0]
        inner.supxlabel(axis_label(first.x), fontsize=10.0)
        inner.supylabel(axis_label(first.y), fontsize=10.0)
        regions = [Regions(view.arrange(panel.sequence), _POINTS) for panel, view in zip(panels, views, strict=True)]
        varying = {*facets, *(axis.parameter for axis in results.coordinates if RUN in facets)}
        fixed = [axis for axis in first.fixed if axis.parameter not in varying]
        named = " and ".join(map(_full_name, axes))
        more = [f"each map at one {named}"]
        if quantity == "regimes":
            notes = _paint_regimes(drawn, panels, views, regions)
        else:
            notes = _paint_quantity(inner, drawn, panels, views, regions, quantity)
            more.append(boundaries_note(quantity))
        line = subtitle_of(results, fixed, "; ".join(more))
        subtitle = inner.suptitle(line, fontsize=9.0, color=FAINT_INK, ha="left", parse_math=False)
        set_notes(figure, notes)
        _freeze(figure, drawn[0], title, subtitle)
        if quantity == "regimes":
            for ax, own, view in zip(drawn, regions, views, strict=True):
                label_regions(Raster.of(ax, own, view), results.labels, leaders=False, settings=_SETTINGS)
        return figure


def shown_values(axis: ResultAxis, facets: int) -> npt.NDArray[np.float64]:
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


def _scale(ax: Axes, view: View) -> None:
    """The axes of a panel, which is too small for many numbers."""
    scale_axes(ax, view)
    ax.set_xlabel("")
    ax.set_ylabel("")
    ax.tick_params(labelsize=8.0)
    for line in (ax.xaxis, ax.yaxis):
        locator = line.get_major_locator()
        if isinstance(locator, ticker.MaxNLocator):
            locator.set_params(nbins=5)


def _name_panels(grid: npt.NDArray[Any], axes: Sequence[ResultAxis]) -> None:
    """A panel's value over it; of two facets the columns' over the first row and the rows' beside the last column."""
    values = [shown_values(axis, len(axes)) for axis in axes]
    if len(axes) == 1:
        for ax, value in zip(grid.flat, values[0], strict=False):
            ax.set_title(_named(axes[0], value), loc="left", fontsize=9.0)
        for ax in grid[-2, grid.shape[1] - (grid.size - len(values[0])) :] if len(values[0]) < grid.size else ():
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


def _paint_regimes(
    drawn: Sequence[Axes], panels: Sequence[Results], views: Sequence[View], regions: Sequence[Regions]
) -> list[Artist]:
    """The regimes of all panels, and their notes."""
    labels = panels[0].labels
    for ax, view, own in zip(drawn, views, regions, strict=True):
        paint_regimes(ax, view, own, labels, linewidth=0.6)
    undecided = sum(mark_undecided(ax, view, panel) for ax, view, panel in zip(drawn, views, panels, strict=True))
    codes = np.stack([own.codes for own in regions])
    palette = palette_of(labels)
    swatches = [region_swatch(label, palette[label]) for label in present(labels, codes)]
    return [*swatches, *failed_notes(codes), *undecided_notes(undecided)]


def _paint_quantity(
    inner: SubFigure,
    drawn: Sequence[Axes],
    panels: Sequence[Results],
    views: Sequence[View],
    regions: Sequence[Regions],
    name: str,
) -> list[Artist]:
    """A quantity of all panels, its colour bar, and their notes."""
    values = np.stack([view.arrange(known_values(panel, name)) for panel, view in zip(panels, views, strict=True)])
    require_some(values, name)
    norm = quantity_norm(values, name)
    for ax, view, own, value in zip(drawn, views, regions, values, strict=True):
        mesh = paint_quantity(ax, view, own, value, name, norm, linewidth=0.4)
    finish_bar(inner.colorbar(mesh, ax=drawn, pad=0.02, aspect=40), name)
    codes = np.stack([own.codes for own in regions])
    notes: list[Artist] = [*failed_notes(codes)]
    if np.isnan(values[codes != FAILED_CODE]).any():
        notes.append(undefined_note(name))
    return notes
