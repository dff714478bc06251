"""Sobol indices as bars: the share of the variance of each parameter alone and with all of its interactions."""

from __future__ import annotations

import math
import textwrap
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from clunk.analysis.sobol import CONFIDENCE, Indices, Sensitivity
from clunk.plot import style
from clunk.study.arrays import Positions
from clunk.study.parameters import quantity

_ABREAST = 3  # panels
_BAR = 0.36  # of the distance from one parameter to the next
_BEYOND = 0.02  # of the variance, left and right of what is drawn
_NAMES = 2.0  # inches, the parameters' names
_PANEL = 2.8  # inches
_ROW = 0.5  # inches, a parameter
_AROUND = 0.9  # inches, a panel's heading and axis
_FIRST, _TOTAL = style.LINE_COLOURS[0], style.LINE_COLOURS[1]


@style.styled()
def sobol_bars(sensitivity: Sensitivity) -> Figure:
    """First-order and total index of each parameter with their intervals, a panel for each quantity that varies.

    The parameters are in the order of the first panel's total indices, the largest on top.

    Raises PlotError where no quantity varies.
    """
    drawn = [indices for indices in sensitivity.indices if indices.varies]
    if not drawn:
        raise style.PlotError("There are no indices to draw: every quantity is the same in all runs.")
    columns = 2 if len(drawn) == 4 else min(len(drawn), _ABREAST)
    rows = math.ceil(len(drawn) / columns)
    width = _NAMES + max(columns * _PANEL, 5.0)
    order = drawn[0].order
    figure = style.new_figure((width, 0.9 + rows * (_AROUND + _ROW * max(order.size, 3))))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax in panels[len(drawn) :]:
        ax.remove()
    characters = int(width * 13.5 / columns) - 12  # of a heading
    title = f"{sensitivity.study.title}: {_point(sensitivity)}"
    for ax, indices in zip(panels, drawn, strict=False):
        _draw_bars(ax, indices, order)
        ax.set_title(textwrap.fill(style.capital(indices.heading), characters), loc="left", fontsize=9.0)
    axes = [quantity(sensitivity.parameters[k]) for k in order]
    names = [f"{style.plain(style.capital(axis.name))}, {style.symbol_text(axis.symbol)}" for axis in axes]
    panels[0].set_yticks(np.arange(order.size), names)
    panels[0].set_ylim(order.size - 0.5, -0.5)
    ends = np.array([(indices.first_interval, indices.total_interval) for indices in drawn])
    panels[0].set_xlim(min(0.0, ends.min()) - _BEYOND, max(1.0, ends.max()) + _BEYOND)
    for ax in panels[max(0, len(drawn) - columns) : len(drawn)]:
        ax.set_xlabel("Share of the variance")
        ax.xaxis.set_tick_params(labelbottom=True)
    bar: dict[str, Any] = {"color": style.INK, "linewidth": 1.0, "marker": "|", "markersize": 5}
    notes: list[Artist] = [
        Patch(color=_FIRST, label="alone (first-order index)"),
        Patch(color=_TOTAL, label="in all (total index)"),
        Line2D([], [], **bar, label=f"{100 * CONFIDENCE:g} % interval"),
    ]
    style.lay_out(figure, panels[0], title, panels[0].get_title(loc="left"), notes)
    return figure


def _draw_bars(ax: Axes, indices: Indices, order: Positions) -> None:
    """Draw both indices of each parameter as bars, and their intervals over them."""
    places = np.arange(order.size)
    first, total = (indices.first, indices.first_interval, _FIRST), (indices.total, indices.total_interval, _TOTAL)
    for (share, interval, colour), at in ((first, places - 0.5 * _BAR), (total, places + 0.5 * _BAR)):
        ax.barh(at, share[order], _BAR, color=colour, zorder=2)
        low, high = interval[:, order]
        ax.hlines(at, low, high, color=style.INK, linewidth=1.0, zorder=3)
        ax.plot([low, high], [at, at], "|", color=style.INK, markersize=4.0, markeredgewidth=1.0, zorder=3)
    ax.axvline(0.0, color=style.INK, linewidth=0.8, zorder=4)
    ax.xaxis.set_major_locator(ticker.MultipleLocator(0.2))
    ax.grid(axis="x", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _point(sensitivity: Sensitivity) -> str:
    """The operating point, for example load ratio 5, backlash 6 degrees."""
    axes = ((quantity(parameter), value) for parameter, value in sensitivity.at.items())
    return ", ".join(f"{axis.name} {value:g} {axis.unit.removeprefix('1')}".rstrip() for axis, value in axes)
