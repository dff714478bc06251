"""The exact method: through the regimes by their modes, over spans in which no guard can turn negative.

From a guard's value, slope and curvature and a bound on its third derivative follows the longest tabulated span that
cannot hold a zero of it. Where not even the shortest can be passed so, the guard is expanded there into its Taylor
series, exact to rounding, and the series' first zero, if it has one, is the event. So no event is skipped, to
rounding, for this model.

The severity's extremes are located by the same means, where the acceleration could exceed what the window holds; and
so are the near misses, which give the run's margin: how near it came to another label. It is the smallest of

- positive, what did not happen: the distance to a flank where the gap coordinate turned back, as a share of the whole
  gap; and where a contact held, later than the sticking time, the least overlap of the flanks (restitution: the least
  torque that locks them), as a share of its value at rest;
- negative, what did: how much further a crossing, or the end of a sticking contact, would have gone, were the contact
  not to change; and one less the length of a contact over the sticking time, of either sign.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import lanes, modal, polynomial
from clunk.core.events import LOAD_STEP, LOCK, OPENING, REJOIN, SEPARATION, TOUCH
from clunk.core.flows import BLOCK, CURVATURE, JERK, LONG, SLOPE, SPANS, SWAY, TERMS, VALUE, Flows
from clunk.core.jit import compiled, unowned, unowned_inlined
from clunk.core.lanes import WIDTH
from clunk.core.regimes import ACCELERATION, CLOSED_FLOW, CLOSED_POSITIVE, FORCE, GAP, System
from clunk.core.status import INTERRUPTED, QUALITY_COMPLETE, QUALITY_GRAZING, Status
from clunk.core.switching import ROUNDING, pass_on, record, room_for_a_switch, strike

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Space = tuple[FloatArray, modal.Work, FloatArray, FloatArray, IntArray]

_OK = int(Status.OK)
_NON_FINITE = int(Status.NON_FINITE)
_EVENT_BUFFER_FULL = int(Status.EVENT_BUFFER_FULL)

MOST = 0.25  # margins from here on are all alike
GRAZING = 1e-12  # a guard that turns back within this share of its scale has not turned negative
_SIXTH = 1.0 / 6.0 * (1.0 + 1e-15)  # a product is quicker than a division
_MOST_DIP = 4.0 / 27.0 * (1.0 + 1e-15)  # of a Hermite cubic below both its ends, in (0, 1), for a slope of 1
_CLOSED = -np.inf  # a window of severity that nothing can exceed

# How a phase ends, if not by a guard.
_AT_END, _SETTLED, _STOPPED, _LOST = -1, -2, -3, -4


@compiled
def run(
    system: System,
    flows: Flows,
    x: FloatArray,
    regime: int,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    stop: npt.NDArray[np.uint8],
) -> tuple[int, int, int, float, float]:
    """Run from the load step to the end time, or until nothing can follow.

    Parameters
    ----------
    system : System
    flows : Flows
    x : (N,) float64  [rad, rad/s]
        State at the load step; overwritten.
    regime : int
        The regime that `x` is in.
    torque : float  [N m]
        Load torque after the step.
    half_gap : float  [rad]
    events : (capacity,) EVENT
        Output. Event 0 is the load step.
    states : (capacity, N) float64  [rad, rad/s]
        Output: the state at each event; or no rows at all, and none are kept.
    stop : (1,) uint8
        Set to non-zero from another thread to abandon the run.

    Returns
    -------
    status : int
    count : int
        Events written, the load step included.
    quality : int
        QUALITY_COMPLETE, QUALITY_GRAZING.
    margin : float
        Dimensionless, from -MOST to MOST.
    end : float  [s after the load step]
        Where the run stopped.
    """
    return run_in(workspace(flows), system, flows, x, regime, torque, half_gap, events, states, stop)


@compiled
def workspace(flows: Flows) -> Space:
    """What `run_in` takes, for any number of runs, one after the other."""
    rows = np.empty((7, flows.basis.shape[1]))
    scratch = (
        rows[3],
        rows[4],
        rows[5],
        np.empty(LONG),
        np.empty(TERMS),
        np.empty((TERMS, TERMS)),
        rows[6],
    )
    return rows, scratch, np.empty((3, 2)), np.empty((4, 3)), np.empty(2, np.int64)


@unowned
def run_in(
    space: Space,
    system: System,
    flows: Flows,
    x: FloatArray,
    regime: int,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    stop: npt.NDArray[np.uint8],
) -> tuple[int, int, int, float, float]:
    """`run`, in work space that it is given."""
    rows, scratch, guard, origin, at = space
    origins, origin_output, coordinates, basis = flows.origin, flows.origin_output, flows.coordinates, flows.basis
    span, propagator, power, generator = flows.span, flows.propagator, flows.power, flows.generator
    watch, series, modal_flow, ringing, steady = flows.watch, flows.series, flows.modal, flows.ringing, flows.steady
    regimes, table, lash = system.regimes, system.guards, system.lash
    impulsive, sticking_time, end_time = system.impulsive, system.sticking_time, system.end_time
    y, before, amplitude = rows[0], rows[1], rows[2]
    here, origin = origin[3], origin[:3]
    by_force = impulsive == 0 and table[CLOSED_POSITIVE, 0].functional != GAP
    sign, shift, scale = guard[0], guard[1], guard[2]
    margin, quality = MOST, 0
    static = _static(system, flows, regime, torque, half_gap, x)
    record(events, states, 0, 0.0, 0.0, LOAD_STEP, regime, regimes[regime].side, x)
    count, time, fastest = 1, 0.0, 0.0
    zero_guard, zero_order = -1, 0
    last_side, began, from_sticking = regimes[regime].side, -np.inf, False
    high, low = -_CLOSED, _CLOSED  # nothing is asked of the acceleration before the first primary impact
    while True:
        flow, gap_input, guards = regimes[regime].flow, regimes[regime].side * half_gap, regimes[regime].guards
        for k in range(2):
            row = table[regime, min(k, guards - 1)]  # a single guard stands for two
            at[k], sign[k], shift[k] = row.functional, row.sign, row.offset * half_gap
            scale[k] = static if flow == CLOSED_FLOW else 2.0 * half_gap
        watched = guards
        if by_force and regimes[regime].side != 0:
            # the flanks may press less than nothing on each other; a miss is near where they all but cease to overlap
            at[1], sign[1], shift[1], scale[0], scale[1] = GAP, regimes[regime].side, -half_gap, 0.0, static
            watched = 2
            if flow != CLOSED_FLOW:
                row = table[regime, 1]
                at[1], sign[1], shift[1] = row.functional, row.sign, row.offset * half_gap
                scale[0], scale[1] = static, 0.0
        _enter(origins[flow], origin_output[flow], coordinates[flow], at, torque, gap_input, x, y, amplitude, origin)
        ended, elapsed, largest, smallest, high, low, margin, grazed = _phase(
            span[flow],
            propagator[flow],
            power[flow],
            generator[flow],
            watch[flow],
            series[flow],
            modal_flow[flow] != 0,
            ringing[flow],
            steady[flow] != 0,
            guards,
            watched,
            at,
            sign,
            shift,
            scale,
            origin,
            y,
            before,
            amplitude,
            scratch,
            here,
            zero_guard,
            zero_order,
            end_time - time,
            began + sticking_time - time if flow == CLOSED_FLOW else -np.inf,
            high,
            low,
            margin,
            stop,
        )
        events[count - 1].max_acceleration = largest
        events[count - 1].min_acceleration = smallest
        time += elapsed
        if grazed:
            quality = QUALITY_GRAZING
        if ended == _SETTLED:
            return _OK, count, quality | QUALITY_COMPLETE, margin, time
        if ended == _AT_END:
            return _OK, count, quality, margin, end_time
        if ended == _STOPPED:
            return INTERRUPTED, count, quality, margin, time
        if ended == _LOST or not _leave(origins[flow], basis[flow], torque, gap_input, elapsed, y, before, x):
            return _NON_FINITE, count, quality, margin, time
        if not room_for_a_switch(impulsive, half_gap, events.size, count):
            return _EVENT_BUFFER_FULL, count, quality, margin, time

        kind, age = table[regime, ended].event_kind, time - began
        crossed = kind == TOUCH and (1 if ended == 0 else -1) != last_side
        # by force it is the opening that counts, after a contact that held
        parted = kind == OPENING and from_sticking if by_force else kind == SEPARATION and age > sticking_time
        if (crossed or parted) and scale[ended] > 0.0:
            _move_origin(origin, ended, elapsed, here)
            beyond = modal.depth(
                span[flow],
                propagator[flow],
                power[flow],
                generator[flow],
                watch[flow, at[ended]],
                series[flow, at[ended]],
                modal_flow[flow] != 0,
                scratch,
                sign[ended],
                shift[ended],
                y,
                here,
                abs(margin) * scale[ended],
            )
            if beyond < abs(margin) * scale[ended]:
                margin = -beyond / scale[ended]
        if kind == SEPARATION and abs(age - sticking_time) < abs(margin) * sticking_time:
            margin = 1.0 - age / sticking_time

        if kind == REJOIN and age > sticking_time and static > 0.0:
            # the overlap is least here or soon after: where it all but vanishes, rounding decides which
            overlap = -half_gap
            for k in range(x.size):
                overlap += regimes[regime].side * system.functionals[CLOSED_FLOW, GAP, k] * x[k]
            if max(overlap, 0.0) / static < abs(margin):
                margin = max(overlap, 0.0) / static

        known = count
        if impulsive == 0:
            count, regime, zero_guard, zero_order = pass_on(
                regimes, table, lash, regime, ended, time, x, events, states, count
            )
        else:
            count, regime, zero_guard, zero_order, fastest = strike(
                system, regime, ended, time, x, torque, half_gap, events, states, count, fastest
            )
        for k in range(known, count):
            kind = events[k].kind
            if kind == TOUCH:
                if events[k].side != last_side or from_sticking:
                    high, low = _CLOSED, -_CLOSED  # a primary impact: a new window
                last_side, began, from_sticking = events[k].side, time, False
            elif kind == LOCK:
                began = time
            elif kind == SEPARATION:
                from_sticking = time - began > sticking_time


@unowned
def _static(system: System, flows: Flows, regime: int, torque: float, half_gap: float, x: FloatArray) -> float:
    """The overlap of the flanks, or the torque that locks them, at rest under the torque after the load step.

    Without such rest, what it is at the load step.
    """
    f = FORCE if system.impulsive != 0 else GAP
    offset = 0.0 if system.impulsive != 0 else half_gap
    most = 0.0
    for side in (1, -1):
        value = flows.origin_output[CLOSED_FLOW, 0, f, 0] * torque
        value += flows.origin_output[CLOSED_FLOW, 0, f, 1] * side * half_gap
        if flows.steady[CLOSED_FLOW] != 0:
            most = max(most, side * value - offset)
    side = system.regimes[regime].side
    if most > 0.0 or side == 0:
        return float(most)
    value = 0.0
    for k in range(x.size):
        value += system.functionals[CLOSED_FLOW, f, k] * x[k]
    return float(max(side * value - offset, 0.0))


@unowned_inlined
def _enter(
    origins: FloatArray,
    origin_output: FloatArray,
    coordinates: FloatArray,
    at: IntArray,
    torque: float,
    gap_input: float,
    x: FloatArray,
    y: FloatArray,
    amplitude: FloatArray,
    origin: FloatArray,
) -> None:
    """A state in a flow's coordinates, and the origins of both guards' functionals and of the acceleration."""
    for k in range(3):
        f = at[k] if k < 2 else ACCELERATION
        for j in range(3):
            origin[k, j] = origin_output[j, f, 0] * torque + origin_output[j, f, 1] * gap_input
    blocks = y.size // WIDTH
    for b in range(blocks):
        lanes.store(amplitude, b, _origin(origins, 0, blocks, b, torque, gap_input))
    for b in range(blocks):
        total = lanes.splat(0.0)
        for k in range(x.size):
            away = x[k] - lanes.number(amplitude, k)
            total = lanes.plus_times(total, lanes.load(coordinates, k * blocks + b), away)
        lanes.store(y, b, total)
    modal.measure(y, amplitude)


@unowned_inlined
def _leave(
    origins: FloatArray,
    basis: FloatArray,
    torque: float,
    gap_input: float,
    elapsed: float,
    y: FloatArray,
    moved: FloatArray,
    x: FloatArray,
) -> bool:
    """Back to the state; whether it is finite. `moved` is scratch."""
    blocks, half = y.size // WIDTH, 0.5 * elapsed * elapsed
    total = 0.0
    for b in range(blocks):
        row = _origin(origins, 0, blocks, b, torque, gap_input)
        row = lanes.plus_times(row, _origin(origins, 1, blocks, b, torque, gap_input), elapsed)
        row = lanes.plus_times(row, _origin(origins, 2, blocks, b, torque, gap_input), half)
        away = lanes.splat(0.0)
        for j in range(y.size):
            away = lanes.plus_times(away, lanes.load(basis, j * blocks + b), lanes.number(y, j))
        lanes.store(moved, b, lanes.plus(row, away))
    for k in range(x.size):
        x[k] = lanes.number(moved, k)
        total += abs(x[k])
    return bool(np.isfinite(total))


@unowned_inlined
def _origin(origins: FloatArray, order: int, blocks: int, b: int, torque: float, gap_input: float) -> lanes.Lanes:
    """Eight states of a particular solution, or of its slope or curvature."""
    at = order * 2 * blocks + b
    row = lanes.times(lanes.load(origins, at), lanes.splat(torque))
    return lanes.plus_times(row, lanes.load(origins, at + blocks), gap_input)


@unowned_inlined
def _move_origin(origin: FloatArray, which: int, elapsed: float, here: FloatArray) -> None:
    """A functional's origin after a time."""
    value, slope, curvature = origin[which, 0], origin[which, 1], origin[which, 2]
    here[0], here[1], here[2] = (
        value + elapsed * (slope + 0.5 * elapsed * curvature),
        slope + elapsed * curvature,
        curvature,
    )


