"""Functionals of the runs in the lanes: their values, bounds of their derivatives, and what these bounds prove.

The first C rows of `work` hold the modal coordinates of the runs, one run in each lane, and the rows of `amplitudes`
the amplitudes of the pairs of coordinates. Tables are the parts of `flows.Flows` for one flow and one functional.
"""

from typing import NamedTuple

from clunk.core.arrays import FloatArray
from clunk.core.exact.flows import CURVATURE, PAIRS, SIXTH, SLOPE, SWAY, THIRD, VALUE, WATCHED
from clunk.core.jit import inlined_part
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, Table, Vector, fused

A_SIXTH = 1.0 / 6.0 * (1.0 + 1e-15)  # rounded up; a product is quicker than a division
# Bounds, per unit of the sixth derivative over (0, 1), of how far a function is from the quintic that has its values,
# slopes and curvatures at both ends: by the middle one of seven Bernstein coefficients, as a slope, and as a curvature
_REMAINDER = 1.0 / 14400.0 * (1.0 + 1e-15)
_SLOPE_REMAINDER = 7.45355992499930e-5  # √5 / 30000; this and the next are those of Birkhoff & Priver 1967
_CURVATURE_REMAINDER = 1.0 / 1920.0 * (1.0 + 1e-15)
# Factors of the bounds of the third and the sixth derivative in `guess`; a bound that is proved has 1 instead of 0.2
# and 1.5
_OF_THE_THIRD = 0.2 / 6.0
_OF_THE_SIXTH = 1.5 / 14400.0


class Curve(NamedTuple):
    """A function of time in each lane: its value and derivatives now, and bounds of two higher ones from now on.

    The bounds are of the magnitudes of the third and the sixth derivative.
    """

    value: Vector
    slope: Vector
    curvature: Vector
    third_bound: Vector
    sixth_bound: Vector


class Origin(NamedTuple):
    """A functional, or a state, of a flow's particular solution: its value and three derivatives, the last constant."""

    value: Vector
    slope: Vector
    curvature: Vector
    third: Vector


@inlined_part
def _pair(watch: Table, at: int, one: Vector, other: Vector) -> Vector:
    """Contribution of a pair of coordinates to a sum whose factors lie in `watch`, that of the first member at `at`."""
    return fused(other, vectors.number(watch, at + PAIRS), one * vectors.number(watch, at))


