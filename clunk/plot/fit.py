"""Figures of fits: the ensemble, and the labels' probabilities. The maps before and after are in `comparisons`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.analysis.fitted import Fitted, weighted_quantiles
from clunk.plot import style
from clunk.study.arrays import Floats
from clunk.study.parameters import quantity

_PANEL = 1.9  # inches, of the corner plot
_ROW = 0.24  # inches, of a measurement
_BARS = 7.2  # inches, width
_SHOWN = 1500  # draws
_BINS = 30
_ENDS = (0.002, 0.998)  # quantiles of the ensemble, between which it is drawn
_LEAST = 0.02  # probability of a label that is in the legend
_ENSEMBLE, _ESTIMATE = style.LINE_COLOURS[0], style.LINE_COLOURS[1]


@style.styled()
def corner(fitted: Fitted) -> Figure:
    """The ensemble: each parameter's distribution, and each two together; the lines are the best candidate's."""
    count = len(fitted.priors)
    figure = style.new_figure((1.2 + max(count, 2) * _PANEL, 1.2 + max(count, 2) * _PANEL))
    grid = figure.subplots(count, count, squeeze=False, sharex="col")
    picked = np.random.default_rng(fitted.fit.seed).choice(len(fitted.weights), _SHOWN, p=fitted.weights)
    draws, ends = fitted.draws[picked], weighted_quantiles(fitted.draws, fitted.weights, _ENDS)
    names = [_name(fitted, k) for k in range(count)]
    for row in range(count):
        for column in range(count):
            ax = grid[row, column]
            if column > row:
                ax.remove()
                continue
            if column == row:
                _draw_one(ax, fitted, row, ends[row])
            else:
                ax.scatter(draws[:, column], draws[:, row], s=3.0, color=_ENSEMBLE, alpha=0.25, linewidths=0)
                ax.axhline(fitted.estimate[row], color=_ESTIMATE, linewidth=0.9)
                ax.axvline(fitted.estimate[column], color=_ESTIMATE, linewidth=0.9)
                ax.set_ylim(_around(ends[row], fitted.estimate[row]))
            if column == 0 and row > 0:
                ax.set_ylabel(names[row])
            elif column != row:
                ax.tick_params(labelleft=False)
            if row == count - 1:
                ax.set_xlabel(names[column])
            ax.tick_params(labelsize=8.0)
            ax.xaxis.set_major_locator(ticker.MaxNLocator(4))
    line = f"{len(fitted.weights):,} draws, effectively {fitted.effective:.0f}; lines: best candidate; dashed: prior"
    style.lay_out(figure, grid[0, 0], f"{fitted.study.title}: ensemble", line)
    return figure


def _draw_one(ax: Axes, fitted: Fitted, k: int, ends: Floats) -> None:
    """Draw the distribution of a parameter, its interval and its prior."""
    low, high = _around(ends, fitted.estimate[k])
    edges = np.linspace(low, high, _BINS + 1)
    heights, _ = np.histogram(fitted.draws[:, k], edges, weights=fitted.weights)
    ax.stairs(heights / np.diff(edges), edges, fill=True, color=_ENSEMBLE, alpha=0.5)
    shares = np.linspace(0.0, 1.0, 2001)[1:-1]
    below = np.interp(edges, fitted.prior_intervals(tuple(shares))[k], shares, 0.0, 1.0)
    ax.stairs(np.diff(below) / np.diff(edges), edges, color=style.INK, linestyle="--", linewidth=0.8)
    ax.axvline(fitted.estimate[k], color=_ESTIMATE, linewidth=1.2)
    for bound in fitted.intervals()[k]:
        ax.axvline(bound, color=_ENSEMBLE, linewidth=0.8)
    ax.set_xlim(low, high)
    ax.set_yticks([])


def _around(ends: Floats, estimate: float) -> tuple[float, float]:
    """Limits that hold the ensemble's ends and the estimate."""
    low, high = min(ends[0], estimate), max(ends[1], estimate)
    beyond = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return float(low - beyond), float(high + beyond)


def _name(fitted: Fitted, k: int) -> str:
    """Name of a parameter, and its unit where it is no factor."""
    prior = fitted.priors[k]
    described = quantity(prior.parameter)
    symbol = style.symbol_text(style.bare(described.symbol)) or style.plain(described.name)
    unit = "" if described.unit == "1" else f" [{described.unit}]"
    return {"factor": f"factor of {symbol}", "offset": f"offset of {symbol}{unit}"}.get(prior.draws, symbol + unit)


@style.styled()
def label_probabilities(fitted: Fitted) -> Figure:
    """The ensemble's probability of each label at each measured point; the measured label's part is framed."""
    measurements, shares = fitted.experiment.measurements, fitted.probabilities
    labels = tuple(dict.fromkeys([*(each.label for each in measurements), *(text for each in shares for text in each)]))
    palette = style.palette_of(labels)
    figure = style.new_figure((_BARS, 1.3 + _ROW * len(measurements)))
    ax = figure.add_subplot()
    for row, (measurement, probabilities) in enumerate(zip(measurements, shares, strict=True)):
        left = 0.0
        for text, share in probabilities.items():
            is_measured = text == measurement.label
            look: dict[str, Any] = {
                "edgecolor": style.INK if is_measured else "white",
                "linewidth": 1.4 if is_measured else 0.4,
            }
            ax.barh(row, share, left=left, height=0.78, color=palette.get(text, style.FAILED_FILL), **look)
            left += share
    symbols = [style.symbol_text(style.bare(quantity(axis).symbol)) or axis for axis in fitted.axes]
    names = [
        ", ".join(f"{symbol} = {value:g}" for symbol, value in zip(symbols, each.values, strict=True))
        + f":  {each.label}"
        for each in measurements
    ]
    ax.set_yticks(range(len(names)), names, fontsize=8.0)
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.set_xlim(0.0, 1.0)
    ax.set_xlabel("probability of the label")
    frequent = [text for text in labels if any(each.get(text, 0.0) >= _LEAST for each in shares)]
    line = f"framed: the measured label; ensemble of {len(fitted.weights):,} draws"
    notes = [style.swatch(text, palette.get(text, style.FAILED_FILL)) for text in frequent]
    style.lay_out(figure, ax, f"{fitted.study.title}: predicted labels", line, notes)
    return figure


FIGURES: dict[str, Callable[[Fitted], Figure]] = {"ensemble": corner, "labels": label_probabilities}
