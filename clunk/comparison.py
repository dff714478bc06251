"""Two answers to the same question: a regime map against another one, or against measurements.

Two maps of the same grid (other contact model, solver, driveline or machine) are compared cell by cell: where the
sequences of impacts differ, and how the severities do. Measurements, as in the report's Table 4.1, are compared with
the cells nearest to them, and by their trend: does the number of double-sided impacts change in the same direction?
"""

from __future__ import annotations

import math
import tomllib
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from clunk.configfile import dotted, shorten
from clunk.experiments import (
    CAVEAT,
    Experiment,
    ExperimentError,
    Measurement,
    double_sided,
    is_experiment,
    read_experiment,
)
from clunk.results import CELL_FIELDS, FAILED, FAILED_CODE, IMPACT_FIELDS, ResultAxis, Results

__all__ = [
    "Comparison",
    "ComparisonError",
    "ConfigDifference",
    "Deviation",
    "DifferingCell",
    "ExperimentComparison",
    "ExperimentError",
    "Extreme",
    "Point",
    "Tally",
    "Transition",
    "Trend",
    "as_record",
    "compare",
    "compare_experiment",
    "is_experiment",
    "read_experiment",
    "report",
]

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

_SAME_AXIS = 1e-9  # of an axis's smallest step: the same values computed in another way differ by rounding
_WIDTH = 80  # of the text report, in characters
_MOST_TRANSITIONS = 12  # in the text report
_MOST_CELLS = 12  # likewise
_SYMBOL = {"severity": ("Severity Q", "rad/s²"), "approach_velocity": ("Approach velocity V", "rad/s")}


class ComparisonError(Exception):
    """Results that cannot be compared; its text is one sentence for the user."""


# --- two maps: what is found


@dataclass(frozen=True)
class Transition:
    """A label of A that is another one in B, and in how many cells."""

    a: str
    b: str
    cells: int


@dataclass(frozen=True)
class DifferingCell:
    """A cell with two labels; `values` are its parameters in the axes' order and units."""

    values: tuple[float, ...]
    a: str
    b: str


@dataclass(frozen=True)
class Extreme:
    """A quantity in the cell where A and B are furthest apart; `values` are its parameters in the axes' order."""

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
    """How a quantity of B compares with A's, over the cells where it is positive in both.

    quantity : `severity` [rad/s²] or `approach_velocity` [rad/s]
    cells : how many cells that are
    zero_in_one : cells where it is zero in one of the two only, and there is no ratio
    median, low, high : of the ratio B/A; low and high are its 5 and 95 % quantiles
    largest_ratio : where the ratio is furthest from 1; 1/2 is as far as 2
    largest_difference : where the difference is largest
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
    """Two maps of the same grid.

    titles : of A and of B
    axes : A's; B's are the same
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
    codes_a: npt.NDArray[np.intp]
    codes_b: npt.NDArray[np.intp]
    transitions: tuple[Transition, ...]
    deviation: Deviation | None
    identical: bool
    configs_equal: bool
    config_differences: tuple[ConfigDifference, ...]
    provenance_differences: dict[str, tuple[str, str]]

    @property
    def cells(self) -> int:
        """Cells that have a label in both maps; only these are compared."""
        return int(np.count_nonzero(~(self.failed_a | self.failed_b)))

    @property
    def differing(self) -> int:
        """Cells of these whose labels differ."""
        return int(np.count_nonzero(self.differs))

    @property
    def share(self) -> float:
        """Differing cells over compared cells; NaN where no cell could be compared."""
        return self.differing / self.cells if self.cells else math.nan

    @property
    def failed_in_a_only(self) -> int:
        """Cells that have no label in A and one in B."""
        return int(np.count_nonzero(self.failed_a & ~self.failed_b))

    @property
    def failed_in_b_only(self) -> int:
        """Cells that have no label in B and one in A."""
        return int(np.count_nonzero(self.failed_b & ~self.failed_a))

    @property
    def failed_in_both(self) -> int:
        """Cells that have no label in either."""
        return int(np.count_nonzero(self.failed_a & self.failed_b))

    @property
    def same_regimes(self) -> bool:
        """Whether the two agree in every cell: the same label, or failed in both; never if nothing was compared."""
        return self.cells > 0 and not (self.differing or self.failed_in_a_only or self.failed_in_b_only)

    def differing_cells(self) -> Iterator[DifferingCell]:
        """The cells whose labels differ, in the grid's order."""
        for cell in np.argwhere(self.differs):
            at = tuple(int(k) for k in cell)
            yield DifferingCell(_values_at(self.axes, at), self.labels[self.codes_a[at]], self.labels[self.codes_b[at]])


