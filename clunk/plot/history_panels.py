"""The panels of time histories: load, angles, speeds, backlash coordinate and acceleration over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from clunk.plot.style import FAINT_INK, INK, LINE_COLOURS, halo, plain, symbol_text
from clunk.simulation.history import History, Impact
from clunk.simulation.load import load_step
from clunk.study.arrays import Floats

Curve = tuple[History, dict[str, Any]]  # a run and its colour, dashes and width

_GAP_FILL = "#e4e4e4"
_LABELLED = 12  # impacts; more arrows than these would hide the curve
_LISTED = 6  # of their values, beside it
_LONGEST_NAME = 12  # characters of an inertia's name in the legend


def draw_angles(ax: Axes, curves: Sequence[Curve]) -> None:
    """Angle of every inertia; where the driveline rolls, less its rolling."""
    rolls = any(run.twist is not run.angle for run, _ in curves)
    _draw_inertias(ax, curves, [run.twist for run, _ in curves], "θ")
    ax.set_ylabel("Rotation less\nrolling [rad]" if rolls else "Rotation [rad]")


def draw_speeds(ax: Axes, curves: Sequence[Curve]) -> None:
    """Speed of every inertia, its rolling included."""
    _draw_inertias(ax, curves, [run.velocity for run, _ in curves], r"$\mathregular{\dot{\theta}}$")
    ax.set_ylabel("Speed [rad/s]")


def _draw_inertias(ax: Axes, curves: Sequence[Curve], values: Sequence[Floats], symbol: str) -> None:
    """Values of every inertia, (M, n) for each run: each inertia in its colour, each run in its dashes."""
    for (run, look), columns in zip(curves, values, strict=True):
        for inertia, column in enumerate(columns.T):
            ax.plot(run.time, column, zorder=3, **look | {"color": LINE_COLOURS[inertia % len(LINE_COLOURS)]})
    count = max(columns.shape[1] for columns in values)
    names = curves[0][0].study.driveline.names or ()
    handles = []
    for inertia in range(min(count, 16)):
        name = names[inertia] if inertia < len(names) and len(names[inertia]) <= _LONGEST_NAME else ""
        label = f"{symbol}{_index(inertia + 1)} {plain(name)}".rstrip()
        handles.append(Line2D([], [], color=LINE_COLOURS[inertia % len(LINE_COLOURS)], label=label))
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.03), "borderaxespad": 0.2}
    ax.legend(handles=handles, handlelength=1.4, frameon=False, **place)


def draw_torque(ax: Axes, curves: Sequence[Curve]) -> None:
    """Torque of the load; ticks are at the torques before and after, where it stays between two."""
    steady, values = {torque for run, _ in curves for torque in load_step(run.study.load)}, set[float]()
    for run, look in curves:
        single = {"color": INK} if len(curves) == 1 else {}  # the first inertia has the first run's colour
        ax.plot(run.time, run.torque, zorder=3, **look | single)
        values |= set(run.torque.tolist())
    ax.set_ylabel("Torque\n[N m]")
    rounding = 1e-9 * max(map(abs, values))
    if min(steady) - rounding <= min(values) and max(values) <= max(steady) + rounding:
        values = steady
    if len(values) <= 2:
        ax.set_yticks(sorted(values))
    else:
        ax.yaxis.set_major_locator(ticker.MaxNLocator(4))
    ax.margins(y=0.25)


def draw_backlash(ax: Axes, curves: Sequence[Curve], limits: tuple[float, float] | None = None) -> None:
    """Backlash coordinate x_b in millimetres, the widest gap in grey, touches filled where primary."""
    runs = [run for run, _ in curves]
    half_gaps = sorted({1e3 * run.half_gap for run in runs})
    widest = half_gaps[-1]
    ax.axhspan(-widest, widest, color=_GAP_FILL, linewidth=0.0, zorder=0)
    for edge in half_gaps[:-1]:
        for side in (-1.0, 1.0):
            ax.axhline(side * edge, color="0.7", linewidth=0.7, zorder=0.5)
    size = 6.5
    for run, look in curves:
        ax.plot(run.time, 1e3 * run.backlash_coordinate, zorder=3, **look)
        _mark_touches(ax, run, look["color"], size)
        size *= 0.8  # so that of impacts in one place all can be seen
    ax.set_ylabel(f"Backlash coordinate\n{symbol_text('xb')} [mm]")
    if limits is None:
        reach = max(1.2 * widest, *(1.05e3 * np.abs(run.backlash_coordinate).max() for run in runs))
        # locked flanks without a gap stay together but for rounding, which is nothing to look at
        limits = (-reach, reach) if reach > 1e-9 * max(run.lash.radius for run in runs) else (-1.0, 1.0)
    ax.set_ylim(*limits)
    _name_flanks(ax, widest, {run.trajectory.initial_side for run in runs})


def _name_flanks(ax: Axes, widest: float, initial_sides: set[int]) -> None:
    """Names of the gap and of its flanks in the right margin, those that are within the panel."""
    names = {0.0: "gap" if widest > 0.0 else "no gap"}
    for side in (-1, 1) if widest > 0.0 else ():
        flank = "initial flank" if side in initial_sides else "opposite flank"
        names[side * widest] = flank if len(initial_sides) == 1 else "flank"
    low, high = ax.get_ylim()
    for at, name in names.items():
        if low <= at <= high:
            place = ax.get_yaxis_transform()
            ax.text(1.015, at, name, transform=place, va="center", fontsize=8.5, color=FAINT_INK)


def _mark_touches(ax: Axes, run: History, colour: Any, size: float) -> None:
    """Mark every touch at its flank, pointing at it."""
    for row, side, primary in zip(run.touches.row, run.touches.side, run.touches.primary, strict=True):
        x, y = run.time[row], 1e3 * run.backlash_coordinate[row]
        look = touch_look(colour, primary=primary, size=size)
        ax.plot(x, y, marker="^" if side > 0 else "v", gid="primary" if primary else "secondary", **look)


def touch_look(colour: Any, *, primary: bool, size: float = 6.5) -> dict[str, Any]:
    """Look of a touch's marker: primary impacts filled, chatter small and open."""
    edge, face, zorder = (INK, colour, 5) if primary else (colour, "white", 4)
    look = {"linestyle": "none", "color": colour, "markeredgewidth": 0.7, "markersize": size if primary else 4.0}
    return look | {"markeredgecolor": edge, "markerfacecolor": face, "zorder": zorder}


