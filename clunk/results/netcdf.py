"""Named arrays over named dimensions, and their files: HDF5 laid out as netCDF-4, which xarray, MATLAB and ncdump read.

This module knows nothing of quantities.

A file that is missing, foreign, of another version or not as it was written ends in a `StoreError` whose text is one
sentence.

A checksum of the file's bytes follows the end of the HDF5 data, and is compared before the HDF5 library reads the file:
the library does not return from every damaged file, since a changed bit can make it loop for ever. The library ignores
bytes behind the end that the superblock gives, and truncates the file there when it changes it: a file that another
program has changed has no checksum any more.
"""

import hashlib
import io
import math
import zlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from clunk.results.files import reason, write_whole, writing
from clunk.study.arrays import Array
from clunk.study.document import FilePath, nearest_file
from clunk.study.errors import ClunkError

# Last dimension of a variable -> the variable with the number of entries that each cell has along it.
COUNTED_BY = {"impact": "primary_impacts"}

SCHEMA_VERSION = 8
_OF_FILE = ("schema_version", "Conventions", "variables", "content_digest")  # attributes; all others are the dataset's
_OF_HDF5 = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST")  # attributes of variables that HDF5 itself sets

_MARK = b"clunk-sha256:"
_LENGTH = len(_MARK) + 64 + 1  # `head -c -78 FILE | sha256sum` gives the same digits

_SLAB = 2**17  # padded values in memory at a time: 1 MB of float64, or one row of cells
_CHUNK = 2**13  # least number of padded values that are worth compressing together
_LEVEL = 1  # of gzip: levels 1 to 6 differ by 1 % in size of Figure 3.4's map, and 6 takes three times as long
_SMALL = 4096  # bytes; a variable no larger than this would grow by compression
_LONGEST_FIXED_TEXT = 1 << 14  # an HDF5 attribute in an object header ends at 64 KiB; longer text goes to the heap


class Variable(NamedTuple):
    """An array over named dimensions.

    dims : names of the dimensions; a variable named after its only dimension is the dimension's coordinate
    values : in the shape of the dimensions; where the last one is in `COUNTED_BY`, a flat array of the entries of all
        cells in C order
    attributes : texts, numbers and arrays by name; `units` and `long_name` are among them
    """

    dims: tuple[str, ...]
    values: Array
    attributes: Mapping[str, str | Array]


class Dataset(NamedTuple):
    """Variables by name, coordinates before the variables along them, and attributes of the whole dataset."""

    variables: Mapping[str, Variable]
    attributes: Mapping[str, str]

    def padded(self, name: str) -> Array:
        """Values of a variable in the shape of its dimensions; behind the last entry of a cell NaN (floats) or 0."""
        values = self.variables[name].values
        return values if values.ndim == len(self.variables[name].dims) else _padded(values, *self.places(name))

    def places(self, name: str) -> tuple[Array, int]:
        """Number of entries of a variable in each cell, and number of places of each cell in the padded array.

        A variable without a dimension in `COUNTED_BY` has one entry and one place for each of its values.
        """
        values, dims = self.variables[name].values, self.variables[name].dims
        if values.ndim == len(dims):
            return np.ones(values.shape, np.int8), 1
        return self.variables[COUNTED_BY[dims[-1]]].values, self.variables[dims[-1]].values.size


def _padded(entries: Array, counts: Array, places: int) -> Array:
    """Flat entries of cells spread over `places` places for each cell; free places have NaN (floats) or 0.

    entries : (N,), of all cells in C order
    counts : number of entries of each cell; the result has its shape + (places,)
    """
    is_entry = np.arange(places) < counts[..., None]
    padded = np.full(is_entry.shape, np.nan if entries.dtype.kind == "f" else 0, entries.dtype)
    padded[is_entry] = entries
    return padded


def flags(meanings: Mapping[int, str], dtype: npt.DTypeLike, *, masks: bool = False) -> dict[str, str | Array]:
    """CF's attributes for the meanings of a variable's integers or, with `masks`, bits; empty without meanings."""
    if not meanings:
        return {}
    words = " ".join(meanings.values())
    return {"flag_masks" if masks else "flag_values": np.array(list(meanings), dtype), "flag_meanings": words}


def meanings_of(variable: Variable) -> dict[int, str]:
    """Word of each of a variable's integers, by its CF attributes. Raises KeyError, ValueError without these."""
    codes, words = np.asarray(variable.attributes["flag_values"]), str(variable.attributes["flag_meanings"]).split()
    return dict(zip(codes.tolist(), words, strict=True))


