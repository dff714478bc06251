"""Runs as figures for people: time histories like the report's Figures 3.1, 3.2, 3.3, 3.5 and 3.6.

A run comes as (label, trajectory, history); several are drawn over each other, told apart by colour and dashes, those
of the indentation model the more solid.
"""

import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import patheffects, ticker
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk import driveline
from clunk import plot as house
from clunk.config import Study
from clunk.core import rk4
from clunk.core.events import TOUCH
from clunk.core.regimes import CLOSED_FLOW, FORCE
from clunk.history import History, Phases
from clunk.load import load_step
from clunk.plot import PlotError
from clunk.simulation import Trajectory

FloatArray = npt.NDArray[np.float64]
Runs = Sequence[tuple[str, Trajectory, History]]
Looks = Sequence[dict[str, Any]]

_WIDTH = 7.2  # inches
_LINE = 1.3  # points
_GAP_FILL = "#e4e4e4"
# Of runs and of inertias, in this order; also the colour blind tell them apart, and their lightness differs.
_COLOURS = ("#2f7fc1", "#dd6b1f", "#1f9e83", "#7d55a8", "#b8447c", "#d9b310", "#7a6a55")
_DASHED = (0, (4.0, 1.6))
_PATTERNS: tuple[Any, ...] = ("solid", _DASHED, (0, (1.2, 1.2)), (0, (6.0, 1.2, 1.2, 1.2)))
_LABELLED = 12  # impacts; more arrows than these would hide the curve
_LISTED = 6  # of their values, beside it
_BEFORE = 0.4  # of a close-up's width lies before the moment that it is around
MINUS = "\N{MINUS SIGN}"
_HALO = [patheffects.withStroke(linewidth=2.4, foreground="white")]


# --- Figures ---------------------------------------------------------------------------------------------------------


def simulation_figure(runs: Runs) -> Figure:
    """Everything about a run on one time axis: angles, load, backlash coordinate and acceleration."""
    with house._styled():
        figure, axes = _frame(runs, (3.0, 0.9, 2.4, 2.6), 9.2)
        looks = _looks(runs)
        _draw_angles(axes[0], runs, looks)
        _draw_torque(axes[1], runs, looks)
        _draw_backlash(axes[2], runs, looks)
        _draw_acceleration(axes[3], runs, looks)
        return _finished(figure, axes, runs, marks=True)


def angles(runs: Runs) -> Figure:
    """The angle of every inertia over the load (Figure 3.1)."""
    with house._styled():
        figure, axes = _frame(runs, (4.0, 1.0), 5.2)
        looks = _looks(runs)
        _draw_angles(axes[0], runs, looks)
        _draw_torque(axes[1], runs, looks)
        return _finished(figure, axes, runs)


def backlash(runs: Runs) -> Figure:
    """The backlash coordinate in its gap, every touch marked (Figure 3.2).

    Runs that differ in their contact alone share a panel; every other one has its own.
    """
    panels = _panels(runs)
    if len(panels) > 1:  # what a panel's runs have in common is said by its title, and runs alike look alike
        panels = [_told_apart(panel) for panel in panels]
        runs = [run for panel in panels for run in panel]
    with house._styled():
        figure, axes = _frame(runs, (1.0,) * len(panels), 1.5 + (3.4 if len(panels) == 1 else 2.3 * len(panels)))
        looks = dict(zip((label for label, _, _ in runs), _looks(runs), strict=True))
        for ax, panel in zip(axes, panels, strict=True):
            _draw_backlash(ax, panel, [looks[label] for label, _, _ in panel])
            if len(panels) > 1:
                outcomes = dict.fromkeys(trajectory.label for _, trajectory, _ in panel)
                ax.set_title(f"{_case(panel[0][1].study)}: {', '.join(outcomes)}", loc="right", fontsize=9.0)
        return _finished(figure, axes, runs, marks=True)


