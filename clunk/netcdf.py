"""HDF5 laid out as netCDF-4: dimension scales, units and meanings, for xarray, MATLAB and ncdump to find."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from clunk.files import write_whole

CONVENTIONS = "CF-1.11"

# On the map of Figure 3.4 levels 1 to 6 differ by 1 % in size, and 6 takes three times as long.
_COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
_CHUNK_BYTES = 1 << 20  # HDF5's chunk cache, so that every chunk is compressed once
_LONGEST_FIXED_TEXT = 1 << 14  # an HDF5 attribute in an object header ends at 64 KiB; longer text goes to the heap


def write_file(path: str | os.PathLike[str], fill: Callable[[h5py.File], None]) -> None:
    """Write the file that `fill` fills, whole or not at all. Raises OSError.

    It is assembled in memory (a results file takes about 90 bytes a cell): HDF5 writing to a full disk does not only
    fail, it leaves handles that crash the interpreter when it exits. Python's own write fails cleanly.
    """
    image = io.BytesIO()
    with h5py.File(image, "w", track_order=True) as file:  # netCDF-4 asks for creation order
        fill(file)
    write_whole(path, lambda target: target.write(image.getbuffer()))


def create_scale(
    file: h5py.File,
    name: str,
    values: npt.NDArray[Any],
    meaning: tuple[str, str],
    texts: Mapping[str, str] | None = None,
) -> h5py.Dataset:
    """A dimension with its values, the coordinate of the variables along it.

    meaning : (unit, long name)
    texts : further attributes
    """
    scale = create_variable(file, name, values.shape, values.dtype.type, meaning)
    scale[:] = values
    for key, text in (texts or {}).items():
        set_text(scale, key, text)
    scale.make_scale(name)
    return scale


def create_variable(
    file: h5py.File,
    name: str,
    shape: tuple[int, ...],
    dtype: type[np.generic],
    meaning: tuple[str, str],
    scales: Sequence[h5py.Dataset] = (),
) -> h5py.Dataset:
    """A variable along some dimensions, still without its values, compressed where that pays.

    meaning : (unit, long name)
    """
    itemsize = np.dtype(dtype).itemsize
    filters: dict[str, Any] = {}
    if scales and itemsize * int(np.prod(shape)) > 4096:  # a smaller one would only grow
        filters = {"chunks": _chunks(shape, itemsize), **_COMPRESSION}
    # Little-endian whatever the machine, so that the file does not depend on it.
    variable = file.create_dataset(name, shape, np.dtype(dtype).newbyteorder("<"), track_order=True, **filters)
    for position, scale in enumerate(scales):
        variable.dims[position].attach_scale(scale)
    unit, long_name = meaning
    set_text(variable, "units", unit)
    set_text(variable, "long_name", long_name)
    return variable


def set_flags(variable: h5py.Dataset, meanings: Mapping[int, str], *, masks: bool = False) -> None:
    """CF's flag attributes: what the integers of a variable mean, or with `masks` their bits."""
    variable.attrs["flag_masks" if masks else "flag_values"] = np.array(list(meanings), variable.dtype)
    set_text(variable, "flag_meanings", " ".join(meanings.values()))


def set_text(target: h5py.File | h5py.Dataset, name: str, text: str) -> None:
    """A fixed-length string attribute, as netCDF's own `units` are; a long one at variable length."""
    raw = text.encode()
    if len(raw) > _LONGEST_FIXED_TEXT:
        target.attrs[name] = text
    else:
        kind = h5py.string_dtype("ascii" if text.isascii() else "utf-8", max(1, len(raw)))
        target.attrs.create(name, np.bytes_(raw), dtype=kind)


def get_text(source: h5py.File | h5py.Dataset, name: str) -> str:
    """A string attribute of either length."""
    value = source.attrs[name]
    return value.decode() if isinstance(value, bytes) else str(value)


def _chunks(shape: tuple[int, ...], itemsize: int) -> tuple[int, ...]:
    """The longest run of whole trailing dimensions that stays within the chunk cache."""
    room = _CHUNK_BYTES // itemsize
    chunk = []
    for count in reversed(shape):
        chunk.append(min(count, max(1, room)))
        room //= chunk[-1]
    return tuple(reversed(chunk))
