"""Comparison of two regime maps of the same grid, cell by cell: labels that differ, and ratios of the severities."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clunk.results.labels import FAILED_CODE
from clunk.results.maps import parameters_of, values_at
from clunk.results.regimemap import Results
from clunk.study.arrays import Bools, Positions
from clunk.study.axes import ResultAxis
from clunk.study.document import leaves
from clunk.study.errors import ClunkError

_SAME_AXIS = 1e-9  # of an axis's smallest step: the same values computed in another way differ by rounding
_ROUNDING = 1e-14  # of a value itself: drawn ones may lie as near to each other as that


class ComparisonError(ClunkError):
    """Results that cannot be compared; its text is one sentence for the user."""


@dataclass(frozen=True)
class Transition:
    """A label of A that is another one in B, and in how many cells."""

    a: str
    b: str
    cells: int


@dataclass(frozen=True)
class DifferingCell:
    """A cell with two labels: its index, its parameters' values in their units, and its label in A and in B."""

    at: tuple[int, ...]
    values: tuple[float, ...]
    a: str
    b: str


@dataclass(frozen=True)
class Extreme:
    """A quantity in the cell where A and B are furthest apart; `values` are those of the comparison's parameters."""

    values: tuple[float, ...]
    a: float
    b: float

    @property
    def ratio(self) -> float:
        """B over A."""
        return self.b / self.a

    @property
    def difference(self) -> float:
        """B less A, in the quantity's unit."""
        return self.b - self.a


@dataclass(frozen=True)
class Deviation:
    """Ratio of a quantity in B to the one in A, over the cells where it is positive in both.

    quantity : `severity` [rad/s²] or `approach_velocity` [rad/s]
    cells : number of these cells
    zero_in_one : number of cells where it is zero in one of the two only, and there is no ratio
    median, low, high : of the ratio B/A; low and high are its 5 and 95 % quantiles
    largest_ratio : the cell whose ratio is furthest from 1; 1/2 is as far as 2
    largest_difference : the cell whose difference is largest
    """

    quantity: str
    cells: int
    zero_in_one: int
    median: float
    low: float
    high: float
    largest_ratio: Extreme
    largest_difference: Extreme


@dataclass(frozen=True)
class ConfigDifference:
    """A key that the two configs do not agree on; None where one has no such key."""

    key: str
    a: Any
    b: Any


@dataclass(frozen=True, eq=False)
class Comparison:
    """Differences between two maps of the same grid, A and B.

    titles : of A and of B
    axes, coordinates : A's; B's are the same
    labels : of both, A's first
    differs : shape, bool: both have a label, and not the same
    failed_a, failed_b : shape, bool
    codes_a, codes_b : shape, int: the label in `labels`, or -1 where the cell failed
    transitions : the most frequent first
    deviation : of the severity or, where one map has none, of the approach velocity; None where nothing can be compared
    identical : whether every array of the two is the same, bit for bit
    configs_equal : whether the two digests are, that is everything that decides the results
    config_differences : keys of the two configs that differ, those that decide nothing (a title) among them
    provenance_differences : versions and machines that differ, by name
    """

    titles: tuple[str, str]
    axes: tuple[ResultAxis, ...]
    labels: tuple[str, ...]
    differs: Bools
    failed_a: Bools
    failed_b: Bools
    codes_a: Positions
    codes_b: Positions
    transitions: tuple[Transition, ...]
    deviation: Deviation | None
    identical: bool
    configs_equal: bool
    config_differences: tuple[ConfigDifference, ...]
    provenance_differences: dict[str, tuple[str, str]]
    coordinates: tuple[ResultAxis, ...] = ()

    @property
    def parameters(self) -> tuple[ResultAxis, ...]:
        """The swept parameters: the axes, and in the place of `run` its coordinates."""
        return parameters_of(self.axes, self.coordinates)

    @property
    def cells(self) -> int:
        """Number of cells that have a label in both maps; only these are compared."""
        return int(np.count_nonzero(~(self.failed_a | self.failed_b)))

    @property
    def differing(self) -> int:
        """Number of compared cells whose labels differ."""
        return int(np.count_nonzero(self.differs))

    @property
    def share(self) -> float:
        """Share of the compared cells whose labels differ; NaN where no cell could be compared."""
        return self.differing / self.cells if self.cells else math.nan

    @property
    def failed_in_a_only(self) -> int:
        """Number of cells that have no label in A and one in B."""
        return int(np.count_nonzero(self.failed_a & ~self.failed_b))

    @property
    def failed_in_b_only(self) -> int:
        """Number of cells that have no label in B and one in A."""
        return int(np.count_nonzero(self.failed_b & ~self.failed_a))

    @property
    def failed_in_both(self) -> int:
        """Number of cells that have no label in either."""
        return int(np.count_nonzero(self.failed_a & self.failed_b))

    @property
    def same_regimes(self) -> bool:
        """Whether the two agree in every cell: the same label, or failed in both; never if nothing was compared."""
        return self.cells > 0 and not (self.differing or self.failed_in_a_only or self.failed_in_b_only)

    def differing_cells(self, among: Bools | bool = True) -> Iterator[DifferingCell]:
        """The cells whose labels differ, in the grid's order; with a mask only those among its cells."""
        for cell in np.argwhere(self.differs & among):
            at = tuple(cell.tolist())
            values = values_at(self.axes, at, self.coordinates)
            yield DifferingCell(at, values, self.labels[self.codes_a[at]], self.labels[self.codes_b[at]])


