"""Runs as figures for people: time histories like the report's Figures 3.1, 3.2, 3.3 and 3.6.

A run comes as (label, trajectory, history); several are drawn over each other, told apart by colour and dashes, those
of the indentation model the more solid.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.core.events import TOUCH
from clunk.plot.history_panels import (
    Runs,
    draw_acceleration,
    draw_angles,
    draw_backlash,
    draw_torque,
    half_gap,
    is_restitution,
)
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
    plain,
    set_titles,
    styled,
    symbol_text,
    tidy,
)
from clunk.simulation.history import History
from clunk.simulation.load import load_step
from clunk.simulation.trajectory import Trajectory
from clunk.study.config import Study

_LINE = 1.3  # points
_PATTERNS: tuple[Any, ...] = ("solid", DASHED, (0, (1.2, 1.2)), (0, (6.0, 1.2, 1.2, 1.2)))
_BEFORE = 0.4  # of a close-up's width lies before the moment that it is around


def simulation_figure(runs: Runs) -> Figure:
    """Everything about a run on one time axis: angles, load, backlash coordinate and acceleration."""
    with styled():
        figure, axes = _frame(runs, (3.0, 0.9, 2.4, 2.6), 9.2)
        looks = _looks(runs)
        draw_angles(axes[0], runs, looks)
        draw_torque(axes[1], runs, looks)
        draw_backlash(axes[2], runs, looks)
        draw_acceleration(axes[3], runs, looks)
        return _finished(figure, axes, runs, marks=True)


def angles(runs: Runs) -> Figure:
    """The angle of every inertia over the load (Figure 3.1)."""
    with styled():
        figure, axes = _frame(runs, (4.0, 1.0), 5.2)
        looks = _looks(runs)
        draw_angles(axes[0], runs, looks)
        draw_torque(axes[1], runs, looks)
        return _finished(figure, axes, runs)


def backlash(runs: Runs) -> Figure:
    """The backlash coordinate in its gap, every touch marked (Figure 3.2).

    Runs that differ in their contact alone share a panel; every other one has its own.
    """
    panels = _panels(runs)
    if len(panels) > 1:  # what a panel's runs have in common is said by its title, and runs alike look alike
        panels = [_told_apart(panel) for panel in panels]
        runs = [run for panel in panels for run in panel]
    with styled():
        figure, axes = _frame(runs, (1.0,) * len(panels), 1.5 + (3.4 if len(panels) == 1 else 2.3 * len(panels)))
        looks = dict(zip((label for label, _, _ in runs), _looks(runs), strict=True))
        for ax, panel in zip(axes, panels, strict=True):
            draw_backlash(ax, panel, [looks[label] for label, _, _ in panel])
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
    with styled():
        figure, (ax,) = _frame(runs, (1.0,), 4.6)
        draw_backlash(ax, runs, _looks(runs), _closeup_range(runs, touches, nearest))
        ax.set_xlim(begin, end)
        return _finished(figure, [ax], runs, marks=True)


def acceleration(runs: Runs) -> Figure:
    """The acceleration behind the severity, with each impact's peak-to-peak value Q_i (Figure 3.6); a panel per run."""
    with styled():
        figure, axes = _frame(runs, (1.0,) * len(runs), 1.6 + (3.2 if len(runs) == 1 else 2.6) * len(runs))
        for ax, run, look in zip(axes, runs, _looks(runs), strict=True):
            if ax is not axes[0]:
                ax.sharey(axes[0])
            draw_acceleration(ax, [run], [look | {"linestyle": "solid"}])
            if len(runs) > 1:
                ax.set_title(f"{plain(run[0])}: {run[1].label}", loc="right", fontsize=9.0)
        return _finished(figure, axes, runs, legend=False)  # each panel names its run


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
    smallest = 0.02 * max(1e3 * half_gap(trajectory.study) for _, trajectory, _ in runs)
    height = max(highest - lowest, smallest, 1e-9)
    low, high = lowest - 0.2 * height, highest + 0.22 * height
    return (low, high) if side > 0 else (-high, -low)


