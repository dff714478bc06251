"""A step of runs side by side: a span in which no guard can turn negative, or a part of the shortest one to an event.

The fastest pairs of modes, LEVEL of them, are taken out of the guards and bounded by their sway instead, as soon as
that lets a longer span pass: what rings less than a guard is away from zero need not be resolved.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import abreast, lanes, polynomial, queues, rows
from clunk.core.flows import TERMS, Flows
from clunk.core.jit import unowned_inlined
from clunk.core.lanes import ROW, WIDTH, Lanes
from clunk.core.pool import (
    AT_END,
    GOES_ON,
    LOST,
    SETTLED,
    Pool,
    ask,
    fields,
    find_origin,
    gather_spans,
    push_all,
    put_back,
    row_of,
)
from clunk.core.regimes import ACCELERATION
from clunk.core.status import QUALITY_GRAZING
from clunk.core.switching import ROUNDING

FloatArray = npt.NDArray[np.float64]

GRAZING = 1e-12  # a guard that turns back within this share of its scale has not turned negative
_MOST_DIP = 4.0 / 27.0 * (1.0 + 1e-15)  # of a Hermite cubic below both its ends, in (0, 1), for a slope of 1


@unowned_inlined
def stride(pool: Pool, flows: Flows, queue: int, count: int) -> None:
    """Take a step with the `count` runs that have been taken from a queue, SPAN or PART of their kind."""
    short = queue >= queues.PART
    kind = queue - queues.PART if short else queue - queues.SPAN
    own = pool.kinds[kind]
    flow, guards, watched, two = own.flow, own.guards, own.watched, own.two != 0
    guard1, guard2 = pool.guards[kind, 0], pool.guards[kind, 1]
    f1, f2 = guard1.functional, guard2.functional
    size, work, notes = flows.basis.shape[1], pool.work, pool.notes
    field, present, none = fields(size), (1 << count) - 1, lanes.splat(0.0)
    output, steady, modes = flows.origin_output[flow], flows.steady[flow] != 0, flows.modal[flow] != 0
    watch, series, shortest = flows.watch[flow], flows.series[flow], flows.span[flow, 0]
    first, second, accelerating = watch[f1], watch[f2], watch[ACCELERATION]
    deepest = min(flows.ringing[flow], size // 2 - 1)

    elapsed, level, zero = (
        row_of(pool, field + rows.ELAPSED),
        row_of(pool, field + rows.LEVEL),
        row_of(pool, field + rows.ZERO),
    )
    high, low, margin = (
        row_of(pool, field + rows.HIGH),
        row_of(pool, field + rows.LOW),
        row_of(pool, field + rows.MARGIN),
    )
    torque, half_gap, side = (
        row_of(pool, field + rows.TORQUE),
        row_of(pool, field + rows.HALF_GAP),
        row_of(pool, field + rows.SIDE),
    )
    static, held_from = row_of(pool, field + rows.STATIC), row_of(pool, field + rows.HELD_FROM)
    rest, gap_input = row_of(pool, field + rows.LIMIT) - elapsed, side * half_gap
    sign1 = side * guard1.sign if guard1.sided != 0 else lanes.splat(guard1.sign)
    sign2 = side * guard2.sign if guard2.sided != 0 else lanes.splat(guard2.sign)
    shift1, shift2 = half_gap * guard1.offset, half_gap * guard2.offset
    scale1 = half_gap * guard1.of_gap + static * guard1.of_rest
    scale2 = half_gap * guard2.of_gap + static * guard2.of_rest
    bar1, bar2 = lanes.magnitude(margin) * scale1, lanes.magnitude(margin) * scale2

    # the guards: n, m, l, q, r are value, slope, curvature, jerk and sway of the fastest pair that is still in them
    v1, d1, e1, j1, ring1, n1, m1, l1, q1, r1, sway1 = abreast.look(first, work, size, level, deepest)
    o1, p1, c1 = abreast.origin(output, f1, steady, torque, gap_input, elapsed)
    if two:
        v2, d2, e2, j2, ring2, n2, m2, l2, q2, r2, sway2 = abreast.look(second, work, size, level, deepest)
        o2, p2, c2 = abreast.origin(output, f2, steady, torque, gap_input, elapsed)
    else:  # the same, or its mirror image
        v2, d2, e2, j2, ring2, n2, m2, l2, q2, r2, sway2 = v1, d1, e1, j1, ring1, n1, m1, l1, q1, r1, sway1
        o2, p2, c2 = o1, p1, c1
    g1, d1, e1 = sign1 * (v1 + o1) + shift1 - ring1, sign1 * (d1 + p1), sign1 * (e1 + c1)
    g2, d2, e2 = sign2 * (v2 + o2) + shift2 - ring2, sign2 * (d2 + p2), sign2 * (e2 + c2)

    # what can follow
    acceleration, _, _ = abreast.origin(output, ACCELERATION, True, torque, gap_input, none)
    jerk, swing = abreast.bounds(accelerating, work, size)
    beaten = (acceleration + swing > high) | (acceleration - swing < low)
    settled = 0
    if steady:
        calm1, calm2 = sign1 * o1 + shift1 - sway1, sign2 * o2 + shift2 - sway2
        settled = (calm1 > 0.0) & (calm2 > 0.0) & (calm1 >= bar1) & (calm2 >= bar2) & ~beaten & present
    there = present & ~settled

    # the longest span in which no guard can turn negative, or the part of the shortest up to an event
    g1, g2 = lanes.choose(zero == 1.0, 0.0, g1), lanes.choose(zero == -1.0, 0.0, g2)
    event, ends, lost, grazing, dig = none - 1.0, 0, 0, 0, 0
    if short:
        k, whole, part = none - 1.0, none + shortest, lanes.smaller(rest / shortest, none + 1.0)
        ends = (rest <= shortest) & there
        for g in range(guards):
            order = lanes.larger(zero if g == 0 else -zero, none)
            bound = abreast.low(g1, d1, e1, j1, whole) if g == 0 else abreast.low(g2, d2, e2, j2, whole)
            near = (~(bound > 0.0) | (order >= 2.0)) & there
            if near == 0:
                continue
            if g == 0:
                abreast.expand(series[f1], work, size, shortest, sign1, shift1, o1, p1, c1, pool.series)
            else:
                abreast.expand(series[f2], work, size, shortest, sign2, shift2, o2, p2, c2, pool.series)
            value, sway, shift, scale = (o1, sway1, shift1, scale1) if g == 0 else (o2, sway2, shift2, scale2)
            noise = ROUNDING * (lanes.magnitude(value) + lanes.magnitude(shift) + sway)
            found, bad, grazed, s = _crossing(pool, near, order, noise, scale, part)
            lost |= bad
            grazing |= grazed
            found &= (event < 0.0) | (s < part)
            event, part = lanes.choose(found, float(g), event), lanes.choose(found, s, part)
        h = whole * part
    else:
        h, k = abreast.longest(shortest, g1, d1, e1, j1, g2, d2, e2, j2, rest)
        level_guard = lanes.magnitude(zero) > 1.0  # it is zero with its slope: its series decides
        k = lanes.choose(level_guard, -1.0, k)
        slower1, slower2 = g1 - sign1 * n1, g2 - sign2 * n2
        deeper = (level < float(deepest)) & (slower1 > r1) & (slower2 > r2) & ~level_guard
        deeper &= (k >= 0.0) | (level == 0.0)
        if deeper != 0:
            slower1, slower2, slow_jerk1, slow_jerk2 = slower1 - r1, slower2 - r2, j1 - q1, j2 - q2
            slope1, bent1, slope2, bent2 = d1 - sign1 * m1, e1 - sign1 * l1, d2 - sign2 * m2, e2 - sign2 * l2
            longer, number = abreast.longest(
                shortest, slower1, slope1, bent1, slow_jerk1, slower2, slope2, bent2, slow_jerk2, rest
            )
            deeper &= number > k
            k, h = lanes.choose(deeper, number, k), lanes.choose(deeper, longer, h)
            level = lanes.choose(deeper, level + 1.0, level)
            g1, d1 = lanes.choose(deeper, slower1, g1), lanes.choose(deeper, slope1, d1)
            g2, d2 = lanes.choose(deeper, slower2, g2), lanes.choose(deeper, slope2, d2)
            e1, j1 = lanes.choose(deeper, bent1, e1), lanes.choose(deeper, slow_jerk1, j1)
            e2, j2 = lanes.choose(deeper, bent2, e2), lanes.choose(deeper, slow_jerk2, j2)
            ring1, ring2 = lanes.choose(deeper, ring1 + r1, ring1), lanes.choose(deeper, ring2 + r2, ring2)
        dig, part, whole = (k < 0.0) & there, none, h
    moving = there & ~dig & ~lost
    # between the slope of a guard's slower part and the line through its ends lies at most its bow, h²/8 of the
    # jerk; between that part and the Hermite cubic of its ends h³/16 of it, since they part with a third derivative
    # of twice the jerk and meet, with their slopes, at both ends
    bow1, bow2 = whole * whole * j1 * 0.125, whole * whole * j2 * 0.125
    rush1 = rush2 = abreast.rush(first, work, size, level, deepest)
    if watched == 2 and two:
        rush2 = abreast.rush(second, work, size, level, deepest)

    # go there
    lanes.store(notes, 0, k)
    if short:
        abreast.move(flows.power[flow], flows.generator[flow], modes, part, work, size, pool.moved)
        abreast.measure(work, size)
    else:
        gather_spans(pool, flows.propagator[flow], size)
        abreast.jump(pool.moved, work, size)
    elapsed += h
    lanes.store(work, field + rows.ELAPSED, elapsed)
    lanes.store(work, field + rows.ZERO, none)
    turns = _accelerate(pool, accelerating, acceleration, jerk, h, beaten & moving, size)

    # how the guards got on
    v1, u1, b1 = abreast.glance(first, work, size, level, deepest)
    o1, p1, c1 = abreast.origin(output, f1, steady, torque, gap_input, elapsed)
    v2, u2, b2, o2, p2, c2 = v1, u1, b1, o1, p1, c1
    if two:
        v2, u2, b2 = abreast.glance(second, work, size, level, deepest)
        o2, p2, c2 = abreast.origin(output, f2, steady, torque, gap_input, elapsed)
    counts, misses, close = moving & (elapsed > held_from), 0, 0
    for g in range(watched):
        begins, fell, bent, jerk, ring = (g1, d1, e1, j1, ring1) if g == 0 else (g2, d2, e2, j2, ring2)
        sign, shift, scale, bar = (sign1, shift1, scale1, bar1) if g == 0 else (sign2, shift2, scale2, bar2)
        bow, rush = (bow1, rush1) if g == 0 else (bow2, rush2)
        if g == 0:
            ends_at, rises, bends = sign * (v1 + o1) + shift, sign * (u1 + p1), sign * (b1 + c1)
        else:
            ends_at, rises, bends = sign * (v2 + o2) + shift, sign * (u2 + p2), sign * (b2 + c2)
        if g < guards:  # not even the shortest span will pass
            close |= abreast.low(ends_at - ring, rises, bends, jerk, none + shortest) <= 0.0
        # what turned back on the way is a near miss; but a guard that was level, rounding would have turn
        fresh = (zero > 1.0 if g == 0 else zero < -1.0) & (held_from <= 0.0)
        may = counts & (scale > 0.0) & ~(event == float(g)) & ~fresh
        # whether it falls all the way, rises, or is bent down
        loose = bow + rush
        may &= ~((lanes.larger(fell, rises) < -loose) | (lanes.smaller(fell, rises) > loose))
        may &= ~(((bent + bends) * h < -8.0 * bow) & (level == 0.0))
        drop = h * _MOST_DIP * (lanes.larger(rises, none) - lanes.smaller(fell, none))
        may &= lanes.smaller(begins + ring, ends_at) - drop < bar + ring + 0.5 * h * bow
        if may != 0:
            noted = (h, begins + ring, fell, ends_at, rises, bow, ring, sign, shift, scale, elapsed)
            misses |= _misses(pool, flows, flow, f1 if g == 0 else f2, g, may, noted) << (g * WIDTH)
    lanes.store(work, field + rows.LEVEL, lanes.choose(close, 0.0, level))

    # who moved is put back; who met an event, with its state
    happened = (event >= 0.0) & moving
    if happened != 0:
        _leave(pool, flows, flow, torque, gap_input, elapsed, happened)
        lanes.store(notes, 0, event)
    put_back(pool, pool.numbers, field + rows.CHANGING, moving)
    bits = dig
    while bits != 0:
        lane = lanes.first_of(bits)
        bits &= bits - 1
        pool.numbers[pool.who[lane], field + rows.LEVEL] = 0.0
    special = (settled | lost | ends | grazing | happened | turns | misses | misses >> WIDTH) & present
    if modes:
        push_all(pool, queues.PART + kind, (dig | close & moving) & ~special)
        push_all(pool, queues.SPAN + kind, moving & ~close & ~special)
    else:
        push_all(pool, queues.PART + kind, moving & ~special)
    push_all(pool, queues.FOLLOW, special)
    while special != 0:
        lane = lanes.first_of(special)
        special &= special - 1
        run, bit = pool.runs[pool.who[lane]], 1 << lane
        run.pending = (turns >> lane & 1) | (misses >> lane & 1) << 1 | (misses >> (lane + WIDTH) & 1) << 2
        run.measured = 0
        if grazing & bit:
            run.quality |= QUALITY_GRAZING
        if settled & bit:
            run.ended = SETTLED
        elif lost & bit:
            run.ended = LOST
        elif happened & bit:
            run.ended = int(lanes.number(notes, lane))
        else:
            run.ended = AT_END if ends & bit else GOES_ON


@unowned_inlined
def _crossing(
    pool: Pool, near: int, order: Lanes, noise: Lanes, scale: Lanes, part: Lanes
) -> tuple[int, int, int, Lanes]:
    """Where the guards whose series are `pool.series` turn negative first, within a part of the shortest span.

    near : the lanes that are concerned
    order : how many of a guard's derivatives are zero at the beginning, itself included
    noise, scale : its rounding, and what its grazing is relative to

    Returns
    -------
    found, lost, grazed : int
        The lanes where it does, where nothing is finite, and where it does not turn negative, but turns back within
        GRAZING.
    s : Lanes
        In shares of the shortest span.
    """
    c = pool.series
    start = lanes.load(c, 0)
    lost = near & ~(start - start == 0.0)
    near &= ~lost
    within = lanes.larger(noise, GRAZING * scale)
    order = lanes.choose((order == 0.0) & (start <= noise) & (start >= -within), 1.0, order)
    for n in range(3):  # zeros at the beginning are divided out
        shifted = order > float(n)
        if shifted == 0:
            break
        for j in range(TERMS - 1):
            lanes.store(c, j, lanes.choose(shifted, lanes.load(c, j + 1), lanes.load(c, j)))
        lanes.store(c, TERMS - 1, lanes.choose(shifted, 0.0, lanes.load(c, TERMS - 1)))
    found, positive, s, fall, half = abreast.crossing(c, part)
    unclear = near & ~found & ~positive
    if unclear != 0:
        lanes.store(pool.notes, 0, s)
        lanes.store(pool.notes, 1, fall)
        lanes.store(pool.notes, 2, half)
        lanes.store(pool.notes, 3, part)
        found |= _cross_alone(pool, unclear)
        s, fall, half = lanes.load(pool.notes, 0), lanes.load(pool.notes, 1), lanes.load(pool.notes, 2)
    # only where it falls at once can it turn back within rounding
    start = lanes.load(c, 0)
    fall = lanes.choose(order > 0.0, start, fall)
    bend = lanes.choose(order > 0.0, 2.0 * lanes.load(c, 1), 2.0 * half)
    tangent = (s > 0.0) | (order > 0.0) | (start >= -within)
    tangent &= (bend > 0.0) & (order < 2.0) & (fall * fall <= 2.0 * bend * GRAZING * scale)
    found &= near
    return found & ~tangent, lost, found & tangent, s


@unowned_inlined
def _cross_alone(pool: Pool, bits: int) -> int:
    """Zero, slope and half the curvature of some lanes' series, one by one, into the first notes; whose has a zero."""
    notes, c, found = pool.notes, pool.single[0], 0
    while bits != 0:
        lane = lanes.first_of(bits)
        bits &= bits - 1
        for j in range(TERMS):
            c[j] = lanes.number(pool.series, j * WIDTH + lane)
        zero = polynomial.first_negative_of(c, notes[3, lane], pool.single[1], pool.ladder)
        if zero >= 0.0:
            found |= 1 << lane
            notes[0, lane] = zero
            _, notes[1, lane], notes[2, lane] = polynomial.derivatives(c, TERMS, zero)
    return found


