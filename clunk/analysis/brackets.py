"""Brackets: pairs of runs of different outcome, narrowed side by side, a batch of runs for each step.

What decides is the outcomes of a bracket's two ends. Where to look is said by a number of the runs (the margin, or how
much a severity exceeds its bound): where the line between the ends is zero, if it changes sign with them, and a little
towards the middle of that, as in the ITP method (Oliveira and Takahashi 2020, doi:10.1145/3423597); or, as the number
may jump where the outcome changes, where the line through the last two values on one side is zero. A bracket that these
do not narrow is halved now and then. Where further outcomes lie within a bracket, it becomes several.
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
_STALLED = 0.5  # of its width, which a bracket is expected to fall below
_SECANT, _EXTRAPOLATION, _MIDDLE = range(3)  # ways to expect a place
_SECANTS = 2  # stalls, after which others are taken in turn
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
    while len(ends):
        width, middle = ends["value"][:, 2] - ends["value"][:, 1], ends["value"][:, 1:3].mean(axis=1)
        wide = (width > tolerance) & (ends["value"][:, 1] < middle) & (middle < ends["value"][:, 2])
        narrowed.append(ends[~wide])
        ends, stalls, width = ends[wide], stalls[wide], width[wide]
        if not len(ends):
            break
        way = np.where(stalls < _SECANTS, _SECANT, _LATER[stalls % _LATER.size])
        place, is_expected = _expected(ends, way)
        values = _next(ends, place, is_expected, span, tolerance)
        chain = np.empty((len(ends), values.shape[1] + 4), POINT)
        chain[:, :2], chain[:, -2:] = ends[:, :2], ends[:, 2:]
        chain[:, 2:-2] = run(np.repeat(ends["cell"][:, 0], values.shape[1]), values.ravel()).reshape(values.shape)
        rows, at = np.nonzero(chain["outcome"][:, 1:-2] != chain["outcome"][:, 2:-1])
        ends = chain[rows[:, None], at[:, None] + np.arange(4)]
        is_stalled = ends["value"][:, 2] - ends["value"][:, 1] > _STALLED * width[rows]
        stalls = stalls[rows] + (is_stalled & is_expected[rows] | (way == _MIDDLE)[rows])
    ends = np.concatenate(narrowed)
    return ends[:, 1], ends[:, 2]


def _next(ends: Points, place: Floats, is_expected: Bools, span: float, tolerance: float) -> Floats:
    """Next values to run in each bracket, ascending: one beside the expected place, on the side of the middle.

    Where brackets are few, a run costs less than a batch, and there are further ones: evenly spaced, and in a geometric
    series on either side of the expected place, if there is one.
    """
    low, high = ends["value"][:, 1], ends["value"][:, 2]
    width, middle = high - low, 0.5 * (low + high)
    towards = np.sign(middle - place)
    nudge = np.minimum(np.maximum(0.2 / span * width**2, _BESIDE * tolerance), np.abs(place - middle))
    numbers = np.arange(min(_FEW // len(ends), _MOST_SPREAD))
    even = low[:, None] + width[:, None] * (numbers + 1) / (numbers.size + 1)
    nearest = _BESIDE * tolerance / width[:, None]
    beside = np.where(numbers % 4, 1.0, -1.0) * width[:, None] * nearest ** (1.0 - numbers / max(numbers.size, 1))
    near = place[:, None] + np.where(towards, towards, 1.0)[:, None] * beside
    is_near = is_expected[:, None] & (numbers % 2 == 0) & (low[:, None] < near) & (near < high[:, None])
    further = np.where(is_near, near, even)
    values: Floats = np.sort(np.column_stack([place + towards * nudge, further]), axis=1)
    return values


def _expected(ends: Points, way: Codes) -> tuple[Floats, Bools]:
    """Where the outcome is expected to change in each bracket, and whether that is more than its middle.

    By extrapolation from the end that is nearer to zero. Where that led to the bracket's other end, as its curve
    is bent, it is a tenth of the width before that.
    """
    values, measures = ends["value"], ends["measure"]
    low, width = values[:, 1], values[:, 2] - values[:, 1]
    side = 1 + np.argmin(np.abs(measures[:, 1:3]), axis=1)
    rows, before = np.arange(len(ends)), 3 * side - 3
    at, other = measures[rows, side], measures[rows, before]
    with np.errstate(invalid="ignore", divide="ignore"):
        ahead = at * np.abs(values[rows, side] - values[rows, before]) / (other - at)
        secant = low + width * measures[:, 1] / (measures[:, 1] - measures[:, 2])
    falls = (ends["outcome"][rows, before] == ends["outcome"][rows, side]) & (ahead > 0.0) & (way == _EXTRAPOLATION)
    ahead = np.where(ahead < width, ahead, 0.9 * width)
    extrapolated = np.where(side == 1, low + ahead, values[:, 2] - ahead)
    crosses = (measures[:, 1] * measures[:, 2] < 0.0) & (way == _SECANT)
    places = np.select([crosses, falls], [secant, extrapolated], low + 0.5 * width)
    return places, crosses | falls
