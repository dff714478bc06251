"""Small multiples: the map of two axes for some values of a third, or rows and columns of them for a third and fourth.

All panels have the same axes and colours: one label has one colour, one colour bar is for all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from clunk.plot.labelling import label_regions
from clunk.plot.layers import Layers, stacked
from clunk.plot.notes import failed_notes, label_notes, note_columns, set_notes, undecided_notes, undefined_notes
from clunk.plot.painting import Colours, mark_undecided, paint_quantity, paint_regimes
from clunk.plot.plane import SurplusAxesError, axis_label, drawn_axes, scale_axes, value_text
from clunk.plot.raster import Raster
from clunk.plot.style import FAINT_INK, SIZE, PlotError, bare, freeze_layout, new_figure, styled, symbol_text
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats
from clunk.study.axes import RUN, ResultAxis

MOST_VALUES = (12, 4)  # of one facet, of each of two

_NARROWEST = 2.0  # inches, of a panel
_HIGHEST = 2.2  # likewise
_AROUND = (0.9, 1.3)  # inches, for axes and titles
_NOTE = 0.18  # inches, of a row of notes
_MOST_NOTES = 16  # labels
_POINTS = 300  # across a panel: finer is not seen
_SETTINGS = ((8.5, False), (7.5, False), (7.5, True), (6.5, False), (6.5, True))  # sizes of labels, and turned or not

_Panel = tuple[Axes, Layers]


@styled()
def facet_map(results: Results, facets: Sequence[str], quantity: str = "regimes") -> Figure:
    """A map of the regimes or of a quantity for each value of one facet, or of two: rows, then columns.

    Of many values those that `shown_values` chooses are drawn. Raises PlotError where a facet is no axis of several
    values, or not two axes are left for the maps.
    """
    axes = _facet_axes(results, facets)
    values = [shown_values(axis, len(axes)) for axis in axes]
    slices = [results.at(dict(zip(facets, place, strict=True))) for place in product(*values)]
    is_regimes = quantity == "regimes"
    layers = [Layers.of(each, 2) if is_regimes else Layers.of_quantity(each, 2, quantity) for each in slices]
    layers = [replace(each, points=_POINTS) for each in layers]
    rows, columns, size = _layout([len(each) for each in values])
    figure = new_figure(size)
    figure.suptitle(layers[0].title, fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
    inner = figure.add_subfigure(figure.add_gridspec(1, 1)[0])  # for a second title, and names of the axes
    grid = inner.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax in grid.flat[len(layers) :]:
        ax.remove()
    panels = list(zip(grid.flat, layers, strict=False))
    for ax, each in panels:
        _scale(ax, each)
    _name_panels(grid, axes, values)
    inner.supxlabel(axis_label(layers[0].view.x), fontsize=10.0)
    inner.supylabel(axis_label(layers[0].view.y), fontsize=10.0)
    notes = _paint_regimes(panels) if is_regimes else _paint_quantity(inner, panels)
    together = replace(stacked(layers), caveats=tuple(results.caveats))
    line = _subtitle(results, axes, together, figure.get_figwidth())
    subtitle = inner.suptitle(line, fontsize=9.0, color=FAINT_INK, ha="left", parse_math=False)
    set_notes(figure, notes)
    if notes:
        figure.set_figheight(figure.get_figheight() + _NOTE * math.ceil(len(notes) / note_columns(figure, notes)))
    freeze_layout(figure, panels[0][0])
    subtitle.set_x(panels[0][0].get_position().x0)
    for ax, each in panels if is_regimes else []:
        label_regions(Raster.of(ax, each), results.labels, leaders=False, settings=_SETTINGS)
    return figure


def shown_values(axis: ResultAxis, facets: int) -> Floats:
    """The values of a facet that are drawn, ascending: all, or evenly spaced ones with the first and the last."""
    values, most = np.sort(axis.values), MOST_VALUES[facets - 1]
    if len(values) <= most:
        return values
    return values[np.rint(np.linspace(0, len(values) - 1, most)).astype(np.intp)]


def _facet_axes(results: Results, facets: Sequence[str]) -> list[ResultAxis]:
    """The axes of the facets. Raises PlotError where no maps can be drawn for each of their values."""
    if len(facets) > len(MOST_VALUES):
        raise PlotError("Small multiples have one facet, or two for rows and columns; fix the other axes.")
    changing = {results.axes[index].parameter: results.axes[index] for index in drawn_axes(results)}
    for facet in facets:
        if facet not in changing:
            raise PlotError(f"{facet} is no axis of several values; these are {', '.join(changing)}.")
    if len(set(facets)) < len(facets):
        raise PlotError(f"The facet {facets[0]} is there twice; rows and columns need two axes.")
    rest = [axis for name, axis in changing.items() if name not in facets]
    if len(rest) < 2:
        count, names = len(rest) or "none", ", ".join(changing)
        problem = f"A map needs two axes, and beside the facets {count} of {names} is left"
        raise PlotError(f"{problem}; leave out a facet, or take a slice with --at instead.")
    if len(rest) > 2:
        names = ", ".join(axis.parameter for axis in rest)
        text = f"Each map of a family shows two axes, and beside the facets {len(rest)} are left ({names})"
        raise SurplusAxesError(text, rest[2:])
    return [changing[facet] for facet in facets]


def _layout(counts: Sequence[int]) -> tuple[int, int, tuple[float, float]]:
    """Number of rows and columns of the panels, and the figure's size without its notes  [inches]."""
    columns = counts[-1] if len(counts) > 1 else 2 if counts[0] in (2, 4) else 4 if counts[0] > 9 else min(counts[0], 3)
    rows = counts[0] if len(counts) > 1 else math.ceil(counts[0] / columns)
    panel = max((SIZE[0] - _AROUND[0]) / columns, _NARROWEST)
    return rows, columns, (_AROUND[0] + columns * panel, _AROUND[1] + rows * min(0.85 * panel, _HIGHEST))