def closeup(runs: Runs, around: float | None = None, width: float = 0.1) -> Figure:
    """One flank from near, every touch marked (Figure 3.3).

    around : float, optional  [s], on the plot's axis; by default the first primary impact
    width : float  [s], of the time axis

    Raises PlotError where no run touches a flank in that time.
    """
    if around is None:
        first = [t.events["time"][t.primaries[0]] + t.study.load.step_time for _, t, _ in runs if t.primaries.size]
        if not first:
            raise PlotError("There is no impact to look at closely: no primary impact happens.")
        around = float(min(first))
    if not width > 0.0:
        raise PlotError(f"A close-up must be wider than {width:g} s.")
    begin = 0.1 * width * np.round((around - _BEFORE * width) / (0.1 * width))  # so that the axis begins at a tick
    end = begin + width
    touches = [_touches_within(trajectory, begin, min(end, history.time[-1])) for _, trajectory, history in runs]
    nearest = _nearest_side(runs, touches, around)
    if nearest == 0:
        raise PlotError(f"There is no touch to look at closely between {begin:g} s and {end:g} s.")
    with house._styled():
        figure, (ax,) = _frame(runs, (1.0,), 4.6)
        _draw_backlash(ax, runs, _looks(runs), _closeup_range(runs, touches, nearest))
        ax.set_xlim(begin, end)
        return _finished(figure, [ax], runs, marks=True)


def acceleration(runs: Runs) -> Figure:
    """The acceleration behind the severity, with each impact's peak-to-peak value Q_i (Figure 3.6); a panel per run."""
    with house._styled():
        figure, axes = _frame(runs, (1.0,) * len(runs), 1.6 + (3.2 if len(runs) == 1 else 2.6) * len(runs))
        for ax, run, look in zip(axes, runs, _looks(runs), strict=True):
            if ax is not axes[0]:
                ax.sharey(axes[0])
            _draw_acceleration(ax, [run], [look | {"linestyle": "solid"}])
            if len(runs) > 1:
                ax.set_title(f"{house._plain(run[0])}: {run[1].label}", loc="right", fontsize=9.0)
        return _finished(figure, axes, runs, legend=False)  # each panel names its run


