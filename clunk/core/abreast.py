"""Runs side by side, one in each lane: their functionals, the spans that they may take, and moving by them.

Of each run there are modal coordinates, C of them, and the amplitudes of their pairs. `work` has a row of lanes for
each of these numbers, coordinates first. The other arrays are those of `flows.Flows`, for one flow and one functional.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import lanes
from clunk.core.flows import BLOCK, CROSS, CURVATURE, DECAY, JERK, OWN, RUSH, SLOPE, SWAY, TERMS, VALUE
from clunk.core.jit import unowned_inlined
from clunk.core.lanes import ROW, Lanes

FloatArray = npt.NDArray[np.float64]

SIXTH = 1.0 / 6.0 * (1.0 + 1e-15)  # a product is quicker than a division

Look = tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes]


@unowned_inlined
def weight(array: FloatArray, row: int, lane: int) -> float:
    """A number of a table whose rows have eight."""
    return float(lanes.number(array, row * ROW + lane))


@unowned_inlined
def look(watch: FloatArray, work: FloatArray, size: int, level: Lanes, deepest: int) -> Look:
    """A functional less its origin, and without its fastest pairs.

    size : of the coordinates
    level : how many pairs are left out in each lane, at most `deepest`

    Returns
    -------
    value, slope, curvature, jerk : Lanes
        Without the first `level` pairs; the last is the bound of its third derivative.
    ringing : Lanes
        The sway of those pairs.
    value, slope, curvature, jerk, sway : Lanes
        Of the next pair alone.
    sway : Lanes
        Of all of it.
    """
    none = lanes.splat(0.0)
    value, slope, curvature, jerk, sway, ringing = none, none, none, none, none, none
    next_value, next_slope, next_curvature, next_jerk, next_sway = none, none, none, none, none
    for begin in range(0, size, ROW):
        v1, v2, d1, d2, e1, e2 = none, none, none, none, none, none
        j, w = none, none
        for k in range(BLOCK):
            p, pair = begin + k, begin // 2 + k
            one, other = lanes.load(work, p), lanes.load(work, p + BLOCK)
            amplitude = lanes.load(work, size + pair)
            a1, a2 = one * weight(watch, p, VALUE), other * weight(watch, p + BLOCK, VALUE)
            b1, b2 = one * weight(watch, p, SLOPE), other * weight(watch, p + BLOCK, SLOPE)
            c1, c2 = one * weight(watch, p, CURVATURE), other * weight(watch, p + BLOCK, CURVATURE)
            jerking, swing = amplitude * weight(watch, size + p, JERK), amplitude * weight(watch, size + p, SWAY)
            if pair < deepest:
                slow, at = level <= float(pair), level == float(pair)
                next_value, next_slope = lanes.choose(at, a1 + a2, next_value), lanes.choose(at, b1 + b2, next_slope)
                next_curvature = lanes.choose(at, c1 + c2, next_curvature)
                next_jerk, next_sway = lanes.choose(at, jerking, next_jerk), lanes.choose(at, swing, next_sway)
                ringing += lanes.choose(slow, 0.0, swing)
                a1, a2 = lanes.choose(slow, a1, 0.0), lanes.choose(slow, a2, 0.0)
                b1, b2 = lanes.choose(slow, b1, 0.0), lanes.choose(slow, b2, 0.0)
                c1, c2 = lanes.choose(slow, c1, 0.0), lanes.choose(slow, c2, 0.0)
                jerking, swing = lanes.choose(slow, jerking, 0.0), lanes.choose(slow, swing, 0.0)
            v1, v2, d1, d2, e1, e2 = v1 + a1, v2 + a2, d1 + b1, d2 + b2, e1 + c1, e2 + c2
            j, w = j + jerking, w + swing
        value, slope, curvature = value + (v1 + v2), slope + (d1 + d2), curvature + (e1 + e2)
        jerk, sway = jerk + j, sway + w
    return (
        value, slope, curvature, jerk, ringing, next_value, next_slope, next_curvature, next_jerk, next_sway,
        ringing + sway,
    )  # fmt: skip


@unowned_inlined
def rush(watch: FloatArray, work: FloatArray, size: int, level: Lanes, deepest: int) -> Lanes:
    """What the fastest pairs of a functional add to its slope at most from now on."""
    total = lanes.splat(0.0)
    for pair in range(deepest):
        p = pair + pair // BLOCK * BLOCK
        fast = lanes.load(work, size + pair) * weight(watch, size + p, RUSH)
        total += lanes.choose(level > float(pair), fast, 0.0)
    return total


@unowned_inlined
def glance(watch: FloatArray, work: FloatArray, size: int, level: Lanes, deepest: int) -> tuple[Lanes, Lanes, Lanes]:
    """The first three of `look`."""
    none = lanes.splat(0.0)
    value, slope, curvature = none, none, none
    for begin in range(0, size, ROW):
        v1, v2, d1, d2, e1, e2 = none, none, none, none, none, none
        for k in range(BLOCK):
            p, pair = begin + k, begin // 2 + k
            one, other = lanes.load(work, p), lanes.load(work, p + BLOCK)
            if pair < deepest:
                slow = level <= float(pair)
                one, other = lanes.choose(slow, one, 0.0), lanes.choose(slow, other, 0.0)
            v1, v2 = v1 + one * weight(watch, p, VALUE), v2 + other * weight(watch, p + BLOCK, VALUE)
            d1, d2 = d1 + one * weight(watch, p, SLOPE), d2 + other * weight(watch, p + BLOCK, SLOPE)
            e1, e2 = e1 + one * weight(watch, p, CURVATURE), e2 + other * weight(watch, p + BLOCK, CURVATURE)
        value, slope, curvature = value + (v1 + v2), slope + (d1 + d2), curvature + (e1 + e2)
    return value, slope, curvature


@unowned_inlined
def bounds(watch: FloatArray, work: FloatArray, size: int) -> tuple[Lanes, Lanes]:
    """What bounds a functional's third derivative, and its value less its origin, from now on."""
    none = lanes.splat(0.0)
    jerk, sway = none, none
    for begin in range(0, size, ROW):
        j, w = none, none
        for k in range(BLOCK):
            amplitude = lanes.load(work, size + begin // 2 + k)
            j += amplitude * weight(watch, size + begin + k, JERK)
            w += amplitude * weight(watch, size + begin + k, SWAY)
        jerk, sway = jerk + j, sway + w
    return jerk, sway


@unowned_inlined
def origin(
    output: FloatArray, f: int, steady: bool, torque: Lanes, gap_input: Lanes, elapsed: Lanes
) -> tuple[Lanes, Lanes, Lanes]:
    """Value, slope and curvature of a functional's origin after a time.

    output : (3, F, 2) float64
    """
    value = torque * output[0, f, 0] + gap_input * output[0, f, 1]
    slope = curvature = lanes.splat(0.0)
    if not steady:
        slope = torque * output[1, f, 0] + gap_input * output[1, f, 1]
        curvature = torque * output[2, f, 0] + gap_input * output[2, f, 1]
        value += elapsed * (slope + 0.5 * elapsed * curvature)
        slope += elapsed * curvature
    return value, slope, curvature


@unowned_inlined
def low(value: Lanes, slope: Lanes, curvature: Lanes, jerk: Lanes, h: Lanes) -> Lanes:
    """A bound, concave in h: a guard that is positive stays so within a time h for which this is."""
    bent = 0.5 * lanes.smaller(curvature, lanes.splat(0.0)) - h * (jerk * SIXTH)
    return value + h * (slope + h * bent)


@unowned_inlined
def longest(
    shortest: float,
    g1: Lanes,
    d1: Lanes,
    e1: Lanes,
    j1: Lanes,
    g2: Lanes,
    d2: Lanes,
    e2: Lanes,
    j2: Lanes,
    rest: Lanes,
) -> tuple[Lanes, Lanes]:
    """The longest span of the ladder that keeps two guards positive by `low`, and is not beyond `rest`; and its number.

    Where there is none, the number is -1. A span passes where any longer one does.
    """
    h, k = lanes.splat(shortest), lanes.splat(0.0)
    none = ~_passes(g1, d1, e1, j1, g2, d2, e2, j2, h, rest)
    for octaves in (4, 1):  # the octave, of 16, in base 4: three at once, since each takes long to be known
        a, b, c = h * float(1 << octaves), h * float(1 << 2 * octaves), h * float(1 << 3 * octaves)
        first = _passes(g1, d1, e1, j1, g2, d2, e2, j2, a, rest)
        second = _passes(g1, d1, e1, j1, g2, d2, e2, j2, b, rest)
        third = _passes(g1, d1, e1, j1, g2, d2, e2, j2, c, rest)
        h = lanes.choose(third, c, lanes.choose(second, b, lanes.choose(first, a, h)))
        step = 2.0 * octaves
        k += lanes.choose(third, 3.0 * step, lanes.choose(second, 2.0 * step, lanes.choose(first, step, 0.0)))
    half = h * 1.5
    passes = _passes(g1, d1, e1, j1, g2, d2, e2, j2, half, rest)
    h, k = lanes.choose(passes, half, h), lanes.choose(passes, k + 1.0, k)
    return h, lanes.choose(none, -1.0, k)


@unowned_inlined
def _passes(
    g1: Lanes, d1: Lanes, e1: Lanes, j1: Lanes, g2: Lanes, d2: Lanes, e2: Lanes, j2: Lanes, h: Lanes, rest: Lanes
) -> int:
    return int((low(g1, d1, e1, j1, h) > 0.0) & (low(g2, d2, e2, j2, h) > 0.0) & (h <= rest))


@unowned_inlined
def jump(propagated: FloatArray, work: FloatArray, size: int) -> None:
    """Move by a span.

    propagated : (3C, WIDTH) float64
        The span's row of `propagator`, of each lane.
    """
    for begin in range(0, size, ROW):
        at = 3 * begin
        for k in range(BLOCK):
            p, q, pair = begin + k, begin + k + BLOCK, size + begin // 2 + k
            one, other = lanes.load(work, p), lanes.load(work, q)
            own, cross, decay = at + OWN * ROW + k, at + CROSS * ROW + k, at + DECAY * ROW + k
            lanes.store(work, p, lanes.load(propagated, own) * one + lanes.load(propagated, cross) * other)
            lanes.store(
                work, q, lanes.load(propagated, own + BLOCK) * other + lanes.load(propagated, cross + BLOCK) * one
            )
            lanes.store(work, pair, lanes.load(propagated, decay) * lanes.load(work, pair))


@unowned_inlined
def measure(work: FloatArray, size: int) -> None:
    """The amplitudes of the pairs."""
    for begin in range(0, size, ROW):
        for k in range(BLOCK):
            one, other = lanes.load(work, begin + k), lanes.load(work, begin + k + BLOCK)
            lanes.store(work, size + begin // 2 + k, lanes.root(one * one + other * other))


@unowned_inlined
def move(
    power: FloatArray, generator: FloatArray, modes: bool, part: Lanes, work: FloatArray, size: int, moved: FloatArray
) -> None:
    """Move by a part of the shortest span, by the Taylor series of the exponential. `moved` is scratch, 2C rows."""
    if modes:
        for begin in range(0, size, ROW):
            for k in range(BLOCK):
                one, other = lanes.load(work, begin + k), lanes.load(work, begin + k + BLOCK)
                total1, total2 = lanes.splat(0.0), lanes.splat(0.0)
                for j in range(TERMS - 1, -1, -1):
                    first = (j * (size // ROW) + begin // ROW) * 2
                    own, cross = first + OWN, first + CROSS
                    term1 = one * weight(power, own, k) + other * weight(power, cross, k)
                    term2 = other * weight(power, own, k + BLOCK) + one * weight(power, cross, k + BLOCK)
                    total1, total2 = term1 + total1 * part, term2 + total2 * part
                lanes.store(work, begin + k, total1)
                lanes.store(work, begin + k + BLOCK, total2)
        return
    for r in range(size):
        lanes.store(moved, r, lanes.load(work, r))
    for k in range(TERMS - 1, 0, -1):
        for r in range(size):
            total = lanes.splat(0.0)
            for c in range(size):
                total += lanes.load(work, c) * lanes.number(generator, r * size + c)
            lanes.store(moved, size + r, lanes.load(moved, r) + part / float(k) * total)
        for r in range(size):
            lanes.store(work, r, lanes.load(moved, size + r))


@unowned_inlined
def expand(
    series: FloatArray,
    work: FloatArray,
    size: int,
    shortest: float,
    sign: Lanes,
    shift: Lanes,
    value: Lanes,
    slope: Lanes,
    curvature: Lanes,
    c: FloatArray,
) -> None:
    """The Taylor coefficients over the shortest span of sign times a functional plus shift.

    shortest : the span  [s]
    value, slope, curvature : of the functional's origin
    c : (TERMS, WIDTH) float64
        Output.
    """
    for j in range(TERMS):
        total = lanes.splat(0.0)
        for k in range(size):
            total += lanes.load(work, k) * weight(series, 2 * k, j)
        if j == 0:
            total += value
        elif j == 1:
            total += shortest * slope
        elif j == 2:
            total += 0.5 * shortest * shortest * curvature
        lanes.store(c, j, sign * total)
    lanes.store(c, 0, lanes.load(c, 0) + shift)


@unowned_inlined
def derivatives(c: FloatArray, s: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """Value, slope and half the second derivative of a series: Horner's rule, even and odd powers side by side."""
    none = lanes.splat(0.0)
    square = s * s
    even, odd, even_slope, odd_slope, even_half, odd_half = none, none, none, none, none, none  # by s²
    for k in range(TERMS // 2 - 1, -1, -1):
        even_half, odd_half = even_half * square + even_slope, odd_half * square + odd_slope
        even_slope, odd_slope = even_slope * square + even, odd_slope * square + odd
        even, odd = even * square + lanes.load(c, 2 * k), odd * square + lanes.load(c, 2 * k + 1)
    value = even + s * odd
    slope = odd + 2.0 * (s * even_slope + square * odd_slope)
    half = even_slope + 3.0 * s * odd_slope + 4.0 * square * (even_half + s * odd_half)
    return value, slope, half


@unowned_inlined
def crossing(c: FloatArray, length: Lanes) -> tuple[int, int, Lanes, Lanes, Lanes]:
    """The zero of a series that does nothing but fall, its slope and half its curvature there.

    length : at most 1

    Returns
    -------
    found : int
        The lanes where such a zero is.
    none : int
        The lanes where the series stays positive.
    s, slope, half : Lanes
    """
    none = lanes.splat(0.0)
    even, odd, total = none, none, none
    for k in range(2, TERMS, 2):
        one, other = lanes.magnitude(lanes.load(c, k)), lanes.magnitude(lanes.load(c, k + 1))
        even, odd, total = even + one * float(k), odd + other * float(k + 1), total + (one + other)
    c0, c1, c2 = lanes.load(c, 0), lanes.load(c, 1), lanes.load(c, 2)
    steep = c1 * c1 - c0 * c2
    alive = (c0 > 0.0) & (-c1 > even + odd) & (steep > 0.0)
    positive = c0 > total + lanes.magnitude(c1)
    s, slope, half, found = -c0 * c1 / steep, none, none, 0
    for _ in range(3):
        alive &= s <= length
        if alive == 0:
            break
        value, slope_here, half_here = derivatives(c, s)
        moved = s - value * slope_here / (slope_here * slope_here - value * half_here)
        s = lanes.choose(alive, moved, s)
        slope, half = lanes.choose(alive, slope_here, slope), lanes.choose(alive, half_here, half)
        # what is left of the error is the square of how much the slope changed in this step, as a share of the step
        steady = lanes.magnitude(value * half_here) <= 2e-5 * (slope_here * slope_here)
        steady &= lanes.magnitude(value) <= 2e-5 * lanes.magnitude(slope_here)
        here = alive & steady & (s >= 0.0) & (s <= length)
        found |= here
        alive &= ~here
    return found, positive, s, slope, half


@unowned_inlined
def value(c: FloatArray, s: Lanes) -> Lanes:
    """The first of `derivatives`."""
    even, odd, square = lanes.splat(0.0), lanes.splat(0.0), s * s
    for k in range(TERMS // 2 - 1, -1, -1):
        even, odd = even * square + lanes.load(c, 2 * k), odd * square + lanes.load(c, 2 * k + 1)
    return even + s * odd


@unowned_inlined
def turning(c: FloatArray, slopes: FloatArray, length: Lanes) -> tuple[int, int, Lanes]:
    """The turning point of a series whose slope does nothing but fall, or rise.

    slopes : (TERMS, WIDTH) float64
        Scratch.

    Returns
    -------
    found : int
        The lanes where such a turning point is.
    none : int
        The lanes where the series has none.
    s : Lanes
    """
    falls = lanes.load(c, 1) < 0.0
    for k in range(TERMS - 1):
        term = lanes.load(c, k + 1) * float(k + 1)
        lanes.store(slopes, k, lanes.choose(falls, -term, term))
    lanes.store(slopes, TERMS - 1, lanes.splat(0.0))
    found, none, s, _, _ = crossing(slopes, length)
    return found, none, s