def compare(a: Results, b: Results) -> Comparison:
    """Compare two maps of the same grid, by their labels' text: codes depend on what else is in a file.

    Raises
    ------
    ComparisonError
        Where the axes are not the same, or a config cannot be read.

    Examples
    --------
    >>> import clunk
    >>> maps = [clunk.sweep(clunk.load_study("configs/smoke.toml", [f"solver.step={h}"])) for h in (2e-4, 1e-4)]
    >>> int(clunk.compare(*maps).differs.sum())
    0
    """
    _require_same_axes(a.parameters, b.parameters)
    _require_same_axes(a.axes, b.axes)
    labels = tuple(dict.fromkeys((*a.labels, *b.labels)))
    codes_a, codes_b = (codes_among(results, labels) for results in (a, b))
    failed_a, failed_b = codes_a == FAILED_CODE, codes_b == FAILED_CODE
    differs = (codes_a != codes_b) & ~failed_a & ~failed_b
    configs = _flat_config(a, "A"), _flat_config(b, "B")
    return Comparison(
        titles=(a.title, b.title),
        axes=a.axes,
        labels=labels,
        differs=differs,
        failed_a=failed_a,
        failed_b=failed_b,
        codes_a=codes_a,
        codes_b=codes_b,
        transitions=_transitions(labels, codes_a[differs], codes_b[differs]),
        deviation=_deviation(a, b),
        identical=_identical(a, b),
        configs_equal=a.config_digest == b.config_digest,
        config_differences=tuple(
            ConfigDifference(key, configs[0].get(key), configs[1].get(key))
            for key in dict.fromkeys((*configs[0], *configs[1]))
            if configs[0].get(key) != configs[1].get(key)
        ),
        provenance_differences={
            name: (a.attributes.get(name, ""), b.attributes.get(name, ""))
            for name in dict.fromkeys((*a.attributes, *b.attributes))
            if name != "created" and a.attributes.get(name) != b.attributes.get(name)
        },
        coordinates=a.coordinates,
    )


