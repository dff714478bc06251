"""The right half of the page: the run that is shown and those that are pinned, in figures, texts and a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from bokeh.models import Div, UIElement

from clunk.explorer.mapfigure import RUN_COLOURS
from clunk.explorer.page import WIDE
from clunk.explorer.runfigures import RunFigures
from clunk.explorer.saving import Shown
from clunk.plot.plane import number_text
from clunk.simulation.energy import EnergyBalance
from clunk.study.summaries import html_table


class RunPanel:
    """Header, figures and event table of a run, and a line for each run that is pinned."""

    def __init__(self) -> None:
        fixed = {"overflow": "hidden", "flex": "none"}
        self._header = Div(text="", name="header", height=62, styles=fixed, **WIDE)
        self._compared = Div(text="", name="compared", styles={"flex": "none"}, **WIDE)
        self._table = Div(text="", name="events", styles={"overflow-y": "auto", "font-size": "12px"}, **WIDE)
        self._table.update(sizing_mode="stretch_both", min_height=80, max_height=170)
        self._figures = RunFigures(header=self._header, compared=self._compared, events=self._table)

    def elements(self, buttons: UIElement) -> list[UIElement]:
        """Header, these buttons, pinned runs, figures and table, from above."""
        return [self._header, buttons, self._compared, *self._figures.figures.values(), self._table]

    def show(self, run: Shown, pins: Sequence[Shown], lash: int, note: str) -> None:
        """Show the motion of one lash in a run, with a note, and in those that are pinned."""
        histories = [each.history.lashes[lash] for each in (run, *pins)]
        trajectory = histories[0].trajectory
        facts = [f"{name} {text}" for name, text in trajectory.outcome() if name != "label"]
        label = f'<span style="font-size: 20px; font-weight: bold">{escape(trajectory.label)}</span>'
        facts = [*filter(None, [note]), *facts, energy_text(run.energy)]
        header = f"{label} &nbsp; {escape(run.place)}<br>{escape(' · '.join(facts))}"
        columns, *events = trajectory.event_table()
        ending = (f"{trajectory.end:.7f}", f"end: {trajectory.ending}", *[""] * (len(columns) - 2))
        compared = [
            f'<span style="color: {colour}">■</span> {escape(_described(pin, lash))}'
            for pin, colour in zip(pins, RUN_COLOURS[1:], strict=False)
        ]
        table = html_table([*events, ending], columns)
        self._figures.show(histories, header=header, compared="<br>".join(compared), events=table)

    def refuse(self, text: str) -> None:
        """Show no run, and why."""
        self._figures.show([], header=f"<b>no run</b>: {escape(text)}", events="")


def _described(shown: Shown, lash: int) -> str:
    """The place of a run, its label and severity."""
    trajectory = shown.history.lashes[lash].trajectory
    severity = "" if math.isnan(trajectory.severity) else f", Q = {trajectory.severity:.1f} rad/s²"
    return f"{shown.place}: {trajectory.label}{severity}"


def energy_text(energy: EnergyBalance) -> str:
    """Terms of an energy balance that are not zero, and its residual."""
    terms = {
        "work of the load": energy.work,
        "damped": energy.damped,
        "rubbed": energy.rubbed,
        "lost at impacts": energy.lost_at_impacts,
    }
    texts = [f"{name} {number_text(float(f'{value:.4g}'))} J" for name, value in terms.items() if value]
    return f"energy: {', '.join(texts)}; residual {energy.relative_residual:.0e}" if texts else "energy: none"
