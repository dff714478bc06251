"""The results file, both ways: HDF5 laid out as netCDF-4, so that xarray, MATLAB and ncdump read it too.

Nothing of a file is believed on reading: what is missing, foreign, newer or damaged ends in a `StoreError` whose text
is one sentence.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from clunk.results.checksum import verify
from clunk.results.files import reason
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import count_labels
from clunk.results.netcdf import (
    CONVENTIONS,
    ChunkWriter,
    Image,
    create_scale,
    create_variable,
    get_text,
    image_of,
    set_flags,
    set_text,
    write_file,
)
from clunk.results.quantities import CELL_QUANTITIES, IMPACT_QUANTITIES, Quantity
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.axes import RUN, ResultAxis
from clunk.study.errors import ClunkError

SCHEMA_VERSION = 2  # of a regime map
NEWEST_VERSION = 3  # of any file that is read: tolerance maps have it, which came with it

# Root attributes that are fields of Results (or this module's own); all others are Results.attributes.
_OWN_ATTRIBUTES = {"title", "Conventions", "schema_version", "kind", "config", "config_digest", "content_digest"}
TOLERANCE_MAP = "tolerance map"  # the attribute `kind` of one; a regime map has none


_LARGE = 1 << 22  # cells, about 270 MB: more is assembled on the disk


class StoreError(ClunkError):
    """A results file that cannot be read or written; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False)
class Header:
    """What a results file says about itself, without its large arrays.

    title, config, config_digest, content_digest : str
    axes, coordinates : the swept parameters, as those of `Results`
    labels : code -> label
    counts : label -> number of cells, ``failed`` last; of a tolerance map, cells in which it is the most likely one
    attributes : versions, date and machine
    tolerance_map : whether it is one, which `clunk.results.tolerancefile` reads
    """

    title: str
    axes: tuple[ResultAxis, ...]
    labels: tuple[str, ...]
    counts: dict[str, int]
    config: str
    config_digest: str
    content_digest: str
    attributes: dict[str, str]
    coordinates: tuple[ResultAxis, ...] = ()
    tolerance_map: bool = False


def write(path: str | os.PathLike[str], results: Results, scratch: Path | None = None) -> None:
    """Write a results file so that at every moment `path` is either the old file or the complete new one.

    Missing parent directories are made. What is not complete yet is in `scratch`, by default in the same directory.
    Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> clunk.write_results("results/copy.h5", results)
    """
    write_filled(path, lambda file: _write(file, results), scratch, large=results.sequence.size > _LARGE)


