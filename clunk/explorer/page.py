"""The page as it opens: the stored map, before anything that runs or draws is imported."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any

from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady, DoubleTap, MouseLeave, MouseMove, PointEvent, Press, Tap
from bokeh.models import ColumnDataSource, CustomJS, Div, Pane, UIElement

from clunk.explorer.mapfigure import MapFigure
from clunk.explorer.message import Message, asset
from clunk.explorer.pictures import Picture, picture_of
from clunk.explorer.subject import Subject
from clunk.results.quantities import LABEL
from clunk.study.errors import ClunkError

if TYPE_CHECKING:
    from clunk.explorer.workbench import Workbench

WIDE: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (2, 6, 2, 6)}
CLICKS = (Tap, DoubleTap, Press)  # quick ones, wherever they are, and slow ones are other events to Bokeh
_LISTED = 16  # labels below the map
_READ_LINK = """
const state = [...new URLSearchParams(location.hash.slice(1))];
link.data = {name: state.map(([name]) => name), value: state.map(([, value]) => value)};
"""
_WRITE_LINK = """
const {name, value} = cb_obj.data;
const state = new URLSearchParams([...name].map((each, k) => [each, value[k]]));
if (name.length) history.replaceState(null, "", `#${state}`);
"""


class Page:
    """One page in one browser: a map, and what its workbench puts around it once the browser has drawn that.

    link : what the address of the page says of its state, after its #
    above, below, right : for the workbench: a row and a column around the map, and the right half
    """

    def __init__(self, document: Document, subject: Subject) -> None:
        self.document, self.subject = document, subject
        self.map = MapFigure(subject.plane) if subject.plane else None
        # both of one height, or the map would be drawn anew with every text
        one_line = {"color": "#5b646c", "flex": "none", "overflow": "hidden", "white-space": "nowrap"}
        self.status = Div(text="…", name="status", render_as_text=True, height=20, styles=one_line, **WIDE)
        fixed = {"line-height": "20px", "flex": "none", "overflow-y": "auto"}
        self.legend = Div(text="", name="legend", height=62, styles=fixed, **WIDE)
        self.above = box("row", min_height="36px", flex="none")
        room = {"height": "190px", "flex": "none"} if self.map else {"flex": "1 1 0"}
        self.below = box("column", overflow_y="auto", **room)
        self.right = box("column", flex="1 1 0", min_width="0")
        self.keys = ColumnDataSource(data={"key": [], "steps": []}, name="keys")
        self.link = ColumnDataSource(data={}, name="link")
        self.download = ColumnDataSource(data={"name": [], "type": [], "content": []}, name="download")
        self._workbench: Workbench | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="clunk page")
        self._has_begun = False
        if self.map and len(subject.plane) == 2:
            first = {axis.parameter: float(axis.values[len(axis.values) // 2]) for axis in subject.slices}
            picture = picture_of(subject.stored(first).of_lash(), LABEL, 2)
            self.legend.text = legend_text(picture)
            for name, properties in self.map.changes(picture, "").items():
                self.map.models[name].update(**properties)
        self._message = Message(legend=self.legend, status=self.status, **(self.map.models if self.map else {}))
        if self.map:
            for event in (*CLICKS, MouseMove, MouseLeave):  # what is listened to later, the browser does not hear of
                self.map.figure.on_event(event, self._on_pointer)
        self._add_roots()
        # the document is the browser's by then: a session takes what threads ask of its document before in any order
        document.js_on_event(DocumentReady, CustomJS(args={"link": self.link}, code=_READ_LINK))
        self.link.on_change("data", lambda _attribute, _old, _new: self._begin())
        self.link.js_on_change("data", CustomJS(code=_WRITE_LINK))
        document.js_on_event(ConnectionLost, CustomJS(code=asset("ended.js")))
        self.download.js_on_change("data", CustomJS(code=asset("download.js")))

    def close(self) -> None:
        """End the threads of the page."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        if self._workbench is not None:
            self._workbench.close()

    def work(self, work: Callable[[], None]) -> None:
        """Do something that takes a while in a thread, one after the other."""

        def attempt() -> None:
            try:
                work()
            except Exception as error:
                self.complain_soon(error)

        self._worker.submit(attempt)

    def soon(self, change: Callable[[], None]) -> None:
        """Change the page in the thread of its events."""
        self.document.add_next_tick_callback(change)

    def complain_soon(self, error: Exception) -> None:
        """Say what went wrong in a thread."""
        if not isinstance(error, ClunkError):
            logging.getLogger(__name__).error("the explorer could not do what was asked", exc_info=error)
        text = str(error) if isinstance(error, ClunkError) else f"internal error: {error!r}"
        self.soon(partial(self.say, text))

    def say(self, text: str) -> None:
        """Write a text below the page."""
        self._message.send({"status": {"text": text}})

    def show_map(self, picture: Picture, quantity: str, status: str, *notes: str) -> None:
        """Show the map of a quantity, with notes in its legend, and say what it is."""
        texts = {"legend": {"text": legend_text(picture, *notes)}, "status": {"text": status}}
        self._message.send({**(self.map.changes(picture, quantity) if self.map else {}), **texts})

    def _add_roots(self) -> None:
        title = Div(text=f"<b>{escape(self.subject.title)}</b>", name="title", styles={"font-size": "16px"}, **WIDE)
        left = box("column", flex="1 1 0", min_width="0")
        drawn = [self.map.figure, self.legend] if self.map else []
        left.elements = [title, self.above, *drawn, self.below, self.status]
        page = box("row", left, self.right, height="100vh")
        for root in (page, self.keys, self.link, self.download, self._message.source):
            self.document.add_root(root)

    def _on_pointer(self, event: PointEvent) -> None:
        if self._workbench is not None:
            self._workbench.point(event)

    def _begin(self) -> None:
        """Build the workbench, once: what it imports takes a second, and the page stays alive meanwhile."""
        if not self._has_begun:
            self._has_begun = True
            self.work(self._build)

    def _build(self) -> None:
        from clunk.explorer.variations import Variations
        from clunk.explorer.workbench import Workbench

        variations = Variations(self.subject)

        def furnish() -> None:
            self._workbench = Workbench(self, variations)

        self.soon(furnish)


def legend_text(picture: Picture, *notes: str) -> str:
    """The labels of a map with their colours and shares, and notes."""
    square = '<span style="background: {}; border: 1px solid #1c2126">&emsp;</span>'
    swatch = f'<span style="white-space: nowrap">{square}&nbsp;{{}}&nbsp;{{}}</span>'
    entries = [swatch.format(colour, escape(label), share) for label, colour, share in picture.legend[:_LISTED]]
    if len(picture.legend) > _LISTED:
        entries.append(f"and {len(picture.legend) - _LISTED} more")
    if len(picture.dots):
        entries.append(f"● undecided: {len(picture.dots):,} cells")
    return " &nbsp; ".join([*entries, *notes])


def box(direction: str, *elements: UIElement, **styles: str) -> Pane:
    """Elements in a row or a column, by CSS; styles : properties, with underscores.

    Bokeh lays each out by itself. In its own rows and columns a change of one text lays the whole page out again, and
    draws each figure, which takes 0.1 s.
    """
    names = {name.replace("_", "-"): value for name, value in styles.items()}
    return Pane(elements=list(elements), styles={"display": "flex", "flex-direction": direction, **names})
