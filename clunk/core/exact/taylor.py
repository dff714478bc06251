"""Taylor series of functionals over the shortest span, one in each lane: their zeros and turning points.

The variable s of a series is time as a share of the shortest span, from 0 to 1.
"""

from clunk.core.arrays import FloatArray
from clunk.core.exact.curves import A_SIXTH, Origin
from clunk.core.exact.flows import LONG, TERMS
from clunk.core.jit import part
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import Table, Vector, fused

_HALVINGS = 40  # of a part, at most; a zero that is neither proved nor excluded then is taken to be at the beginning


@part
def expand(
    series: Table,
    work: FloatArray,
    size: int,
    shortest: Vector,
    sign: Vector,
    shift: Vector,
    origin: Origin,
    c: FloatArray,
) -> Vector:
    """Set `c` to the Taylor coefficients of sign · functional + shift over the shortest span.

    Returns the sum of the magnitudes of the terms that add up to c[0], which its rounding is relative to.

    shortest : the span  [s]
    c : (TERMS, WIDTH) float64
        Output.
    """
    terms = vectors.magnitude(origin.value) + vectors.magnitude(shift)
    for k in range(size):
        terms += vectors.magnitude(vectors.load(work, k) * vectors.number(series, k * LONG))
    for j in range(TERMS):
        total = vectors.splat(0.0)
        for k in range(size):
            total = fused(vectors.load(work, k), vectors.number(series, k * LONG + j), total)
        if j == 0:
            total += origin.value
        elif j == 1:
            total += shortest * origin.slope
        elif j == 2:
            total += 0.5 * shortest * shortest * origin.curvature
        elif j == 3:
            total += A_SIXTH * shortest * shortest * shortest * origin.third
        vectors.store(c, j, sign * total)
    vectors.store(c, 0, vectors.load(c, 0) + shift)
    return terms


@part
def derivatives(c: FloatArray, s: Vector) -> tuple[Vector, Vector, Vector]:
    """Value, slope and half the second derivative of a series, by Horner's rule."""
    value = vectors.load(c, TERMS - 1)
    slope = half = vectors.splat(0.0)
    for k in range(TERMS - 2, -1, -1):
        half = fused(half, s, slope)
        slope = fused(slope, s, value)
        value = fused(value, s, vectors.load(c, k))
    return value, slope, half


@part
def shift(c: FloatArray, by: Vector) -> None:
    """Expand a series about s = `by` instead of 0, in place."""
    for k in range(TERMS - 1):
        for j in range(TERMS - 2, k - 1, -1):
            vectors.store(c, j, fused(by, vectors.load(c, j + 1), vectors.load(c, j)))


@part
def first_zero(c: FloatArray, near: int, part: Vector) -> tuple[int, Vector, Vector, Vector, Vector]:
    """First zeros of series within a part of the shortest span, which is halved until it is known whether it has one.

    near : the lanes to look at

    Returns
    -------
    crosses : int
        The lanes where a series turns negative, or is negative at the beginning, or where after _HALVINGS it is still
        not known; these have s = 0.
    s, slope, half : Vector
        The zero, the slope there, and half the curvature.
    part : Vector
        The part within which the series of the other lanes stay positive.
    """
    for _ in range(_HALVINGS):
        crosses, positive, s, slope, half = crossing(c, part, False)
        unclear = near & ~crosses & ~positive
        if not unclear:
            break
        part = vectors.choose(unclear, 0.5 * part, part)
    return crosses & near | unclear, vectors.choose(unclear, 0.0, s), slope, half, part


@part
def crossing(c: FloatArray, length: Vector, only: bool) -> tuple[int, int, Vector, Vector, Vector]:
    """First zero of a series that falls, or is concave, all the way to it; the beginning of a series negative there.

    length : how far to look, at most 1
    only : whether the series has to fall, or be concave, over all the length, so that it has no other zero

    Returns
    -------
    crosses : int
        The lanes that have such a zero, or a negative beginning.
    positive : int
        The lanes where the series is proved to be nowhere negative within the length.
    s, slope, half : Vector
        The zero, the slope there, and half the curvature.
    """
    c0, c1, c2 = vectors.load(c, 0), vectors.load(c, 1), vectors.load(c, 2)
    # first guess: the zero of the first three terms; then Halley's method
    root, negative = vectors.root(vectors.larger(c1 * c1 - 4.0 * c0 * c2, 0.0)), c0 < 0.0
    s = vectors.choose(c1 < 0.0, 2.0 * c0 / (root - c1), -0.5 * (c1 + root) / c2)
    s, slope, half, crosses = vectors.choose(negative, 0.0, s), c1, c2, 0
    alive = ~negative & (s >= 0.0)
    for _ in range(3):
        alive &= s <= length
        if not alive:
            break
        value, slope_here, half_here = derivatives(c, s)
        moved = s - value * slope_here / (slope_here * slope_here - value * half_here)
        s = vectors.choose(alive, moved, s)
        slope, half = vectors.choose(alive, slope_here, slope), vectors.choose(alive, half_here, half)
        # the error that is left, as a share of this step, is about the square of the slope's relative change over it
        steady = vectors.magnitude(value * half_here) <= 2e-5 * (slope_here * slope_here)
        steady &= vectors.magnitude(value) <= 2e-5 * vectors.magnitude(slope_here)
        converged = alive & steady & (s >= 0.0) & (s <= length)
        crosses |= converged
        alive &= ~converged
    rise = bend = fall = vectors.splat(0.0)
    end = length if only else s
    for k in range(TERMS - 1, 1, -1):
        term = vectors.load(c, k)
        up = vectors.larger(term, 0.0)
        fall = fused(fall, length, term - up)
        rise = fused(rise, end, float(k) * up)
        if k > 2:
            bend = fused(bend, end, float(k * (k - 1)) * up)
    crosses &= (c1 + rise * end < 0.0) | (2.0 * c2 + bend * end < 0.0)
    least = c0 + length * vectors.smaller(c1 + length * fall, 0.0)
    return crosses | negative, least >= 0.0, s, slope, half


@part
def turning(c: FloatArray, slopes: FloatArray, length: Vector) -> tuple[int, int, Vector]:
    """The turning point of a series that has only one within a length.

    c : (TERMS + 1, WIDTH) float64, zero in the last row
    slopes : (TERMS, WIDTH) float64
        Scratch.

    Returns
    -------
    turns : int
        The lanes that have such a turning point.
    straight : int
        The lanes where the series is proved to have no turning point.
    s : Vector
        Where it is.
    """
    falls = vectors.load(c, 1) < 0.0
    for k in range(TERMS):
        term = vectors.load(c, k + 1) * float(k + 1)
        vectors.store(slopes, k, vectors.choose(falls, -term, term))
    turns, straight, s, _, _ = crossing(slopes, length, True)
    return turns, straight, s
