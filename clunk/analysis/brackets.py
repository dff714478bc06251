"""Brackets: pairs of runs of different outcome, narrowed side by side, a batch of runs for each step.

What decides is the outcomes of a bracket's two ends. Where to look is said by a number of the runs (the margin, or how
much a severity exceeds its bound): if it changes sign with them, where the inverse polynomial through the ends and the
last points beyond them is zero, as in Alefeld, Potra and Shi 1995 (doi:10.1145/210089.210111); or, as the number may
jump where the outcome changes, where the line through the last two values on one side is zero. A bracket that these do
not narrow is halved now and then. Where further outcomes lie within a bracket, it becomes several.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Codes = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
Points = npt.NDArray[np.void]  # POINT

TOLERANCE = 1e-9  # of the span, the widest that a bracket ends by default
_FEW = 64  # runs, which take no longer than their batch
_MOST_SPREAD = 8
_BESIDE = 0.45  # tolerances from the expected place, so that a bracket of two such values is narrow
_BENT = 0.2  # times the bracket's width squared, by which a secant may be off
_SURE = 100.0  # tolerances by which polynomials of two orders differ, where the place of the higher one is right
_AHEAD = 0.1  # of the way to it, by which an extrapolated place may be off
_STRAIGHT = 300.0  # times that way, a share of it by which the place is off as it comes near
_STALLED = 0.5  # of its width, which a bracket is expected to fall below
_INTERPOLATION, _EXTRAPOLATION, _MIDDLE = range(3)  # ways to expect a place
_INTERPOLATIONS = 2  # stalls, after which others are taken in turn
_LATER = np.array([_MIDDLE, _EXTRAPOLATION, _EXTRAPOLATION])
POINT = np.dtype([("cell", "i8"), ("value", "f8"), ("outcome", "i8"), ("measure", "f8"), ("touches", "i8")])


def narrow(
    low: Points,
    high: Points,
    run: Callable[[Codes, Floats], Points],
    span: float = 1.0,
    tolerance: float = TOLERANCE,
) -> tuple[Points, Points]:
    """Narrow brackets to a tolerance, as a share of the span; returns their lower and their upper ends, in no order.

    low, high : (n,) ends of different outcome, of the same cell and at ascending values
    run : runs cells at values, (m,) each
    """
    tolerance *= span
    ends = np.stack([low, low, high, high], axis=1)  # each with the value before it on its side
    stalls, narrowed = np.zeros(low.size, np.int64), [ends[:0]]
    while True:
        inner = ends["value"][:, 1:3]
        width, middle = inner[:, 1] - inner[:, 0], inner.mean(axis=1)
        wide = (width > tolerance) & (inner[:, 0] < middle) & (middle < inner[:, 1])
        narrowed.append(ends[~wide])
        ends, stalls, width = ends[wide], stalls[wide], width[wide]
        if not len(ends):
            break
        way = np.where(stalls < _INTERPOLATIONS, _INTERPOLATION, _LATER[stalls % _LATER.size])
        values, is_expected = _next(ends, way, span, tolerance)
        rows, columns = np.nonzero((ends["value"][:, 1:2] < values) & (values < ends["value"][:, 2:3]))
        points = np.concatenate([ends.ravel(), run(ends["cell"][rows, 0], values[rows, columns])])
        owner = np.concatenate([np.repeat(np.arange(len(ends)), 4), rows])
        order = np.lexsort((points["value"], owner))
        points, owner = points[order], owner[order]
        at = np.flatnonzero((owner[:-3] == owner[3:]) & (points["outcome"][1:-2] != points["outcome"][2:-1]))
        ends, rows = points[at[:, None] + np.arange(4)], owner[at]
        is_stalled = ends["value"][:, 2] - ends["value"][:, 1] > _STALLED * width[rows]
        stalls = stalls[rows] + (is_stalled & is_expected[rows] | (way == _MIDDLE)[rows])
    ends = np.concatenate(narrowed)
    return ends[:, 1], ends[:, 2]


def _next(ends: Points, way: Codes, span: float, tolerance: float) -> tuple[Floats, Bools]:
    """Next values to run in each bracket, (n, m) with NaN for none, and whether a place is expected there.

    They are beside that place, by as much as it may be off: on the side of the middle or, where it is right or the
    measure jumps there, on both. Without such a place it is the middle. Where brackets are few, a run costs less than a
    batch, and there are further ones: evenly spaced, and in a geometric series on either side of the expected place.
    """
    low, high = ends["value"][:, 1], ends["value"][:, 2]
    width, middle = high - low, 0.5 * (low + high)
    interpolated, off = _interpolated(ends, span)
    extrapolated, ahead = _extrapolated(ends)
    crosses = (way == _INTERPOLATION) & (ends["measure"][:, 1] * ends["measure"][:, 2] < 0.0)
    falls = (way == _EXTRAPOLATION) & (ahead > 0.0)
    sure, is_expected = crosses & (off <= _SURE * tolerance), crosses | falls
    place = np.select([crosses, falls], [interpolated, extrapolated], middle)
    beside = np.select([sure, crosses, falls], [0.0, off, np.minimum(_AHEAD, _STRAIGHT / span * ahead) * ahead], 0.0)
    beside = np.minimum(np.maximum(beside, _BESIDE * tolerance), np.abs(place - middle))
    towards = np.where(place < middle, 1.0, -1.0)
    numbers = np.arange(1 + min(_FEW // len(ends), _MOST_SPREAD))
    even = low[:, None] + width[:, None] * (numbers + 1) / (numbers.size + 1)
    nearest = _BESIDE * tolerance / width[:, None]
    away = np.where(numbers % 4, 1.0, -1.0) * width[:, None] * nearest ** (1.0 - numbers / numbers.size)
    near = place[:, None] + towards[:, None] * away
    is_near = is_expected[:, None] & (numbers % 2 == 0) & (low[:, None] < near) & (near < high[:, None])
    values = np.where(is_near, near, even)
    values[is_expected, -1] = (place + towards * beside)[is_expected]
    return np.column_stack([values, np.where(sure | falls, place - towards * beside, np.nan)]), is_expected


def _extrapolated(ends: Points) -> tuple[Floats, Floats]:
    """Where the line through the last two values on the side nearer to zero is zero, and the way to there from the end.

    That is NaN where the two are of different outcome, and not positive where they rise. Where a bent curve led to the
    bracket's other end, it is a tenth of the width before that.
    """
    values, measures = ends["value"], ends["measure"]
    width, rows = values[:, 2] - values[:, 1], np.arange(len(ends))
    side = 1 + np.argmin(np.abs(measures[:, 1:3]), axis=1)
    before = 3 * side - 3
    at, other = measures[rows, side], measures[rows, before]
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = at * np.abs(values[rows, side] - values[rows, before]) / (other - at)
    ahead = np.where(ends["outcome"][rows, side] == ends["outcome"][rows, before], ahead, np.nan)
    ahead = np.where(ahead >= width, 0.9 * width, ahead)
    return np.where(side == 1, values[:, 1] + ahead, values[:, 2] - ahead), ahead


def _interpolated(ends: Points, span: float) -> tuple[Floats, Floats]:
    """Where the measure is zero by the polynomial of the highest order that is sound, and how far the next is off it.

    Its points are the bracket's ends and those beyond of the same outcome, between which the measure is monotonous.
    """
    values, outcome = ends["value"], ends["outcome"]
    rising = ends["measure"] * np.sign(ends["measure"][:, 2:3])
    place, off = _zero(ends, [1, 2]), _BENT / span * (values[:, 2] - values[:, 1]) ** 2
    left = (outcome[:, 0] == outcome[:, 1]) & (rising[:, 0] < rising[:, 1])
    right = (outcome[:, 2] == outcome[:, 3]) & (rising[:, 2] < rising[:, 3])
    for can_be, columns in ((left, [0, 1, 2]), (right, [1, 2, 3]), (left & right, [0, 1, 2, 3])):
        better = _zero(ends, columns)
        sound = can_be & (values[:, 1] < better) & (better < values[:, 2])
        with np.errstate(invalid="ignore"):
            off = np.where(sound, np.abs(better - place), off)
        place = np.where(sound, better, place)
    return place, off


def _zero(ends: Points, columns: list[int]) -> Floats:
    """Value at measure zero of the polynomial in the measure through these points of each bracket."""
    measures, total = ends["measure"], np.zeros(len(ends))
    with np.errstate(invalid="ignore", divide="ignore"):
        for i in columns:
            others = [j for j in columns if j != i]
            weights = [measures[:, j] / (measures[:, j] - measures[:, i]) for j in others]
            total += ends["value"][:, i] * np.prod(weights, axis=0)
    return total
