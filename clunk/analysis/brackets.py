"""Brackets: pairs of runs of different outcome, narrowed side by side, a batch of runs for each step.

What decides is the outcomes of a bracket's two ends; where a number of the runs (the margin, or how much a severity
exceeds its bound) changes sign with them, its line between the ends says where to look: the ITP method, which takes no
more steps than one beyond bisection (Oliveira and Takahashi 2020, doi:10.1145/3423597). Where further outcomes lie
within a bracket, it becomes several.
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
    steps = _steps(low, high, tolerance)
    narrowed = [(low[:0], high[:0])]
    while low.size:
        middle = _between(low, high, steps, tolerance, span)
        wide = (high["value"] - low["value"] > tolerance) & (low["value"] < middle) & (middle < high["value"])
        narrowed.append((low[~wide], high[~wide]))
        low, high, steps, middle = low[wide], high[wide], steps[wide], middle[wide]
        if not low.size:
            break
        values = np.sort(np.column_stack([middle, _spread(low, high)]), axis=1)
        runs = run(np.repeat(low["cell"], values.shape[1]), values.ravel()).reshape(values.shape)
        chain = np.column_stack([low, runs, high])
        apart = chain["outcome"][:, :-1] != chain["outcome"][:, 1:]
        low, high = chain[:, :-1][apart], chain[:, 1:][apart]
        steps = np.maximum(np.repeat(steps, apart.sum(axis=1)) - 1.0, _steps(low, high, tolerance) - 1.0)
    lows, highs = zip(*narrowed, strict=True)
    return np.concatenate(lows), np.concatenate(highs)


def _spread(low: Points, high: Points) -> Floats:
    """Further values to run in each bracket, evenly spaced: where brackets are few, a run costs less than a batch."""
    shares = np.arange(1, min(_FEW // low.size, _MOST_SPREAD) + 1)
    values: Floats = low["value"][:, None] + (high["value"] - low["value"])[:, None] * shares / (shares.size + 1)
    return values


def _steps(low: Points, high: Points, tolerance: float) -> Floats:
    """Steps in which brackets are to be narrow: one more than by bisection."""
    widths: Floats = np.maximum((high["value"] - low["value"]) / tolerance, 1.0)
    return np.ceil(np.log2(widths)) + 1.0


def _between(low: Points, high: Points, steps: Floats, tolerance: float, span: float) -> Floats:
    """Next value to run in each bracket by the ITP method: the middle, where no number changes sign within it."""
    width, middle = high["value"] - low["value"], 0.5 * (low["value"] + high["value"])
    at_low, at_high = low["measure"], high["measure"]
    crosses = at_low * at_high < 0.0
    share = np.divide(at_low, at_low - at_high, out=np.full(width.size, 0.5), where=crosses)
    away = low["value"] + share * width - middle  # of the line's zero
    nudge = np.maximum(0.2 / span * width**2, 0.5 * tolerance)
    away = np.sign(away) * np.maximum(np.abs(away) - nudge, 0.0)
    reach = np.maximum(0.5 * (tolerance * 2.0 ** (steps - 1.0) - width), 0.0)
    values: Floats = middle + np.clip(away, -reach, reach)
    return values