def write_filled(
    path: str | os.PathLike[str], fill: Callable[[Image], None], scratch: Path | None = None, *, large: bool = False
) -> None:
    """Write the results file that `fill` fills, as `write` does. Raises StoreError."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, fill, scratch, large=large)
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {reason(error)}.") from error


def to_image(results: Results) -> io.BytesIO:
    """A results file in memory."""
    return image_of(lambda file: _write(file, results))


def read(path: str | os.PathLike[str]) -> Results:
    """Read a results file whole and check it against its checksum and digest. Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"), "results/smoke.h5")
    >>> clunk.read_results("results/smoke.h5").label_map[10, 6]
    np.str_('DS(1)SS(1)')
    """
    with opened(path) as file:
        header = header_of(file)
        if header.tolerance_map:
            raise StoreError(
                f"{path} holds a tolerance map, where a regime map is needed: sweep without [[sweep.tolerances]]."
            )
        shape = tuple(len(axis.values) for axis in header.axes)
        digest = Digest(header.axes + header.coordinates, header.labels)
        fields: dict[str, npt.NDArray[Any]] = {}
        for name, quantity in CELL_QUANTITIES.items():
            dtype = quantity.dtype
            if int(file.attrs["schema_version"]) < quantity.since:
                fields[name] = np.full(shape, np.nan, dtype)
                continue
            fields[name] = variable_of(file, name, shape, dtype)[()]
            digest.begin(name, shape, dtype)
            digest.add(fields[name])
        counts = fields["primary_impacts"]
        longest = max(1, int(counts.max()))
        if counts.min() < 0 or longest > 1 << 20:
            raise ValueError("primary_impacts is out of range")
        first = np.concatenate(([0], np.cumsum(counts.reshape(shape[0], -1).sum(axis=1, dtype=np.int64))))
        for name, quantity in IMPACT_QUANTITIES.items():
            dtype = quantity.dtype
            variable = variable_of(file, name, (*shape, longest), dtype)
            digest.begin(name, variable.shape, dtype)
            flat = np.empty(int(first[-1]), dtype)
            for start, stop in row_blocks(variable):
                block = variable[start:stop]
                digest.add(block)
                flat[first[start] : first[stop]] = block[np.arange(longest) < counts[start:stop, ..., None]]
            fields[name] = flat
        if digest.hexdigest() != header.content_digest:
            raise ValueError("its data do not match its content_digest")
        return Results(
            title=header.title,
            axes=header.axes,
            coordinates=header.coordinates,
            labels=header.labels,
            config=header.config,
            config_digest=header.config_digest,
            attributes=header.attributes,
            **fields,
        )


def read_header(path: str | os.PathLike[str]) -> Header:
    """Read what `Header` holds; of the arrays only the axes and `sequence` (2 bytes a cell). Raises StoreError."""
    with opened(path) as file:
        return header_of(file)


def check(path: str | os.PathLike[str]) -> bool:
    """Check a results file: its data against their digest, and its bytes against their checksum.

    Returns whether the bytes have a checksum: another program that changes the file takes it away. Raises StoreError.
    """
    read(path)
    return verify(path)


# --- writing


def _write(file: Image, results: Results) -> None:
    scales = write_head(file, results, SCHEMA_VERSION)
    numbers = np.arange(1, results.max_impacts + 1, dtype=np.int32)
    impact = create_scale(file, "impact", numbers, ("1", "number of the primary impact"))

    digest = Digest(results.axes + results.coordinates, results.labels)
    with ChunkWriter(file) as chunks:
        for name, quantity in CELL_QUANTITIES.items():
            dtype = quantity.dtype
            variable = create_variable(file, name, results.shape, dtype, (quantity.unit, quantity.long_name), scales)
            describe(variable, quantity, results)
            values = np.ascontiguousarray(getattr(results, name))
            digest.begin(name, results.shape, dtype)
            for start, stop in row_blocks(variable):
                chunks.write(variable, start, values[start:stop])
            digest.add(values)
        for name, quantity in IMPACT_QUANTITIES.items():
            dtype = quantity.dtype
            shape = (*results.shape, results.max_impacts)
            meaning = (quantity.unit, quantity.long_name)
            variable = create_variable(file, name, shape, dtype, meaning, [*scales, impact], apart=1)
            describe(variable, quantity, results)
            digest.begin(name, shape, dtype)
            # Padded a block of rows at a time: padded whole, the impacts would be most of a large map's memory.
            for start, stop in row_blocks(variable):
                block = results.rows(name, start, stop)
                chunks.write(variable, start, block)
                digest.add(block)
    set_text(file, "content_digest", digest.hexdigest())


def write_head(file: h5py.File, results: Results | ToleranceMap, version: int) -> list[h5py.Dataset]:
    """Write the root attributes and the axes; returns the axes' scales."""
    set_text(file, "title", results.title)
    set_text(file, "Conventions", CONVENTIONS)
    file.attrs["schema_version"] = np.int32(version)
    for name, value in results.attributes.items():
        if name in _OWN_ATTRIBUTES:
            raise ValueError(f"{name} is written from the results' own fields, not from attributes")
        set_text(file, name, value)
    file.attrs["config"] = results.config  # variable length: it may be longer than an object header allows
    set_text(file, "config_digest", results.config_digest)
    scales = [_write_axis(file, axis) for axis in results.axes]
    run = [scale for axis, scale in zip(results.axes, scales, strict=True) if axis.parameter == RUN]
    for axis in results.coordinates:
        write_coordinate(file, axis.variable, axis, run)
    return scales


def describe(variable: h5py.Dataset, quantity: Quantity, results: Results | ToleranceMap) -> None:
    """Name a variable's coordinates besides its dimensions, and the meanings of its codes or bits."""
    along_run = " ".join(axis.variable for axis in results.coordinates)
    if along_run:
        set_text(variable, "coordinates", along_run)
    meanings = quantity.meanings(results.labels)
    if meanings:
        set_flags(variable, meanings, masks=quantity.coded == "quality")


def _write_axis(file: h5py.File, axis: ResultAxis) -> h5py.Dataset:
    texts = {"symbol": axis.symbol, "parameter": axis.parameter}
    return create_scale(file, axis.variable, axis.values, (axis.unit, axis.name), texts)


def write_coordinate(file: h5py.File, name: str, axis: ResultAxis, scales: list[h5py.Dataset]) -> None:
    """Write a parameter's values along a dimension that has another one's name."""
    variable = create_variable(file, name, axis.values.shape, np.float64, (axis.unit, axis.name), scales)
    variable[:] = axis.values
    for key, text in (("symbol", axis.symbol), ("parameter", axis.parameter)):
        set_text(variable, key, text)


def row_blocks(variable: h5py.Dataset) -> Iterator[tuple[int, int]]:
    """Ranges of the first axis that cover whole chunks."""
    rows = variable.shape[0]
    step = variable.chunks[0] if variable.chunks else rows
    for start in range(0, rows, step):
        yield start, min(start + step, rows)


