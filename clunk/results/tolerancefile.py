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
from clunk.results.netcdf import ChunkWriter, Image, create_scale, create_variable, get_text, set_text
from clunk.results.results import FAILED
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

# Variable -> (unit, long name).
_MEANING = {
    "probability": ("1", "probability of each label: its share of the runs of the sample"),
    "sequence": ("1", "most likely sequence of impact excursions (regime label)"),
    "nominal_sequence": ("1", "sequence of impact excursions (regime label) without tolerances"),
    "severity_mean": ("rad s-2", "mean severity Q of the runs of the sample that did not fail; 0 without impacts"),
    "severity_quantiles": ("rad s-2", "quantiles of the severity Q of the runs of the sample that did not fail"),
    "status": ("1", "how the first run of the sample that failed ended"),
}
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
        for name, (own, dtype) in _layout(shape, len(header.labels)).items():
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
        for name, (shape, dtype) in _layout(found.shape, len(found.labels)).items():
            more = further.get(name, [])
            variable = create_variable(file, name, shape, dtype, _MEANING[name], [*scales, *more], apart=len(more))
            describe(variable, name, found)
            values = np.ascontiguousarray(getattr(found, name))
            digest.begin(name, shape, dtype)
            for start, stop in row_blocks(variable):
                chunks.write(variable, start, values[start:stop])
            digest.add(values)
    set_text(file, "content_digest", digest.hexdigest())


def _layout(shape: tuple[int, ...], labels: int) -> dict[str, tuple[tuple[int, ...], type[np.generic]]]:
    """The variables of the cells, with shape and dtype, in the order of the file and of its digest."""
    return {
        "probability": ((*shape, labels + 1), np.float64),
        "sequence": (shape, np.int16),
        "nominal_sequence": (shape, np.int16),
        "severity_mean": (shape, np.float64),
        "severity_quantiles": ((*shape, len(QUANTILES)), np.float64),
        "status": (shape, np.uint8),
    }
