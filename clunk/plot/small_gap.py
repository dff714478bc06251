"""The response as the backlash vanishes, like the report's Figure 3.5."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk import driveline
from clunk.config import Study
from clunk.core import switching
from clunk.core.regimes import CLOSED_FLOW, FORCE
from clunk.history import Phases
from clunk.load import load_step
from clunk.plot.style import (
    DASHED,
    FAINT_INK,
    HISTORY_WIDTH,
    INK,
    LINE_COLOURS,
    MINUS,
    PlotError,
    freeze_layout,
    new_figure,
    set_titles,
    styled,
    symbol_text,
    tidy,
)

FloatArray = npt.NDArray[np.float64]


def small_gap(study: Study) -> Figure:
    """The response as the backlash vanishes, and how long the lowest mode lifts it off its flank (Figure 3.5).

    With no gap to cross, the lash stays closed and its torque F changes sign instead. With the lowest mode alone it
    swings within F_end ± ΔF exp(-ζ1 ω1 t); one side of this crosses zero at the characteristic time t_c, and
    n_c = t_c ω1 / 2π = ln(σr) / (2π ζ1) periods fit in (report Eq. 3.1, where 2π is missing), with σr = ΔF / F_end.

    Raises PlotError where there is no such response: without static equilibrium or oscillation, or with a load that
    does not reach the lash.
    """
    response = SmallGap.of(study)
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
        set_titles(figure, ax, study.title, text, parse_math=True)
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        freeze_layout(figure, ax)
        return figure


class SmallGap(NamedTuple):
    """The torque across a lash without a gap, on the plot's time axis, signed like q = θi - θj."""

    time: FloatArray  # s
    torque: FloatArray  # N m
    start: float  # N m, before the load step
    end: float  # N m, at rest after it
    decay: float  # 1/s, ζ1 ω1
    frequency: float  # Hz, of the lowest mode
    damping_ratio: float  # ζ1
    step_time: float  # s

    @property
    def ratio(self) -> float:
        """σr = (F before - F after) / F after."""
        return (self.start - self.end) / self.end if self.end != 0.0 else np.inf

    @property
    def periods(self) -> float:
        """n_c = ln(σr) / (2π ζ1); not a number where the envelope never crosses zero."""
        return float(np.log(self.ratio) / (2.0 * np.pi * self.damping_ratio)) if self.ratio > 0.0 else np.nan

    @property
    def characteristic_time(self) -> float:
        """t_c after the load step, where σr exp(-ζ1 ω1 t) = 1  [s]."""
        return float(np.log(self.ratio) / self.decay) if self.ratio > 0.0 else np.nan

    @classmethod
    def of(cls, study: Study) -> "SmallGap":
        """The response of a study's driveline to its load. Raises PlotError where there is none."""
        system = driveline.build(study)
        plant = driveline.Driveline.from_study(study)
        modes = plant.modes(closed=True)
        if not plant.grounded:
            raise PlotError("There is no response to draw: some inertia has no path of stiffness to ground.")
        if modes.frequency.size == 0 or modes.damping_ratio[0] <= 0.0:
            raise PlotError("There is no decay to draw: the driveline has no damped oscillation in contact.")
        load = load_step(study.load)
        before, after = float(load.before), float(load.after)
        x = np.empty(system.lash.size)
        side = switching.preload(system, before, 0.0, x)
        if side == 0:
            raise PlotError("There is no response to draw: the lash carries no static torque before the load step.")
        frequency, damping_ratio = float(modes.frequency[0]), float(modes.damping_ratio[0])
        decay = 2.0 * np.pi * frequency * damping_ratio
        start, end = (float(system.contact_torque[0]) * torque for torque in (before, after))
        crossing = np.log(abs((start - end) / end)) / decay if end != 0.0 and start != end else 0.0
        duration = max(1.35 * crossing, 3.0 / frequency)
        step = min(1.0 / (200.0 * frequency), study.solver.step * max(1.0, duration / study.solver.step / 20_000))
        time = step * np.arange(int(duration / step) + 1)
        # without a gap no flank has an offset, and which one is closed does not matter
        state = Phases(system, after, 0.0, step).flow(switching.closed_on(side), x, 0.0, time.size)
        if system.impulsive:
            torque = state @ system.functionals[CLOSED_FLOW, FORCE] + system.feedthrough[CLOSED_FLOW, FORCE, 0] * after
        else:
            n = plant.inertia.size
            angle, velocity = state[:, :n] @ plant.lash, state[:, n:] @ plant.lash
            torque = plant.contact_stiffness * angle + plant.contact_damping * velocity
        time += study.load.step_time
        return cls(np.asarray(time), torque, start, end, decay, frequency, damping_ratio, study.load.step_time)


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