@inlined_part
def evaluate(watch: Table, work: FloatArray, amplitudes: FloatArray, size: int) -> tuple[Curve, Vector]:
    """A functional less its origin, and its sway: a bound of the magnitude of that difference from now on.

    amplitudes : (C/2, W) float64
    size : C
    """
    value = slope = curvature = third = sixth = sway = vectors.splat(0.0)
    for begin in range(0, size, ROW):
        for k in range(PAIRS):
            p, at = begin + k, begin // ROW * WATCHED + k
            one, other = vectors.load(work, p), vectors.load(work, p + PAIRS)
            value += _pair(watch, at + VALUE, one, other)
            slope += _pair(watch, at + SLOPE, one, other)
            curvature += _pair(watch, at + CURVATURE, one, other)
            amplitude = vectors.load(amplitudes, begin // 2 + k)
            third = fused(amplitude, vectors.number(watch, at + THIRD), third)
            sixth = fused(amplitude, vectors.number(watch, at + SIXTH), sixth)
            sway = fused(amplitude, vectors.number(watch, at + SWAY), sway)
    return Curve(value, slope, curvature, third, sixth), sway


@inlined_part
def load_curve(array: FloatArray, row: int) -> Curve:
    """A curve whose five numbers are rows of an array, from `row` on."""
    return Curve(
        vectors.load(array, row),
        vectors.load(array, row + 1),
        vectors.load(array, row + 2),
        vectors.load(array, row + 3),
        vectors.load(array, row + 4),
    )


@inlined_part
def as_guard(curve: Curve, origin: Origin, sign: Vector, shift: Vector) -> Curve:
    """The guard sign · (functional with its origin) + shift; sign is 1 or -1.

    Origins are cubic in time and add nothing to the sixth derivative.
    """
    return Curve(
        fused(sign, curve.value + origin.value, shift),
        sign * (curve.slope + origin.slope),
        sign * (curve.curvature + origin.curvature),
        curve.third_bound + vectors.magnitude(origin.third),
        curve.sixth_bound,
    )


@inlined_part
def low(guard: Curve, h: Vector) -> Vector:
    """Lower bound of a guard after a time h, concave in h.

    So a guard that is positive now stays positive up to any h for which the bound is positive.
    """
    bent = fused(guard.third_bound * -A_SIXTH, h, 0.5 * vectors.smaller(guard.curvature, 0.0))
    return fused(fused(bent, h, guard.slope), h, guard.value)


@inlined_part
def guess(guard: Curve, h: Vector) -> Vector:
    """Estimate of a guard after a time h.

    Where it is positive, the guard probably stays positive within h, and `between` can probably prove it.
    """
    square = h * h
    bent = fused(guard.third_bound * -_OF_THE_THIRD, h, 0.5 * guard.curvature)
    expected = fused(fused(bent, h, guard.slope), h, guard.value)
    return fused(guard.sixth_bound * -_OF_THE_SIXTH, square * square * square, expected)


@inlined_part
def falls_by(guard: Curve) -> Vector:
    """Lower bound of the distance that a guard falls before it turns back; 0 (or NaN) if it rises.

    The bound of its third derivative gives a least time for which the guard goes on falling. The distance is taken at
    nine tenths of this time, so that rounding does not matter. It is NaN or -inf where the curvature is so negative,
    and the guard so far from turning, that the time's denominator is rounded to zero.
    """
    fall, bend = vectors.larger(-guard.slope, 0.0), guard.curvature
    h = 1.8 * fall / (bend + vectors.root(fused(bend, bend, 2.0 * guard.third_bound * fall)))
    return h * (fall - h * fused(guard.third_bound * A_SIXTH, h, 0.5 * bend))


@inlined_part
def between(start: Curve, end: Curve, h: Vector) -> tuple[Vector, Vector]:
    """Bounds of a function within a time h, by its value, slope and curvature at both ends.

    For t from 0 to 1, the function f is the quintic through these six numbers, plus f⁽⁶⁾ h⁶/720 · t³ (t - 1)³ with f⁽⁶⁾
    at some time within. Since 20 t³ (1 - t)³ is the middle Bernstein polynomial of degree six, f lies between the least
    and the greatest of the quintic's seven Bernstein coefficients of that degree, the middle one widened by the bound
    of |f⁽⁶⁾| times h⁶/14400. The outer two coefficients are the values at the ends.

    Returns
    -------
    least, greatest : Vector
        Of the inner five coefficients, the middle one widened.
    """
    square = h * h
    s0, q0, s1, q1 = start.slope * h, start.curvature * square, end.slope * h, end.curvature * square
    a, b = fused(s0, A_SIXTH, start.value), fused(s1, -A_SIXTH, end.value)
    c = fused(q0, 1.0 / 30.0, fused(s0, 1.0 / 3.0, start.value))
    d = fused(q1, 1.0 / 30.0, fused(s1, -1.0 / 3.0, end.value))
    middle = 0.5 * (fused(q0, 0.05, fused(s0, 0.4, start.value)) + fused(q1, 0.05, fused(s1, -0.4, end.value)))
    least = vectors.smaller(vectors.smaller(a, b), vectors.smaller(c, d))
    greatest = vectors.larger(vectors.larger(a, b), vectors.larger(c, d))
    away = start.sixth_bound * (square * square * square) * _REMAINDER
    return vectors.smaller(least, middle - away), vectors.larger(greatest, middle + away)


@inlined_part
def turns_not(start: Curve, end: Curve, h: Vector) -> tuple[int, int]:
    """Lanes where a function is proved to be monotone within a time h, and lanes where it is proved to be concave."""
    square = h * h
    s0, q0, s1, q1 = start.slope * h, start.curvature * square, end.slope * h, end.curvature * square
    a, b = fused(q0, 0.25, s0), fused(q1, -0.25, s1)
    middle = 5.0 * (fused(q1, 0.05, fused(s1, -0.4, end.value)) - fused(q0, 0.05, fused(s0, 0.4, start.value)))
    remainder = start.sixth_bound * (square * square * square)
    away = remainder * _SLOPE_REMAINDER
    least = vectors.smaller(vectors.smaller(s0, s1), vectors.smaller(vectors.smaller(a, b), middle))
    greatest = vectors.larger(vectors.larger(s0, s1), vectors.larger(vectors.larger(a, b), middle))
    bend = 4.0 * vectors.larger(middle - a, b - middle)
    bent = vectors.larger(vectors.larger(q0, q1), bend) < -(remainder * _CURVATURE_REMAINDER)
    return (least > away) | (greatest < -away), bent
