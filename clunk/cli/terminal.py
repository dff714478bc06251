"""Output to a terminal: text made safe, and messages on stderr: warnings before a run, failures, files written."""

from __future__ import annotations

import os
import re
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from clunk.study.errors import ClunkError
from clunk.study.records import WIDTH, counted, fill, words

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import TextIO

    from matplotlib.figure import Figure

    from clunk.results.maps import AnyMap
    from clunk.study.study import Study


_FEWEST_STEPS = 10  # least number of steps of rk4 in a period of the fastest oscillation
# Characters that a terminal obeys instead of showing: control characters other than tabs and line feeds, and characters
# that change the direction of writing.
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def safe(text: str) -> str:
    """Text with those characters spelled out that a terminal would obey instead of showing: ``\\x1b]0;title``."""
    return _OBEYED.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


class _SafeStream:
    """A text stream that writes every text as `safe` text; `direct` is the stream behind it, for bars and styles.

    It has no `buffer`: bytes written there would not be made safe.
    """

    def __init__(self, stream: TextIO) -> None:
        self.direct = stream

    def write(self, text: str) -> Any:
        return self._passed(self.direct.write, safe(text))

    def flush(self) -> None:
        self._passed(self.direct.flush)

    def _passed(self, call: Any, *arguments: Any) -> Any:
        """Call a method of the stream. Once its reader has gone, as with `| head`, further output is discarded."""
        try:
            return call(*arguments)
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.direct.fileno())

    def __getattr__(self, name: str) -> Any:
        if name == "buffer":
            raise AttributeError(name)
        return getattr(self.direct, name)


@contextmanager
def safe_output() -> Iterator[None]:
    """Make all output safe that is printed within: titles, names and labels may come from files of other people."""
    out, err = (cast("TextIO", _SafeStream(stream)) for stream in (sys.stdout, sys.stderr))
    with redirect_stdout(out), redirect_stderr(err):
        yield


def complain(message: str) -> None:
    """Print a message on stderr, its lines wrapped to the width of a terminal; lines that fit stay as they are."""
    for line in safe(message).splitlines():
        click.echo(line if len(line) <= WIDTH else fill(line), err=True)


def warn(study: Study, method: str | None = None) -> None:
    """Warn of a step of rk4 that is too coarse for the contact, and note each varied key that changes nothing.

    Where a coarse step is stable, this warning is the only sign of its wrong labels. A sweep is judged where the ends
    of its axes give the fewest steps in a period.

    method : by which runs are made, by default the config's
    """
    from clunk.simulation.system import steps_a_period
    from clunk.study.designs import unused_parameters
    from clunk.study.study import replace_values

    is_rk4 = (method or study.solver.method) == "rk4"
    for axis in study.swept.axes * is_rk4:  # set each axis to its end with the fewest steps
        with suppress(ClunkError):  # the ends of some axes may not be allowed together
            ends = (replace_values(study, {axis.parameter: end}) for end in (min(axis.grid), max(axis.grid)))
            study = min(study, *ends, key=steps_a_period)
    if is_rk4 and (steps := steps_a_period(study)) < _FEWEST_STEPS:
        complain(
            f"warning: solver.step = {study.solver.step:g} s gives {steps:.2g} steps a period of the fastest "
            f"oscillation; with fewer than {_FEWEST_STEPS} rebounds are lost and labels wrong; exact has no steps"
        )
    for parameter in unused_parameters(study):
        complain(f"note: {parameter} changes nothing in this model")


def report_failures(results: AnyMap, how: str) -> None:
    """Print on stderr, for each cause, how many cells failed and where the first three are.

    how : text after the word "failed"
    """
    import numpy as np

    from clunk.core.status import Status

    results = results.of_lash()  # all lashes of a cell fail together
    for status in Status:
        cells = np.argwhere(results.status == status)
        if status == Status.OK or cells.size == 0:
            continue
        complain(f"{counted(len(cells), 'cell')} failed{how}: {status.sentence}")
        for cell in cells[:3]:
            click.echo(fill(f"at {words(results.place(cell))}", "  ", "     "), err=True)
        if len(cells) > 3:
            complain(f"  and {len(cells) - 3:,} more")


def say_written(path: Path) -> None:
    """Print on stderr the name of a file that was written."""
    click.echo(f"-> {path}", err=True)


def save_picture(figure: Figure, path: Path) -> None:
    """Save a figure, and print on stderr the name of its file."""
    from clunk import plot

    plot.save(figure, path)
    say_written(path)
