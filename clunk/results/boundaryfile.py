"""The boundaries in a results file: ragged arrays as CF lays them out, a number of vertices for each curve and ring."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from clunk.results.boundaries import EVENTS, NO_LABEL, Boundaries
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.netcdf import create_scale, create_variable, get_text, set_flags
from clunk.study.arrays import Array
from clunk.study.axes import ResultAxis


@dataclass(frozen=True)
class _Variable:
    """A variable of a results file.

    name : in the file
    field : of `Boundaries`
    dtype : numpy scalar type
    dimensions : their names
    long_name : description
    coded : ``labels`` or ``events``, where the integers are codes of these
    counts : the dimension of what is counted
    """

    name: str
    field: str
    dtype: type[np.generic]
    dimensions: tuple[str, ...]
    long_name: str
    coded: str = ""
    counts: str = ""


_VARIABLES = (
    _Variable(
        "boundary_vertices", "curve_counts", np.int32, ("boundary",), "number of vertices", counts="boundary_vertex"
    ),
    _Variable("boundary_left", "curve_left", np.int16, ("boundary",), "label on the left of the curve", "labels"),
    _Variable("boundary_right", "curve_right", np.int16, ("boundary",), "label on the right of the curve", "labels"),
    _Variable("boundary_event", "curve_event", np.int8, ("boundary",), "event that changes the label", "events"),
    _Variable(
        "junction_labels", "junction_labels", np.int16, ("junction", "junction_label"), "labels that meet", "labels"
    ),
    _Variable("region_sequence", "region_label", np.int16, ("region",), "label of the region", "labels"),
    _Variable("region_area", "region_area", np.float64, ("region",), "share of the map, along its axes as spaced"),
    _Variable(
        "region_rings", "region_rings", np.int32, ("region",), "number of rings, first the outer one", counts="ring"
    ),
    _Variable("ring_vertices", "ring_counts", np.int32, ("ring",), "number of vertices", counts="ring_vertex"),
)
_PLACES = (  # prefix of a variable for each axis, field, dimension
    ("boundary", "vertices", "boundary_vertex"),
    ("junction", "junctions", "junction"),
    ("ring", "ring_vertices", "ring_vertex"),
)
_FIRST = "boundary_vertices"  # in a file that has boundaries


def write_boundaries(file: h5py.File, boundaries: Boundaries, add: Callable[[str, Array], None]) -> None:
    """Write boundaries beside their map; add : takes each variable's name and values, for the digest."""
    scales: dict[str, h5py.Dataset] = {}

    def put(name: str, values: Array, dimensions: tuple[str, ...], attributes: dict[str, str]) -> h5py.Dataset:
        for dimension, length in zip(dimensions, values.shape, strict=True):
            if dimension not in scales:
                numbers = np.arange(1, length + 1, dtype=np.int32)
                scales[dimension] = create_scale(file, dimension, numbers, {"units": "1", "long_name": "number"})
        variable = create_variable(file, name, values.dtype, attributes, [scales[each] for each in dimensions])
        variable[...] = values
        add(name, values)
        return variable

    for each in _VARIABLES:
        values = getattr(boundaries, each.field).astype(each.dtype)
        attributes = {"units": "1", "long_name": each.long_name}
        attributes |= {"sample_dimension": each.counts} if each.counts else {}
        attributes |= {"lash": boundaries.lash} if boundaries.lash and each.name == _FIRST else {}
        set_flags(put(each.name, values, each.dimensions, attributes), _meanings(each.coded, boundaries.labels))
    for prefix, field, dimension in _PLACES:
        for axis, values in zip(boundaries.axes, getattr(boundaries, field).T, strict=False):
            attributes = {"units": axis.unit, "long_name": axis.name}
            put(f"{prefix}_{axis.variable}", np.ascontiguousarray(values), (dimension,), attributes)


def read_boundaries(file: h5py.File, axes: tuple[ResultAxis, ...]) -> Boundaries | None:
    """Read the boundaries of a results file, None where it has none. Raises KeyError and ValueError where damaged."""
    if _FIRST not in file:
        return None
    fields: dict[str, Any] = {each.field: file[each.name][()] for each in _VARIABLES}
    for prefix, field, _ in _PLACES:
        names = [f"{prefix}_{axis.variable}" for axis in axes]
        columns = [file[name][()] for name in names if name in file]
        fields[field] = np.column_stack(columns) if columns else np.zeros((0, 2))
    coded = file["boundary_left"]
    words = dict(zip(coded.attrs["flag_values"].tolist(), get_text(coded, "flag_meanings").split(), strict=True))
    labels = tuple(words[code] for code in range(len(words) - 2))
    lash = get_text(file[_FIRST], "lash") if "lash" in file[_FIRST].attrs else ""
    return Boundaries(axes=axes, labels=labels, lash=lash, **fields)


def names_of(file: h5py.File, axes: tuple[ResultAxis, ...]) -> list[str]:
    """Variables of the boundaries in a results file, in the order in which they are written; none without these."""
    names = [each.name for each in _VARIABLES]
    names += [f"{prefix}_{axis.variable}" for prefix, _, _ in _PLACES for axis in axes]
    return [name for name in names if name in file] if _FIRST in file else []


def _meanings(coded: str, labels: tuple[str, ...]) -> dict[int, str]:
    if coded == "labels":
        return dict(enumerate(labels)) | {FAILED_CODE: FAILED, NO_LABEL: "none"}
    return dict(enumerate(EVENTS)) if coded == "events" else {}
