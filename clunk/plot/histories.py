"""Time histories of runs, like the report's Figures 3.1, 3.2, 3.3, 3.5 and 3.6.

Several runs are drawn over each other, told apart by colour and dashes, those of the indentation model the more solid.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.plot import style
from clunk.plot.history_panels import (
    Curve,
    draw_acceleration,
    draw_angles,
    draw_backlash,
    draw_speeds,
    draw_torque,
    touch_look,
)
from clunk.plot.style import FAINT_INK, HISTORY_WIDTH, INK, MINUS, PlotError
from clunk.simulation.history import History
from clunk.simulation.load import load_step
from clunk.simulation.small_gap import SmallGap
from clunk.study.arrays import Bools
from clunk.study.loads import PROFILES, STEP_KEYS, numbers
from clunk.study.problems import listing

Runs = Sequence[History]
_Panel = tuple[Callable[[Axes, Sequence[Curve]], None], float]  # draws it, and its share of the height

_LINE = 1.3  # points
_PATTERNS: tuple[Any, ...] = ("solid", style.DASHED, (0, (1.2, 1.2)), (0, (6.0, 1.2, 1.2, 1.2)))
_BEFORE = 0.4  # share of a close-up's width before the moment that it is around


def simulation_figure(runs: Runs, *, each_lash: bool = True) -> Figure:
    """Load, angles, backlash coordinate and acceleration of runs on one time axis, the latter two of each lash."""
    shared: list[_Panel] = [(draw_torque, 0.9), (draw_angles, 3.0)]
    of_lash: list[_Panel] = [(draw_backlash, 2.4), (draw_acceleration, 2.6)]
    by_lash = _by_lash(runs, of_lash, each_lash)
    panels = by_lash or of_lash
    return _stacked(runs, [*shared, *panels], 4.6 + 2.3 * len(panels), marks=True, outcomes=not by_lash)


def angles(runs: Runs) -> Figure:
    """The angle of every inertia over the load (Figure 3.1)."""
    return _stacked(runs, ((draw_angles, 4.0), (draw_torque, 1.0)), 5.2)


def speeds(runs: Runs) -> Figure:
    """The speed of every inertia over the load."""
    return _stacked(runs, ((draw_speeds, 4.0), (draw_torque, 1.0)), 5.2)


@style.styled()
def backlash(runs: Runs, *, each_lash: bool = True) -> Figure:
    """The backlash coordinate in its gap, every touch marked (Figure 3.2).

    Runs that differ in their contact alone share a panel; every other one has its own. Of several lashes each has one.
    """
    if by_lash := _by_lash(runs, [(draw_backlash, 1.0)], each_lash):
        return _stacked(runs, by_lash, 1.5 + 2.3 * len(by_lash), marks=True, outcomes=False)
    panels: list[Runs] = [[run for run in runs if run.setup == setup] for setup in dict.fromkeys(r.setup for r in runs)]
    if len(panels) > 1:  # a panel's title says what its runs have in common, and runs alike look alike
        panels = [_shortened(panel) for panel in panels]
        runs = [run for panel in panels for run in panel]
    figure, axes = _frame(runs, (1.0,) * len(panels), 1.5 + (3.4 if len(panels) == 1 else 2.3 * len(panels)))
    looks = {run.name: look for run, look in _curves(runs)}
    for ax, panel in zip(axes, panels, strict=True):
        draw_backlash(ax, [(run, looks[run.name]) for run in panel])
        if len(panels) > 1:
            labels = dict.fromkeys(run.trajectory.label for run in panel)
            ax.set_title(f"{_case(panel[0])}: {', '.join(labels)}", loc="right", fontsize=9.0)
    return _finished(figure, axes, runs, marks=True)


@style.styled()
def closeup(runs: Runs, around: float | None = None, width: float = 0.1) -> Figure:
    """The backlash coordinate near one flank for a short time, every touch marked (Figure 3.3).

    around : float, optional  [s], on the plot's axis; by default the first primary impact
    width : float  [s], of the time axis

    Raises PlotError where no run touches a flank in that time.
    """
    if around is None:
        around = min((run.impacts[0].begin for run in runs if run.impacts), default=None)
        if around is None:
            raise PlotError("There is no impact to look at closely: no primary impact happens.")
    if not width > 0.0:
        raise PlotError(f"A close-up must be wider than {width:g} s.")
    begin = 0.1 * width * np.round((around - _BEFORE * width) / (0.1 * width))  # so that the axis begins at a tick
    end = begin + width
    times = [run.time[run.touches.row] for run in runs]
    within = [(time >= begin) & (time <= end) for time in times]
    distances = [
        pair
        for run, time, mask in zip(runs, times, within, strict=True)
        for pair in zip(np.abs(time - around)[mask].tolist(), run.touches.side[mask].tolist(), strict=True)
    ]
    if not distances:
        raise PlotError(f"There is no touch to look at closely between {begin:g} s and {end:g} s.")
    limits = _closeup_range(runs, within, min(distances)[1])
    figure, (ax,) = _frame(runs, (1.0,), 4.6)
    draw_backlash(ax, _curves(runs), limits)
    ax.set_xlim(begin, end)
    return _finished(figure, [ax], runs, marks=True)


@style.styled()
def acceleration(runs: Runs, *, each_lash: bool = True) -> Figure:
    """The acceleration behind the severity, with each impact's peak-to-peak value Q_i (Figure 3.6).

    There is a panel for each run or, of several lashes, for each of these.
    """
    if by_lash := _by_lash(runs, [(draw_acceleration, 1.0)], each_lash):
        return _stacked(runs, by_lash, 1.6 + 2.6 * len(by_lash), outcomes=False)
    figure, axes = _frame(runs, (1.0,) * len(runs), 1.6 + (3.2 if len(runs) == 1 else 2.6) * len(runs))
    for ax, (run, look) in zip(axes, _curves(runs), strict=True):
        if ax is not axes[0]:
            ax.sharey(axes[0])
        draw_acceleration(ax, [(run, look | {"linestyle": "solid"})])
        if len(runs) > 1:
            ax.set_title(f"{style.plain(run.name)}: {run.trajectory.label}", loc="right", fontsize=9.0)
    return _finished(figure, axes, runs, legend=False)  # each panel names its run


def _by_lash(runs: Runs, panels: Sequence[_Panel], each_lash: bool) -> list[_Panel]:
    """Panels of each lash that all runs have; none where that is one, or where `each_lash` is not asked for."""
    lashes = min((len(run.lashes) for run in runs), default=1) if each_lash else 1
    return [_of_lash(draw, lash, share) for lash in range(lashes) for draw, share in panels] if lashes > 1 else []


def _of_lash(draw: Callable[[Axes, Sequence[Curve]], None], lash: int, share: float) -> _Panel:
    """Panel of one of several lashes, with its name and, of a single run, its label."""

    def draw_lash(ax: Axes, curves: Sequence[Curve]) -> None:
        views = [(run.lashes[lash], look) for run, look in curves]
        draw(ax, views)
        label = f": {views[0][0].trajectory.label}" if len(views) == 1 else ""
        look: dict[str, Any] = {"ha": "right", "va": "top", "zorder": 7, "path_effects": style.halo()}
        name = style.plain(_lash_name(views[0][0])) + label
        ax.text(0.99, 0.97, name, transform=ax.transAxes, fontsize=9.0, **look)

    return draw_lash, share


def _lash_name(run: History) -> str:
    return run.study.lash_names[run.trajectory.lash]


def _closeup_range(runs: Runs, within: Iterable[Bools], side: int) -> tuple[float, float]:
    """Limits of the backlash coordinate that show the rebounds and the indentation on one flank  [mm].

    within : for each run which of its touches are shown
    """
    lowest, highest = np.inf, -np.inf
    for run, mask in zip(runs, within, strict=True):
        on_side = np.flatnonzero(mask & (run.touches.side == side))
        if not on_side.size:
            continue
        first, last = run.touches.row[on_side[[0, -1]]]
        until = run.touches.until[on_side[-1]]
        stop = max(last + 1, int(np.searchsorted(run.after_step, until, side="right")))
        coordinate = side * 1e3 * run.backlash_coordinate
        lowest, highest = min(lowest, coordinate[first : last + 1].min()), max(highest, coordinate[first:stop].max())
    height = max(highest - lowest, 0.02 * max(1e3 * run.half_gap for run in runs), 1e-9)
    low, high = lowest - 0.2 * height, highest + 0.22 * height
    return (low, high) if side > 0 else (-high, -low)


@style.styled()
def _stacked(
    runs: Runs, panels: Sequence[_Panel], height: float, *, marks: bool = False, outcomes: bool = True
) -> Figure:
    """Panels over one time axis, each a function that draws it and its share of the height."""
    figure, axes = _frame(runs, [share for _, share in panels], height)
    for ax, (draw, _) in zip(axes, panels, strict=True):
        draw(ax, _curves(runs))
    return _finished(figure, axes, runs, marks=marks, outcomes=outcomes)


def _frame(runs: Runs, heights: Sequence[float], height: float) -> tuple[Figure, list[Axes]]:
    """A column of axes over one time axis."""
    if not runs:
        raise PlotError("There is no run to draw.")
    figure = style.new_figure((HISTORY_WIDTH, height))
    axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    axes[-1].set_xlabel("Time [s]")
    begin = min(float(run.time[0]) for run in runs)
    end = max(float(run.time[-1]) for run in runs)
    axes[0].set_xlim(begin, end if end > begin else begin + 1.0)
    axes[0].xaxis.set_major_locator(ticker.MaxNLocator(11, steps=[1, 2, 5, 10]))
    for ax in axes:
        style.tidy(ax)
        for step_time in {run.study.load.step_time for run in runs}:
            ax.axvline(step_time, color=FAINT_INK, linewidth=0.7, linestyle=(0, (1.0, 2.0)), zorder=1)
    return figure, axes


def _finished(
    figure: Figure,
    axes: Sequence[Axes],
    runs: Runs,
    *,
    marks: bool = False,
    legend: bool = True,
    outcomes: bool = True,
) -> Figure:
    """The figure with titles above, and below a legend of the runs and of the marks; outcomes : of the lash in view."""
    titles, cases = {run.study.title for run in runs}, {_case(run) for run in runs}
    title = titles.pop() if len(titles) == len(cases) == 1 else "Runs compared"
    loads = dict.fromkeys(PROFILES[run.study.load.profile].name for run in runs)
    line = listing([*loads]) + (f", {cases.pop()}" if len(cases) == 1 else "")
    if len(runs) == 1 and outcomes:
        line = f"{line}: {_outcome(runs[0])}"
    handles: list[Artist] = []
    if legend and len(runs) > 1:
        names = [run.name for run in runs]
        for name, (run, look) in {run.name: (run, look) for run, look in _curves(runs)}.items():
            outcome = f": {_outcome(run)}" if outcomes and names.count(name) == 1 else ""
            handles.append(Line2D([], [], **look, label=style.plain(name) + outcome))
    if marks and any(run.touches.row.size for run in runs):
        for primary, text in ((True, "primary impact"), (False, "secondary impact (chatter)")):
            handles.append(Line2D([], [], marker="^", label=text, **touch_look(FAINT_INK, primary=primary)))
    style.lay_out(figure, axes[0], title, line, handles, parse_math=True)
    return figure


def _curves(runs: Runs) -> list[Curve]:
    """Runs with their colours and dashes, alike for one name; indentation takes the first dashes, as in Figure 3.2."""
    is_restitution = {run.name: run.is_restitution for run in reversed(runs)}  # of several alike the first counts
    names = list(dict.fromkeys(run.name for run in runs))
    colours = dict(zip(names, cycle(style.LINE_COLOURS), strict=False))
    patterns = dict(zip(sorted(names, key=is_restitution.__getitem__), cycle(_PATTERNS), strict=False))
    return [(run, {"color": colours[run.name], "linestyle": patterns[run.name], "linewidth": _LINE}) for run in runs]


def _case(run: History) -> str:
    """The load and the gap of a run, in symbols."""
    load = run.study.load
    before, after = load_step(load)
    text = f"T = {before:g} → {after:g} N m"
    if load.ratio is not None:
        text = f"{style.symbol_text('σr')} = {load.ratio:g}"
    elif load.profile == "pulse":
        text = f"T = {before:g} → {load.final_torque:g} → {after:g} N m"
    parts = [text, *numbers(dict(load), without=STEP_KEYS)]
    gaps = "/".join(f"{lash.backlash_deg:g}°" for lash in run.study.lashes)
    return f"{', '.join(parts).replace('-', MINUS)}, {style.symbol_text('φθ')} = {gaps}"


def _outcome(run: History) -> str:
    """The label of a run and its severity, where it has one; of one of several lashes with its name."""
    severity = run.trajectory.severity
    name = f"{_lash_name(run)} " if len(run.lashes) > 1 else ""
    return name + run.trajectory.label + (f", Q = {severity:.0f} rad/s²" if severity > 0.0 else "")


def _shortened(runs: Runs) -> Runs:
    """The runs without the parts of their names, "KEY=VALUE, KEY=VALUE", that are the same for all."""
    parts = [run.name.split(", ") for run in runs]
    common = set(parts[0]).intersection(*parts[1:])
    names = [", ".join(part for part in words if part not in common) for words in parts]
    return [replace(run, name=name) for run, name in zip(runs, names, strict=True)] if all(names) else runs


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
        text = f"{values}: {formula} periods of {1.0 / response.frequency:.3g} s until {time.replace('-', MINUS)}"
    else:
        text = f"{values}: the exponential decay never crosses zero"
    figure = style.new_figure((HISTORY_WIDTH, 4.8))
    ax = figure.add_subplot()
    _draw_small_gap(ax, response)
    text = f"limit of vanishing backlash, the lash always closed\n{text}"
    style.lay_out(figure, ax, title, text, ax.get_legend_handles_labels()[0], parse_math=True)
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
    ax.axhline(0.0, color=INK, linewidth=1.0, zorder=2)
    ax.axhline(response.end, color=FAINT_INK, linewidth=0.9, linestyle=(0, (1.0, 2.0)), label="equilibrium")
    swing = reach * np.exp(-response.decay * (response.time - t0))
    for curve, name in ((response.end + swing, "exponential decay"), (response.end - swing, "_")):
        ax.plot(response.time, curve, color=orange, linewidth=1.1, linestyle=style.DASHED, label=name)
    time, torque = np.append(t0 - lead, response.time), np.append(response.start, response.torque)
    ax.plot(time, torque, color=blue, linewidth=1.5, zorder=4, label="response")
    times = {"t0": t0}
    if _crosses_zero(response):
        times["tc"] = t0 + response.characteristic_time
        point: dict[str, Any] = {"color": orange, "markeredgecolor": INK, "markersize": 5.5}
        ax.plot(times["tc"], 0.0, "o", zorder=6, gid="tc", **point)
    for name, at in times.items():
        ax.axvline(at, color=FAINT_INK, linewidth=0.7, linestyle=(0, (4.0, 3.0)), zorder=1)
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
