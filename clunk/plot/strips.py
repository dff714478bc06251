"""Pictures along one axis: labels as bands over a quantity's curve, probabilities of labels, severity over backlash."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.plot.labelling import Raster, write_names
from clunk.plot.layers import Layers
from clunk.plot.maps import mark_doubts, notes_of
from clunk.plot.plane import View, axis_label, scale_axis, spaced_numbers
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import CELL_QUANTITIES
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import QUANTILES, ToleranceMap
from clunk.study.arrays import Floats

_FEW = 60  # samples, each of which is marked on the curve
_COLOUR = style.LINE_COLOURS[0]


@style.styled()
def strip(results: Results, quantity: str = "severity", more: str = "") -> Figure:
    """The labels along one swept axis as a coloured strip over the curve of a quantity.

    more : further facts for the line under the title

    Raises PlotError unless one axis was swept and the quantity is defined in some cell.
    """
    layers = Layers.of(results, 1)
    values = Layers.of(results, 1, quantity)
    samples, (edges, codes) = layers.view.x.values, layers.bands
    figure = style.new_figure()
    band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
    style.set_titles(figure, band, layers.title, layers.subtitle(more))
    assert values.values is not None
    for k, code in enumerate(codes):
        _draw_regime(band, ax, layers, edges[k : k + 2], int(code), values.values)
    scale_axis(ax, "x", layers.view.x)
    ax.set_xlim(*((samples[0], samples[-1]) if len(samples) > 1 else edges[[0, -1]]))
    ax.set_ylabel(values.value_label)
    _limit_upwards(ax, values.values)
    style.tidy(ax)
    band.set_yticks([])
    band.tick_params(bottom=False, labelbottom=False)
    mark_doubts(band, layers)
    if layers.boundaries is not None:
        _print_values(band, layers.boundaries.vertices[:, 0].tolist())
    style.freeze_layout(figure, band)
    unnamed = write_names(Raster.of(band, layers), layers.names)
    style.append_notes(figure, notes_of(layers, unnamed))
    return figure


def _print_values(band: Axes, values: list[float]) -> None:
    """Write the values at which the label changes above the band, as far as there is room."""
    top = band.secondary_xaxis("top")
    top.set_xticks(values, spaced_numbers(band, values, ".7g"))
    top.tick_params(direction="out", length=3.0, labelsize=8.0)
    top.minorticks_off()


def _draw_regime(band: Axes, ax: Axes, layers: Layers, ends: Floats, code: int, values: Floats) -> None:
    """Draw a regime's piece of the band and of the curve: the quantity jumps between regimes."""
    samples = layers.view.x.values
    cells = slice(np.searchsorted(samples, ends[0]), np.searchsorted(samples, ends[1], side="right"))
    left, right = np.clip(ends, samples[0], samples[-1]) if len(samples) > 1 else ends
    fill: dict[str, Any] = style.FAILED_LOOK
    if code != FAILED_CODE:
        fill = {"facecolor": layers.colours[code], "edgecolor": "none"}
    band.axvspan(left, right, zorder=1, **{"linewidth": 0.0} | fill)
    if left > samples[0]:
        band.axvline(left, color=style.INK, linewidth=0.9, zorder=2)
        ax.axvline(left, color=style.FAINT_INK, linewidth=0.6, linestyle=(0, (4, 3)), zorder=1)
    is_marked = len(samples) <= _FEW or cells.stop - cells.start == 1
    marker: dict[str, Any] = {"marker": "o", "markersize": 3.0} if is_marked else {}
    look: dict[str, Any] = {"color": _COLOUR, "linewidth": 1.5, "clip_on": False, "zorder": 3}
    ax.plot(samples[cells], values[cells], **look, **marker)


def _limit_upwards(ax: Axes, values: Floats) -> None:
    """Begin at zero the y axis of values without a negative one; else draw a line at zero if they have both signs."""
    if not np.nanmin(values) < 0.0:
        ax.set_ylim(bottom=0.0)
    elif np.nanmax(values) > 0.0:
        ax.axhline(0.0, color=style.INK, linewidth=0.8, zorder=2)


