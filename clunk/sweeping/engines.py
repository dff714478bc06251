"""Engines: the executors that run the tiles of a sweep.

An engine is anything with the shape of `concurrent.futures.Executor`: threads by default, or the workers of a dask
scheduler (`clunk.sweeping.distributed`). A cell's result depends on nothing but its parameters, so neither the engine,
the cut into tiles, the order nor the number of workers can change a bit of it.

An engine may have three methods besides: `next_tile(running, work, runner)`, as the function below, `processors()`, and
`explained(error)`, which makes of a tile's error one for the user.
"""

from __future__ import annotations

import functools
import platform
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from pathlib import Path
from typing import Protocol

import numpy as np

from clunk.core.regimes import System
from clunk.results.machine import available_cores
from clunk.study.arrays import Cells
from clunk.study.errors import ClunkError
from clunk.sweeping.cells import Flag
from clunk.sweeping.signals import deferred_signals
from clunk.sweeping.tiles import Layout, Tile

_AHEAD = 2  # tiles handed to each worker
_AHEAD_OF_WHOLE = 8  # of tiles of the largest size: they go on while a part is written to the disk, 0.3 s


class EngineError(ClunkError):
    """An engine that cannot start or go on; its text is one sentence for the user."""


class Runner(Protocol):
    """Runs cells to tiles, in any thread or process: it can be pickled.

    layout : of the tiles
    runs : of each cell
    method : of the runs, ``rk4`` or ``exact``
    tile_cells : the most cells of a tile
    """

    layout: Layout
    runs: int
    method: str
    tile_cells: int

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order in which they are best cut into tiles."""

    def shared(self) -> System | None:
        """The system that all runs share, if they do."""

    def run(self, cells: Cells, stop: Flag) -> Tile:
        """Run cells; the tile has those that were done before `stop` was set."""


class Work:
    """Queue of cells to run.

    size : number that wait
    known : number of all
    """

    def __init__(self, runner: Runner, cells: Cells) -> None:
        self._waiting = runner.ordered(cells)
        self.size = self.known = cells.size

    def take(self, most: int) -> Cells:
        """Remove up to `most` cells from the queue, such as are best run together."""
        part = self._waiting[:most].copy()  # it may be kept, and the rest need not
        self._waiting = self._waiting[most:]
        self.size -= part.size
        return part


def run_tiles(engine: Executor, runner: Runner, work: Work) -> Generator[Tile, None, None]:
    """Run cells until none wait or run; yield finished tiles in the order in which they finish.

    Leaving the generator early abandons the running cells. Raises EngineError where the engine cannot go on.
    """
    stop = np.zeros(1, np.uint8)
    running: set[Future[Tile]] = set()
    workers = getattr(engine, "_max_workers", None) or available_cores()  # all of the standard library have this name
    choose = getattr(engine, "next_tile", functools.partial(next_tile, workers))
    explained = getattr(engine, "explained", None)
    try:
        while True:
            while most := choose(len(running), work, runner):
                running.add(engine.submit(run_tile, runner, work.take(most), stop))
            if not running:
                return
            with deferred_signals():
                finished, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
            for future in finished:
                try:
                    tile = future.result()
                except Exception as error:
                    if explained is None:
                        raise
                    raise explained(error) from error
                yield tile
    finally:
        stop[0] = 1
        with deferred_signals():
            for future in running:
                future.cancel()


def run_tile(runner: Runner, cells: Cells, stop: Flag) -> Tile:
    """Run one tile; the task that engines are given. A process of its own gets a copy of the flag `stop`."""
    return runner.run(cells, stop)


def next_tile(workers: int, running: int, work: Work, runner: Runner) -> int:
    """Number of cells of the next tile; 0 where enough tiles are running.

    Half of a worker's share of the rest, so that all workers end together.
    """
    most = min(max(-(-work.size // (2 * workers)), _least(work.known, runner, workers)), runner.tile_cells)
    enough = workers * (_AHEAD_OF_WHOLE if most == runner.tile_cells else _AHEAD)
    return most if work.size and running < enough else 0


def tile_size(cells: int, runner: Runner, workers: int) -> int:
    """Number of cells of a tile so that each worker gets eight tiles, within the limits of a tile."""
    return min(max(-(-cells // (8 * workers)), _least(cells, runner, workers)), runner.tile_cells)


def _least(cells: int, runner: Runner, workers: int) -> int:
    """Number of cells below which a tile is not worth while, unless a worker would be idle without it."""
    return max(min(runner.tile_cells // 8, -(-cells // workers)), 1)


@functools.cache
def cpu_model() -> str:
    """Model of this machine's processor."""
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
