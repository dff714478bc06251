"""The workers of a dask scheduler as an engine: tiles run there, and come back to this process, which keeps them.

No other module imports dask. The scheduler holds only a few tiles for each thread of its workers, however large the
grid is, and workers may come and go while it runs: a tile whose worker dies is run by another. Every worker must have
the same versions, so that no bit of a tile depends on the worker that runs it. A sweep that is stopped leaves its
scheduler at once; tiles that are running then go on to their ends, and their results are dropped.
"""

import logging
import pickle
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, suppress
from typing import Any, Self

import dask
import distributed
import numpy as np
from distributed import Client, KilledWorker, LocalCluster
from distributed.utils import silence_logging_cmgr
from llvmlite.binding import get_host_cpu_name

from clunk.core.arrays import StopFlag
from clunk.results.files import reason
from clunk.study.arrays import Cells
from clunk.sweeping.cells import Grid, Tile
from clunk.sweeping.engines import EngineError
from clunk.sweeping.machine import available_cores, versions
from clunk.sweeping.progress import note

_CONNECTING = 4.0  # s to wait for the scheduler's answer, at most
_ASKING = 1.0  # s between two queries of the number of threads
_LOGS = ("distributed", "distributed.client", "tornado.application")  # silenced: EngineError says what they log
_LOCAL: dict[str, Any] = {
    "threads_per_worker": 1,
    "scheduler_kwargs": {"dashboard": False, "dashboard_address": "127.0.0.1:0"},
    "memory_limit": 0,  # none: a worker needs only some MB beside the program itself
    "silence_logs": logging.CRITICAL,
    # in a terminal Ctrl-C goes to every process; the workers ignore it and leave it to this process
    "preload": ["import signal ; signal.signal(signal.SIGINT, signal.SIG_IGN)"],
}


class Cluster(Executor):
    """Engine of the workers of a scheduler, while this context is open.

    address : address of the scheduler, such as ``tcp://host:8786``; or ``local`` for a scheduler and workers on this
        machine, which end with this context; a script that uses ``local`` needs Python's ``if __name__ == "__main__":``
    workers : number of worker processes of ``local``; by default one for each core that this process may use

    Raises EngineError where no scheduler answers, or one of its workers has other versions.
    """

    def __init__(self, address: str, workers: int | None = None) -> None:
        self._address = address
        self._workers = workers or available_cores()
        self._sent: tuple[Grid, Any] | None = None  # the latest grid, and the task that brings it to the workers
        self._threads, self._asked = 1, -_ASKING  # as if there had been a worker, so that a note says if there is none

    def __enter__(self) -> Self:
        scheduler: Any = self._address
        with ExitStack() as opened:
            for name in _LOGS:
                opened.enter_context(silence_logging_cmgr(logging.CRITICAL + 1, name))
            opened.enter_context(dask.config.set({"distributed.comm.timeouts.connect": _CONNECTING}))
            try:
                if scheduler == "local":
                    scheduler = opened.enter_context(LocalCluster(n_workers=self._workers, **_LOCAL))
                client = Client(scheduler, timeout=_CONNECTING, set_as_default=False, name="clunk")
                self._client = opened.enter_context(client)
            except Exception as error:  # any: the address may be of another service, or of none
                raise EngineError(
                    f"No scheduler answers at {self._address} ({reason(error)}): start one with 'dask scheduler'."
                ) from error
            self._executor = self._client.get_executor(pure=False)
            self._open = opened.pop_all()
        return self

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the scheduler, which then drops the tasks of this engine, whatever the arguments are."""
        self._open.close()

    @property
    def _max_workers(self) -> int:
        """Number of threads of the workers, or 1 while there are none."""
        if time.monotonic() - self._asked > _ASKING:
            try:
                threads, self._asked = sum(self._client.nthreads().values()), time.monotonic()
                if self._threads and not threads:
                    note(f"waiting for a worker of {self._address} …", True)
                self._threads = threads
            except Exception as error:  # which one depends on the layer that first notices a lost scheduler
                raise self.explained(CancelledError()) from error
        return max(1, self._threads)

    def processors(self) -> str:
        """Models of the workers' processors, by which LAPACK may round differently as it prepares systems there."""
        models = {}
        with suppress(OSError):  # all cells are finished, and the scheduler or a worker has gone since
            models = self._client.run(get_host_cpu_name, on_error="ignore")
        return "; ".join(sorted(set(models.values()))) or get_host_cpu_name()

    def submit(self, function: Any, /, *arguments: Any, **_options: Any) -> Future[Any]:
        """Run a tile on a worker; `function` is `Grid.run` of a grid."""
        grid = function.__self__
        if self._sent is None or self._sent[0] is not grid:
            # sent by a task and not as scattered data: where a worker that holds it dies, the task is run again
            self._sent = grid, self._client.submit(pickle.loads, pickle.dumps(grid), pure=False)
        return self._executor.submit(_run, versions(), self._sent[1], *arguments)

    def explained(self, error: BaseException) -> BaseException:
        """Error for the user, made of a tile's error."""
        if isinstance(error, EngineError):
            return error
        if isinstance(error, KilledWorker):
            text = f"The same cells were being run by {error.allowed_failures + 1} workers that died: see their logs."
        elif isinstance(error, CancelledError) or self._client.status != "running":
            text = f"The scheduler at {self._address} was lost."
        else:
            text = f"A worker could not run its cells ({reason(error)}): it needs the same installation as here."
        return EngineError(text)


def _run(wanted: Mapping[str, str], grid: Grid, cells: Cells, stop: StopFlag) -> Tile:
    """Run a tile on a worker, which keeps the grid, and the drivelines that it has prepared, for further tiles.

    Raises EngineError where the worker has other versions than those wanted.
    """
    for name, version in versions().items():
        if version != wanted[name]:
            raise EngineError(
                f"Worker {distributed.get_worker().address} has another {name}: {version[:12]} there, "
                f"{wanted[name][:12]} here. Its results could differ in their last bits; it needs the same "
                "installation as here."
            )
    return grid.run(np.array(cells), stop)
