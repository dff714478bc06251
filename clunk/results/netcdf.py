"""HDF5 laid out as netCDF-4: dimension scales, units and meanings, for xarray, MATLAB and ncdump to find."""

from __future__ import annotations

import io
import math
import os
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
import numpy.typing as npt

from clunk.results.checksum import blocks, trailer
from clunk.results.files import reserve, write_whole
from clunk.study.arrays import Array

CONVENTIONS = "CF-1.11"

# On the map of Figure 3.4 levels 1 to 6 differ by 1 % in size, and 6 takes three times as long.
_COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_CHUNK_BYTES = 1 << 20  # HDF5's chunk cache, so that every chunk is compressed once
_AHEAD = 1 << 26  # bytes reserved; chunks and HDF5's own structures for them are far smaller
_LONGEST_FIXED_TEXT = 1 << 14  # an HDF5 attribute in an object header ends at 64 KiB; longer text goes to the heap


def write_file(
    path: str | os.PathLike[str], fill: Callable[[Image], None], scratch: Path | None = None, *, large: bool = False
) -> None:
    """Write the file that `fill` fills and its checksum, whole or not at all; see `write_whole`. Raises OSError.

    It is assembled in memory (a results file takes about 65 bytes a cell): HDF5 writing to a full disk does not only
    fail, it leaves handles that crash the interpreter when it exits. Python's own write fails cleanly. A large one is
    assembled on the disk, in room that is reserved before HDF5 writes there.
    """

    def write(target: BinaryIO) -> None:
        if large:
            room = _Room(target)
            with Image(room, room.reserve) as file:
                fill(file)
            target.truncate(room.end)
            checksum = trailer(blocks(target, room.end))
        else:
            image = image_of(fill).getbuffer()
            target.write(image)
            checksum = trailer([image])
        target.write(checksum)

    write_whole(path, write, scratch)


def image_of(fill: Callable[[Image], None]) -> io.BytesIO:
    """Write the file that `fill` fills in memory."""
    image = io.BytesIO()
    with Image(image) as file:
        fill(file)
    return image


class Image(h5py.File):  # type: ignore[misc]  # h5py has no type information
    """HDF5 file that is being filled; reserve : to be called before each chunk, sees to room on the disk."""

    def __init__(self, target: io.BytesIO | _Room, reserve: Callable[[], None] = lambda: None) -> None:
        reserve()
        self.reserve = reserve
        super().__init__(target, "w", track_order=True)  # netCDF-4 asks for creation order


