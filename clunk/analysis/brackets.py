"""Brackets: pairs of runs of different outcome, narrowed side by side, a batch of runs for each step.

What decides is the outcomes of a bracket's two ends. Where to look is said by a number of the runs (the margin, or how
much a severity exceeds its bound), if it changes sign with them: where the inverse polynomial through the ends and the
last points beyond them is zero, as in Alefeld, Potra and Shi 1995 (doi:10.1145/210089.210111). As the number may belong
to another change, or jump at this one, a bracket that does not get narrow so is divided where the secant of either side
leads, and ever nearer to its middle.
Where further outcomes lie within a bracket, it becomes several.

It ends: a bracket that has stalled three times is divided in its middle, so that of three steps in a row one halves it
at least, and where a bracket becomes more than a number that is stated beforehand, those are given up as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Codes, Floats

Points = npt.NDArray[np.void]  # POINT

TOLERANCE = 1e-9  # of the span, the widest that a bracket ends by default
_FEW = 32  # runs, which take little longer than one
_MOST_SPREAD = 16  # of them in a bracket
_BESIDE = 0.45  # tolerances from the expected place, so that a bracket of two such values is narrow
_BENT = 0.2  # times the bracket's width squared, by which a secant may be off
_SURE = 100.0  # tolerances by which polynomials of two orders differ, where the place of the higher one is right
_MOST_STALLS = 3  # behind which a bracket is divided in its middle
_STALLED = 0.5  # of its width, which a bracket is expected to fall below
_NARROWED = 0.1  # of its width, below which the expected place was right
_FARTHEST = 0.8  # of a bracket, that a secant of one side is followed
_LEAST = 1e-6  # of a bracket, from its ends
_OUTER, _INNER = [0, 3], [1, 2]  # of a bracket's points: the two ends, and before and behind them
POINT = np.dtype([("cell", "i8"), ("value", "f8"), ("outcome", "i8"), ("measure", "f8"), ("touches", "i8")])


def narrow(
    ends: Points,
    run: Callable[[Codes, Floats], Generator[Any, Any, Points]],
    span: float = 1.0,
    tolerance: float = TOLERANCE,
    tolerance_of_failures: float = TOLERANCE,
    most: int | None = None,
    may_run: Callable[[], bool] = lambda: True,
) -> Generator[Any, Any, tuple[Points, Points]]:
    """Narrow brackets to a tolerance, as a share of the span; returns their lower and their upper ends, in no order.

    tolerance_of_failures : that of brackets of which one end is a run that failed
    most : that one of the brackets may become; those of one that becomes more are returned as wide as they are
    ends : (n, 4), at ascending values of one cell: the ends of a bracket, of different outcome, and before and behind
        these the next points that are known there, or once more the ends
    run : runs cells at values, (m,) each; what it yields is yielded
    may_run : asked before each batch; once it says no, all brackets are returned as wide as they are
    """
    tolerance, tolerance_of_failures = tolerance * span, tolerance_of_failures * span
    stalls, narrowed = np.zeros(len(ends), np.int64), [ends[:0]]
    origin, begun = np.arange(len(ends)), len(ends)  # of each bracket the one that it is a part of
    finished = np.zeros(begun, np.int64)  # parts of each
    while True:
        inner = ends["value"][:, 1:3]
        width, middle = inner[:, 1] - inner[:, 0], inner.mean(axis=1)
        has_failed = (ends["outcome"][:, 1:3] == FAILED_CODE).any(axis=1)
        wide = width > np.where(has_failed, tolerance_of_failures, tolerance)
        wide &= (inner[:, 0] < middle) & (middle < inner[:, 1]) & may_run()
        rest = np.flatnonzero(wide)  # `take` and `put` do with records in a tenth of the time what indexing does
        finished += np.bincount(origin[~wide], minlength=begun)
        crowded = finished + np.bincount(origin[rest], minlength=begun) > (most or np.inf)
        rest = rest[~crowded[origin[rest]]]
        narrowed.append(np.delete(ends, rest, axis=0))
        ends, stalls, width, origin = ends.take(rest, axis=0), stalls[rest], width[rest], origin[rest]
        if not len(ends):
            break
        values = _next(ends, stalls, span, tolerance)
        rows, columns = np.nonzero((ends["value"][:, 1:2] < values) & (values < ends["value"][:, 2:3]))
        points = np.zeros((len(ends), 4 + values.shape[1]), POINT)
        points["value"], begins = np.nan, points.shape[1] * np.arange(len(ends))
        points.put(begins[:, None] + np.arange(4), ends)
        points.put(begins[rows] + 4 + columns, (yield from run(ends["cell"][rows, 0], values[rows, columns])))
        points = points.take(begins[:, None] + np.argsort(points["value"], axis=1, kind="stable"))
        is_end = (points["outcome"][:, 1:-2] != points["outcome"][:, 2:-1]) & ~np.isnan(points["value"][:, 3:])
        rows, columns = np.nonzero(is_end)
        ends = points.take((begins[rows] + columns)[:, None] + np.arange(4))
        shrunk = (ends["value"][:, 2] - ends["value"][:, 1]) / width[rows]
        fewer = np.where(shrunk > _NARROWED, np.maximum(stalls[rows] - 1, 0), 0)
        stalls, origin = np.where(shrunk > _STALLED, stalls[rows] + 1, fewer), origin[rows]
    ends = np.concatenate(narrowed)
    return ends[:, 1], ends[:, 2]


def _next(ends: Points, stalls: Codes, span: float, tolerance: float) -> Floats:
    """Next values to run in each bracket, (n, m) with NaN for none.

    Two are on either side of the place that is expected, by as much as that may be off. Where there is no such place or
    the bracket has stalled, they are where the measure would be zero by the secants of either side; without these, or
    after more stalls, one is midway, by the geometric mean, between the place that the measures' sizes tell and the
    bracket's middle. Where brackets are few, so that a run costs less than a batch, there are further ones, evenly
    spaced.
    """
    low, width = ends["value"][:, 1], ends["value"][:, 2] - ends["value"][:, 1]
    sizes, alike = np.abs(ends["measure"]), ends["outcome"][:, _OUTER] == ends["outcome"][:, _INNER]
    falls = np.where(alike, sizes[:, _OUTER] - sizes[:, _INNER], 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = sizes[:, _INNER] / falls * np.abs(ends["value"][:, _OUTER] - ends["value"][:, _INNER])
        share = sizes[:, 1] / (sizes[:, 1] + sizes[:, 2])
    ahead = np.where(falls > 0.0, np.minimum(ahead, _FARTHEST * width[:, None]), np.nan)
    place, off = _expected(ends, span)
    # a measure that rises towards the bracket belongs to another change
    unknown = np.isnan(place) | (stalls > 0) | (falls < 0.0).any(axis=1)
    beside = np.maximum(np.where(off <= _SURE * tolerance, 0.0, off), _BESIDE * tolerance)
    first = np.where(unknown, low + ahead[:, 0], place - beside)
    second = np.where(unknown, low + width - ahead[:, 1], place + beside)
    divided = unknown & (np.isnan(ahead).all(axis=1) | (stalls > 1))
    share = np.clip(np.nan_to_num(share, nan=0.5), _LEAST, 1.0 - _LEAST)
    share = np.where(share < 0.5, np.sqrt(0.5 * share), 1.0 - np.sqrt(0.5 * (1.0 - share)))
    share[stalls >= _MOST_STALLS] = 0.5
    spread = min(_FEW // len(ends), _MOST_SPREAD)
    even = low[:, None] + width[:, None] * np.arange(1, spread + 1) / (spread + 1)
    return np.column_stack([first, second, np.where(divided, low + share * width, np.nan), even])


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