def compare(a: Results, b: Results) -> Comparison:
    """Compare two maps of the same grid, by their labels' text: codes depend on what else is in a file.

    Raises
    ------
    ComparisonError
        Where the axes are not the same, or a config cannot be read.
    """
    _require_same_axes(a.axes, b.axes)
    labels = tuple(dict.fromkeys((*a.labels, *b.labels)))
    codes_a, codes_b = (_codes(results, labels) for results in (a, b))
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
    )


def _require_same_axes(a: tuple[ResultAxis, ...], b: tuple[ResultAxis, ...]) -> None:
    names = [", ".join(axis.parameter for axis in axes) for axes in (a, b)]
    if names[0] != names[1]:
        same = {axis.parameter for axis in a} == {axis.parameter for axis in b}
        what = "in another order" if same else "other parameters"
        raise ComparisonError(
            f"The maps cannot be compared because they sweep {what}: {names[0]} in A and {names[1]} in B."
        )
    for mine, theirs in zip(a, b, strict=True):
        if len(mine.values) != len(theirs.values):
            raise ComparisonError(
                f"The maps cannot be compared because their grids differ: {mine.parameter} takes {_span(mine)} in A "
                f"and {_span(theirs)} in B."
            )
        steps = np.abs(np.diff(mine.values))
        tolerance = _SAME_AXIS * (steps.min() if steps.size else abs(mine.values[0]))
        apart = np.abs(mine.values - theirs.values) > tolerance
        if apart.any():
            k = int(np.argmax(apart))
            raise ComparisonError(
                f"The maps cannot be compared because their grids differ: value {k + 1} of {mine.parameter} is "
                f"{mine.values[k]:.10g} in A and {theirs.values[k]:.10g} in B."
            )


def _span(axis: ResultAxis) -> str:
    count = len(axis.values)
    return f"{count} value{'' if count == 1 else 's'} from {axis.values[0]:g} to {axis.values[-1]:g}"


def _codes(results: Results, labels: tuple[str, ...]) -> npt.NDArray[np.intp]:
    # the code of a failed cell, -1, finds the last entry
    code = np.array([*(labels.index(label) for label in results.labels), FAILED_CODE], np.intp)
    codes: npt.NDArray[np.intp] = code[results.sequence]
    return codes


