"""Moving along a flow in its modal coordinates, and looking at a functional on the way.

The arrays are those of `flows.Flows`, for one flow and one functional, whose origin is its value, slope and curvature
for y = 0.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import polynomial
from clunk.core.flows import BLOCK, JERK, SPANS, TERMS
from clunk.core.jit import unowned, unowned_inlined

FloatArray = npt.NDArray[np.float64]
_INVERSE = tuple(1.0 / max(k, 1) for k in range(TERMS))
# scratch: 2 x (C,), (P,), 2 x (TERMS,), (TERMS, TERMS), (C,)
Work = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


@unowned_inlined
def copy(y: FloatArray, to: FloatArray) -> None:
    """Copy coordinates."""
    for b in range(0, y.size, 2 * BLOCK):
        for j in range(b, b + 2 * BLOCK):
            to[j] = y[j]


@unowned
def measure(y: FloatArray, amplitude: FloatArray) -> None:
    """The amplitude of each pair of coordinates."""
    for b in range(0, amplitude.size, BLOCK):
        for p in range(b, b + BLOCK):
            amplitude[p] = np.sqrt(y[2 * p] * y[2 * p] + y[2 * p + 1] * y[2 * p + 1])


@unowned_inlined
def observe(watch: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Value, slope and curvature of a functional, less its origin."""
    value, slope, curvature = 0.0, 0.0, 0.0
    for block in range(0, watch.shape[0], BLOCK):
        for p in range(block, block + BLOCK):
            a, b = y[2 * p], y[2 * p + 1]
            value += watch[p, 0] * a + watch[p, 1] * b
            slope += watch[p, 2] * a + watch[p, 3] * b
            curvature += watch[p, 4] * a + watch[p, 5] * b
    return value, slope, curvature


@unowned_inlined
def value(watch: FloatArray, y: FloatArray) -> float:
    """Value of a functional, less its origin."""
    total = 0.0
    for b in range(0, watch.shape[0], BLOCK):
        for p in range(b, b + BLOCK):
            total += watch[p, 0] * y[2 * p] + watch[p, 1] * y[2 * p + 1]
    return total


@unowned_inlined
def within(watch: FloatArray, which: int, amplitude: FloatArray) -> float:
    """What bounds a functional's third derivative (JERK), or its value less its origin (SWAY), from now on."""
    total = 0.0
    for b in range(0, amplitude.size, BLOCK):
        for p in range(b, b + BLOCK):
            total += watch[p, which] * amplitude[p]
    return total


@unowned
def move(generator: FloatArray, modes: bool, part: float, y: FloatArray, work: Work) -> None:
    """Move y by a part of the shortest span, by the Taylor series of the exponential."""
    size, scratch, moved = y.size, work[1], work[6]
    copy(y, scratch)
    if modes:
        for p in range(0, size, 2):
            a, b, c, d = generator[p, p], generator[p, p + 1], generator[p + 1, p], generator[p + 1, p + 1]
            y1, y2 = y[p], y[p + 1]
            for k in range(TERMS - 1, 0, -1):
                s = part * _INVERSE[k]
                y1, y2 = scratch[p] + s * (a * y1 + b * y2), scratch[p + 1] + s * (c * y1 + d * y2)
            y[p], y[p + 1] = y1, y2
        return
    for k in range(TERMS - 1, 0, -1):
        for r in range(size):
            total = 0.0
            for c in range(size):
                total += generator[r, c] * y[c]
            moved[r] = scratch[r] + part / k * total
        for r in range(size):
            y[r] = moved[r]


@unowned_inlined
def jump(propagator: FloatArray, k: int, y: FloatArray, amplitude: FloatArray) -> None:
    """Move y and the amplitudes of the modes by a span."""
    for block in range(0, amplitude.size, BLOCK):
        for p in range(block, block + BLOCK):
            a, b = y[2 * p], y[2 * p + 1]
            y[2 * p] = propagator[k, p, 0] * a + propagator[k, p, 1] * b
            y[2 * p + 1] = propagator[k, p, 2] * a + propagator[k, p, 3] * b
            amplitude[p] *= propagator[k, p, 4]


