"""A dataset as a file, both ways: HDF5 laid out as netCDF-4, so that xarray, MATLAB and ncdump read it too.

Nothing of a file is believed on reading: what is missing, foreign, of another version or damaged ends in a `StoreError`
whose text is one sentence.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np
import numpy.typing as npt

from clunk.results.checksum import blocks, matches_checksum, trailer
from clunk.results.dataset import COUNTED_BY, Dataset, Variable, first_entries, has_entry
from clunk.results.files import reason, reserve, write_whole, writing
from clunk.results.machine import available_cores
from clunk.study.arrays import Array
from clunk.study.document import nearest_file
from clunk.study.errors import ClunkError

SCHEMA_VERSION = 7
_OF_HDF5 = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST")  # attributes of variables

# On the map of Figure 3.4 levels 1 to 6 differ by 1 % in size, and 6 takes three times as long.
_COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_CHUNK_BYTES = 1 << 20  # HDF5's chunk cache, so that every chunk is compressed once
_AHEAD = 1 << 26  # bytes reserved; chunks and HDF5's own structures for them are far smaller
_LONGEST_FIXED_TEXT = 1 << 14  # an HDF5 attribute in an object header ends at 64 KiB; longer text goes to the heap
_BEST_RATIO = 1100  # of deflate, which makes at most 258 bytes of two bits: 1032
_LARGE = 1 << 28  # bytes of arrays: more is assembled on the disk
_LARGE_FILE = 1 << 28  # bytes: more is read from the disk twice, for the checksum and by HDF5, and not held in memory


class StoreError(ClunkError):
    """A results file that cannot be read or written; its text is one sentence for the user."""


# --- writing


def write(path: str | os.PathLike[str], dataset: Dataset, scratch: Path | None = None) -> None:
    """Write a dataset and its checksum so that at every moment `path` is either the old file or the complete new one.

    Missing parent directories are made. What is not complete yet is in `scratch`, by default in the same directory.
    Raises ClunkError.

    The file is assembled in memory (a results file takes about 65 bytes a cell): HDF5 writing to a full disk does not
    only fail, it leaves handles that crash the interpreter when it exits. Python's own write fails cleanly. A large one
    is assembled on the disk, in room that is reserved before HDF5 writes there.
    """

    def assemble(target: BinaryIO) -> None:
        if sum(variable.values.nbytes for variable in dataset.variables.values()) > _LARGE:
            room = _Room(target)
            with Image(room, room.reserve) as file:
                _fill(file, dataset)
            target.truncate(room.end)
            checksum = trailer(blocks(target, room.end))
        else:
            image = io.BytesIO()
            with Image(image) as file:
                _fill(file, dataset)
            target.write(image.getbuffer())
            checksum = trailer([image.getbuffer()])
        target.write(checksum)

    with writing(path) as target:
        write_whole(target, assemble, scratch)


def _fill(file: Image, dataset: Dataset) -> None:
    """Write attributes, the variables, and the digest of these."""
    file.attrs["schema_version"] = np.int32(SCHEMA_VERSION)
    names = " ".join(dataset.variables)
    _set_attributes(file, {**dataset.attributes, "Conventions": "CF-1.11", "variables": names})
    digest = _Digest()
    with chunk_writer(file) as write_rows:
        for name, variable in dataset.variables.items():
            stored = _create(file, name, variable)
            digest.begin(name, stored)
            for start, stop in row_blocks(stored):
                block = dataset.rows(name, start, stop)
                write_rows(stored, start, block)
                digest.add(block)
    _set_attributes(file, {"content_digest": digest.hexdigest()})


def _create(file: Image, name: str, variable: Variable) -> h5py.Dataset:
    """Create a dimension or a variable along some, still without its values; a variable compressed where that pays."""
    # Words of variable length: xarray takes fixed-length strings for bytes, and none would be found by its name.
    # Numbers little-endian whatever the machine, so that the file does not depend on it.
    dtype = variable.values.dtype
    stored_as = h5py.string_dtype() if dtype.kind == "U" else dtype.newbyteorder("<")
    if variable.dims == (name,):
        stored = file.create_dataset(name, variable.values.shape, stored_as, track_order=True)
        _set_attributes(stored, variable.attributes)
        stored.make_scale(name)
        return stored
    shape = tuple(len(file[dim]) for dim in variable.dims)
    filters: dict[str, Any] = {}
    if dtype.itemsize * math.prod(shape) > 4096:  # a smaller one would only grow
        together = len(shape) - variable.apart
        filters = {"chunks": (*_chunks(shape[:together], dtype.itemsize), *[1] * variable.apart), **_COMPRESSION}
    stored = file.create_dataset(name, shape, stored_as, track_order=True, **filters)
    for dimension, dim in zip(stored.dims, variable.dims, strict=True):
        dimension.attach_scale(file[dim])
    _set_attributes(stored, variable.attributes)
    return stored


def _set_attributes(target: h5py.File | h5py.Dataset, attributes: Mapping[str, str | Array]) -> None:
    """Write attributes; a text is of fixed length, as netCDF's own `units` are, one of several lines of variable."""
    for name, value in attributes.items():
        raw = value.encode() if isinstance(value, str) else b""
        if not isinstance(value, str) or "\n" in value or len(raw) > _LONGEST_FIXED_TEXT:
            target.attrs[name] = value
        else:
            dtype = h5py.string_dtype("ascii" if value.isascii() else "utf-8", max(1, len(raw)))
            target.attrs.create(name, np.bytes_(raw), dtype=dtype)


