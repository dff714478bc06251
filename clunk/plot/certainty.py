"""Figures of a tolerance map: the most likely regimes and where they are uncertain, probabilities, and severities.

The boundary between two regimes is a band: within it, no label is likelier than `CERTAIN`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib import colors, ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from clunk.plot import style
from clunk.plot.labelling import label_and_note
from clunk.plot.layers import Layers
from clunk.plot.notes import cells_phrase, set_notes, swatch
from clunk.plot.painting import Colours, new_map, paint_regimes, shaded_map
from clunk.plot.plane import View, drawn_axes, scale_axis
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import CELL_QUANTITIES, TOLERANCE_QUANTITIES
from clunk.results.tolerancemap import CERTAIN, QUANTILES, ToleranceMap
from clunk.study.arrays import Floats

_SEVERITIES = {"severity": TOLERANCE_QUANTITIES["severity_mean"].plot_label} | {
    f"severity_{100 * level:g}": f"{100 * level:g} % {TOLERANCE_QUANTITIES['severity_quantiles'].heading_with_unit}"
    for level in QUANTILES
}
# by name, what its colours or its curve stand for
QUANTITIES = {"regimes": "regimes", "double_sided": "Probability of a double-sided impact", **_SEVERITIES}

# A cell's colour is taken towards white where its label is less certain than these, by so much.
_FADES = ((CERTAIN, 0.30), (0.8, 0.55), (0.65, 0.80))
_PROBABLE = colors.LinearSegmentedColormap.from_list("probable", ["#f6f5f1", style.HUES[1]])


def draw(tolerances: ToleranceMap, quantity: str) -> Figure:
    """The figure of a quantity of `QUANTITIES`: a map for two swept axes; curves for one. Raises PlotError."""
    if quantity not in QUANTITIES:
        raise style.PlotError(f"A tolerance map has no quantity {quantity!r}; it has {', '.join(QUANTITIES)}.")
    if len(drawn_axes(tolerances)) == 1:
        return likelihood_curves(tolerances)
    if quantity == "regimes":
        return likely_regimes(tolerances)
    return _quantity_map(tolerances, quantity)


def layers_of_quantity(tolerances: ToleranceMap, dimensions: int, name: str) -> tuple[Layers, Colours]:
    """Layers of a quantity over this many axes, and its colours. Raises PlotError where it is not defined."""
    values = tolerances.double_sided if name == "double_sided" else _severity(tolerances, name)
    layers = Layers.of(tolerances, dimensions, name, values)
    if name == "double_sided":
        percent = ticker.PercentFormatter(1.0, symbol=" %")
        return layers, Colours(QUANTITIES[name], colors.Normalize(0.0, 1.0), _PROBABLE, formatter=percent)
    return layers, Colours(QUANTITIES[name], colors.Normalize(np.nanmin(values), np.nanmax(values)))


def likely_layers(tolerances: ToleranceMap, dimensions: int) -> Layers:
    """Layers of the most likely labels, without those that are nowhere the most likely one."""
    layers = Layers.of(tolerances, dimensions)
    present = [layers.labels.index(label) for label in layers.present]
    codes = np.where(layers.failed, FAILED_CODE, np.searchsorted(present, layers.codes)).astype(np.int16)
    return replace(layers, labels=tuple(layers.present), codes=codes)


def paleness(certainty: Floats) -> Floats:
    """Share of white in each cell's colour, 0 to 1, by the probability of its most likely label."""
    amounts = np.zeros(certainty.shape)
    for below, amount in _FADES:
        amounts[certainty < below] = amount
    return amounts


def default_quantities(tolerances: ToleranceMap) -> list[str]:
    """Quantities that are drawn where none is named. Under the restitution model there is no severity."""
    if len(drawn_axes(tolerances)) == 1:
        return ["regimes"]
    return ["regimes", "double_sided"] + ["severity"] * bool(np.isfinite(tolerances.severity_mean).any())


@style.styled()
def likely_regimes(tolerances: ToleranceMap) -> Figure:
    """The most likely label of every cell, paler where it is less certain, and the band where it is uncertain.

    Raises PlotError unless two axes were swept.
    """
    layers = likely_layers(tolerances, 2)
    figure, ax = new_map(layers, f"most likely of {tolerances.draws:,} draws")
    paint_regimes(ax, layers)
    _fade(ax, layers.view, layers.view.arrange(tolerances.certainty))
    label_and_note(figure, ax, layers, _fade_notes(tolerances))
    return figure


