"""The workers of a dask scheduler as an engine: tiles run there, and come back to this process, which keeps them.

No other module imports dask. The scheduler holds only a few tiles for each thread of its workers, however large the
grid is, and workers may come and go while it runs: a tile whose worker dies is run by another. Every worker must have
the same versions, so that no bit of a tile depends on the one that runs it.
"""

from __future__ import annotations

import functools
import io
import logging
import math
import pickle
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any, Self

import dask
import distributed
import numpy as np
from distributed import Client, KilledWorker, LocalCluster

from clunk.core.jit import is_cold
from clunk.results.files import reason
from clunk.results.machine import available_cores
from clunk.study.arrays import Cells
from clunk.sweeping import engines
from clunk.sweeping.engines import EngineError, Runner, Stop, Work
from clunk.sweeping.provenance import versions
from clunk.sweeping.tiles import Tile

LOCAL = "local"

_CONNECTING = 4.0  # s
_IN_FLIGHT = 3  # tiles for each thread of the workers
_ASKING = 1.0  # s between two looks at the number of threads
_FETCHED = 8  # tiles at once
_SHORTEST = 0.2  # s, of a tile
_ATTENTION = 4e-3  # s of this process for a tile, with a margin
_LARGEST = 1 << 18  # runs of a tile, about 30 MB of cells
_ENDING = 3.0  # s that workers have to hear that a sweep is abandoned
_CLOSING = 30.0  # s that those of a local cluster have to end; dask kills them after five


@dataclass(frozen=True)
class _Worker:
    """A worker's description of itself."""

    address: str
    versions: Mapping[str, str]
    processor: str


@dataclass(frozen=True)
class _Answer:
    """A tile, or None from a worker of other versions, and the time that it took."""

    worker: _Worker
    seconds: float
    tile: Tile | None


class _Pace:
    """Sizes of the next tiles, so long that this process has the time to look after all workers.

    least : cells of the first tiles, and of the smallest
    largest : cells of the largest
    """

    def __init__(self, least: int, largest: int) -> None:
        self.least = least
        self._largest = largest
        self._seconds = math.inf  # a cell

    def cells(self, waiting: int, threads: int) -> int:
        """Number of cells of the next tile, where `waiting` cells are left for `threads` threads."""
        long_enough = int(max(_SHORTEST, _ATTENTION * threads) / self._seconds)
        share = waiting // (4 * threads)  # so that all end together
        return max(self.least, min(long_enough, share, self._largest))

    def took(self, seconds: float, cells: int) -> None:
        """Take the time of a tile into account; that of a worker's first ones includes loading the program."""
        pace = max(seconds, 1e-6) / max(cells, 1)
        self._seconds = pace if math.isinf(self._seconds) else 0.5 * (self._seconds + pace)


class _Task(Future[Tile]):
    """A tile that is run by the workers; to cancel one is to abandon its sweep."""

    def __init__(self, abandon: Callable[[], None]) -> None:
        super().__init__()
        self._abandon = abandon

    def cancel(self) -> bool:
        """Abandon the sweep."""
        self._abandon()
        return super().cancel()


@dataclass(eq=False)
class _Sweep:
    """The tiles of one runner.

    versions : that its workers must have
    sent : the runner as a task, which goes to each worker once, and to those that join later as well
    running : tiles by dask's future
    """

    runner: Runner
    stop: Stop
    versions: Mapping[str, str]
    pace: _Pace
    sent: Any = None
    running: dict[Any, _Task] = field(default_factory=dict)
    done: SimpleQueue[Any] = field(default_factory=SimpleQueue)
    count: int = 0
    ended: bool = False  # nothing more comes of it
    abandoned: bool = False
    warned: bool = False  # of processors of several types


