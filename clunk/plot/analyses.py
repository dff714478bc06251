"""Figures of analyses: a fit's ensemble and predicted labels, Sobol indices, a front of optima."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.analysis.fitted import Fitted
from clunk.analysis.optimisation import Front
from clunk.analysis.sobol import CONFIDENCE, Sensitivity
from clunk.plot import style
from clunk.plot.comparisons import measured_on_maps
from clunk.study.arrays import Floats
from clunk.study.parameters import nominal_value, quantity

_SIDE = 1.9  # inches, of a panel of the corner plot
_SHOWN = 1500  # draws
_BINS = 30
_LEAST = 0.02  # probability of a label that is in the legend
_WIDTH = 7.2  # inches, of charts of bars
_BAR = 0.36  # of the distance from one parameter to the next
_INTERVAL = {"ecolor": style.INK, "elinewidth": 1.0, "capsize": 2.0}
_FIRST, _SECOND = style.LINE_COLOURS[:2]


@style.styled()
def corner(fitted: Fitted) -> Figure:
    """The ensemble: each parameter's distribution, and each two together; the lines are the best candidate's."""
    count = len(fitted.priors)
    side = 1.2 + max(count, 2) * _SIDE
    figure = style.new_figure((side, side))
    grid = figure.subplots(count, count, squeeze=False, sharex="col")
    picked = np.random.default_rng(fitted.fit.seed).choice(len(fitted.weights), _SHOWN, p=fitted.weights)
    draws, names = fitted.draws[picked], [_name(fitted, k) for k in range(count)]
    for (row, column), ax in np.ndenumerate(grid):
        if column > row:
            ax.remove()
            continue
        ax.axvline(fitted.estimate[column], color=_SECOND, linewidth=0.9)
        ax.xaxis.set_major_locator(ticker.MaxNLocator(4))
        ax.tick_params(labelsize=8.0, labelleft=column == 0)
        if column == row:
            _draw_distribution(ax, fitted, row, draws[:, row])
        else:
            ax.scatter(draws[:, column], draws[:, row], s=3.0, color=_FIRST, alpha=0.25, linewidths=0)
            ax.axhline(fitted.estimate[row], color=_SECOND, linewidth=0.9)
    for k in range(count):
        grid[-1, k].set_xlabel(names[k])
        if k:
            grid[k, 0].set_ylabel(names[k])
    line = f"{len(fitted.weights):,} draws, effectively {fitted.effective:.0f}; lines: best candidate; dashed: prior"
    style.lay_out(figure, grid[0, 0], f"{fitted.study.title}: ensemble", line)
    return figure


def _draw_distribution(ax: Axes, fitted: Fitted, k: int, draws: Floats) -> None:
    """Draw the shares of a parameter's draws in bins, its interval and its prior."""
    prior, edges = fitted.priors[k], np.histogram_bin_edges(draws, _BINS)
    shares = np.linspace(0.0, 1.0, 2001)[1:-1]
    before = prior.quantiles(shares, nominal_value(fitted.study, prior.parameter))
    ax.stairs(np.histogram(draws, edges)[0] / draws.size, edges, fill=True, color=_FIRST, alpha=0.5)
    of_prior = np.histogram(before, edges)[0] / before.size
    ax.stairs(of_prior, edges, color=style.INK, linestyle="--", linewidth=0.8)
    for bound in fitted.intervals()[k]:
        ax.axvline(bound, color=_FIRST, linewidth=0.8)
    ax.set_yticks([])


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
    measured = fitted.measured
    figure = style.new_figure((_WIDTH, 1.3 + 0.24 * len(measured)))
    ax = figure.add_subplot()
    notes: dict[str, Artist] = {}
    for row, each in enumerate(measured):
        left = 0.0
        for label, share in each.probabilities.items():
            is_measured = label == each.label
            look: dict[str, Any] = {"edgecolor": style.INK, "linewidth": 1.4} if is_measured else {"edgecolor": "white"}
            colour = style.colour_of(label)
            ax.barh(row, share, left=left, height=0.78, color=colour, **look)
            left += share
            if share >= _LEAST:
                notes[label] = style.swatch(label, colour)
    symbols = [style.symbol_text(style.bare(quantity(axis).symbol)) or axis for axis in fitted.axes]
    names = []
    for each in measured:
        values = (f"{symbol} = {value:g}" for symbol, value in zip(symbols, each.at.values(), strict=True))
        names.append(f"{', '.join(values)}:  {each.label}")
    ax.set_yticks(range(len(names)), names, fontsize=8.0)
    ax.set(xlim=(0.0, 1.0), ylim=(len(names) - 0.4, -0.6), xlabel="probability of the label")
    line = f"framed: the measured label; ensemble of {len(fitted.weights):,} draws"
    style.lay_out(figure, ax, f"{fitted.study.title}: predicted labels", line, list(notes.values()))
    return figure