@style.styled()
def _quantity_map(tolerances: ToleranceMap, name: str) -> Figure:
    """A probability or a severity of every cell as colour, under the most likely regimes' boundaries."""
    layers, colours = layers_of_quantity(tolerances, 2, name)
    lines = layers.boundaries_note.replace("the regimes", "the most likely regimes")
    figure, ax = shaded_map(layers, colours, f"{tolerances.draws:,} draws; {lines}")
    style.freeze_layout(figure, ax)
    return figure


@style.styled()
def likelihood_curves(tolerances: ToleranceMap) -> Figure:
    """The probability of each label along one swept axis, stacked, over the severity's median and 5 to 95 % band.

    Raises PlotError unless one axis was swept.
    """
    layers = Layers.of(tolerances, 1)
    x = layers.view.x.values
    figure = style.new_figure()
    share, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.3))
    style.set_titles(figure, share, layers.title, layers.subtitle(f"{tolerances.draws:,} draws"))
    notes = [*_stack_labels(share, tolerances, layers.view), *_draw_severity(ax, tolerances, layers.view)]
    scale_axis(ax, "x", layers.view.x)
    if len(x) > 1:
        ax.set_xlim(x[0], x[-1])
    style.tidy(ax)
    set_notes(figure, notes)
    style.freeze_layout(figure, share)
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
    return [swatch(names[code], fill) for code, fill in zip(shown, fills, strict=True)]


def _draw_severity(ax: Axes, tolerances: ToleranceMap, view: View) -> list[Artist]:
    """Median, mean and 5 to 95 % band of the severity; returns their notes."""
    ax.set_ylabel(CELL_QUANTITIES["severity"].plot_label)
    x, mean = view.x.values, view.arrange(tolerances.severity_mean)
    low, median, high = (view.arrange(tolerances.severity_quantiles[..., k]) for k in range(len(QUANTILES)))
    if not np.isfinite(median).any():
        ax.text(0.5, 0.5, "not defined", transform=ax.transAxes, ha="center", color=style.FAINT_INK)
        return []
    band = ax.fill_between(x, low, high, color=style.HUES[1], alpha=0.25, linewidth=0.0, label="5 to 95 % of the draws")
    (line,) = ax.plot(x, median, color=style.HUES[1], linewidth=1.6, label="median")
    (dashed,) = ax.plot(x, mean, color=style.INK, linewidth=1.0, linestyle=(0, (4, 2)), label="mean")
    ax.set_ylim(bottom=0.0)
    return [line, band, dashed]


def _severity(tolerances: ToleranceMap, name: str) -> Floats:
    """The mean of the severity, or a quantile. Raises PlotError where it is not defined."""
    values = tolerances.severity_mean
    if name != "severity":
        values = tolerances.severity_quantiles[..., list(_SEVERITIES).index(name) - 1]
    if np.isnan(values).all():
        raise style.PlotError(
            f"There is no {name} to draw: it is not defined in any cell; under the restitution model accelerations are "
            "impulsive."
        )
    return values


def _fade(ax: Axes, view: View, certainty: Floats) -> None:
    """Lay white over the cells, the more the less certain they are, and draw a line around the band."""
    levels = [-1.0, *(below for below, _ in _FADES[::-1])]
    white = [(1.0, 1.0, 1.0, amount) for _, amount in _FADES[::-1]]
    x, y = view.x.values, view.y.values
    if certainty.min() < CERTAIN:
        ax.contourf(x, y, certainty.T, levels=levels, colors=white, zorder=1.5)
        if certainty.max() > CERTAIN:
            look: dict[str, Any] = {"colors": [style.FAINT_INK], "linewidths": 0.5, "linestyles": [(0, (3.0, 2.0))]}
            ax.contour(x, y, certainty.T, levels=[CERTAIN], zorder=2, **look)


def _fade_notes(tolerances: ToleranceMap) -> list[Artist]:
    """Number of cells of the band, and how certain each shade is."""
    base = np.array(colors.to_rgb(style.FAINT_INK))
    ends = [*(below for below, _ in _FADES[1:]), 0.0]
    text = f"less than {100 * CERTAIN:.0f} % likely: {cells_phrase(tolerances.uncertain)}"
    look: dict[str, Any] = {"facecolor": "none", "edgecolor": style.FAINT_INK, "linewidth": 0.5, "linestyle": "--"}
    notes: list[Artist] = [Patch(label=text, **look)]
    for (below, amount), end in zip(_FADES, ends, strict=True):
        span = f"paler: {100 * end:.0f} to {100 * below:.0f} %" if end else f"below {100 * below:.0f} %"
        notes.append(swatch(span, colors.to_hex(tuple(base + amount * (1.0 - base)))))
    return notes
