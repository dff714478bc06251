"""Engines: the executors that run the tiles of a sweep.

An engine is anything with the shape of `concurrent.futures.Executor`: threads by default, or the workers of a dask
scheduler (`clunk.sweeping.distributed`). A cell's result depends on nothing but its parameters, so neither the engine,
the cut into tiles, the order nor the number of workers can change a bit of it.

An engine may have two methods besides: `processors()`, and `explained(error)`, which makes of a tile's error one for
the user.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any, Protocol

import numpy as np

from clunk.core.regimes import System
from clunk.study.arrays import Cells
from clunk.study.errors import ClunkError
from clunk.sweeping.cells import Flag, Layout, Tile
from clunk.sweeping.machine import available_cores

_DEFERRED = (signal.SIGINT, signal.SIGTERM)
_AHEAD = 2  # tiles handed to each worker
_AHEAD_OF_WHOLE = 8  # of tiles of the largest size: they go on while a part is written to the disk, 0.3 s
_ATTENDED = 25  # workers whose tiles of the usual size this process can look after: 4 ms each, of 0.1 s


class EngineError(ClunkError):
    """An engine that cannot start or go on; its text is one sentence for the user."""


class Runner(Protocol):
    """Runs cells to tiles, in any thread or process: it can be pickled.

    layout : of the tiles
    tile_cells : the most cells of a tile
    """

    layout: Layout
    tile_cells: int

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order in which they are best cut into tiles."""

    def shared(self) -> System | None:
        """The system that all runs share, if they do."""

    def run(self, cells: Cells, stop: Flag) -> Tile:
        """Run cells; the tile has those that were done before `stop` was set."""


def run_tiles(engine: Executor, runner: Runner, cells: Cells) -> Generator[Tile, None, None]:
    """Run cells until none wait or run; yield finished tiles in the order in which they finish.

    Leaving the generator early abandons the running cells. Raises EngineError where the engine cannot go on.
    """
    stop = np.zeros(1, np.uint8)
    running: set[Future[Tile]] = set()
    waiting = runner.ordered(cells)
    try:
        while True:
            workers = getattr(engine, "_max_workers", None) or available_cores()  # all engines have this name
            while size := next_tile(waiting.size, len(running), cells.size, workers, runner.tile_cells):
                running.add(engine.submit(run_tile, runner, waiting[:size].copy(), stop))  # may be kept, the rest not
                waiting = waiting[size:]
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
        with deferred_signals():
            for future in running:
                future.cancel()


def run_tile(runner: Runner, cells: Cells, stop: Flag) -> Tile:
    """Run one tile; the task that engines are given. A process of its own gets a copy of the flag `stop`."""
    return runner.run(cells, stop)


def next_tile(waiting: int, running: int, cells: int, workers: int, tile_cells: int) -> int:
    """Number of cells of the next tile; 0 where enough tiles are running.

    Half of a worker's share of the rest, so that all workers end together; but not so few that a tile is not worth
    while, unless a worker would be idle without it.

    waiting : number of cells that wait
    running : number of tiles that run
    cells : number of all cells
    tile_cells : the runner's
    """
    largest = tile_cells * max(1, workers // _ATTENDED)
    least = max(min(largest // 8, -(-cells // workers)), 1)
    size = min(max(-(-waiting // (2 * workers)), least), largest)
    enough = workers * (_AHEAD_OF_WHOLE if size == largest else _AHEAD)
    return min(size, waiting) if running < enough else 0


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Context that defers the handlers of SIGINT and SIGTERM to its end.

    Python runs the handler of a signal between any two steps of the main thread. A handler that raises, as that of
    SIGINT does, can interrupt `concurrent.futures` where it has locked something and not yet noted that it has to
    unlock it; its threads then wait for ever, and so does who waits for them.
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
