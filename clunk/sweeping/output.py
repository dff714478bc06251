"""The results file that a sweep ends in: complete already, taken up where it was stopped, or not to be touched."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from clunk.results.regimemap import Results
from clunk.results.store import StoreError, read, read_header, write
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.config import Study, digest
from clunk.study.designs import has_tolerances
from clunk.sweeping.engines import Engine, EngineError, Threads
from clunk.sweeping.parts import Parts, PartsError, WorkingDirectory
from clunk.sweeping.progress import Progress
from clunk.sweeping.sweep import SweepError, parts_of, retry_failed, sweep, tolerance_map

_WAYS_OUT = "Name another file, or overwrite it with --force (in Python, force=True)."


@dataclass(frozen=True, eq=False)
class Output:
    """A results file and the sweep that fills it; made by `opened`, and of use as long as that is.

    path : of the results file
    counts : number of cells of each label, if the file is complete already: then nothing needs to be run
    earlier : finished results, of which only the failed cells are run again
    refine : bool, whether cells are inferred
    directory : where finished cells are kept until all are
    """

    path: Path
    study: Study
    counts: dict[str, int] | None
    earlier: Results | None
    refine: bool
    directory: WorkingDirectory

    @cached_property
    def parts(self) -> Parts:
        """The finished cells. Raises PartsError where they are another sweep's."""
        return parts_of(self.directory, self.study, refine=self.refine, retry=self.earlier is not None)

    @property
    def kept(self) -> str:
        """What is on the disk of a sweep that was stopped, for people."""
        if not self.parts.kept:
            return "no cell was finished"
        return f"{self.parts.kept:,} cells are kept in {self.directory.path}; the same command goes on from there"

    def run(self, *, engine: Engine, progress: Progress | None = None) -> Results | ToleranceMap:
        """Run what is missing. As `clunk.sweeping.sweep`, or `tolerance_map` where the study has tolerances."""
        if has_tolerances(self.study):
            return tolerance_map(self.study, engine=engine, progress=progress, parts=self.parts)
        if self.earlier is not None:
            return retry_failed(self.earlier, self.study, engine=engine, progress=progress, parts=self.parts)
        return sweep(self.study, engine=engine, progress=progress, refine=self.refine, parts=self.parts)

    def tidy(self) -> None:
        """Remove what a sweep that was killed after its file was in place has left; another sweep's parts stay."""
        if self.directory.parts():
            with suppress(PartsError):
                _ = self.parts
                self.directory.clear()

    def save(self, results: Results | ToleranceMap) -> None:
        """Put the results into their place, and remove the parts. Raises StoreError."""
        write(self.path, results, self.directory.path)
        self.directory.remove()


@contextmanager
def opened(
    path: str | os.PathLike[str],
    study: Study,
    *,
    refine: bool = False,
    retry: bool = False,
    restart: bool = False,
    force: bool = False,
) -> Iterator[Output]:
    """Lock a results file for a sweep, and see what is there.

    Parameters
    ----------
    path : path of the results file, whose directory exists
    refine : bool, see `clunk.sweeping.sweep`
    retry : bool, run only the failed cells of the finished file again
    restart : bool, neither go on with a stopped sweep nor keep a finished one
    force : bool, overwrite whatever is there

    Raises
    ------
    SweepError
        Where the file holds something else.
    StoreError
        Where `retry` finds no file that can be read.
    PartsError
        Where the file is being written, or another sweep into it has been stopped.
    """
    path = Path(path)
    with WorkingDirectory(path) as directory:
        earlier, counts = None, None
        if retry:
            earlier = read(path)
            counts = None if (earlier.status != 0).any() else earlier.counts()
        elif path.exists() and not force:
            counts = _complete_counts(path, study, restart=restart, refine=refine)
        output = Output(path, study, counts, earlier, refine, directory)
        if counts is not None:
            output.tidy()
        elif restart:
            directory.clear()
        yield output


def _complete_counts(path: Path, study: Study, *, restart: bool, refine: bool) -> dict[str, int] | None:
    """The counts of a file that holds this very sweep; whatever else is there is refused."""
    try:
        header = read_header(path)
    except StoreError as error:
        raise SweepError(f"{error} It is in the way of the results. {_WAYS_OUT}") from error
    if header.config_digest != digest(study):
        raise SweepError(f"{path} holds the results of another config ({header.title!r}). {_WAYS_OUT}")
    if restart:
        return None
    if "refinement" in header.attributes and not refine:
        raise SweepError(f"{path} holds this sweep by --refine, with inferred cells. {_WAYS_OUT}")
    return header.counts


def engine_of(
    scheduler: str | None, workers: int | None = None, say: Callable[[str], None] | None = None
) -> AbstractContextManager[Engine]:
    """What runs cells, to be opened: this process's threads, or the workers of a dask scheduler.

    Parameters
    ----------
    scheduler : str or None
        Its address, ``tcp://host:8786``; or ``local`` for worker processes on this machine; or None for threads.
    workers : int, optional
        Threads or processes here; by default one for each core that this process may use.
    say : callable(text), optional
        Told what is being waited for.

    Raises EngineError where there is no such thing as the address, or no dask.
    """
    if workers is not None and workers < 1:
        raise EngineError(f"A sweep needs at least one worker, not {workers}.")
    if scheduler is None:
        return nullcontext(Threads(workers))
    if scheduler != "local" and not re.fullmatch(r"[a-z]+://\S+", scheduler):
        raise EngineError(f"A scheduler is an address such as tcp://host:8786, or local, not {scheduler!r}.")
    if scheduler != "local" and workers is not None:
        raise EngineError("The number of workers is for threads, or for a local scheduler; this one has its own.")
    try:
        from clunk.sweeping.distributed import Cluster
    except ModuleNotFoundError as error:
        raise EngineError(
            f"A scheduler needs dask, which is not installed (no {error.name}): pip install 'clunk[dask]'"
        ) from error
    return Cluster(scheduler, workers, say)