class _Digest:
    """SHA-256 over each variable's name, shape, dtype and flag meanings, and its values: text, or little-endian."""

    def __init__(self) -> None:
        self._sha = hashlib.sha256()
        self.hexdigest = self._sha.hexdigest

    def begin(self, name: str, stored: h5py.Dataset) -> None:
        """Begin a variable, whose values are then added."""
        words = _attributes_of(stored).get("flag_meanings", "")
        self._sha.update(f"\n{name} {stored.shape} {stored.dtype.name} {words}\n".encode())

    def add(self, values: Array) -> None:
        """Add values, in C order."""
        if values.dtype.kind == "U":
            self._sha.update("\n".join(values.tolist()).encode())
        else:
            self._sha.update(np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"), copy=False)).data)


# --- reading


def read(path: str | os.PathLike[str]) -> Dataset:
    """Read a file whole, its bytes compared with their checksum, or its data with their digest. Raises StoreError."""
    with opened(path) as dataset:
        return Dataset(dict(dataset.variables), dataset.attributes)


def check(path: str | os.PathLike[str]) -> bool:
    """Compare a file's bytes with their checksum, if they have one, and its data with their digest.

    Returns whether it has a checksum: another program that changes the file takes it away. Raises StoreError.
    """
    with _opened(path, unread=True) as (file, has_checksum):
        _require_digest(file)
        return has_checksum


@contextmanager
def opened(path: str | os.PathLike[str], *, unread: bool = False) -> Iterator[Dataset]:
    """Open a file as a dataset, whose variables are read as they are asked for.

    Whatever is wrong with the file, also while it is open, is raised as a StoreError.

    unread : do without the memory for the whole file, and the digest of one whose bytes have no checksum
    """
    with _opened(path, unread=unread) as (file, _):
        attributes = {name: value for name, value in _attributes_of(file).items() if isinstance(value, str)}
        for name in ("Conventions", "variables"):
            del attributes[name]
        yield Dataset(_Stored(file), attributes)


class _Stored(Mapping[str, Variable]):
    """The variables of an open file, each read when it is asked for."""

    def __init__(self, file: h5py.File) -> None:
        self._file, self._names = file, _names_of(file)
        self._read: dict[str, Variable] = {}

    def __getitem__(self, name: str) -> Variable:
        if name not in self._names:
            raise KeyError(name)
        if name not in self._read:
            stored = _stored(self._file, name)
            dims = (name,) if stored.is_scale else tuple(dim[0].name.removeprefix("/") for dim in stored.dims)
            if dims[-1] in COUNTED_BY and len(dims) > 1:
                values = _unpadded(stored, self[COUNTED_BY[dims[-1]]].values)
            else:
                values = _values_of(stored)
            self._read[name] = Variable(dims, values, _attributes_of(stored))
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@contextmanager
def _opened(path: str | os.PathLike[str], *, unread: bool) -> Iterator[tuple[h5py.File, bool]]:
    """Open a file and tell whether it has a checksum, which its bytes match; parameters and errors as of `opened`.

    The bytes are read once, and HDF5 takes them from memory; those of a large file twice.
    """
    path = Path(path)
    try:
        on_disk = path.open("rb")  # Python's own errors are clearer than HDF5's
    except OSError as error:
        hint = nearest_file(path, ".h5", "results") or "."
        raise StoreError(f"{path} cannot be read: {reason(error)}{hint}") from error
    try:
        with on_disk:
            is_large = os.fstat(on_disk.fileno()).st_size > _LARGE_FILE
            source = on_disk if unread or is_large else io.BytesIO(on_disk.read())
            if source.read(8) != b"\x89HDF\r\n\x1a\n":
                hint = f"; clunk sweep {path} makes one" if path.suffix == ".toml" else ""
                raise StoreError(f"{path} is not a results file of clunk: it is not HDF5{hint}.")
            has_checksum = matches_checksum(source)  # before HDF5 sees it
            with h5py.File(source, "r") as file:
                if "schema_version" not in file.attrs:
                    raise StoreError(f"{path} is not a results file of clunk, although it is HDF5.")
                version = int(file.attrs["schema_version"])
                if version != SCHEMA_VERSION:
                    raise StoreError(
                        f"{path} has schema version {version}, and this clunk reads {SCHEMA_VERSION}: "
                        "run the sweep again."
                    )
                if not has_checksum and not unread:
                    _require_digest(file)
                yield file, has_checksum
    except (OSError, LookupError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise StoreError(f"{path} is damaged ({reason(error)}): run the sweep again.") from error


def _require_digest(file: h5py.File) -> None:
    """Raise ValueError where a file's data do not match their digest."""
    digest = _Digest()
    for name in _names_of(file):
        stored = _stored(file, name)
        digest.begin(name, stored)
        for start, stop in row_blocks(stored):
            digest.add(_values_of(stored, start, stop))
    if digest.hexdigest() != _attributes_of(file)["content_digest"]:
        raise ValueError("its data do not match its content_digest")


def _names_of(file: h5py.File) -> list[str]:
    return str(_attributes_of(file)["variables"]).split()


def _stored(file: h5py.File, name: str) -> h5py.Dataset:
    """A variable, before any of it is read. Raises ValueError where it claims more than its axes or its bytes hold."""
    stored = file[name]
    if not stored.is_scale and stored.shape != tuple(dim[0].size for dim in stored.dims):
        raise ValueError(f"the shape of {name} is not that of its axes")
    if stored.nbytes > _BEST_RATIO * (stored.id.get_storage_size() + 1):
        raise ValueError(f"{name} claims more values than its bytes can hold")
    return stored


def _attributes_of(source: h5py.File | h5py.Dataset) -> dict[str, Any]:
    """Attributes, texts of fixed and variable length alike, without HDF5's and netCDF's own."""
    return {
        name: value.decode() if isinstance(value, bytes) else value
        for name, value in source.attrs.items()
        if name not in _OF_HDF5 and not name.startswith("_")  # netCDF's own, left by its tools
    }


def _values_of(stored: h5py.Dataset, start: int = 0, stop: int | None = None) -> Array:
    """Rows of a variable as it is stored; words as text."""
    values: Array = stored[start:stop]
    return np.array([word.decode() for word in values.tolist()]) if values.dtype.kind == "O" else values


def _unpadded(stored: h5py.Dataset, counts: npt.NDArray[np.int32]) -> Array:
    """Entries of all cells in C order, read a block of rows at a time; counts : of each cell."""
    first = first_entries(counts)
    flat = np.empty(int(first[-1]), stored.dtype)
    for start, stop in row_blocks(stored):
        flat[first[start] : first[stop]] = stored[start:stop][has_entry(counts[start:stop], stored.shape[-1])]
    return flat


# --- large files


def row_blocks(variable: h5py.Dataset) -> Iterator[tuple[int, int]]:
    """Ranges of the first axis that cover whole chunks."""
    rows = variable.shape[0]
    step = variable.chunks[0] if variable.chunks else max(rows, 1)
    for start in range(0, rows, step):
        yield start, min(start + step, rows)


def _chunks(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """Shape of chunks: as many whole trailing dimensions as stay within the chunk cache."""
    room = _CHUNK_BYTES // itemsize
    chunk = []
    for count in reversed(shape):
        chunk.append(min(count, max(1, room)))
        room //= chunk[-1]
    return tuple(reversed(chunk))


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
    cores = min(available_cores(), 8)
    running: deque[tuple[h5py.Dataset, tuple[int, ...], Future[bytes]]] = deque()

    def drain(left: int) -> None:
        while len(running) > left:
            variable, place, chunk = running.popleft()
            file.reserve()
            variable.id.write_direct_chunk(place, chunk.result())

    def write(variable: h5py.Dataset, start: int, rows: Array) -> None:
        if variable.chunks is None:
            variable[start : start + len(rows)] = rows.astype(object) if rows.dtype.kind == "U" else rows
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