@style.styled()
def likelihood_curves(tolerances: ToleranceMap) -> Figure:
    """The probability of each label along one swept axis, stacked, over the severity's median and 5 to 95 % band.

    Raises PlotError unless one axis was swept.
    """
    layers = Layers.of(tolerances, 1)
    x = layers.view.x.values
    figure = style.new_figure()
    share, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.3))
    style.set_titles(figure, share, layers.title, layers.subtitle())
    notes = [*_stack_labels(share, tolerances, layers.view), *_draw_severity(ax, tolerances, layers.view)]
    scale_axis(ax, "x", layers.view.x)
    if len(x) > 1:
        ax.set_xlim(x[0], x[-1])
    style.tidy(ax)
    style.freeze_layout(figure, share, notes)
    return figure


def _stack_labels(ax: Axes, tolerances: ToleranceMap, view: View) -> list[Artist]:
    """The probability of each label, stacked; returns their notes."""
    names = (*tolerances.labels, FAILED)
    palette = style.palette_of(tolerances.labels) | {FAILED: style.FAILED_FILL}
    probability = tolerances.probability.reshape(-1, len(names))[view.order[0]]
    shown = [code for code in range(len(names)) if probability[:, code].any()]
    fills = [palette[names[code]] for code in shown]
    ax.stackplot(view.x.values, probability[:, shown].T, colors=fills, edgecolor=style.INK, linewidth=0.5)
    ax.set_ylim(0.0, 1.0)
    ax.set_ylabel("Probability")
    ax.yaxis.set_major_formatter(ticker.PercentFormatter(1.0, symbol=" %"))
    ax.tick_params(bottom=False, labelbottom=False)
    return [style.swatch(names[code], fill) for code, fill in zip(shown, fills, strict=True)]


def _draw_severity(ax: Axes, tolerances: ToleranceMap, view: View) -> list[Artist]:
    """Median, mean and 5 to 95 % band of the severity; returns their notes."""
    ax.set_ylabel(CELL_QUANTITIES["severity"].plot_label)
    x, mean = view.x.values, view.arrange(tolerances.severity_mean)
    low, median, high = (view.arrange(tolerances.severity_quantiles[..., k]) for k in range(len(QUANTILES)))
    if not np.isfinite(median).any():
        ax.text(0.5, 0.5, "not defined", transform=ax.transAxes, ha="center", color=style.FAINT_INK)
        return []
    band = ax.fill_between(x, low, high, color=_COLOUR, alpha=0.25, linewidth=0.0, label="5 to 95 % of the draws")
    (line,) = ax.plot(x, median, color=_COLOUR, linewidth=1.6, label="median")
    (dashed,) = ax.plot(x, mean, color=style.INK, linewidth=1.0, linestyle=(0, (4, 2)), label="mean")
    ax.set_ylim(bottom=0.0)
    return [line, band, dashed]


@style.styled()
def severity_profiles(results: Results, ratios: Sequence[float]) -> Figure:
    """Q over the second axis at the values of the first that are nearest to `ratios`, each maximum marked.

    It is the trend of the report's Figure 4.4: where less backlash makes it worse.

    results : over load ratio and backlash, in this order
    """
    load, backlash = (axis.values for axis in results.axes)
    figure = style.new_figure()
    ax = figure.add_subplot()
    for ratio, colour in zip(ratios, style.LINE_COLOURS, strict=False):
        row = int(np.argmin(np.abs(load - ratio)))
        q = results.severity[row]
        worst = int(np.argmax(q))
        ax.plot(backlash, q, color=colour, linewidth=1.5)
        name = f"{style.symbol_text('σr')} = {load[row]:.3g}"
        ax.annotate(name, (backlash[-1], q[-1]), (5, 0), textcoords="offset points", va="center", color=colour)
        if 0 < worst < q.size - 1:
            ax.plot(backlash[worst], q[worst], "o", color=colour, markeredgecolor="white", markersize=7)
    ax.plot([], [], "o", color=style.INK, label="largest Q for this load ratio")
    ax.legend(frameon=False, loc="upper left")
    ax.set_xlim(backlash[0], backlash[-1])
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(axis_label(results.axes[1]))
    ax.set_ylabel(CELL_QUANTITIES["severity"].plot_label)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_title("Severity over backlash: up to a worst gap, then down", loc="left", fontweight="bold")
    return figure
