"""What a sweep found: one regime, severity and outcome per cell of the grid, and every primary impact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.status import QUALITY_INFERRED, QUALITY_MEANINGS, Status
from clunk.study.axes import RUN, ResultAxis
from clunk.study.summaries import Rows, as_html, as_text, html_table

FAILED = "failed"
FAILED_CODE = -1

# Field -> dtype; the order is the order in the results file and in its digest.
CELL_FIELDS: dict[str, type[np.generic]] = {
    "sequence": np.int16,
    "severity": np.float64,
    "approach_velocity": np.float64,
    "primary_impacts": np.int32,
    "touches": np.int32,
    "last_event_time": np.float64,
    "status": np.uint8,
    "quality": np.uint8,
    "initial_side": np.int8,
    "margin": np.float64,
}
IMPACT_FIELDS: dict[str, type[np.generic]] = {
    "impact_time": np.float64,
    "impact_flank": np.int8,
    "impact_closing_speed": np.float64,
    "impact_severity": np.float64,
}


class OverAxes:
    """What all results over axes have."""

    axes: tuple[ResultAxis, ...]
    coordinates: tuple[ResultAxis, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """The axes' counts in order."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def parameters(self) -> tuple[ResultAxis, ...]:
        """What was swept: the axes, and in the place of `run` its coordinates."""
        return parameters_of(self.axes, self.coordinates)

    def _part(self, values: Mapping[str, float]) -> tuple[tuple[slice, ...], dict[str, Any]]:
        """The slice at some axes' values, the nearest of each: the positions on the axes, and `axes`, `coordinates`.

        Raises ValueError where a name is not an axis, or a value lies beyond it.
        """
        names = [axis.parameter for axis in self.axes]
        part = [slice(None)] * len(names)
        for parameter, value in values.items():
            if parameter not in names:
                raise ValueError(f"{parameter!r} is no axis of these results; their axes are {', '.join(names)}")
            at = names.index(parameter)
            position = self.axes[at].nearest(value)
            part[at] = slice(position, position + 1)
        run = part[names.index(RUN)] if RUN in names else slice(None)
        axes = tuple(replace(axis, values=axis.values[own]) for axis, own in zip(self.axes, part, strict=True))
        coordinates = tuple(replace(axis, values=axis.values[run]) for axis in self.coordinates)
        return tuple(part), {"axes": axes, "coordinates": coordinates}