class Cluster(Executor):
    """The workers of a scheduler, while this is open.

    address : of the scheduler, ``tcp://host:8786``; or `LOCAL` for one with workers on this machine, which end with
        this; a script that uses that needs Python's ``if __name__ == "__main__":``
    workers : processes of `LOCAL`; by default one for each core that this process may use
    say : called with messages on what it waits for

    Raises EngineError where there is no scheduler, or one of its workers has other versions.
    """

    def __init__(self, address: str, workers: int | None = None, say: Callable[[str], None] | None = None) -> None:
        self._address = address
        self._workers = workers or available_cores()
        self._say = say or (lambda _text: None)
        self._processors: set[str] = set()
        self._open = ExitStack()
        self._sweep: _Sweep | None = None  # the latest one
        self._known_threads, self._asked = 0, -math.inf

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(_quiet())
            opened.enter_context(dask.config.set({"distributed.comm.timeouts.connect": _CONNECTING}))
            scheduler: LocalCluster | str = self._address
            if self._address == LOCAL:
                scheduler = opened.enter_context(_local_cluster(self._workers))
            try:
                self._client = Client(scheduler, timeout=_CONNECTING, set_as_default=False, name="clunk")
            except Exception as error:  # any: the address may be of another service, or of none
                raise EngineError(
                    f"No scheduler answers at {self._address} ({reason(error)}): start one with 'dask scheduler'."
                ) from error
            opened.callback(self._client.close, timeout=_ENDING)
            self._open = opened.pop_all()
        return self

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the scheduler; its tasks end with that."""
        self._open.close()

    def processors(self) -> str:
        """The models of the processors that ran cells.

        A system that all cells share is prepared in this process. Those of structural axes are prepared on the workers,
        by LAPACK, which on a processor of another type may round differently.
        """
        return "; ".join(sorted(self._processors)) or engines.cpu_model()

    def next_tile(self, running: int, work: Work, runner: Runner) -> int:
        """Number of cells of the next tile; 0 where enough tiles are running."""
        if not work.size:
            return 0
        threads, sweep = self._threads(), self._sweep
        if sweep is None or sweep.runner is not runner or sweep.ended:
            pace = _Pace(engines.tile_size(work.size, runner, threads), max(1, _LARGEST // runner.runs))
            sweep = _Sweep(runner, Stop(), versions(), pace)
            self._check_workers(sweep)
            self._sweep = sweep
        return sweep.pace.cells(work.size, threads) if running < _IN_FLIGHT * threads else 0

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_options: Any) -> Future[Any]:
        """Run a tile on a worker; `function` is `clunk.sweeping.engines.run_tile`."""
        assert function is engines.run_tile
        runner, cells, stop = arguments
        sweep = self._sweep
        assert sweep is not None
        assert sweep.runner is runner
        if sweep.sent is None:
            sweep.stop = stop
            pickled = io.BytesIO()
            _Pickler(pickled).dump(runner)
            sweep.sent = self._client.submit(bytes, pickled.getvalue(), key=f"clunk-study-{stop.name}")
            threading.Thread(target=self._fetch, args=(sweep,), daemon=True).start()
        consecutive = cells[-1] - cells[0] + 1 == cells.size and np.all(np.diff(cells) == 1)
        task = _Task(functools.partial(self._abandon, sweep))
        future = self._client.submit(
            _run,
            (int(cells[0]), int(cells[-1]) + 1) if consecutive else cells,
            sweep.sent,
            stop,
            sweep.versions,
            key=f"clunk-tile-{stop.name}-{sweep.count}",
        )
        sweep.count += 1
        task.set_running_or_notify_cancel()
        sweep.running[future] = task
        future.add_done_callback(sweep.done.put)
        return task

    def _fetch(self, sweep: _Sweep) -> None:
        """Fetch finished tiles until the sweep ends; runs in a separate thread."""
        while not sweep.ended:
            futures = _finished(sweep.done)
            try:
                for future, answer in zip(futures, self._answers(futures, sweep), strict=True):
                    assert answer.tile is not None
                    sweep.pace.took(answer.seconds, answer.tile.cells.size)
                    sweep.running.pop(future).set_result(answer.tile)
                if self._client.status != "running":
                    raise self._lost()
            except Exception as error:
                if not sweep.ended:
                    sweep.ended = True
                    for task in list(sweep.running.values()):
                        task.set_exception(error)

    def _answers(self, futures: Sequence[Any], sweep: _Sweep) -> list[_Answer]:
        """Results of finished tasks."""
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
            self._check_workers(sweep)  # one that has joined since may be the reason
            raise EngineError(f"A worker could not run its cells: {reason(error)}.") from error
        for answer in answers:
            _refuse_other_versions(answer.worker, sweep)
            self._processors.add(answer.worker.processor)
        if len(self._processors) > 1 and not sweep.warned and sweep.runner.shared() is None:
            sweep.warned = True
            self._say(f"note: processors of several types, last bits may depend on them: {self.processors()}")
        return answers

    def _threads(self) -> int:
        """Number of threads of the workers; waits for the first worker."""
        if self._known_threads and time.monotonic() - self._asked < _ASKING:
            return self._known_threads
        announced = False
        while True:
            try:
                threads = int(sum(self._client.nthreads().values()))
            except Exception as error:  # depends on the layer that notices first that the scheduler has gone
                raise self._lost() from error
            if threads:
                self._known_threads, self._asked = threads, time.monotonic()
                return threads
            if not announced:
                self._say(f"waiting for a worker of {self._address} …")
            announced = True
            time.sleep(_ASKING / 4)

    def _check_workers(self, sweep: _Sweep) -> None:
        """Raise EngineError where a worker has other versions; say how many will compile the kernel."""
        method = sweep.runner.method
        try:
            workers = self._client.run(_described, on_error="return")
            cold = self._client.run(is_cold, method, on_error="ignore")
        except Exception as error:
            raise self._lost() from error
        for address, worker in workers.items():
            if isinstance(worker, OSError):  # it has gone in the meantime
                continue
            if not isinstance(worker, _Worker):
                raise EngineError(
                    f"Worker {address} cannot run clunk ({reason(worker)}): it needs the same installation as here."
                )
            _refuse_other_versions(worker, sweep)
        if compiling := sum(cold.values()):
            self._say(f"{compiling} of {len(workers)} workers compile {method}, once for an installation …")

    def _lost(self) -> EngineError:
        return EngineError(f"The scheduler at {self._address} was lost.")

    def _abandon(self, sweep: _Sweep) -> None:
        """Cancel a sweep's tasks, and end those that run."""
        if sweep.abandoned:
            return
        sweep.abandoned = sweep.ended = True
        if self._client.status != "running":
            return

        def cancel() -> None:
            self._client.cancel([*sweep.running, sweep.sent], force=True)
            self._client.run(Stop.set, sweep.stop, on_error="ignore")

        cancelling = threading.Thread(target=cancel, daemon=True)  # a worker does not answer while it compiles
        cancelling.start()
        cancelling.join(_ENDING)


