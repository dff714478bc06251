"""Comparison of measured sequences of impacts with a map: the labels of the nearest cells, and the trends."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from clunk.analysis.measurements import Experiment, Measurement
from clunk.results.labels import FAILED, double_sided
from clunk.results.maps import Results, at_cell, values_at
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError
from clunk.study.records import SENTENCE, Record, tells, told


@dataclass(frozen=True)
class Point(Record):
    """A measured point and the cell nearest to it.

    at : parameter -> measured value; NaN on an axis of one value that has no column
    measured : label
    computed : label of the nearest cell, ``failed``, or None where the point lies outside the swept range
    cell : the nearest cell's parameters, None outside
    """

    at: dict[str, float] = told("at")
    measured: str = told("measured")
    computed: str | None = told("computed")
    cell: dict[str, float | str] | None = told()

    @property
    def values(self) -> tuple[float, ...]:
        """The measured values, in the order of the results' axes."""
        return tuple(self.at.values())

    @property
    def counts(self) -> bool:
        """Whether the nearest cell has a label to compare with."""
        return self.computed is not None and self.computed != FAILED

    @property
    @tells("agrees")
    def agrees(self) -> bool:
        """Whether the labels are the same."""
        return self.counts and self.measured == self.computed


@dataclass(frozen=True)
class Trend(Record):
    """Change of the number of double-sided impacts along one parameter, from each point to its neighbour.

    parameter, symbol : of the axis
    measured, computed : numbers of pairs of neighbours between which it rises, stays and falls, over the same pairs
    alike : pairs in which both rise, both stay or both fall
    opposed : pairs in which one rises and the other falls
    """

    parameter: str = told("along")
    symbol: str = told()
    measured: tuple[int, ...] = told("measured")
    computed: tuple[int, ...] = told("computed")
    alike: int = told("alike")
    opposed: int = told("opposed")

    @property
    @tells("pairs")
    def pairs(self) -> int:
        """Number of pairs of neighbours that have computed labels."""
        return sum(self.measured)


@dataclass(frozen=True, eq=False, repr=False)
class ExperimentComparison(Record):
    """Comparison of measurements with a map.

    experiment : what was measured
    axes : the results'
    title : of the results
    points : in the file's order
    trends : one for each axis of more than one value
    """

    experiment: Experiment
    axes: tuple[ResultAxis, ...]
    title: str = told()
    points: tuple[Point, ...] = told("measured points")
    trends: tuple[Trend, ...] = told("double-sided impacts from a point to the next: pairs where they rise, stay, fall")

    @property
    @tells(SENTENCE)
    def caveat(self) -> str:
        """What keeps the measurements from being a test of the model."""
        return self.experiment.caveat

    @property
    @tells(key="experiment")
    def experiment_name(self) -> str:
        """Name of the file of the measurements."""
        return self.experiment.name

    @property
    @tells("points with a computed label", key="points_counted")
    def counted(self) -> int:
        """Number of points with a computed label."""
        return sum(point.counts for point in self.points)

    @property
    @tells("labels agree at", key="points_agreeing")
    def agreeing(self) -> int:
        """Number of points whose labels are the same."""
        return sum(point.agrees for point in self.points)

    @property
    @tells("double-sided impacts agree at", key="points_same_double_sided")
    def same_double_sided(self) -> int:
        """Number of counted points with the same number of double-sided impacts."""
        return sum(
            point.counts and double_sided(point.measured) == double_sided(str(point.computed)) for point in self.points
        )

    @property
    @tells("outside the swept range", key="points_outside")
    def outside(self) -> int:
        """Number of points outside the swept range."""
        return sum(point.computed is None for point in self.points)

    @property
    @tells("nearest to a failed cell", key="points_failed")
    def failed(self) -> int:
        """Number of points whose nearest cell failed."""
        return sum(point.computed == FAILED for point in self.points)

    @property
    @tells()
    def same_regimes(self) -> bool:
        """Whether every point inside the swept range agrees; never if there is none."""
        return self.counted > 0 and self.agreeing == self.counted and not self.failed


def compare_experiment(results: Results, experiment: Experiment) -> ExperimentComparison:
    """Compare each measurement with the nearest cell of a map, and the two trends.

    Raises
    ------
    ClunkError
        Where the measurements' columns are not the results' axes; an axis of one value needs no column.
    """
    variables = [axis.variable for axis in results.axes]
    swept = ", ".join(variables)
    for column in experiment.columns:
        if column not in variables:
            raise ClunkError(
                f"The column {column} of {experiment.name} is no axis of the results, which sweep {swept}."
            )
    for axis in results.axes:
        if axis.variable not in experiment.columns and len(axis.values) > 1:
            raise ClunkError(f"The results sweep {axis.parameter}, and {experiment.name} has no column for it.")
    points = tuple(_point(results, experiment.columns, measurement) for measurement in experiment.measurements)
    trends = tuple(_trend(axis, position, points) for position, axis in enumerate(results.axes) if len(axis.values) > 1)
    return ExperimentComparison(experiment, results.axes, results.title, points, trends)


def _point(results: Results, columns: tuple[str, ...], measurement: Measurement) -> Point:
    measured = dict(zip(columns, measurement.values, strict=True))
    values = {axis.parameter: measured.get(axis.variable, math.nan) for axis in results.axes}
    try:
        cell = tuple(axis.nearest(measured.get(axis.variable, axis.values[0])) for axis in results.axes)
    except ValueError:  # beyond an axis
        return Point(values, measurement.label, None, None)
    computed = str((*results.labels, FAILED)[results.sequence[cell]])  # the code of failed cells, -1, is the last
    return Point(values, measurement.label, computed, at_cell(results.axes, values_at(results.axes, cell)))


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
    tallies = [tuple(int((signs == way).sum()) for way in (1, 0, -1)) for signs in (measured, computed)]
    return Trend(
        parameter=axis.parameter,
        symbol=axis.symbol,
        measured=tallies[0],
        computed=tallies[1],
        alike=int((measured == computed).sum()),
        opposed=int((measured * computed < 0).sum()),
    )