@dataclass(frozen=True, eq=False)
class Results(OverAxes):
    """A regime map and what lies under it.

    "Shape" is the axes' counts in order; N counts the primary impacts of all cells.

    title : str
    axes : one or more `ResultAxis`
    coordinates : the parameters that change together along the axis `run`, if there is one; each as long as it
    labels : code -> label; the code -1 is a failed cell
    sequence : shape, int16 codes into `labels`
    severity : shape, Q  [rad/s²], NaN where it is not defined
    approach_velocity : shape, V  [rad/s]
    last_event_time : shape  [s after the load step], NaN where nothing happened
    primary_impacts, touches : shape, int32; touches -1 where the cell was inferred
    status, quality : shape, uint8; see `clunk.core.status`
    initial_side : shape, int8, sign of θ_i - θ_j on the initial flank (0: none)
    margin : shape, dimensionless: how near the run came to another label, positive for what did not happen and negative
        for what did (see `clunk.core.exact.run`); NaN where the method knows none
    impact_time : (N,)  [s after the load step]; cells in C order, cell k owns `primary_impacts[k]` consecutive entries
    impact_flank : (N,) int8, +1 opposite, -1 initial
    impact_closing_speed : (N,)  [rad/s]
    impact_severity : (N,) Q_i  [rad/s²]
    config, config_digest : the resolved TOML and its digest

    A cell that a refined sweep inferred (`QUALITY_INFERRED`) has what its regime tells: code, primary_impacts,
    initial_side and the flanks of its impacts, which have their places in the flat arrays; its floats are NaN.
    attributes : versions, date and machine, by name

    Raises ValueError where an array's shape or dtype is not the one above, or a code has no label.
    """

    title: str
    axes: tuple[ResultAxis, ...]
    labels: tuple[str, ...]
    sequence: npt.NDArray[np.int16]
    severity: npt.NDArray[np.float64]
    approach_velocity: npt.NDArray[np.float64]
    last_event_time: npt.NDArray[np.float64]
    primary_impacts: npt.NDArray[np.int32]
    touches: npt.NDArray[np.int32]
    status: npt.NDArray[np.uint8]
    quality: npt.NDArray[np.uint8]
    initial_side: npt.NDArray[np.int8]
    margin: npt.NDArray[np.float64]
    impact_time: npt.NDArray[np.float64]
    impact_flank: npt.NDArray[np.int8]
    impact_closing_speed: npt.NDArray[np.float64]
    impact_severity: npt.NDArray[np.float64]
    config: str
    config_digest: str
    attributes: dict[str, str]
    coordinates: tuple[ResultAxis, ...] = ()

    def __post_init__(self) -> None:
        check_axes(self.axes, self.coordinates)
        for name, dtype in CELL_FIELDS.items():
            require(name, getattr(self, name), self.shape, dtype)
        if self.primary_impacts.min() < 0:
            raise ValueError("primary_impacts must not be negative")
        impacts = (int(self.primary_impacts.sum(dtype=np.int64)),)
        for name, dtype in IMPACT_FIELDS.items():
            require(name, getattr(self, name), impacts, dtype)
        check_labels(self.labels, self.sequence)

    @cached_property
    def inferred(self) -> npt.NDArray[np.bool_]:
        """Which cells a refined sweep did not run: shape, bool."""
        inferred: npt.NDArray[np.bool_] = (self.quality & QUALITY_INFERRED) != 0
        return inferred

    @cached_property
    def max_impacts(self) -> int:
        """Length of the file's `impact` dimension: the most primary impacts of any cell, at least 1."""
        return max(1, int(self.primary_impacts.max()))

    @cached_property
    def first_impact(self) -> npt.NDArray[np.int64]:
        """Where each cell's impacts begin in the flat arrays: (cells + 1,), in C order."""
        first = np.zeros(self.primary_impacts.size + 1, np.int64)
        np.cumsum(self.primary_impacts.ravel(), out=first[1:])
        return first

    def at(self, values: Mapping[str, float]) -> Results:
        """The slice at some axes' values, the nearest of each: ``results.at({"lash.contact.stiffness": 4e5})``.

        Those axes stay, with one value; of `run` a run's number, and its coordinates stay with theirs. Labels and codes
        are those of the whole.

        Raises ValueError where a name is not an axis, or a value lies beyond it.
        """
        part, along = self._part(values)
        cells = np.arange(self.sequence.size).reshape(self.shape)[part].ravel()
        count, first = np.diff(self.first_impact)[cells], self.first_impact[cells]
        begin = np.cumsum(count) - count  # of each cell's impacts in the slice
        impacts = np.arange(count.sum()) + np.repeat(first - begin, count)
        fields: dict[str, Any] = {name: np.ascontiguousarray(getattr(self, name)[part]) for name in CELL_FIELDS}
        fields |= {name: getattr(self, name)[impacts] for name in IMPACT_FIELDS}
        return replace(self, **along, **fields)

    def counts(self) -> dict[str, int]:
        """Number of cells of each label, in the labels' order, and last of ``failed`` (also where it is 0)."""
        return count_labels(self.labels, self.sequence)

    @property
    def label_map(self) -> npt.NDArray[np.str_]:
        """Each cell's label, shape; ``failed`` where the run failed."""
        return np.array([*self.labels, FAILED])[self.sequence]  # the code -1 is the last

    def cell(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Everything that is known about the cell nearest to these values.

        Parameters
        ----------
        values : by parameter, for every axis, in its unit

        Returns
        -------
        dict
            The cell's own value of each parameter; its `label`; whatever there is of a cell, by name; the names of its
            `status` and `quality` in the place of their codes; and of each primary impact what there is of impacts, in
            arrays.

        Raises
        ------
        ValueError
            Where an axis is not named, or something that is none; or a value lies beyond an axis.

        Examples
        --------
        >>> import clunk
        >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
        >>> cell = results.cell({"load.ratio": 5.0, "lash.backlash_deg": 6.0})
        >>> cell["label"], cell["touches"], cell["quality"]
        ('DS(1)SS(1)', 9, ['complete'])
        >>> cell["impact_time"].round(4)  # s after the load step
        array([0.1191, 0.2613, 0.565 ])
        """
        names = [axis.parameter for axis in self.axes]
        if set(values) != set(names):
            raise ValueError(f"A cell is named by {' and '.join(names)}, not by {', '.join(values) or 'nothing'}.")
        at = tuple(axis.nearest(values[axis.parameter]) for axis in self.axes)
        number = int(np.ravel_multi_index(at, self.shape))
        impacts = slice(*self.first_impact[number : number + 2])
        found: dict[str, Any] = dict(zip(names, values_at(self.axes, at), strict=True))
        own = values_at(self.axes, at, self.coordinates)
        found |= {axis.parameter: value for axis, value in zip(self.parameters, own, strict=True)}
        found["label"] = [*self.labels, FAILED][self.sequence[at]]
        found |= {name: getattr(self, name)[at].item() for name in CELL_FIELDS}
        found["status"] = Status(found["status"]).name.lower()
        found["quality"] = [name for bit, name in QUALITY_MEANINGS.items() if found["quality"] & bit]
        return found | {name: getattr(self, name)[impacts] for name in IMPACT_FIELDS}

    def summary(self) -> Rows:
        """What was found, for people: (name, value) pairs."""
        rows = [(axis.parameter, axis.spread) for axis in self.axes]
        rows += [(axis.parameter, f"{axis.spread}, along {RUN}") for axis in self.coordinates]
        if np.isfinite(self.severity).any():
            rows.append(("severity Q", f"{np.nanmin(self.severity):.0f} to {np.nanmax(self.severity):.0f} rad/s²"))
        for bit, name in QUALITY_MEANINGS.items():
            count = int(np.count_nonzero(self.quality & bit))
            if count:
                rows.append((name, share(count, self.sequence.size)))
        return rows

    def _label_rows(self) -> Rows:
        cells = self.sequence.size
        return [(label, share(n, cells)) for label, n in self.counts().items() if n or label != FAILED]

    def __repr__(self) -> str:
        return as_text(f"clunk.Results {self.title!r}", [*self.summary(), *self._label_rows()])

    def _repr_html_(self) -> str:
        return as_html(self.title, html_table(self.summary()), html_table(self._label_rows(), ("label", "cells")))

    def padded(self, name: str) -> npt.NDArray[Any]:
        """One `impact_…` array as shape + (max_impacts,), padded with NaN (floats) or 0 (integers)."""
        return self.padded_rows(name, 0, self.shape[0])

    def padded_rows(self, name: str, start: int, stop: int) -> npt.NDArray[Any]:
        """`padded(name)[start:stop]` at the memory of those rows only."""
        dtype = np.dtype(IMPACT_FIELDS[name])
        count = self.primary_impacts[start:stop]
        row = int(np.prod(self.shape[1:], dtype=np.int64))
        flat = getattr(self, name)[self.first_impact[start * row] : self.first_impact[stop * row]]
        block = np.full((*count.shape, self.max_impacts), np.nan if dtype.kind == "f" else 0, dtype)
        block[np.arange(self.max_impacts) < count[..., None]] = flat
        return block


def parameters_of(axes: Sequence[ResultAxis], coordinates: Sequence[ResultAxis]) -> tuple[ResultAxis, ...]:
    """The axes, and in the place of `run` its coordinates."""
    found: list[ResultAxis] = []
    for axis in axes:
        found += coordinates if axis.parameter == RUN else [axis]
    return tuple(found)


def values_at(
    axes: Sequence[ResultAxis], cell: Sequence[int], coordinates: Sequence[ResultAxis] = ()
) -> tuple[float, ...]:
    """The parameters of a cell, in the order of `parameters_of` and their units; of `run` its number without these."""
    values: list[float] = []
    for axis, k in zip(axes, cell, strict=True):
        own = coordinates if axis.parameter == RUN and coordinates else [axis]
        values += (float(each.values[k]) for each in own)
    return tuple(values)


def share(count: int, cells: int) -> str:
    """How many of the cells, and which part of them: ``21 cells, 4.8 %``."""
    return f"{count:,} {'cell' if count == 1 else 'cells'}, {100.0 * count / cells:.1f} %"


def count_labels(labels: tuple[str, ...], sequence: npt.NDArray[np.int16]) -> dict[str, int]:
    """Number of cells of each label, in the labels' order, and last of ``failed``."""
    cells = np.bincount(sequence.ravel().astype(np.intp) - FAILED_CODE, minlength=len(labels) + 1)
    return {label: int(cells[code - FAILED_CODE]) for code, label in enumerate(labels)} | {FAILED: int(cells[0])}


def check_axes(axes: tuple[ResultAxis, ...], coordinates: tuple[ResultAxis, ...]) -> None:
    """Raise ValueError where these cannot be the axes of results."""
    if not axes:
        raise ValueError("results need at least one axis")
    parameters = parameters_of(axes, coordinates)
    if len({axis.variable for axis in parameters}) != len(parameters):
        raise ValueError("two axes have the same name")
    run = {len(axis.values) for axis in axes if axis.parameter == RUN}
    if {len(axis.values) for axis in coordinates} - run:
        raise ValueError("a coordinate is not as long as the axis run")


def check_labels(labels: tuple[str, ...], sequence: npt.NDArray[np.int16]) -> None:
    """Raise ValueError where these cannot be labels, or a code has none."""
    if any(not label or label.split() != [label] or label == FAILED for label in labels):
        raise ValueError("a label must be one word, and not 'failed'")
    if len(set(labels)) != len(labels):
        raise ValueError("labels must differ from each other")
    if sequence.min() < FAILED_CODE or sequence.max() >= len(labels):
        raise ValueError("sequence holds a code without a label")


def require(name: str, array: npt.NDArray[Any], shape: tuple[int, ...], dtype: type[np.generic]) -> None:
    """Raise ValueError where an array has another shape or dtype."""
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(f"{name} must be {np.dtype(dtype)} {shape}, not {array.dtype} {array.shape}")