def _frame(runs: Runs, heights: Sequence[float], height: float) -> tuple[Figure, list[Axes]]:
    """A column of axes over one time axis."""
    if not runs:
        raise PlotError("There is no run to draw.")
    figure = new_figure((HISTORY_WIDTH, height))
    axes = list(figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0])
    axes[-1].set_xlabel("Time [s]")
    begin = min(float(history.time[0]) for _, _, history in runs)
    end = max(float(history.time[-1]) for _, _, history in runs)
    axes[0].set_xlim(begin, end if end > begin else begin + 1.0)
    axes[0].xaxis.set_major_locator(ticker.MaxNLocator(11, steps=[1, 2, 5, 10]))
    for ax in axes:
        tidy(ax)
        for step_time in {trajectory.study.load.step_time for _, trajectory, _ in runs}:
            ax.axvline(step_time, color=FAINT_INK, linewidth=0.7, linestyle=(0, (1.0, 2.0)), zorder=1)
    return figure, axes


def _finished(figure: Figure, axes: Sequence[Axes], runs: Runs, *, marks: bool = False, legend: bool = True) -> Figure:
    """Titles above, the runs and the marks explained below."""
    titles = {trajectory.study.title for _, trajectory, _ in runs}
    cases = {_case(trajectory.study) for _, trajectory, _ in runs}
    title = titles.pop() if len(titles) == len(cases) == 1 else "Runs compared"
    line = "ideal torque step (tip-out)" + (f", {cases.pop()}" if len(cases) == 1 else "")
    if len(runs) == 1:
        line = f"{line}: {_outcome(runs[0][1])}"
    set_titles(figure, axes[0], title, line, parse_math=True)
    handles: list[Line2D] = []
    labels = [label for label, _, _ in runs]
    for k, (label, look) in enumerate(zip(labels, _looks(runs), strict=True)):
        if legend and len(runs) > 1 and label not in labels[:k]:
            outcome = f": {_outcome(runs[k][1])}" if labels.count(label) == 1 else ""
            handles.append(Line2D([], [], **look, label=plain(label) + outcome))
    if marks and any(trajectory.touches for _, trajectory, _ in runs):
        common: dict[str, Any] = {"linestyle": "none", "markeredgewidth": 0.7, "color": FAINT_INK}
        handles.append(
            Line2D([], [], marker="^", markersize=6.5, markeredgecolor=INK, label="primary impact", **common)
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
        columns = max(1, min(len(handles), int((HISTORY_WIDTH - 0.4) / (0.45 + 0.07 * widest))))
        figure.legend(handles=handles, loc="outside lower center", ncols=columns, frameon=False)
    freeze_layout(figure, axes[0])
    return figure


def _looks(runs: Runs) -> list[dict[str, Any]]:
    """How each run is drawn; runs of one label alike. Indentation takes the first dash patterns, as in Figure 3.2."""
    models: dict[str, bool] = {}
    for label, trajectory, _ in runs:
        models.setdefault(label, is_restitution(trajectory))
    order = sorted(models, key=lambda label: models[label])  # stable: False, the indentation model, first
    return [
        {
            "color": LINE_COLOURS[list(models).index(label) % len(LINE_COLOURS)],
            "linestyle": _PATTERNS[order.index(label) % len(_PATTERNS)],
            "linewidth": _LINE,
        }
        for label, _, _ in runs
    ]


def _case(study: Study) -> str:
    """The load and the gap of a run, in symbols."""
    load = load_step(study.load)
    ratio = f"{symbol_text('σr')} = {study.load.ratio:g}".replace("-", MINUS) if study.load.ratio is not None else ""
    torque = f"T = {load.before:g} → {load.after:g} N m".replace("-", MINUS)
    gap = f"{symbol_text('φθ')} = {study.lash.backlash_deg:g}°"
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
