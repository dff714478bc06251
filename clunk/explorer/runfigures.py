"""The figures of runs: load, lash coordinate, acceleration and contact torque over one time axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from bokeh.events import Reset
from bokeh.models import BoxAnnotation, DataRange1d, Div, Range1d, Span
from bokeh.plotting import figure

from clunk.explorer.curves import thinned
from clunk.explorer.mapfigure import RUN_COLOURS
from clunk.explorer.message import Changes, Message, source
from clunk.plot.style import FAINT_INK, INK
from clunk.simulation.history import History
from clunk.study.arrays import Floats

_COLUMNS = 800  # spans of time that a screen tells apart
_MOST_ARROWS = 12  # impacts; more arrows than these would hide the curve
_LEFT, _RIGHT = 72, 32  # pixels beside all panels, so that their time axes lie under each other


class _Panel(NamedTuple):
    name: str
    label: str
    values: Callable[[History], Floats]
    share: float  # of the height
    padding: float = 0.25  # of the height of the curves, above and below them together


_PANELS = (
    _Panel("torque", "load [N m]", lambda run: run.torque, 0.9),
    _Panel("lash", "lash x_b [mm]", lambda run: 1e3 * run.backlash_coordinate, 1.4),
    _Panel("acceleration", "θ'' [rad/s²]", lambda run: run.acceleration[:, run.watched - 1], 1.4, 0.6),
    _Panel("contact", "contact [N m]", lambda run: run.contact_torque, 1.6),
)


class RunFigures:
    """Panels of one run and of those that are pinned beside it, thinned anew for what the time axis shows.

    texts : by name, what is written beside the panels
    """

    def __init__(self, **texts: Div) -> None:
        self._runs: Sequence[History] = []
        self._time = Range1d(0.0, 1.0)
        self._whole = self._span = (0.0, 1.0)  # times of the runs, and those that are seen
        self._steps: list[Span] = []
        # all curves of all panels in one source
        self._curves = source(*(f"{panel.name}_{axis}" for panel in _PANELS for axis in "xy"), "colour")
        unit = [[0.0, 1.0]]  # a line to begin with: without any, ranges are complained of in the browser's console
        self._curves.data = dict.fromkeys(self._curves.data, unit) | {"colour": ["white"]}
        self.figures = {panel.name: self._figure(panel) for panel in _PANELS}
        lash, acceleration = self.figures["lash"], self.figures["acceleration"]
        gap = BoxAnnotation(fill_color="#e4e4e4", fill_alpha=1.0, level="underlay", line_color=None)
        lash.add_layout(gap)
        flanks = source("x", "y", "text", "baseline")
        small = {"text_font_size": "11px", "text_color": FAINT_INK, "x_offset": 4}
        lash.text("x", "y", "text", source=flanks, text_baseline="baseline", **small)
        touches = source("x", "y", "angle", "fill", "colour", "size")
        look = {"line_color": "colour", "fill_color": "fill", "size": "size", "angle": "angle"}
        lash.scatter("x", "y", source=touches, marker="triangle", **look)
        arrows = source("x", "low", "high", "text")
        acceleration.segment("x", "low", "x", "high", source=arrows, color=INK, line_width=1.0)
        for end, angle in (("low", np.pi), ("high", 0.0)):
            acceleration.scatter("x", end, source=arrows, marker="triangle", size=5, color=INK, angle=angle)
        text = {"text_align": "center", "text_baseline": "bottom", "text_font_size": "11px", "y_offset": -2}
        acceleration.text("x", "high", "text", source=arrows, **text)
        for name in ("start", "end"):
            self._time.on_change(name, self._on_zoom)
        sources = {"curves": self._curves, "flanks": flanks, "touches": touches, "arrows": arrows}
        self._marks = {name: list(source.data) for name, source in sources.items() if name != "curves"}
        self._message = Message(time=self._time, gap=gap, **sources, **texts)
        lash.tags = [self._message.source]  # a part of the page that is not drawn

    def _figure(self, panel: _Panel) -> Any:
        plot = figure(
            name=panel.name,
            x_range=self._time,
            y_range=DataRange1d(range_padding=panel.padding),
            y_axis_label=panel.label,
            lod_threshold=None,
            tools="xpan,xwheel_zoom,xbox_zoom,reset",
            active_drag="xbox_zoom",
            toolbar_location="right" if panel.name == "lash" else None,
            sizing_mode="stretch_both",
            min_height=int(64 * panel.share),
            styles={"flex": f"{panel.share} 1 0"},
            min_border_left=_LEFT,
            min_border_right=_RIGHT,
            min_border_bottom=2,
            min_border_top=2,
            margin=0,
        )
        plot.toolbar.logo = None
        plot.yaxis.axis_label_text_font_size = "11px"
        plot.yaxis.ticker.desired_num_ticks = 3 if panel.share < 1.0 else 5
        plot.axis.minor_tick_line_color = None
        plot.xgrid.visible = False
        plot.ygrid.grid_line_color = "#e6e6e6"
        plot.outline_line_color = None
        if panel is _PANELS[-1]:
            plot.xaxis.axis_label = "time [s]"
        else:
            plot.xaxis.visible = False
        step = Span(location=0.0, dimension="height", line_color=FAINT_INK, line_dash="dotted", line_width=1.0)
        plot.add_layout(step)
        self._steps.append(step)
        plot.multi_line(f"{panel.name}_x", f"{panel.name}_y", source=self._curves, color="colour", line_width=1.4)
        plot.on_event(Reset, lambda _: self._message.send({**self._see(self._whole), **self._drawn()}))
        return plot

    def show(self, runs: Sequence[History], **texts: str) -> None:
        """Show a run and those that are pinned, and texts; the time axis stays as the user has zoomed it."""
        self._runs = runs
        changes: dict[str, dict[str, Any]] = {name: {"text": text} for name, text in texts.items()}
        if runs:
            whole = float(min(run.time[0] for run in runs)), float(max(run.time[-1] for run in runs))
            if self._span == self._whole:
                changes |= self._see(whole)
            self._whole = whole
            for step in self._steps:
                step.location = runs[0].study.load.step_time
            half = 1e3 * runs[0].half_gap
            changes |= {"gap": {"bottom": -half, "top": half}, **self._marks_of(runs[0])}
        else:
            changes |= {name: {"data": {column: [] for column in columns}} for name, columns in self._marks.items()}
        self._message.send({**changes, **self._drawn()})

    def _see(self, span: tuple[float, float]) -> dict[str, dict[str, Any]]:
        """Let the time axis begin and end at these times."""
        self._span = span
        return {"time": {"start": span[0], "end": span[1]}}

    def _on_zoom(self, _attribute: str, _old: float, _new: float) -> None:
        self._span = float(self._time.start), float(self._time.end)
        self._message.send(self._drawn())

    def _drawn(self) -> Changes:
        """The curves of all runs within what the time axis shows."""
        begin, end = self._span
        shown = list(zip(self._runs, RUN_COLOURS, strict=False))[::-1]
        data: dict[str, list[Any]] = {"colour": [colour for _, colour in shown]}
        for panel in _PANELS:
            curves = [thinned(run.time, panel.values(run), begin, end, _COLUMNS) for run, _ in shown]
            data[f"{panel.name}_x"], data[f"{panel.name}_y"] = [x for x, _ in curves], [y for _, y in curves]
        return {"curves": {"data": data}}

    def _marks_of(self, run: History) -> dict[str, dict[str, Any]]:
        """Flanks, touches and Q_i of the run that is shown."""
        half, side = 1e3 * run.half_gap, run.trajectory.initial_side
        names = {side * half: "initial flank", -side * half: "opposite flank"} if half > 0.0 else {0.0: "no gap"}
        on_top = np.argsort(run.touches.primary, kind="stable")  # primary ones last
        row, sides, primary = (each[on_top] for each in run.touches[:3])
        offset = 0.012 * (self._whole[1] - self._whole[0])
        impacts = [] if run.is_restitution else [each for each in run.impacts if each.rows.stop > each.rows.start]
        impacts = impacts if len(impacts) <= _MOST_ARROWS else []
        marks: dict[str, dict[str, Any]] = {
            "flanks": {
                "x": [self._whole[0]] * len(names),
                "y": list(names),
                "text": list(names.values()),
                "baseline": ["top" if y > 0.0 else "bottom" for y in names],
            },
            "touches": {
                "x": run.time[row],
                "y": 1e3 * run.backlash_coordinate[row],
                "angle": np.where(sides > 0, 0.0, np.pi),
                "fill": [RUN_COLOURS[0] if each else "white" for each in primary],
                "colour": [RUN_COLOURS[0]] * row.size,
                "size": np.where(primary, 10, 6),
            },
            "arrows": {
                "x": [each.begin + offset for each in impacts],
                "low": [each.smallest for each in impacts],
                "high": [each.largest for each in impacts],
                "text": [f"Q{each.number} = {each.severity:.0f}" for each in impacts],
            },
        }
        return {name: {"data": columns} for name, columns in marks.items()}
