"""Crossings of straight lines with the boundaries of a map of two axes, many side by side."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from clunk.analysis.brackets import POINT, TOLERANCE, Points, narrow
from clunk.analysis.pointruns import RUN, RUN_FIELDS, Runs
from clunk.analysis.searches import Search
from clunk.study.arrays import Codes, Floats

_MOST = 8  # crossings on a line that are told apart
_ONCE_MORE = [0, 0, 1, 1]


class Crossings(NamedTuple):
    """Crossings in the order of their lines and along these: the lines' numbers, brackets (n, 2, 2), runs (n, 2)."""

    lines: Codes
    brackets: Floats
    runs: Runs

    @property
    def places(self) -> Floats:
        """Middles of the brackets, (n, 2)."""
        places: Floats = self.brackets.mean(axis=1)
        return places


def located(
    places: Floats, runs: Runs, tolerance: float = TOLERANCE, *, runs_left: Callable[[], int]
) -> Search[Crossings]:
    """Locate crossings on straight lines between points of different labels, by default to 1e-9 of each axis.

    Where there are more than `_MOST` on a line, or no runs are left, their brackets stay wide.

    places, runs : (n, 2, 2) points and (n, 2) their runs; or (n, 4, 2) and (n, 4), with further points on these lines
        before and behind them, or once more the ends
    """
    if runs.shape[1] == 2:
        places, runs = places[:, _ONCE_MORE], runs[:, _ONCE_MORE]
    begin, steps = places[:, 1], places[:, 2] - places[:, 1]
    lengths = np.hypot(*steps.T)[:, None]
    steps = np.divide(steps, lengths, out=np.zeros_like(steps), where=lengths > 0.0)

    def run_at(lines: Codes, distances: Floats) -> Search[Points]:
        return _points(lines, distances, (yield begin[lines] + distances[:, None] * steps[lines]))

    distances = ((places - begin[:, None]) * steps[:, None]).sum(axis=2)
    distances[:, 2] = lengths[:, 0]
    lines = np.broadcast_to(np.arange(len(runs))[:, None], runs.shape)
    low, high = yield from narrow(
        _points(lines, distances, runs), run_at, tolerance=tolerance, most=_MOST, may_run=lambda: runs_left() > 0
    )
    order = np.lexsort((low["value"], low["cell"]))
    ends = np.stack([low, high], axis=1).take(order, axis=0)
    lines, narrowed = ends["cell"][:, 0], np.zeros(ends.shape, RUN)
    for name in RUN_FIELDS:
        narrowed[name] = ends[name]
    return Crossings(lines, begin[lines, None] + ends["value"][..., None] * steps[lines, None], narrowed)


def _points(lines: Codes, distances: Floats, runs: Runs) -> Points:
    points = np.zeros(lines.shape, POINT)
    points["cell"], points["value"] = lines, distances
    for name in RUN_FIELDS:
        points[name] = runs[name]
    return points
