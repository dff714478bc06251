"""The workers of a dask scheduler as an engine: tiles run there, and come back to this process, which keeps them.

No other module imports dask. The scheduler holds only a few tiles for each thread of its workers, however large the
grid is, and workers may come and go while it runs: a tile whose worker dies is run by another. Every worker must have
the same versions, so that no bit of a tile depends on the one that runs it. A sweep that is stopped leaves its
scheduler at once; tiles that run then go on to their ends, and their results are dropped.
"""

from __future__ import annotations

import functools
import io
import logging
import pickle
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from tempfile import TemporaryDirectory
from typing import Any, Self

import dask
import distributed
import numpy as np
from distributed import Client, KilledWorker, LocalCluster

from clunk.results.files import reason
from clunk.study.arrays import Cells
from clunk.sweeping import engines
from clunk.sweeping.cells import Flag, Grid, Tile
from clunk.sweeping.engines import EngineError
from clunk.sweeping.machine import available_cores, cpu_model, versions

LOCAL = "local"

_CONNECTING = 4.0  # s
_ASKING = 1.0  # s between two looks at the number of threads
_CLOSING = 30.0  # s that the workers of a local cluster have to end; dask kills them after five


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
        self._open = ExitStack()
        self._sent: tuple[Grid, Any] | None = None  # the latest grid, and the task that brings it to the workers
        self._threads, self._asked = 0, -_ASKING

    def __enter__(self) -> Self:
        with ExitStack() as opened:
            opened.enter_context(_quiet())
            opened.enter_context(dask.config.set({"distributed.comm.timeouts.connect": _CONNECTING}))
            scheduler: LocalCluster | str = self._address
            if self._address == LOCAL:
                scheduler = opened.enter_context(_local_cluster(self._workers))
            try:
                self._client = Client(scheduler, timeout=_CONNECTING, set_as_default=False, name="clunk")
                opened.callback(self._client.close, timeout=_CONNECTING)
                if not self._client.nthreads():
                    self._say(f"waiting for a worker of {self._address} …")
                    self._client.wait_for_workers(1)
            except Exception as error:  # any: the address may be of another service, or of none
                raise EngineError(
                    f"No scheduler answers at {self._address} ({reason(error)}): start one with 'dask scheduler'."
                ) from error
            self._executor = self._client.get_executor(pure=False)
            self._open = opened.pop_all()
        return self

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the scheduler; its tasks end with that."""
        self._open.close()

    @property
    def _max_workers(self) -> int:
        """Number of threads of the workers, or 1 while there are none."""
        if time.monotonic() - self._asked > _ASKING:
            try:
                self._threads, self._asked = sum(self._client.nthreads().values()), time.monotonic()
            except Exception as error:  # depends on the layer that notices first that the scheduler has gone
                raise self._lost() from error
        return max(1, self._threads)

    def processors(self) -> str:
        """The models of the workers' processors.

        A system that all cells share is prepared in this process. Those of structural axes are prepared on the workers,
        by LAPACK, which on a processor of another type may round differently.
        """
        return "; ".join(sorted(set(self._ask(cpu_model).values()))) or cpu_model()

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **_options: Any) -> Future[Any]:
        """Run a tile on a worker; `function` is `clunk.sweeping.engines.run_tile`."""
        grid, cells, stop = arguments
        if self._sent is None or self._sent[0] is not grid:
            self._check_workers()
            pickled = io.BytesIO()
            _Pickler(pickled).dump(grid)
            # a task and not scattered data: a worker that dies takes no copy with it that could not be made again
            self._sent = grid, self._client.submit(bytes, pickled.getvalue(), pure=False)
        future: Future[Any] = self._executor.submit(_run, cells, self._sent[1], stop, versions())
        return future

    def explained(self, error: BaseException) -> BaseException:
        """The error of a tile, as one for the user."""
        if isinstance(error, EngineError):
            return error
        if isinstance(error, KilledWorker):
            return EngineError(
                f"The same cells were being run by {error.allowed_failures + 1} workers that died, the last of them "
                f"{error.last_worker.address}: see their logs."
            )
        if isinstance(error, CancelledError) or self._client.status != "running":
            return self._lost()
        return EngineError(f"A worker could not run its cells: {reason(error)}.")

    def _ask(self, function: Callable[[], Any]) -> dict[str, Any]:
        """Answer of each worker, or the error that it ended with; by address."""
        try:
            answers: dict[str, Any] = self._client.run(function, on_error="return")
        except Exception as error:
            raise self._lost() from error
        return {address: each for address, each in answers.items() if not isinstance(each, OSError)}  # it has gone

    def _check_workers(self) -> None:
        """Raise EngineError where a worker has other versions."""
        for address, answer in self._ask(versions).items():
            if not isinstance(answer, dict):
                raise EngineError(
                    f"Worker {address} cannot run clunk ({reason(answer)}): it needs the same installation as here."
                )
            _refuse_other_versions(address, answer, versions())

    def _lost(self) -> EngineError:
        return EngineError(f"The scheduler at {self._address} was lost.")


def _refuse_other_versions(address: str, there: Mapping[str, str], here: Mapping[str, str]) -> None:
    for name, wanted in here.items():
        version = there.get(name, "none")
        if version != wanted:
            raise EngineError(
                f"Worker {address} has another {name}: {version[:12]} there, {wanted[:12]} here. Its results "
                "could differ in their last bits; it needs the same installation as here."
            )


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


def _run(cells: Cells, pickled: bytes, stop: Flag, wanted: Mapping[str, str]) -> Tile:
    _refuse_other_versions(distributed.get_worker().address, versions(), wanted)  # it may have joined just now
    return engines.run_tile(_grid(pickled), np.array(cells), stop)


@functools.lru_cache(2)
def _grid(pickled: bytes) -> Grid:
    """The cells of a sweep; kept for other tiles, with the drivelines that they keep."""
    grid: Grid = pickle.loads(pickled)  # noqa: S301  # from the command, by a scheduler that its user trusts
    return grid
