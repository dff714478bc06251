"""The results file of a tolerance map, both ways; laid out as that of a regime map, see `clunk.results.store`.

probability (axes…, label)            the last label is failed; runs are probability times the length of draw
sequence (axes…)                      codes of the most likely labels
nominal_sequence (axes…)              of the labels without tolerances
severity_mean (axes…)
severity_quantiles (axes…, quantile)
drawn_… (draw)                        the sample, a variable for each toleranced parameter
"""

from __future__ import annotations

import os
from pathlib import Path

import h5py
import numpy as np

from clunk.results.checksum import verify
from clunk.results.labels import FAILED
from clunk.results.netcdf import ChunkWriter, Image, create_scale, create_variable, get_text, set_text
from clunk.results.quantities import TOLERANCE_QUANTITIES
from clunk.results.store import (
    NEWEST_VERSION,
    TOLERANCE_MAP,
    Digest,
    StoreError,
    describe,
    header_of,
    opened,
    read_axis,
    row_blocks,
    variable_of,
    write_coordinate,
    write_filled,
    write_head,
)
from clunk.results.tolerancemap import QUANTILES, ToleranceMap

_DRAWN = "drawn_"


def write(path: str | os.PathLike[str], found: ToleranceMap, scratch: Path | None = None) -> None:
    """Write a tolerance map as `clunk.results.store.write` writes a regime map. Raises StoreError."""
    write_filled(path, lambda file: _write(file, found), scratch)


def read(path: str | os.PathLike[str]) -> ToleranceMap:
    """Read a tolerance map whole and check it against its checksum and digest. Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> fewer = ["sweep.sampling.count=4", "sweep.axes[1].count=3", "sweep.axes[2].count=3"]
    >>> study = clunk.load_study("configs/tolerance.toml", fewer)
    >>> found = clunk.tolerance_map(study, "results/tolerance.h5")
    >>> clunk.read_tolerance_map("results/tolerance.h5").draws
    4
    """
    with opened(path) as file:
        header = header_of(file)
        if not header.tolerance_map:
            raise StoreError(f"{path} holds a regime map, where a tolerance map is needed.")
        shape = tuple(len(axis.values) for axis in header.axes)
        sample = tuple(read_axis(file[name]) for name in get_text(file["draw"], "sample").split())
        digest = Digest(header.axes + header.coordinates + sample, header.labels)
        fields = {}
        behind = {"": (), "label": (len(header.labels) + 1,), "quantile": (len(QUANTILES),)}
        for name, quantity in TOLERANCE_QUANTITIES.items():
            own, dtype = (*shape, *behind[quantity.dimension]), quantity.dtype
            fields[name] = variable_of(file, name, own, dtype)[()]
            digest.begin(name, own, dtype)
            digest.add(fields[name])
        if digest.hexdigest() != header.content_digest:
            raise ValueError("its data do not match its content_digest")
        probability, sequence = fields.pop("probability"), fields.pop("sequence")
        draws = len(file["draw"])
        found = ToleranceMap(
            title=header.title,
            axes=header.axes,
            coordinates=header.coordinates,
            labels=header.labels,
            sample=sample,
            runs=np.rint(probability * draws).astype(np.int32),
            config=header.config,
            config_digest=header.config_digest,
            attributes=header.attributes,
            **fields,
        )
        if not np.array_equal(found.sequence, sequence):
            raise ValueError("sequence is not what is most probable")
        return found


def check(path: str | os.PathLike[str]) -> bool:
    """Check the file of a tolerance map, as `clunk.results.store.check` that of a regime map. Raises StoreError."""
    read(path)
    return verify(path)


def _write(file: Image, found: ToleranceMap) -> None:
    scales = write_head(file, found, NEWEST_VERSION)
    set_text(file, "kind", TOLERANCE_MAP)
    # Of variable length: xarray takes fixed-length strings for bytes, and none would be found by its name.
    names = np.array([*found.labels, FAILED], h5py.string_dtype())
    label = file.create_dataset("label", data=names, track_order=True)
    set_text(label, "long_name", "sequence of impact excursions (regime label)")
    label.make_scale("label")
    quantile = create_scale(file, "quantile", np.array(QUANTILES), ("1", "quantile of the runs of the sample"))
    draw = create_scale(file, "draw", np.arange(1, found.draws + 1, dtype=np.int32), ("1", "number of the draw"))
    set_text(draw, "sample", " ".join(_DRAWN + each.variable for each in found.sample))
    for each in found.sample:
        write_coordinate(file, _DRAWN + each.variable, each, [draw])

    digest = Digest(found.axes + found.coordinates + found.sample, found.labels)
    further = {"probability": [label], "severity_quantiles": [quantile]}
    with ChunkWriter(file) as chunks:
        for name, quantity in TOLERANCE_QUANTITIES.items():
            more, shape, dtype = further.get(name, []), found.stored_shape(name), quantity.dtype
            meaning = (quantity.unit, quantity.long_name)
            variable = create_variable(file, name, shape, dtype, meaning, [*scales, *more], apart=len(more))
            describe(variable, quantity, found)
            values = np.ascontiguousarray(getattr(found, name))
            digest.begin(name, shape, dtype)
            for start, stop in row_blocks(variable):
                chunks.write(variable, start, values[start:stop])
            digest.add(values)
    set_text(file, "content_digest", digest.hexdigest())
