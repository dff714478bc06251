"""Engines: who runs the cells of a sweep. This one is the threads of this process, `clunk.distributed` has another.

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

from clunk.cells import Grid
from clunk.tiles import Tile

Cells = npt.NDArray[np.int64]

_AHEAD = 8  # tiles handed to each worker: they go on while a part is written to the disk, 0.3 s


class EngineError(Exception):
    """An engine that cannot start or go on; its text is one sentence for the user."""


class Engine(Protocol):
    """Runs cells of a grid."""

    def run(self, grid: Grid, cells: Cells) -> Generator[Tile, None, None]:
        """Finished tiles in the order in which they finish. Leaving the generator early abandons the running cells.

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

    def run(self, grid: Grid, cells: Cells) -> Generator[Tile, None, None]:
        """See `Engine`."""
        stop = np.zeros(1, np.uint8)
        size = tile_size(cells.size, grid, self._workers)
        cells = grid.ordered(cells)
        waiting = (cells[start : start + size] for start in range(0, cells.size, size))
        with ThreadPoolExecutor(self._workers, thread_name_prefix="clunk") as pool:
            running: set[Future[Tile]] = set()
            try:
                while True:
                    while len(running) < _AHEAD * self._workers and (part := next(waiting, None)) is not None:
                        running.add(pool.submit(grid.run, part, stop))
                    if not running:
                        return
                    finished, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
                    for future in finished:
                        yield future.result()
            finally:
                stop[0] = 1
                for future in running:
                    future.cancel()

    def processors(self) -> str:
        """This machine's."""
        return cpu_model()


def tile_size(cells: int, grid: Grid, workers: int) -> int:
    """Cells of a tile: eight tiles a worker, none larger than the grid's; fewer tiles where they would be too small."""
    least = min(grid.tile_cells // 8, -(-cells // workers))
    return min(max(-(-cells // (8 * workers)), least, 1), grid.tile_cells)


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
