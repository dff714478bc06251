"""The results file, both ways: HDF5 laid out as netCDF-4, so that xarray, MATLAB and ncdump read it too.

Nothing of a file is believed on reading: what is missing, foreign, newer or damaged ends in a `StoreError` whose text
is one sentence.
"""

from __future__ import annotations

import hashlib
import io
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from clunk.core.status import QUALITY_MEANINGS, Status
from clunk.results import CELL_FIELDS, FAILED, FAILED_CODE, IMPACT_FIELDS, ResultAxis, Results, count_labels

SCHEMA_VERSION = 1
CONVENTIONS = "CF-1.11"

# Variable -> (unit, long name).
_MEANING = {
    "sequence": ("1", "sequence of impact excursions (regime label)"),
    "severity": ("rad s-2", "severity Q: root of the summed squares of the primary impacts' severities"),
    "approach_velocity": ("rad s-1", "approach velocity V: root of the summed squares of the closing speeds"),
    "primary_impacts": ("1", "number of primary impacts"),
    "touches": ("1", "number of touches, chatter included"),
    "last_event_time": ("s", "time of the last event after the load step"),
    "status": ("1", "how the run ended"),
    "quality": ("1", "what is known about the run's sequence"),
    "initial_side": ("1", "sign of the gap coordinate on the initial flank, 0 without one"),
    "impact_time": ("s", "time of the primary impact after the load step"),
    "impact_flank": ("1", "flank of the primary impact"),
    "impact_closing_speed": ("rad s-1", "closing speed just before the primary impact"),
    "impact_severity": ("rad s-2", "severity of the primary impact: peak-to-peak acceleration until the next"),
}
# Root attributes that are fields of Results (or this module's own); all others are Results.attributes.
_OWN_ATTRIBUTES = {"title", "Conventions", "schema_version", "config", "config_digest", "content_digest"}
# On the map of Figure 3.4 levels 1 to 6 differ by 1 % in size, and 6 takes three times as long.
_COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_CHUNK_BYTES = 1 << 20  # HDF5's chunk cache, so that every chunk is compressed once
_LONGEST_FIXED_TEXT = 1 << 14  # an HDF5 attribute in an object header ends at 64 KiB; longer text goes to the heap