@unowned
def move_by(
    span: FloatArray,
    propagator: FloatArray,
    generator: FloatArray,
    modes: bool,
    work: Work,
    y: FloatArray,
    time: float,
) -> None:
    """Move y by any time, a sum of spans and a part of the shortest."""
    rest = time
    for k in range(SPANS - 1 if modes else 0, -1, -1):
        while span[k] <= rest:
            if modes:
                jump(propagator, k, y, work[2])
            else:
                move(generator, modes, 1.0, y, work)
            rest -= span[k]
    if rest > 0.0:
        move(generator, modes, rest / span[0], y, work)


@unowned
def expand(
    series: FloatArray,
    y: FloatArray,
    h: float,
    value: float,
    slope: float,
    curvature: float,
    c: FloatArray,
) -> None:
    """A functional's Taylor coefficients over the shortest span, its origin included."""
    for k in range(TERMS):
        total = 0.0
        for b in range(0, y.size, 2 * BLOCK):
            for j in range(b, b + 2 * BLOCK):
                total += series[k, j] * y[j]
        c[k] = total
    c[0] += value
    c[1] += h * slope
    c[2] += 0.5 * h * h * curvature


@unowned
def extremes(
    span: FloatArray,
    propagator: FloatArray,
    generator: FloatArray,
    watch: FloatArray,
    series: FloatArray,
    modes: bool,
    work: Work,
    y: FloatArray,
    origin: FloatArray,
    length: float,
    longest: int,
    largest: float,
    smallest: float,
) -> tuple[float, float]:
    """The extremes of a functional over a time, where they exceed those given; located, not sampled.

    A span is passed in which the functional is monotone, or cannot exceed them. Elsewhere the shortest span is
    expanded and searched.

    Parameters
    ----------
    y : (C,) float64
        At the beginning; kept.
    origin : (3,) float64
        Value, slope and curvature of the functional's origin at the beginning.
    length : float  [s]
    longest : int
        The longest span that fits into it, -1 for none.
    work
        Scratch.
    """
    at, amplitude, c, found = work[0], work[2], work[3], work[4]
    copy(y, at)
    measure(at, amplitude)
    rest_value, rest_slope, curvature = origin[0], origin[1], origin[2]
    rest, k = length, longest
    while rest > 0.0:
        v, d, e = observe(watch, at)
        v, d, e = v + rest_value, d + rest_slope, e + curvature
        most = within(watch, JERK, amplitude)
        largest, smallest = max(largest, v), min(smallest, v)
        while k >= 0:
            h = span[k]
            if h <= rest:
                bend = 0.5 * h * (abs(e) + h * most / 3.0)
                cannot = v + h * (max(d, 0.0) + bend) <= largest and v + h * (min(d, 0.0) - bend) >= smallest
                if cannot or abs(d) > h * (abs(e) + 0.5 * h * most):
                    break
            k -= 1
        h = span[max(k, 0)]
        if k < 0:
            expand(series, at, h, rest_value, rest_slope, curvature, c)
            high, low = polynomial.extremes_of(c, min(1.0, rest / h), found, work[5])
            largest, smallest = max(largest, high), min(smallest, low)
            if rest <= h:
                return largest, smallest
            k = 0
        if modes:
            jump(propagator, k, at, amplitude)
        else:
            move(generator, modes, 1.0, at, work)
            measure(at, amplitude)
        rest_value += h * (rest_slope + 0.5 * h * curvature)
        rest_slope += h * curvature
        rest -= h
        k = min(k + 2, longest)
    last = value(watch, at) + rest_value
    return max(largest, last), min(smallest, last)