@unowned_inlined
def _accelerate(pool: Pool, watch: FloatArray, origin: Lanes, jerk: Lanes, h: Lanes, beaten: int, size: int) -> int:
    """See what the acceleration did within a time h; in which lanes it may have had an extreme that counts.

    beaten : the lanes where it can exceed what its window holds
    """
    work, notes, field = pool.work, pool.notes, fields(size)
    before, slope, curvature = (
        row_of(pool, field + rows.SEEN),
        row_of(pool, field + rows.SEEN_SLOPE),
        row_of(pool, field + rows.SEEN_CURVATURE),
    )
    bend = 0.125 * h * h * (lanes.magnitude(curvature) + h * jerk)
    away = lanes.choose(slope > 0.0, -curvature, curvature)
    monotone = lanes.magnitude(slope) > h * (away + 0.5 * h * jerk)
    last, slope, curvature = abreast.glance(watch, work, size, lanes.splat(0.0), 0)
    last += origin
    high, low = lanes.larger(row_of(pool, field + rows.HIGH), last), lanes.smaller(row_of(pool, field + rows.LOW), last)
    turns = (lanes.larger(before, last) + bend > high) | (lanes.smaller(before, last) - bend < low)
    turns &= beaten & ~monotone
    lanes.store(work, field + rows.HIGH, high)
    lanes.store(work, field + rows.LOW, low)
    lanes.store(work, field + rows.LARGEST, lanes.larger(row_of(pool, field + rows.LARGEST), last))
    lanes.store(work, field + rows.SMALLEST, lanes.smaller(row_of(pool, field + rows.SMALLEST), last))
    lanes.store(work, field + rows.SEEN, last)
    lanes.store(work, field + rows.SEEN_SLOPE, slope)
    lanes.store(work, field + rows.SEEN_CURVATURE, curvature)
    if turns != 0:
        lanes.store(notes, 1, h)
        lanes.store(notes, 2, origin)
        bits = turns
        while bits != 0:
            lane = lanes.first_of(bits)
            bits &= bits - 1
            pool.here[0], pool.here[1], pool.here[2] = notes[2, lane], 0.0, 0.0
            ask(pool, pool.who[lane], rows.EXTREMES_TASK, size, notes[1, lane], 1.0, 0.0)
    return int(turns)


