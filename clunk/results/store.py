"""The results file, both ways: HDF5 laid out as netCDF-4, so that xarray, MATLAB and ncdump read it too.

The variables of a file are the quantities of its map, see `clunk.results.quantities`. Nothing of a file is believed on
reading: what is missing, foreign, of another version or damaged ends in a `StoreError` whose text is one sentence.
"""

from __future__ import annotations

import dataclasses
import hashlib
import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from clunk.results.boundaryfile import names_of, read_boundaries, write_boundaries
from clunk.results.checksum import matches_checksum
from clunk.results.files import reason, writing
from clunk.results.maps import Description, count_labels, counts_by_lash, require_array, require_codes
from clunk.results.netcdf import (
    CONVENTIONS,
    Image,
    chunk_writer,
    create_scale,
    create_variable,
    get_text,
    image_of,
    row_blocks,
    set_flags,
    set_text,
    write_file,
)
from clunk.results.quantities import REGIME_QUANTITIES, TOLERANCE_QUANTITIES, Quantity
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import AnyMap, ToleranceMap
from clunk.study.arrays import Array
from clunk.study.axes import LASH, RUN, ResultAxis, lash_axis
from clunk.study.document import nearest_file
from clunk.study.errors import ClunkError

SCHEMA_VERSION = 7
_KIND = "kind"  # root attribute of a tolerance map; a regime map has none
_TOLERANCE_MAP = "tolerance map"
# Root attributes that are not among the `attributes` of a map.
_RESERVED = {"title", "Conventions", "schema_version", _KIND, "config", "config_digest", "content_digest"}
_DIMENSIONS = {  # behind a map's axes -> attributes
    "impact": {"units": "1", "long_name": "number of the primary impact"},
    "label": {"long_name": "sequence of impact excursions (regime label)"},
    "quantile": {"units": "1", "long_name": "quantile of the runs of the sample"},
    "draw": {"units": "1", "long_name": "number of the draw"},
}
_DRAWN = "drawn_"  # begins the names of the sample's variables

_LARGE = 1 << 22  # cells, about 270 MB: more is assembled on the disk
_LARGE_FILE = 1 << 28  # bytes: more is read from the disk twice, for the checksum and by HDF5, and not held in memory


