"""Progress of a long computation on stderr: a bar in a terminal or a notebook, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clunk.study.study import Study

Progress = Callable[[int, int], None]

_LINE_EVERY = 5.0  # s
_BAR_EVERY = 0.1  # s; each update of a notebook is a message to the browser


@contextmanager
def shown(total: int, unit: str = "cells") -> Iterator[Progress]:
    """Show progress while this is open; the function that it yields takes the numbers done and in all, 0 if unknown."""
    state = _State(total, unit)
    display: AbstractContextManager[Callable[[], None]] = nullcontext(state.print_line)
    if in_notebook():
        display = _notebook_bar(state)
    elif sys.stderr.isatty():
        display = _terminal_bar(state)
    with display as show:

        def update(done: int, total: int) -> None:
            state.advance(done, total)
            show()

        yield update


@contextmanager
def reporting(progress: bool | Progress, cells: int, *studies: Study, what: str = "cells") -> Iterator[Progress | None]:
    """Function to report progress to; a bar is shown when the kernels that the studies need are compiled."""
    from clunk.sweeping.cells import compiling_note, warm_up

    if progress is False or cells == 0:
        yield None
    elif progress is True:
        if note := compiling_note(*studies):
            print(note, file=sys.stderr)
        for study in studies:
            warm_up(study)
        with shown(cells, what) as report:
            yield report
    else:
        yield progress


class _State:
    """Progress as text, and as HTML where a front end shows it.

    rate : a second, since the first report, which may include the cells of an earlier run
    """

    def __init__(self, total: int, unit: str) -> None:
        self.done, self.total, self.unit, self.rate = 0, total, unit, 0.0
        self._first: tuple[int, float] | None = None
        self._shown = time.perf_counter()

    def advance(self, done: int, total: int) -> None:
        now = time.perf_counter()
        count, began = self._first = self._first or (done, now)
        self.done, self.total, self.rate = done, total, (done - count) / max(now - began, 1e-9)

    def is_due(self, pause: float) -> bool:
        """Whether it was last shown so many seconds ago; it is shown now if so."""
        now = time.perf_counter()
        if now - self._shown < pause:
            return False
        self._shown = now
        return True

    def print_line(self) -> None:
        if self.rate > 0.0 and self.done != self.total and self.is_due(_LINE_EVERY):
            print(self, file=sys.stderr)

    def __repr__(self) -> str:
        """For example 1,000 of 40,401 cells, 6,200/s, 6 s left."""
        line = f"{self.done:,} of {self.total:,} {self.unit}" if self.total else f"{self.done:,} {self.unit}"
        if self.rate > 0.0:
            line += f", {self.rate:,.0f}/s"
            if self.done < self.total:
                line += f", {(self.total - self.done) / self.rate:.0f} s left"
        return line

    def _repr_html_(self) -> str:
        share = f' max="{self.total}" value="{self.done}"' if self.total else ""
        bar = f'<progress style="width: 50%"{share}></progress>'
        return f"<div>{bar} {escape(repr(self))}</div>"


def in_notebook() -> bool:
    """Whether this runs in a kernel, whose front end shows what IPython displays."""
    if "IPython" not in sys.modules:  # a kernel has imported it
        return False
    from IPython import get_ipython

    return getattr(get_ipython(), "kernel", None) is not None


@contextmanager
def _terminal_bar(state: _State) -> Iterator[Callable[[], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    text = TextColumn(state.unit + "  {task.fields[rate]}")
    columns = BarColumn(bar_width=None), MofNCompleteColumn(), text, TimeRemainingColumn()
    stream = getattr(sys.stderr, "direct", sys.stderr)  # a command's own stderr shows control sequences as text
    with Progress(*columns, console=Console(file=stream), transient=True) as bar:
        task = bar.add_task("", total=state.total or None, rate="")
        yield lambda: bar.update(task, completed=state.done, total=state.total or None, rate=f"{state.rate:,.0f}/s ")


@contextmanager
def _notebook_bar(state: _State) -> Iterator[Callable[[], None]]:
    """An element of HTML that IPython's display replaces; rich and tqdm need ipywidgets for theirs."""
    from IPython.display import display

    handle = display(state, display_id=True)
    try:
        yield lambda: handle.update(state) if state.is_due(_BAR_EVERY) else None
    finally:
        handle.update(state)  # the last state stays in the notebook, after an interrupt too
