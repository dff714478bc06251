"""Comparison of measured sequences of impacts with a map: the labels of the nearest cells, and the trends."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import cast

import numpy as np

from clunk.analysis.measurements import Experiment, ExperimentError, Measurement
from clunk.results.labels import FAILED, FAILED_CODE, double_sided
from clunk.results.maps import values_at
from clunk.results.regimemap import Results
from clunk.study.axes import ResultAxis


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
        """Whether the nearest cell has a label to compare with."""
        return self.computed is not None and self.computed != FAILED

    @property
    def agrees(self) -> bool:
        """Whether the labels are the same."""
        return self.counts and self.measured == self.computed


@dataclass(frozen=True)
class Tally:
    """Numbers of pairs of neighbours between which the number of double-sided impacts rises, stays or falls."""

    rises: int
    same: int
    falls: int

    @property
    def direction(self) -> str:
        """Direction in one word: rises, falls, varies or constant."""
        if self.rises and self.falls:
            return "varies"
        return "rises" if self.rises else "falls" if self.falls else "constant"


@dataclass(frozen=True)
class Trend:
    """Change of the number of double-sided impacts along one parameter, from each point to its neighbour.

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
        """Number of pairs of neighbours that have computed labels."""
        return self.measured.rises + self.measured.same + self.measured.falls

    @property
    def share(self) -> float:
        """Share of the pairs that are ordered alike; NaN without any."""
        return self.alike / self.pairs if self.pairs else math.nan


@dataclass(frozen=True, eq=False)
class ExperimentComparison:
    """Comparison of measurements with a map.

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
        """Number of points with a computed label."""
        return sum(point.counts for point in self.points)

    @property
    def agreeing(self) -> int:
        """Number of points whose labels are the same."""
        return sum(point.agrees for point in self.points)

    @property
    def share(self) -> float:
        """Share of the counted points that agree; NaN without any."""
        return self.agreeing / self.counted if self.counted else math.nan

    @property
    def same_double_sided(self) -> int:
        """Number of counted points with the same number of double-sided impacts."""
        return sum(
            point.counts and double_sided(point.measured) == double_sided(str(point.computed)) for point in self.points
        )

    @property
    def outside(self) -> int:
        """Number of points more than half a cell outside the swept range."""
        return sum(point.computed is None for point in self.points)

    @property
    def failed(self) -> int:
        """Number of points whose nearest cell failed."""
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
    points = tuple(_point(results, experiment.columns, measurement) for measurement in experiment.measurements)
    trends = tuple(_trend(axis, position, points) for position, axis in enumerate(results.axes) if len(axis.values) > 1)
    return ExperimentComparison(results.title, experiment, results.axes, points, trends)


def _point(results: Results, columns: tuple[str, ...], measurement: Measurement) -> Point:
    measured = dict(zip(columns, measurement.values, strict=True))
    values = tuple(measured.get(axis.variable, math.nan) for axis in results.axes)
    at = [
        _nearest(axis, value) if axis.variable in measured else 0
        for axis, value in zip(results.axes, values, strict=True)
    ]
    if None in at:
        return Point(values, measurement.label, None, None)
    cell = cast("tuple[int, ...]", tuple(at))
    code = int(results.sequence[cell])
    computed = FAILED if code == FAILED_CODE else results.labels[code]
    return Point(values, measurement.label, computed, values_at(results.axes, cell))


def _nearest(axis: ResultAxis, value: float) -> int | None:
    """Index of the nearest of an axis's values, in any order; None more than half a cell beyond the outermost.

    Near is meant on the axis's own scale, the logarithm where that is how the values are spaced.
    """
    values = axis.values
    ascending = np.sort(values)
    if len(values) == 1:  # no cell to be half of
        return 0 if math.isclose(value, values[0], rel_tol=1e-6, abs_tol=1e-12) else None
    if axis.is_geometric:
        if value <= 0.0:
            return None
        ascending, values, value = np.log(ascending), np.log(values), math.log(value)
    room = 1e-9 * (ascending[-1] - ascending[0])  # exactly half a cell is inside, whatever the rounding
    low = ascending[0] - 0.5 * (ascending[1] - ascending[0]) - room
    high = ascending[-1] + 0.5 * (ascending[-1] - ascending[-2]) + room
    return int(np.argmin(np.abs(values - value))) if low <= value <= high else None


def _trend(axis: ResultAxis, position: int, points: tuple[Point, ...]) -> Trend:
    """Trend between neighbours: points that differ in this parameter only, with no measured point between them."""
    lines: dict[tuple[str, ...], dict[float, list[Point]]] = defaultdict(lambda: defaultdict(list))
    for point in points:
        # as text, so that NaN, a parameter that was not measured, is equal to itself
        fixed = tuple(repr(value) for k, value in enumerate(point.values) if k != position)
        lines[fixed][point.values[position]].append(point)
    changes = [
        (
            double_sided(second.measured) - double_sided(first.measured),
            double_sided(str(second.computed)) - double_sided(str(first.computed)),
        )
        for line in lines.values()
        for lower, upper in pairwise(sorted(line))
        for first in line[lower]
        for second in line[upper]
        if first.counts and second.counts
    ]
    measured, computed = np.sign(np.array(changes, int)).reshape(-1, 2).T
    rises_same_falls = [[int((signs == way).sum()) for way in (1, 0, -1)] for signs in (measured, computed)]
    return Trend(
        parameter=axis.parameter,
        name=axis.name,
        symbol=axis.symbol,
        measured=Tally(*rises_same_falls[0]),
        computed=Tally(*rises_same_falls[1]),
        alike=int((measured == computed).sum()),
        opposed=int((measured * computed < 0).sum()),
    )
