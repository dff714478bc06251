"""Arrays of results: in memory, or, where they are large, mapped to files that the system writes as it needs memory."""

from __future__ import annotations

import math
import mmap
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
import numpy.typing as npt

from clunk.results.files import reason, reserve
from clunk.results.machine import available_memory
from clunk.study.arrays import Array
from clunk.study.errors import ClunkError
from clunk.sweeping.reduction import SweepError

_BLOCK = 1 << 28  # bytes
_BYTES_PER_CELL = 400  # the most that a cell's results, their assembly and writing take
_BYTES_IN_MEMORY = 50  # of them, those that have to be in memory where the results are assembled on the disk
_LARGE_SHARE = 0.25  # of the memory


class Scratch:
    """Maker of arrays, in memory or mapped to temporary files.

    directory : of the files, which have no name where the system allows that, and end with the arrays; None for memory

    Its methods raise ClunkError where the disk has no room.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self._directory = directory
        self._free = np.zeros(0, np.uint8)

    def empty(self, count: int, dtype: npt.DTypeLike) -> Array:
        """Uninitialised array, in memory or mapped to a temporary file."""
        if self._directory is None:
            return np.empty(count, dtype)
        return self._mapped(count * np.dtype(dtype).itemsize).view(dtype)[:count]

    def keep(self, array: Array) -> Array:
        """The array itself, or a copy of it that is mapped to a temporary file."""
        if self._directory is None:
            return array
        if array.nbytes > self._free.size:
            self._free = self._mapped(max(array.nbytes, _BLOCK))
        copy = self._free[: array.nbytes].view(array.dtype)
        self._free = self._free[-(-array.nbytes // 64) * 64 :]
        copy[:] = array
        return copy

    def _mapped(self, size: int) -> npt.NDArray[np.uint8]:
        size = -(-max(size, 1) // mmap.PAGESIZE) * mmap.PAGESIZE
        try:
            with TemporaryFile(dir=self._directory, prefix=".scratch-", suffix=".tmp") as file:
                reserve(file, size)  # else a full disk would be a bus error
                return np.frombuffer(mmap.mmap(file.fileno(), size), np.uint8)
        except OSError as error:
            raise ClunkError(
                f"{self._directory} has no room for the results ({reason(error)}); "
                "the same command goes on from what is there."
            ) from error


def scratch_for(cells: int, directory: Path | None) -> Scratch:
    """Scratch for the results of so many cells: in the directory, if any, where they are a large share of memory."""
    return Scratch(directory if cells * _BYTES_PER_CELL > _LARGE_SHARE * available_memory() else None)


def refuse_if_too_large(shape: Sequence[int], directory: Path | None) -> None:
    """Raise SweepError where results of this shape do not fit in memory, or beside it in a directory."""
    cells, memory = math.prod(shape), available_memory()
    needed = cells * (_BYTES_PER_CELL if directory is None else _BYTES_IN_MEMORY)
    if needed > 0.8 * memory:
        raise SweepError(
            f"The grid of {' x '.join(str(count) for count in shape)} = {cells:,} cells does not fit in memory: it "
            f"takes about {needed / 2**30:.0f} GiB, and there are {memory / 2**30:.0f} GiB."
        )