def small_gap(study: Study) -> Figure:
    """The response as the backlash vanishes, and how long the lowest mode lifts it off its flank (Figure 3.5).

    With no gap to cross, the lash stays closed and its torque F changes sign instead. With the lowest mode alone it
    swings within F_end ± ΔF exp(-ζ1 ω1 t); one side of this crosses zero at the characteristic time t_c, and
    n_c = t_c ω1 / 2π = ln(σr) / (2π ζ1) periods fit in (report Eq. 3.1, where 2π is missing), with σr = ΔF / F_end.

    Raises PlotError where there is no such response: without static equilibrium or oscillation, or with a load that
    does not reach the lash.
    """
    response = _SmallGap.of(study)
    symbol = house._symbol
    values = f"{symbol('σr')} = {response.ratio:.4g}, {symbol('ζ1')} = {response.damping_ratio:.3f}"
    if response.periods > 0.0 and np.isfinite(response.periods):
        time = f"{symbol('tc')} - {symbol('t0')} = {response.characteristic_time:.3g} s"
        formula = f"{symbol('nc')} = ln({symbol('σr')}) / (2π {symbol('ζ1')}) = {response.periods:.2f}"
        text = f"{values}: {formula} periods of {1.0 / response.frequency:.3g} s until {time.replace('-', MINUS)}"
    else:
        text = f"{values}: the exponential decay never crosses zero"
    with house._styled():
        figure = Figure(figsize=(_WIDTH, 4.8), dpi=house._DPI, layout="constrained")
        FigureCanvasAgg(figure)
        ax = figure.add_subplot()
        _draw_small_gap(ax, response)
        title = textwrap.fill(study.title, 78)
        figure.suptitle(title, fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
        text = f"limit of vanishing backlash, the lash always closed\n{text}"
        ax.set_title(text, loc="left", fontsize=9.0, color=house._FAINT_INK)
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        house._freeze_layout(figure, ax)
        return figure


# --- Panels ----------------------------------------------------------------------------------------------------------


def _draw_angles(ax: Axes, runs: Runs, looks: Looks) -> None:
    """A colour for each inertia, each run's dashes."""
    for (_, _, history), look in zip(runs, looks, strict=True):
        for inertia in range(history.angle.shape[1]):
            colour = {"color": _COLOURS[inertia % len(_COLOURS)]}
            ax.plot(history.time, history.angle[:, inertia], zorder=3, **look | colour)
    ax.set_ylabel("Rotation [rad]")
    names = runs[0][1].study.driveline.names
    handles = []
    for inertia in range(max(history.angle.shape[1] for _, _, history in runs)):
        name = f" {names[inertia]}" if names and inertia < len(names) and len(names[inertia]) <= 12 else ""
        text = house._plain(name)
        handles.append(Line2D([], [], color=_COLOURS[inertia % len(_COLOURS)], label=f"θ{_index(inertia + 1)}{text}"))
    _margin_legend(ax, handles[:16])


def _draw_torque(ax: Axes, runs: Runs, looks: Looks) -> None:
    values: set[float] = set()
    for (_, _, history), look in zip(runs, looks, strict=True):
        alone = {"color": house._INK} if len(runs) == 1 else {}  # the first inertia has the first run's colour
        ax.plot(history.time, history.torque, zorder=3, **look | alone)
        values |= set(history.torque.tolist())
    ax.set_ylabel("Torque\n[N m]")
    if len(values) <= 2:
        ax.set_yticks(sorted(values))
    else:
        ax.yaxis.set_major_locator(ticker.MaxNLocator(3))
    ax.margins(y=0.25)


def _draw_backlash(ax: Axes, runs: Runs, looks: Looks, limits: tuple[float, float] | None = None) -> None:
    """x_b in millimetres, the widest gap in grey, touches filled where primary."""
    half_gaps = sorted({1e3 * _half_gap(trajectory.study) for _, trajectory, _ in runs})
    widest = half_gaps[-1]
    ax.axhspan(-widest, widest, color=_GAP_FILL, linewidth=0.0, zorder=0)
    for edge in half_gaps[:-1]:
        for side in (-1.0, 1.0):
            ax.axhline(side * edge, color="0.7", linewidth=0.7, zorder=0.5)
    size = 6.5
    for (_, trajectory, history), look in zip(runs, looks, strict=True):
        ax.plot(history.time, 1e3 * history.backlash_coordinate, zorder=3, **look)
        _mark_touches(ax, trajectory, history, look["color"], size)
        size *= 0.8  # so that of impacts in one place all can be seen
    ax.set_ylabel(f"Backlash coordinate\n{house._symbol('xb')} [mm]")
    if limits is None:
        reach = max(1.2 * widest, *(1.05e3 * np.abs(history.backlash_coordinate).max() for _, _, history in runs))
        # locked flanks without a gap stay together but for rounding, which is nothing to look at
        limits = (-reach, reach) if reach > 1e-9 * max(t.study.lash.radius for _, t, _ in runs) else (-1.0, 1.0)
    ax.set_ylim(*limits)
    low, high = ax.get_ylim()
    sides = {trajectory.initial_side for _, trajectory, _ in runs}
    names = {0.0: "gap" if widest > 0.0 else "no gap"}
    for side in (-1, 1) if widest > 0.0 else ():
        names[side * widest] = ("initial flank" if side in sides else "opposite flank") if len(sides) == 1 else "flank"
    for at, name in names.items():
        if low <= at <= high:
            _margin_text(ax, at, name)


def _mark_touches(ax: Axes, trajectory: Trajectory, history: History, colour: Any, size: float) -> None:
    """Every touch at its flank, pointing at it; primary impacts filled, chatter small and open."""
    shown = np.flatnonzero(history.event >= 0)
    for row in shown[trajectory.events["kind"][history.event[shown]] == TOUCH]:
        k = int(history.event[row])
        primary = k in trajectory.primaries
        ax.plot(
            history.time[row],
            1e3 * history.backlash_coordinate[row],
            marker="^" if trajectory.events["side"][k] > 0 else "v",
            color=colour,
            markersize=size if primary else 4.0,
            markerfacecolor=colour if primary else "white",
            markeredgecolor=house._INK if primary else colour,
            markeredgewidth=0.7,
            linestyle="none",
            zorder=5 if primary else 4,
            gid="primary" if primary else "secondary",
        )


def _draw_acceleration(ax: Axes, runs: Runs, looks: Looks) -> None:
    watched = {int(trajectory.study.impacts.acceleration_of) for _, trajectory, _ in runs}
    for (_, trajectory, history), look in zip(runs, looks, strict=True):
        inertia = int(trajectory.study.impacts.acceleration_of) - 1
        ax.plot(history.time, history.acceleration[:, inertia], zorder=3, **look | {"linewidth": 1.0})
    index = _index(watched.pop()) if len(watched) == 1 else ""
    ax.set_ylabel(rf"Acceleration$\n$\mathregular{{\ddot{{\theta}}}}${index} [rad/s²]".replace(r"$\n$", "\n$"))
    if any(_is_restitution(trajectory) for _, trajectory, _ in runs):
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.2 * (high - low))
        _corner_text(ax, "restitution model: between the touches only, where velocities jump; Q is not defined")
    elif len(runs) == 1:
        _mark_severity(ax, *runs[0][1:])