class Digest:
    """SHA-256 over the axes, the labels and then each variable's name, shape, dtype and little-endian values.

    A thread of its own computes it, while the next values are made ready; those added must not be changed any more.
    """

    def __init__(self, axes: tuple[ResultAxis, ...], labels: tuple[str, ...]) -> None:
        self._sha = hashlib.sha256("\n".join(labels).encode())
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="clunk-sha256")
        self._running: Future[None] | None = None
        for axis in axes:
            self.begin(axis.variable, axis.values.shape, np.float64)
            self.add(axis.values)

    def begin(self, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> None:
        """Begin a variable, whose values are then added."""
        self._update(f"\n{name} {shape} {np.dtype(dtype).name}\n".encode())

    def add(self, values: npt.NDArray[Any]) -> None:
        """Add values, in C order."""
        little = values.astype(values.dtype.newbyteorder("<"), copy=False)
        self._update(np.ascontiguousarray(little).data)

    def hexdigest(self) -> str:
        """The digest of all that was added."""
        self._thread.shutdown()
        return self._sha.hexdigest()

    def _update(self, raw: bytes | memoryview) -> None:
        if self._running is not None:
            self._running.result()
        self._running = self._thread.submit(self._sha.update, raw)


# --- reading


@contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[h5py.File]:
    """The open file; whatever is wrong with it leaves here as a StoreError."""
    path = Path(path)
    try:
        with path.open("rb") as raw:  # Python's own errors are clearer than HDF5's
            signature = raw.read(8)
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {reason(error)}.") from error
    if signature != b"\x89HDF\r\n\x1a\n":
        raise StoreError(f"{path} is not a results file of clunk: it is not HDF5.")
    try:
        verify(path)  # before HDF5 sees it
        with h5py.File(path, "r") as file:
            if "schema_version" not in file.attrs or "sequence" not in file:
                raise StoreError(f"{path} is not a results file of clunk, although it is HDF5.")
            version = int(file.attrs["schema_version"])
            if version > NEWEST_VERSION:
                raise StoreError(
                    f"{path} has schema version {version} and this clunk reads up to {NEWEST_VERSION}: "
                    "a newer clunk is needed to read it."
                )
            yield file
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise StoreError(f"{path} is damaged ({reason(error)}): run the sweep again.") from error


def header_of(file: h5py.File) -> Header:
    """The header of an open file."""
    sequence = file["sequence"]
    axes = tuple(read_axis(dimension[0]) for dimension in sequence.dims)
    coordinates = (
        tuple(read_axis(file[name]) for name in get_text(sequence, "coordinates").split())
        if ("coordinates" in sequence.attrs)
        else ()
    )
    labels = _labels(sequence)
    codes = variable_of(file, "sequence", tuple(len(axis.values) for axis in axes), np.int16)[()]
    if codes.min() < FAILED_CODE or codes.max() >= len(labels):
        raise ValueError("sequence holds a code without a label")
    return Header(
        title=get_text(file, "title"),
        axes=axes,
        coordinates=coordinates,
        labels=labels,
        counts=count_labels(labels, codes),
        config=get_text(file, "config"),
        config_digest=get_text(file, "config_digest"),
        content_digest=get_text(file, "content_digest"),
        tolerance_map="kind" in file.attrs and get_text(file, "kind") == TOLERANCE_MAP,
        # Names that begin with _ are netCDF's own, left by its tools.
        attributes={
            name: get_text(file, name)
            for name in file.attrs
            if name not in _OWN_ATTRIBUTES and not name.startswith("_")
        },
    )


def read_axis(scale: h5py.Dataset) -> ResultAxis:
    """A parameter's values with their meaning."""
    return ResultAxis(
        parameter=get_text(scale, "parameter"),
        values=np.asarray(scale[()], np.float64),
        name=get_text(scale, "long_name"),
        symbol=get_text(scale, "symbol"),
        unit=get_text(scale, "units"),
    )


def _labels(sequence: h5py.Dataset) -> tuple[str, ...]:
    meaning = dict(
        zip(sequence.attrs["flag_values"].tolist(), get_text(sequence, "flag_meanings").split(), strict=True)
    )
    return tuple(meaning[code] for code in range(len(meaning) - 1))


def variable_of(file: h5py.File, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> h5py.Dataset:
    """A variable of this shape and dtype; ValueError where it has others."""
    variable = file[name]
    if variable.shape != shape or variable.dtype != dtype:
        raise ValueError(f"{name} is {variable.dtype} {variable.shape} instead of {np.dtype(dtype)} {shape}")
    return variable
