"""Moving along a flow in its modal coordinates, and looking at a functional on the way.

The arrays are those of `flows.Flows`, for one flow and one functional, whose origin is its value, slope and curvature
for y = 0.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import lanes, polynomial
from clunk.core.flows import BLOCK, CROSS, CURVATURE, DECAY, JERK, OWN, SLOPE, SPANS, TERMS, VALUE
from clunk.core.jit import unowned, unowned_inlined
from clunk.core.lanes import WIDTH, Lanes

FloatArray = npt.NDArray[np.float64]
_SIXTH = 1.0 / 6.0 * (1.0 + 1e-15)  # a product is quicker than a division
# scratch: 3 x (C,), (LONG,), (TERMS,), (TERMS, TERMS), (C,)
Work = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


@unowned_inlined
def copy(y: FloatArray, to: FloatArray) -> None:
    """Copy coordinates."""
    for b in range(y.size // WIDTH):
        lanes.store(to, b, lanes.load(y, b))


@unowned_inlined
def measure(y: FloatArray, amplitude: FloatArray) -> None:
    """The amplitude of each pair of coordinates, in both their places."""
    for b in range(y.size // WIDTH):
        row = lanes.load(y, b)
        squares = lanes.times(row, row)
        lanes.store(amplitude, b, lanes.root(lanes.plus(squares, lanes.swapped(squares))))


@unowned_inlined
def look(watch: FloatArray, y: FloatArray, first: int) -> Lanes:
    """VALUE, SLOPE and CURVATURE of a functional, less its origin, by the pairs from the one at `first` on."""
    if first == 0:
        total = _seen(watch, y, 0, BLOCK)
        for b in range(WIDTH, y.size, WIDTH):
            total = lanes.plus(total, _seen(watch, y, b, b + BLOCK))
        return total
    total = lanes.splat(0.0)
    for b in range(0, y.size, WIDTH):
        total = lanes.plus(total, _seen(watch, y, max(b, first), b + BLOCK))
    return total


@unowned_inlined
def _seen(watch: FloatArray, y: FloatArray, first: int, end: int) -> Lanes:
    one, other = lanes.splat(0.0), lanes.splat(0.0)
    for p in range(first, end):
        one = lanes.plus_times(one, lanes.load(watch, p), lanes.number(y, p))
        other = lanes.plus_times(other, lanes.load(watch, p + BLOCK), lanes.number(y, p + BLOCK))
    return lanes.plus(one, other)


@unowned_inlined
def bounds(watch: FloatArray, amplitude: FloatArray, first: int) -> Lanes:
    """JERK and SWAY of a functional from now on, by the pairs from the one at `first` on."""
    if first == 0:
        total = _bounded(watch, amplitude, 0, BLOCK)
        for b in range(WIDTH, amplitude.size, WIDTH):
            total = lanes.plus(total, _bounded(watch, amplitude, b, b + BLOCK))
        return total
    total = lanes.splat(0.0)
    for b in range(0, amplitude.size, WIDTH):
        total = lanes.plus(total, _bounded(watch, amplitude, max(b, first), b + BLOCK))
    return total


@unowned_inlined
def _bounded(watch: FloatArray, amplitude: FloatArray, first: int, end: int) -> Lanes:
    total = lanes.splat(0.0)
    for p in range(first, end):
        total = lanes.plus_times(total, lanes.load(watch, amplitude.size + p), lanes.number(amplitude, p))
    return total


@unowned_inlined
def observe(watch: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Value, slope and curvature of a functional, less its origin."""
    seen = look(watch, y, 0)
    return lanes.lane(seen, VALUE), lanes.lane(seen, SLOPE), lanes.lane(seen, CURVATURE)


@unowned_inlined
def within(watch: FloatArray, which: int, amplitude: FloatArray) -> float:
    """What bounds a functional's third derivative (JERK), or its value less its origin (SWAY), from now on."""
    return float(lanes.lane(bounds(watch, amplitude, 0), which))


