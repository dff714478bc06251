"""Searches for the values at which an outcome of runs changes, in many cells side by side, a batch of runs a step.

A cell is whatever the runs differ in besides: a driveline, a line across a map. Known points of each, in the order of
their values, are looked through (`with_hidden`): where outcomes may change and change back between two of them, further
ones are run. Between neighbours of different outcome lies a bracket (`brackets`), which is narrowed (`narrow`).

What decides is the outcomes of a bracket's two ends. Where to look is said by a number of the runs (the margin, or how
much a severity exceeds its bound), if it changes sign with them: where the inverse polynomial through the ends and the
last points beyond them is zero, as in Alefeld, Potra and Shi 1995 (doi:10.1145/210089.210111). As the number may belong
to another change, or jump at this one, a bracket that has not been halved so is halved next.
Where further outcomes lie within a bracket, it becomes several.

It ends: of two steps in a row one halves a bracket at least, and where a bracket becomes more than a number that is
stated beforehand, those are given up as they are. Between two points `_LOOKED` runs at most look for what is hidden.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Bools, Codes, Floats

# A run of a cell at a value: the code of its outcome, a number that changes sign where that does, NaN where none is
# known, and its number of touches.
POINT = np.dtype([("cell", "i8"), ("value", "f8"), ("outcome", "i8"), ("measure", "f8"), ("touches", "i8")])
Points = npt.NDArray[np.void]  # POINT
Run = Callable[[Codes, Floats], Points]  # runs cells at values, (n,) each; these need not be in its points

TOLERANCE = 1e-9  # of the span, the widest that a bracket ends by default
TOUCHES_OF_A_RUN = 50  # for so many more touches a run counts as one more run
_TOUCHES = 2  # by which neighbours differ where something may be hidden between them
_STEEPER = 2.0  # than between known values, as the number of the runs may fall between them
_LOOKED = 64  # runs between two points that look for what is hidden, but for those of the last halving
_BESIDE = 0.45  # tolerances from the expected place, so that a bracket of two such values is narrow
_BENT = 0.2  # times the bracket's width squared, by which a secant may be off
_SURE = 100.0  # tolerances by which polynomials of two orders differ, where the place of the higher one is right
_STALLED = 0.5  # of its width, which a bracket is expected to fall below


def with_hidden(
    points: Points, run: Run, halvings: int, may_run: Callable[[], bool] = lambda: True
) -> tuple[Points, Codes]:
    """Points (n,) and further ones where other outcomes may be hidden between two of them, in the same order.

    points : in the order of cells and, in each, of values
    halvings : of the spacing between two points
    may_run : asked before each batch

    Also returns the number of the point at or before each, (m,).
    """
    before, looked = np.arange(points.size), np.zeros(points.size, np.int64)
    for _ in range(halvings):
        between = np.flatnonzero(_may_hide(points))
        between = between[looked[before[between]] < _LOOKED]
        if not between.size or not may_run():
            break
        cells, middles = points["cell"][between], 0.5 * (points["value"][between] + points["value"][between + 1])
        runs = run(cells, middles)
        runs["cell"], runs["value"] = cells, middles
        np.add.at(looked, before[between], 1 + np.maximum(runs["touches"], 0) // TOUCHES_OF_A_RUN)
        points, before = np.insert(points, between + 1, runs), np.insert(before, between + 1, before[between])
    return points, before


def _may_hide(points: Points) -> Bools:
    """Whether thresholds may be hidden between each point and the next, of one cell and of the same outcome."""
    left, right = points[:-1], points[1:]
    alike = (left["cell"] == right["cell"]) & (left["outcome"] == right["outcome"]) & (left["outcome"] != FAILED_CODE)
    hidden = np.abs(right["touches"] - left["touches"]) >= _TOUCHES
    width, least = right["value"] - left["value"], np.abs(points["measure"])
    slope = np.abs(np.diff(least)) / width
    # whatever the signs: across a sliver a margin may pass from what did not happen to what did
    is_dip = alike[:-1] & alike[1:] & (least[1:-1] <= np.minimum(least[:-2], least[2:]))
    slope = _STEEPER * np.maximum(slope[:-1], slope[1:])
    hidden[:-1] |= is_dip & (least[1:-1] < slope * width[:-1])
    hidden[1:] |= is_dip & (least[1:-1] < slope * width[1:])
    suspect: Bools = alike & hidden
    return suspect


def brackets(points: Points) -> Points:
    """Brackets as `narrow` takes them, (n, 4), between neighbours whose outcomes differ.

    points : in the order of cells and, in each, of values
    """
    apart = (points["cell"][:-1] == points["cell"][1:]) & (points["outcome"][:-1] != points["outcome"][1:])
    at = np.flatnonzero(apart)
    around = np.clip(at[:, None] + np.arange(-1, 3), 0, points.size - 1)
    around = np.where(points["cell"][around] == points["cell"][at, None], around, at[:, None] + [0, 0, 1, 1])
    return points[around]


def narrow(
    ends: Points,
    run: Run,
    span: float = 1.0,
    tolerance: float = TOLERANCE,
    tolerance_of_failures: float = TOLERANCE,
    most: int | None = None,
    may_run: Callable[[], bool] = lambda: True,
) -> tuple[Points, Points]:
    """Narrow brackets to a tolerance, as a share of the span; returns their lower and their upper ends, in no order.

    tolerance_of_failures : that of brackets of which one end is a run that failed
    most : that one of the brackets may become; those of one that becomes more are returned as wide as they are
    ends : (n, 4), at ascending values of one cell: the ends of a bracket, of different outcome, and before and behind
        these the next points that are known there, or once more the ends
    may_run : asked before each batch; once it says no, all brackets are returned as wide as they are
    """
    tolerance, tolerance_of_failures = tolerance * span, tolerance_of_failures * span
    is_slow, narrowed = np.zeros(len(ends), bool), [ends[:0]]
    origin, begun = np.arange(len(ends)), len(ends)  # of each bracket the one that it is a part of
    finished = np.zeros(begun, np.int64)  # parts of each
    while True:
        low, high = ends["value"][:, 1], ends["value"][:, 2]
        width, middle = high - low, 0.5 * (low + high)
        has_failed = (ends["outcome"][:, 1:3] == FAILED_CODE).any(axis=1)
        wide = width > np.where(has_failed, tolerance_of_failures, tolerance)
        wide &= (low < middle) & (middle < high) & may_run()
        rest = np.flatnonzero(wide)  # `take` and `put` do with records in a tenth of the time what indexing does
        finished += np.bincount(origin[~wide], minlength=begun)
        crowded = finished + np.bincount(origin[rest], minlength=begun) > (most or np.inf)
        rest = rest[~crowded[origin[rest]]]
        narrowed.append(np.delete(ends, rest, axis=0))
        ends, is_slow, width, origin = ends.take(rest, axis=0), is_slow[rest], width[rest], origin[rest]
        if not len(ends):
            break
        place, off = _expected(ends, span)
        beside = np.maximum(np.where(off <= _SURE * tolerance, 0.0, off), _BESIDE * tolerance)
        values = place[:, None] + beside[:, None] * [-1.0, 1.0]
        halved = is_slow | np.isnan(place)
        values[halved] = middle[rest][halved, None] * [1.0, np.nan]
        rows, columns = np.nonzero((ends["value"][:, 1:2] < values) & (values < ends["value"][:, 2:3]))
        cells, new = ends["cell"][rows, 0], values[rows, columns]
        runs = run(cells, new)
        runs["cell"], runs["value"] = cells, new
        points = np.zeros((len(ends), 6), POINT)
        points["value"], begins = np.nan, 6 * np.arange(len(ends))
        points.put(begins[:, None] + np.arange(4), ends)
        points.put(begins[rows] + 4 + columns, runs)
        points = points.take(begins[:, None] + np.argsort(points["value"], axis=1, kind="stable"))
        is_end = (points["outcome"][:, 1:-2] != points["outcome"][:, 2:-1]) & ~np.isnan(points["value"][:, 3:])
        rows, columns = np.nonzero(is_end)
        ends = points.take((begins[rows] + columns)[:, None] + np.arange(4))
        is_slow = ends["value"][:, 2] - ends["value"][:, 1] > _STALLED * width[rows]
        origin = origin[rows]
    ends = np.concatenate(narrowed)
    return ends[:, 1], ends[:, 2]


def _expected(ends: Points, span: float) -> tuple[Floats, Floats]:
    """Value at which the measure is expected to be zero, and how far that may be off, (n,) each.

    It is that of the polynomial of the highest order that is sound, which may be off by as much as that of the next
    order is from it. The polynomial's points are the bracket's ends and those beyond of the same outcome, between which
    the measure is monotonous; it is a polynomial in the measure, by Neville's scheme. NaN where the measure has one
    sign.
    """
    values, measures, outcome = (np.ascontiguousarray(ends[name].T) for name in ("value", "measure", "outcome"))

    def zero(first: int, last: int, without_last: Floats, without_first: Floats) -> Floats:
        """Value at measure zero of the polynomial through points first to last, by those of one point less."""
        at: Floats = (measures[last] * without_last - measures[first] * without_first) / (
            measures[last] - measures[first]
        )
        return at

    with np.errstate(invalid="ignore", divide="ignore"):
        before, place, after = (zero(k, k + 1, values[k], values[k + 1]) for k in range(3))
        left, right = zero(0, 2, before, place), zero(1, 3, place, after)
        steps = np.diff(measures, axis=0) * np.sign(measures[2] - measures[1])
        rises = (steps > 0.0) & (outcome[:-1] == outcome[1:])
        off = _BENT / span * (values[2] - values[1]) ** 2
        for can_be, better in (
            (rises[0], left),
            (rises[2], right),
            (rises[0] & rises[2], zero(0, 3, left, right)),
        ):
            sound = can_be & (values[1] <= better) & (better <= values[2])
            off = np.where(sound, np.abs(better - place), off)
            place = np.where(sound, better, place)
        crosses = (measures[1] * measures[2] <= 0.0) & (measures[1] != measures[2])
    return np.where(crosses, place, np.nan), np.where(crosses, off, np.nan)
