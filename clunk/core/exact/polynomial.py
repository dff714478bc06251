"""The zeros and turning points of one polynomial of any degree: the Taylor series of a functional over a short span."""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import part

FloatArray = npt.NDArray[np.float64]


@part
def derivatives(c: FloatArray, count: int, s: float) -> tuple[float, float, float]:
    """Value, slope and half the second derivative of c[0] + c[1] s + ... + c[count - 1] s^(count - 1).

    By Horner's rule, even and odd powers side by side.
    """
    square = s * s
    even, odd = c[count - 1] if count % 2 else 0.0, 0.0
    even_slope, odd_slope, even_half, odd_half = 0.0, 0.0, 0.0, 0.0  # by s²
    for k in range(count // 2 - 1, -1, -1):
        even_half = even_half * square + even_slope
        odd_half = odd_half * square + odd_slope
        even_slope = even_slope * square + even
        odd_slope = odd_slope * square + odd
        even = even * square + c[2 * k]
        odd = odd * square + c[2 * k + 1]
    value = even + s * odd
    slope = odd + 2.0 * (s * even_slope + square * odd_slope)
    half = even_slope + 3.0 * s * odd_slope + 4.0 * square * (even_half + s * odd_half)
    return value, slope, half


@part
def zero_between(c: FloatArray, count: int, low: float, high: float, first: float, last: float) -> float:
    """The zero where a polynomial changes sign between `low` and `high`: Newton's steps, kept within the bracket.

    first, last : its values there
    """
    s = low + (high - low) * first / (first - last)
    for _ in range(200):
        value, slope, _ = derivatives(c, count, s)
        if (value >= 0.0) == (first >= 0.0):
            low = s
        else:
            high = s
        moved = s - value / slope if slope != 0.0 else low
        if low <= moved <= high:
            if abs(moved - s) <= 1e-8:  # squared by the step just made
                return moved
        else:
            moved = 0.5 * (low + high)
            if high - low <= 1e-16:
                return moved
        s = moved
    return s


@part
def sign_changes(c: FloatArray, count: int, length: float, points: FloatArray, ladder: FloatArray) -> int:
    """Write the points of (0, length) at which a polynomial changes sign to `points`, in order; return their number.

    Between the sign changes of its derivative it is monotone; where its lowest term outweighs all rest it has none.
    The derivatives' coefficients go into `ladder`, (count, count) at least.
    """
    highest_terms, power = 0.0, 1.0
    for k in range(1, count):
        power *= length
        highest_terms += abs(c[k]) * power
    if abs(c[0]) > highest_terms or count < 2:
        return 0
    _differentiate(c, count, ladder)
    pieces = sign_changes(ladder[count - 1], count - 1, length, points, ladder) + 1
    kept, low, before = 0, 0.0, c[0]
    for piece in range(pieces):
        high = points[piece] if piece < pieces - 1 else length
        after, _, _ = derivatives(c, count, high)
        if (before < 0.0) != (after < 0.0):
            points[kept] = zero_between(
                c, count, low, high, before, after
            )  # kept <= piece: nothing unread is overwritten
            kept += 1
        low, before = high, after
    return kept


@part
def turning_points(c: FloatArray, length: float, points: FloatArray, ladder: FloatArray) -> int:
    """Write the points of (0, length) at which the slope changes sign to `points`, in order; return their number."""
    _differentiate(c, c.size, ladder)
    return int(sign_changes(ladder[c.size - 1], c.size - 1, length, points, ladder))


@part
def _differentiate(c: FloatArray, count: int, ladder: FloatArray) -> None:
    """Write the coefficients of the derivative to row `count` - 1 of `ladder`."""
    for k in range(count - 1):
        ladder[count - 1, k] = (k + 1) * c[k + 1]


@part
def first_negative_of(c: FloatArray, length: float, points: FloatArray, ladder: FloatArray) -> float:
    """The first s of [0, length] from which on a polynomial is negative, or -1 where there is none."""
    if c[0] < 0.0:
        return 0.0
    return float(points[0]) if sign_changes(c, c.size, length, points, ladder) > 0 else -1.0
