"""Engines: the executors that run the tiles of a sweep.

An engine is anything with the shape of `concurrent.futures.Executor`: threads by default, or the workers of a dask
scheduler (`clunk.sweeping.distributed`). Its tasks are calls of `Grid.run`. Other processes get a copy of the flag that
stops a task, so that setting it does not stop them. A cell's result depends on nothing but its parameters, so neither
the engine, the cut into tiles, the order nor the number of workers can change a bit of it.

An engine may have two further methods: `processors()`, which names the processors of its workers, and
`explained(error)`, which makes an error for the user of a tile's error.
"""

import math
import signal
import threading
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

import numpy as np

from clunk.study.arrays import Cells
from clunk.study.errors import ClunkError
from clunk.sweeping.cells import Grid, Tile
from clunk.sweeping.machine import available_cores

_DEFERRED = (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM))
_MOMENT = 0.01  # s of runs from which on threads are used: to start them and to wait for them takes 1 ms
_TILE = 0.5  # s that a tile takes at most: progress is smooth, and an interrupt loses little
_AHEAD = 8  # tiles submitted for each worker, which goes on while a part is written to the disk, 0.1 to 0.3 s
_ATTENDED = 25  # workers that this process can serve: a tile of the usual size takes 4 ms here and 0.1 s there


class EngineError(ClunkError):
    """An engine that cannot start or go on; its text is one sentence for the user."""


def run_tiles(grid: Grid, cells: Cells, engine: Executor) -> Generator[Tile, None, None]:
    """Run cells until none wait or run; yield finished tiles in the order in which they finish.

    Leaving the generator early abandons the running cells. Raises EngineError where the engine cannot go on. Runs that
    take less than `_MOMENT` altogether are done without threads.
    """
    stop, waiting = np.zeros(1, np.uint8), grid.ordered(cells)
    if grid.few_cells and isinstance(engine, Threads):
        while waiting.size and not _MOMENT <= waiting.size * grid.pace[0] < math.inf:
            few, waiting = np.split(waiting, [grid.few_cells if grid.pace[0] == math.inf else grid.tile_cells])
            yield grid.run(few, stop)
    running: set[Future[Tile]] = set()
    count = waiting.size
    try:
        while True:
            workers = getattr(engine, "_max_workers", None) or available_cores()  # an attribute of all engines
            most = grid.tile_cells
            if isinstance(engine, Threads) and grid.pace[0] < math.inf:  # unknown of other processes
                most = min(most, max(grid.few_cells, math.ceil(_TILE / grid.pace[0])))
            while size := next_tile(waiting.size, len(running), count, workers, most):
                # each of the last tiles has every n-th of the cells that are left, so that they take equally long
                part = slice(0, None, -(-waiting.size // size)) if waiting.size <= workers * size else slice(size)
                running.add(engine.submit(grid.run, waiting[part].copy(), stop))  # a tile keeps these only
                waiting = waiting[size:] if part.step is None else np.delete(waiting, part)
            if not running:
                return
            with deferred_signals():
                finished, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    tile = future.result()
                except Exception as error:
                    if not hasattr(engine, "explained"):
                        raise
                    raise engine.explained(error) from error
                yield tile
    finally:
        stop[0] = 1
        if running:
            with deferred_signals():
                for future in running:
                    future.cancel()


def next_tile(waiting: int, running: int, cells: int, workers: int, tile_cells: int) -> int:
    """Number of cells of the next tile; 0 where enough tiles are running.

    It is half of a worker's share of the waiting cells, so that all workers end together; but not so small that a tile
    is not worth its overhead, unless a worker would be idle without it.

    waiting : number of cells that wait
    running : number of tiles that run
    cells : number of all cells
    tile_cells : the most cells of a tile
    """
    largest = tile_cells * max(1, workers // _ATTENDED)
    least = max(min(largest // 8, -(-cells // workers)), 1)
    size = min(max(-(-waiting // (2 * workers)), least), largest)
    return min(size, waiting) if running < workers * _AHEAD else 0


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Context that defers the handlers of SIGINT, SIGTERM and SIGHUP to its end.

    Python runs the handler of a signal between any two steps of the main thread. A handler that raises, as that of
    SIGINT does, can interrupt `concurrent.futures` where it has locked something and not yet noted that it has to
    unlock it; its threads then wait for ever, and so does all that waits for them.
    """
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # the only one that runs handlers, and that may set them
        handlers = {number: handler for number in _DEFERRED if callable(handler := signal.getsignal(number))}
    arrived: list[int] = []
    try:
        for number in handlers:
            signal.signal(number, lambda number, _frame: arrived.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in arrived[:1]:
            handlers[number](number, None)


class Threads(ThreadPoolExecutor):
    """Thread pool in which a signal leaves no lock held."""

    def submit(self, *arguments: Any, **options: Any) -> Future[Any]:
        """Submit a task as `ThreadPoolExecutor` does; a signal waits until the task is in the queue."""
        with deferred_signals():
            return super().submit(*arguments, **options)
