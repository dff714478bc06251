"""Arrays larger than a machine's memory should hold: in files that the system writes out as it needs memory."""

from __future__ import annotations

import mmap
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.results.files import reason, reserve
from clunk.study.errors import ClunkError

_BLOCK = 1 << 28  # bytes


class ScratchError(ClunkError):
    """A disk without room for the arrays; its text is one sentence for the user."""


class Scratch:
    """Where arrays are made.

    directory : for files, without a name where the system allows that, that go with the arrays; None for memory

    Its methods raise ScratchError where the disk has no room.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self._directory = directory
        self._free = np.zeros(0, np.uint8)

    def empty(self, count: int, dtype: npt.DTypeLike) -> npt.NDArray[Any]:
        """An array of whatever."""
        if self._directory is None:
            return np.empty(count, dtype)
        return self._mapped(count * np.dtype(dtype).itemsize).view(dtype)[:count]

    def keep(self, array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """An array, or where memory is short a copy of it."""
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
            raise ScratchError(
                f"{self._directory} has no room for the results ({reason(error)}); "
                "the same command goes on from what is there."
            ) from error