def _require_same_axes(a: tuple[ResultAxis, ...], b: tuple[ResultAxis, ...]) -> None:
    names = [", ".join(axis.spread if axis.words else axis.parameter for axis in axes) for axes in (a, b)]
    if names[0] != names[1]:
        same = {axis.parameter for axis in a} == {axis.parameter for axis in b}
        order = "in another order" if same else "other parameters"
        raise ComparisonError(
            f"The maps cannot be compared because they sweep {order}: {names[0]} in A and {names[1]} in B."
        )
    for axis_a, axis_b in zip(a, b, strict=True):
        if len(axis_a.values) != len(axis_b.values):
            raise ComparisonError(
                f"The maps cannot be compared because their grids differ: {axis_a.parameter} takes {_span(axis_a)} "
                f"in A and {_span(axis_b)} in B."
            )
        steps = np.diff(np.unique(axis_a.values))
        smallest = steps.min() if steps.size else abs(axis_a.values[0])
        tolerance = np.maximum(_SAME_AXIS * smallest, _ROUNDING * np.abs(axis_a.values))
        apart = np.abs(axis_a.values - axis_b.values) > tolerance
        if apart.any():
            k = int(np.argmax(apart))
            raise ComparisonError(
                f"The maps cannot be compared because their grids differ: value {k + 1} of {axis_a.parameter} is "
                f"{axis_a.values[k]:.10g} in A and {axis_b.values[k]:.10g} in B."
            )


def _span(axis: ResultAxis) -> str:
    count = len(axis.values)
    return f"{count} value{'' if count == 1 else 's'} from {axis.values[0]:g} to {axis.values[-1]:g}"


def codes_among(results: Results, labels: tuple[str, ...]) -> Positions:
    """Codes of the cells' labels among other labels, in the shape of the map; -1 of failed cells."""
    # the code of a failed cell, -1, takes the last entry
    code = np.array([*(labels.index(label) for label in results.labels), FAILED_CODE], np.intp)
    codes: Positions = code[results.sequence]
    return codes


def _transitions(labels: tuple[str, ...], a: Positions, b: Positions) -> tuple[Transition, ...]:
    pairs, counts = np.unique(a * len(labels) + b, return_counts=True)
    transitions = [
        Transition(labels[pair // len(labels)], labels[pair % len(labels)], count)
        for pair, count in zip(pairs.tolist(), counts.tolist(), strict=True)
    ]
    return tuple(
        sorted(transitions, key=lambda transition: -transition.cells)
    )  # a stable sort: ties in the labels' order


def _deviation(a: Results, b: Results) -> Deviation | None:
    ok = (a.sequence != FAILED_CODE) & (b.sequence != FAILED_CODE)
    for name in ("severity", "approach_velocity"):
        values_a, values_b = getattr(a, name), getattr(b, name)
        if np.isfinite(values_a[ok]).any() and np.isfinite(values_b[ok]).any():
            break
    else:
        return None
    known = ok & np.isfinite(values_a) & np.isfinite(values_b)
    both = known & (values_a > 0.0) & (values_b > 0.0)
    if not both.any():
        return None
    cells = np.argwhere(both)
    ratio = values_b[both] / values_a[both]
    low, median, high = np.quantile(ratio, (0.05, 0.5, 0.95))

    def extreme(k: np.intp) -> Extreme:
        at = tuple(int(index) for index in cells[k])
        return Extreme(values_at(a.axes, at, a.coordinates), float(values_a[at]), float(values_b[at]))

    return Deviation(
        quantity=name,
        cells=len(cells),
        zero_in_one=int(np.count_nonzero(known & ((values_a > 0.0) != (values_b > 0.0)))),
        median=float(median),
        low=float(low),
        high=float(high),
        largest_ratio=extreme(np.argmax(np.abs(np.log(ratio)))),
        largest_difference=extreme(np.argmax(np.abs(values_b[both] - values_a[both]))),
    )


def _identical(a: Results, b: Results) -> bool:
    if a.quantities != b.quantities:
        return False
    axes = all(np.array_equal(one.values, other.values) for one, other in zip(a.parameters, b.parameters, strict=True))
    # bytes, so that NaN is equal to itself
    return (
        axes
        and a.labels == b.labels
        and all(a.values(name).tobytes() == b.values(name).tobytes() for name in a.quantities)
    )


def _flat_config(results: Results, which: str) -> dict[str, Any]:
    """Values of a map's config by dotted key."""
    try:
        document = tomllib.loads(results.config)
    except tomllib.TOMLDecodeError as error:
        raise ComparisonError(f"The config that {which} carries cannot be read as TOML ({error}).") from error
    return dict(leaves(document))
