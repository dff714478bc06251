"""The workers of a dask scheduler as an engine: tiles run there, and come back to this process, which keeps them.

No other module imports dask. The scheduler holds only a few tiles for each thread of its workers, however large the
grid is, and workers may come and go while it runs: a tile whose worker dies is run by another. Who runs it can change
no bit of it where all are of the same versions, which every worker is asked.
"""

from __future__ import annotations

import functools
import hashlib
import io
import json
import logging
import math
import pickle
import secrets
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

import dask
import distributed
import numpy as np
import numpy.typing as npt
from distributed import Client, Future, KilledWorker, LocalCluster

from clunk.core.jit import is_cold
from clunk.results.files import reason
from clunk.sweeping.cells import Grid
from clunk.sweeping.engines import Cells, EngineError, Work, available_cores, cpu_model, tile_size
from clunk.sweeping.parts import versions
from clunk.sweeping.tiles import Tile, from_bytes, to_pieces

LOCAL = "local"

_CONNECTING = 4.0  # s
_IN_FLIGHT = 3  # tiles for each thread of the workers
_ASKING = 1.0  # s between two looks at how many threads there are
_FETCHED = 8  # tiles at once
_SHORTEST = 0.2  # s, of a tile
_ATTENTION = 4e-3  # s of this process for a tile, with a margin
_LARGEST = 1 << 18  # runs of a tile, about 30 MB of cells
_ENDING = 3.0  # s that workers have to hear that a sweep is abandoned


@dataclass(frozen=True)
class _Job:
    """What goes with every tile of a sweep."""

    name: str
    method: str
    versions: Mapping[str, str]

    @property
    def origin(self) -> bytes:
        """What its tiles are marked with."""
        return hashlib.sha256(json.dumps([self.name, dict(self.versions)]).encode()).digest()


@dataclass(frozen=True)
class _Worker:
    """What a worker says of itself."""

    address: str
    versions: Mapping[str, str]
    processor: str


@dataclass(frozen=True)
class _Answer:
    """A tile as `clunk.sweeping.tiles` writes it, empty from a worker of other versions; and how long it took."""

    worker: _Worker
    seconds: float
    tile: bytes


class _Tiles:
    """The cells that wait, cut into tiles: so long that this process has the time to look after all workers.

    least : cells of the first tiles, and the least of any
    largest : of all
    """

    def __init__(self, work: Work, least: int, largest: int) -> None:
        self._work = work
        self.least = least
        self._largest = largest
        self._number = 0
        self._pace = math.inf  # s a cell

    def next(self, tiles: int, threads: int) -> dict[int, Cells | tuple[int, int]]:
        """Up to so many tiles by number, for so many threads: consecutive cells as the range that they are."""
        found: dict[int, Cells | tuple[int, int]] = {}
        while len(found) < tiles and self._work.size:
            wanted = int(max(_SHORTEST, _ATTENTION * threads) / self._pace)
            share = self._work.size // (4 * threads)  # so that all end together
            part = self._work.take(max(self.least, min(wanted, share, self._largest)))
            found[self._number] = (int(part[0]), int(part[-1]) + 1) if np.all(np.diff(part) == 1) else part
            self._number += 1
        return found

    def took(self, seconds: float, cells: int) -> None:
        """How long a tile took; the first ones of a worker load the program, too."""
        pace = max(seconds, 1e-6) / max(cells, 1)
        self._pace = pace if math.isinf(self._pace) else 0.5 * (self._pace + pace)


