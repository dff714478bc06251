"""Sweeps: the cells of a study's design, run by an engine and reduced to a map, in memory or into a results file."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from functools import cached_property
from pathlib import Path

from clunk.results.regimemap import Results
from clunk.results.store import StoreError, read, read_header, read_map, write
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.designs import Design, design_of, has_tolerances
from clunk.study.study import Study, digest
from clunk.sweeping.assembly import MendedReduction, RefinedReduction, RegimeReduction
from clunk.sweeping.cells import complaint, warm_up
from clunk.sweeping.engines import EngineError, Work, available_cores, run_tiles
from clunk.sweeping.parts import Parts, PartsError, WorkingDirectory
from clunk.sweeping.progress import Progress
from clunk.sweeping.provenance import provenance
from clunk.sweeping.reduction import AnyMap, Reduction, SweepError
from clunk.sweeping.scratch import refuse_if_too_large, scratch_for
from clunk.sweeping.tolerances import ToleranceReduction

__all__ = ["Job", "SweepError", "cell_count", "engine_of", "opened", "sweep", "tolerance_map", "warm_up"]

HAS_TOLERANCES = "The study has [[sweep.tolerances]]: clunk.tolerance_map runs it."
NO_TOLERANCES = "The study has no [[sweep.tolerances]]: clunk.sweep runs it."
_WAYS_OUT = "Name another file, or overwrite it with --force (in Python, force=True)."


class Job:
    """One sweep, from what there is of it to its map; `opened` makes one of a results file.

    Parameters
    ----------
    study : Study
        With at least one axis or sample; with tolerances, the map is a ToleranceMap, else Results.
    design : Design, optional
        Cells to run instead of those of the study's own sweep.
    refine : bool
        Run only a coarse grid and what `clunk.sweeping.refinement` asks for, and infer the other cells.
    earlier : Results, optional
        Finished results of which only the failed cells are run again, with another [solver].
    directory : WorkingDirectory, optional
        Open; finished cells are kept there as the sweep goes on, and taken up from there.
    path : Path, optional
        Results file to write.
    counts : dict, optional
        Number of cells of each label, if the file is complete already: then there is nothing to run.

    Attributes
    ----------
    ran : int
        Number of cells that `run` has run.
    seconds : float
        How long it took to run them.
    """

    def __init__(
        self,
        study: Study,
        design: Design | None = None,
        *,
        refine: bool = False,
        earlier: Results | None = None,
        directory: WorkingDirectory | None = None,
        path: Path | None = None,
        counts: dict[str, int] | None = None,
    ) -> None:
        self.study, self.design = study, design or design_of(study)
        self.refine, self.earlier, self.directory, self.path, self.counts = refine, earlier, directory, path, counts
        self.ran, self.seconds = 0, 0.0

    @cached_property
    def reduction(self) -> Reduction[AnyMap]:
        """Empty arrays of the map. Raises SweepError where nothing can run, or the arrays don't fit in memory."""
        study, design = self.study, self.design
        if not design.shape:
            raise SweepError("There is nothing to sweep: the config has no [[sweep.axes]] and no [[sweep.samples]].")
        on_disk = None if self.directory is None else self.directory.path
        refuse_if_too_large(design.shape, on_disk)
        if has_tolerances(study):
            return ToleranceReduction(study)
        scratch = scratch_for(design.cells, on_disk)
        if self.earlier is not None:
            return MendedReduction(study, self.earlier, scratch)
        return (RefinedReduction if self.refine else RegimeReduction)(study, design, scratch)

    @cached_property
    def parts(self) -> Parts | None:
        """Finished cells on the disk, if they are kept. Raises PartsError where they are another sweep's."""
        return None if self.directory is None else Parts(self.directory, self.study, self.reduction)

    @property
    def kept(self) -> str:
        """What is on the disk of a sweep that was stopped, for people."""
        if self.parts is None or not self.parts.kept:
            return "no cell was finished"
        return f"{self.parts.kept:,} cells are kept in {self.parts.directory.path}; the same command goes on from there"

    def run(
        self, engine: Executor | None = None, *, workers: int | None = None, progress: Progress | None = None
    ) -> AnyMap:
        """Run the cells that are not there yet, and put the map in its file, if it has one.

        Parameters
        ----------
        engine : Executor, optional
            What runs tiles of cells, see `clunk.sweeping.engines`; by default threads.
        workers : int, optional
            Number of these threads; by default one for each core that this process may use.
        progress : callable(done, total), optional
            Called in this thread with the number of cells, first of those taken up and then after each tile.

        Raises
        ------
        SweepError
            Where there is nothing to sweep, the grid does not fit in memory, or no cell of it could run.
        PartsError, StoreError
            Where finished cells or the results cannot be kept.
        ScratchError
            Where the disk has no room for the results.
        EngineError
            Where the engine cannot go on; the finished cells have been kept.
        KeyboardInterrupt
            Passed on after the running cells have been abandoned, and the finished ones kept.
        """
        if workers is not None and workers < 1:
            raise SweepError(f"A sweep needs at least one worker, not {workers}.")
        began = time.perf_counter()
        reduction, parts = self.reduction, self.parts
        if (why := complaint(reduction.runner.shared())) is not None:
            raise SweepError(f"No cell can run: {why}.")
        before = reduction.done
        for tile in parts.read() if parts is not None else ():
            reduction.add(tile)
        if progress is not None and parts is not None and parts.taken_up:
            progress(reduction.done, max(reduction.done, self.design.cells))
        try:
            with nullcontext(engine) if engine is not None else _threads(workers) as executor:
                self._run_tiles(executor, reduction, parts, progress)
        except (KeyboardInterrupt, SystemExit, EngineError) as stopped:  # SIGINT, SIGTERM, workers gone
            if parts is not None:
                parts.flush()
            if self.path is not None:
                stopped.add_note(self.kept)
            raise
        if parts is not None and parts.on_disk:  # a sweep shorter than the first part is not worth a file
            parts.flush()
        result = reduction.result(provenance(engine))
        self.ran, self.seconds = reduction.done - before, time.perf_counter() - began
        if self.path is not None:
            self._save(result, self.path)
        return result

    def _run_tiles(
        self, engine: Executor, reduction: Reduction[AnyMap], parts: Parts | None, progress: Progress | None
    ) -> None:
        before = reduction.done
        work = Work(reduction.runner, reduction.first(), may_grow=reduction.may_grow)
        with closing(run_tiles(engine, reduction.runner, work)) as tiles:  # an interrupt abandons the running cells
            for tile in tiles:
                reduction.add(tile)
                if parts is not None:
                    parts.add(tile)
                work.add(reduction.next(tile.cells))
                if progress is not None:
                    progress(reduction.done, before + work.known)

    def _save(self, result: AnyMap, path: Path) -> None:
        """Put the map into its place, and remove the parts."""
        directory = None if self.directory is None else self.directory.path
        write(path, result, directory)
        if self.directory is not None:
            self.directory.remove()

    def read(self) -> AnyMap:
        """The map of a file that is complete already. Raises StoreError."""
        assert self.path is not None
        return read_map(self.path)

    def tidy(self) -> None:
        """Remove what a sweep that was killed after its file was in place has left; another sweep's parts stay."""
        if self.directory is not None and self.directory.parts():
            with suppress(PartsError):
                _ = self.parts
                self.directory.clear()


