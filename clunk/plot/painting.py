"""The painter of maps: layers as regions or as a quantity's colours, with boundaries, hatches, dots and colour bar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colors, ticker
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure, SubFigure

from clunk.plot.layers import Layers
from clunk.plot.network import draw_curves, fill_label
from clunk.plot.notes import DOT, failed_notes, set_notes, undefined_notes
from clunk.plot.plane import cell_edges, scale_axes
from clunk.plot.regions import Scores
from clunk.plot.style import (
    FAILED_FILL,
    FAILED_HATCH,
    FAILED_LOOK,
    INK,
    MOST_POINTS,
    UNDEFINED,
    new_figure,
    palette_of,
    set_titles,
)
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import Quantity
from clunk.study.arrays import Floats

_MAP = 330.0  # points, width of a map
_STRIP_DOT = 0.12  # of a strip's height: undecided cells are marked under their labels
_MOST_COLOURS = 12  # of whole numbers, each in a colour of its own


class Colours(NamedTuple):
    """Colours of a quantity, and the name and ticks of its colour bar."""

    label: str
    norm: colors.Normalize
    cmap: str | colors.Colormap = "viridis"
    formatter: ticker.Formatter | None = None
    locator: ticker.Locator | None = None

    @classmethod
    def of(cls, quantity: Quantity, values: Floats) -> Colours:
        """Colours of a cell's quantity for values of any shape; the margin's diverge from zero."""
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        if quantity.name == "margin":
            return cls(quantity.plot_label, colors.CenteredNorm(0.0, max(abs(low), abs(high)) or 1.0), "PuOr")
        is_whole = np.issubdtype(quantity.dtype, np.integer)
        if is_whole and high - low <= _MOST_COLOURS:
            return cls(quantity.plot_label, colors.BoundaryNorm(np.arange(low - 0.5, high + 1.0), 256))
        low = min(low, 0.0)
        norm = colors.Normalize(low, high if high > low else low + 1.0)
        return cls(quantity.plot_label, norm, locator=ticker.MaxNLocator(integer=True) if is_whole else None)

    def add_bar(
        self, figure: Figure | SubFigure, mesh: ScalarMappable, axes: Axes | Sequence[Axes], aspect: float = 28
    ) -> None:
        """Draw the colour bar beside the axes."""
        bar = figure.colorbar(mesh, ax=axes, pad=0.02, aspect=aspect, ticks=self.locator, format=self.formatter)
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


def new_map(layers: Layers, *facts: str) -> tuple[Figure, Axes]:
    """A figure as `new_plot`, with the axes of a map."""
    figure, ax = new_plot(layers, *facts)
    scale_axes(ax, layers.view)
    return figure, ax


def shaded_map(layers: Layers, colours: Colours, *facts: str) -> tuple[Figure, Axes]:
    """A figure of a quantity as colour under the regimes' boundaries, its colour bar and its notes."""
    figure, ax = new_map(layers, *facts)
    mesh = paint_quantity(ax, layers, colours)
    colours.add_bar(figure, mesh, ax)
    set_notes(figure, [*failed_notes(layers.failed), *undefined_notes(layers)])
    return figure, ax


def paint_regimes(ax: Axes, layers: Layers, *, linewidth: float = 0.9) -> None:
    """Fill the regions with their labels' colours, hatch failed cells, and draw the boundaries."""
    hatch_failed(ax, layers)
    palette = palette_of(layers.labels)
    if layers.boundaries is not None:
        for label in layers.present:
            fill_label(ax, layers.boundaries, layers.view, label, {"facecolor": palette[label]})
    for code in layers.regions.present if layers.boundaries is None else ():
        x, y, margin = margin_of(layers, code)
        if code != FAILED_CODE and margin.max() > 0.0:
            ax.contourf(x, y, margin, levels=[0.0, np.inf], colors=[palette[layers.labels[code]]], zorder=1)
    draw_boundaries(ax, layers, color=INK, linewidth=linewidth)


def paint_quantity(
    ax: Axes, layers: Layers, colours: Colours, *, dark: bool | None = None, linewidth: float = 0.6
) -> QuadMesh:
    """Draw a quantity as colour under the regimes' boundaries.

    dark : whether the boundaries are dark; by default as the layers say
    """
    ax.set_facecolor(UNDEFINED)
    edges = cell_edges(layers.view.x), cell_edges(layers.view.y)
    look: dict[str, Any] = {"cmap": colours.cmap, "norm": colours.norm, "zorder": 0.5}
    look["rasterized"] = True  # a vector file with a path for every cell would take seconds to show
    mesh = ax.pcolormesh(*edges, layers.values.T, **look)
    hatch_failed(ax, layers)
    is_dark = layers.has_dark_lines if dark is None else dark
    draw_boundaries(ax, layers, color=INK if is_dark else "white", linewidth=linewidth)
    return mesh


def hatch_failed(ax: Axes, layers: Layers) -> None:
    """Hatch the failed cells, if there are any."""
    if not layers.failed.any():
        return
    if layers.boundaries is not None:
        fill_label(ax, layers.boundaries, layers.view, FAILED, FAILED_LOOK)
        return
    look: dict[str, Any] = {"colors": [FAILED_FILL], "hatches": [FAILED_LOOK["hatch"]], "zorder": 1}
    filled = ax.contourf(*margin_of(layers, FAILED_CODE), levels=[0.0, np.inf], **look)
    filled.set_edgecolor(FAILED_HATCH)
    filled.set_linewidth(0.0)


def draw_boundaries(ax: Axes, layers: Layers, *, color: str, linewidth: float) -> None:
    """Draw lines between the regions."""
    if layers.boundaries is not None:
        draw_curves(ax, layers.boundaries, layers.view, {"colors": color, "linewidths": linewidth, "zorder": 3})
        return
    present = layers.regions.present
    for code in present if len(present) > 1 else ():
        x, y, margin = margin_of(layers, code)
        if margin.min() < 0.0 < margin.max():
            ax.contour(x, y, margin, levels=[0.0], colors=[color], linewidths=linewidth, zorder=3)


def mark_undecided(ax: Axes, layers: Layers) -> None:
    """Put a dot on every cell of a map, or under every cell of a strip, whose margin is below its tolerance."""
    cells = np.nonzero(layers.undecided)
    if not cells[0].size:
        return
    is_map = len(layers.view.axes) > 1
    upward = layers.view.y.values[cells[1]] if is_map else np.full(cells[0].size, _STRIP_DOT)
    transform = ax.transData if is_map else ax.get_xaxis_transform()
    size = float(np.clip(0.6 * _MAP / max(layers.codes.shape), 1.3, 3.0))
    look: dict[str, Any] = DOT | {"markersize": size, "transform": transform, "zorder": 4}
    look["rasterized"] = cells[0].size > MOST_POINTS
    ax.plot(layers.view.x.values[cells[0]], upward, gid="undecided", **look)


def margin_of(layers: Layers, code: int) -> tuple[Floats, Floats, Scores]:
    """The fine points among which a label's cells are, and its margin there, rows along y."""
    (columns, rows), margin = layers.regions.margin(code)
    x, y = layers.regions.fine_values(layers.view)
    return x[columns], y[rows], margin.T