class Cluster:
    """The workers of a scheduler, while this is open.

    Parameters
    ----------
    address : str
        Of the scheduler, ``tcp://host:8786``; or `LOCAL` for one with workers on this machine, which end with this.
        A script that uses `LOCAL` needs Python's ``if __name__ == "__main__":``.
    workers : int, optional
        Processes of `LOCAL`; by default one for each core that this process may use.
    say : callable(text), optional
        Told what is being waited for.

    Raises EngineError where there is no scheduler, or one of its workers cannot give the bits that this process would.
    """

    def __init__(self, address: str, workers: int | None = None, say: Callable[[str], None] | None = None) -> None:
        self._address = address
        self._workers = workers or available_cores()
        self._say = say or (lambda _text: None)
        self._processors: set[str] = set()
        self._told = False
        self._open = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(_quiet())
            opened.enter_context(dask.config.set({"distributed.comm.timeouts.connect": _CONNECTING}))
            scheduler: LocalCluster | str = self._address
            if self._address == LOCAL:
                scheduler = opened.enter_context(_local_cluster(self._workers))
            try:
                self._client = Client(scheduler, timeout=_CONNECTING, set_as_default=False, name="clunk")
            except Exception as error:  # whatever answers at that address, or does not
                raise EngineError(
                    f"No scheduler answers at {self._address} ({reason(error)}): start one with 'dask scheduler'."
                ) from error
            opened.callback(self._client.close, timeout=_ENDING)
            self._open = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def processors(self) -> str:
        """The models of the processors that ran cells; where there are several, see `run`."""
        return "; ".join(sorted(self._processors)) or cpu_model()

    def run(self, grid: Grid, work: Work) -> Generator[Tile, None, None]:
        """See `clunk.sweeping.engines.Engine`.

        A system that all cells share is prepared here. Those of structural axes are prepared where they are needed, by
        LAPACK, which on a processor of another type may round differently.
        """
        if not work.size:
            return
        job = _Job(secrets.token_hex(8), grid.study.solver.method, versions())
        threads, asked = self._threads(), time.monotonic()
        self._check_workers(job)
        # A task of its own: it goes to each worker once, and to those that come later as well.
        study = self._client.submit(bytes, _pickled(*grid.recipe()), key=f"clunk-study-{job.name}")
        tiles = _Tiles(work, tile_size(work.size, grid, threads), max(1, _LARGEST // grid.runs))
        running: set[Future[Any]] = set()
        done: SimpleQueue[Future[Any]] = SimpleQueue()
        try:
            while True:
                if time.monotonic() - asked > _ASKING:
                    threads, asked = self._threads(), time.monotonic()
                if work.may_grow:
                    tiles.least = tile_size(work.known, grid, threads)
                parts = tiles.next(_IN_FLIGHT * threads - len(running), threads)
                if parts:
                    keys = [f"clunk-tile-{job.name}-{number}" for number in parts]
                    for future in self._client.map(_run_tile, list(parts.values()), study=study, job=job, key=keys):
                        running.add(future)
                        future.add_done_callback(done.put)
                if not running:  # nor does anything wait, which may have come while tiles were yielded
                    return
                futures = _those_in(done)
                for answer in self._fetched(futures, job):
                    tile = from_bytes(answer.tile, job.origin, grid.record, grid.detail)
                    tiles.took(answer.seconds, tile.cells.size)
                    yield tile
                running.difference_update(futures)
                if grid.shared() is None and len(self._processors) > 1 and not self._told:
                    self._told = True
                    self._say(f"note: processors of several types, last bits may depend on them: {self.processors()}")
                if self._client.status != "running":
                    raise self._lost()
        finally:
            self._abandon(job, [*running, study])

    def _threads(self) -> int:
        """How many threads the workers have; waits for the first."""
        told = False
        while True:
            try:
                threads = int(sum(self._client.nthreads().values()))
            except Exception as error:  # whichever of its layers notices first that the scheduler has gone
                raise self._lost() from error
            if threads:
                return threads
            if not told:
                self._say(f"waiting for a worker of {self._address} …")
            told = True
            time.sleep(_ASKING / 4)

    def _check_workers(self, job: _Job) -> None:
        """Refuse workers of other versions, or that cannot tell theirs; say where kernels will be compiled."""
        try:
            found = self._client.run(_introduced, on_error="return")
            cold = self._client.run(is_cold, job.method, on_error="ignore")
        except Exception as error:
            raise self._lost() from error
        for address, worker in found.items():
            if isinstance(worker, OSError):  # it has gone in the meantime
                continue
            if not isinstance(worker, _Worker):
                raise EngineError(
                    f"Worker {address} cannot run clunk ({reason(worker)}): it needs the same installation as here."
                )
            _refuse_other_versions(worker, job)
        if compiling := sum(cold.values()):
            self._say(f"{compiling} of {len(found)} workers compile {job.method}, once for an installation …")

    def _fetched(self, futures: Sequence[Future[Any]], job: _Job) -> list[_Answer]:
        """What came of finished tasks."""
        if not futures:
            return []
        try:
            answers: list[_Answer] = self._client.gather(list(futures))
        except KilledWorker as error:
            raise EngineError(
                f"The same cells were being run by {error.allowed_failures + 1} workers that died, the last of them "
                f"{error.last_worker.address}: see their logs."
            ) from error
        except Exception as error:
            if self._client.status != "running":
                raise self._lost() from error
            self._check_workers(job)  # one that has come since may be why
            raise EngineError(f"A worker could not run its cells: {reason(error)}.") from error
        for answer in answers:
            _refuse_other_versions(answer.worker, job)
            self._processors.add(answer.worker.processor)
        return answers

    def _lost(self) -> EngineError:
        return EngineError(f"The scheduler at {self._address} was lost.")

    def _abandon(self, job: _Job, futures: Sequence[Future[Any]]) -> None:
        """Let go of tasks, and end those that run."""
        if len(futures) < 2 or self._client.status != "running":
            return

        def tell() -> None:
            self._client.cancel(list(futures), force=True)
            self._client.run(_stop, job.name, on_error="ignore")

        telling = threading.Thread(target=tell, daemon=True)  # a worker may be deaf for as long as it compiles
        telling.start()
        telling.join(_ENDING)


def _refuse_other_versions(worker: _Worker, job: _Job) -> None:
    for name, here in job.versions.items():
        there = worker.versions.get(name, "none")
        if there != here:
            raise EngineError(
                f"Worker {worker.address} has another {name}: {there[:12]} there, {here[:12]} here. Its results could "
                "differ in their last bits; it needs the same installation as here."
            )


def _those_in(done: SimpleQueue[Future[Any]]) -> list[Future[Any]]:
    """Some of the finished tasks; none where there are none for a while."""
    try:
        futures = [done.get(timeout=0.2)]
    except Empty:
        return []
    while len(futures) < _FETCHED and not done.empty():
        futures.append(done.get())
    return futures


def _pickled(*values: object) -> bytes:
    buffer = io.BytesIO()
    _Pickler(buffer).dump(values)
    return buffer.getvalue()


class _Pickler(pickle.Pickler):
    """Keeps how arrays lie in memory: kernels are compiled for that, and pickle knows only C and Fortran order."""

    def reducer_override(self, value: object) -> Any:
        if not isinstance(value, np.ndarray) or value.flags.forc:
            return NotImplemented
        order = np.argsort([-stride for stride in value.strides], kind="stable")
        return np.transpose, (np.ascontiguousarray(value.transpose(order)), tuple(np.argsort(order).tolist()))


@contextmanager
def _local_cluster(workers: int) -> Iterator[LocalCluster]:
    with TemporaryDirectory(prefix="clunk-dask-") as scratch:
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            memory_limit=0,  # of a worker; it needs some MB beside the program itself
            local_directory=scratch,
            silence_logs=logging.CRITICAL,
            preload=[_DEAF],
        )
        try:
            yield cluster
        finally:
            cluster.close(timeout=_ENDING)


# In a terminal Ctrl-C goes to every process; the workers of a local cluster leave it to this one.
_DEAF = "import signal ; signal.signal(signal.SIGINT, signal.SIG_IGN)"


@contextmanager
def _quiet() -> Iterator[None]:
    """Without dask's own messages: what a user should know is said by `Cluster`."""
    names = [name for name in logging.root.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in names}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=distributed.versions.VersionMismatchWarning)
        try:
            for name in names:
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
            yield
        finally:
            for name, level in levels.items():
                logging.getLogger(name).setLevel(level)


