"""The workbench around the map: what is asked for with pointer, keys and widgets, and where it is shown."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from bokeh.events import MouseLeave, PointEvent
from bokeh.models import Button, Select, Toggle

from clunk.analysis.small_gap import thresholds_of
from clunk.explorer.controls import CellBoxes, Controls
from clunk.explorer.mapfigure import RUN_COLOURS, Mark
from clunk.explorer.newest import Newest, Request
from clunk.explorer.page import CLICKS, box
from clunk.explorer.pictures import Picture, picture_of
from clunk.explorer.runpanel import RunPanel
from clunk.explorer.saving import NAMES, Cell, Shown, download
from clunk.explorer.variations import Variations
from clunk.plot.layers import hardness
from clunk.plot.plane import number_text, value_text
from clunk.results.labels import FAILED
from clunk.results.maps import share
from clunk.results.quantities import LABEL, TEXT, quantities_of
from clunk.results.tolerancemap import CERTAIN, AnyMap, ToleranceMap
from clunk.simulation.energy import balance
from clunk.study.errors import ClunkError

if TYPE_CHECKING:
    from clunk.explorer.page import Page

_PINS = len(RUN_COLOURS) - 1
_ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowDown": (0, -1), "ArrowUp": (0, 1)}
_HELP = "   ·   click: keep a run · shift-click or p: pin it · u: unpin · arrows: next cell · f: follow"
_HELP_WITHOUT_MAP = "   ·   p: pin this run · u: unpin"
_FIRST_RUN, _RUN = 10.0, 0.2  # s for which a map waits for a run at most; the first run imports much
_OFTEN = 0.5  # s between two words of progress: for each, the browser lays the page out again, 0.1 s
_LISTED = 12  # values in a note below the map
_COARSE = "computing the map: every few cells are shown"
_OWN = "the map with the config's own numbers"


class Workbench:
    """Widgets around a page's map, what is shown in them, and the threads that compute it."""

    def __init__(self, page: Page, variations: Variations) -> None:
        self._page, self._subject, self._variations = page, page.subject, variations
        self._numbers: dict[str, float] = {}
        self._slices: dict[str, float] = {}
        self._is_ready = False
        self._results: AnyMap | None = None
        self._latest: tuple[tuple[dict[str, float], dict[str, float]], AnyMap, str] | None = None
        self._drawn = ""  # the quantity that the map shows
        self._cell = self._first_cell()
        self._hovered: Cell | None = None
        self._run: Shown | None = None
        self._pins: list[Shown] = []
        self._pins_next = False
        self._requested: tuple[dict[str, float], dict[str, float]] | None = None

        results = self._subject.results
        options = {"width": 260, "margin": (0, 6, 4, 6)}
        # over one axis, labels are the colours under a curve
        described = list(_quantities(results).items())[len(self._subject.plane) == 1 :]
        first = described[0][0] if len(self._subject.plane) > 1 else hardness(results)
        has_map = page.map is not None
        self._quantity = Select(value=first, options=described, name="quantity", visible=has_map, **options)
        self._lash = Select(value=results.lash_names[0], options=list(results.lash_names), name="of lash", **options)
        self._lash.visible = bool(results.lashes)
        small = {"height": 30, "margin": (0, 0, 4, 6)}
        self._follow = Toggle(label="follow the pointer", active=True, name="follow", visible=has_map, **small)
        self._pin = Button(label="pin this run", name="pin", **small)
        self._unpin = Button(label="unpin", name="unpin", **small)
        self._reset = Button(label="reset the numbers", name="reset", visible=False, **small)
        saved = [("", "save …"), *((name, name) for name in NAMES if has_map or not name.startswith("map"))]
        self._save = Select(value="", options=saved, name="save", width=130, **small)
        self._panel = RunPanel()

        self._newest_run = Newest("run", page.complain_soon)
        self._newest_map = Newest("map", page.complain_soon)
        swept = {axis.parameter for axis in self._subject.swept}
        on_change = self._on_slice, self._on_number
        self._controls = Controls(variations.study, self._subject.slices, swept, *on_change, shown=4 if has_map else 12)
        self._boxes = CellBoxes(self._subject.plane, self._on_values)
        self._boxes.show(self._cell)
        self._listen()
        self._furnish()
        self._restore(dict(zip(*page.link.data.values(), strict=True)) if page.link.data else {})
        self._is_ready = True
        self._request_both()

    def close(self) -> None:
        """End the threads."""
        self._newest_run.close()
        self._newest_map.close()

    def _furnish(self) -> None:
        buttons = box("row", *self._boxes.boxes, self._pin, self._unpin, self._save, flex="none")
        self._page.above.elements = [self._quantity, self._lash, self._follow, self._reset]
        self._page.below.elements = [self._controls.layout]
        self._page.right.elements = self._panel.elements(buttons)

    def _listen(self) -> None:
        self._quantity.on_change("value", lambda _attribute, _old, _new: self._request_map())
        self._lash.on_change("value", lambda _attribute, _old, _new: self._on_lash())
        self._follow.on_change("active", lambda _attribute, _old, _new: self._hover(None))
        self._pin.on_click(lambda *_: self._pin_run())
        self._unpin.on_click(lambda *_: self._unpin_runs())
        self._reset.on_click(lambda *_: self._controls.reset())
        self._save.on_change("value", lambda _attribute, _old, name: self._save_as(name))
        self._page.keys.on_change("data", lambda _attribute, _old, _new: self._on_key())

    # --- The link ----------------------------------------------------------------------------------------------------

    def _restore(self, texts: Mapping[str, str]) -> None:
        """Show what a link says; what it says of other results is left out."""
        for select in (self._quantity, self._lash):
            known = [each if isinstance(each, str) else each[0] for each in select.options]
            if texts.get(select.name) in known:
                select.value = texts[select.name]
        values = {name: value for name, text in texts.items() if math.isfinite(value := _number(text))}
        self._controls.set(values)
        if self._page.map and all(axis.parameter in values for axis in self._subject.plane):
            self._on_values([values[axis.parameter] for axis in self._subject.plane])

    def _keep_link(self) -> None:
        """Let the address of the page hold what it shows."""
        chosen = {select.name: select.value for select in (self._quantity, self._lash) if select.visible}
        numbers = self._values(self._cell) | self._active_numbers()
        state = chosen | {key: f"{value:.12g}" for key, value in numbers.items()}
        if self._is_ready:
            self._page.link.data = {"name": list(state), "value": list(state.values())}

    # --- What the user does ------------------------------------------------------------------------------------------

    def point(self, event: PointEvent) -> None:
        """Follow the pointer over the map, or keep the cell that is clicked."""
        assert self._page.map is not None
        cell = None if isinstance(event, MouseLeave) else self._page.map.nearest(event.x, event.y)
        if isinstance(event, CLICKS):
            if cell is not None:
                self._pins_next = bool((event.modifiers or {}).get("shift"))
                self._select(cell)
        elif self._follow.active or cell is None:
            self._hover(cell)
        self._page.map.label(self._label_of(cell) if cell else "", event.x, event.y)

    def _label_of(self, cell: Cell) -> str:
        """The label of a cell in the map that is shown."""
        if self._results is None:
            return ""
        part, values = self._results.of_lash(self._lash.value), self._values(cell)
        at = tuple(axis.nearest(values.get(axis.parameter, axis.values[0])) for axis in part.axes)
        return str((*part.labels, FAILED)[part.sequence[at]])

    def _hover(self, cell: Cell | None) -> None:
        if cell != self._hovered:
            self._hovered = cell
            self._request_run()

    def _select(self, cell: Cell) -> None:
        self._cell, self._hovered = cell, None
        self._boxes.show(cell)
        self._mark()
        self._keep_link()
        self._request_run()
        self._pin_where_wanted()

    def _on_values(self, values: list[float]) -> None:
        assert self._page.map is not None
        low, high = ([limit(axis.values) for axis in self._subject.plane] for limit in (min, max))
        cell = self._page.map.nearest(*(sorted(each)[1] for each in zip(low, values, high, strict=True)))
        if cell is not None:
            self._select(cell)

    def _on_key(self) -> None:
        (key,), (steps,) = self._page.keys.data["key"], self._page.keys.data["steps"]
        if key in _ARROWS:
            cell = []
            for axis, value, direction in zip(self._subject.plane, self._cell, _ARROWS[key], strict=False):
                ascending = sorted(axis.values.tolist())
                at = min(max(ascending.index(value) + direction * int(steps), 0), len(ascending) - 1)
                cell.append(ascending[at])
            self._select(tuple(cell))
        elif key == "p":
            self._pin_run()
        elif key in ("u", "Escape"):
            self._unpin_runs()
        elif key == "f":
            self._follow.active = not self._follow.active

    def _on_lash(self) -> None:
        self._request_map()
        self._show_runs()

    def _on_slice(self, parameter: str, value: float) -> None:
        if self._slices.get(parameter) != value:
            self._slices[parameter] = value
            self._request_both()

    def _on_number(self, parameter: str, value: float) -> None:
        if self._numbers.get(parameter) != value:
            self._numbers[parameter] = value
            self._request_both()

    def _request_both(self) -> None:
        if self._is_ready:
            self._request_run()
            self._request_map()

    def _pin_run(self) -> None:
        if self._run is not None:
            self._pins = [*self._pins, self._run][-_PINS:]
            self._mark()
            self._show_runs()

    def _unpin_runs(self) -> None:
        self._pins = []
        self._mark()
        self._show_runs()

    # --- Runs --------------------------------------------------------------------------------------------------------

    def _first_cell(self) -> Cell:
        """The cell in which the config's own values lie, or else the middle one."""
        at = []
        for axis in self._subject.plane:
            value = self._variations.number(axis.parameter)
            low, high = axis.values.min(), axis.values.max()
            at.append(float(axis.values[axis.nearest(value) if low <= value <= high else len(axis.values) // 2]))
        return tuple(at)

    def _values(self, cell: Cell) -> dict[str, float]:
        axes = self._subject.plane
        return {**self._slices, **{axis.parameter: value for axis, value in zip(axes, cell, strict=True)}}

    def _request_run(self) -> None:
        if not self._is_ready:
            return
        cell = self._cell if self._hovered is None else self._hovered
        values, numbers = self._values(cell), dict(self._active_numbers())
        if (values, numbers) == self._requested:
            return
        self._requested = values, numbers

        def work(request: Request) -> None:
            try:
                history = self._variations.run(values, numbers)
            except ClunkError as error:
                self._page.soon(partial(self._refuse_run, str(error)))
                return
            request.go_on()
            shown = Shown(cell, values, numbers, history, balance(history.trajectory), self._place(values, numbers))
            request.go_on()
            self._page.soon(partial(self._show_run, shown))

        self._newest_run.submit(work)

    def _refuse_run(self, text: str) -> None:
        self._run = None
        self._panel.refuse(text)

    def _show_run(self, shown: Shown) -> None:
        self._run = shown
        self._show_runs()
        self._pin_where_wanted()

    def _pin_where_wanted(self) -> None:
        """Pin the run of a shift-click once it is there."""
        if self._pins_next and self._run is not None and self._run.cell == self._cell:
            self._pins_next = False
            self._pin_run()

    def _show_runs(self) -> None:
        if self._run is not None:
            # other numbers are those of no map
            note = "" if self._run.numbers else self._subject.likelihood(self._run.values, self._lash.value)
            self._panel.show(self._run, self._pins, self._lash_position, note)

    def _place(self, values: Mapping[str, float], numbers: Mapping[str, float]) -> str:
        """Values of all axes, and numbers, in words."""
        results = self._subject.results
        axes = {axis.parameter: axis for axis in (*results.axes, *results.coordinates)}
        swept, changing = self._subject.values(values), {axis.parameter for axis in self._subject.swept}
        texts = [value_text(axes[name], value, symbol=True) for name, value in swept.items() if name in changing]
        texts += [f"{name} = {number_text(value)}" for name, value in numbers.items()]
        return ", ".join(texts)

    # --- Maps --------------------------------------------------------------------------------------------------------

    @property
    def _lash_position(self) -> int:
        return self._subject.results.lash_names.index(self._lash.value)

    def _active_numbers(self) -> dict[str, float]:
        """The numbers that differ from the config's."""
        return {key: value for key, value in self._numbers.items() if value != self._variations.number(key)}

    def _request_map(self) -> None:
        if not self._is_ready:
            return
        subject, variations = self._subject, self._variations
        slices, numbers = dict(self._slices), self._active_numbers()
        quantity, lash = self._quantity.value, self._lash.value
        if numbers and isinstance(subject.results, ToleranceMap) and quantity.startswith("severity_"):
            quantity = LABEL  # of the nominal map: other numbers leave tolerances aside
        self._reset.visible = bool(numbers)
        if not subject.plane:
            self._keep_link()
            self._say("a run with these numbers, which are in no file" if numbers else "the run of this config")
            return

        nominal = "nominal " if isinstance(subject.results, ToleranceMap) else ""

        def show(request: Request, results: AnyMap, status: str) -> None:
            picture = picture_of(results.of_lash(lash), quantity, len(subject.plane))
            thresholds = thresholds_of(results) if quantity == LABEL and status != _COARSE else []
            self._page.soon(lambda: self._show_map(request, results, quantity, picture, thresholds, status))

        def work(request: Request) -> None:
            said = time.monotonic()

            def progress(done: int, total: int) -> None:
                nonlocal said
                request.go_on()
                if time.monotonic() > said + _OFTEN:
                    said = time.monotonic()
                    self._page.soon(partial(self._say, f"computing the map: {done:,} of {total:,} cells"))

            self._newest_run.wait(_FIRST_RUN if self._results is None else _RUN)  # it is wanted at once
            if self._latest is not None and self._latest[0] == (slices, numbers):
                full, status = self._latest[1:]
            elif numbers:
                coarse = variations.coarse_map(slices, numbers, progress)
                request.go_on()
                if coarse is not None:
                    show(request, coarse, _COARSE)
                full = variations.full_map(slices, numbers, progress)
                status = f"the {nominal}map with these numbers, which is in no file"
            else:
                full, status = subject.stored(slices), _OWN
            request.go_on()
            show(request, full, status)
            if not numbers:
                variations.prepare(lambda text: self._page.soon(partial(self._say, text)))
            traced = variations.traced_map(slices, numbers, full, lash, request.go_on)
            request.go_on()
            self._latest = (slices, numbers), traced, status
            if traced is not full:
                show(request, traced, status)

        self._newest_map.submit(work)

    def _show_map(
        self,
        request: Request,
        results: AnyMap,
        quantity: str,
        picture: Picture,
        thresholds: list[float],
        status: str,
    ) -> None:
        if request.is_superseded:
            return
        self._results, self._drawn = results, quantity
        self._keep_link()
        changes = picture.edges[1:-1].tolist()
        notes = [*_listed("thresholds for vanishing backlash", thresholds), *_listed("label changes", changes)]
        if picture.peak is not None:
            value, *at = picture.peak
            place = [value_text(axis, each, symbol=True) for axis, each in zip(self._subject.plane, at, strict=True)]
            notes.append(f"largest: {value:.6g} at {', '.join(place)}")
        if isinstance(results, ToleranceMap) and quantity == LABEL and picture.pixels.size:
            notes.append(f"paler: less than {CERTAIN:.0%} likely, {share(results.uncertain, results.sequence.size)}")
        self._page.show_map(picture, _quantities(results)[quantity], f"{status}{_HELP}", *notes)
        self._mark()

    def _mark(self) -> None:
        if self._page.map is None:
            return
        cells = [(pin.cell, colour) for pin, colour in zip(self._pins, RUN_COLOURS[1:], strict=False)]
        marks: list[Mark] = []
        for cell, colour in [*cells, (self._cell, RUN_COLOURS[0])]:
            marks.append((cell[0], cell[1] if len(cell) > 1 else 0.0, colour))
        self._page.map.mark(marks)

    def _save_as(self, name: str) -> None:
        """Make a file in a thread, and hand it to the browser as a download."""
        self._save.value = ""
        if name not in NAMES or self._run is None or (self._results is None and self._page.map):
            return
        runs, quantity = [self._run, *self._pins], self._drawn
        part = (self._results or self._subject.results).at_lash(self._lash.value)

        def work() -> None:
            data = download(name, runs, self._variations, part, quantity)
            self._page.soon(partial(self._hand_over, data))

        self._page.work(work)

    def _hand_over(self, data: dict[str, list[str]]) -> None:
        (name,), self._page.download.data = data["name"], data
        again = f": clunk simulate {name} makes this run" if name.endswith(".toml") else ""
        again += f", clunk sweep {name} the map" if again and self._page.map else ""
        self._say(f"saved {name}{again}")

    def _say(self, text: str) -> None:
        self._page.say(f"{text}{_HELP if self._page.map else _HELP_WITHOUT_MAP}")


def _listed(what: str, values: list[float]) -> list[str]:
    """A note on values of an axis, if there are any and they are few."""
    return [f"{what}: {', '.join(f'{each:.4g}' for each in values)}"] if 0 < len(values) <= _LISTED else []


def _number(text: str) -> float:
    """A number of a link; NaN of what is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _quantities(results: AnyMap) -> dict[str, str]:
    """Quantities of results that can be drawn, with their names for people."""
    known = quantities_of(results).items()
    return {name: "regimes" if each.type == TEXT else results.plot_label(each) for name, each in known}
