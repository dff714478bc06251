"""Boundaries as variables: ragged arrays as CF lays them out, a number of vertices for each curve and ring."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from clunk.results.boundaries import EVENTS, NO_LABEL, Boundaries
from clunk.results.dataset import Variable, flags, meanings_of
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.study.arrays import Array
from clunk.study.axes import ResultAxis


class _Field(NamedTuple):
    """A variable that is a field of `Boundaries`.

    field : its name there
    dtype : numpy scalar type
    dims : names of the dimensions
    long_name : description
    coded : ``labels`` or ``events``, where the integers are codes of these
    counts : the dimension of what is counted
    """

    field: str
    dtype: type[np.generic]
    dims: tuple[str, ...]
    long_name: str
    coded: str = ""
    counts: str = ""


_FIELDS = {
    "boundary_vertices": _Field(
        "curve_counts", np.int32, ("boundary",), "number of vertices", counts="boundary_vertex"
    ),
    "boundary_left": _Field("curve_left", np.int16, ("boundary",), "label on the left of the curve", "labels"),
    "boundary_right": _Field("curve_right", np.int16, ("boundary",), "label on the right of the curve", "labels"),
    "boundary_event": _Field("curve_event", np.int8, ("boundary",), "event that changes the label", "events"),
    "junction_labels": _Field(
        "junction_labels", np.int16, ("junction", "junction_label"), "labels that meet", "labels"
    ),
    "region_sequence": _Field("region_label", np.int16, ("region",), "label of the region", "labels"),
    "region_area": _Field("region_area", np.float64, ("region",), "share of the map, along its axes as spaced"),
    "region_rings": _Field(
        "region_rings", np.int32, ("region",), "number of rings, first the outer one", counts="ring"
    ),
    "ring_vertices": _Field("ring_counts", np.int32, ("ring",), "number of vertices", counts="ring_vertex"),
}
_PLACES = (  # prefix of a variable for each axis, field, dimension
    ("boundary", "vertices", "boundary_vertex"),
    ("junction", "junctions", "junction"),
    ("ring", "ring_vertices", "ring_vertex"),
    ("unresolved", "unresolved", "unresolved"),
)
_FIRST = "boundary_vertices"  # in a file that has boundaries; it names the lash


def variables_of(boundaries: Boundaries) -> dict[str, Variable]:
    """Variables of boundaries by name, after the numbers along their dimensions."""
    meanings = {
        "labels": dict(enumerate(boundaries.labels)) | {FAILED_CODE: FAILED, NO_LABEL: "none"},
        "events": dict(enumerate(EVENTS)),
        "": {},
    }
    variables: dict[str, Variable] = {}
    for name, each in _FIELDS.items():
        attributes: dict[str, str | Array] = {"units": "1", "long_name": each.long_name}
        attributes |= {"sample_dimension": each.counts} if each.counts else {}
        attributes |= {"lash": boundaries.lash} if boundaries.lash and name == _FIRST else {}
        attributes |= flags(meanings[each.coded], each.dtype)
        variables[name] = Variable(each.dims, getattr(boundaries, each.field).astype(each.dtype), attributes)
    for prefix, field, dim in _PLACES:
        for axis, values in zip(boundaries.axes, getattr(boundaries, field).T, strict=False):
            attributes = {"units": axis.unit, "long_name": axis.name}
            variables[f"{prefix}_{axis.variable}"] = Variable((dim,), np.ascontiguousarray(values), attributes)
    lengths = {dim: n for each in variables.values() for dim, n in zip(each.dims, each.values.shape, strict=True)}
    numbers = {dim: np.arange(1, length + 1, dtype=np.int32) for dim, length in lengths.items()}
    described: dict[str, str | Array] = {"units": "1", "long_name": "number"}
    return {dim: Variable((dim,), each, described) for dim, each in numbers.items()} | variables


def boundaries_of(variables: Mapping[str, Variable], axes: tuple[ResultAxis, ...]) -> Boundaries | None:
    """The boundaries among some variables, None without any. Raises KeyError and ValueError where they are damaged."""
    if _FIRST not in variables:
        return None
    fields: dict[str, Any] = {each.field: variables[name].values for name, each in _FIELDS.items()}
    for prefix, field, _ in _PLACES:
        names = [f"{prefix}_{axis.variable}" for axis in axes]
        columns = [variables[name].values for name in names if name in variables]
        fields[field] = np.column_stack(columns) if columns else np.zeros((0, 2))
    words = meanings_of(variables["boundary_left"])
    labels = tuple(words[code] for code in range(len(words) - 2))
    return Boundaries(axes=axes, labels=labels, lash=str(variables[_FIRST].attributes.get("lash", "")), **fields)