class StoreError(Exception):
    """A results file that cannot be read or written; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False)
class Header:
    """What a results file says about itself, without its large arrays.

    title, config, config_digest, content_digest : str
    axes : the swept parameters
    labels : code -> label
    counts : label -> number of cells, ``failed`` last
    attributes : versions, date and machine
    """

    title: str
    axes: tuple[ResultAxis, ...]
    labels: tuple[str, ...]
    counts: dict[str, int]
    config: str
    config_digest: str
    content_digest: str
    attributes: dict[str, str]


def write(path: str | os.PathLike[str], results: Results) -> None:
    """Write a results file so that at every moment `path` is either the old file or the complete new one.

    The new file is written beside `path` under a temporary name, flushed to the disk, then renamed. Missing parent
    directories are made. Raises StoreError; then, and on an interrupt, the temporary file is removed.
    """
    path = Path(os.path.realpath(path))  # through a symbolic link: replace the file, not the link
    # Assembled in memory (about 90 bytes a cell): HDF5 writing to a full disk does not only fail, it leaves handles
    # that crash the interpreter when it exits. Python's own write fails cleanly.
    image = io.BytesIO()
    with h5py.File(image, "w", track_order=True) as file:  # netCDF-4 asks for creation order
        _write(file, results)
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as target:
            target.write(image.getbuffer())
            target.flush()
            os.fsync(target.fileno())
        temporary.replace(path)
        _sync_directory(path.parent)
    except OSError as error:
        raise StoreError(f"{path} cannot be written: {_reason(error)}.") from error
    finally:
        with suppress(OSError):  # its directory may be what is missing
            temporary.unlink(missing_ok=True)


def read(path: str | os.PathLike[str]) -> Results:
    """Read a results file whole and check it against its digest. Raises StoreError."""
    with _opened(path) as file:
        header = _header(file)
        shape = tuple(len(axis.values) for axis in header.axes)
        digest = _Digest(header.axes, header.labels)
        fields: dict[str, npt.NDArray[Any]] = {}
        for name, dtype in CELL_FIELDS.items():
            fields[name] = _variable(file, name, shape, dtype)[()]
            digest.begin(name, shape, dtype)
            digest.add(fields[name])
        counts = fields["primary_impacts"]
        longest = max(1, int(counts.max()))
        if counts.min() < 0 or longest > 1 << 20:
            raise ValueError("primary_impacts is out of range")
        first = np.concatenate(([0], np.cumsum(counts.reshape(shape[0], -1).sum(axis=1, dtype=np.int64))))
        for name, dtype in IMPACT_FIELDS.items():
            variable = _variable(file, name, (*shape, longest), dtype)
            digest.begin(name, variable.shape, dtype)
            flat = np.empty(int(first[-1]), dtype)
            for start, stop in _row_blocks(variable):
                block = variable[start:stop]
                digest.add(block)
                flat[first[start] : first[stop]] = block[np.arange(longest) < counts[start:stop, ..., None]]
            fields[name] = flat
        if digest.hexdigest() != header.content_digest:
            raise ValueError("its data do not match its content_digest")
        return Results(
            title=header.title,
            axes=header.axes,
            labels=header.labels,
            config=header.config,
            config_digest=header.config_digest,
            attributes=header.attributes,
            **fields,
        )


def read_header(path: str | os.PathLike[str]) -> Header:
    """Read what `Header` holds; of the arrays only the axes and `sequence` (2 bytes a cell). Raises StoreError."""
    with _opened(path) as file:
        return _header(file)


# --- writing


def _write(file: h5py.File, results: Results) -> None:
    _set_text(file, "title", results.title)
    _set_text(file, "Conventions", CONVENTIONS)
    file.attrs["schema_version"] = np.int32(SCHEMA_VERSION)
    for name, value in results.attributes.items():
        if name in _OWN_ATTRIBUTES:
            raise ValueError(f"{name} is written from the results' own fields, not from attributes")
        _set_text(file, name, value)
    file.attrs["config"] = results.config  # variable length: it may be longer than an object header allows
    _set_text(file, "config_digest", results.config_digest)

    scales = [_write_axis(file, axis) for axis in results.axes]
    impact = _create(file, "impact", (results.max_impacts,), np.int32, ("1", "number of the primary impact"))
    impact[:] = np.arange(1, results.max_impacts + 1)
    impact.make_scale("impact")

    digest = _Digest(results.axes, results.labels)
    for name, dtype in CELL_FIELDS.items():
        variable = _create(file, name, results.shape, dtype, _MEANING[name], scales)
        _write_flags(variable, name, results.labels)
        values = np.ascontiguousarray(getattr(results, name))
        variable[...] = values
        digest.begin(name, values.shape, dtype)
        digest.add(values)
    for name, dtype in IMPACT_FIELDS.items():
        shape = (*results.shape, results.max_impacts)
        variable = _create(file, name, shape, dtype, _MEANING[name], [*scales, impact])
        _write_flags(variable, name, results.labels)
        digest.begin(name, shape, dtype)
        # Padded a block of rows at a time: padded whole, the impacts would be most of a large map's memory.
        for start, stop in _row_blocks(variable):
            block = results.padded_rows(name, start, stop)
            variable[start:stop] = block
            digest.add(block)
    _set_text(file, "content_digest", digest.hexdigest())


def _write_axis(file: h5py.File, axis: ResultAxis) -> h5py.Dataset:
    variable = _create(file, axis.variable, axis.values.shape, np.float64, (axis.unit, axis.name))
    variable[:] = axis.values
    _set_text(variable, "symbol", axis.symbol)
    _set_text(variable, "parameter", axis.parameter)
    variable.make_scale(axis.variable)
    return variable


def _write_flags(variable: h5py.Dataset, name: str, labels: tuple[str, ...]) -> None:
    """CF's flag attributes: what the integers of a variable mean."""
    if name == "sequence":
        # The failed code last: flag_meanings.split()[code] is then right for -1 too.
        flags = [*range(len(labels)), FAILED_CODE]
        meanings = [*labels, FAILED]
    elif name == "status":
        flags, meanings = [status.value for status in Status], [status.name.lower() for status in Status]
    elif name == "quality":
        flags, meanings = list(QUALITY_MEANINGS), list(QUALITY_MEANINGS.values())
    elif name == "impact_flank":
        flags, meanings = [-1, 0, 1], ["initial", "none", "opposite"]
    else:
        return
    variable.attrs["flag_masks" if name == "quality" else "flag_values"] = np.array(flags, variable.dtype)
    _set_text(variable, "flag_meanings", " ".join(meanings))


def _create(
    file: h5py.File,
    name: str,
    shape: tuple[int, ...],
    dtype: type[np.generic],
    meaning: tuple[str, str],
    scales: list[h5py.Dataset] | None = None,
) -> h5py.Dataset:
    itemsize = np.dtype(dtype).itemsize
    filters: dict[str, Any] = {}
    if scales is not None and itemsize * int(np.prod(shape)) > 4096:  # a smaller one would only grow
        filters = {"chunks": _chunks(shape, itemsize), **_COMPRESSION}
    # Little-endian whatever the machine, so that the file does not depend on it.
    variable = file.create_dataset(name, shape, np.dtype(dtype).newbyteorder("<"), track_order=True, **filters)
    for position, scale in enumerate(scales or ()):
        variable.dims[position].attach_scale(scale)
    unit, long_name = meaning
    _set_text(variable, "units", unit)
    _set_text(variable, "long_name", long_name)
    return variable


