"""Severity over the backlash, a curve for each load ratio: where less backlash makes it worse (Figure 4.4's trend)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from clunk.plot.plane import axis_label
from clunk.plot.style import INK, new_figure, styled, symbol_text
from clunk.results.quantities import CELL_QUANTITIES
from clunk.results.regimemap import Results

_COLOURS = ("#d9b310", "#1f9e83", "#2f7fc1", "#7d55a8", "#b8447c", "#dd6b1f")


@styled()
def severity_profiles(results: Results, ratios: Sequence[float]) -> Figure:
    """Q over the second axis at the values of the first that are nearest to `ratios`, each maximum marked.

    results : over load ratio and backlash, in this order
    """
    load, backlash = (axis.values for axis in results.axes)
    figure = new_figure()
    ax = figure.add_subplot()
    for ratio, colour in zip(ratios, _COLOURS, strict=False):
        row = int(np.argmin(np.abs(load - ratio)))
        q = results.severity[row]
        worst = int(np.argmax(q))
        ax.plot(backlash, q, color=colour, linewidth=1.5)
        name = f"{symbol_text('σr')} = {load[row]:.3g}"
        ax.annotate(name, (backlash[-1], q[-1]), (5, 0), textcoords="offset points", va="center", color=colour)
        if 0 < worst < q.size - 1:
            ax.plot(backlash[worst], q[worst], "o", color=colour, markeredgecolor="white", markersize=7)
    ax.plot([], [], "o", color=INK, label="largest Q for this load ratio")
    ax.legend(frameon=False, loc="upper left")
    ax.set_xlim(backlash[0], backlash[-1])
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(axis_label(results.axes[1]))
    ax.set_ylabel(CELL_QUANTITIES["severity"].plot_label)
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_title("Severity over backlash: up to a worst gap, then down", loc="left", fontweight="bold")
    return figure