# --- on a worker


def _run_tile(cells: Cells | tuple[int, int], study: bytes, job: _Job) -> _Answer:
    worker = _introduced(distributed.get_worker())
    if worker.versions != job.versions:
        return _Answer(worker, 0.0, b"")
    numbers = np.arange(*cells, dtype=np.int64) if isinstance(cells, tuple) else cells
    began = time.perf_counter()
    tile = _grid(study).run(numbers, _stop_flag(job.name))
    return _Answer(worker, time.perf_counter() - began, b"".join(to_pieces([tile], job.origin)))


def _introduced(dask_worker: distributed.Worker) -> _Worker:
    return _Worker(dask_worker.address, _versions(), cpu_model())


@functools.cache
def _versions() -> dict[str, str]:
    return versions()


@functools.lru_cache(2)
def _grid(study: bytes) -> Grid:
    """The grid of a study as `Cluster.run` sends it; kept for other tiles, with the systems that it keeps."""
    kind, values = pickle.loads(study)  # noqa: S301  # from the command, by a scheduler that its user trusts
    grid: Grid = kind(*values)
    return grid


@functools.lru_cache(16)
def _stop_flag(job: str) -> npt.NDArray[np.uint8]:
    """What ends a sweep's tiles in this process."""
    return np.zeros(1, np.uint8)


def _stop(job: str) -> None:
    _stop_flag(job)[0] = 1
