"""Pictures along one axis: labels as bands over a quantity's curve, probabilities of labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.plot.labelling import Raster, write_names
from clunk.plot.layers import Layers
from clunk.plot.maps import mark_doubts, notes_of
from clunk.plot.plane import scale_axis
from clunk.results.labels import FAILED
from clunk.results.quantities import CELL_QUANTITIES
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.arrays import Floats

_FEW = 60  # samples, each of which is marked on the curve
_COLOUR = style.LINE_COLOURS[0]


@style.styled()
def strip(results: Results, quantity: str = "severity", more: str = "") -> Figure:
    """The labels along one swept axis as a coloured strip over the curve of a quantity.

    more : further facts for the line under the title

    Raises PlotError unless one axis was swept and the quantity is defined in some cell.
    """
    layers, of_quantity = Layers.of(results, 1), Layers.of(results, 1, quantity)
    samples, values, (edges, codes) = layers.view.x.values, of_quantity.values, layers.bands
    assert values is not None
    figure = style.new_figure()
    band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
    fills = (*layers.colours, style.FAILED_FILL)
    for left, right, code in zip(edges[:-1], edges[1:], codes, strict=True):
        band.axvspan(left, right, facecolor=fills[code], linewidth=0.0, zorder=1)
    for edge in edges[1:-1]:
        band.axvline(edge, color=style.INK, linewidth=0.9, zorder=2)
        ax.axvline(edge, color=style.FAINT_INK, linewidth=0.6, linestyle=style.DASHED, zorder=1)
    # The quantity jumps between regimes.
    for cells in np.split(np.arange(samples.size), np.flatnonzero(np.diff(layers.codes)) + 1):
        marker = "o" if samples.size <= _FEW or cells.size == 1 else ""
        look: dict[str, Any] = {"color": _COLOUR, "linewidth": 1.5, "markersize": 3.0, "clip_on": False, "zorder": 3}
        ax.plot(samples[cells], values[cells], marker=marker, **look)
    scale_axis(ax, "x", layers.view.x)
    ax.set_xlim(*((samples[0], samples[-1]) if len(samples) > 1 else edges[[0, -1]]))
    ax.set_ylabel(of_quantity.value_label)
    if not np.nanmin(values) < 0.0:
        ax.set_ylim(bottom=0.0)
    elif np.nanmax(values) > 0.0:
        ax.axhline(0.0, color=style.INK, linewidth=0.8, zorder=2)
    style.tidy(ax)
    band.set_yticks([])
    band.tick_params(bottom=False, labelbottom=False)
    mark_doubts(band, layers)
    style.lay_out(figure, band, layers.title, layers.subtitle(more))
    notes = notes_of(layers, write_names(Raster.of(band, layers), layers.names))
    if layers.boundaries is not None:
        changes = ", ".join(f"{value:.7g}" for value in layers.boundaries.vertices[:, 0])
        notes.append(style.remark(f"the label changes at {changes}"))
    style.add_notes(figure, notes)
    return figure


def stack_shares(ax: Axes, x: Floats, shares: Sequence[Floats] | Floats, fills: Sequence[str], **look: Any) -> None:
    """Draw probabilities along x one upon the other, each in its colour."""
    ax.stackplot(x, *shares, colors=fills, edgecolor=style.INK, linewidth=0.5, **look)
    ax.set(ylim=(0.0, 1.0), ylabel="Probability")


@style.styled()
def likelihood_curves(tolerances: ToleranceMap) -> Figure:
    """The probability of each label along one swept axis, stacked, over the severity's median and 5 to 95 % band.

    Raises PlotError unless one axis was swept.
    """
    layers, names = Layers.of(tolerances, 1), (*tolerances.labels, FAILED)
    x = layers.view.x.values
    figure = style.new_figure()
    share, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.3))
    probability = tolerances.probability.reshape(-1, len(names))[layers.view.order[0]]
    fills = {name: style.colour_of(name) for name in tolerances.labels} | {FAILED: style.FAILED_FILL}
    shown = {name: column for name, column in zip(names, probability.T, strict=True) if column.any()}
    stack_shares(share, x, [*shown.values()], [fills[name] for name in shown])
    share.tick_params(bottom=False, labelbottom=False)
    notes = [style.swatch(name, fills[name]) for name in shown]
    mean = layers.view.arrange(tolerances.severity_mean)
    low, median, high = (layers.view.arrange(each) for each in np.moveaxis(tolerances.severity_quantiles, -1, 0))
    if np.isfinite(median).any():
        band = ax.fill_between(x, low, high, color=_COLOUR, alpha=0.25, linewidth=0.0, label="5 to 95 % of the draws")
        line = ax.plot(x, median, color=_COLOUR, linewidth=1.6, label="median")
        dashed = ax.plot(x, mean, color=style.INK, linewidth=1.0, linestyle=style.DASHED, label="mean")
        ax.set_ylim(bottom=0.0)
        notes += [*line, band, *dashed]
    else:
        ax.text(0.5, 0.5, "not defined", transform=ax.transAxes, ha="center", color=style.FAINT_INK)
    ax.set_ylabel(CELL_QUANTITIES["severity"].plot_label)
    scale_axis(ax, "x", layers.view.x)
    if len(x) > 1:
        ax.set_xlim(x[0], x[-1])
    style.tidy(ax)
    style.lay_out(figure, share, layers.title, layers.subtitle(), notes)
    return figure