@unowned_inlined
def _look(
    watch: FloatArray, y: FloatArray, amplitude: FloatArray, level: int
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """A functional less its origin, and without its fastest pairs.

    Returns
    -------
    value, slope, curvature, jerk : float
        Without the first `level` pairs; the last is the bound of its third derivative.
    ringing : float
        The sway of those pairs.
    value, slope, curvature, jerk, sway : float
        Of the next pair alone.
    sway : float
        Of all of it.
    """
    size, at = y.size, _place(level)
    seen, bound, ringing = modal.look(watch, y, at), modal.bounds(watch, amplitude, at), 0.0
    for k in range(level):
        ringing += watch[size + _place(k), SWAY] * amplitude[_place(k)]
    fast = lanes.times(lanes.load(watch, at), lanes.splat(lanes.number(y, at)))
    fast = lanes.plus_times(fast, lanes.load(watch, at + BLOCK), lanes.number(y, at + BLOCK))
    fast_bound = lanes.times(lanes.load(watch, size + at), lanes.splat(lanes.number(amplitude, at)))
    return (
        lanes.lane(seen, VALUE),
        lanes.lane(seen, SLOPE),
        lanes.lane(seen, CURVATURE),
        lanes.lane(bound, JERK),
        ringing,
        lanes.lane(fast, VALUE),
        lanes.lane(fast, SLOPE),
        lanes.lane(fast, CURVATURE),
        lanes.lane(fast_bound, JERK),
        lanes.lane(fast_bound, SWAY),
        ringing + lanes.lane(bound, SWAY),
    )


@unowned_inlined
def _place(pair: int) -> int:
    """Where the first of a pair's coordinates lies."""
    return pair + pair // BLOCK * BLOCK


@unowned_inlined
def _ringing(watch: FloatArray, y: FloatArray, level: int) -> tuple[float, float]:
    """What the fastest pairs of a functional add to it at most from now on, and to its slope."""
    sway, rush = 0.0, 0.0
    for k in range(level):
        p = _place(k)
        q = p + BLOCK
        amplitude = np.sqrt(y[p] * y[p] + y[q] * y[q])
        sway += watch[y.size + p, SWAY] * amplitude
        rush += np.sqrt(watch[p, SLOPE] * watch[p, SLOPE] + watch[q, SLOPE] * watch[q, SLOPE]) * amplitude
    return sway, rush


@unowned_inlined
def _longest(
    span: FloatArray,
    g1: float,
    d1: float,
    e1: float,
    j1: float,
    g2: float,
    d2: float,
    e2: float,
    j2: float,
    rest: float,
    k: int,
) -> int:
    """The longest span that keeps two guards positive by `_low`, and is not beyond `rest`; -1 for none.

    k : where to look first
    """
    base = min(max(k - WIDTH // 2 + 1, 0), SPANS - WIDTH)
    passing = _passing(span, base, g1, d1, e1, j1, g2, d2, e2, j2, rest)
    while passing == 0 and base > 0:
        base = max(base - WIDTH, 0)
        passing = _passing(span, base, g1, d1, e1, j1, g2, d2, e2, j2, rest)
    while passing == WIDTH and base < SPANS - WIDTH:
        base = min(base + WIDTH, SPANS - WIDTH)
        passing = _passing(span, base, g1, d1, e1, j1, g2, d2, e2, j2, rest)
    return base + passing - 1


@unowned_inlined
def _passing(
    span: FloatArray,
    base: int,
    g1: float,
    d1: float,
    e1: float,
    j1: float,
    g2: float,
    d2: float,
    e2: float,
    j2: float,
    rest: float,
) -> int:
    """How many of the eight spans from `base` on `_longest` may take."""
    h = lanes.load_from(span, base)
    first = lanes.plus_times(lanes.splat(0.5 * min(e1, 0.0)), h, -(j1 * _SIXTH))
    second = lanes.plus_times(lanes.splat(0.5 * min(e2, 0.0)), h, -(j2 * _SIXTH))
    first = lanes.plus(lanes.splat(d1), lanes.times(h, first))
    second = lanes.plus(lanes.splat(d2), lanes.times(h, second))
    first = lanes.plus(lanes.splat(g1), lanes.times(h, first))
    second = lanes.plus(lanes.splat(g2), lanes.times(h, second))
    return int(lanes.both_positive(first, second, h, rest))


@unowned_inlined
def _low(value: float, slope: float, curvature: float, jerk: float, h: float) -> float:
    """What a guard does not go below within a time h, where that is positive: it is concave in h."""
    return value + h * (slope + h * (0.5 * min(curvature, 0.0) - h * (jerk * _SIXTH)))


@unowned_inlined
def _clean_crossing(c: FloatArray, length: float) -> tuple[float, float, float]:
    """The zero of a series that does nothing but fall, its slope and half its curvature there; else -1 for the first.

    length : at most 1
    """
    even, odd = 0.0, 0.0
    for k in range(2, TERMS, 2):
        even += k * abs(c[k])
        odd += (k + 1) * abs(c[k + 1])
    steep = c[1] * c[1] - c[0] * c[2]
    if not (c[0] > 0.0 and -c[1] > even + odd and steep > 0.0):
        return -1.0, 0.0, 0.0
    s = -c[0] * c[1] / steep
    for _ in range(3):
        if not s <= length:
            break
        value, slope, half = polynomial.derivatives(c, TERMS, s)
        s -= value * slope / (slope * slope - value * half)
        if abs(value) <= 1e-4 * abs(slope) and 0.0 <= s <= length:  # the error is the cube of this step's
            return s, slope, half
    return -1.0, 0.0, 0.0


@unowned_inlined
def _dip(begins: float, ends: float, fell: float, rises: float, h: float) -> float:
    """The least value in (0, h) of the cubic with these values and slopes at its ends, falling and then rising."""
    secant = (ends - begins) / h
    cube, square = fell + rises - 2.0 * secant, 3.0 * secant - 2.0 * fell - rises  # over s = t/h in (0, 1), times h
    root = np.sqrt(max(square * square - 3.0 * cube * fell, 0.0))
    s = -fell / (square + root) if square + root > 0.0 else 1.0
    s = min(max(s, 0.0), 1.0)
    return min(begins, ends, begins + h * s * (fell + s * (square + s * cube)))


@unowned_inlined
def _phase(
    span: FloatArray,
    propagator: FloatArray,
    power: FloatArray,
    generator: FloatArray,
    watch: FloatArray,
    series: FloatArray,
    modes: bool,
    ringing: int,
    steady: bool,
    guards: int,
    watched: int,
    at: IntArray,
    sign: FloatArray,
    shift: FloatArray,
    scale: FloatArray,
    origin: FloatArray,
    y: FloatArray,
    before: FloatArray,
    amplitude: FloatArray,
    work: modal.Work,
    here: FloatArray,
    zero_guard: int,
    zero_order: int,
    limit: float,
    held_from: float,
    high: float,
    low: float,
    margin: float,
    stop: npt.NDArray[np.uint8],
) -> tuple[int, float, float, float, float, float, float, bool]:
    """Follow a flow until one of its guards turns negative.

    The fastest pairs of modes, `level` of them, are taken out of the guards and bounded by their sway instead, as soon
    as that lets a longer span pass: what rings less than a guard is away from zero need not be resolved.

    Returns
    -------
    ended : int
        The guard, or one of _AT_END, _SETTLED, _STOPPED, _LOST.
    elapsed : float  [s]
    largest, smallest : float  [rad/s2]
        What was seen of the acceleration: all of it that counts in its window.
    high, low : float  [rad/s2]
        The window's extremes.
    margin : float
    grazed : bool
    """
    first, second, accelerating = watch[at[0]], watch[at[1]], watch[ACCELERATION]
    two = at[0] != at[1]
    sign1, sign2 = sign[0], sign[1]
    long_c, c, found = work[3], work[3][:TERMS], work[4]
    highest, deepest = span.size - 1 if modes else 0, min(ringing, amplitude.size // 2 - 1)
    order1, order2 = zero_order if zero_guard == 0 else 0, zero_order if zero_guard == 1 else 0
    elapsed, h, k, level, grazed, event, ends = 0.0, 0.0, 0, 0, False, -1, False
    entered = zero_guard if zero_order > 1 else -1  # it is level, and rounding would have it turn
    s1, s2, was1, was2 = 0.0, 0.0, 0.0, 0.0
    bow1, bow2, rang1, rang2, bent1, bent2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a, slope, curvature = modal.observe(accelerating, y)
    a += origin[2, 0]
    largest, smallest = a, a
    high, low = max(high, a), min(low, a)
    while True:
        v1, d1, e1, j1, ring1, n1, m1, l1, q1, r1, sway1 = _look(first, y, amplitude, level)
        o1 = origin[0, 0] + elapsed * (origin[0, 1] + 0.5 * elapsed * origin[0, 2])
        p1 = origin[0, 1] + elapsed * origin[0, 2]
        g1 = sign1 * (v1 + o1) + shift[0] - ring1
        d1, e1 = sign1 * (d1 + p1), sign1 * (e1 + origin[0, 2])
        n1, m1, l1 = sign1 * n1, sign1 * m1, sign1 * l1
        if two:
            v2, d2, e2, j2, ring2, n2, m2, l2, q2, r2, sway2 = _look(second, y, amplitude, level)
            o2 = origin[1, 0] + elapsed * (origin[1, 1] + 0.5 * elapsed * origin[1, 2])
            p2 = origin[1, 1] + elapsed * origin[1, 2]
            g2 = sign2 * (v2 + o2) + shift[1] - ring2
            d2, e2 = sign2 * (d2 + p2), sign2 * (e2 + origin[1, 2])
            n2, m2, l2 = sign2 * n2, sign2 * m2, sign2 * l2
        else:  # the same, or its mirror image
            mirror = sign1 * sign2
            j2, ring2, q2, r2, sway2 = j1, ring1, q1, r1, sway1
            g2 = sign2 * (v1 + o1) + shift[1] - ring1
            d2, e2, n2, m2, l2 = mirror * d1, mirror * e1, mirror * n1, mirror * m1, mirror * l1

        # what turned back on the way here is a near miss
        if h > 0.0 and elapsed > held_from:
            for g in range(watched):
                if g == event or (g == entered and held_from <= 0.0) or scale[g] <= 0.0:
                    continue
                begins, fell, ends_at, rises = (was1, s1, g1 + ring1, d1) if g == 0 else (was2, s2, g2 + ring2, d2)
                bow, ring, bent = (bow1, rang1, bent1 + e1) if g == 0 else (bow2, rang2, bent2 + e2)
                # whether it falls all the way, rises, or is bent down
                if level == 0 and (max(fell, rises) < -bow or min(fell, rises) > bow or bent * h < -8.0 * bow):
                    continue
                bar = abs(margin) * scale[g] + ring + 0.5 * h * bow
                if min(begins, ends_at) - h * _MOST_DIP * (max(rises, 0.0) - min(fell, 0.0)) >= bar:
                    continue
                least = _dip(begins, ends_at, fell, rises, h) - 0.5 * h * bow
                if least - ring < abs(margin) * scale[g]:
                    began = max(elapsed - h, held_from)
                    if began > elapsed - h:
                        modal.move_by(span, propagator, power, generator, modes, work, before, began - (elapsed - h))
                    ring, rush = _ringing(watch[at[g]], before, level)  # it may have died down meanwhile
                    bow += rush
                    if least - ring >= abs(margin) * scale[g] or max(fell, rises) < -bow or min(fell, rises) > bow:
                        continue
                    _move_origin(origin, g, began, here)
                    nearest = modal.lowest_turn(
                        span, propagator, power, generator, watch[at[g]], series[at[g]], modes, work, sign[g], shift[g],
                        before, here, elapsed - began, k, abs(margin) * scale[g]
                    ) / scale[g]  # fmt: skip
                    if nearest < abs(margin):
                        margin = max(nearest, 0.0)
                        grazed = grazed or nearest <= GRAZING
            entered = -1
        if event >= 0:
            return event, elapsed, largest, smallest, high, low, margin, grazed
        if ends:
            return _AT_END, elapsed, largest, smallest, high, low, margin, grazed
        if stop[0] != 0:
            return _STOPPED, elapsed, largest, smallest, high, low, margin, grazed

        bound = modal.bounds(accelerating, amplitude, 0)
        swing = lanes.lane(bound, SWAY)
        beaten = origin[2, 0] + swing > high or origin[2, 0] - swing < low
        if steady and not beaten:
            calm1, calm2 = sign1 * origin[0, 0] + shift[0] - sway1, sign2 * origin[1, 0] + shift[1] - sway2
            if calm1 > 0.0 and calm2 > 0.0 and calm1 >= abs(margin) * scale[0] and calm2 >= abs(margin) * scale[1]:
                return _SETTLED, elapsed, largest, smallest, high, low, margin, grazed

        # the longest span in which no guard can turn negative
        rest = limit - elapsed
        if order1 == 1:
            g1 = 0.0
        if order2 == 1:
            g2 = 0.0
        if order1 > 1 or order2 > 1:
            k = -1
        else:
            k = min(_longest(span, g1, d1, e1, j1, g2, d2, e2, j2, rest, k), highest)
            if k < 0 and level > 0:
                level, h = 0, 0.0
                continue
            if level < deepest and g1 - n1 > r1 and g2 - n2 > r2:
                longer = _longest(
                    span, g1 - n1 - r1, d1 - m1, e1 - l1, j1 - q1, g2 - n2 - r2, d2 - m2, e2 - l2, j2 - q2, rest, k + 2
                )  # fmt: skip
                longer = min(longer, highest)
                if longer > k:
                    k, level = longer, level + 1
                    g1, d1, e1, j1 = g1 - n1 - r1, d1 - m1, e1 - l1, j1 - q1
                    g2, d2, e2, j2 = g2 - n2 - r2, d2 - m2, e2 - l2, j2 - q2
                    ring1, ring2 = ring1 + r1, ring2 + r2
        h, part = span[max(k, 0)], 1.0
        if k < 0:
            part, ends = min(1.0, rest / h), rest <= h
            for g in range(guards):
                order = order1 if g == 0 else order2
                if order < 2 and (_low(g1, d1, e1, j1, h) if g == 0 else _low(g2, d2, e2, j2, h)) > 0.0:
                    continue
                _move_origin(origin, g, elapsed, here)
                modal.expand(series[at[g]], y, h, here[0], here[1], here[2], long_c)
                for j in range(TERMS):
                    c[j] *= sign[g]
                c[0] += shift[g]
                if not np.isfinite(c[0]):
                    return _LOST, elapsed, largest, smallest, high, low, margin, grazed
                noise = ROUNDING * (abs(here[0]) + abs(shift[g]) + (sway1 if g == 0 else sway2))
                if order == 0 and -max(noise, GRAZING * scale[g]) <= c[0] <= noise:
                    order = 1
                for _ in range(order):  # zeros at the beginning are divided out
                    for j in range(TERMS - 1):
                        c[j] = c[j + 1]
                    c[TERMS - 1] = 0.0
                s, fall, half = _clean_crossing(long_c, part)
                if s < 0.0:
                    s = polynomial.first_negative_of(c, part, found, work[5])
                    _, fall, half = polynomial.derivatives(c, TERMS, max(s, 0.0))
                if s >= 0.0:
                    bend = 2.0 * half
                    if order > 0:
                        fall, bend = c[0], 2.0 * c[1]  # only where it falls at once can it turn back within rounding
                    tangent = s > 0.0 or order > 0 or c[0] >= -max(noise, GRAZING * scale[g])
                    if tangent and bend > 0.0 and order < 2 and fall * fall <= 2.0 * bend * GRAZING * scale[g]:
                        grazed = True
                    elif event < 0 or s < part:
                        event, part = g, s
        order1, order2 = 0, 0
        # between the slope of a guard's slower part and the line through its ends lies at most its bow, h²/8 of the
        # jerk; between that part and the Hermite cubic of its ends h³/16 of it, since they part with a third derivative
        # of twice the jerk and meet, with their slopes, at both ends
        s1, s2, was1, was2, bent1, bent2 = d1, d2, g1 + ring1, g2 + ring2, e1, e2
        bow1, bow2, rang1, rang2 = h * h * j1 * 0.125, h * h * j2 * 0.125, ring1, ring2

        # go there, and see what the acceleration did on the way
        modal.copy(y, before)
        h *= part
        bend, monotone = 0.0, True
        if beaten:
            jerk = lanes.lane(bound, JERK)
            bend = 0.125 * h * h * (abs(curvature) + h * jerk)
            monotone = abs(slope) > h * ((-curvature if slope > 0.0 else curvature) + 0.5 * h * jerk)
        if k >= 0 and modes:
            modal.jump(propagator, k, y, amplitude)
        else:
            modal.move(power, generator, modes, part, y, work)
            if event < 0 or level > 0:
                modal.measure(y, amplitude)
        last, slope, curvature = modal.observe(accelerating, y)
        last += origin[2, 0]
        largest, smallest = max(largest, last), min(smallest, last)
        high, low = max(high, last), min(low, last)
        if beaten and not monotone and (max(a, last) + bend > high or min(a, last) - bend < low):
            here[0], here[1], here[2] = origin[2, 0], 0.0, 0.0
            high, low = modal.extremes(
                span,
                propagator,
                power,
                generator,
                accelerating,
                series[ACCELERATION],
                modes,
                work,
                before,
                here,
                h,
                k,
                high,
                low,
            )
            largest, smallest = max(largest, high), min(smallest, low)
        a = last
        elapsed += h