class StoreError(ClunkError):
    """A results file that cannot be read or written; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Header(Description):
    """Description of the map in a results file.

    counts_of_lashes : name of a lash, empty for an only one -> label -> number of cells, ``failed`` last; of a
        tolerance map, cells in which the label is the most likely one
    content_digest : SHA-256 of axes, labels and arrays
    checksum : whether the file has a checksum, which its bytes match: another program that changes it takes it away
    """

    counts_of_lashes: dict[str, dict[str, int]]
    content_digest: str
    checksum: bool

    @property
    def tolerance_map(self) -> bool:
        """Whether the file holds a tolerance map."""
        return bool(self.sample)


def write_results(path: str | os.PathLike[str], results: AnyMap, scratch: Path | None = None) -> None:
    """Write a results file so that at every moment `path` is either the old file or the complete new one.

    Missing parent directories are made. What is not complete yet is in `scratch`, by default in the same directory.
    Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> clunk.write_results("results/copy.h5", results)
    """
    with writing(path, StoreError) as target:
        write_file(target, lambda file: _fill(file, results), scratch, large=results.sequence.size > _LARGE)


def to_image(results: AnyMap) -> io.BytesIO:
    """Write a results file in memory."""
    return image_of(lambda file: _fill(file, results))


def read_results(path: str | os.PathLike[str]) -> Results:
    """Read a regime map whole, its bytes compared with their checksum, or its data with their digest.

    Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"), "results/smoke.h5")
    >>> clunk.read_results("results/smoke.h5").label_map[10, 6]
    np.str_('DS(1)SS(1)')
    """
    results = read_map(path)
    if not isinstance(results, Results):
        raise StoreError(
            f"{path} holds a tolerance map, where a regime map is needed: sweep without [[sweep.tolerances]]."
        )
    return results


def read_tolerance_map(path: str | os.PathLike[str]) -> ToleranceMap:
    """Read a tolerance map whole, its bytes compared with their checksum, or its data with their digest.

    Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> fewer = ["sweep.sampling.count=4", "sweep.axes[1].count=3", "sweep.axes[2].count=3"]
    >>> study = clunk.load_study("configs/tolerance.toml", fewer)
    >>> tolerances = clunk.tolerance_map(study, "results/tolerance.h5")
    >>> clunk.read_tolerance_map("results/tolerance.h5").draws
    4
    """
    results = read_map(path)
    if not isinstance(results, ToleranceMap):
        raise StoreError(f"{path} holds a regime map, where a tolerance map is needed.")
    return results


def read_map(path: str | os.PathLike[str]) -> AnyMap:
    """Read whichever map a results file holds, as `read_results` and `read_tolerance_map`. Raises StoreError."""
    with opened(path) as (file, header, _):
        return map_of(file, header)


def read_header(path: str | os.PathLike[str]) -> Header:
    """Read the header of a results file; of the arrays only the axes and `sequence`. Raises StoreError."""
    with opened(path, header_only=True) as (_, header, _):
        return header


def check(path: str | os.PathLike[str]) -> Header:
    """Compare a results file's bytes with their checksum, if they have one, and its data with their digest.

    Raises StoreError.
    """
    with opened(path) as (file, header, _):
        if header.checksum:
            _require_digest(file, header)
        return header


# --- writing


def _fill(file: Image, results: AnyMap) -> None:
    sample, boundaries = results.sample, results.boundaries
    set_text(file, "title", results.title)
    set_text(file, "Conventions", CONVENTIONS)
    file.attrs["schema_version"] = np.int32(SCHEMA_VERSION)
    for name, value in results.attributes.items():
        if name in _RESERVED:
            raise ValueError(f"{name} is written from the results' own fields, not from attributes")
        set_text(file, name, value)
    file.attrs["config"] = results.config  # variable length: it may be longer than an object header allows
    set_text(file, "config_digest", results.config_digest)
    if sample:
        set_text(file, _KIND, _TOLERANCE_MAP)

    axes = [
        create_scale(file, axis.variable, np.array(axis.words) if axis.words else axis.values, _attributes(axis))
        for axis in results.axes
    ]
    of_cell = axes[: len(axes) - bool(results.lashes)]
    along = {axis.parameter: [scale] for axis, scale in zip(results.axes, axes, strict=True)}
    for axis in results.coordinates:
        create_variable(file, axis.variable, np.float64, _attributes(axis), along[RUN])[:] = axis.values
    scales = {name: create_scale(file, name, values, _DIMENSIONS[name]) for name, values in results.entries.items()}
    if sample:
        set_text(scales["draw"], "sample", " ".join(_DRAWN + axis.variable for axis in sample))
    for axis in sample:
        variable = create_variable(file, _DRAWN + axis.variable, np.float64, _attributes(axis), [scales["draw"]])
        variable[:] = axis.values

    digest = Digest(results.axes + results.coordinates + sample, (*results.labels, *results.lashes))
    coordinates = " ".join(axis.variable for axis in results.coordinates)
    with chunk_writer(file) as write_rows:
        for name, each in results.quantities.items():
            attributes = {"units": each.unit, "long_name": each.long_name}
            attributes |= {"coordinates": coordinates} if coordinates else {}
            further = [scales[each.dimension]] if each.dimension else []
            scales_of = (of_cell if each.of == "cell" else axes) + further
            apart = len(scales_of) - len(of_cell)
            variable = create_variable(file, name, each.dtype, attributes, scales_of, apart=apart)
            set_flags(variable, each.meanings(results.labels), masks=each.coded == "quality")
            digest.begin(name, variable)
            # A block of rows at a time: padded whole, the impacts would be most of a large map's memory.
            for start, stop in row_blocks(variable):
                block = results.padded(name, start, stop)
                if each.of == "cell" and results.lashes:
                    block = block[..., 0]
                write_rows(variable, start, block)
                digest.add(block)
    if boundaries is not None:
        write_boundaries(file, boundaries, digest.add_variable)
    set_text(file, "content_digest", digest.hexdigest())


def _attributes(axis: ResultAxis) -> dict[str, str]:
    return {"units": axis.unit, "long_name": axis.name, "symbol": axis.symbol, "parameter": axis.parameter}


class Digest:
    """SHA-256 over the axes, the labels and then each variable's name, shape, dtype and little-endian values."""

    def __init__(self, axes: Sequence[ResultAxis], labels: Sequence[str]) -> None:
        self._sha = hashlib.sha256("\n".join(labels).encode())
        self.hexdigest = self._sha.hexdigest
        for axis in axes:
            self.add_variable(axis.variable, axis.values)

    def add_variable(self, name: str, values: Array) -> None:
        """Begin a variable and add its values."""
        self.begin(name, values)
        self.add(values)

    def begin(self, name: str, variable: h5py.Dataset | Array) -> None:
        """Begin a variable, whose values are then added."""
        self._sha.update(f"\n{name} {variable.shape} {variable.dtype.name}\n".encode())

    def add(self, values: Array) -> None:
        """Add values, in C order."""
        self._sha.update(np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"), copy=False)).data)


# --- reading


class Content(NamedTuple):
    """An open results file: as HDF5, its header, and its bytes."""

    file: h5py.File
    header: Header
    source: BinaryIO


@contextmanager
def opened(path: str | os.PathLike[str], *, header_only: bool = False) -> Iterator[Content]:
    """Open a results file whose bytes match their checksum or, where they have none, its data their digest.

    The bytes are read once, and HDF5 takes them from memory; those of a large file twice. Whatever is wrong with the
    file, also while it is open, is raised as a StoreError.

    header_only : do without the comparison of the data, and without the memory
    """
    path = Path(path)
    try:
        stored = path.open("rb")  # Python's own errors are clearer than HDF5's
    except OSError as error:
        hint = nearest_file(path, ".h5", "results") or "."
        raise StoreError(f"{path} cannot be read: {reason(error)}{hint}") from error
    try:
        with stored:
            on_disk = header_only or os.fstat(stored.fileno()).st_size > _LARGE_FILE
            source = stored if on_disk else io.BytesIO(stored.read())
            if source.read(8) != b"\x89HDF\r\n\x1a\n":
                hint = f"; clunk sweep {path} makes one" if path.suffix == ".toml" else ""
                raise StoreError(f"{path} is not a results file of clunk: it is not HDF5{hint}.")
            checksum = matches_checksum(source)  # before HDF5 sees it
            with h5py.File(source, "r") as file:
                if "schema_version" not in file.attrs or "sequence" not in file:
                    raise StoreError(f"{path} is not a results file of clunk, although it is HDF5.")
                version = int(file.attrs["schema_version"])
                if version != SCHEMA_VERSION:
                    raise StoreError(
                        f"{path} has schema version {version}, and this clunk reads {SCHEMA_VERSION}: "
                        "run the sweep again."
                    )
                header = _header_of(file, checksum)
                if not checksum and not header_only:
                    _require_digest(file, header)
                yield Content(file, header, source)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, MemoryError) as error:
        raise StoreError(f"{path} is damaged ({reason(error)}): run the sweep again.") from error