def _mark_severity(ax: Axes, trajectory: Trajectory, history: History) -> None:
    """A double arrow over each impact's peak-to-peak acceleration, from its smallest to its largest value."""
    windows = [window for window in _windows(trajectory, history) if window.stop > window.start]
    begin, end = history.time[0], history.time[-1]
    offset = 0.028 * (end - begin)
    for window in windows if len(windows) <= _LABELLED else []:
        x = min(window.begin + offset, 0.5 * (window.begin + min(window.end, end)))
        inertia = int(trajectory.study.impacts.acceleration_of) - 1
        curve = history.acceleration[window.start : window.stop, inertia]
        times = history.time[window.start : window.stop]
        for value, at in ((window.largest, times[np.argmax(curve)]), (window.smallest, times[np.argmin(curve)])):
            ax.plot([at, x + 0.35 * offset], [value, value], color=house._INK, linewidth=0.6, zorder=4)
        ax.annotate(
            "",
            xy=(x, window.largest),
            xytext=(x, window.smallest),
            arrowprops={"arrowstyle": "<->", "color": house._INK, "linewidth": 0.9, "shrinkA": 0.0, "shrinkB": 0.0},
            zorder=6,
        )
        ax.annotate(
            f"Q{_index(window.number)}",
            (x, window.largest),
            (0.0, 2.0),
            textcoords="offset points",
            ha="center" if x < end - offset else "right",
            va="bottom",
            fontsize=9.0,
            zorder=7,
            path_effects=_HALO,
            gid="severity",
        )
    if windows:
        ax.margins(y=0.12)
        lines = [f"Q{_index(i)} = {value:.0f}" for i, value in enumerate(trajectory.impact_severity[:_LISTED], 1)]
        if trajectory.impact_severity.size > _LISTED:
            lines.append("…")
        ax.text(
            1.015,
            1.0,
            "\n".join(["[rad/s²]", *lines, f"Q = {trajectory.severity:.0f}"]),
            transform=ax.transAxes,
            va="top",
            fontsize=8.5,
            linespacing=1.5,
        )


class _Window(NamedTuple):
    """From a primary impact to the next one, or to the end."""

    number: int  # from 1
    begin: float  # s, on the plot's axis
    end: float
    start: int  # rows of the history
    stop: int
    largest: float  # rad/s2
    smallest: float


