"""A quartic on one time step: where it turns negative, and its extremes.

On a linear regime one RK4 step of length s is x(s) = sum over k <= 4 of (sA)^k/k! x, so every linear functional of the
state (the gap, the contact force, an acceleration) is a quartic p(s) = c0 + c1 s + c2 s^2 + c3 s^3 + c4 s^4 in the
step's length. Finding an event is finding a zero of p, without integrating anything again.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import part

FloatArray = npt.NDArray[np.float64]


@part
def evaluate(c0: float, c1: float, c2: float, c3: float, c4: float, s: float) -> float:
    """p(s) by Horner's rule."""
    return c0 + s * (c1 + s * (c2 + s * (c3 + s * c4)))


@part
def bisect(c0: float, c1: float, c2: float, c3: float, c4: float, low: float, high: float) -> float:
    """Bisect a sign change of p between `low` and `high` down to neighbouring floating-point numbers.

    Returns the end on `low`'s side: p has not changed sign yet there.
    """
    negative = evaluate(c0, c1, c2, c3, c4, high) < 0.0
    for _ in range(1100):  # halving reaches neighbours in about 60 steps; a zero at `low` = 0 takes down to denormals
        middle = 0.5 * (low + high)
        if middle <= low or middle >= high:
            break
        if (evaluate(c0, c1, c2, c3, c4, middle) < 0.0) == negative:
            high = middle
        else:
            low = middle
        if high < 1e-40:  # far below any time scale of a driveline [s]
            break
    return low


@part
def stationary_points(c1: float, c2: float, c3: float, c4: float, length: float) -> tuple[float, float, float]:
    """The points of (0, length) at which p' changes sign, in order.

    The zeros of p'' in closed form cut p' into monotone pieces, each with at most one zero. One that there
    is not is the one before, or 0.
    """
    d2, d3, d4 = 2.0 * c2, 3.0 * c3, 4.0 * c4  # p' = c1 + d2 s + d3 s^2 + d4 s^3
    if abs(c1) > length * (abs(d2) + length * (abs(d3) + length * abs(d4))):
        return 0.0, 0.0, 0.0
    cut1, cut2 = _quadratic_roots(d2, 2.0 * d3, 3.0 * d4, length)
    s1 = _sign_change(c1, d2, d3, d4, 0.0, cut1, 0.0)
    s2 = _sign_change(c1, d2, d3, d4, cut1, cut2, s1)
    return s1, s2, _sign_change(c1, d2, d3, d4, cut2, length, s2)


@part
def _sign_change(c0: float, c1: float, c2: float, c3: float, low: float, high: float, otherwise: float) -> float:
    """Where a cubic that is monotone between two places changes its sign there."""
    if high <= low or (evaluate(c0, c1, c2, c3, 0.0, low) < 0.0) == (evaluate(c0, c1, c2, c3, 0.0, high) < 0.0):
        return otherwise
    return bisect(c0, c1, c2, c3, 0.0, low, high)


@part
def _quadratic_roots(a0: float, a1: float, a2: float, length: float) -> tuple[float, float]:
    """The two zeros of a0 + a1 s + a2 s^2, in order; one that is not in (0, length) is replaced by `length`."""
    first, second = length, length
    if a2 == 0.0:
        if a1 != 0.0:
            first = -a0 / a1
    else:
        discriminant = a1 * a1 - 4.0 * a2 * a0
        if discriminant > 0.0:
            root = discriminant**0.5
            far = -0.5 * (a1 + root) if a1 >= 0.0 else -0.5 * (a1 - root)  # no cancellation
            first = far / a2
            if far != 0.0:
                second = a0 / far
    if not 0.0 < first < length:
        first = length
    if not 0.0 < second < length:
        second = length
    return min(first, second), max(first, second)


@part
def first_negative(c0: float, c1: float, c2: float, c3: float, c4: float, length: float) -> float:
    """The first s of [0, length] from which on p is negative, or -1 where there is none."""
    if c0 < 0.0:
        return 0.0
    if c0 > length * (abs(c1) + length * (abs(c2) + length * (abs(c3) + length * abs(c4)))):
        return -1.0
    s1, s2, s3 = stationary_points(c1, c2, c3, c4, length)
    low = 0.0
    for high in (s1, s2, s3, length):
        if high > low and evaluate(c0, c1, c2, c3, c4, high) < 0.0:
            return bisect(c0, c1, c2, c3, c4, low, high)
        low = high
    return -1.0


@part
def extremes(c0: float, c1: float, c2: float, c3: float, c4: float, length: float) -> tuple[float, float]:
    """The largest and the smallest value of p on [0, length], both ends included."""
    end = evaluate(c0, c1, c2, c3, c4, length)
    largest, smallest = max(c0, end), min(c0, end)
    s1, s2, s3 = stationary_points(c1, c2, c3, c4, length)
    for s in (s1, s2, s3):
        value = evaluate(c0, c1, c2, c3, c4, s)
        largest, smallest = max(largest, value), min(smallest, value)
    return largest, smallest
