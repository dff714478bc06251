"""Sweeps: the cells of a study's design, run by an engine and reduced to a map, in memory or into a results file."""

import math
import re
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from pathlib import Path

from clunk.core.status import Status
from clunk.results.maps import AnyMap, Results
from clunk.results.netcdf import StoreError
from clunk.results.store import read_map, write_results
from clunk.simulation.system import explained
from clunk.study.designs import Design, design_of
from clunk.study.document import FilePath
from clunk.study.errors import ClunkError
from clunk.study.records import counted
from clunk.study.study import Study, digest
from clunk.sweeping.cells import Grid
from clunk.sweeping.engines import EngineError, Threads, deferred_signals
from clunk.sweeping.machine import available_cores, available_memory, provenance
from clunk.sweeping.parts import Parts, PartsError, WorkingDirectory, differences
from clunk.sweeping.progress import ShowProgress, note, reporting
from clunk.sweeping.reduction import Reduction, regime_map
from clunk.sweeping.tolerances import SampleGrid, tolerance_map

HAS_TOLERANCES = "The study has [[sweep.tolerances]]: clunk.tolerance_map runs it."

_NO_SWEEP = (
    "There is nothing to sweep: the config has no [[sweep.axes]] and no [[sweep.samples]] (clunk help designs). "
    "clunk simulate runs it once."
)
_BYTES_PER_CELL = 550  # of memory for a cell with few impacts, at most: results, assembly, boundaries, writing
_WAYS_OUT = "Name another file, or overwrite it with --force (in Python, force=True)."


class Job:
    """A sweep of a study: it takes up the cells that are finished, runs the others and makes the map of all.

    `opened` makes a job for a results file. Raises ClunkError where nothing can run or the arrays don't fit in memory,
    and PartsError where `directory` holds another sweep's cells.

    study : with at least one axis or sample; with tolerances, the map is a ToleranceMap, else Results
    design : cells to run instead of those of the study's sweep
    directory : an open working directory, in which finished cells are kept and from which they are taken up
    path : results file to write
    held : the complete map that the file holds already, so that there is nothing to run; or None
    ran, seconds : number of cells that `run` has run, and the time that it took  [s]
    """

    def __init__(
        self,
        study: Study,
        design: Design | None = None,
        *,
        directory: WorkingDirectory | None = None,
        path: Path | None = None,
        held: AnyMap | None = None,
    ) -> None:
        self.study = study
        self.design = design or design_of(study)
        self.directory, self.path, self.held = directory, path, held
        self.ran, self.seconds = 0, 0.0
        self.parts = None
        if held is None:
            self._reduction = self._empty()
            if directory is not None:
                self.parts = Parts(directory, study)

    def _empty(self) -> Reduction:
        """Reduction without any finished cell.

        Raises ClunkError where there is nothing to sweep, the map does not fit in memory, or a tolerance map would have
        measures.
        """
        if not self.design.shape:
            raise ClunkError(_NO_SWEEP)
        lashes = len(self.study.lashes)
        shape = (*self.design.shape, lashes) if lashes > 1 else self.design.shape
        cells, memory = math.prod(shape), available_memory()
        needed = cells * _BYTES_PER_CELL
        if needed > 0.8 * memory:
            raise ClunkError(
                f"The grid of {' x '.join(map(str, shape))} = {cells:,} cells does not fit in memory: it takes "
                f"about {needed / 2**30:.0f} GiB, and there are {memory / 2**30:.0f} GiB."
            )
        if not self.study.swept.tolerances:
            return Reduction(Grid(self.study, self.design))
        if self.study.measured:
            raise ClunkError("A tolerance map has Q alone: leave out impacts.quantities and [[measures]].")
        return Reduction(SampleGrid(self.study))

    def finish(self, result: AnyMap, addition: Callable[[AnyMap], AnyMap] | None = None) -> AnyMap:
        """Add to a finished map, such as its boundaries, and write it to the results file, if there is one.

        Where the addition fails or is interrupted, the map is written without it. Raises ClunkError where the disk has
        no room for the results.
        """
        added = result
        try:
            if addition is not None:
                added = addition(result)
        except BaseException as stopped:
            if self.path is not None:
                stopped.add_note(
                    f"the map is complete in {self.path}, without its boundaries; the same command goes on with these"
                )
            raise
        finally:
            if added is not self.held and self.path is not None and self.directory is not None:
                with deferred_signals(), self._kept():
                    write_results(self.path, added, self.directory.path)
                    with suppress(PartsError):  # parts of the map that cannot be removed stay
                        self.directory.clear()
        return added

    @contextmanager
    def _kept(self) -> Iterator[None]:
        """Write finished cells to the disk where an interrupt or an error stops the sweep, and note where they are."""
        try:
            yield
        except (KeyboardInterrupt, SystemExit, ClunkError) as stopped:  # SIGINT, SIGTERM, workers gone, disk full
            if self.parts is not None:
                self.parts.flush()
                kept = f"{self.parts.kept:,} cells are kept in {self.parts.directory.path}; the same command goes on"
                stopped.add_note(f"{kept} from there" if self.parts.kept else "no cell was finished")
            raise

    def run(
        self,
        engine: Executor | None = None,
        *,
        progress: ShowProgress = False,
    ) -> AnyMap:
        """Take up the cells that are finished, run the others, and make the map.

        engine : runs tiles of cells, see `clunk.sweeping.engines`; by default threads, one for each core that this
            process may use
        progress : whether a bar is shown; or a function to call in this thread with the numbers of finished and of all
            cells, first with the cells taken up, then after each tile

        Raises the errors of `clunk.sweep`.
        """
        with reporting(progress, self.study) as report:
            began = time.perf_counter()
            reduction, parts = self._reduction, self.parts
            shared = reduction.grid.shared()
            if shared is not None and (status := Status(shared.status)) != Status.OK:
                raise ClunkError(f"No cell can run: {explained(self.study, status)}.")
            if parts is not None:
                for tile in parts.read():
                    reduction.add(tile)
                if parts.discarded:
                    note(
                        f"{counted(parts.discarded, 'part')} of other versions, or damaged: their cells are run again",
                        progress,
                    )
                if parts.taken_up:
                    note(f"{counted(parts.taken_up, 'cell')} were finished before; going on from there", progress)
            before = reduction.done
            with self._kept():
                reduction.run(engine or engine_of(None), report, None if parts is None else parts.add)
                make = tolerance_map if isinstance(reduction.grid, SampleGrid) else regime_map
                result = make(reduction, provenance(engine))
            self.ran, self.seconds = reduction.done - before, time.perf_counter() - began
            return result


