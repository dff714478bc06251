"""Time histories of runs, like the report's Figures 3.1, 3.2, 3.3, 3.5 and 3.6.

Several runs are drawn over each other, told apart by colour and dashes.
"""

from collections.abc import Callable, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.core.runs import LEVEL
from clunk.core.tables import TORQUE
from clunk.plot.style import (
    DASHED,
    FAINT_INK,
    INK,
    LINE_COLOURS,
    MINUS,
    Look,
    PlotError,
    lay_out,
    new_figure,
    plain,
    styled,
    symbol_text,
    tidy,
    tint,
)
from clunk.simulation.history import History, Impact
from clunk.simulation.load import run_load
from clunk.simulation.small_gap import SmallGap
from clunk.study.errors import listing
from clunk.study.loads import PROFILES, STEP_KEYS, numbers

Runs = Sequence[History]
Looks = dict[str, Look]  # name of a run -> colour, dashes and width of its curves

_WIDTH, _AROUND, _LOWEST = 7.2, 1.2, 4.6  # inches: a figure's width, the height around its panels, its least height
_LINE = 1.3  # points, width of a curve
_PATTERNS: tuple[Any, ...] = ("solid", DASHED, (0, (1.2, 1.2)), (0, (6.0, 1.2, 1.2, 1.2)))
_DOTTED = (0, (1.0, 2.0))
_CLOSE, _BEFORE, _TICK = 0.1, 0.03, 0.01  # s: length of a close-up, its part before the impact, and its tick spacing
_GAP_FILL = "#e4e4e4"
_LEAST = 1e-6  # mm, least reach of the coordinate's axis: locked flanks move by rounding alone, which it must not show
_LABELLED = 6  # most impacts whose severity is marked: more arrows would hide the curve, and each other


@styled()
def history_figure(runs: Runs, name: str = "everything") -> Figure:
    """Draw the runs as one of the `FIGURES`, with its panels over one time axis.

    Of several lashes, backlash coordinate and acceleration have a panel for each lash that all runs have. Of one lash,
    the figures `backlash` and `acceleration` have a panel for each load and gap, in which all runs with this load and
    gap are drawn (Figure 3.2). The figure `closeup` shows one lash only.

    Raises PlotError where there is no run, or a `closeup` has no primary impact to show.
    """
    if not runs:
        raise PlotError("There is no run to draw.")
    lashes = min(len(run.lashes) for run in runs) if name != "closeup" else 1
    groups = {"": runs}
    if lashes > 1:
        groups = {plain(runs[0].study.lash_names[k]): [run.lashes[k] for run in runs] for k in range(lashes)}
    elif name in ("backlash", "acceleration"):
        cases = [_case(run) for run in runs]
        groups = {each: [run for run, case in zip(runs, cases, strict=True) if case == each] for each in cases}
    panels = [(*panel, "", runs) for panel in FIGURES[name] if panel[0] not in _OF_LASH]
    for title, group in groups.items():
        panels += [(*panel, title, group) for panel in FIGURES[name] if panel[0] in _OF_LASH]
    figure, axes = _frame(runs, [height for _, height, _, _ in panels])
    looks = _looks(runs)
    for ax, (draw, _, title, group) in zip(axes, panels, strict=True):
        if lashes == 1 and len(groups) > 1 and ax is not axes[0]:
            ax.sharey(axes[0])
        draw(ax, group, looks)
        if title and len(groups) > 1:
            labels = {run.trajectory.label for run in group}
            ax.set_title(f"{title}: {labels.pop()}" if len(labels) == 1 else title, loc="right", fontsize=9.0)
    if name == "closeup":
        _look_closely(axes[0], runs)
    _finish(figure, axes, runs, lashes)
    return figure


def _look_closely(ax: Axes, runs: Runs) -> None:
    """Limit the axes to 0.1 s around the first primary impact, near the flank that it hits (Figure 3.3)."""
    first = min((run for run in runs if run.impacts), key=lambda run: run.impacts[0].begin, default=None)
    if first is None:
        raise PlotError("There is no impact to look at closely: no primary impact happens.")
    impact, side = first.impacts[0].begin, first.touches.side[first.touches.primary.argmax()]
    begin = np.floor((impact - _BEFORE) / _TICK) * _TICK  # the axis begins at a tick
    end = begin + _CLOSE
    near = np.concatenate(
        [side * 1e3 * run.backlash_coordinate[(run.time >= impact) & (run.time <= end)] for run in runs]
    )
    low, high = near.min(), near.max()
    height = max(high - low, 1e-9)
    ax.set(xlim=(begin, end), ylim=sorted((side * (low - 0.2 * height), side * (high + 0.22 * height))))