def _subtitle(results: Results, axes: Sequence[ResultAxis], layers: Layers, width: float) -> str:
    """Line under the title: parameters that are fixed in all panels, those that vary, and the name of the lines."""
    varying = {axis.parameter for axis in axes}
    if RUN in varying:
        varying |= {axis.parameter for axis in results.coordinates}
    facts = [f"each map at one {' and '.join(map(_full_name, axes))}"]
    if layers.quantity != "regimes":
        facts.append(layers.boundaries_note)
    fixed = [axis for axis in layers.view.fixed if axis.parameter not in varying]
    return layers.subtitle(*facts, fixed=fixed, width=width)


def _scale(ax: Axes, layers: Layers) -> None:
    """Scale the axes of a panel, which is too small for many numbers."""
    scale_axes(ax, layers.view)
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
    """Name and symbol of a parameter."""
    symbol = bare(axis.symbol)
    return f"{axis.name or axis.parameter} ({symbol})" if symbol else axis.name or axis.parameter


def _named(axis: ResultAxis, value: float) -> str:
    """A parameter's symbol and value."""
    return symbol_text(value_text(axis, value, symbol=True))


def _paint_regimes(panels: Sequence[_Panel]) -> list[Artist]:
    """Draw the regimes of all panels; returns their notes."""
    for ax, layers in panels:
        paint_regimes(ax, layers, linewidth=0.6)
        mark_undecided(ax, layers)
    together = stacked([layers for _, layers in panels])
    # many labels are of few cells each, and hardly seen
    frequent = sorted(together.present, key=lambda label: -together.count(label))[:_MOST_NOTES]
    labels = sorted(together.present, key=lambda label: label not in frequent)
    notes = label_notes(together, labels, _MOST_NOTES, counted=False)
    return [*notes, *failed_notes(together.failed), *undecided_notes(together.undecided)]


def _paint_quantity(inner: SubFigure, panels: Sequence[_Panel]) -> list[Artist]:
    """Draw a quantity of all panels and its colour bar; returns their notes."""
    together = stacked([layers for _, layers in panels])
    together.require_values()
    colours, dark = Colours.of(together.described, together.values), together.has_dark_lines
    for ax, layers in panels:
        mesh = paint_quantity(ax, layers, colours, dark=dark, linewidth=0.4)
    colours.add_bar(inner, mesh, [ax for ax, _ in panels], aspect=40)
    return [*failed_notes(together.failed), *undefined_notes(together)]