@contextmanager
def opened(
    path: FilePath | None,
    study: Study,
    *,
    restart: bool = False,
    force: bool = False,
) -> Iterator[Job]:
    """Lock a results file for a sweep, and yield its job.

    path : results file, whose directory exists; None for a sweep in memory
    restart, force : as for `clunk.sweep`

    Raises ClunkError where the file holds something else, and PartsError where another process is writing it, or where
    cells of another sweep into it, which was stopped, are kept beside it.
    """
    if path is None:
        yield Job(study)
        return
    path = Path(path)
    with WorkingDirectory(path) as directory:
        held = _held(path, study) if path.exists() and not force else None
        if restart:
            directory.clear()
        elif held is not None and directory.parts():  # left by a process that was killed after writing its file
            with suppress(PartsError):  # another sweep's parts stay
                Parts(directory, study)
                directory.clear()
        yield Job(study, directory=directory, path=path, held=None if restart else held)


def _held(path: Path, study: Study) -> AnyMap:
    """The map that a results file holds. Raises ClunkError where it is not the complete map of this sweep."""
    try:
        held = read_map(path)
    except StoreError as error:
        raise ClunkError(f"{error} It is in the way of the results. {_WAYS_OUT}") from error
    if held.config_digest != digest(study):
        raise ClunkError(f"{path} holds the results of another config ({differences(held.config, study)}). {_WAYS_OUT}")
    if held.sequence.size != design_of(study).cells * len(study.lashes):
        raise ClunkError(f"{path} holds a part of this map. {_WAYS_OUT}")
    return held


def engine_of(scheduler: str | None, workers: int | None = None) -> Executor:
    """Engine of this process's threads, or of the workers of a dask scheduler, which must be opened (``with``).

    scheduler : address, such as ``tcp://host:8786``; or ``local`` for processes on this machine; or None for threads
    workers : number of threads or of local processes; by default one for each core that this process may use

    Raises EngineError where `scheduler` is not an address, `workers` is less than 1 or given with an address, or dask
    is not installed.
    """
    if workers is not None and workers < 1:
        raise EngineError(f"There is to be at least one worker, not {workers}.")
    if scheduler is None:
        return Threads(workers or available_cores())
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
    return Cluster(scheduler, workers)


def sweep(
    study: Study,
    design: Design | None = None,
    *,
    workers: int | None = None,
    progress: ShowProgress = False,
) -> Results:
    """Run the cells of a study in memory.

    Parameters and errors are those of `Job` and `Job.run`. Raises ClunkError where the study has tolerances, too.
    """
    if study.swept.tolerances:
        raise ClunkError(HAS_TOLERANCES)
    with engine_of(None, workers) as engine:
        results = Job(study, design).run(engine, progress=progress)
    assert isinstance(results, Results)
    return results