def _transitions(labels: tuple[str, ...], a: npt.NDArray[np.intp], b: npt.NDArray[np.intp]) -> tuple[Transition, ...]:
    pairs, counts = np.unique(a * len(labels) + b, return_counts=True)
    found = [
        Transition(labels[pair // len(labels)], labels[pair % len(labels)], count)
        for pair, count in zip(pairs.tolist(), counts.tolist(), strict=True)
    ]
    return tuple(sorted(found, key=lambda transition: -transition.cells))  # a stable sort: ties in the labels' order


def _deviation(a: Results, b: Results) -> Deviation | None:
    ok = (a.sequence != FAILED_CODE) & (b.sequence != FAILED_CODE)
    for name in _SYMBOL:
        mine, theirs = getattr(a, name), getattr(b, name)
        if np.isfinite(mine[ok]).any() and np.isfinite(theirs[ok]).any():
            break
    else:
        return None
    known = ok & np.isfinite(mine) & np.isfinite(theirs)
    both = known & (mine > 0.0) & (theirs > 0.0)
    if not both.any():
        return None
    cells = np.argwhere(both)
    ratio = theirs[both] / mine[both]
    low, median, high = np.quantile(ratio, (0.05, 0.5, 0.95))

    def extreme(k: np.intp) -> Extreme:
        at = tuple(int(index) for index in cells[k])
        return Extreme(_values_at(a.axes, at), float(mine[at]), float(theirs[at]))

    return Deviation(
        quantity=name,
        cells=len(cells),
        zero_in_one=int(np.count_nonzero(known & ((mine > 0.0) != (theirs > 0.0)))),
        median=float(median),
        low=float(low),
        high=float(high),
        largest_ratio=extreme(np.argmax(np.abs(np.log(ratio)))),
        largest_difference=extreme(np.argmax(np.abs(theirs[both] - mine[both]))),
    )


def _identical(a: Results, b: Results) -> bool:
    names = [*CELL_FIELDS, *IMPACT_FIELDS]
    axes = all(np.array_equal(mine.values, theirs.values) for mine, theirs in zip(a.axes, b.axes, strict=True))
    # bytes, so that NaN is equal to itself
    return axes and a.labels == b.labels and all(getattr(a, n).tobytes() == getattr(b, n).tobytes() for n in names)


def _values_at(axes: tuple[ResultAxis, ...], at: Sequence[int]) -> tuple[float, ...]:
    return tuple(float(axis.values[k]) for axis, k in zip(axes, at, strict=True))


def _flat_config(results: Results, which: str) -> dict[str, Any]:
    """Dotted key -> value."""
    try:
        document = tomllib.loads(results.config)
    except tomllib.TOMLDecodeError as error:
        raise ComparisonError(f"The config that {which} carries cannot be read as TOML ({error}).") from error
    return dict(_leaves(document, ()))


def _leaves(node: Any, place: tuple[str | int, ...]) -> Iterator[tuple[str, Any]]:
    if isinstance(node, dict | list) and node:
        for step, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from _leaves(value, (*place, step))
    else:
        yield dotted(place), node


# --- measurements against a map


@dataclass(frozen=True)
class Point:
    """A measured point and the cell nearest to it.

    values : of the measurement, in the results' axes' order and units; NaN on an axis of one value that has no column
    measured : label
    computed : label of the nearest cell, ``failed``, or None where the point lies outside the swept range
    cell : the nearest cell's values, None outside
    """

    values: tuple[float, ...]
    measured: str
    computed: str | None
    cell: tuple[float, ...] | None

    @property
    def counts(self) -> bool:
        """Whether there is something to compare with."""
        return self.computed is not None and self.computed != FAILED

    @property
    def agrees(self) -> bool:
        """Whether the labels are the same."""
        return self.counts and self.measured == self.computed


@dataclass(frozen=True)
class Tally:
    """Between how many neighbouring points the number of double-sided impacts rises, stays the same or falls."""

    rises: int
    same: int
    falls: int

    @property
    def direction(self) -> str:
        """In one word."""
        if self.rises and self.falls:
            return "varies"
        return "rises" if self.rises else "falls" if self.falls else "constant"


@dataclass(frozen=True)
class Trend:
    """How the number of double-sided impacts changes along one parameter, from each point to its neighbour.

    parameter, name, symbol : of the axis
    measured, computed : over the same pairs of neighbours
    alike : pairs in which both rise, both stay or both fall
    opposed : pairs in which one rises and the other falls
    """

    parameter: str
    name: str
    symbol: str
    measured: Tally
    computed: Tally
    alike: int
    opposed: int

    @property
    def pairs(self) -> int:
        """Neighbours that have a computed label."""
        return self.measured.rises + self.measured.same + self.measured.falls

    @property
    def share(self) -> float:
        """Pairs that are ordered alike over all; NaN without any."""
        return self.alike / self.pairs if self.pairs else math.nan


@dataclass(frozen=True, eq=False)
class ExperimentComparison:
    """Measurements against a map.

    title : of the results
    experiment : what was measured
    axes : the results'
    points : in the file's order
    trends : one for each axis of more than one value
    """

    title: str
    experiment: Experiment
    axes: tuple[ResultAxis, ...]
    points: tuple[Point, ...]
    trends: tuple[Trend, ...]

    @property
    def counted(self) -> int:
        """Points with a computed label."""
        return sum(point.counts for point in self.points)

    @property
    def agreeing(self) -> int:
        """Points whose labels are the same."""
        return sum(point.agrees for point in self.points)

    @property
    def share(self) -> float:
        """Agreeing points over counted ones; NaN without any."""
        return self.agreeing / self.counted if self.counted else math.nan

    @property
    def same_double_sided(self) -> int:
        """Counted points with the same number of double-sided impacts."""
        return sum(
            point.counts and double_sided(point.measured) == double_sided(str(point.computed)) for point in self.points
        )

    @property
    def outside(self) -> int:
        """Points more than half a cell outside the swept range."""
        return sum(point.computed is None for point in self.points)

    @property
    def failed(self) -> int:
        """Points whose nearest cell failed."""
        return sum(point.computed == FAILED for point in self.points)

    @property
    def same_regimes(self) -> bool:
        """Whether every point inside the swept range agrees; never if there is none."""
        return self.counted > 0 and self.agreeing == self.counted and not self.failed


def compare_experiment(results: Results, experiment: Experiment) -> ExperimentComparison:
    """Compare each measurement with the nearest cell of a map, and the two trends.

    Raises
    ------
    ExperimentError
        Where the measurements' columns are not the results' axes; an axis of one value needs no column.
    """
    variables = [axis.variable for axis in results.axes]
    swept = ", ".join(variables)
    for column in experiment.columns:
        if column not in variables:
            raise ExperimentError(
                f"The column {column} of {experiment.name} is no axis of the results, which sweep {swept}."
            )
    for axis in results.axes:
        if axis.variable not in experiment.columns and len(axis.values) > 1:
            raise ExperimentError(f"The results sweep {axis.parameter}, and {experiment.name} has no column for it.")
    points = tuple(_point(results, experiment.columns, found) for found in experiment.measurements)
    trends = tuple(_trend(axis, position, points) for position, axis in enumerate(results.axes) if len(axis.values) > 1)
    return ExperimentComparison(results.title, experiment, results.axes, points, trends)


def _point(results: Results, columns: tuple[str, ...], found: Measurement) -> Point:
    given = dict(zip(columns, found.values, strict=True))
    values = tuple(given.get(axis.variable, math.nan) for axis in results.axes)
    at = [
        _nearest(axis.values, value) if axis.variable in given else 0
        for axis, value in zip(results.axes, values, strict=True)
    ]
    if None in at:
        return Point(values, found.label, None, None)
    cell = cast("tuple[int, ...]", tuple(at))
    code = int(results.sequence[cell])
    computed = FAILED if code == FAILED_CODE else results.labels[code]
    return Point(values, found.label, computed, _values_at(results.axes, cell))


def _nearest(values: Floats, value: float) -> int | None:
    """Index of the nearest of an axis's values, in any order; None more than half a cell beyond the outermost.

    Near is meant on the axis's own scale, the logarithm where that is how the values are spaced.
    """
    ascending = np.sort(values)
    if len(values) == 1:  # no cell to be half of
        return 0 if math.isclose(value, values[0], rel_tol=1e-6, abs_tol=1e-12) else None
    if _is_geometric(ascending):
        if value <= 0.0:
            return None
        ascending, values, value = np.log(ascending), np.log(values), math.log(value)
    room = 1e-9 * (ascending[-1] - ascending[0])  # exactly half a cell is inside, whatever the rounding
    low = ascending[0] - 0.5 * (ascending[1] - ascending[0]) - room
    high = ascending[-1] + 0.5 * (ascending[-1] - ascending[-2]) + room
    return int(np.argmin(np.abs(values - value))) if low <= value <= high else None


def _is_geometric(ascending: Floats) -> bool:
    """Whether values are spaced evenly in their logarithm, and not in themselves."""
    if len(ascending) < 3 or ascending[0] <= 0.0:
        return False
    steps = np.diff(np.log(ascending))
    return bool(np.allclose(steps, steps.mean(), rtol=1e-6) and ascending[-1] / ascending[0] > 3.0)


def _trend(axis: ResultAxis, position: int, points: tuple[Point, ...]) -> Trend:
    """Neighbours are points that differ in this parameter only, with no measured point between them."""
    lines: dict[tuple[str, ...], dict[float, list[Point]]] = defaultdict(lambda: defaultdict(list))
    for point in points:
        # as text, so that NaN, a parameter that was not measured, is equal to itself
        others = tuple(repr(value) for k, value in enumerate(point.values) if k != position)
        lines[others][point.values[position]].append(point)
    changes = [
        (
            double_sided(second.measured) - double_sided(first.measured),
            double_sided(str(second.computed)) - double_sided(str(first.computed)),
        )
        for line in lines.values()
        for here, there in pairwise(sorted(line))
        for first in line[here]
        for second in line[there]
        if first.counts and second.counts
    ]
    signs = [(_sign(measured), _sign(computed)) for measured, computed in changes]
    return Trend(
        parameter=axis.parameter,
        name=axis.name,
        symbol=axis.symbol,
        measured=_tally([measured for measured, _ in signs]),
        computed=_tally([computed for _, computed in signs]),
        alike=sum(measured == computed for measured, computed in signs),
        opposed=sum(measured * computed < 0 for measured, computed in signs),
    )


def _sign(change: int) -> int:
    return (change > 0) - (change < 0)


def _tally(signs: list[int]) -> Tally:
    return Tally(signs.count(1), signs.count(0), signs.count(-1))


# --- for people and for scripts


def report(comparison: Comparison | ExperimentComparison, names: tuple[str, str] | None = None) -> str:
    """A comparison as text for 80 columns; `names` are what to call the two sides, for example their files."""
    if isinstance(comparison, Comparison):
        lines = [*_map_report(comparison, names or comparison.titles)]
    else:
        lines = [*_experiment_report(comparison, names or (comparison.title, comparison.experiment.name))]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def as_record(comparison: Comparison | ExperimentComparison) -> dict[str, Any]:
    """A comparison for JSON: numbers, text, lists and dictionaries, null in place of NaN."""
    record = _map_record(comparison) if isinstance(comparison, Comparison) else _experiment_record(comparison)
    return cast("dict[str, Any]", _plain(record))


def _map_report(comparison: Comparison, names: tuple[str, str]) -> Iterator[str]:
    for letter, name in zip("AB", names, strict=True):
        yield f"{letter}  {_cut(name, _WIDTH - 3)}"
    yield ""
    yield _regimes_sentence(comparison)
    failed = comparison.failed_in_a_only, comparison.failed_in_b_only, comparison.failed_in_both
    if any(failed):
        yield f"Failed, not compared: {failed[0]:,} cells in A only, {failed[1]:,} in B only, {failed[2]:,} in both."
    if comparison.identical:
        yield "All arrays are identical, bit for bit."
    yield from _transition_report(comparison)
    if 0 < comparison.differing <= _MOST_CELLS:
        yield ""
        yield from _table(
            [
                [*(axis.parameter for axis in comparison.axes), "A", "B"],
                *([*map(_number, cell.values), cell.a, cell.b] for cell in comparison.differing_cells()),
            ]
        )
    if comparison.deviation is not None and not comparison.identical:
        yield ""
        yield from _deviation_report(comparison.axes, comparison.deviation)
    yield ""
    yield from _config_report(comparison)


def _regimes_sentence(comparison: Comparison) -> str:
    if not comparison.cells:
        return "No cell has a label in both maps."
    if not comparison.differing:
        return f"The regimes are the same in all {comparison.cells:,} cells."
    differ = "differs" if comparison.differing == 1 else "differ"
    return (
        f"The regimes of {comparison.differing:,} of {comparison.cells:,} cells {differ} "
        f"({percent(comparison.differing, comparison.cells)})."
    )


def _transition_report(comparison: Comparison) -> Iterator[str]:
    if not comparison.transitions:
        return
    shown, rest = comparison.transitions[:_MOST_TRANSITIONS], comparison.transitions[_MOST_TRANSITIONS:]
    yield ""
    yield from _table(
        [["A", "B", "cells"], *([found.a, found.b, f"{found.cells:,}"] for found in shown)], right=(False, False, True)
    )
    if rest:
        yield f"  and {len(rest)} transitions more, {sum(found.cells for found in rest):,} cells"


def _deviation_report(axes: tuple[ResultAxis, ...], found: Deviation) -> Iterator[str]:
    name, unit = _SYMBOL[found.quantity]
    cells = "cell" if found.cells == 1 else "cells"
    yield f"{name}, B over A, in {found.cells:,} {cells} where neither is zero"
    if found.quantity != "severity":
        yield "  (in place of the severity Q, which is not defined in both)"
    yield f"  median {found.median:.4g}; 5 % to 95 % of the cells: {found.low:.4g} to {found.high:.4g}"
    for what, extreme, value in (
        ("furthest ratio", found.largest_ratio, f"{found.largest_ratio.ratio:.4g}"),
        ("largest difference", found.largest_difference, f"{found.largest_difference.difference:+.4g} {unit}"),
    ):
        yield f"  {what} {value}: {extreme.a:.5g} in A, {extreme.b:.5g} in B {unit}"
        yield _cut(f"    at {_where(axes, extreme.values)}", _WIDTH)
    if found.zero_in_one:
        cells = "cell" if found.zero_in_one == 1 else "cells"
        yield f"  {found.zero_in_one:,} {cells} more in which one of the two is zero"


def _config_report(comparison: Comparison) -> Iterator[str]:
    found = comparison.config_differences
    decides = "The configs' digests are the same" if comparison.configs_equal else "The configs differ"
    if not found:
        yield f"{decides}." if comparison.configs_equal else "The configs' texts are the same, their digests are not."
    else:
        keys = "1 key" if len(found) == 1 else f"{len(found)} keys"
        yield f"{decides}, but for {keys} that decide nothing:" if comparison.configs_equal else f"{decides} in {keys}:"
        absent = "(not given)"
        rows = [
            [each.key, *(absent if value is None else shorten(value, 60) for value in (each.a, each.b))]
            for each in found
        ]
        yield from _table([["key", "A", "B"], *rows])
    if comparison.provenance_differences:
        yield ""
        yield "Computed with or on other:"
        yield from _table(
            [["", "A", "B"], *([name, *both] for name, both in comparison.provenance_differences.items())]
        )


def _experiment_report(comparison: ExperimentComparison, names: tuple[str, str]) -> Iterator[str]:
    experiment = comparison.experiment
    yield f"computed  {_cut(names[0], _WIDTH - 10)}"
    yield f"measured  {_cut(names[1], _WIDTH - 10)}"
    yield from _wrapped(f"A {experiment.caveat}." if experiment.caveat == CAVEAT else f"{_capital(experiment.caveat)}.")
    yield ""
    yield _points_sentence(comparison)
    if comparison.counted:
        number = comparison.same_double_sided
        share = percent(number, comparison.counted)
        yield f"The number of double-sided impacts is the same at {number:,} of them ({share})."
    for count, what in (
        (comparison.outside, "outside the swept range"),
        (comparison.failed, "nearest to a failed cell"),
    ):
        if count:
            yield f"Not counted: {count:,} point{'' if count == 1 else 's'} {what}."
    yield ""
    yield from _table(
        [
            [*(axis.variable for axis in comparison.axes), "measured", "computed", ""],
            *(
                [
                    *map(_number, point.values),
                    point.measured,
                    "outside" if point.computed is None else point.computed,
                    "agrees" if point.agrees else "",
                ]
                for point in comparison.points
            ),
        ]
    )
    yield ""
    yield from _trend_report(comparison.trends)


def _points_sentence(comparison: ExperimentComparison) -> str:
    if not comparison.counted:
        return "No measured point lies where a label was computed."
    points = "point agrees" if comparison.counted == 1 else "points agree"
    return (
        f"{comparison.agreeing:,} of {comparison.counted:,} measured {points} with the nearest cell "
        f"({percent(comparison.agreeing, comparison.counted)})."
    )


def _trend_report(trends: tuple[Trend, ...]) -> Iterator[str]:
    yield "Number of double-sided impacts, from each measured point to the next"
    rows = []
    for trend in trends:
        label = f"{trend.name} {trend.symbol.split('=')[0].strip()}".strip()
        if not trend.pairs:
            rows.append([label, "0", "-", "-", "-", "-"])
            continue
        alike = f"{trend.alike} ({percent(trend.alike, trend.pairs)})"
        sides = [
            f"{tally.direction} ({tally.rises}, {tally.same}, {tally.falls})"
            for tally in (trend.measured, trend.computed)
        ]
        rows.append([label, str(trend.pairs), *sides, alike, str(trend.opposed)])
    yield from _table([["along", "pairs", "measured", "computed", "alike", "opposed"], *rows])
    yield "  (in brackets: pairs in which it rises, stays the same, falls)"


def _table(rows: list[list[str]], right: Sequence[bool] = ()) -> Iterator[str]:
    """Rows as columns two blanks apart, indented by two; the widest columns are cut until the table fits."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    while 2 + sum(widths) + 2 * (len(widths) - 1) > _WIDTH and max(widths) > 8:
        widths[widths.index(max(widths))] -= 1
    for row in rows:
        cells = [
            f"{_cut(cell, width):{'>' if k < len(right) and right[k] else '<'}{width}}"
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield ("  " + "  ".join(cells)).rstrip()


def _wrapped(text: str) -> Iterator[str]:
    line = ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > _WIDTH:
            yield line
            line = ""
        line = f"{line} {word}".strip()
    yield line


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".")


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.6g}"


def percent(part: int, whole: int) -> str:
    """A share in words that never says none or all where that is not so."""
    share = 100.0 * part / whole
    if 0 < share < 0.01:
        return "less than 0.01 %"
    if 99.99 < share < 100:
        return "more than 99.99 %"
    return f"{share:.2g} %" if share < 10 else f"{share:.4g} %" if share > 99 else f"{share:.3g} %"


def _where(axes: tuple[ResultAxis, ...], values: tuple[float, ...]) -> str:
    return ", ".join(f"{axis.parameter} = {_number(value)}" for axis, value in zip(axes, values, strict=True))


def _at(axes: tuple[ResultAxis, ...], values: tuple[float, ...]) -> dict[str, float]:
    return {axis.parameter: value for axis, value in zip(axes, values, strict=True)}


def _map_record(comparison: Comparison) -> dict[str, Any]:
    axes, found = comparison.axes, comparison.deviation
    deviation: dict[str, Any] | None = None
    if found is not None:
        deviation = {name: getattr(found, name) for name in ("quantity", "cells", "zero_in_one")}
        deviation["ratio"] = {"median": found.median, "quantile_5": found.low, "quantile_95": found.high}
        for name in ("largest_ratio", "largest_difference"):
            extreme: Extreme = getattr(found, name)
            deviation[name] = {
                "at": _at(axes, extreme.values),
                "a": extreme.a,
                "b": extreme.b,
                "ratio": extreme.ratio,
                "difference": extreme.difference,
            }
    return {
        "titles": {"a": comparison.titles[0], "b": comparison.titles[1]},
        "same_regimes": comparison.same_regimes,
        "identical": comparison.identical,
        "cells_compared": comparison.cells,
        "cells_differing": comparison.differing,
        "share_differing": comparison.share,
        "failed": {
            "a_only": comparison.failed_in_a_only,
            "b_only": comparison.failed_in_b_only,
            "both": comparison.failed_in_both,
        },
        "transitions": [asdict(found) for found in comparison.transitions],
        "deviation": deviation,
        "configs_equal": comparison.configs_equal,
        "config_differences": [asdict(each) for each in comparison.config_differences],
        "provenance_differences": {
            name: {"a": a, "b": b} for name, (a, b) in comparison.provenance_differences.items()
        },
        "differing_cells": [
            {"at": _at(axes, cell.values), "a": cell.a, "b": cell.b} for cell in comparison.differing_cells()
        ],
    }


def _experiment_record(comparison: ExperimentComparison) -> dict[str, Any]:
    axes = comparison.axes
    return {
        "title": comparison.title,
        "experiment": comparison.experiment.name,
        "caveat": comparison.experiment.caveat,
        "points_counted": comparison.counted,
        "points_agreeing": comparison.agreeing,
        "share_agreeing": comparison.share,
        "points_same_double_sided": comparison.same_double_sided,
        "same_regimes": comparison.same_regimes,
        "points_outside": comparison.outside,
        "points_failed": comparison.failed,
        "trends": [asdict(trend) | {"pairs": trend.pairs, "share_alike": trend.share} for trend in comparison.trends],
        "points": [
            {
                "at": _at(axes, point.values),
                "cell": None if point.cell is None else _at(axes, point.cell),
                "measured": point.measured,
                "computed": point.computed,
                "agrees": point.agrees,
            }
            for point in comparison.points
        ],
    }


def _plain(value: Any) -> Any:
    """What JSON can hold: None for NaN and infinities, text for dates and times."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
