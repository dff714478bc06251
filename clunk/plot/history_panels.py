"""The panels of time histories: angles, load, backlash coordinate and acceleration over time."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib import patheffects, ticker
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from clunk.core.events import TOUCH
from clunk.plot.style import FAINT_INK, INK, LINE_COLOURS, plain, symbol_text
from clunk.simulation.history import History
from clunk.simulation.trajectory import Trajectory
from clunk.study.config import Study

Runs = Sequence[tuple[str, Trajectory, History]]
Looks = Sequence[dict[str, Any]]

_GAP_FILL = "#e4e4e4"
_LABELLED = 12  # impacts; more arrows than these would hide the curve
_LISTED = 6  # of their values, beside it
_HALO = [patheffects.withStroke(linewidth=2.4, foreground="white")]


def draw_angles(ax: Axes, runs: Runs, looks: Looks) -> None:
    """A colour for each inertia, each run's dashes."""
    for (_, _, history), look in zip(runs, looks, strict=True):
        for inertia in range(history.angle.shape[1]):
            colour = {"color": LINE_COLOURS[inertia % len(LINE_COLOURS)]}
            ax.plot(history.time, history.angle[:, inertia], zorder=3, **look | colour)
    ax.set_ylabel("Rotation [rad]")
    names = runs[0][1].study.driveline.names
    handles = []
    for inertia in range(max(history.angle.shape[1] for _, _, history in runs)):
        name = f" {names[inertia]}" if names and inertia < len(names) and len(names[inertia]) <= 12 else ""
        text = plain(name)
        handles.append(
            Line2D([], [], color=LINE_COLOURS[inertia % len(LINE_COLOURS)], label=f"θ{_index(inertia + 1)}{text}")
        )
    _margin_legend(ax, handles[:16])


def draw_torque(ax: Axes, runs: Runs, looks: Looks) -> None:
    """The load."""
    values: set[float] = set()
    for (_, _, history), look in zip(runs, looks, strict=True):
        alone = {"color": INK} if len(runs) == 1 else {}  # the first inertia has the first run's colour
        ax.plot(history.time, history.torque, zorder=3, **look | alone)
        values |= set(history.torque.tolist())
    ax.set_ylabel("Torque\n[N m]")
    if len(values) <= 2:
        ax.set_yticks(sorted(values))
    else:
        ax.yaxis.set_major_locator(ticker.MaxNLocator(3))
    ax.margins(y=0.25)


def draw_backlash(ax: Axes, runs: Runs, looks: Looks, limits: tuple[float, float] | None = None) -> None:
    """x_b in millimetres, the widest gap in grey, touches filled where primary."""
    half_gaps = sorted({1e3 * half_gap(trajectory.study) for _, trajectory, _ in runs})
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
    ax.set_ylabel(f"Backlash coordinate\n{symbol_text('xb')} [mm]")
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
            markeredgecolor=INK if primary else colour,
            markeredgewidth=0.7,
            linestyle="none",
            zorder=5 if primary else 4,
            gid="primary" if primary else "secondary",
        )


def draw_acceleration(ax: Axes, runs: Runs, looks: Looks) -> None:
    """The acceleration of the watched inertia, and where Q is defined what it is made of."""
    watched = {int(trajectory.study.impacts.acceleration_of) for _, trajectory, _ in runs}
    for (_, trajectory, history), look in zip(runs, looks, strict=True):
        inertia = int(trajectory.study.impacts.acceleration_of) - 1
        ax.plot(history.time, history.acceleration[:, inertia], zorder=3, **look | {"linewidth": 1.0})
    index = _index(watched.pop()) if len(watched) == 1 else ""
    ax.set_ylabel(rf"Acceleration$\n$\mathregular{{\ddot{{\theta}}}}${index} [rad/s²]".replace(r"$\n$", "\n$"))
    if any(is_restitution(trajectory) for _, trajectory, _ in runs):
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
            ax.plot([at, x + 0.35 * offset], [value, value], color=INK, linewidth=0.6, zorder=4)
        ax.annotate(
            "",
            xy=(x, window.largest),
            xytext=(x, window.smallest),
            arrowprops={"arrowstyle": "<->", "color": INK, "linewidth": 0.9, "shrinkA": 0.0, "shrinkB": 0.0},
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
    ax.text(1.015, y, text, transform=ax.get_yaxis_transform(), va="center", fontsize=8.5, color=FAINT_INK)


def _corner_text(ax: Axes, text: str) -> None:
    ax.text(0.99, 0.97, text, transform=ax.transAxes, ha="right", va="top", fontsize=8.5, zorder=7, path_effects=_HALO)


def _index(number: int) -> str:
    return rf"$_\mathregular{{{number}}}$"


def is_restitution(trajectory: Trajectory) -> bool:
    """Whether a run's contact is an impulse, in which accelerations are not defined."""
    return trajectory.study.lash.contact.model == "restitution"


def half_gap(study: Study) -> float:
    """r φ/2  [m]."""
    return float(study.lash.radius * np.deg2rad(study.lash.backlash_deg) / 2)