def _refuse_other_versions(worker: _Worker, sweep: _Sweep) -> None:
    for name, wanted in sweep.versions.items():
        version = worker.versions.get(name, "none")
        if version != wanted:
            raise EngineError(
                f"Worker {worker.address} has another {name}: {version[:12]} there, {wanted[:12]} here. Its results "
                "could differ in their last bits; it needs the same installation as here."
            )


def _finished(done: SimpleQueue[Any]) -> list[Any]:
    """The next finished tasks; none where none finishes for a while."""
    try:
        futures = [done.get(timeout=0.2)]
    except Empty:
        return []
    while len(futures) < _FETCHED and not done.empty():
        futures.append(done.get())
    return futures


class _Pickler(pickle.Pickler):
    """Pickler that keeps the order of arrays in memory, for which kernels are compiled; pickle knows only C and F."""

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
            preload=[_NO_INTERRUPTS],
        )
        try:
            yield cluster
        finally:
            with suppress(TimeoutError):  # of a busy machine: they end with this process at the latest
                cluster.close(timeout=_CLOSING)


# In a terminal Ctrl-C goes to every process; the workers of a local cluster leave it to this one.
_NO_INTERRUPTS = "import signal ; signal.signal(signal.SIGINT, signal.SIG_IGN)"


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence dask's messages: `Cluster` says what a user should know."""
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


def _run(cells: Cells | tuple[int, int], pickled: bytes, stop: Stop, wanted: Mapping[str, str]) -> _Answer:
    worker = _described(distributed.get_worker())
    if worker.versions != wanted:
        return _Answer(worker, 0.0, None)
    numbers = np.arange(*cells, dtype=np.int64) if isinstance(cells, tuple) else np.array(cells)
    began = time.perf_counter()
    tile = engines.run_tile(_runner(pickled), numbers, stop)
    return _Answer(worker, time.perf_counter() - began, tile)


def _described(dask_worker: distributed.Worker) -> _Worker:
    return _Worker(dask_worker.address, versions(), engines.cpu_model())


@functools.lru_cache(2)
def _runner(pickled: bytes) -> Runner:
    """The runner of a sweep; kept for other tiles, with the systems that it keeps."""
    runner: Runner = pickle.loads(pickled)  # noqa: S301  # from the command, by a scheduler that its user trusts
    return runner