def _frame(runs: Runs, heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Figure with a column of axes over one time axis, and lines at the load steps; heights : of the axes  [inches]."""
    figure = new_figure((_WIDTH, max(_AROUND + sum(heights), _LOWEST)))
    axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    axes[-1].set_xlabel("Time [s]")
    begin = min(run.time[0] for run in runs)
    end = max(run.time[-1] for run in runs)
    axes[0].set_xlim(begin, end if end > begin else begin + 1.0)
    axes[0].xaxis.set_major_locator(ticker.MaxNLocator(11, steps=[1, 2, 5, 10]))
    for ax in axes:
        tidy(ax)
        for step_time in {run.study.load.step_time for run in runs}:
            ax.axvline(step_time, color=FAINT_INK, linewidth=0.7, linestyle=_DOTTED, zorder=1)
    return figure, axes


def _finish(figure: Figure, axes: Sequence[Axes], runs: Runs, lashes: int) -> None:
    """Write the titles, and below the panels a legend of the runs and of the touches; lashes : how many are drawn."""
    titles, cases = {run.study.title for run in runs}, {_case(run) for run in runs}
    title = titles.pop() if len(titles) == len(cases) == 1 else "Runs compared"
    loads = dict.fromkeys(PROFILES[run.study.load.profile].name for run in runs)
    line = listing([*loads]) + (f", {cases.pop()}" if len(cases) == 1 else "")
    outcomes = {run.name: f": {outcome(run)}" for run in runs}
    if lashes > 1:
        labels = {run.name: ", ".join(each.trajectory.label for each in run.lashes[:lashes]) for run in runs}
        outcomes = {name: f": {text}" if len(runs) > 1 else "" for name, text in labels.items()}
    handles = []
    if len(runs) == 1:
        line += outcomes[runs[0].name]
    else:
        names = [run.name for run in runs]
        for name, look in _looks(runs).items():
            text = plain(name) + (outcomes[name] if names.count(name) == 1 else "")
            handles.append(Line2D([], [], **look, label=text))
    if any(line.get_gid() in ("primary", "secondary") for ax in axes for line in ax.lines):
        for primary, text in ((True, "primary impact"), (False, "secondary impact (chatter)")):
            handles.append(Line2D([], [], marker="^", label=text, **_touch_look(FAINT_INK, primary=primary)))
    lay_out(figure, axes[0], title, line, handles, parse_math=True)


def _looks(runs: Runs) -> Looks:
    """Colour, dashes and width of the curves of each run; runs of the same name look the same."""
    each = zip(dict.fromkeys(run.name for run in runs), cycle(LINE_COLOURS), cycle(_PATTERNS), strict=False)
    return {name: {"color": colour, "linestyle": dashes, "linewidth": _LINE} for name, colour, dashes in each}


def _case(run: History) -> str:
    """Text on the load and the backlash of a run, in symbols."""
    load = run.study.load
    inputs, pieces = run_load(run.study)
    before, after = inputs[TORQUE], pieces[-1, LEVEL]
    text = f"T = {before:g} → {after:g} N m"
    if load.ratio is not None:
        text = f"{symbol_text('σr')} = {load.ratio:g}"
    elif load.profile == "pulse":
        text = f"T = {before:g} → {load.final_torque:g} → {after:g} N m"
    parts = [text, *numbers(dict(load), without=STEP_KEYS)]
    gaps = "/".join(f"{lash.backlash_deg:g}°" for lash in run.study.lashes)
    return f"{', '.join(parts).replace('-', MINUS)}, {symbol_text('φθ')} = {gaps}"


def outcome(run: History) -> str:
    """Text with the label of a run, and its severity if above 0; of several lashes the lash's name comes first."""
    severity = run.trajectory.severity
    name = f"{run.study.lash_names[run.trajectory.lash]} " if len(run.lashes) > 1 else ""
    return name + run.trajectory.label + (f", Q = {severity:.0f} rad/s²" if severity > 0.0 else "")


def draw_angles(ax: Axes, runs: Runs, looks: Looks) -> None:
    """Draw the angles of all inertias: colour tells the inertia, dashes tell the run.

    Of a driveline that can rotate as a whole, this rigid-body rotation is subtracted (`History.twist`).
    """
    names, notes = runs[0].study.driveline.names, []
    colours = cycle([*LINE_COLOURS, *(tint(colour, 0.5) for colour in LINE_COLOURS)])
    for inertia, colour in zip(range(max(run.twist.shape[1] for run in runs)), colours, strict=False):
        for run in runs:
            ax.plot(run.time, run.twist[:, inertia : inertia + 1], zorder=3, **looks[run.name] | {"color": colour})
        name = plain(names[inertia]) if names else ""
        notes.append(Line2D([], [], color=colour, label=f"θ{_index(inertia + 1)} {name}".rstrip()))
    beside: Look = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.03), "borderaxespad": 0.2}
    ax.legend(handles=notes, handlelength=1.4, frameon=False, **beside)
    rolls = any(run.twist is not run.angle for run in runs)
    ax.set_ylabel("Rotation less\nrolling [rad]" if rolls else "Rotation [rad]")