class StoreError(ClunkError):
    """A results file that cannot be read or written; its text is one sentence for the user."""


def content_digest(dataset: Dataset) -> str:
    """SHA-256 over each variable's name, dimensions, shape, dtype, flag meanings and values (texts or numbers)."""
    sha = hashlib.sha256()
    for name, variable in dataset.variables.items():
        values, words = variable.values, variable.attributes.get("flag_meanings", "")
        is_text = values.dtype.kind == "U"
        described = f"{name} {variable.dims} {values.shape} {'text' if is_text else values.dtype.name} {words}"
        sha.update(f"\n{described}\n".encode())
        sha.update("\n".join(values.tolist()).encode() if is_text else np.ascontiguousarray(values).data)
    return sha.hexdigest()


# --- writing


def write(path: FilePath, dataset: Dataset, scratch: Path | None = None) -> None:
    """Write a dataset and its checksum so that at every moment `path` is either the old file or the complete new one.

    Missing parent directories are made. The incomplete file is in `scratch`, by default in the same directory. Raises
    ClunkError.

    The file is assembled in memory (a results file takes about 65 bytes a cell): HDF5 writing to a full disk does not
    only fail, it leaves handles that crash the interpreter when it exits. Python's own write fails cleanly.
    """
    image = io.BytesIO()
    with h5py.File(image, "w", track_order=True) as file:  # netCDF-4 asks for creation order
        file.attrs["schema_version"] = np.int32(SCHEMA_VERSION)
        _set_attributes(
            file,
            {
                **dataset.attributes,
                "Conventions": "CF-1.11",
                "variables": " ".join(dataset.variables),
                "content_digest": content_digest(dataset),
            },
        )
        for name in dataset.variables:
            _create(file, name, dataset)
    with writing(path) as target, image.getbuffer() as content:
        write_whole(target, lambda stream: stream.writelines([content, _trailer(content)]), scratch)


