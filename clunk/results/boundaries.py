"""Boundaries of a regime map: curves between two labels, junctions of three or four, and the regions in between.

In a file they are CF's contiguous ragged arrays, with the number of vertices of each curve and ring.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.netcdf import Variable, flags, meanings_of
from clunk.study.arrays import Array, Counts, Flanks, Floats, LabelCodes
from clunk.study.axes import ResultAxes, parameters_of
from clunk.study.records import Rows, as_text, counted

EVENTS = (
    "unknown",
    "grazing_of_the_opposite_flank",
    "grazing_of_the_initial_flank",
    "end_of_sticking",
    "sticking_time_reached",
    "end_time_reached",
)
NO_LABEL = -2  # in the fourth column of `junction_labels` where only three labels meet
UNKNOWN, OPPOSITE_FLANK, INITIAL_FLANK, STICKING_ENDS, STICKING_TIME, END_TIME = range(len(EVENTS))

_FIRST = "boundary_vertices"  # in every file with boundaries; of several lashes its attribute `lash` names one
_VARIABLES = (  # name, field of `Boundaries`, dimensions, description, meaning of its codes, dimension that it counts
    (_FIRST, "curve_counts", ("boundary",), "number of vertices", "", "boundary_vertex"),
    ("boundary_left", "curve_left", ("boundary",), "label on the left of the curve", "labels", ""),
    ("boundary_right", "curve_right", ("boundary",), "label on the right of the curve", "labels", ""),
    ("boundary_event", "curve_event", ("boundary",), "event that changes the label", "events", ""),
    ("junction_labels", "junction_labels", ("junction", "junction_label"), "labels that meet", "labels", ""),
    ("region_sequence", "region_label", ("region",), "label of the region", "labels", ""),
    ("region_area", "region_area", ("region",), "share of the map, along its axes as spaced", "", ""),
    ("region_rings", "region_rings", ("region",), "number of rings, first the outer one", "", "ring"),
    ("ring_vertices", "ring_counts", ("ring",), "number of vertices", "", "ring_vertex"),
)
_PLACES = (  # prefix of a variable for each axis, field, dimension
    ("boundary", "vertices", "boundary_vertex"),
    ("junction", "junctions", "junction"),
    ("ring", "ring_vertices", "ring_vertex"),
    ("unresolved", "unresolved", "unresolved"),
)


class Curve(NamedTuple):
    """A curve between two labels.

    vertices : (n, 2), in the axes' units
    left, right : label on either side, seen along the curve from its first vertex to its last
    event : one of `EVENTS`, at which the label changes
    """

    vertices: Floats
    left: str
    right: str
    event: str


class Region(NamedTuple):
    """A connected part of a map with one label.

    rings : closed polygons, (n, 2) each in the axes' units, the outer one first, anticlockwise, then holes, clockwise
    label : str
    area : share of the map, measured along its axes as they are spaced: evenly, or in their logarithm
    """

    rings: tuple[Floats, ...]
    label: str
    area: float


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Boundaries:
    """The boundary network of a regime map over two axes, each vertex accurate to 1e-9 of its axis's range.

    Where labels change so finely that the runs of the tracing do not suffice, a boundary is accurate to 1.3e-4 of the
    map, or its place is listed in `unresolved`.

    axes : the two axes of the map
    labels : code -> label; first the map's labels, then those that none of its cells has; the code -1 is `failed`
    vertices : (V, 2) float64, in the axes' units, of one curve after the other
    curve_counts : (C,) int32, number of vertices of each curve
    curve_left, curve_right : (C,) int16, codes on either side
    curve_event : (C,) int8, number in `EVENTS` of the event at the middle of each curve
    junctions : (J, 2) float64, points where three labels meet, or four where two boundaries cross, accurate to 1e-7 of
        the map
    junction_labels : (J, 3 or 4) int16, codes of these labels, ascending, then `NO_LABEL` where there are three of four
    ring_vertices : (W, 2) float64, closed rings of one region after the other, see `Region`
    ring_counts : (G,) int32, number of vertices of each ring
    region_rings : (R,) int32, number of rings of each region
    region_label : (R,) int16, code of the label
    region_area : (R,) float64, share of the map
    unresolved : (U, 2) float64, a place in each cell where no boundary could be located: a label has no width there or
        depends on rounding, or labels change more finely than the runs along the boundaries resolve
    lash : name of the lash whose labels are parted; empty where the driveline has one lash
    """

    axes: ResultAxes
    labels: tuple[str, ...]
    vertices: Floats
    curve_counts: Counts
    curve_left: LabelCodes
    curve_right: LabelCodes
    curve_event: Flanks
    junctions: Floats
    junction_labels: LabelCodes
    ring_vertices: Floats
    ring_counts: Counts
    region_rings: Counts
    region_label: LabelCodes
    region_area: Floats
    unresolved: Floats
    lash: str

    def label(self, code: int) -> str:
        """The label of a code."""
        return (*self.labels, FAILED)[code]

    @property
    def curves(self) -> list[Curve]:
        """The curves."""
        parts = _parts(self.vertices, self.curve_counts)
        return [
            Curve(part, self.label(left), self.label(right), EVENTS[event])
            for part, left, right, event in zip(parts, self.curve_left, self.curve_right, self.curve_event, strict=True)
        ]

    @property
    def regions(self) -> list[Region]:
        """The regions."""
        rings = iter(_parts(self.ring_vertices, self.ring_counts))
        rest = zip(self.region_rings, self.region_label, self.region_area, strict=True)
        return [Region(tuple(islice(rings, count)), self.label(code), float(area)) for count, code, area in rest]

    @property
    def meetings(self) -> list[tuple[Floats, list[str]]]:
        """The junctions, each with its labels."""
        labels = [[self.label(code) for code in codes if code != NO_LABEL] for codes in self.junction_labels.tolist()]
        return list(zip(self.junctions, labels, strict=True))

    @property
    def areas(self) -> dict[str, float]:
        """Share of the map of each label that has a region, in the order of the labels, last ``failed``."""
        codes = sorted(set(self.region_label.tolist()), key=lambda code: (code < 0, code))
        return {self.label(code): float(self.region_area[self.region_label == code].sum()) for code in codes}

    def summary(self) -> Rows:
        """Pairs of a name and a value that describe the network, for people."""
        name = f"boundaries of {self.lash}" if self.lash else "boundaries"
        parts = [f"{counted(len(self.curve_counts), 'curve')} of {len(self.vertices):,} vertices"]
        parts += [counted(len(self.junctions), "junction"), counted(len(self.region_area), "region")]
        return [(name, ", ".join(parts))]

    @property
    def unresolved_sentence(self) -> str:
        """A sentence on the places that are unresolved; empty without any."""
        if not len(self.unresolved):
            return ""
        first = zip(self.axes, self.unresolved[0].tolist(), strict=True)
        at = ", ".join(f"{axis.parameter} = {value:.6g}" for axis, value in first)
        return (
            f"unresolved: {counted(len(self.unresolved), 'place')}, first {at}; there labels change more finely than "
            "the runs along the lines can show, or rounding decides them"
        )

    def meeting_rows(self) -> list[dict[str, str]]:
        """A row for each junction: texts of its axes' values and of the labels that meet, by heading."""
        names = parameters_of(self.axes)
        return [
            {name: f"{value:.10g}" for name, value in zip(names, place.tolist(), strict=True)}
            | {"labels that meet": ", ".join(labels)}
            for place, labels in self.meetings
        ]

    def __repr__(self) -> str:
        return as_text("clunk.Boundaries", [*self.summary(), *((k, f"{v:.6%}") for k, v in self.areas.items())])

    def geojson(self) -> dict[str, Any]:
        """A FeatureCollection: regions as polygons, curves as lines, junctions and unresolved places as points.

        Coordinates are the axes' values in the order of the axes. For a driveline of several lashes, the member `lash`
        names the lash to which the boundaries belong.
        """
        features: list[tuple[str, list[Any], dict[str, Any]]] = []
        for region in self.regions:
            rings = [ring.tolist() for ring in region.rings]
            features.append(("Polygon", rings, {"label": region.label, "area": region.area}))
        for curve in self.curves:
            sides = {"left": curve.left, "right": curve.right, "event": curve.event}
            features.append(("LineString", curve.vertices.tolist(), sides))
        features += [("Point", point.tolist(), {"labels": labels}) for point, labels in self.meetings]
        features += [("Point", place, {"unresolved": True}) for place in self.unresolved.tolist()]
        return {
            "type": "FeatureCollection",
            "axes": parameters_of(self.axes),
            **({"lash": self.lash} if self.lash else {}),
            "features": [
                {"type": "Feature", "geometry": {"type": shape, "coordinates": points}, "properties": properties}
                for shape, points, properties in features
            ],
        }


