"""The right half of the page: the run that is shown and those that are pinned, in figures, texts and a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from bokeh.events import Reset
from bokeh.models import BoxAnnotation, DataRange1d, Div, Range1d, Span
from bokeh.plotting import figure

from clunk.explorer.mapfigure import RUN_COLOURS, Cell
from clunk.explorer.message import Changes, Message, columns, source
from clunk.plot.style import FAINT_INK, INK
from clunk.simulation.history import History
from clunk.study.arrays import Floats
from clunk.study.records import html_table

_COLUMNS = 800  # spans of time that a screen tells apart
_MOST_ARROWS = 12  # impacts; more arrows than these would hide the curve
_LEFT, _RIGHT = 72, 32  # pixels beside all panels, so that their time axes lie under each other
_WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (2, 6, 2, 6)}


class Shown(NamedTuple):
    """A run on the page, with what it takes to make it again."""

    cell: Cell
    values: dict[str, float]  # of all axes
    numbers: dict[str, float]
    history: History
    place: str  # values and numbers in words


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
    """Panels, header and event table of one run and of those that are pinned beside it.

    Curves are thinned anew for what the time axis shows.

    load_step : its time  [s]
    header, compared, events : texts above and below the figures
    message : carries what changes
    """

    def __init__(self, load_step: float) -> None:
        self._load_step = load_step
        self.header = Div(name="header", height=62, styles={"overflow": "hidden", "flex": "none"}, **_WIDE)
        self.compared = Div(name="compared", styles={"flex": "none"}, **_WIDE)
        self.events = Div(name="events", styles={"overflow-y": "auto", "font-size": "12px"}, **_WIDE)
        self.events.update(sizing_mode="stretch_both", min_height=80, max_height=170)
        self._runs: Sequence[History] = []
        self._time = Range1d(0.0, 1.0)
        self._whole = self._span = (0.0, 1.0)  # times of the runs, and those that are seen
        # all curves of all panels in one source
        self._curves = source(" ".join(["colour", *(f"{panel.name}_{axis}" for panel in _PANELS for axis in "xy")]))
        unit = [[0.0, 1.0]]  # a line to begin with: without any, ranges are complained of in the browser's console
        self._curves.data = dict.fromkeys(self._curves.data, unit) | {"colour": ["white"]}
        self.figures = {panel.name: self._figure(panel) for panel in _PANELS}
        lash, acceleration = self.figures["lash"], self.figures["acceleration"]
        gap = BoxAnnotation(fill_color="#e4e4e4", fill_alpha=1.0, level="underlay", line_color=None)
        lash.add_layout(gap)
        flanks = source("x y text baseline")
        lash.text(
            "x",
            "y",
            "text",
            source=flanks,
            text_baseline="baseline",
            text_font_size="11px",
            text_color=FAINT_INK,
            x_offset=4,
        )
        touches = source("x y angle fill colour size")
        lash.scatter(
            "x",
            "y",
            source=touches,
            marker="triangle",
            line_color="colour",
            fill_color="fill",
            size="size",
            angle="angle",
        )
        arrows = source("x low high text")
        acceleration.segment("x", "low", "x", "high", source=arrows, color=INK, line_width=1.0)
        for end, angle in (("low", np.pi), ("high", 0.0)):
            acceleration.scatter("x", end, source=arrows, marker="triangle", size=5, color=INK, angle=angle)
        acceleration.text(
            "x",
            "high",
            "text",
            source=arrows,
            text_align="center",
            text_baseline="bottom",
            text_font_size="11px",
            y_offset=-2,
        )
        for name in ("start", "end"):
            self._time.on_change(name, self._on_zoom)
        models = {"time": self._time, "gap": gap, "curves": self._curves, "flanks": flanks, "touches": touches}
        models |= {"arrows": arrows, "header": self.header, "compared": self.compared, "events": self.events}
        self.message = Message(models)
        lash.tags = [self.message.source]  # a part of the page that is not drawn

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
        step = Span(
            location=self._load_step, dimension="height", line_color=FAINT_INK, line_dash="dotted", line_width=1.0
        )
        plot.add_layout(step)
        plot.multi_line(f"{panel.name}_x", f"{panel.name}_y", source=self._curves, color="colour", line_width=1.4)
        plot.on_event(Reset, lambda _: self.message.send({**self._see(self._whole), **self._drawn()}))
        return plot

    def show(self, run: Shown, pins: Sequence[Shown], lash: int, note: str) -> None:
        """Show the motion of one lash in a run, with a note, and in those that are pinned.

        The time axis stays as the user has zoomed it.
        """
        self._runs = [each.history.lashes[lash] for each in (run, *pins)]
        whole = float(min(each.time[0] for each in self._runs)), float(max(each.time[-1] for each in self._runs))
        changes: Changes = self._see(whole) if self._span == self._whole else {}
        self._whole = whole
        first = self._runs[0]
        half = 1e3 * first.half_gap
        trajectory = first.trajectory
        facts = [*filter(None, [note]), *(f"{name} {text}" for name, text in trajectory.outcome() if name != "label")]
        label = f'<span style="font-size: 20px; font-weight: bold">{escape(trajectory.label)}</span>'
        headings, *events = trajectory.event_table()
        ending = (f"{trajectory.end:.7f}", f"end: {trajectory.ending}", *[""] * (len(headings) - 2))
        pinned = zip(pins, self._runs[1:], RUN_COLOURS[1:], strict=False)
        lines = [
            f'<span style="color: {colour}">■</span> {escape(f"{pin.place}: {_outcome(history)}")}'
            for pin, history, colour in pinned
        ]
        changes |= {
            "gap": {"bottom": -half, "top": half},
            "header": {"text": f"{label} &nbsp; {escape(run.place)}<br>{escape(' · '.join(facts))}"},
            "compared": {"text": "<br>".join(lines)},
            "events": {"text": html_table([*events, ending], headings)},
        }
        self.message.send({**changes, **self._marks(), **self._drawn()})

    def refuse(self, text: str) -> None:
        """Show no run, and why."""
        self._runs = []
        texts: Changes = {"header": {"text": f"<b>no run</b>: {escape(text)}"}, "events": {"text": ""}}
        empty: Changes = {"flanks": columns("x y text baseline", [])}
        empty["touches"] = columns("x y angle fill colour size", [])
        self.message.send({**texts, **empty, **self._drawn()})

    def _see(self, span: tuple[float, float]) -> Changes:
        """Let the time axis begin and end at these times."""
        self._span = span
        return {"time": {"start": span[0], "end": span[1]}}

    def _on_zoom(self, _attribute: str, _old: float, _new: float) -> None:
        self._span = float(self._time.start), float(self._time.end)
        self.message.send(self._drawn())

    def _drawn(self) -> Changes:
        """The curves of all runs, and the arrows of the one that is shown, within what the time axis shows."""
        begin, end = self._span
        shown = list(zip(self._runs, RUN_COLOURS, strict=False))[::-1]
        data: dict[str, list[Any]] = {"colour": [colour for _, colour in shown]}
        for panel in _PANELS:
            curves = [thinned(run.time, panel.values(run), begin, end, _COLUMNS) for run, _ in shown]
            data[f"{panel.name}_x"], data[f"{panel.name}_y"] = [x for x, _ in curves], [y for _, y in curves]
        return {"curves": {"data": data}, "arrows": self._arrows()}

    def _arrows(self) -> Mapping[str, Any]:
        """An arrow for each Q_i."""
        run, width = self._runs[0] if self._runs else None, self._span[1] - self._span[0]
        impacts = [] if run is None or run.is_restitution else run.impacts
        arrows = [
            (each.begin + 0.012 * width, each.smallest, each.largest, f"Q{each.number}")
            for each in impacts
            if each.rows.stop > each.rows.start
        ]
        return columns("x low high text", arrows if len(arrows) <= _MOST_ARROWS else [])

    def _marks(self) -> Changes:
        """Flanks and touches of the run that is shown."""
        run = self._runs[0]
        half, side = 1e3 * run.half_gap, run.trajectory.initial_side
        names = {side * half: "initial flank", -side * half: "opposite flank"} if half > 0.0 else {0.0: "no gap"}
        flanks = [(self._whole[0], y, name, "top" if y > 0.0 else "bottom") for y, name in names.items()]
        on_top = np.argsort(run.touches.primary, kind="stable")  # primary ones last
        row, sides, primary = (each[on_top] for each in run.touches[:3])
        touches = {
            "x": run.time[row],
            "y": 1e3 * run.backlash_coordinate[row],
            "angle": np.where(sides > 0, 0.0, np.pi),
            "fill": np.where(primary, RUN_COLOURS[0], "white").tolist(),
            "colour": [RUN_COLOURS[0]] * row.size,
            "size": np.where(primary, 10, 6),
        }
        return {"flanks": columns("x y text baseline", flanks), "touches": {"data": touches}}


def _outcome(history: History) -> str:
    """Label and severity of a run."""
    severity = history.trajectory.severity
    return history.trajectory.label + ("" if math.isnan(severity) else f", Q = {severity:.1f} rad/s²")


def thinned(time: Floats, values: Floats, begin: float, end: float, spans: int) -> tuple[Floats, Floats]:
    """The part of a curve between two times, with no more points than a screen tells apart.

    Each of about as many spans of samples is drawn as its least and its greatest value, so that no peak is lost and
    nothing moves by more than a span.

    Parameters
    ----------
    time, values : (M,) float64
        Time does not decrease.
    begin, end : float
        One point beyond each is kept, so that the line leaves the picture as it should.
    spans : int

    Returns
    -------
    time, values : (m,) float64, m at most 4 spans + 3
    """
    first = max(0, int(np.searchsorted(time, begin)) - 1)
    last = min(time.size, int(np.searchsorted(time, end, side="right")) + 1)
    starts = np.arange(first, last, max(1, (last - first) // spans))
    extremes = [reduce.reduceat(values[:last], starts) for reduce in (np.minimum, np.maximum)]
    return np.append(np.repeat(time[starts], 2), time[last - 1]), np.append(np.ravel(extremes, "F"), values[last - 1])