@unowned_inlined
def _misses(
    pool: Pool,
    flows: Flows,
    flow: int,
    f: int,
    g: int,
    bits: int,
    noted: tuple[Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes, Lanes],
) -> int:
    """In which of some lanes the lowest turn of a guard within the step is to be looked for."""
    notes, numbers, size, found = pool.notes, pool.numbers, flows.basis.shape[1], 0
    field = fields(size)
    for k, noted_row in enumerate(noted):
        lanes.store(notes, k + 1, noted_row)
    while bits != 0:
        lane = lanes.first_of(bits)
        bits &= bits - 1
        h, bow, slot = notes[1, lane], notes[6, lane], pool.who[lane]
        least = _dip(notes[2, lane], notes[4, lane], notes[3, lane], notes[5, lane], h) - 0.5 * h * bow - notes[7, lane]
        if least >= abs(numbers[slot, field + rows.MARGIN]) * notes[10, lane]:
            continue
        torque, gap_input = (
            numbers[slot, field + rows.TORQUE],
            numbers[slot, field + rows.SIDE] * numbers[slot, field + rows.HALF_GAP],
        )
        find_origin(pool, flows, flow, f, torque, gap_input, numbers[slot, field + rows.ELAPSED])
        ask(pool, slot, rows.TURN_TASK + g, size, h, notes[8, lane], notes[9, lane])
        pool.asked[slot * rows.TASKS + rows.TURN_TASK + g, field + rows.COUNTS] = (
            notes[11, lane] - numbers[slot, field + rows.HELD_FROM]
        )
        found |= 1 << lane
    return found


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
def _leave(pool: Pool, flows: Flows, flow: int, torque: Lanes, gap_input: Lanes, elapsed: Lanes, bits: int) -> None:
    """The states of some lanes, into `pool.state`."""
    origins, basis, left, size = flows.origin[flow], flows.basis[flow], pool.left, flows.basis.shape[1]
    half = 0.5 * elapsed * elapsed
    for n in range(flows.coordinates.shape[1]):
        origin = torque * lanes.number(origins, n) + gap_input * lanes.number(origins, size + n)
        if flows.steady[flow] == 0:
            slope = torque * lanes.number(origins, 2 * size + n) + gap_input * lanes.number(origins, 3 * size + n)
            bend = torque * lanes.number(origins, 4 * size + n) + gap_input * lanes.number(origins, 5 * size + n)
            origin += slope * elapsed
            origin += bend * half
        away = lanes.splat(0.0)
        for j in range(size):
            away += lanes.load(pool.work, j) * lanes.number(basis, j * size + n)
        lanes.store(left, n, origin + away)
    nobody = pool.state.shape[0] - 1
    for lane in range(WIDTH):
        pool.others[lane] = (pool.who[lane] if (bits >> lane) & 1 else nobody) * size
    for row in range(0, size, ROW):
        lanes.scatter(left, row, pool.state, pool.others, row)