def draw_torque(ax: Axes, runs: Runs, looks: Looks) -> None:
    """Draw the torque of the load."""
    for run in runs:
        single = {"color": INK} if len(runs) == 1 else {}  # the first run's own colour is also the first inertia's
        ax.plot(run.time, run.torque, zorder=3, **looks[run.name] | single)
    ax.set_ylabel("Torque\n[N m]")
    ax.yaxis.set_major_locator(ticker.MaxNLocator(4))
    ax.margins(y=0.25)


def draw_backlash(ax: Axes, runs: Runs, looks: Looks) -> None:
    """Draw the backlash coordinate x_b in mm over the widest gap in grey, and the touches: filled ones are primary."""
    flanks, size, reach = flank_names(runs), 6.5, _LEAST
    widest = max(flanks)
    ax.axhspan(-widest, widest, color=_GAP_FILL, linewidth=0.0, zorder=0)
    for run in runs:
        coordinate, look = 1e3 * run.backlash_coordinate, looks[run.name]
        ax.plot(run.time, coordinate, zorder=3, **look)
        for row, side, primary in zip(*run.touches, strict=True):
            marker: Look = {"marker": "^" if side > 0 else "v", "gid": "primary" if primary else "secondary"}
            marker |= _touch_look(look["color"], primary=primary, size=size)
            ax.plot(run.time[row], coordinate[row], **marker)
        size *= 0.8  # the markers of later runs are smaller, so that all of those in one place can be seen
        reach = max(reach, 1.2 * widest, 1.05 * abs(coordinate).max())
    ax.set_ylabel(f"Backlash coordinate\n{symbol_text('xb')} [mm]")
    ax.set_ylim(-reach, reach)
    names = {0.0: "gap"} | flanks
    right = ax.secondary_yaxis("right")
    right.set_yticks([*names], [*names.values()], fontsize=8.5)
    right.tick_params(length=0.0, labelcolor=FAINT_INK)
    right.spines["right"].set_visible(False)


def flank_names(runs: Runs) -> dict[float, str]:
    """Backlash coordinate [mm] -> name of the flank there, for both flanks of the widest gap.

    A flank is plainly a "flank" where the runs do not have the same initial flank. Without any gap, the coordinate 0
    has the only entry, "no gap".
    """
    widest = max(1e3 * run.half_gap for run in runs)
    initial = {run.trajectory.initial_side for run in runs}
    if not widest:
        return {0.0: "no gap"}
    names = {side: "initial flank" if side in initial else "opposite flank" for side in (-1, 1)}
    return {side * widest: name if len(initial) == 1 else "flank" for side, name in names.items()}


def _touch_look(colour: Any, *, primary: bool, size: float = 6.5) -> Look:
    """Look of a touch's marker: filled for a primary impact, small and open for chatter; size : in points."""
    edge, face, zorder = (INK, colour, 5) if primary else (colour, "white", 4)
    look = {"linestyle": "none", "color": colour, "markeredgewidth": 0.7, "markersize": size if primary else 4.0}
    return look | {"markeredgecolor": edge, "markerfacecolor": face, "zorder": zorder}


def draw_acceleration(ax: Axes, runs: Runs, looks: Looks) -> None:
    """Draw the acceleration of the inertia that gives the severity, and mark each Q_i if there is a single run."""
    for run in runs:
        ax.plot(run.time, run.acceleration[:, run.watched - 1], zorder=3, **looks[run.name] | {"linewidth": 1.0})
    watched = {run.watched for run in runs}
    index = _index(watched.pop()) if len(watched) == 1 else ""
    ax.set_ylabel("Acceleration\n" + rf"$\mathregular{{\ddot{{\theta}}}}${index} [rad/s²]")
    if any(run.study.has_rigid_flanks for run in runs):
        ax.margins(y=0.2)
        text = "restitution model: between the touches only, where velocities jump; Q is not defined"
        ax.text(0.99, 0.97, text, fontsize=8.5, zorder=7, transform=ax.transAxes, ha="right", va="top")
    elif len(runs) == 1:
        _mark_severity(ax, runs[0])