def _chunks(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """The longest run of whole trailing dimensions that stays within the chunk cache."""
    room = _CHUNK_BYTES // itemsize
    chunk = []
    for count in reversed(shape):
        chunk.append(min(count, max(1, room)))
        room //= chunk[-1]
    return tuple(reversed(chunk))


def _row_blocks(variable: h5py.Dataset) -> Iterator[tuple[int, int]]:
    """Ranges of the first axis that cover whole chunks."""
    rows = variable.shape[0]
    step = variable.chunks[0] if variable.chunks else rows
    for start in range(0, rows, step):
        yield start, min(start + step, rows)


def _set_text(target: h5py.File | h5py.Dataset, name: str, text: str) -> None:
    """A fixed-length string attribute, as netCDF's own `units` are; a long one at variable length."""
    raw = text.encode()
    if len(raw) > _LONGEST_FIXED_TEXT:
        target.attrs[name] = text
    else:
        kind = h5py.string_dtype("ascii" if text.isascii() else "utf-8", max(1, len(raw)))
        target.attrs.create(name, np.bytes_(raw), dtype=kind)


def _sync_directory(directory: Path) -> None:
    """Make the renaming itself survive a power cut, where directories can be opened for that."""
    if os.name == "posix":
        descriptor = os.open(directory, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


class _Digest:
    """SHA-256 over the axes, the labels and then each variable's name, shape, dtype and little-endian values."""

    def __init__(self, axes: tuple[ResultAxis, ...], labels: tuple[str, ...]) -> None:
        self._sha = hashlib.sha256("\n".join(labels).encode())
        for axis in axes:
            self.begin(axis.variable, axis.values.shape, np.float64)
            self.add(axis.values)

    def begin(self, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> None:
        self._sha.update(f"\n{name} {shape} {np.dtype(dtype).name}\n".encode())

    def add(self, values: npt.NDArray[Any]) -> None:
        little = values.astype(values.dtype.newbyteorder("<"), copy=False)
        self._sha.update(np.ascontiguousarray(little).data)

    def hexdigest(self) -> str:
        return self._sha.hexdigest()


# --- reading


@contextmanager
def _opened(path: str | os.PathLike[str]) -> Iterator[h5py.File]:
    """The open file; whatever is wrong with it leaves here as a StoreError."""
    path = Path(path)
    try:
        with path.open("rb") as raw:  # Python's own errors are clearer than HDF5's
            signature = raw.read(8)
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {_reason(error)}.") from error
    if signature != b"\x89HDF\r\n\x1a\n":
        raise StoreError(f"{path} is not a results file of clunk: it is not HDF5.")
    try:
        with h5py.File(path, "r") as file:
            if "schema_version" not in file.attrs or "sequence" not in file:
                raise StoreError(f"{path} is not a results file of clunk, although it is HDF5.")
            version = int(file.attrs["schema_version"])
            if version > SCHEMA_VERSION:
                raise StoreError(
                    f"{path} has schema version {version} and this clunk reads up to {SCHEMA_VERSION}: "
                    "a newer clunk is needed to read it."
                )
            yield file
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise StoreError(f"{path} is damaged ({_reason(error)}): run the sweep again.") from error


def _header(file: h5py.File) -> Header:
    sequence = file["sequence"]
    axes = tuple(_read_axis(dimension[0]) for dimension in sequence.dims)
    labels = _labels(sequence)
    codes = _variable(file, "sequence", tuple(len(axis.values) for axis in axes), np.int16)[()]
    if codes.min() < FAILED_CODE or codes.max() >= len(labels):
        raise ValueError("sequence holds a code without a label")
    return Header(
        title=_text(file, "title"),
        axes=axes,
        labels=labels,
        counts=count_labels(labels, codes),
        config=_text(file, "config"),
        config_digest=_text(file, "config_digest"),
        content_digest=_text(file, "content_digest"),
        # Names that begin with _ are netCDF's own, left by its tools.
        attributes={
            name: _text(file, name) for name in file.attrs if name not in _OWN_ATTRIBUTES and not name.startswith("_")
        },
    )


def _read_axis(scale: h5py.Dataset) -> ResultAxis:
    return ResultAxis(
        parameter=_text(scale, "parameter"),
        values=np.asarray(scale[()], np.float64),
        name=_text(scale, "long_name"),
        symbol=_text(scale, "symbol"),
        unit=_text(scale, "units"),
    )


def _labels(sequence: h5py.Dataset) -> tuple[str, ...]:
    meaning = dict(zip(sequence.attrs["flag_values"].tolist(), _text(sequence, "flag_meanings").split(), strict=True))
    return tuple(meaning[code] for code in range(len(meaning) - 1))


def _variable(file: h5py.File, name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> h5py.Dataset:
    variable = file[name]
    if variable.shape != shape or variable.dtype != dtype:
        raise ValueError(f"{name} is {variable.dtype} {variable.shape} instead of {np.dtype(dtype)} {shape}")
    return variable


def _text(source: h5py.File | h5py.Dataset, name: str) -> str:
    value = source.attrs[name]
    return value.decode() if isinstance(value, bytes) else str(value)


def _reason(error: BaseException) -> str:
    """An error's own words as one phrase."""
    if isinstance(error, OSError) and error.strerror:
        words = error.strerror
    else:
        words = str(error.args[0]) if error.args else type(error).__name__
    words = " ".join(words.split()).rstrip(".")
    return words[:1].lower() + words[1:]