def map_of(file: h5py.File, header: Header) -> AnyMap:
    """Read the map of an open file. Raises ValueError where it cannot be one."""
    described: dict[str, Any] = {field.name: getattr(header, field.name) for field in dataclasses.fields(Description)}
    arrays: dict[str, Any] = {}
    for name, quantity in _quantities(header).items():
        in_impacts = quantity.dimension == "impact"
        arrays[name] = _unpadded(file[name], arrays["primary_impacts"]) if in_impacts else file[name][()]
        if quantity.of == "cell" and header.lashes:
            arrays[name] = np.repeat(arrays[name][..., None], len(header.lashes), axis=-1)
    if not header.tolerance_map:
        measured = {name: arrays.pop(name) for name in header.measured_quantities}
        return Results(**described, **arrays, measured=measured)
    probability, sequence = arrays.pop("probability"), arrays.pop("sequence")
    runs = np.rint(probability * len(header.sample[0].values)).astype(np.int32)
    tolerances = ToleranceMap(**described, runs=runs, **arrays)
    if not np.array_equal(tolerances.sequence, sequence):
        raise ValueError("sequence is not what is most probable")
    return tolerances


def _unpadded(variable: h5py.Dataset, counts: npt.NDArray[np.int32]) -> Array:
    """Values of all cells' impacts in C order, read a block of rows at a time; counts : of each cell."""
    first = np.concatenate(([0], np.cumsum(counts.reshape(len(counts), -1).sum(axis=1, dtype=np.int64))))
    flat = np.empty(int(first[-1]), variable.dtype)
    for start, stop in row_blocks(variable):
        mask = np.arange(variable.shape[-1]) < counts[start:stop, ..., None]
        flat[first[start] : first[stop]] = variable[start:stop][mask]
    return flat


