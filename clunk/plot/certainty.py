"""Figures of a tolerance map: the most likely regimes and where they are uncertain, probabilities, and severities.

The boundary between two regimes is a band: within it, no label is likelier than `CERTAIN`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colors, ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from clunk.plot.labelling import label_and_note, region_swatch
from clunk.plot.maps import map_titles
from clunk.plot.plane import View, cell_edges, drawn_axes, scale_axes, scale_axis
from clunk.plot.raster import Raster
from clunk.plot.regions import Regions, draw_boundaries, fill_regions, hatch_failed
from clunk.plot.style import (
    FAILED_FILL,
    FAINT_INK,
    HUES,
    INK,
    PlotError,
    cells_phrase,
    failed_notes,
    freeze_layout,
    new_figure,
    palette_of,
    set_notes,
    styled,
    tidy,
)
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.quantities import CELL_QUANTITIES, TOLERANCE_QUANTITIES
from clunk.results.tolerancemap import CERTAIN, QUANTILES, ToleranceMap

Floats = npt.NDArray[np.float64]

_SEVERITIES = {"severity": TOLERANCE_QUANTITIES["severity_mean"].plot_label} | {
    f"severity_{100 * level:g}": f"{100 * level:g} % {TOLERANCE_QUANTITIES['severity_quantiles'].heading_with_unit}"
    for level in QUANTILES
}
QUANTITIES = ("regimes", "double_sided", *_SEVERITIES)

# A cell's colour is taken towards white where its label is less certain than these, by so much.
_FADES = ((CERTAIN, 0.30), (0.8, 0.55), (0.65, 0.80))
_PROBABLE = colors.LinearSegmentedColormap.from_list("probable", ["#f6f5f1", HUES[1]])


def draw(found: ToleranceMap, quantity: str) -> Figure:
    """The figure of a quantity of `QUANTITIES`: a map for two swept axes; curves for one. Raises PlotError."""
    if quantity not in QUANTITIES:
        raise PlotError(f"A tolerance map has no quantity {quantity!r}; it has {', '.join(QUANTITIES)}.")
    if len(drawn_axes(found)) == 1:
        return likelihood_curves(found)
    if quantity == "regimes":
        return likely_regimes(found)
    return double_sided_map(found) if quantity == "double_sided" else severity_map(found, quantity)


def default_quantities(found: ToleranceMap) -> list[str]:
    """What is drawn where nothing is named. Under the restitution model there is no severity."""
    if len(drawn_axes(found)) == 1:
        return ["regimes"]
    return ["regimes", "double_sided"] + ["severity"] * bool(np.isfinite(found.severity_mean).any())


def likely_regimes(found: ToleranceMap) -> Figure:
    """The most likely label of every cell, paler where it is less certain, and the band where it is uncertain.

    Raises PlotError unless two axes were swept.
    """
    view = View.of(found, 2)
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        map_titles(figure, ax, found, view, f"most likely of {found.draws:,} draws")
        scale_axes(ax, view)
        labels, codes = _present(found.labels, view.arrange(found.sequence))
        regions = Regions(codes)
        fill_regions(ax, view, regions, labels)
        _fade(ax, view, view.arrange(found.certainty))
        draw_boundaries(ax, view, regions, color=INK, linewidth=0.9)
        label_and_note(
            figure,
            ax,
            labels,
            codes,
            lambda: Raster.of(ax, regions, view),
            leaders=True,
            more=_fade_notes(found),
        )
        return figure


def double_sided_map(found: ToleranceMap) -> Figure:
    """How probable a double-sided impact is in every cell. Raises PlotError unless two axes were swept."""
    view = View.of(found, 2)
    values = view.arrange(found.double_sided)
    with styled():
        figure, ax, bar = _value_map(found, view, values, "dark", cmap=_PROBABLE, vmin=0.0, vmax=1.0)
        bar.set_label("Probability of a double-sided impact")
        bar.formatter = ticker.PercentFormatter(1.0, symbol=" %")
        bar.update_ticks()
        set_notes(figure, failed_notes(view.arrange(found.sequence)))
        freeze_layout(figure, ax)
        return figure


def severity_map(found: ToleranceMap, name: str = "severity") -> Figure:
    """The mean severity of every cell's draws, or a quantile of it, under the most likely regimes' boundaries.

    Raises PlotError unless two axes were swept and Q is defined somewhere.
    """
    view = View.of(found, 2)
    values = view.arrange(_severity(found, name))
    with styled():
        figure, ax, bar = _value_map(found, view, values, "light", cmap="viridis")
        bar.set_label(_SEVERITIES[name])
        set_notes(figure, failed_notes(view.arrange(found.sequence)))
        freeze_layout(figure, ax)
        return figure


def likelihood_curves(found: ToleranceMap) -> Figure:
    """Along one swept axis: how probable each label is, stacked, over the severity's median and 5 to 95 % band.

    Raises PlotError unless one axis was swept.
    """
    view = View.of(found, 1)
    x = view.x.values
    probability = found.probability.reshape(-1, len(found.labels) + 1)[view.order[0]]
    palette = palette_of(found.labels) | {FAILED: FAILED_FILL}
    names = (*found.labels, FAILED)
    shown = [code for code in range(len(names)) if probability[:, code].any()]
    with styled():
        figure = new_figure()
        share, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 1.3))
        map_titles(figure, share, found, view, f"{found.draws:,} draws")
        look: dict[str, Any] = {"colors": [palette[names[code]] for code in shown], "edgecolor": INK, "linewidth": 0.5}
        share.stackplot(x, probability[:, shown].T, **look)
        share.set_ylim(0.0, 1.0)
        share.set_ylabel("Probability")
        share.yaxis.set_major_formatter(ticker.PercentFormatter(1.0, symbol=" %"))
        share.tick_params(bottom=False, labelbottom=False)
        notes: list[Artist] = [region_swatch(names[code], palette[names[code]]) for code in shown]
        low, median, high = view_quantiles(found, view)
        if np.isfinite(median).any():
            band = ax.fill_between(
                x, low, high, color=HUES[1], alpha=0.25, linewidth=0.0, label="5 to 95 % of the draws"
            )
            (line,) = ax.plot(x, median, color=HUES[1], linewidth=1.6, label="median")
            mean = view.arrange(found.severity_mean)
            (dashed,) = ax.plot(x, mean, color=INK, linewidth=1.0, linestyle=(0, (4, 2)), label="mean")
            ax.set_ylim(bottom=0.0)
            notes += [line, band, dashed]
        else:
            ax.text(0.5, 0.5, "not defined", transform=ax.transAxes, ha="center", color=FAINT_INK)
        ax.set_ylabel(CELL_QUANTITIES["severity"].plot_label)
        scale_axis(ax, "x", view.x)
        if len(x) > 1:
            ax.set_xlim(x[0], x[-1])
        tidy(ax)
        set_notes(figure, notes)
        freeze_layout(figure, share)
        return figure


def view_quantiles(found: ToleranceMap, view: View) -> tuple[Floats, ...]:
    """The severity's quantiles as a view has them."""
    return tuple(view.arrange(found.severity_quantiles[..., k]) for k in range(len(QUANTILES)))