@contextmanager
def opened(
    path: str | os.PathLike[str] | None,
    study: Study,
    *,
    refine: bool = False,
    retry: bool = False,
    restart: bool = False,
    force: bool = False,
) -> Iterator[Job]:
    """Lock a results file for a sweep, and see what is there.

    Parameters
    ----------
    path : path of the results file, whose directory exists; None for a sweep in memory
    refine : bool, run only where labels change, and infer the other cells
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
    if path is None:
        yield Job(study, refine=refine)
        return
    path = Path(path)
    with WorkingDirectory(path) as directory:
        earlier, counts = None, None
        if retry:
            earlier = read(path)
            counts = None if (earlier.status != 0).any() else earlier.counts()
        elif path.exists() and not force:
            counts = _complete_counts(path, study, restart=restart, refine=refine)
        job = Job(study, refine=refine, earlier=earlier, directory=directory, path=path, counts=counts)
        if counts is not None:
            job.tidy()
        elif restart:
            directory.clear()
        yield job


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
) -> AbstractContextManager[Executor]:
    """Engine to be opened: this process's threads, or the workers of a dask scheduler.

    Parameters
    ----------
    scheduler : str or None
        Its address, ``tcp://host:8786``; or ``local`` for worker processes on this machine; or None for threads.
    workers : int, optional
        Threads or processes here; by default one for each core that this process may use.
    say : callable(text), optional
        Called with what is being waited for.

    Raises EngineError where there is no such thing as the address, or no dask.
    """
    if workers is not None and workers < 1:
        raise EngineError(f"A sweep needs at least one worker, not {workers}.")
    if scheduler is None:
        return _threads(workers)
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


def _threads(workers: int | None) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers or available_cores(), thread_name_prefix="clunk")


def sweep(
    study: Study,
    design: Design | None = None,
    *,
    workers: int | None = None,
    engine: Executor | None = None,
    progress: Progress | None = None,
    refine: bool = False,
) -> Results:
    """Run the cells of a study in memory.

    Parameters and errors are those of `Job` and `Job.run`; SweepError, too, where the study has tolerances.
    """
    if has_tolerances(study):
        raise SweepError(HAS_TOLERANCES)
    results = Job(study, design, refine=refine).run(engine, workers=workers, progress=progress)
    assert isinstance(results, Results)
    return results


def tolerance_map(
    study: Study,
    *,
    workers: int | None = None,
    engine: Executor | None = None,
    progress: Progress | None = None,
) -> ToleranceMap:
    """Run the cells of a study for every draw of its tolerances, in memory; as `sweep`."""
    if not has_tolerances(study):
        raise SweepError(NO_TOLERANCES)
    result = Job(study).run(engine, workers=workers, progress=progress)
    assert isinstance(result, ToleranceMap)
    return result


def cell_count(study: Study) -> int:
    """Number of cells of a study's sweep; 0 without axes."""
    design = design_of(study)
    return design.cells if design.shape else 0
