"""The response as the backlash vanishes, like the report's Figure 3.5."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot import style
from clunk.simulation.small_gap import SmallGap


@style.styled()
def small_gap(title: str, response: SmallGap) -> Figure:
    """The response as the backlash vanishes, and how long the lowest mode lifts it off its flank (Figure 3.5).

    With no gap to cross, the lash stays closed and its torque F changes sign instead. With the lowest mode alone it
    swings within F_end ± ΔF exp(-ζ1 ω1 t); one side of this crosses zero at the characteristic time t_c, and
    n_c = t_c ω1 / 2π = ln(σr) / (2π ζ1) periods fit in (report Eq. 3.1, where 2π is missing), with σr = ΔF / F_end.
    """
    symbol = style.symbol_text
    values = f"{symbol('σr')} = {response.ratio:.4g}, {symbol('ζ1')} = {response.damping_ratio:.3f}"
    if _crosses_zero(response):
        time = f"{symbol('tc')} - {symbol('t0')} = {response.characteristic_time:.3g} s"
        formula = f"{symbol('nc')} = ln({symbol('σr')}) / (2π {symbol('ζ1')}) = {response.periods:.2f}"
        text = f"{values}: {formula} periods of {1.0 / response.frequency:.3g} s until {time.replace('-', style.MINUS)}"
    else:
        text = f"{values}: the exponential decay never crosses zero"
    figure = style.new_figure((style.HISTORY_WIDTH, 4.8))
    ax = figure.add_subplot()
    _draw_small_gap(ax, response)
    text = f"limit of vanishing backlash, the lash always closed\n{text}"
    style.set_titles(figure, ax, title, text, parse_math=True)
    figure.legend(loc="outside lower center", ncols=4, frameon=False)
    style.freeze_layout(figure, ax)
    return figure


def _draw_small_gap(ax: Axes, response: SmallGap) -> None:
    """Draw the response, its exponential decay, and the characteristic time where that crosses zero."""
    t0, reach = response.step_time, abs(response.start - response.end)
    lead = 0.06 * (response.time[-1] - t0)
    blue, orange = style.LINE_COLOURS[:2]
    opposite = response.torque * np.sign(response.start) < 0.0
    fill: dict[str, Any] = {"where": opposite.tolist(), "interpolate": True, "color": blue, "alpha": 0.2}
    label = "on the opposite flank" if opposite.any() else "_"
    ax.fill_between(response.time, response.torque, 0.0, linewidth=0.0, label=label, **fill)
    ax.axhline(0.0, color=style.INK, linewidth=1.0, zorder=2)
    ax.axhline(response.end, color=style.FAINT_INK, linewidth=0.9, linestyle=(0, (1.0, 2.0)), label="equilibrium")
    swing = reach * np.exp(-response.decay * (response.time - t0))
    for curve, name in ((response.end + swing, "exponential decay"), (response.end - swing, "_")):
        ax.plot(response.time, curve, color=orange, linewidth=1.1, linestyle=style.DASHED, label=name)
    time, torque = np.append(t0 - lead, response.time), np.append(response.start, response.torque)
    ax.plot(time, torque, color=blue, linewidth=1.5, zorder=4, label="response")
    times = {"t0": t0}
    if _crosses_zero(response):
        times["tc"] = t0 + response.characteristic_time
        point: dict[str, Any] = {"color": orange, "markeredgecolor": style.INK, "markersize": 5.5}
        ax.plot(times["tc"], 0.0, "o", zorder=6, gid="tc", **point)
    for name, at in times.items():
        ax.axvline(at, color=style.FAINT_INK, linewidth=0.7, linestyle=(0, (4.0, 3.0)), zorder=1)
        place: dict[str, Any] = {"xycoords": ax.get_xaxis_transform(), "textcoords": "offset points", "va": "top"}
        ax.annotate(style.symbol_text(name), (at, 1.0), (3.0, -3.0), fontsize=9.5, **place)
    ax.set_xlabel("Time [s]")
    ax.set_ylabel("Torque across the lash [N m]")
    ax.set_xlim(t0 - lead, response.time[-1])
    ax.set_ylim(min(response.end - reach, 0.0) - 0.08 * reach, max(response.end + reach, 0.0) + 0.12 * reach)
    style.tidy(ax)


def _crosses_zero(response: SmallGap) -> bool:
    """Whether the exponential decay crosses zero at some time after the load step."""
    return bool(response.periods > 0.0 and np.isfinite(response.periods))