def _parts(values: Array, counts: Counts) -> list[Array]:
    return list(np.split(values, counts.cumsum()[:-1])) if counts.size else []


def variables_of(boundaries: Boundaries) -> dict[str, Variable]:
    """Variables by name that store boundaries, preceded by coordinates that number the entries of each dimension."""
    meanings = {
        "labels": dict(enumerate(boundaries.labels)) | {FAILED_CODE: FAILED, NO_LABEL: "none"},
        "events": dict(enumerate(EVENTS)),
        "": {},
    }
    variables = {}
    for name, field, dims, long_name, coded, counts in _VARIABLES:
        values = getattr(boundaries, field)
        attributes = {"units": "1", "long_name": long_name}
        attributes |= {"sample_dimension": counts} if counts else {}
        attributes |= {"lash": boundaries.lash} if boundaries.lash and name == _FIRST else {}
        variables[name] = Variable(dims, values, attributes | flags(meanings[coded], values.dtype))
    for prefix, field, dim in _PLACES:
        for axis, values in zip(boundaries.axes, getattr(boundaries, field).T, strict=False):
            attributes = {"units": axis.unit, "long_name": axis.name}
            variables[f"{prefix}_{axis.variable}"] = Variable((dim,), np.ascontiguousarray(values), attributes)
    numbers = {}
    for each in variables.values():
        for dim, length in zip(each.dims, each.values.shape, strict=True):
            values = np.arange(1, length + 1, dtype=np.int32)
            numbers[dim] = Variable((dim,), values, {"units": "1", "long_name": "number"})
    return numbers | variables


def boundaries_of(variables: Mapping[str, Variable], axes: ResultAxes) -> Boundaries | None:
    """The boundaries that are stored among some variables; None where there are none."""
    if _FIRST not in variables:
        return None
    fields = {field: variables[name].values for name, field, *_ in _VARIABLES}
    for prefix, field, _ in _PLACES:
        names = [f"{prefix}_{axis.variable}" for axis in axes]
        columns = [variables[name].values for name in names if name in variables]
        fields[field] = np.column_stack(columns) if columns else np.zeros((0, 2))
    words = meanings_of(variables["boundary_left"])
    labels = tuple(words[code] for code in range(len(words) - 2))
    return Boundaries(axes=axes, labels=labels, lash=str(variables[_FIRST].attributes.get("lash", "")), **fields)