def _create(file: h5py.File, name: str, dataset: Dataset) -> None:
    """Write a variable: as a dimension scale if it is a coordinate, else with its dimensions' scales attached.

    Numeric variables of more than `_SMALL` bytes that are no coordinates are compressed.
    """
    dims, values, attributes = dataset.variables[name]
    is_dimension = dims == (name,)
    counts, places = dataset.places(name)
    shape = (*counts.shape, places)[: len(dims)]
    create = partial(file.create_dataset, name, track_order=True)
    if values.dtype.kind == "U":
        # Variable length, since xarray reads fixed-length strings as bytes, which selection by a text does not find.
        stored = create(data=values.astype(object), dtype=h5py.string_dtype())
    elif is_dimension or math.prod(shape) * values.itemsize <= _SMALL:
        stored = create(data=dataset.padded(name))
    else:
        rows = min(max(_SLAB // (places * counts[0].size), 1), len(counts))
        together = min(-(-_CHUNK // (rows * counts[0].size)), places)
        chunks = (rows, *counts.shape[1:], together)[: len(shape)]
        stored = create(shape, values.dtype, chunks=chunks, compression="gzip", compression_opts=_LEVEL, shuffle=True)
        _compress(values.ravel(), counts, places, stored)
    _set_attributes(stored, attributes)
    if is_dimension:
        stored.make_scale(name)
    else:
        for dimension, dim in zip(stored.dims, dims, strict=True):
            dimension.attach_scale(file[dim])


def _compress(entries: Array, counts: Array, places: int, stored: h5py.Dataset) -> None:
    """Write the compressed chunks that HDF5's filters (shuffle, gzip) would make, on several cores instead of one.

    A chunk holds some rows of cells and some places of each cell. The last chunks reach beyond the array, and have
    zeros there.

    entries : flat, of all cells in C order
    counts : number of entries of each cell
    places : number of places of each cell
    """
    rows, *_, together = (*stored.chunks, 1)[: counts.ndim + 1]
    slabs = np.split(counts, range(rows, len(counts), rows))
    parts = np.split(entries, np.cumsum([slab.sum() for slab in slabs[:-1]], dtype=int))

    def compressed(part: Array, slab: Array) -> list[bytes]:
        whole = np.zeros((rows * counts[0].size, -(-places // together), together), entries.dtype)
        whole.reshape(len(whole), -1)[: slab.size, :places] = _padded(part, slab.ravel(), places)
        chunks = whole.swapaxes(0, 1).copy().view(np.uint8).reshape(whole.shape[1], -1, entries.itemsize)
        return [zlib.compress(chunk.T.copy().data, _LEVEL) for chunk in chunks]

    with ThreadPoolExecutor() as threads:
        for number, chunks in enumerate(threads.map(compressed, parts, slabs)):
            for k, chunk in enumerate(chunks):
                begin = (number * rows, *[0] * (counts.ndim - 1), k * together)
                stored.id.write_direct_chunk(begin[: stored.ndim], chunk)


def _set_attributes(target: h5py.File | h5py.Dataset, attributes: Mapping[str, str | Array]) -> None:
    """Write attributes; a text has fixed length, as in netCDF's own files, or variable length if long or multi-line."""
    for name, value in attributes.items():
        if isinstance(value, str) and "\n" not in value and len(raw := value.encode()) <= _LONGEST_FIXED_TEXT:
            dtype = h5py.string_dtype("ascii" if value.isascii() else "utf-8", max(1, len(raw)))
            target.attrs.create(name, np.bytes_(raw), dtype=dtype)
        else:
            target.attrs[name] = value


def _trailer(content: memoryview | bytes) -> bytes:
    """The bytes behind the content of a file: a mark, and the SHA-256 of the content in hexadecimal digits."""
    return _MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


# --- reading


def read(path: FilePath) -> Dataset:
    """Read a whole file into memory after comparing its bytes with their checksum. Raises StoreError."""
    path = Path(path)
    try:
        if path.is_char_device():  # whose bytes may never end
            raise OSError("it is a device")
        raw = path.read_bytes()  # Python's own errors are clearer than HDF5's
    except OSError as error:
        hint = nearest_file(path, ".h5", "results") or "."
        raise StoreError(f"{path} cannot be read: {reason(error)}{hint}") from error
    if not raw.startswith(b"\x89HDF\r\n\x1a\n"):
        hint = f"; clunk sweep {path} makes one" if path.suffix == ".toml" else ""
        raise StoreError(f"{path} is not a results file of clunk: it is not HDF5{hint}.")
    content, trailer = memoryview(raw)[:-_LENGTH], raw[-_LENGTH:]
    if not trailer.startswith(_MARK):
        raise StoreError(
            f"{path} is not a whole results file of clunk: it was cut, or another program has made or changed it."
        )
    if trailer != _trailer(content):
        raise StoreError(f"{path} is damaged, its bytes do not match their checksum: run the sweep again.")
    with h5py.File(io.BytesIO(raw), "r") as file:
        attributes = _attributes_of(file)
        if (version := attributes["schema_version"]) != SCHEMA_VERSION:
            raise StoreError(
                f"{path} has schema version {version}, and this clunk reads {SCHEMA_VERSION}: run the sweep again."
            )
        variables: dict[str, Variable] = {}
        for name in attributes["variables"].split():
            variables[name] = _variable(file[name], name, variables)
    return Dataset(variables, {name: each for name, each in attributes.items() if name not in _OF_FILE})


def _variable(stored: h5py.Dataset, name: str, earlier: Mapping[str, Variable]) -> Variable:
    """A stored variable, with entries of cells flat, without padding, and with words as text.

    earlier : variables that precede it in the file, the numbers of entries among them
    """
    dims = (name,) if stored.is_scale else tuple(dim[0].name.removeprefix("/") for dim in stored.dims)
    if dims[-1] in COUNTED_BY and len(dims) > 1:
        counts, most = earlier[COUNTED_BY[dims[-1]]].values, stored.shape[-1]
        each = (stored.chunks or stored.shape)[0]
        slabs = (slice(k, k + each) for k in range(0, len(counts), each))
        values = np.concatenate([stored[rows][np.arange(most) < counts[rows][..., None]] for rows in slabs])
    else:
        values = stored[...]
    if values.dtype.kind == "O":
        values = np.array([word.decode() for word in values.tolist()])
    return Variable(dims, values, _attributes_of(stored))


def _attributes_of(source: h5py.File | h5py.Dataset) -> dict[str, Any]:
    """Attributes of a file or variable, texts of fixed or variable length as str, without those that HDF5 sets."""
    return {
        name: value.decode() if isinstance(value, bytes) else value
        for name, value in source.attrs.items()
        if name not in _OF_HDF5
    }
