"""The explorer's page: map, runs and widgets, and what pointer, keys and widgets do."""

import logging
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from html import escape
from pathlib import PurePath
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady, DoubleTap, MouseLeave, MouseMove, PointEvent, Press, Tap
from bokeh.models import Button, ColumnDataSource, CustomJS, Div, Model, Pane, Select, UIElement

from clunk.explorer.controls import Controls
from clunk.explorer.figures import RUN_COLOURS, WIDE, Cell, Changes, MapFigure, RunFigures, Shown
from clunk.explorer.newest import GoOn, Newest
from clunk.explorer.subject import Numbers, Subject
from clunk.plot.layers import hardness
from clunk.plot.plane import number_text, value_text
from clunk.plot.style import FAINT_INK
from clunk.results.maps import AnyMap, ToleranceMap
from clunk.results.quantities import LABEL, TEXT, quantities_of
from clunk.study.axes import RUN, parameters_of
from clunk.study.errors import ClunkError
from clunk.sweeping.cells import compiling_note, warm_up

_CLICKS = (Tap, DoubleTap, Press)  # Bokeh reports two quick clicks anywhere as DoubleTap, and a slow one as Press
_PINS = len(RUN_COLOURS) - 1
_ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_HELP = "   ·   click: keep a run · p: pin it · u: unpin · arrows: next cell · f: follow the pointer"
_OFTEN = 0.5  # s, least time between two messages on progress: for each the browser takes 0.1 s to lay the page out

_KEEP_LINK = """
const {name, value} = cb_obj.data;
const state = new URLSearchParams([...name].map((each, k) => [each, value[k]]));
clearTimeout(window.keptLink);
window.keptLink = setTimeout(() => history.replaceState(null, "", `?${state}`), 100);  // it takes 5 ms: after the run
"""
_ENDED = """
if (!document.getElementById("ended")) {
  const banner = document.createElement("div");
  banner.id = "ended";
  banner.style = "position: fixed; inset: 0 0 auto 0; padding: 12px; z-index: 9999; text-align: center; color: white; "
    + "background: #a13d2d; font-size: 16px";
  banner.textContent = "The explorer has ended: this page no longer answers. Start clunk explore again and open the "
    + "address that it prints.";
  document.body.append(banner);
}
"""
_DOWNLOAD = """
const {name: [name], text: [text]} = cb_obj.data;
const link = document.createElement("a");
link.href = URL.createObjectURL(new Blob([text], {type: "application/toml"}));
link.download = name;
link.click();
setTimeout(() => URL.revokeObjectURL(link.href), 10000);
"""
_LISTEN = """
window.addEventListener("keydown", (event) => {
  const target = event.composedPath()[0];
  const known = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "p", "u", "f", "Escape"];
  if (["INPUT", "SELECT", "TEXTAREA"].includes(target.tagName) || target.closest?.(".noUi-target")) return;
  if (!known.includes(event.key) || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  // with its time, or a key that is pressed again would be no change, of which nobody is told
  keys.data = {key: [event.key], steps: [event.shiftKey ? 10 : 1], time: [event.timeStamp]};
});
"""


