"""Crossings of straight lines with the boundaries of a map of two axes, many side by side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clunk.analysis.brackets import POINT, TOLERANCE, Codes, Floats, Points, narrow
from clunk.analysis.pointruns import RUN, RUN_FIELDS, Runs

Run = Callable[[Floats], Runs]  # of points (n, 2), on each axis from 0 to 1


def located(
    run: Run, low: Floats, high: Floats, below: Runs, above: Runs, tolerance: float = TOLERANCE
) -> tuple[Points, Points]:
    """Narrow brackets on straight lines between points (n, 2) of different labels, by default to 1e-9 of each axis.

    below, above : (n,) runs at these points

    The points that come back have the line's number as their cell, and the distance from its first end as their value.
    """
    lengths = np.hypot(*(high - low).T)
    steps = np.divide(high - low, lengths[:, None], out=np.zeros_like(low), where=lengths[:, None] > 0.0)

    def run_at(lines: Codes, distances: Floats) -> Points:
        return _points(lines, distances, run(low[lines] + distances[:, None] * steps[lines]))

    lines = np.arange(lengths.size)
    begin, end = _points(lines, np.zeros(lines.size), below), _points(lines, lengths, above)
    return narrow(begin, end, run_at, tolerance=tolerance)


def _points(lines: Codes, distances: Floats, runs: Runs) -> Points:
    points = np.zeros(lines.size, POINT)
    points["cell"], points["value"] = lines, distances
    for name in RUN_FIELDS:
        points[name] = runs[name]
    return points


def as_runs(points: Points) -> Runs:
    """The runs at some points."""
    runs = np.zeros(points.size, RUN)
    for name in RUN_FIELDS:
        runs[name] = points[name]
    return runs