def _windows(trajectory: Trajectory, history: History) -> list[_Window]:
    events, step_time = trajectory.events, trajectory.study.load.step_time
    row = np.full(events.size + 1, history.time.size)
    shown = np.flatnonzero(history.event >= 0)
    row[history.event[shown]] = shown
    limits = [*trajectory.primaries.tolist(), events.size]
    return [
        _Window(
            number=i,
            begin=float(step_time + events["time"][k]),
            end=float(step_time + events["time"][following]) if following < events.size else np.inf,
            start=int(row[k]),
            stop=int(row[following]),
            largest=float(events["max_acceleration"][k:following].max()),
            smallest=float(events["min_acceleration"][k:following].min()),
        )
        for i, (k, following) in enumerate(pairwise(limits), 1)
    ]


# --- Close-up --------------------------------------------------------------------------------------------------------


def _touches_within(trajectory: Trajectory, begin: float, end: float) -> npt.NDArray[np.int64]:
    """Indices of the touches between two times of the plot's axis."""
    time = trajectory.study.load.step_time + trajectory.events["time"]
    return np.flatnonzero((trajectory.events["kind"] == TOUCH) & (time >= begin) & (time <= end))


def _nearest_side(runs: Runs, touches: Sequence[npt.NDArray[np.int64]], around: float) -> int:
    """The side of the touch that is nearest to a moment; 0 without any."""
    found = [
        (abs(t.study.load.step_time + t.events["time"][k] - around), int(t.events["side"][k]))
        for (_, t, _), indices in zip(runs, touches, strict=True)
        for k in indices
    ]
    return min(found)[1] if found else 0


def _closeup_range(runs: Runs, touches: Sequence[npt.NDArray[np.int64]], side: int) -> tuple[float, float]:
    """Limits of the backlash coordinate that show the rebounds and the indentation on one flank  [mm]."""
    lowest, highest = np.inf, -np.inf
    for (_, trajectory, history), indices in zip(runs, touches, strict=True):
        on_flank = indices[trajectory.events["side"][indices] == side]
        if on_flank.size == 0:
            continue
        rows = np.flatnonzero(np.isin(history.event, on_flank))
        if rows.size == 0:
            continue
        after = trajectory.events["time"][min(on_flank[-1] + 1, trajectory.events.size - 1)]
        stop = max(rows[-1] + 1, int(np.searchsorted(history.after_step, after, side="right")))
        rebounds = side * 1e3 * history.backlash_coordinate[rows[0] : rows[-1] + 1]
        pressed = side * 1e3 * history.backlash_coordinate[rows[0] : stop]
        lowest, highest = min(lowest, rebounds.min()), max(highest, pressed.max())
    smallest = 0.02 * max(1e3 * _half_gap(trajectory.study) for _, trajectory, _ in runs)
    height = max(highest - lowest, smallest, 1e-9)
    low, high = lowest - 0.2 * height, highest + 0.22 * height
    return (low, high) if side > 0 else (-high, -low)


# --- Vanishing backlash ----------------------------------------------------------------------------------------------


class _SmallGap(NamedTuple):
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
    def of(cls, study: Study) -> "_SmallGap":
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
        side = rk4.preload(system, before, 0.0, x)
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
        state = Phases(system, after, 0.0, step).flow(rk4.closed_on(side), x, 0.0, time.size)
        if system.impulsive:
            torque = state @ system.functionals[CLOSED_FLOW, FORCE] + system.feedthrough[CLOSED_FLOW, FORCE, 0] * after
        else:
            n = plant.inertia.size
            angle, velocity = state[:, :n] @ plant.lash, state[:, n:] @ plant.lash
            torque = plant.contact_stiffness * angle + plant.contact_damping * velocity
        time += study.load.step_time
        return cls(np.asarray(time), torque, start, end, decay, frequency, damping_ratio, study.load.step_time)


