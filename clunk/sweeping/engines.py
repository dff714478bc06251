"""Engines: who runs the cells of a sweep. Here the threads of this process; `clunk.sweeping.distributed` has another.

A cell's result depends on nothing but its parameters, so neither the engine, the cut into tiles, the order nor the
number of threads can change a bit of it.
"""

from __future__ import annotations

import functools
import os
import platform
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from clunk.study.errors import ClunkError
from clunk.sweeping.cells import Grid
from clunk.sweeping.tiles import Tile

Cells = npt.NDArray[np.int64]

_AHEAD = 2  # tiles handed to each worker; by the time that it could get to more, others may be there to go with them
_AHEAD_OF_WHOLE = 8  # of tiles of the largest size: they go on while a part is written to the disk, 0.3 s


class EngineError(ClunkError):
    """An engine that cannot start or go on; its text is one sentence for the user."""


class Work:
    """Cells of a grid that wait to be run.

    size : how many wait
    known : how many there have been
    may_grow : whether others may turn up while some are running
    """

    def __init__(self, grid: Grid, cells: Cells, *, may_grow: bool = False) -> None:
        self.may_grow = may_grow
        self._grid = grid
        self._waiting = grid.ordered(cells)
        self._begin = 0
        self._added: list[Cells] = []
        self.size = self.known = cells.size

    def add(self, cells: Cells) -> None:
        """There are more."""
        if cells.size:
            self._added.append(cells)
            self.size += cells.size
            self.known += cells.size

    def take(self, most: int) -> Cells:
        """Up to so many of them, those that are best run together."""
        if self._added and self._waiting.size - self._begin < most:
            every = np.sort(np.concatenate([self._waiting[self._begin :], *self._added]))
            self._waiting, self._begin, self._added = self._grid.ordered(every), 0, []
        part = self._waiting[self._begin :][:most].copy()  # it may be kept, and the rest need not
        self._begin += part.size
        self.size -= part.size
        return part


class Engine(Protocol):
    """Runs cells of a grid."""

    def run(self, grid: Grid, work: Work) -> Generator[Tile, None, None]:
        """Finished tiles in the order in which they finish, until neither any cells wait nor any are running.

        Leaving the generator early abandons the running cells.

        Raises EngineError where it cannot go on.
        """
        ...

    def processors(self) -> str:
        """The models of the processors that ran cells, for the results' attribute `cpu`."""
        ...


class Threads:
    """The threads of this process, in a kernel without the interpreter lock.

    workers : how many; by default one for each core that this process may use
    """

    def __init__(self, workers: int | None = None) -> None:
        self._workers = workers or available_cores()

    def run(self, grid: Grid, work: Work) -> Generator[Tile, None, None]:
        """See `Engine`."""
        stop = np.zeros(1, np.uint8)
        with ThreadPoolExecutor(self._workers, thread_name_prefix="clunk") as pool:
            running: set[Future[Tile]] = set()
            try:
                while True:
                    while most := self._next(len(running), work, grid):
                        running.add(pool.submit(grid.run, work.take(most), stop))
                    if not running:
                        return
                    finished, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
                    for future in finished:
                        yield future.result()
            finally:
                stop[0] = 1
                for future in running:
                    future.cancel()

    def _next(self, running: int, work: Work, grid: Grid) -> int:
        """Cells of the next tile; 0 where enough tiles are handed out.

        Half of what a worker's share of the rest is, so that all workers end together. Of work that may grow,
        half of a worker's share of all, or of the most that a tile may have: there will be others.
        """
        most = grid.tile_cells
        if work.may_grow:
            most = max(1, min(most, -(-work.known // self._workers)) // 2)
        else:
            share = -(-work.size // (2 * self._workers))
            most = min(max(share, _least(work.known, grid, self._workers)), most)
        enough = self._workers * (_AHEAD_OF_WHOLE if most == grid.tile_cells else _AHEAD)
        return most if work.size and running < enough else 0

    def processors(self) -> str:
        """This machine's."""
        return cpu_model()


def tile_size(cells: int, grid: Grid, workers: int) -> int:
    """Cells of a tile: eight tiles a worker, none larger than the grid's; fewer tiles where they would be too small."""
    return min(max(-(-cells // (8 * workers)), _least(cells, grid, workers)), grid.tile_cells)


def _least(cells: int, grid: Grid, workers: int) -> int:
    """Cells of the smallest tile that is worth while; fewer only where some worker would have nothing to do."""
    return max(min(grid.tile_cells // 8, -(-cells // workers)), 1)


def available_cores() -> int:
    """How many cores this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


@functools.cache
def cpu_model() -> str:
    """What this machine's processor calls itself."""
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