@unowned
def move(power: FloatArray, generator: FloatArray, modes: bool, part: float, y: FloatArray, work: Work) -> None:
    """Move y by a part of the shortest span, by the Taylor series of the exponential."""
    if modes:
        for b in range(y.size // WIDTH):
            row = lanes.load(y, b)
            partner = lanes.swapped(row)
            total = lanes.splat(0.0)
            for k in range(TERMS - 1, -1, -1):
                at = (k * (y.size // WIDTH) + b) * 2
                term = lanes.times(lanes.load(power, at + OWN), row)
                term = lanes.plus(term, lanes.times(lanes.load(power, at + CROSS), partner))
                total = lanes.plus_times(term, total, part)
            lanes.store(y, b, total)
        return
    size, scratch, moved = y.size, work[1], work[6]
    copy(y, scratch)
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
    blocks = y.size // WIDTH
    for b in range(blocks):
        row, at = lanes.load(y, b), (k * blocks + b) * 3
        own = lanes.times(lanes.load(propagator, at + OWN), row)
        lanes.store(y, b, lanes.plus(own, lanes.times(lanes.load(propagator, at + CROSS), lanes.swapped(row))))
        lanes.store(amplitude, b, lanes.times(lanes.load(propagator, at + DECAY), lanes.load(amplitude, b)))


@unowned
def move_by(
    span: FloatArray,
    propagator: FloatArray,
    power: FloatArray,
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
                move(power, generator, modes, 1.0, y, work)
            rest -= span[k]
    if rest > 0.0:
        move(power, generator, modes, rest / span[0], y, work)


@unowned_inlined
def expand(
    series: FloatArray,
    y: FloatArray,
    h: float,
    value: float,
    slope: float,
    curvature: float,
    c: FloatArray,
) -> None:
    """A functional's Taylor coefficients over the shortest span, its origin included.

    c : (LONG,) float64
        Output; zero from TERMS on.
    """
    low, high = lanes.splat(0.0), lanes.splat(0.0)
    for b in range(0, y.size, WIDTH):
        for j in range(b, b + WIDTH):
            low = lanes.plus_times(low, lanes.load(series, 2 * j), lanes.number(y, j))
            high = lanes.plus_times(high, lanes.load(series, 2 * j + 1), lanes.number(y, j))
    lanes.store(c, 0, low)
    lanes.store(c, 1, high)
    c[0] += value
    c[1] += h * slope
    c[2] += 0.5 * h * h * curvature


@unowned_inlined
def _bend(h: Lanes, curvature: float, jerk: float) -> Lanes:
    """How far, for each unit of time, a functional may part from its tangent within times h."""
    return lanes.times(h, lanes.plus_times(lanes.splat(0.5 * abs(curvature)), h, jerk * _SIXTH))


@unowned_inlined
def _turn(h: Lanes, slope: float, curvature: float, jerk: float) -> Lanes:
    """Negative where a functional is monotone within times h: how far its slope may cross zero, convex in h."""
    away = -curvature if slope > 0.0 else curvature
    return lanes.plus(lanes.splat(-abs(slope)), lanes.times(h, lanes.plus_times(lanes.splat(away), h, 0.5 * jerk)))


@unowned
def extremes(
    span: FloatArray,
    propagator: FloatArray,
    power: FloatArray,
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
        Where to look first for spans to pass: the longest that fits into it, -1 for none.
    work
        Scratch.
    largest, smallest : float
        The value at the end is within.
    """
    at, amplitude, long_c, found = work[0], work[2], work[3], work[4]
    c = long_c[:TERMS]
    copy(y, at)
    measure(at, amplitude)
    rest_value, rest_slope, curvature = origin[0], origin[1], origin[2]
    rest, k = length, longest
    while rest > 0.0:
        v, d, e = observe(watch, at)
        v, d, e = v + rest_value, d + rest_slope, e + curvature
        most = within(watch, JERK, amplitude)
        largest, smallest = max(largest, v), min(smallest, v)
        base = max(min(k + 1, SPANS) - WIDTH, 0)
        while True:
            h = lanes.load_from(span, base)
            bend = _bend(h, e, most)
            over = lanes.plus(lanes.splat(v - largest), lanes.times(h, lanes.plus(lanes.splat(max(d, 0.0)), bend)))
            under = lanes.plus(lanes.splat(smallest - v), lanes.times(h, lanes.plus(lanes.splat(max(-d, 0.0)), bend)))
            passing = lanes.either_below(lanes.larger(over, under), _turn(h, d, e, most))
            if passing > 0 or base == 0:
                break
            base = max(base - WIDTH, 0)
        k = base + passing - 1 if modes else min(passing - 1, 0)
        h = span[max(k, 0)]
        if k < 0:
            expand(series, at, h, rest_value, rest_slope, curvature, long_c)
            high, low = polynomial.extremes_of(c, min(1.0, rest / h), found, work[5])
            largest, smallest = max(largest, high), min(smallest, low)
            k = 0
        if rest <= h:
            break
        if modes:
            jump(propagator, k, at, amplitude)
        else:
            move(power, generator, modes, 1.0, at, work)
            measure(at, amplitude)
        rest_value += h * (rest_slope + 0.5 * h * curvature)
        rest_slope += h * curvature
        rest -= h
        k = longest
    return largest, smallest


@unowned
def lowest_turn(
    span: FloatArray,
    propagator: FloatArray,
    power: FloatArray,
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
    at, amplitude, long_c, found = work[0], work[2], work[3], work[4]
    c = long_c[:TERMS]
    copy(y, at)
    measure(at, amplitude)
    rest_value, rest_slope, curvature = origin[0], origin[1], origin[2]
    rest, k, lowest = length, longest, np.inf
    while rest > 0.0:
        v, d, e = observe(watch, at)
        v, d, e = sign * (v + rest_value) + shift, sign * (d + rest_slope), sign * (e + curvature)
        most = within(watch, JERK, amplitude)
        base = max(min(k + 1, SPANS) - WIDTH, 0)
        while True:
            h = lanes.load_from(span, base)
            fall = lanes.plus(lanes.splat(max(-d, 0.0)), _bend(h, e, most))
            under = lanes.plus(lanes.splat(bar - v), lanes.times(h, fall))
            concave = lanes.plus_times(lanes.splat(e), h, most)  # negative where it can only turn the other way
            passing = lanes.either_below(under, lanes.smaller(_turn(h, d, e, most), concave))
            if passing > 0 or base == 0:
                break
            base = max(base - WIDTH, 0)
        k = base + passing - 1 if modes else min(passing - 1, 0)
        h = span[max(k, 0)]
        if k < 0:
            expand(series, at, h, rest_value, rest_slope, curvature, long_c)
            falls = sign * c[1] < 0.0
            for turn in range(polynomial.turning_points(c, min(1.0, rest / h), found, work[5])):
                value = sign * polynomial.value_of(c, TERMS, found[turn]) + shift
                if falls and value < bar:
                    bar, lowest = value, value
                falls = not falls
            k = 0
        if rest <= h:
            break
        if modes:
            jump(propagator, k, at, amplitude)
        else:
            move(power, generator, modes, 1.0, at, work)
            measure(at, amplitude)
        rest_value += h * (rest_slope + 0.5 * h * curvature)
        rest_slope += h * curvature
        rest -= h
        k = longest
    return lowest


@unowned
def depth(
    span: FloatArray,
    propagator: FloatArray,
    power: FloatArray,
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
    at, amplitude, long_c, found = work[0], work[2], work[3], work[4]
    c = long_c[:TERMS]
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
        falling, bending = -sign * (d + rest_slope), sign * (e + curvature)
        most = 0.5 * within(watch, JERK, amplitude)
        k = max(k, 0)
        while k < highest and falling > span[k + 1] * (bending + span[k + 1] * most):
            k += 1
        while k >= 0 and not falling > span[k] * (bending + span[k] * most):
            k -= 1
        h = span[max(k, 0)]
        if k < 0:
            expand(series, at, h, rest_value, rest_slope, curvature, long_c)
            if sign * c[1] >= 0.0:
                break
            if polynomial.turning_points(c, 1.0, found, work[5]) > 0:
                reached = -(sign * polynomial.value_of(c, TERMS, found[0]) + shift)
                break
        if modes:
            jump(propagator, max(k, 0), at, amplitude)
        else:
            move(power, generator, modes, 1.0, at, work)
            measure(at, amplitude)
        rest_value += h * (rest_slope + 0.5 * h * curvature)
        rest_slope += h * curvature
    return min(max(reached, 0.0), limit)