class _Room:
    """File with room reserved on the disk behind its end, which HDF5 does not see."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._reserved = 0
        self.end = 0

    def reserve(self) -> None:
        if self.end + _AHEAD // 2 > self._reserved:
            self._reserved = self.end + _AHEAD
            reserve(self._file, self._reserved)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._file.seek(self.end + offset) if whence == os.SEEK_END else self._file.seek(offset, whence)

    def write(self, data: bytes | memoryview) -> int:
        written = self._file.write(data)
        self.end = max(self.end, self._file.tell())
        return written

    def truncate(self, size: int) -> int:
        self.end = size
        return size


@contextmanager
def chunk_writer(file: Image) -> Iterator[Callable[[h5py.Dataset, int, Array], None]]:
    """Make a function that writes rows, compressing chunks on every core; all are written when the context is left.

    ``write(variable, start, rows)`` writes from row `start`; where the variable is chunked, `start` and the end are
    between chunks. HDF5 compresses on one thread; zlib lets go of the interpreter lock.
    """
    cores = min(os.cpu_count() or 1, 8)
    running: deque[tuple[h5py.Dataset, tuple[int, ...], Future[bytes]]] = deque()

    def drain(left: int) -> None:
        while len(running) > left:
            variable, place, chunk = running.popleft()
            file.reserve()
            variable.id.write_direct_chunk(place, chunk.result())

    def write(variable: h5py.Dataset, start: int, rows: Array) -> None:
        if variable.chunks is None:
            variable[start : start + len(rows)] = rows
            return
        rows = rows.astype(variable.dtype, copy=False)
        for offset in product(*(range(0, n, step) for n, step in zip(rows.shape, variable.chunks, strict=True))):
            part = rows[tuple(slice(at, at + step) for at, step in zip(offset, variable.chunks, strict=True))]
            chunk = pool.submit(_deflated, part, variable.chunks)
            running.append((variable, (start + offset[0], *offset[1:]), chunk))
            drain(4 * cores)

    pool = ThreadPoolExecutor(cores, thread_name_prefix="clunk-zlib")
    try:
        yield write
        drain(0)
    finally:
        pool.shutdown(cancel_futures=True)


def _deflated(part: Array, shape: tuple[int, ...]) -> bytes:
    """Shuffle and deflate a chunk as HDF5's filters do; one over the edge is filled up with zeros.

    Run-length coding takes 60 % of the time of zlib's search at level 1, and up to 25 % more bytes: shuffled, the high
    bytes of neighbouring numbers are runs, and the low ones are noise.
    """
    if part.shape != shape:
        part = np.pad(part, [(0, full - count) for full, count in zip(shape, part.shape, strict=True)])
    planes = np.ascontiguousarray(part).view(np.uint8).reshape(-1, part.itemsize).T
    deflate = zlib.compressobj(1, zlib.DEFLATED, strategy=zlib.Z_RLE)
    return deflate.compress(np.ascontiguousarray(planes).data) + deflate.flush()


def create_scale(file: h5py.File, name: str, values: Array, attributes: Mapping[str, str]) -> h5py.Dataset:
    """Write a dimension with its coordinates, numbers or words, and their attributes, such as ``units``."""
    if values.dtype.kind == "U":
        # Of variable length: xarray takes fixed-length strings for bytes, and none would be found by its name.
        scale = file.create_dataset(name, data=values.astype(object), dtype=h5py.string_dtype(), track_order=True)
    else:
        scale = file.create_dataset(name, data=values.astype(values.dtype.newbyteorder("<")), track_order=True)
    for key, text in attributes.items():
        set_text(scale, key, text)
    scale.make_scale(name)
    return scale


def create_variable(
    file: h5py.File,
    name: str,
    dtype: npt.DTypeLike,
    attributes: Mapping[str, str],
    scales: Sequence[h5py.Dataset],
    apart: int = 0,
) -> h5py.Dataset:
    """Create a variable along some dimensions, still without its values, compressed where that pays.

    apart : how many dimensions, the last, are not mixed in a chunk: the first impacts of neighbouring cells are more
        alike than a cell's first and second, and whoever reads the first ones need not read the others
    """
    # Little-endian whatever the machine, so that the file does not depend on it.
    stored = np.dtype(dtype).newbyteorder("<")
    shape = tuple(len(scale) for scale in scales)
    filters: dict[str, Any] = {}
    if stored.itemsize * math.prod(shape) > 4096:  # a smaller one would only grow
        together = len(shape) - apart
        filters = {"chunks": (*_chunks(shape[:together], stored.itemsize), *[1] * apart), **_COMPRESSION}
    variable = file.create_dataset(name, shape, stored, track_order=True, **filters)
    for dimension, scale in zip(variable.dims, scales, strict=True):
        dimension.attach_scale(scale)
    for key, text in attributes.items():
        set_text(variable, key, text)
    return variable


def row_blocks(variable: h5py.Dataset) -> Iterator[tuple[int, int]]:
    """Ranges of the first axis that cover whole chunks."""
    rows = variable.shape[0]
    step = variable.chunks[0] if variable.chunks else rows
    for start in range(0, rows, step):
        yield start, min(start + step, rows)


def set_flags(variable: h5py.Dataset, meanings: Mapping[int, str], *, masks: bool = False) -> None:
    """Write CF's flag attributes, the meanings of a variable's integers or, with `masks`, of their bits, if any."""
    if not meanings:
        return
    variable.attrs["flag_masks" if masks else "flag_values"] = np.array(list(meanings), variable.dtype)
    set_text(variable, "flag_meanings", " ".join(meanings.values()))


def set_text(target: h5py.File | h5py.Dataset, name: str, text: str) -> None:
    """Write a string attribute of fixed length, as netCDF's own `units` are; a long one of variable length."""
    raw = text.encode()
    if len(raw) > _LONGEST_FIXED_TEXT:
        target.attrs[name] = text
    else:
        dtype = h5py.string_dtype("ascii" if text.isascii() else "utf-8", max(1, len(raw)))
        target.attrs.create(name, np.bytes_(raw), dtype=dtype)


def get_text(source: h5py.File | h5py.Dataset, name: str) -> str:
    """Read a string attribute, of fixed or variable length."""
    value = source.attrs[name]
    return value.decode() if isinstance(value, bytes) else str(value)


def _chunks(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Shape of chunks: as many whole trailing dimensions as stay within the chunk cache."""
    room = _CHUNK_BYTES // itemsize
    chunk = []
    for count in reversed(shape):
        chunk.append(min(count, max(1, room)))
        room //= chunk[-1]
    return tuple(reversed(chunk))
