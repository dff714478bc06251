"""Strips along one swept axis: labels as coloured bands over the curve of a quantity."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.plot.labelling import label_and_note
from clunk.plot.layers import Layers
from clunk.plot.painting import mark_undecided
from clunk.plot.plane import scale_axis, spaced_numbers
from clunk.results.labels import FAILED_CODE
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats

_FEW = 60  # samples, each of which is marked on the curve


@style.styled()
def strip(results: Results, quantity: str = "severity", more: str = "") -> Figure:
    """The labels along one swept axis as a coloured strip over the curve of a quantity.

    more : further facts for the line under the title

    Raises PlotError unless one axis was swept, `quantity` is one and it is defined in some cell.
    """
    layers = Layers.of_quantity(results, 1, quantity)
    layers.require_values()
    samples, (edges, codes) = layers.view.x.values, layers.bands
    figure = style.new_figure()
    band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
    style.set_titles(figure, band, layers.title, layers.subtitle(more))
    for piece in np.split(np.arange(len(codes)), np.flatnonzero(np.diff(codes)) + 1):
        _draw_regime(band, ax, layers, edges[[piece[0], piece[-1] + 1]], codes[piece[0]])
    scale_axis(ax, "x", layers.view.x)
    ax.set_xlim(*((samples[0], samples[-1]) if len(samples) > 1 else edges))
    ax.set_ylabel(layers.described.plot_label)
    _limit_upwards(ax, layers.values)
    style.tidy(ax)
    band.set_yticks([])
    band.tick_params(bottom=False, labelbottom=False)
    mark_undecided(band, layers)
    if layers.boundaries is not None:
        _print_values(band, layers.boundaries.vertices[:, 0].tolist())
    label_and_note(figure, band, layers)
    return figure


def _print_values(band: Axes, values: list[float]) -> None:
    """Write the values at which the label changes above the band, as far as there is room."""
    top = band.secondary_xaxis("top")
    top.set_xticks(values, spaced_numbers(band, values, ".7g"))
    top.tick_params(direction="out", length=3.0, labelsize=8.0)
    top.minorticks_off()


def _draw_regime(band: Axes, ax: Axes, layers: Layers, ends: Floats, code: int) -> None:
    """Draw a regime's piece of the band and of the curve: the quantity jumps between regimes."""
    samples = layers.view.x.values
    cells = slice(np.searchsorted(samples, ends[0]), np.searchsorted(samples, ends[1], side="right"))
    left, right = np.clip(ends, samples[0], samples[-1]) if len(samples) > 1 else ends
    fill: dict[str, Any] = {"facecolor": style.FAILED_FILL, "hatch": "////", "edgecolor": style.FAILED_HATCH}
    if code != FAILED_CODE:
        fill = {"facecolor": style.palette_of(layers.labels)[layers.labels[code]], "edgecolor": "none"}
    band.axvspan(left, right, linewidth=0.0, zorder=1, **fill)
    if left > samples[0]:
        band.axvline(left, color=style.INK, linewidth=0.9, zorder=2)
        ax.axvline(left, color=style.FAINT_INK, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    is_marked = len(samples) <= _FEW or cells.stop - cells.start == 1
    marker: dict[str, Any] = {"marker": "o", "markersize": 3.0} if is_marked else {}
    look: dict[str, Any] = {"color": style.HUES[1], "linewidth": 1.5, "clip_on": False, "zorder": 3}
    ax.plot(samples[cells], layers.values[cells], **look, **marker)


def _limit_upwards(ax: Axes, values: Floats) -> None:
    """Begin at zero the y axis of values without a negative one; else draw a line at zero if they have both signs."""
    if not np.nanmin(values) < 0.0:
        ax.set_ylim(bottom=0.0)
    elif np.nanmax(values) > 0.0:
        ax.axhline(0.0, color=style.INK, linewidth=0.8, zorder=2)
