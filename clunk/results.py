"""What a sweep found: one regime, severity and outcome per cell of the grid, and every primary impact."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

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


@dataclass(frozen=True, eq=False)
class ResultAxis:
    """One swept parameter and the values it took.

    parameter : dotted key of the config, e.g. ``load.ratio`` or ``driveline.inertias[4]``
    values : (count,) float64  [unit]
    name, symbol, unit : for people, e.g. ``load ratio``, ``σr = Td/Ts``, ``1``
    """

    parameter: str
    values: npt.NDArray[np.float64]
    name: str
    symbol: str
    unit: str

    def __post_init__(self) -> None:
        if self.values.dtype != np.float64 or self.values.ndim != 1 or not self.values.size:
            raise ValueError(f"the values of axis {self.parameter} must be a non-empty 1-D float64 array")

    @property
    def variable(self) -> str:
        """Name of the axis in the results file: ``load_ratio``, ``driveline_inertias_4``."""
        return re.sub(r"[.\[\]]", "_", self.parameter).rstrip("_")

    @cached_property
    def is_geometric(self) -> bool:
        """Whether the values, put in order, are spaced evenly in their logarithm, and not in themselves."""
        ascending = np.sort(self.values)
        if len(ascending) < 3 or ascending[0] <= 0.0:
            return False
        steps = np.diff(np.log(ascending))
        return bool(np.allclose(steps, steps.mean(), rtol=1e-6) and ascending[-1] / ascending[0] > 3.0)


@dataclass(frozen=True, eq=False)
class Results:
    """A regime map and what lies under it.

    "Shape" is the axes' counts in order; N counts the primary impacts of all cells.

    title : str
    axes : one or more `ResultAxis`
    labels : code -> label; the code -1 is a failed cell
    sequence : shape, int16 codes into `labels`
    severity : shape, Q  [rad/s²], NaN where it is not defined
    approach_velocity : shape, V  [rad/s]
    last_event_time : shape  [s after the load step], NaN where nothing happened
    primary_impacts, touches : shape, int32; touches -1 where the cell was inferred
    status, quality : shape, uint8; see `clunk.core.status`
    initial_side : shape, int8, sign of θ_i - θ_j on the initial flank (0: none)
    margin : shape, dimensionless: how near the run came to another label, positive for what did not happen and negative
        for what did (see `clunk.core.exact`); NaN where the method knows none
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

    def __post_init__(self) -> None:
        if not self.axes:
            raise ValueError("results need at least one axis")
        if len({axis.variable for axis in self.axes}) != len(self.axes):
            raise ValueError("two axes have the same name")
        for name, dtype in CELL_FIELDS.items():
            _require(name, getattr(self, name), self.shape, dtype)
        if self.primary_impacts.min() < 0:
            raise ValueError("primary_impacts must not be negative")
        impacts = (int(self.primary_impacts.sum(dtype=np.int64)),)
        for name, dtype in IMPACT_FIELDS.items():
            _require(name, getattr(self, name), impacts, dtype)
        if any(not label or label.split() != [label] or label == FAILED for label in self.labels):
            raise ValueError("a label must be one word, and not 'failed'")
        if len(set(self.labels)) != len(self.labels):
            raise ValueError("labels must differ from each other")
        if self.sequence.min() < FAILED_CODE or self.sequence.max() >= len(self.labels):
            raise ValueError("sequence holds a code without a label")

    @property
    def shape(self) -> tuple[int, ...]:
        """The axes' counts in order."""
        return tuple(len(axis.values) for axis in self.axes)

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

    def counts(self) -> dict[str, int]:
        """Number of cells of each label, in the labels' order, and last of ``failed`` (also where it is 0)."""
        return count_labels(self.labels, self.sequence)

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


def values_at(axes: tuple[ResultAxis, ...], cell: Sequence[int]) -> tuple[float, ...]:
    """The parameters of a cell, in the axes' order and units."""
    return tuple(float(axis.values[k]) for axis, k in zip(axes, cell, strict=True))


def count_labels(labels: tuple[str, ...], sequence: npt.NDArray[np.int16]) -> dict[str, int]:
    """Number of cells of each label, in the labels' order, and last of ``failed``."""
    cells = np.bincount(sequence.ravel().astype(np.intp) - FAILED_CODE, minlength=len(labels) + 1)
    return {label: int(cells[code - FAILED_CODE]) for code, label in enumerate(labels)} | {FAILED: int(cells[0])}


def _require(name: str, array: npt.NDArray[Any], shape: tuple[int, ...], dtype: type[np.generic]) -> None:
    if array.shape != shape or array.dtype != dtype:
        raise ValueError(f"{name} must be {np.dtype(dtype)} {shape}, not {array.dtype} {array.shape}")
