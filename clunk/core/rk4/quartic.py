"""Zeros and extremes of a quartic on one time step.

On a linear regime one RK4 step of length s is x(s) = sum over k <= 4 of (sA)^k/k! x, so every linear functional of the
state (the gap, the contact force, an acceleration) is a quartic p(s) = c0 + c1 s + c2 s^2 + c3 s^3 + c4 s^4 in the
step's length. To locate an event is to find a zero of p, without another integration.
"""

from clunk.core.jit import part

Quartic = tuple[float, float, float, float, float]  # c0 to c4


@part
def evaluate(p: Quartic, s: float) -> float:
    """p(s) by Horner's rule."""
    return p[0] + s * (p[1] + s * (p[2] + s * (p[3] + s * p[4])))


@part
def bisect(p: Quartic, low: float, high: float) -> float:
    """Bisect a sign change of p between `low` and `high` down to neighbouring floating-point numbers.

    Returns the end on `low`'s side: p has not changed sign yet there.
    """
    negative = evaluate(p, high) < 0.0
    while high > 1e-40:  # far below any time scale of a driveline [s]
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if (evaluate(p, middle) < 0.0) == negative:
            high = middle
        else:
            low = middle
    return low


@part
def _most_change(p: Quartic, length: float) -> float:
    """Bound of |p(s) - p(0)| on [0, length]."""
    return length * (abs(p[1]) + length * (abs(p[2]) + length * (abs(p[3]) + length * abs(p[4]))))


@part
def stationary_points(p: Quartic, length: float) -> tuple[float, float, float]:
    """The points of (0, length) at which p' changes sign, in order.

    The zero of p''' cuts p'' into monotone pieces, and the zeros of p'' cut p' into monotone pieces. Where p' changes
    sign less than three times, each missing point repeats the one before, or is 0.
    """
    slope = p[1], 2.0 * p[2], 3.0 * p[3], 4.0 * p[4], 0.0
    if abs(slope[0]) > _most_change(slope, length):
        return 0.0, 0.0, 0.0
    bend, middle = (slope[1], 2.0 * slope[2], 3.0 * slope[3], 0.0, 0.0), length
    if slope[3] != 0.0:
        middle = -slope[2] / (3.0 * slope[3])
    if not 0.0 < middle < length:
        middle = length
    cut1 = _sign_change(bend, 0.0, middle, 0.0)
    cut2 = _sign_change(bend, middle, length, cut1)
    s1 = _sign_change(slope, 0.0, cut1, 0.0)
    s2 = _sign_change(slope, cut1, cut2, s1)
    return s1, s2, _sign_change(slope, cut2, length, s2)


@part
def _sign_change(p: Quartic, low: float, high: float, otherwise: float) -> float:
    """The zero between `low` and `high` of p, which is monotone there; `otherwise` if its sign does not change."""
    if high <= low or (evaluate(p, low) < 0.0) == (evaluate(p, high) < 0.0):
        return otherwise
    return bisect(p, low, high)


@part
def first_negative(p: Quartic, length: float) -> float:
    """The first s of [0, length] from which on p is negative, or -1 where there is none."""
    if p[0] < 0.0:
        return 0.0
    if p[0] > _most_change(p, length):
        return -1.0
    s1, s2, s3 = stationary_points(p, length)
    low = 0.0
    for high in (s1, s2, s3, length):
        if high > low and evaluate(p, high) < 0.0:
            return bisect(p, low, high)
        low = high
    return -1.0


@part
def extremes(p: Quartic, length: float) -> tuple[float, float]:
    """The largest and the smallest value of p on [0, length], both ends included."""
    end = evaluate(p, length)
    largest, smallest = max(p[0], end), min(p[0], end)
    for s in stationary_points(p, length):
        value = evaluate(p, s)
        largest, smallest = max(largest, value), min(smallest, value)
    return largest, smallest