def _mark_severity(ax: Axes, run: History) -> None:
    """Draw a double arrow over the peak-to-peak acceleration of each primary impact, with the value of its Q_i."""
    begin, end = run.time[[0, -1]]
    look: Look = {"ha": "center", "va": "bottom", "fontsize": 9.0, "gid": "severity", "zorder": 6}
    look["arrowprops"] = {"arrowstyle": "<->", "relpos": (0.5, 0.0), "shrinkA": 0.0, "shrinkB": 0.0}
    for impact in measured_impacts(run):
        x = min(impact.begin + 0.028 * (end - begin), 0.5 * (impact.begin + min(impact.end, end)))
        text = f"Q{_index(impact.number)} = {impact.severity:.0f}"
        ax.annotate(text, (x, impact.smallest), (x, impact.largest), **look)
    ax.margins(y=0.12)


def measured_impacts(run: History) -> Sequence[Impact]:
    """Primary impacts within the history whose severities Q_i are marked in a figure.

    There are none for rigid flanks, nor where more than six arrows would hide the curve.
    """
    impacts = [each for each in run.impacts if each.begin <= run.time[-1] and not run.study.has_rigid_flanks]
    return impacts if len(impacts) <= _LABELLED else []


def _index(number: int) -> str:
    """TeX of a number as a subscript."""
    return rf"$_\mathregular{{{number}}}$"


_OF_LASH = (draw_backlash, draw_acceleration)
# Name of a figure -> its panels from top to bottom: the function that draws the panel, and its height  [inches].
FIGURES: dict[str, Sequence[tuple[Callable[[Axes, Runs, Looks], None], float]]] = {
    "everything": ((draw_torque, 0.8), (draw_angles, 2.7), (draw_backlash, 2.2), (draw_acceleration, 2.3)),
    "angles": ((draw_angles, 3.2), (draw_torque, 0.8)),
    "backlash": ((draw_backlash, 2.3),),
    "acceleration": ((draw_acceleration, 2.6),),
    "closeup": ((draw_backlash, _LOWEST - _AROUND),),
}


@styled()
def small_gap(title: str, response: SmallGap) -> Figure:
    """Draw the torque across the lash as the backlash vanishes, and the decay of its lowest mode (Figure 3.5).

    With no gap to cross, the lash stays closed, and its torque F changes sign where the teeth would impact. With the
    lowest mode alone F stays within F_end ± ΔF exp(-ζ1 ω1 t). One of these two limits crosses zero at the
    characteristic time t_c after the step, which is n_c = t_c ω1 / 2π = ln|σr| / (2π ζ1) periods of that mode (report
    Eq. 3.1, where 2π is missing), with σr = ΔF / F_end.
    """
    ratio = f"{response.ratio:.4g}".replace("-", "−")
    values = f"{symbol_text('σr')} = {ratio}, {symbol_text('ζ1')} = {response.damping_ratio:.3f}"
    figure = new_figure((_WIDTH, 4.8))
    ax = figure.add_subplot()
    time, zero = response.time, response.step_time + response.characteristic_time
    swing = abs(response.start - response.end) * np.exp(-response.decay * (time - response.step_time))
    for side, label in ((1.0, "exponential decay"), (-1.0, "")):
        ax.plot(time, response.end + side * swing, color=LINE_COLOURS[1], linestyle=DASHED, label=label)
    ax.plot(time, response.torque, color=LINE_COLOURS[0], linewidth=1.5, zorder=4, label="response")
    ax.axhline(0.0, color=INK, linewidth=1.0, zorder=2)
    ax.axhline(response.end, color=FAINT_INK, linewidth=0.9, linestyle=_DOTTED, label="equilibrium")
    crossing = "the exponential decay never crosses zero"
    if np.isfinite(response.periods):
        formula = f"{symbol_text('nc')} = ln|{symbol_text('σr')}| / (2π {symbol_text('ζ1')})"
        crossing = (
            f"{formula} = {response.periods:.2f} periods of {1.0 / response.frequency:.3g} s until it crosses zero"
        )
        label = f"characteristic time {symbol_text('tc')}"
        ax.plot(zero, 0.0, "o", color=LINE_COLOURS[1], markeredgecolor=INK, zorder=6, gid="tc", label=label)
    ax.set(xlabel="Time [s]", ylabel="Torque across the lash [N m]", xlim=time[[0, -1]])
    tidy(ax)
    line = f"ideal step to the last torque, limit of vanishing backlash, the lash always closed; {values}: {crossing}"
    lay_out(figure, ax, title, line, ax.get_legend_handles_labels()[0], parse_math=True)
    return figure