@unowned
def lowest_turn(
    span: FloatArray,
    propagator: FloatArray,
    generator: FloatArray,
    watch: FloatArray,
    series: FloatArray,
    modes: bool,
    work: Work,
    sign: float,
    shift: float,
    y: FloatArray,
    origin: FloatArray,
    length: float,
    longest: int,
    bar: float,
) -> float:
    """The lowest value at which a guard turns from falling to rising within a time, where below `bar`; else infinite.

    As in `extremes`, a span is passed in which the guard is monotone or stays above the bar, and the shortest one is
    expanded elsewhere.

    Parameters
    ----------
    sign, shift : float
        The guard is sign times the functional plus shift.
    y, origin, length, longest, work
        As of `extremes`.
    """
    at, amplitude, c, found = work[0], work[2], work[3], work[4]
    copy(y, at)
    measure(at, amplitude)
    rest_value, rest_slope, curvature = origin[0], origin[1], origin[2]
    rest, k, lowest = length, longest, np.inf
    while rest > 0.0:
        v, d, e = observe(watch, at)
        v, d, e = sign * (v + rest_value) + shift, sign * (d + rest_slope), abs(e + curvature)
        most = within(watch, JERK, amplitude)
        while k >= 0:
            h = span[k]
            if h <= rest:
                above = v + h * (min(d, 0.0) - 0.5 * h * (e + h * most / 3.0)) >= bar
                if above or abs(d) > h * (e + 0.5 * h * most):
                    break
            k -= 1
        h = span[max(k, 0)]
        if k < 0:
            expand(series, at, h, rest_value, rest_slope, curvature, c)
            falls = sign * c[1] < 0.0
            for turn in range(polynomial.turning_points(c, min(1.0, rest / h), found, work[5])):
                value = sign * polynomial.value_of(c, TERMS, found[turn]) + shift
                if falls and value < bar:
                    bar, lowest = value, value
                falls = not falls
            k = 0
        if modes:
            jump(propagator, k, at, amplitude)
        else:
            move(generator, modes, 1.0, at, work)
            measure(at, amplitude)
        rest_value += h * (rest_slope + 0.5 * h * curvature)
        rest_slope += h * curvature
        rest -= h
        k = min(k + 2, longest)
    return lowest


@unowned
def depth(
    span: FloatArray,
    propagator: FloatArray,
    generator: FloatArray,
    watch: FloatArray,
    series: FloatArray,
    modes: bool,
    work: Work,
    sign: float,
    shift: float,
    y: FloatArray,
    origin: FloatArray,
    limit: float,
) -> float:
    """How far a guard that has just turned negative would go before it turned back; at most `limit`.

    Parameters
    ----------
    sign, shift : float
        The guard is sign times the functional plus shift.
    y : (C,) float64
        At the event; kept.
    origin : (3,) float64
        Value, slope and curvature of the functional's origin there.
    """
    at, amplitude, c, found = work[0], work[2], work[3], work[4]
    copy(y, at)
    measure(at, amplitude)
    rest_value, rest_slope, curvature = origin[0], origin[1], origin[2]
    highest = SPANS - 1 if modes else 0
    k, reached = 0, 0.0
    for _ in range(1000):  # a guard that never turns back comes to rest
        v, d, e = observe(watch, at)
        reached = -(sign * (v + rest_value) + shift)
        if reached >= limit:
            return limit
        falling, bending = -sign * (d + rest_slope), max(sign * (e + curvature), 0.0)
        most = 0.5 * within(watch, JERK, amplitude)
        k = max(k, 0)
        while k < highest and falling > span[k + 1] * (bending + span[k + 1] * most):
            k += 1
        while k >= 0 and not falling > span[k] * (bending + span[k] * most):
            k -= 1
        h = span[max(k, 0)]
        if k < 0:
            expand(series, at, h, rest_value, rest_slope, curvature, c)
            if sign * c[1] >= 0.0:
                break
            if polynomial.turning_points(c, 1.0, found, work[5]) > 0:
                reached = -(sign * polynomial.value_of(c, TERMS, found[0]) + shift)
                break
        if modes:
            jump(propagator, max(k, 0), at, amplitude)
        else:
            move(generator, modes, 1.0, at, work)
            measure(at, amplitude)
        rest_value += h * (rest_slope + 0.5 * h * curvature)
        rest_slope += h * curvature
    return min(max(reached, 0.0), limit)