def _draw_small_gap(ax: Axes, response: _SmallGap) -> None:
    t0, reach = response.step_time, abs(response.start - response.end)
    lead = 0.06 * (response.time[-1] - t0)
    opposite = response.torque * np.sign(response.start) < 0.0
    ax.fill_between(
        response.time,
        response.torque,
        0.0,
        where=opposite.tolist(),
        interpolate=True,
        color=_COLOURS[0],
        alpha=0.2,
        linewidth=0.0,
        label="on the opposite flank" if opposite.any() else "_",
    )
    ax.axhline(0.0, color=house._INK, linewidth=1.0, zorder=2)
    ax.axhline(response.end, color=house._FAINT_INK, linewidth=0.9, linestyle=(0, (1.0, 2.0)), label="equilibrium")
    swing = reach * np.exp(-response.decay * (response.time - t0))
    for curve, name in ((response.end + swing, "exponential decay"), (response.end - swing, "_")):
        ax.plot(response.time, curve, color=_COLOURS[1], linewidth=1.1, linestyle=_DASHED, label=name)
    ax.plot(
        np.concatenate(([t0 - lead], response.time)),
        np.concatenate(([response.start], response.torque)),
        color=_COLOURS[0],
        linewidth=1.5,
        zorder=4,
        label="response",
    )
    marks = {"t0": t0}
    if response.periods > 0.0 and np.isfinite(response.periods):
        marks["tc"] = t0 + response.characteristic_time
        ax.plot(
            marks["tc"], 0.0, "o", color=_COLOURS[1], markeredgecolor=house._INK, markersize=5.5, zorder=6, gid="tc"
        )
    for name, at in marks.items():
        ax.axvline(at, color=house._FAINT_INK, linewidth=0.7, linestyle=(0, (4.0, 3.0)), zorder=1)
        ax.annotate(
            house._symbol(name),
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
    _tidy(ax)


# --- Parts of a figure -----------------------------------------------------------------------------------------------


def _frame(runs: Runs, heights: Sequence[float], height: float) -> tuple[Figure, list[Axes]]:
    """A column of axes over one time axis."""
    if not runs:
        raise PlotError("There is no run to draw.")
    figure = Figure(figsize=(_WIDTH, height), dpi=house._DPI, layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    axes[-1].set_xlabel("Time [s]")
    begin = min(float(history.time[0]) for _, _, history in runs)
    end = max(float(history.time[-1]) for _, _, history in runs)
    axes[0].set_xlim(begin, end if end > begin else begin + 1.0)
    axes[0].xaxis.set_major_locator(ticker.MaxNLocator(11, steps=[1, 2, 5, 10]))
    for ax in axes:
        _tidy(ax)
        for step_time in {trajectory.study.load.step_time for _, trajectory, _ in runs}:
            ax.axvline(step_time, color=house._FAINT_INK, linewidth=0.7, linestyle=(0, (1.0, 2.0)), zorder=1)
    return figure, axes


def _tidy(ax: Axes) -> None:
    ax.grid(axis="y", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _finished(figure: Figure, axes: Sequence[Axes], runs: Runs, *, marks: bool = False, legend: bool = True) -> Figure:
    """Titles above, the runs and the marks explained below."""
    titles = {trajectory.study.title for _, trajectory, _ in runs}
    cases = {_case(trajectory.study) for _, trajectory, _ in runs}
    title = textwrap.fill(titles.pop(), 78) if len(titles) == len(cases) == 1 else "Runs compared"
    figure.suptitle(title, fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
    line = "ideal torque step (tip-out)" + (f", {cases.pop()}" if len(cases) == 1 else "")
    if len(runs) == 1:
        line = f"{line}: {_outcome(runs[0][1])}"
    axes[0].set_title(line, loc="left", fontsize=9.0, color=house._FAINT_INK)
    handles: list[Line2D] = []
    labels = [label for label, _, _ in runs]
    for k, (label, look) in enumerate(zip(labels, _looks(runs), strict=True)):
        if legend and len(runs) > 1 and label not in labels[:k]:
            outcome = f": {_outcome(runs[k][1])}" if labels.count(label) == 1 else ""
            handles.append(Line2D([], [], **look, label=house._plain(label) + outcome))
    if marks and any(trajectory.touches for _, trajectory, _ in runs):
        common: dict[str, Any] = {"linestyle": "none", "markeredgewidth": 0.7, "color": house._FAINT_INK}
        handles.append(
            Line2D([], [], marker="^", markersize=6.5, markeredgecolor=house._INK, label="primary impact", **common)
        )
        handles.append(
            Line2D(
                [],
                [],
                marker="^",
                markersize=4.0,
                markerfacecolor="white",
                label="secondary impact (chatter)",
                **common,
            )
        )
    if handles:
        widest = max(len(str(handle.get_label())) for handle in handles)
        columns = max(1, min(len(handles), int((_WIDTH - 0.4) / (0.45 + 0.07 * widest))))
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)
    house._freeze_layout(figure, axes[0])
    return figure


def _margin_legend(ax: Axes, handles: list[Line2D]) -> None:
    ax.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.03),
        frameon=False,
        handlelength=1.4,
        borderaxespad=0.2,
    )


def _margin_text(ax: Axes, y: float, text: str) -> None:
    ax.text(1.015, y, text, transform=ax.get_yaxis_transform(), va="center", fontsize=8.5, color=house._FAINT_INK)


def _corner_text(ax: Axes, text: str) -> None:
    ax.text(0.99, 0.97, text, transform=ax.transAxes, ha="right", va="top", fontsize=8.5, zorder=7, path_effects=_HALO)


def _looks(runs: Runs) -> list[dict[str, Any]]:
    """How each run is drawn; runs of one label alike. Indentation takes the first dash patterns, as in Figure 3.2."""
    models: dict[str, bool] = {}
    for label, trajectory, _ in runs:
        models.setdefault(label, _is_restitution(trajectory))
    order = sorted(models, key=lambda label: models[label])  # stable: False, the indentation model, first
    return [
        {
            "color": _COLOURS[list(models).index(label) % len(_COLOURS)],
            "linestyle": _PATTERNS[order.index(label) % len(_PATTERNS)],
            "linewidth": _LINE,
        }
        for label, _, _ in runs
    ]


def _index(number: int) -> str:
    return rf"$_\mathregular{{{number}}}$"


def _is_restitution(trajectory: Trajectory) -> bool:
    return trajectory.study.lash.contact.model == "restitution"


def _half_gap(study: Study) -> float:
    """r φ/2  [m]."""
    return float(study.lash.radius * np.deg2rad(study.lash.backlash_deg) / 2)


def _case(study: Study) -> str:
    """The load and the gap of a run, in symbols."""
    load = load_step(study.load)
    ratio = f"{house._symbol('σr')} = {study.load.ratio:g}".replace("-", MINUS) if study.load.ratio is not None else ""
    torque = f"T = {load.before:g} → {load.after:g} N m".replace("-", MINUS)
    gap = f"{house._symbol('φθ')} = {study.lash.backlash_deg:g}°"
    return f"{ratio or torque}, {gap}"


def _outcome(trajectory: Trajectory) -> str:
    severity = trajectory.severity
    return trajectory.label + (f", Q = {severity:.0f} rad/s²" if severity > 0.0 else "")


def _told_apart(runs: Runs) -> Runs:
    """The runs without the parts of their labels, "KEY=VALUE, KEY=VALUE", that are the same for all."""
    parts = [label.split(", ") for label, _, _ in runs]
    common = set(parts[0]).intersection(*parts[1:])
    labels = [", ".join(part for part in own if part not in common) for own in parts]
    if not all(labels):
        return runs
    return [(label, trajectory, history) for label, (_, trajectory, history) in zip(labels, runs, strict=True)]


def _panels(runs: Runs) -> list[Runs]:
    """Runs that differ in nothing but their contact, and in how they are computed, together; in order."""
    panels: dict[str, list[tuple[str, Trajectory, History]]] = {}
    for run in runs:
        study = run[1].study
        lash = study.lash.model_dump(exclude={"contact"})
        panels.setdefault(repr((study.driveline, lash, study.load)), []).append(run)
    return list(panels.values())
