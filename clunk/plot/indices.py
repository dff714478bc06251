"""Sobol indices as bars: a parameter's own share of the variance beside its share with all of its interactions."""

from __future__ import annotations

import math
import textwrap

import numpy as np
import numpy.typing as npt
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from clunk.analysis.sobol import CONFIDENCE, Indices, Sensitivity
from clunk.plot.style import (
    INK,
    LINE_COLOURS,
    PlotError,
    freeze_layout,
    new_figure,
    plain,
    set_titles,
    styled,
    symbol_text,
)
from clunk.study.config import quantity

_ABREAST = 3  # panels
_BAR = 0.36  # of the distance from one parameter to the next
_BEYOND = 0.02  # of the variance, left and right of what is drawn
_NAMES = 2.0  # inches, the parameters' names
_PANEL = 2.8  # inches
_ROW = 0.5  # inches, a parameter
_AROUND = 0.9  # inches, a panel's heading and axis
_FIRST, _TOTAL = LINE_COLOURS[0], LINE_COLOURS[1]


def sobol_bars(found: Sensitivity) -> Figure:
    """First-order and total index of each parameter with their intervals, a panel for each quantity that varies.

    The parameters are in the order of the first panel's total indices, the largest on top.

    Raises PlotError where no quantity varies.
    """
    drawn = [indices for indices in found.indices if indices.varies]
    if not drawn:
        raise PlotError("There are no indices to draw: every quantity is the same in all runs.")
    columns = 2 if len(drawn) == 4 else min(len(drawn), _ABREAST)
    rows = math.ceil(len(drawn) / columns)
    width = _NAMES + max(columns * _PANEL, 5.0)
    order = drawn[0].order
    with styled():
        figure = new_figure((width, 0.9 + rows * (_AROUND + _ROW * max(order.size, 3))))
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for ax in panels[len(drawn) :]:
            ax.remove()
        wrapped = int(width * 13.5 / columns) - 12  # characters of a heading
        headings = [textwrap.fill(_capital(indices.heading), wrapped) for indices in drawn]
        for ax, indices, heading in zip(panels, drawn, headings, strict=False):
            _draw_bars(ax, indices, order)
            set_titles(figure, ax, f"{found.study.title}: {_point(found)}", heading)
        names = [_name(found.parameters[k]) for k in order]
        panels[0].set_yticks(np.arange(order.size), names)
        panels[0].set_ylim(order.size - 0.5, -0.5)
        ends = np.concatenate([[0.0, 1.0], *(indices.first_interval.ravel() for indices in drawn)])
        ends = np.concatenate([ends, *(indices.total_interval.ravel() for indices in drawn)])
        panels[0].set_xlim(ends.min() - _BEYOND, ends.max() + _BEYOND)
        for ax in panels[max(0, len(drawn) - columns) : len(drawn)]:
            ax.set_xlabel("Share of the variance")
            ax.xaxis.set_tick_params(labelbottom=True)
        interval = Line2D(
            [], [], color=INK, linewidth=1.0, marker="|", markersize=5, label=f"{100 * CONFIDENCE:g} % interval"
        )
        bars = [
            Patch(color=_FIRST, label="alone (first-order index)"),
            Patch(color=_TOTAL, label="in all (total index)"),
        ]
        figure.legend(handles=[*bars, interval], loc="outside lower center", ncols=3, frameon=False, handlelength=1.6)
        freeze_layout(figure, panels[0])
        return figure


def _draw_bars(ax: Axes, indices: Indices, order: npt.NDArray[np.intp]) -> None:
    places = np.arange(order.size)
    pairs = (
        (indices.first, indices.first_interval, -0.5, _FIRST),
        (indices.total, indices.total_interval, 0.5, _TOTAL),
    )
    for share, interval, offset, colour in pairs:
        at = places + offset * _BAR
        ax.barh(at, share[order], _BAR, color=colour, zorder=2)
        low, high = interval[:, order]
        ax.hlines(at, low, high, color=INK, linewidth=1.0, zorder=3)
        ax.plot([low, high], [at, at], "|", color=INK, markersize=4.0, markeredgewidth=1.0, zorder=3)
    ax.axvline(0.0, color=INK, linewidth=0.8, zorder=4)
    ax.xaxis.set_major_locator(ticker.MultipleLocator(0.2))
    ax.grid(axis="x", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right", "left"]].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _point(found: Sensitivity) -> str:
    """The operating point, for example load ratio 5, backlash 6 degrees."""
    known = {parameter: quantity(parameter) for parameter in found.at}
    values = (f"{known[key].name} {value:g} {known[key].unit.removeprefix('1')}" for key, value in found.at.items())
    return ", ".join(value.rstrip() for value in values)


def _name(parameter: str) -> str:
    """A parameter's name and symbol."""
    known = quantity(parameter)
    return f"{plain(_capital(known.name))}, {symbol_text(known.symbol)}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