class Workbench:
    """One page in one browser, and the threads that compute what is shown on it.

    link : state of the page from the query of its address: quantity, lash, values of axes and other numbers, as text
    """

    def __init__(self, document: Document, subject: Subject, link: Mapping[str, str]) -> None:
        self._document, self._subject = document, subject
        self._map = MapFigure(subject.plane) if subject.plane else None
        self._results: AnyMap | None = None
        self._latest: tuple[tuple[Numbers, Numbers], AnyMap] | None = None
        self._follows = True
        self._hovered: Cell | None = None
        self._run: Shown | None = None
        self._pins: list[Shown] = []
        self._requested_map: tuple[Any, ...] | None = None

        results = subject.results
        # over one axis the label, the first quantity, is no choice: the colours under each curve show it
        known = [*quantities_of(results).items()][len(subject.plane) == 1 :]
        described = [(name, "regimes" if each.type == TEXT else results.plot_label(each)) for name, each in known]
        first = described[0][0] if len(subject.plane) > 1 else hardness(results)
        names = results.lash_names
        self._quantity = Select(value=first, options=described, name="quantity", visible=bool(subject.plane), width=260)
        lashes = list(zip(names, names, strict=True))
        self._lash = Select(value=names[0], options=lashes, name="of lash", visible=bool(results.lashes), width=260)
        self._selects = self._quantity, self._lash
        models: dict[str, Model] = self._map.models if self._map else {}
        one_line = {"color": FAINT_INK, "flex": "none", "overflow": "hidden", "white-space": "nowrap"}
        self._status = Div(text="…", name="status", render_as_text=True, height=20, styles=one_line, **WIDE)
        self._figures = RunFigures(subject.study.load.step_time, {"status": self._status, **models})
        self._message = self._figures.message
        self._keys = ColumnDataSource()
        self._link = ColumnDataSource()
        self._download = ColumnDataSource(name="download")

        self._newest_run = Newest("run", self._complain_soon)
        self._newest_map = Newest("map", self._complain_soon)
        swept = parameters_of(subject.swept)
        shown = 4 if self._map else 12
        self._controls = Controls(subject.study, [*subject.plane, *subject.slices], swept, self._on_change, shown)
        # before `_furnish`: Bokeh reports no event whose listener is added after its model is in the document
        self._listen(link)
        self._furnish()

    def close(self) -> None:
        """End the threads."""
        self._newest_run.close()
        self._newest_map.close()

    def _furnish(self) -> None:
        save = Button(label="save the config", name="save", height=30, margin=6)
        save.on_click(lambda *_: self._save())
        title = Div(text=f"<b>{escape(self._subject.title)}</b>", name="title", styles={"font-size": "16px"})
        drawn = [self._map.figure, self._map.legend] if self._map else []
        room = {"height": "190px", "flex": "none"} if self._map else {"flex": "1 1 0"}
        left = [
            title,
            _box("row", *self._selects, save, flex="none"),
            *drawn,
            _box("column", self._controls.layout, overflow_y="auto", **room),
            self._status,
        ]
        runs = self._figures
        right = [runs.header, runs.compared, *runs.figures.values(), runs.events]
        halves = [_box("column", *half, flex="1 1 0", min_width="0") for half in (left, right)]
        roots = _box("row", *halves, height="100vh"), self._keys, self._link, self._download, self._message.source
        for root in roots:
            self._document.add_root(root)

    def _listen(self, link: Mapping[str, str]) -> None:
        for select in self._selects:
            select.on_change("value", lambda _attribute, _old, _new: self._on_quantity())
        self._keys.on_change("data", lambda _attribute, _old, _new: self._on_key())
        self._link.js_on_change("data", CustomJS(code=_KEEP_LINK))
        self._download.js_on_change("data", CustomJS(code=_DOWNLOAD))
        if self._map:
            for event in (*_CLICKS, MouseMove, MouseLeave):
                self._map.figure.on_event(event, self._on_pointer)
        self._document.js_on_event(DocumentReady, CustomJS(args={"keys": self._keys}, code=_LISTEN))
        self._document.js_on_event(ConnectionLost, CustomJS(code=_ENDED))
        # not before the browser has the document: until then, changes that threads request would arrive in any order
        self._document.on_event(DocumentReady, lambda _: self._restore(link))

    # --- The link ----------------------------------------------------------------------------------------------------

    def _restore(self, link: Mapping[str, str]) -> None:
        """Set widgets to the state in a link, and show it; entries that do not fit these results are ignored."""
        for select in self._selects:
            if link.get(select.name) in dict(select.options):
                select.value = link[select.name]
        numbers = {}
        for name, text in link.items():
            with suppress(ValueError):
                numbers[name] = float(text)
        self._controls.set(numbers)
        self._on_change()

    def _keep_link(self) -> None:
        """Write the state of the page into its address, so that the address links to what is shown."""
        chosen = {select.name: select.value for select in self._selects if select.visible}
        numbers = self._controls.cell | self._controls.numbers
        state = chosen | {key: repr(float(value)).removesuffix(".0") for key, value in numbers.items()}
        self._link.data = {"name": list(state), "value": list(state.values())}

    # --- What the user does ------------------------------------------------------------------------------------------

    def _on_pointer(self, event: PointEvent) -> None:
        """Show the run and the label of the cell under the pointer, or select the cell that is clicked."""
        assert self._map is not None
        cell = None if isinstance(event, MouseLeave) else self._map.nearest(event.x, event.y)
        if isinstance(event, _CLICKS):
            if cell is not None:
                self._select(cell)
        else:
            self._hover(cell if self._follows else None)
            self._map.label(self._label_of(cell) if cell else "", event.x, event.y)

    def _label_of(self, cell: Cell) -> str:
        """The label of a cell in the map that is shown; empty before there is one."""
        if self._results is None:
            return ""
        part = self._results.of_lash(self._lash.value)
        return part.coded_labels[part.sequence[part.nearest(self._values(cell))]]

    def _hover(self, cell: Cell | None) -> None:
        if cell != self._hovered:
            self._hovered = cell
            self._request_run()

    def _select(self, cell: Cell) -> None:
        self._controls.set(self._values(cell))
        self._on_change()

    def _on_change(self) -> None:
        self._hovered = None
        self._request_run()
        self._request_map()

    def _on_key(self) -> None:
        (key,), (steps,) = self._keys.data["key"], self._keys.data["steps"]
        if key in _ARROWS:
            cell = []
            for axis, value, direction in zip(self._subject.plane, self._cell, _ARROWS[key], strict=False):
                at = np.searchsorted(values := np.sort(axis.values), value) + direction * int(steps)
                cell.append(float(values[at.clip(0, len(values) - 1)]))
            self._select(tuple(cell))
        elif key == "p":
            if self._run is not None:
                self._pins = [*self._pins, self._run][-_PINS:]
                self._show_runs()
        elif key == "f":
            self._follows = not self._follows
            self._hover(None)
        else:
            self._pins = []
            self._show_runs()

    def _on_quantity(self) -> None:
        self._keep_link()
        self._request_map()
        self._show_runs()

    def _save(self) -> None:
        """Let the browser download the config of the map and the run that are shown."""
        name = f"{PurePath(self._subject.name).stem or 'map'}-config.toml"
        if self._run is not None:
            self._download.data = {"name": [name], "text": [self._subject.config(self._run.values, self._run.numbers)]}
            what = f", clunk sweep {name} the map" if self._map else ""
            at = f" --at run={self._run.values[RUN]:g}" if self._subject.study.swept.samples else ""
            self._say(f"saved {name}: clunk simulate {name}{at} makes this run{what}")
        else:
            self._say("there is no run to save")

    # --- Runs --------------------------------------------------------------------------------------------------------

    @property
    def _cell(self) -> Cell:
        """The cell that is selected: by a click, by keys or by sliders."""
        return tuple(self._controls.cell[axis.parameter] for axis in self._subject.plane)

    def _values(self, cell: Cell) -> Numbers:
        """Value of every axis, by parameter: the cell's of the map's axes, the sliders' of the others."""
        plane = parameters_of(self._subject.plane)
        return self._controls.cell | dict(zip(plane, cell, strict=True))

    def _request_run(self) -> None:
        cell = self._cell if self._hovered is None else self._hovered
        values, numbers = self._values(cell), self._controls.numbers

        def work(go_on: GoOn) -> None:
            try:
                history = self._subject.run(values, numbers)
            except ClunkError as error:
                self._soon(partial(self._take_run, None, str(error)))
                return
            go_on()
            swept = self._subject.values(values)
            place = [value_text(axis, swept[axis.parameter], symbol=True) for axis in self._subject.swept]
            place += [f"{name} = {number_text(value)}" for name, value in numbers.items()]
            self._soon(partial(self._take_run, Shown(cell, values, numbers, history, ", ".join(place))))

        self._newest_run.submit(work)

    def _take_run(self, shown: Shown | None, refusal: str = "") -> None:
        """Show a run that has been computed, or the refusal that says why there is none."""
        self._run = shown
        if shown is None:
            self._figures.refuse(refusal)
        self._show_runs()
        self._keep_link()

    def _show_runs(self) -> None:
        if self._run is not None:
            # the probabilities of a tolerance map hold for the config's own numbers only
            note = "" if self._run.numbers else self._subject.likelihood(self._run.values, self._lash.value)
            lash = self._subject.results.lash_names.index(self._lash.value)
            self._figures.show(self._run, self._pins, lash, note)
        if self._map:  # after the run: otherwise the browser would draw the map first, and show the run later
            pinned = zip((pin.cell for pin in self._pins), RUN_COLOURS[1:], strict=False)
            self._map.mark([*pinned, (self._cell, RUN_COLOURS[0])])

    # --- Maps --------------------------------------------------------------------------------------------------------

    def _request_map(self) -> None:
        subject = self._subject
        numbers, cell = self._controls.numbers, self._controls.cell
        slices = {axis.parameter: cell[axis.parameter] for axis in subject.slices}
        quantity, lash = self._quantity.value, self._lash.value
        if (slices, numbers, quantity, lash) == self._requested_map:
            return
        self._requested_map = slices, numbers, quantity, lash
        nominal = isinstance(subject.results, ToleranceMap)
        if numbers and nominal and quantity.startswith("severity_"):
            quantity = LABEL  # with other numbers the map is nominal, and has no quantiles of the severity
        if not subject.plane:
            self._say("a run with these numbers, which are in no file" if numbers else "the run of this config")
            return

        def show(results: AnyMap, status: str) -> None:
            assert self._map is not None
            changes = self._map.changes(results.of_lash(lash), quantity)
            changes["status"] = {"text": f"{status}{_HELP}"}
            self._soon(partial(self._show_map, results, changes))

        def work(go_on: GoOn) -> None:
            said = time.monotonic()

            def progress(done: int, _total: int) -> None:
                nonlocal said
                go_on()
                if time.monotonic() > said + _OFTEN:
                    said = time.monotonic()
                    self._say_soon(f"computing the map: {done:,} runs")

            if not numbers:
                show(subject.results.at(slices) if slices else subject.results, "the map with the config's own numbers")
                if note := compiling_note(subject.study):
                    self._say_soon(note)
                warm_up(subject.study)  # so that the first map with other numbers does not wait for compilation
                return
            status = f"the {'nominal ' if nominal else ''}map with these numbers, which is in no file"
            if self._latest is not None and self._latest[0] == (slices, numbers):
                show(self._latest[1], status)
                return
            for results in subject.maps(slices, numbers, lash, progress):
                go_on()
                show(results, status)
            self._say_soon(status)  # takes the place of the progress of a tracing that was given up
            self._latest = (slices, numbers), results

        self._newest_map.submit(work)

    def _show_map(self, results: AnyMap, changes: Changes) -> None:
        self._results = results
        self._message.send(changes)

    # --- Messages ----------------------------------------------------------------------------------------------------

    def _soon(self, change: Callable[[], None]) -> None:
        """Schedule a change of the page in the thread of its document, from any thread."""
        self._document.add_next_tick_callback(change)

    def _say(self, text: str) -> None:
        """Write a text into the status line at the bottom of the page, followed by help on keys if there is a map."""
        self._message.send({"status": {"text": f"{text}{_HELP * bool(self._map)}"}})

    def _say_soon(self, text: str) -> None:
        self._soon(partial(self._say, text))

    def _complain_soon(self, error: Exception) -> None:
        """Write an error of a computing thread into the status line, and log it unless it is a ClunkError."""
        if isinstance(error, ClunkError):
            self._say_soon(str(error))
        else:
            logging.getLogger(__name__).error("the explorer could not do what was asked", exc_info=error)
            self._say_soon(f"internal error: {error!r}")


def _box(direction: str, *elements: UIElement, **styles: str) -> Pane:
    """Pane that lays its elements out in a row or a column by CSS; styles : CSS properties, with underscores.

    In Bokeh's own Row and Column, a change of one text lays the whole page out again and draws each figure, which takes
    0.1 s. In such a pane Bokeh lays out each element by itself.
    """
    names = {name.replace("_", "-"): value for name, value in styles.items()}
    return Pane(elements=list(elements), styles={"display": "flex", "flex-direction": direction, **names})