def _header_of(file: h5py.File, checksum: bool) -> Header:
    sequence = file["sequence"]
    axes = tuple(_axis_of(dimension[0]) for dimension in sequence.dims)
    coordinates = get_text(sequence, "coordinates").split() if "coordinates" in sequence.attrs else []
    is_tolerance_map = _KIND in file.attrs and get_text(file, _KIND) == _TOLERANCE_MAP
    sample = get_text(file["draw"], "sample").split() if is_tolerance_map else []
    names = get_text(sequence, "flag_meanings").split()
    meanings = dict(zip(sequence.attrs["flag_values"].tolist(), names, strict=True))
    labels = tuple(meanings[code] for code in range(len(meanings) - 1))
    codes = sequence[()]
    require_array("sequence", codes, tuple(len(axis.values) for axis in axes), np.int16)
    require_codes(labels, codes)
    return Header(
        title=get_text(file, "title"),
        axes=axes,
        coordinates=tuple(_axis_of(file[name]) for name in coordinates),
        labels=labels,
        counts_of_lashes=counts_by_lash(
            {
                name: count_labels(labels, codes[..., k] if name else codes)
                for k, name in enumerate(axes[-1].words or [""])
            }
        ),
        config=get_text(file, "config"),
        config_digest=get_text(file, "config_digest"),
        content_digest=get_text(file, "content_digest"),
        # Names that begin with _ are netCDF's own, left by its tools.
        attributes={
            name: get_text(file, name) for name in file.attrs if name not in _RESERVED and not name.startswith("_")
        },
        sample=tuple(_axis_of(file[name]) for name in sample),
        boundaries=read_boundaries(file, _of_cells(axes)),
        checksum=checksum,
    )


def _of_cells(axes: tuple[ResultAxis, ...]) -> tuple[ResultAxis, ...]:
    """The axes without that of the lashes."""
    return tuple(axis for axis in axes if axis.parameter != LASH)


def _axis_of(scale: h5py.Dataset) -> ResultAxis:
    if get_text(scale, "parameter") == LASH:
        return lash_axis([name.decode() for name in scale[()].tolist()])
    return ResultAxis(
        parameter=get_text(scale, "parameter"),
        values=np.asarray(scale[()], np.float64),
        name=get_text(scale, "long_name"),
        symbol=get_text(scale, "symbol"),
        unit=get_text(scale, "units"),
    )


def _quantities(header: Header) -> dict[str, Quantity]:
    """The quantities of a file, in their order."""
    return TOLERANCE_QUANTITIES if header.tolerance_map else REGIME_QUANTITIES | header.measured_quantities


def _require_digest(file: h5py.File, header: Header) -> None:
    """Raise ValueError where a file's data do not match their digest."""
    digest = Digest(header.axes + header.coordinates + header.sample, (*header.labels, *header.lashes))
    for name in _quantities(header):
        digest.begin(name, file[name])
        for start, stop in row_blocks(file[name]):
            digest.add(file[name][start:stop])
    for name in names_of(file, _of_cells(header.axes)):
        digest.add_variable(name, file[name][()])
    if digest.hexdigest() != header.content_digest:
        raise ValueError("its data do not match its content_digest")