def _severity(found: ToleranceMap, name: str) -> Floats:
    values = found.severity_mean
    if name != "severity":
        values = found.severity_quantiles[..., list(_SEVERITIES).index(name) - 1]
    if np.isnan(values).all():
        raise PlotError(
            f"There is no {name} to draw: it is not defined in any cell; under the restitution model accelerations are "
            "impulsive."
        )
    return values


def _value_map(
    found: ToleranceMap, view: View, values: Floats, lines: str, **look: Any
) -> tuple[Figure, Axes, Colorbar]:
    """A quantity of every cell as colour under dark or light boundaries, and its bar."""
    figure = new_figure()
    ax = figure.add_subplot()
    more = f"{found.draws:,} draws; {lines} lines: boundaries of the most likely regimes"
    map_titles(figure, ax, found, view, more)
    scale_axes(ax, view)
    mesh = ax.pcolormesh(
        cell_edges(view.x),
        cell_edges(view.y),
        values.T,
        rasterized=True,  # a vector file with a path for every cell would take seconds to show
        zorder=0.5,
        **look,
    )
    regions = Regions(view.arrange(found.sequence))
    hatch_failed(ax, view, regions)
    draw_boundaries(ax, view, regions, color=INK if lines == "dark" else "white", linewidth=0.6)
    return figure, ax, figure.colorbar(mesh, ax=ax, pad=0.02, aspect=28)


def _present(labels: tuple[str, ...], codes: npt.NDArray[np.int16]) -> tuple[tuple[str, ...], npt.NDArray[np.int16]]:
    """The labels that are the most likely one somewhere, and the codes numbered by them."""
    present = [code for code in range(len(labels)) if (codes == code).any()]
    renumbered = np.full(codes.shape, FAILED_CODE, np.int16)
    for number, code in enumerate(present):
        renumbered[codes == code] = number
    return tuple(labels[code] for code in present), renumbered


def _fade(ax: Axes, view: View, certainty: Floats) -> None:
    """White over what is less certain, the more the less it is, and a line around the band."""
    levels = [-1.0, *(below for below, _ in _FADES[::-1])]
    white = [(1.0, 1.0, 1.0, amount) for _, amount in _FADES[::-1]]
    x, y = view.x.values, view.y.values
    if certainty.min() < CERTAIN:
        ax.contourf(x, y, certainty.T, levels=levels, colors=white, zorder=1.5)
        if certainty.max() > CERTAIN:
            look: dict[str, Any] = {"colors": [FAINT_INK], "linewidths": 0.5, "linestyles": [(0, (3.0, 2.0))]}
            ax.contour(x, y, certainty.T, levels=[CERTAIN], zorder=2, **look)


def _fade_notes(found: ToleranceMap) -> list[Artist]:
    """How many cells the band has, and how certain each shade is."""
    base = np.array(colors.to_rgb(FAINT_INK))
    ends = [*(below for below, _ in _FADES[1:]), 0.0]
    text = f"less than {100 * CERTAIN:.0f} % likely: {cells_phrase(found.uncertain)}"
    notes: list[Artist] = [Patch(facecolor="none", edgecolor=FAINT_INK, linewidth=0.5, linestyle="--", label=text)]
    for (below, amount), end in zip(_FADES, ends, strict=True):
        span = f"paler: {100 * end:.0f} to {100 * below:.0f} %" if end else f"below {100 * below:.0f} %"
        notes.append(region_swatch(span, colors.to_hex(tuple(base + amount * (1.0 - base)))))
    return notes
