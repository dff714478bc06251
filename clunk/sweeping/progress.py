"""How far a long computation is: a bar in a terminal or a notebook, else a line now and then; on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape

Progress = Callable[[int, int], None]

_LINE_EVERY = 5.0  # s
_BAR_EVERY = 0.1  # s; each update of a notebook is a message to the browser


@contextmanager
def shown(total: int, what: str = "cells") -> Iterator[Progress]:
    """Show what the function given here, called with what is done and what there is, is told."""
    if _in_notebook():
        with _notebook_bar(total, what) as update:
            yield update
    elif sys.stderr.isatty():
        with _terminal_bar(total, what) as update:
            yield update
    else:
        yield _lines(what)


def _in_notebook() -> bool:
    """Whether this runs in a kernel, whose front end shows what IPython displays."""
    if "IPython" not in sys.modules:  # a kernel has imported it
        return False
    from IPython import get_ipython

    return getattr(get_ipython(), "kernel", None) is not None


@contextmanager
def _terminal_bar(total: int, what: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn(what + "  {task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total, rate="")
        speed = _Speed()

        def update(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total, rate=f"{speed(done):,.0f}/s ")

        yield update


@contextmanager
def _notebook_bar(total: int, what: str) -> Iterator[Progress]:
    """An element of HTML that IPython's own display replaces; rich and tqdm need ipywidgets for theirs."""
    from IPython.display import display

    bar = _NotebookBar(total, what)
    handle = display(bar, display_id=True)
    last = time.perf_counter()

    def update(done: int, total: int) -> None:
        nonlocal last
        bar.advance(done, total)
        now = time.perf_counter()
        if now - last >= _BAR_EVERY:
            last = now
            handle.update(bar)

    try:
        yield update
    finally:
        handle.update(bar)  # what was reached stays in the notebook, after an interrupt too


class _NotebookBar:
    """A bar as HTML, and as text where a front end shows no HTML."""

    def __init__(self, total: int, what: str) -> None:
        self._done, self._total, self._what = 0, total, what
        self._speed, self._rate = _Speed(), 0.0

    def advance(self, done: int, total: int) -> None:
        self._done, self._total, self._rate = done, total, self._speed(done)

    def __repr__(self) -> str:
        return _line(self._done, self._total, self._what, self._rate)

    def _repr_html_(self) -> str:
        bar = f'<progress style="width: 50%" max="{self._total}" value="{self._done}"></progress>'
        return f"<div>{bar} {escape(repr(self))}</div>"


def _lines(what: str) -> Progress:
    last = time.perf_counter()
    speed = _Speed()

    def update(done: int, total: int) -> None:
        nonlocal last
        now = time.perf_counter()
        rate = speed(done)
        if now - last < _LINE_EVERY or done == total or rate == 0.0:
            return
        last = now
        print(_line(done, total, what, rate), file=sys.stderr)

    return update


def _line(done: int, total: int, what: str, rate: float) -> str:
    """For example 1,000 of 40,401 cells, 6,200/s, 6 s left."""
    line = f"{done:,} of {total:,} {what}"
    if rate > 0.0:
        line += f", {rate:,.0f}/s"
        if done < total:
            line += f", {(total - done) / rate:.0f} s left"
    return line


class _Speed:
    """Cells a second since the first report; what was done by then may be of an earlier run."""

    def __init__(self) -> None:
        self._first: tuple[int, float] | None = None

    def __call__(self, done: int) -> float:
        now = time.perf_counter()
        if self._first is None:
            self._first = done, now
        count, began = self._first
        return (done - count) / max(now - began, 1e-9)
