"""Runs side by side, one in each lane: their functionals, the spans that they may take, and moving by them.

Of each run there are modal coordinates, C of them, and the amplitudes of their pairs. `work` has a row of lanes for
each of these numbers, coordinates first. The other arrays are those of `flows.Flows`, for one flow and one functional.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.exact.flows import BLOCK, CROSS, CURVATURE, DECAY, JERK, OWN, RUSH, SIXTH, SLOPE, SWAY, TERMS, VALUE
from clunk.core.jit import unowned_inlined
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, Vector, fused

FloatArray = npt.NDArray[np.float64]

A_SIXTH = 1.0 / 6.0 * (1.0 + 1e-15)  # a product is quicker than a division
# How far a function may be from the polynomial with its values, slopes and curvatures at both ends, at most, by its
# sixth derivative over (0, 1): by the middle one of seven Bernstein coefficients, as a slope, and as a curvature
_PARTS = 1.0 / 14400.0 * (1.0 + 1e-15)
_SLOPE_PARTS = 7.45355992499930e-5  # √5 / 30000: Birkhoff & Priver 1967, as the next
_CURVATURE_PARTS = 1.0 / 1920.0 * (1.0 + 1e-15)
# What makes a guess of how long a guard stays positive: of the bounds of its derivatives, so much
_OF_THE_JERK = 0.2 / 6.0
_OF_THE_SIXTH = 1.5 / 14400.0


class Curve(NamedTuple):
    """A function of time in each lane, as it is now, and what bounds two of its derivatives from now on."""

    value: Vector
    slope: Vector
    curvature: Vector
    jerk: Vector  # of the third
    sixth: Vector


@unowned_inlined
def weight(array: FloatArray, row: int, lane: int) -> float:
    """A number of a table whose rows have eight."""
    return float(vectors.number(array, row * ROW + lane))


@unowned_inlined
def look(
    watch: FloatArray, work: FloatArray, size: int, level: Vector, deepest: int
) -> tuple[Curve, Vector, Curve, Vector, Vector]:
    """A functional less its origin, and without its fastest pairs.

    size : of the coordinates
    level : how many pairs are left out in each lane, at most `deepest`

    Returns
    -------
    slower : Curve
        Without the first `level` pairs.
    ringing : Vector
        The sway of those pairs.
    pair, sway : Curve, Vector
        The next pair alone.
    sway : Vector
        Of all of it.
    """
    none = vectors.splat(0.0)
    value, slope, curvature, jerk, sixth, sway, ringing = none, none, none, none, none, none, none
    next_value, next_slope, next_curvature, next_jerk, next_sixth, next_sway = none, none, none, none, none, none
    for begin in range(0, size, ROW):
        for k in range(BLOCK):
            p, number = begin + k, begin // 2 + k
            one, other = vectors.load(work, p), vectors.load(work, p + BLOCK)
            amplitude = vectors.load(work, size + number)
            a = fused(other, weight(watch, p + BLOCK, VALUE), one * weight(watch, p, VALUE))
            b = fused(other, weight(watch, p + BLOCK, SLOPE), one * weight(watch, p, SLOPE))
            c = fused(other, weight(watch, p + BLOCK, CURVATURE), one * weight(watch, p, CURVATURE))
            jerking, swing = amplitude * weight(watch, size + p, JERK), amplitude * weight(watch, size + p, SWAY)
            highest = amplitude * weight(watch, size + p, SIXTH)
            if number < deepest:
                slow, at = level <= float(number), level == float(number)
                next_value, next_slope = vectors.choose(at, a, next_value), vectors.choose(at, b, next_slope)
                next_curvature = vectors.choose(at, c, next_curvature)
                next_jerk, next_sway = vectors.choose(at, jerking, next_jerk), vectors.choose(at, swing, next_sway)
                next_sixth = vectors.choose(at, highest, next_sixth)
                ringing += vectors.choose(slow, 0.0, swing)
                a, b, c = vectors.choose(slow, a, 0.0), vectors.choose(slow, b, 0.0), vectors.choose(slow, c, 0.0)
                jerking, swing = vectors.choose(slow, jerking, 0.0), vectors.choose(slow, swing, 0.0)
                highest = vectors.choose(slow, highest, 0.0)
            value, slope, curvature = value + a, slope + b, curvature + c
            jerk, sixth, sway = jerk + jerking, sixth + highest, sway + swing
    slower = Curve(value, slope, curvature, jerk, sixth)
    pair = Curve(next_value, next_slope, next_curvature, next_jerk, next_sixth)
    return slower, ringing, pair, next_sway, ringing + sway


@unowned_inlined
def rush(watch: FloatArray, work: FloatArray, size: int, level: Vector, deepest: int) -> Vector:
    """What the fastest pairs of a functional add to its slope at most from now on."""
    total = vectors.splat(0.0)
    for pair in range(deepest):
        p = pair + pair // BLOCK * BLOCK
        fast = vectors.load(work, size + pair) * weight(watch, size + p, RUSH)
        total += vectors.choose(level > float(pair), fast, 0.0)
    return total


@unowned_inlined
def glance(watch: FloatArray, work: FloatArray, size: int, level: Vector, deepest: int, before: Curve) -> Curve:
    """The first of `look`, with the bounds that were found `before`."""
    none = vectors.splat(0.0)
    value, slope, curvature = none, none, none
    for begin in range(0, size, ROW):
        for k in range(BLOCK):
            p, pair = begin + k, begin // 2 + k
            one, other = vectors.load(work, p), vectors.load(work, p + BLOCK)
            if pair < deepest:
                slow = level <= float(pair)
                one, other = vectors.choose(slow, one, 0.0), vectors.choose(slow, other, 0.0)
            value += fused(other, weight(watch, p + BLOCK, VALUE), one * weight(watch, p, VALUE))
            slope += fused(other, weight(watch, p + BLOCK, SLOPE), one * weight(watch, p, SLOPE))
            curvature += fused(other, weight(watch, p + BLOCK, CURVATURE), one * weight(watch, p, CURVATURE))
    return Curve(value, slope, curvature, before.jerk, before.sixth)


@unowned_inlined
def bounds(watch: FloatArray, work: FloatArray, size: int) -> tuple[Vector, Vector, Vector]:
    """What bounds from now on a functional's third and sixth derivatives, and its value less its origin."""
    none = vectors.splat(0.0)
    jerk, sixth, sway = none, none, none
    for begin in range(0, size, ROW):
        for k in range(BLOCK):
            amplitude = vectors.load(work, size + begin // 2 + k)
            jerk = fused(amplitude, weight(watch, size + begin + k, JERK), jerk)
            sixth = fused(amplitude, weight(watch, size + begin + k, SIXTH), sixth)
            sway = fused(amplitude, weight(watch, size + begin + k, SWAY), sway)
    return jerk, sixth, sway


@unowned_inlined
def origin(
    output: FloatArray, f: int, steady: bool, torque: Vector, gap_input: Vector, elapsed: Vector
) -> tuple[Vector, Vector, Vector]:
    """Value, slope and curvature of a functional's origin after a time.

    output : (3, F, 2) float64
    """
    value = fused(gap_input, output[0, f, 1], torque * output[0, f, 0])
    slope = curvature = vectors.splat(0.0)
    if not steady:
        slope = torque * output[1, f, 0] + gap_input * output[1, f, 1]
        curvature = torque * output[2, f, 0] + gap_input * output[2, f, 1]
        value += elapsed * (slope + 0.5 * elapsed * curvature)
        slope += elapsed * curvature
    return value, slope, curvature


@unowned_inlined
def as_guard(curve: Curve, origin: tuple[Vector, Vector, Vector], sign: Vector, shift: Vector) -> Curve:
    """sign times a functional, its origin included, plus shift."""
    value, slope, curvature = origin
    return Curve(
        fused(sign, curve.value + value, shift),
        sign * (curve.slope + slope),
        sign * (curve.curvature + curvature),
        curve.jerk,
        curve.sixth,
    )


@unowned_inlined
def without(guard: Curve, pair: Curve, sign: Vector, sway: Vector) -> Curve:
    """A guard without a pair of its modes, lower by that pair's sway."""
    return Curve(
        guard.value - sign * pair.value - sway,
        guard.slope - sign * pair.slope,
        guard.curvature - sign * pair.curvature,
        guard.jerk - pair.jerk,
        guard.sixth - pair.sixth,
    )


@unowned_inlined
def less(guard: Curve, by: Vector) -> Curve:
    """A guard, lower by so much."""
    return Curve(guard.value - by, guard.slope, guard.curvature, guard.jerk, guard.sixth)


@unowned_inlined
def either(bits: int, one: Curve, other: Curve) -> Curve:
    """One in the lanes whose bits are set, and the other elsewhere."""
    return Curve(
        vectors.choose(bits, one.value, other.value),
        vectors.choose(bits, one.slope, other.slope),
        vectors.choose(bits, one.curvature, other.curvature),
        vectors.choose(bits, one.jerk, other.jerk),
        vectors.choose(bits, one.sixth, other.sixth),
    )


@unowned_inlined
def low(guard: Curve, h: Vector) -> Vector:
    """A bound, concave in h: a guard that is positive stays so within a time h for which this is."""
    bent = fused(guard.jerk * -A_SIXTH, h, 0.5 * vectors.smaller(guard.curvature, vectors.splat(0.0)))
    return fused(fused(bent, h, guard.slope), h, guard.value)


@unowned_inlined
def guess(guard: Curve, h: Vector) -> Vector:
    """What is positive as long as a guard will probably stay so, and as that can probably be proved by `between`."""
    square = h * h
    bent = fused(guard.jerk * -_OF_THE_JERK, h, 0.5 * guard.curvature)
    expected = fused(fused(bent, h, guard.slope), h, guard.value)
    return fused(guard.sixth * -_OF_THE_SIXTH, square * square * square, expected)


@unowned_inlined
def longest(shortest: float, one: Curve, other: Curve, at_most: Vector) -> tuple[Vector, Vector]:
    """The longest span of the ladder, at most `at_most`, up to which two guards stay positive by `guess`; its number.

    Where there is none, the number is -1.
    """
    h, k = vectors.splat(shortest), vectors.splat(0.0)
    none = ~_passes(one, other, h, at_most)
    for octaves in (4, 1):  # the octave, of 16, in base 4: three at once, since each takes long to be known
        a, b, c = h * float(1 << octaves), h * float(1 << 2 * octaves), h * float(1 << 3 * octaves)
        first = _passes(one, other, a, at_most)
        second = _passes(one, other, b, at_most) & first
        third = _passes(one, other, c, at_most) & second
        h = vectors.choose(third, c, vectors.choose(second, b, vectors.choose(first, a, h)))
        step = 2.0 * octaves
        k += vectors.choose(third, 3.0 * step, vectors.choose(second, 2.0 * step, vectors.choose(first, step, 0.0)))
    half = h * 1.5
    passes = _passes(one, other, half, at_most)
    h, k = vectors.choose(passes, half, h), vectors.choose(passes, k + 1.0, k)
    return h, vectors.choose(none, -1.0, k)


@unowned_inlined
def _passes(one: Curve, other: Curve, h: Vector, at_most: Vector) -> int:
    return int((guess(one, h) > 0.0) & (guess(other, h) > 0.0) & (h <= at_most))


@unowned_inlined
def falls_by(guard: Curve) -> Vector:
    """How far at least a guard will go on falling before it turns back.

    0 if it rises. NaN or -inf where that is so far that rounding hides it.

    By what bounds its third derivative, it falls for a time at least. Nearly all of that is looked at, so that rounding
    does not matter.
    """
    fall, bend = vectors.larger(-guard.slope, vectors.splat(0.0)), guard.curvature
    h = 1.8 * fall / (bend + vectors.root(fused(bend, bend, 2.0 * guard.jerk * fall)))
    return h * (fall - h * fused(guard.jerk * A_SIXTH, h, 0.5 * bend))


@unowned_inlined
def between(start: Curve, end: Curve, h: Vector) -> tuple[Vector, Vector, Vector]:
    """What a function does within a time h, by its value, slope and curvature at both ends.

    It is a polynomial of degree six but for the sixth derivative's part, and so within its Bernstein coefficients, of
    which that part moves the middle one. The ends are the outer two: with them, the inner five bound it.

    Returns
    -------
    least, greatest : Vector
        Of the inner five coefficients.
    parts : Vector
        The sixth derivative's bound times h⁶.
    """
    square = h * h
    parts = start.sixth * (square * square * square)
    s0, q0, s1, q1 = start.slope * h, start.curvature * square, end.slope * h, end.curvature * square
    a, b = fused(s0, A_SIXTH, start.value), fused(s1, -A_SIXTH, end.value)
    c = fused(q0, 1.0 / 30.0, fused(s0, 1.0 / 3.0, start.value))
    d = fused(q1, 1.0 / 30.0, fused(s1, -1.0 / 3.0, end.value))
    middle = 0.5 * (fused(q0, 0.05, fused(s0, 0.4, start.value)) + fused(q1, 0.05, fused(s1, -0.4, end.value)))
    least = vectors.smaller(vectors.smaller(a, b), vectors.smaller(c, d))
    greatest = vectors.larger(vectors.larger(a, b), vectors.larger(c, d))
    away = parts * _PARTS
    return vectors.smaller(least, middle - away), vectors.larger(greatest, middle + away), parts


@unowned_inlined
def turns_not(start: Curve, end: Curve, parts: Vector, rush: Vector, h: Vector) -> tuple[int, int]:
    """Where a function is monotone within a time h; and where it bends down all the way.

    parts : as `between` has them; rush : what else is in its slope at most
    """
    square = h * h
    s0, q0, s1, q1 = start.slope * h, start.curvature * square, end.slope * h, end.curvature * square
    a, b = fused(q0, 0.25, s0), fused(q1, -0.25, s1)
    middle = 5.0 * (fused(q1, 0.05, fused(s1, -0.4, end.value)) - fused(q0, 0.05, fused(s0, 0.4, start.value)))
    away = fused(parts, _SLOPE_PARTS, rush * h)
    least = vectors.smaller(vectors.smaller(s0, s1), vectors.smaller(vectors.smaller(a, b), middle))
    greatest = vectors.larger(vectors.larger(s0, s1), vectors.larger(vectors.larger(a, b), middle))
    bend = 4.0 * vectors.larger(middle - a, b - middle)
    bent = vectors.larger(vectors.larger(q0, q1), bend) < -(parts * _CURVATURE_PARTS)
    return (least > away) | (greatest < -away), bent


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
            one, other = vectors.load(work, p), vectors.load(work, q)
            own, cross, decay = at + OWN * ROW + k, at + CROSS * ROW + k, at + DECAY * ROW + k
            moved = fused(vectors.load(propagated, own), one, vectors.load(propagated, cross) * other)
            partner = fused(vectors.load(propagated, own + BLOCK), other, vectors.load(propagated, cross + BLOCK) * one)
            vectors.store(work, p, moved)
            vectors.store(work, q, partner)
            vectors.store(work, pair, vectors.load(propagated, decay) * vectors.load(work, pair))


@unowned_inlined
def measure(work: FloatArray, size: int) -> None:
    """The amplitudes of the pairs."""
    for begin in range(0, size, ROW):
        for k in range(BLOCK):
            one, other = vectors.load(work, begin + k), vectors.load(work, begin + k + BLOCK)
            vectors.store(work, size + begin // 2 + k, vectors.root(fused(one, one, other * other)))


@unowned_inlined
def move(
    power: FloatArray, generator: FloatArray, modes: bool, part: Vector, work: FloatArray, size: int, moved: FloatArray
) -> None:
    """Move by a part of the shortest span, by the Taylor series of the exponential. `moved` is scratch, 2C rows."""
    if modes:
        for begin in range(0, size, ROW):
            for k in range(BLOCK):
                one, other = vectors.load(work, begin + k), vectors.load(work, begin + k + BLOCK)
                total1, total2 = vectors.splat(0.0), vectors.splat(0.0)
                for j in range(TERMS - 1, -1, -1):
                    first = (j * (size // ROW) + begin // ROW) * 2
                    own, cross = first + OWN, first + CROSS
                    term1 = fused(other, weight(power, cross, k), one * weight(power, own, k))
                    term2 = fused(one, weight(power, cross, k + BLOCK), other * weight(power, own, k + BLOCK))
                    total1, total2 = fused(total1, part, term1), fused(total2, part, term2)
                vectors.store(work, begin + k, total1)
                vectors.store(work, begin + k + BLOCK, total2)
        return
    for r in range(size):
        vectors.store(moved, r, vectors.load(work, r))
    for k in range(TERMS - 1, 0, -1):
        for r in range(size):
            total = vectors.splat(0.0)
            for c in range(size):
                total = fused(vectors.load(work, c), vectors.number(generator, r * size + c), total)
            vectors.store(moved, size + r, vectors.load(moved, r) + part / float(k) * total)
        for r in range(size):
            vectors.store(work, r, vectors.load(moved, size + r))


@unowned_inlined
def expand(
    series: FloatArray,
    work: FloatArray,
    size: int,
    shortest: float,
    sign: Vector,
    shift: Vector,
    origin: tuple[Vector, Vector, Vector],
    c: FloatArray,
) -> None:
    """The Taylor coefficients over the shortest span of sign times a functional plus shift.

    shortest : the span  [s]
    origin : the functional's: value, slope and curvature
    c : (TERMS, WIDTH) float64
        Output.
    """
    value, slope, curvature = origin
    for j in range(TERMS):
        total = vectors.splat(0.0)
        for k in range(size):
            total = fused(vectors.load(work, k), weight(series, 2 * k, j), total)
        if j == 0:
            total += value
        elif j == 1:
            total += shortest * slope
        elif j == 2:
            total += 0.5 * shortest * shortest * curvature
        vectors.store(c, j, sign * total)
    vectors.store(c, 0, vectors.load(c, 0) + shift)


@unowned_inlined
def derivatives(c: FloatArray, s: Vector) -> tuple[Vector, Vector, Vector]:
    """Value, slope and half the second derivative of a series: Horner's rule, even and odd powers side by side."""
    none = vectors.splat(0.0)
    square = s * s
    even, odd, even_slope, odd_slope, even_half, odd_half = none, none, none, none, none, none  # by s²
    for k in range(TERMS // 2 - 1, -1, -1):
        even_half, odd_half = fused(even_half, square, even_slope), fused(odd_half, square, odd_slope)
        even_slope, odd_slope = fused(even_slope, square, even), fused(odd_slope, square, odd)
        even, odd = fused(even, square, vectors.load(c, 2 * k)), fused(odd, square, vectors.load(c, 2 * k + 1))
    value = fused(s, odd, even)
    slope = fused(2.0, fused(s, even_slope, square * odd_slope), odd)
    half = fused(4.0 * square, fused(s, odd_half, even_half), fused(3.0 * s, odd_slope, even_slope))
    return value, slope, half


@unowned_inlined
def crossing(c: FloatArray, length: Vector, only: bool) -> tuple[int, int, Vector, Vector, Vector]:
    """The first zero of a series that is positive at first, where it falls, or is concave, all the way to it.

    length : at most 1
    only : whether it is to fall, or be concave, all the length, so that there is no other zero

    Returns
    -------
    found : int
        The lanes where such a zero is.
    none : int
        The lanes where the series stays positive.
    s, slope, half : Vector
        The zero, the slope there, and half the curvature.
    """
    none = vectors.splat(0.0)
    c0, c1, c2 = vectors.load(c, 0), vectors.load(c, 1), vectors.load(c, 2)
    # of its first three terms
    root = vectors.root(vectors.larger(c1 * c1 - 4.0 * c0 * c2, none))
    s = vectors.choose(c1 < 0.0, 2.0 * c0 / (root - c1), -0.5 * (c1 + root) / c2)
    slope, half, found, alive = none, none, 0, (c0 > 0.0) & (s >= 0.0)
    for _ in range(3):
        alive &= s <= length
        if alive == 0:
            break
        value, slope_here, half_here = derivatives(c, s)
        moved = s - value * slope_here / (slope_here * slope_here - value * half_here)
        s = vectors.choose(alive, moved, s)
        slope, half = vectors.choose(alive, slope_here, slope), vectors.choose(alive, half_here, half)
        # what is left of the error is the square of how much the slope changed in this step, as a share of the step
        steady = vectors.magnitude(value * half_here) <= 2e-5 * (slope_here * slope_here)
        steady &= vectors.magnitude(value) <= 2e-5 * vectors.magnitude(slope_here)
        here = alive & steady & (s >= 0.0) & (s <= length)
        found |= here
        alive &= ~here
    end, rise, bend, fall = length if only else s, none, none, none
    for k in range(TERMS - 1, 1, -1):
        term = vectors.load(c, k)
        up = vectors.larger(term, none)
        fall += term - up
        rise = fused(rise, end, float(k) * up)
        if k > 2:
            bend = fused(bend, end, float(k * (k - 1)) * up)
    found &= (c1 + rise * end < 0.0) | (2.0 * c2 + bend * end < 0.0)
    return found, c0 + vectors.smaller(c1, none) + fall > 0.0, s, slope, half


@unowned_inlined
def value(c: FloatArray, s: Vector) -> Vector:
    """The first of `derivatives`."""
    even, odd, square = vectors.splat(0.0), vectors.splat(0.0), s * s
    for k in range(TERMS // 2 - 1, -1, -1):
        even, odd = fused(even, square, vectors.load(c, 2 * k)), fused(odd, square, vectors.load(c, 2 * k + 1))
    return fused(s, odd, even)


@unowned_inlined
def turning(c: FloatArray, slopes: FloatArray, length: Vector) -> tuple[int, int, Vector]:
    """The turning point of a series that has but one.

    slopes : (TERMS, WIDTH) float64
        Scratch.

    Returns
    -------
    found : int
        The lanes where such a turning point is.
    none : int
        The lanes where the series has none.
    s : Vector
    """
    falls = vectors.load(c, 1) < 0.0
    for k in range(TERMS - 1):
        term = vectors.load(c, k + 1) * float(k + 1)
        vectors.store(slopes, k, vectors.choose(falls, -term, term))
    vectors.store(slopes, TERMS - 1, vectors.splat(0.0))
    found, none, s, _, _ = crossing(slopes, length, True)
    return found, none, s