FIGURES: dict[str, Callable[[Fitted], Figure]] = {
    "maps": measured_on_maps,
    "ensemble": corner,
    "labels": label_probabilities,
}


@style.styled()
def sobol_bars(sensitivity: Sensitivity) -> Figure:
    """First-order and total index of each parameter with their intervals, a panel for each quantity that varies.

    The parameters are in the order of the first panel's total indices, the largest on top.

    Raises PlotError where no quantity varies.
    """
    drawn = [(each.heading, each.indices) for each in sensitivity.indices if each.indices]
    if not drawn:
        raise style.PlotError("There are no indices to draw: every quantity is the same in all runs.")
    parameters = [*drawn[0][1]]
    figure, panels = style.new_panels(len(drawn), 1, (_WIDTH, 1.0 + len(drawn) * (0.6 + 0.45 * len(parameters))))
    places = np.arange(len(parameters))
    for ax, (heading, shares) in zip(panels, drawn, strict=True):
        ordered = [shares[parameter] for parameter in parameters]
        first = [(each.first, *each.first_interval) for each in ordered]
        total = [(each.total, *each.total_interval) for each in ordered]
        for values, colour, at in ((first, _FIRST, places - 0.5 * _BAR), (total, _SECOND, places + 0.5 * _BAR)):
            share, *interval = np.transpose(values)
            ax.barh(at, share, _BAR, color=colour, xerr=np.abs(interval - share), error_kw=_INTERVAL)
        ax.axvline(0.0, color=style.INK, linewidth=0.8)
        ax.set_title(style.capital(heading), loc="left", fontsize=9.0)
        style.tidy(ax, "x")
    axes = [*map(quantity, parameters)]
    names = [f"{style.plain(style.capital(axis.name))}, {style.symbol_text(axis.symbol)}" for axis in axes]
    panels[0].set_yticks(places, names)
    panels[0].set_ylim(len(parameters) - 0.5, -0.5)
    panels[-1].set_xlabel(f"Share of the variance, with {100 * CONFIDENCE:g} % intervals")
    notes = [style.swatch("alone (first-order index)", _FIRST), style.swatch("in all (total index)", _SECOND)]
    point = ((quantity(parameter), value) for parameter, value in sensitivity.at.items())
    line = ", ".join(f"{axis.name} {value:g} {axis.unit.removeprefix('1')}".rstrip() for axis, value in point)
    style.lay_out(figure, panels[0], sensitivity.study.title, line, notes)
    return figure


@style.styled()
def trade_off(front: Front) -> Figure:
    """What is minimised over the quantity that is bounded, a point for each optimum."""
    figure = style.new_figure()
    ax = figure.add_subplot()
    minimized, bounded = ([best.quantities[name] for best in front.points] for name in front.traded)
    ax.plot(bounded, minimized, "o-", color=style.INK)
    ax.set(xlabel=front.traded[1], ylabel=front.traded[0])
    style.tidy(ax)
    style.lay_out(figure, ax, front.points[0].study.title, f"the least {front.traded[0]} for each {front.traded[1]}")
    return figure
