"""Progress of a long computation on stderr: one line that is rewritten, or a line every few seconds in a log."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from clunk.study.study import Study
from clunk.sweeping.cells import compiling_note, warm_up

Progress = Callable[[int, int], None]
ShowProgress = bool | Progress  # whether a bar is shown, or a function to call in its place

_LINE_EVERY = 5.0  # s
_REWRITTEN_EVERY = 0.1  # s
_BAR = 20  # characters
_WIDTH = 79


@contextmanager
def shown(unit: str = "cells") -> Iterator[Progress]:
    """Show progress while this context is open; a terminal and a notebook show a bar in a line that is rewritten.

    Yields a function of the number of units done, and of their number in all, 0 if that is unknown.
    """
    is_rewritten = in_notebook() or sys.stderr.isatty()
    # commands replace stderr by a stream that shows control characters as text; `direct` is the stream behind it
    stream = getattr(sys.stderr, "direct", sys.stderr) if is_rewritten else sys.stderr
    first = None
    last = time.perf_counter()
    line = ""

    def update(done: int, total: int) -> None:
        nonlocal first, last, line
        now = time.perf_counter()
        began_with, began = first = first or (done, now)  # `done` may include cells of an earlier run
        rate = (done - began_with) / max(now - began, 1e-9)
        line = f"{done:,} of {total:,} {unit}" if total else f"{done:,} {unit}"
        if rate > 0.0:
            line += f", {rate:,.0f}/s"
            if done < total:
                line += f", {(total - done) / rate:.0f} s left"
        if is_rewritten and total:
            line = f"{'█' * (_BAR * done // total):░<{_BAR}} {line}"
        is_news = done != total and (is_rewritten or rate > 0.0)
        if is_news and now - last >= (_REWRITTEN_EVERY if is_rewritten else _LINE_EVERY):
            last = now
            stream.write(f"\r{line:<{_WIDTH}}" if is_rewritten else f"{line}\n")
            stream.flush()

    try:
        yield update
    finally:
        if is_rewritten:  # a notebook keeps the last state, after an interrupt too; a terminal has no need of it
            stream.write(f"\r{line:<{_WIDTH}}\n" if in_notebook() else f"\r{'':<{_WIDTH}}\r")
            stream.flush()


def note(text: str, progress: ShowProgress) -> None:
    """Print a text to stderr if it is not empty and `progress` is True."""
    if text and progress is True:
        print(text, file=sys.stderr)


def unseen(_done: int, _total: int) -> None:
    """Report no progress, where none is asked for."""


@contextmanager
def reporting(progress: ShowProgress, study: Study, what: str = "cells") -> Iterator[Progress]:
    """Yield a function to report progress to; a bar is shown once the kernels that the study needs are compiled."""
    if progress is False:
        yield unseen
    elif progress is True:
        note(compiling_note(study), progress)
        warm_up(study)
        with shown(what) as report:
            yield report
    else:
        yield progress


def in_notebook() -> bool:
    """Whether this process is an IPython kernel, whose notebook displays the output."""
    if "IPython" not in sys.modules:  # a kernel would have imported it
        return False
    from IPython import get_ipython

    return getattr(get_ipython(), "kernel", None) is not None
