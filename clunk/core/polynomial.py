"""A quartic on one time step: where it turns negative, and its extremes.

On a linear regime one RK4 step of length s is x(s) = sum over k <= 4 of (sA)^k/k! x, so every linear functional of the
state (the gap, the contact force, an acceleration) is a quartic p(s) = c0 + c1 s + c2 s^2 + c3 s^3 + c4 s^4 in the
step's length. Finding an event is finding a zero of p, without integrating anything again.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled, unowned, unowned_inlined

FloatArray = npt.NDArray[np.float64]


@compiled
def evaluate(c0: float, c1: float, c2: float, c3: float, c4: float, s: float) -> float:
    """p(s) by Horner's rule."""
    return c0 + s * (c1 + s * (c2 + s * (c3 + s * c4)))


@compiled
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


@compiled
def stationary_points(c1: float, c2: float, c3: float, c4: float, length: float) -> tuple[int, float, float, float]:
    """The points of (0, length) at which p' changes sign, in order.

    The zeros of p'' in closed form cut p' into monotone pieces, each with at most one zero.

    Returns
    -------
    count, s1, s2, s3 : int and three floats, those beyond `count` equal to `length`
    """
    d2, d3, d4 = 2.0 * c2, 3.0 * c3, 4.0 * c4  # p' = c1 + d2 s + d3 s^2 + d4 s^3
    if abs(c1) > length * (abs(d2) + length * (abs(d3) + length * abs(d4))):
        return 0, length, length, length
    cut1, cut2 = _quadratic_roots(d2, 2.0 * d3, 3.0 * d4, length)
    count = 0
    found1, found2, found3 = length, length, length
    low = 0.0
    value_low = c1
    for piece in range(3):
        high = cut1 if piece == 0 else (cut2 if piece == 1 else length)
        if high <= low:
            continue
        value_high = evaluate(c1, d2, d3, d4, 0.0, high)
        if (value_low < 0.0) != (value_high < 0.0):
            root = bisect(c1, d2, d3, d4, 0.0, low, high)
            if count == 0:
                found1 = root
            elif count == 1:
                found2 = root
            else:
                found3 = root
            count += 1
        low, value_low = high, value_high
    return count, found1, found2, found3


@compiled
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


@compiled
def first_negative(c0: float, c1: float, c2: float, c3: float, c4: float, length: float) -> float:
    """The first s of [0, length] from which on p is negative, or -1 where there is none."""
    if c0 < 0.0:
        return 0.0
    if c0 > length * (abs(c1) + length * (abs(c2) + length * (abs(c3) + length * abs(c4)))):
        return -1.0
    _, s1, s2, s3 = stationary_points(c1, c2, c3, c4, length)
    low = 0.0
    for piece in range(4):
        high = s1 if piece == 0 else (s2 if piece == 1 else (s3 if piece == 2 else length))
        if high <= low:
            continue
        if evaluate(c0, c1, c2, c3, c4, high) < 0.0:
            return bisect(c0, c1, c2, c3, c4, low, high)
        low = high
    return -1.0


@compiled
def extremes(c0: float, c1: float, c2: float, c3: float, c4: float, length: float) -> tuple[float, float]:
    """The largest and the smallest value of p on [0, length], both ends included."""
    end = evaluate(c0, c1, c2, c3, c4, length)
    largest, smallest = max(c0, end), min(c0, end)
    _, s1, s2, s3 = stationary_points(c1, c2, c3, c4, length)
    for s in (s1, s2, s3):
        value = evaluate(c0, c1, c2, c3, c4, s)
        largest, smallest = max(largest, value), min(smallest, value)
    return largest, smallest


@unowned
def value_of(c: FloatArray, count: int, s: float) -> float:
    """c[0] + c[1] s + ... + c[count - 1] s^(count - 1): Horner's rule, even and odd powers side by side."""
    square = s * s
    even, odd = c[count - 1] if count % 2 else 0.0, 0.0
    for k in range(count // 2 - 1, -1, -1):
        even = even * square + c[2 * k]
        odd = odd * square + c[2 * k + 1]
    return even + s * odd


@unowned_inlined
def derivatives(c: FloatArray, count: int, s: float) -> tuple[float, float, float]:
    """The same, with its first and half its second derivative."""
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


@unowned
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


@unowned
def sign_changes(c: FloatArray, count: int, length: float, found: FloatArray, ladder: FloatArray) -> int:
    """Write the points of (0, length) at which a polynomial changes sign to `found`, in order; return their number.

    Between the sign changes of its derivative it is monotone; where its lowest term outweighs all others it has none.
    The derivatives' coefficients go into `ladder`, (count, count) at least.
    """
    others, power = 0.0, 1.0
    for k in range(1, count):
        power *= length
        others += abs(c[k]) * power
    if abs(c[0]) > others or count < 2:
        return 0
    derivative = ladder[count - 1]
    for k in range(count - 1):
        derivative[k] = (k + 1) * c[k + 1]
    pieces = sign_changes(derivative, count - 1, length, found, ladder) + 1
    kept, low, before = 0, 0.0, c[0]
    for piece in range(pieces):
        high = found[piece] if piece < pieces - 1 else length
        after = value_of(c, count, high)
        if (before < 0.0) != (after < 0.0):
            found[kept] = zero_between(
                c, count, low, high, before, after
            )  # kept <= piece: nothing unread is overwritten
            kept += 1
        low, before = high, after
    return kept


@unowned
def turning_points(c: FloatArray, length: float, found: FloatArray, ladder: FloatArray) -> int:
    """Write the points of (0, length) at which the slope changes sign to `found`, in order; return their number."""
    others, power = 0.0, 1.0
    for k in range(2, c.size):
        power *= length
        others += k * abs(c[k]) * power
    if abs(c[1]) > others:
        return 0
    derivative = ladder[c.size - 1]
    for k in range(c.size - 1):
        derivative[k] = (k + 1) * c[k + 1]
    return sign_changes(derivative, c.size - 1, length, found, ladder)


@unowned
def first_negative_of(c: FloatArray, length: float, found: FloatArray, ladder: FloatArray) -> float:
    """The first s of [0, length] from which on a polynomial is negative, or -1 where there is none."""
    if c[0] < 0.0:
        return 0.0
    turns = turning_points(c, length, found, ladder)
    low, before = 0.0, c[0]
    for piece in range(turns + 1):
        high = found[piece] if piece < turns else length
        after = value_of(c, c.size, high)
        if after < 0.0:
            return zero_between(c, c.size, low, high, before, after)
        low, before = high, after
    return -1.0
