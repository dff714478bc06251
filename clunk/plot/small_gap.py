"""The response as the backlash vanishes, like the report's Figure 3.5."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot.style import (
    DASHED,
    FAINT_INK,
    HISTORY_WIDTH,
    INK,
    LINE_COLOURS,
    MINUS,
    freeze_layout,
    new_figure,
    set_titles,
    styled,
    symbol_text,
    tidy,
)
from clunk.simulation.small_gap import SmallGap


def small_gap(title: str, response: SmallGap) -> Figure:
    """The response as the backlash vanishes, and how long the lowest mode lifts it off its flank (Figure 3.5).

    With no gap to cross, the lash stays closed and its torque F changes sign instead. With the lowest mode alone it
    swings within F_end ± ΔF exp(-ζ1 ω1 t); one side of this crosses zero at the characteristic time t_c, and
    n_c = t_c ω1 / 2π = ln(σr) / (2π ζ1) periods fit in (report Eq. 3.1, where 2π is missing), with σr = ΔF / F_end.
    """
    symbol = symbol_text
    values = f"{symbol('σr')} = {response.ratio:.4g}, {symbol('ζ1')} = {response.damping_ratio:.3f}"
    if response.periods > 0.0 and np.isfinite(response.periods):
        time = f"{symbol('tc')} - {symbol('t0')} = {response.characteristic_time:.3g} s"
        formula = f"{symbol('nc')} = ln({symbol('σr')}) / (2π {symbol('ζ1')}) = {response.periods:.2f}"
        text = f"{values}: {formula} periods of {1.0 / response.frequency:.3g} s until {time.replace('-', MINUS)}"
    else:
        text = f"{values}: the exponential decay never crosses zero"
    with styled():
        figure = new_figure((HISTORY_WIDTH, 4.8))
        ax = figure.add_subplot()
        _draw_small_gap(ax, response)
        text = f"limit of vanishing backlash, the lash always closed\n{text}"
        set_titles(figure, ax, title, text, parse_math=True)
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        freeze_layout(figure, ax)
        return figure


def _draw_small_gap(ax: Axes, response: SmallGap) -> None:
    t0, reach = response.step_time, abs(response.start - response.end)
    lead = 0.06 * (response.time[-1] - t0)
    opposite = response.torque * np.sign(response.start) < 0.0
    ax.fill_between(
        response.time,
        response.torque,
        0.0,
        where=opposite.tolist(),
        interpolate=True,
        color=LINE_COLOURS[0],
        alpha=0.2,
        linewidth=0.0,
        label="on the opposite flank" if opposite.any() else "_",
    )
    ax.axhline(0.0, color=INK, linewidth=1.0, zorder=2)
    ax.axhline(response.end, color=FAINT_INK, linewidth=0.9, linestyle=(0, (1.0, 2.0)), label="equilibrium")
    swing = reach * np.exp(-response.decay * (response.time - t0))
    for curve, name in ((response.end + swing, "exponential decay"), (response.end - swing, "_")):
        ax.plot(response.time, curve, color=LINE_COLOURS[1], linewidth=1.1, linestyle=DASHED, label=name)
    ax.plot(
        np.concatenate(([t0 - lead], response.time)),
        np.concatenate(([response.start], response.torque)),
        color=LINE_COLOURS[0],
        linewidth=1.5,
        zorder=4,
        label="response",
    )
    marks = {"t0": t0}
    if response.periods > 0.0 and np.isfinite(response.periods):
        marks["tc"] = t0 + response.characteristic_time
        ax.plot(marks["tc"], 0.0, "o", color=LINE_COLOURS[1], markeredgecolor=INK, markersize=5.5, zorder=6, gid="tc")
    for name, at in marks.items():
        ax.axvline(at, color=FAINT_INK, linewidth=0.7, linestyle=(0, (4.0, 3.0)), zorder=1)
        ax.annotate(
            symbol_text(name),
            (at, 1.0),
            (3.0, -3.0),
            xycoords=ax.get_xaxis_transform(),
            textcoords="offset points",
            va="top",
            fontsize=9.5,
        )
    ax.set_xlabel("Time [s]")
    ax.set_ylabel("Torque across the lash [N m]")
    ax.set_xlim(t0 - lead, response.time[-1])
    ax.set_ylim(min(response.end - reach, 0.0) - 0.08 * reach, max(response.end + reach, 0.0) + 0.12 * reach)
    tidy(ax)