def draw_acceleration(ax: Axes, curves: Sequence[Curve]) -> None:
    """Acceleration of the watched inertia, and of a single run the peak-to-peak values that Q is made of."""
    for run, look in curves:
        curve = run.acceleration[:, run.watched - 1]
        ax.plot(run.time, curve, zorder=3, **look | {"linewidth": 1.0})
    watched = {run.watched for run, _ in curves}
    index = _index(watched.pop()) if len(watched) == 1 else ""
    ax.set_ylabel("Acceleration\n" + rf"$\mathregular{{\ddot{{\theta}}}}${index} [rad/s²]")
    if any(run.is_restitution for run, _ in curves):
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.2 * (high - low))
        text = "restitution model: between the touches only, where velocities jump; Q is not defined"
        place: dict[str, Any] = {"transform": ax.transAxes, "ha": "right", "va": "top"}
        ax.text(0.99, 0.97, text, fontsize=8.5, zorder=7, path_effects=halo(), **place)
    elif len(curves) == 1:
        _mark_severity(ax, curves[0][0])


def _mark_severity(ax: Axes, run: History) -> None:
    """A double arrow over each impact's peak-to-peak acceleration, and the list of their values."""
    sampled = [impact for impact in run.impacts if impact.rows.stop > impact.rows.start]
    if not sampled:
        return
    for impact in sampled if len(sampled) <= _LABELLED else []:
        _draw_arrow(ax, run, impact)
    ax.margins(y=0.12)
    lines = [f"Q{_index(impact.number)} = {impact.severity:.0f}" for impact in run.impacts[:_LISTED]]
    if len(run.impacts) > _LISTED:
        lines.append("…")
    text = "\n".join(["[rad/s²]", *lines, f"Q = {run.trajectory.severity:.0f}"])
    ax.text(1.015, 1.0, text, transform=ax.transAxes, va="top", fontsize=8.5, linespacing=1.5)


def _draw_arrow(ax: Axes, run: History, impact: Impact) -> None:
    """A double arrow from the smallest to the largest acceleration after an impact, and lines to where they are."""
    begin, end = run.time[0], run.time[-1]
    offset = 0.028 * (end - begin)
    x = min(impact.begin + offset, 0.5 * (impact.begin + min(impact.end, end)))
    curve, times = run.acceleration[impact.rows, run.watched - 1], run.time[impact.rows]
    for value, at in ((impact.largest, times[np.argmax(curve)]), (impact.smallest, times[np.argmin(curve)])):
        ax.plot([at, x + 0.35 * offset], [value, value], color=INK, linewidth=0.6, zorder=4)
    arrow = {"arrowstyle": "<->", "color": INK, "linewidth": 0.9, "shrinkA": 0.0, "shrinkB": 0.0}
    ax.annotate("", xy=(x, impact.largest), xytext=(x, impact.smallest), arrowprops=arrow, zorder=6)
    look: dict[str, Any] = {
        "ha": "center" if x < end - offset else "right",
        "va": "bottom",
        "textcoords": "offset points",
    }
    text, place = f"Q{_index(impact.number)}", (x, impact.largest)
    ax.annotate(text, place, (0.0, 2.0), fontsize=9.0, zorder=7, path_effects=halo(), gid="severity", **look)


def _index(number: int) -> str:
    """A subscript as TeX."""
    return rf"$_\mathregular{{{number}}}$"
