"""A step of runs side by side: a span in which no guard turns negative, or a part of the shortest one to an event.

A span is first tried: a run whose guards are not proved positive all through it stays where it was, and tries a
shorter one next.

The fastest pairs of modes, LEVEL of them, are taken out of the guards and bounded by their sway instead, as soon as
that lets a longer span pass: what rings less than a guard is away from where it counts need not be resolved.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.exact import curves, polynomial, rows
from clunk.core.exact.flows import TERMS, Flows
from clunk.core.jit import unowned_inlined
from clunk.core.lanes import queues, vectors
from clunk.core.lanes.pool import (
    AT_END,
    GOES_ON,
    LOST,
    NEARS,
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
from clunk.core.lanes.vectors import ROW, WIDTH, Vector
from clunk.core.regimes import ACCELERATION
from clunk.core.status import QUALITY_GRAZING
from clunk.core.switching import ROUNDING

FloatArray = npt.NDArray[np.float64]

GRAZING = 1e-12  # a guard that turns back within this share of its scale has not turned negative
_WORTH = 1.0 / 3.0  # of what bounds a guard's jerk: a pair that makes less of it is no obstacle to a longer span
_CLEAR = 0.5  # of what misses count below: what is left of a guard after a span in which a pair is left out
_NEXT_TRY = 0.4  # of a span within which a guard was not proved positive


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
    field, present, none = fields(size), (1 << count) - 1, vectors.splat(0.0)
    alone = -1 if guards == 1 else 0  # bits of all lanes, where the second ends nothing
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
    sign1 = side * guard1.sign if guard1.sided != 0 else vectors.splat(guard1.sign)
    sign2 = side * guard2.sign if guard2.sided != 0 else vectors.splat(guard2.sign)
    shift1, shift2 = half_gap * guard1.offset, half_gap * guard2.offset
    scale1 = half_gap * guard1.of_gap + static * guard1.of_rest
    scale2 = half_gap * guard2.of_gap + static * guard2.of_rest
    bar1, bar2 = vectors.magnitude(margin) * scale1, vectors.magnitude(margin) * scale2

    # the guards: without the pairs that are left out already, and the fastest pair that is still in them
    slower1, ring1, pair1, sways1, sway1 = curves.look(first, work, size, level, deepest)
    at1 = curves.origin(output, f1, steady, torque, gap_input, elapsed)
    slower2, ring2, pair2, sways2, sway2, at2 = slower1, ring1, pair1, sways1, sway1, at1  # itself or its mirror image
    if two:
        slower2, ring2, pair2, sways2, sway2 = curves.look(second, work, size, level, deepest)
        at2 = curves.origin(output, f2, steady, torque, gap_input, elapsed)
    start1 = curves.as_guard(slower1, at1, sign1, shift1 - ring1)
    start2 = curves.as_guard(slower2, at2, sign2, shift2 - ring2)

    # what can follow
    acceleration, _, _ = curves.origin(output, ACCELERATION, True, torque, gap_input, none)
    _, sixth, swing = curves.bounds(accelerating, work, size)
    beaten = (acceleration + swing > high) | (acceleration - swing < low)
    settled = 0
    if steady:
        calm1, calm2 = sign1 * at1[0] + shift1 - sway1, sign2 * at2[0] + shift2 - sway2
        settled = (calm1 > 0.0) & (calm2 > 0.0) & (calm1 >= bar1) & (calm2 >= bar2) & ~beaten & present
    there = present & ~settled

    # a span in which no guard will probably turn negative, or the part of the shortest up to an event
    start1, start2 = _from_zero(start1, zero == 1.0), _from_zero(start2, zero == -1.0)
    event, ends, lost, grazing, dig = none - 1.0, 0, 0, 0, 0
    if short:
        k, whole, part = none - 1.0, none + shortest, vectors.smaller(rest / shortest, none + 1.0)
        ends = (rest <= shortest) & there
        near1 = (~(curves.low(start1, whole) > 0.0) | (zero >= 2.0)) & there
        near2 = (~(curves.low(start2, whole) > 0.0) | (zero <= -2.0)) & there & ~alone
        for g in range(2):
            # a guard and its mirror image are seldom both near: each in its lanes, all at once
            near, other = (near1, 0) if g == 0 else (near2, near2)
            if not two:
                near, other = (near1 | near2, near2 & ~near1) if g == 0 else (near1 & near2, near2)
            if near == 0:
                continue
            sign, shift = vectors.choose(other, sign2, sign1), vectors.choose(other, shift2, shift1)
            at, sway = (at2, sway2) if two and g == 1 else (at1, sway1)
            curves.expand(series[f2 if g == 1 else f1], work, size, shortest, sign, shift, at, pool.series)
            order = vectors.larger(vectors.choose(other, -zero, zero), none)
            noise = ROUNDING * (vectors.magnitude(at[0]) + vectors.magnitude(shift) + sway)
            found, bad, grazed, s = _crossing(pool, near, order, noise, vectors.choose(other, scale2, scale1), part)
            lost |= bad
            grazing |= grazed
            found &= (event < 0.0) | (s < part)
            event, part = vectors.choose(found, vectors.choose(other, 1.0, 0.0), event), vectors.choose(found, s, part)
        h = whole * part
    else:
        at_most = row_of(pool, field + rows.TRY)
        h, k = _longest(shortest, start1, start2, alone, at_most)
        level_guard = vectors.magnitude(zero) > 1.0  # it is zero with its slope: its series decides
        k = vectors.choose(level_guard, -1.0, k)
        slower1, slower2 = curves.without(start1, pair1, sign1, sways1), curves.without(start2, pair2, sign2, sways2)
        # nothing is left out where it would not tell a miss that counts from one that does not
        deeper = (level < float(deepest)) & (slower1.value > bar1) & ((slower2.value > bar2) | alone) & ~level_guard
        deeper &= (k >= 0.0) | (level == 0.0)
        deeper &= (pair1.jerk > _WORTH * start1.jerk) | (pair2.jerk > _WORTH * start2.jerk)
        if deeper != 0:
            clear1, clear2 = curves.less(slower1, _CLEAR * bar1), curves.less(slower2, _CLEAR * bar2)
            longer, number = _longest(shortest, clear1, clear2, alone, at_most)
            deeper &= number > k
            k, h = vectors.choose(deeper, number, k), vectors.choose(deeper, longer, h)
            level = vectors.choose(deeper, level + 1.0, level)
            start1, start2 = curves.either(deeper, slower1, start1), curves.either(deeper, slower2, start2)
            ring1, ring2 = ring1 + vectors.choose(deeper, sways1, 0.0), ring2 + vectors.choose(deeper, sways2, 0.0)
        dig, part = (~((k >= 0.0) & (start1.value >= 0.0) & ((start2.value >= 0.0) | alone))) & there, none
    moving = there & ~dig & ~lost
    rush1 = rush2 = curves.rush(first, work, size, level, deepest)
    if two:
        rush2 = curves.rush(second, work, size, level, deepest)

    # go there
    vectors.store(notes, 0, k)
    if short:
        curves.move(flows.power[flow], flows.generator[flow], modes, part, work, size, pool.moved)
        if not modes:
            curves.measure(work, size)  # amplitudes never grow: of modes, the old ones will do for so short a time
    else:
        gather_spans(pool, flows.propagator[flow], size)
        curves.jump(pool.moved, work, size)
    elapsed += h
    vectors.store(work, field + rows.ELAPSED, elapsed)
    vectors.store(work, field + rows.ZERO, none)
    vectors.store(work, field + rows.TRY, none + np.inf)

    # how the guards got on: whether they stayed positive, and whether not even the shortest span will pass
    slower1 = curves.glance(first, work, size, level, deepest, start1)
    slower2, at1 = slower1, curves.origin(output, f1, steady, torque, gap_input, elapsed)
    at2, end1 = at1, curves.as_guard(slower1, at1, sign1, shift1 - ring1)
    least1, _, parts1 = curves.between(start1, end1, h)
    close = curves.guess(end1, none + shortest) <= 0.0
    sunk, failed = (end1.value < 0.0) | close, ~(vectors.smaller(least1, end1.value) > 0.0)
    end2, least2, parts2 = end1, least1, parts1
    if watched == 2:
        if two:
            slower2 = curves.glance(second, work, size, level, deepest, start2)
            at2 = curves.origin(output, f2, steady, torque, gap_input, elapsed)
        end2 = curves.as_guard(slower2, at2, sign2, shift2 - ring2)
        least2, _, parts2 = curves.between(start2, end2, h)
        close |= (curves.guess(end2, none + shortest) <= 0.0) & ~alone
        sunk |= close | (end2.value < 0.0) & ~alone
        failed |= ~(vectors.smaller(least2, end2.value) > 0.0) & ~alone
    # a span beyond the end of the run counts as failed, so that no event depends on where that end is
    failed = 0 if short else (failed | (h > rest)) & moving
    moving &= ~failed
    turns = _accelerate(pool, accelerating, acceleration, sixth, h, beaten & moving, size)
    counts, misses = moving & (elapsed > held_from), 0
    for g in range(watched):
        # what turned back on the way is a near miss; but a guard that was level, rounding would have turn
        start, end, least, parts = (start1, end1, least1, parts1) if g == 0 else (start2, end2, least2, parts2)
        rush, scale, bar = (rush1, scale1, bar1) if g == 0 else (rush2, scale2, bar2)
        fresh = (zero > 1.0 if g == 0 else zero < -1.0) & (held_from <= 0.0)
        may = counts & (scale > 0.0) & ~(event == float(g)) & ~fresh
        may &= vectors.smaller(vectors.smaller(start.value, end.value), least) < bar
        monotone, crest = curves.turns_not(start, end, parts, rush, h)
        may &= ~monotone & ~(crest & (level == 0.0))
        if may != 0:
            sign, shift = (sign1, shift1) if g == 0 else (sign2, shift2)
            misses |= may << (g * WIDTH)
            _seek_turns(pool, flows, flow, f1 if g == 0 else f2, g, may, h, sign, shift, elapsed)
    vectors.store(work, field + rows.LEVEL, vectors.choose(sunk, 0.0, level))

    # who moved is put back; who met an event, with its state
    happened, deep = (event >= 0.0) & moving, 0
    if happened != 0:
        # a margin is made by how deep the guard goes, unless that is certainly more than the margin is
        deep = vectors.choose(event == 0.0, curves.falls_by(end1) - bar1, curves.falls_by(end2) - bar2) >= 0.0
        _leave(pool, flows, flow, torque, gap_input, elapsed, happened)
        vectors.store(notes, 0, event)
    put_back(pool, pool.numbers, field + rows.CHANGING, moving)
    bits = dig
    while bits != 0:
        lane = vectors.first_of(bits)
        bits &= bits - 1
        pool.numbers[pool.who[lane], field + rows.LEVEL] = 0.0
    if failed != 0:
        vectors.store(notes, 1, _NEXT_TRY * h)
        bits = failed
        while bits != 0:
            lane = vectors.first_of(bits)
            bits &= bits - 1
            pool.numbers[pool.who[lane], field + rows.TRY] = notes[1, lane]
    special = (settled | lost | ends | grazing | happened | turns | misses | misses >> WIDTH) & present
    if modes:
        push_all(pool, queues.PART + kind, (dig | close & moving) & ~special)
        push_all(pool, queues.SPAN + kind, (moving & ~close | failed) & ~special)
    else:
        push_all(pool, queues.PART + kind, moving & ~special)
    push_all(pool, queues.FOLLOW, special)
    while special != 0:
        lane = vectors.first_of(special)
        special &= special - 1
        run, bit = pool.runs[pool.who[lane]], 1 << lane
        run.pending = (turns >> lane & 1) | (misses >> lane & 1) << 1 | (misses >> (lane + WIDTH) & 1) << 2
        run.measured = deep >> lane & 1
        if grazing & bit:
            run.quality |= QUALITY_GRAZING
        if settled & bit:
            run.ended = SETTLED
        elif lost & bit:
            run.ended = LOST
        elif happened & bit:
            run.ended = int(vectors.number(notes, lane))
        else:
            run.ended = AT_END if ends & bit else (NEARS if close & bit else GOES_ON)


@unowned_inlined
def _crossing(
    pool: Pool, near: int, order: Vector, noise: Vector, scale: Vector, part: Vector
) -> tuple[int, int, int, Vector]:
    """Where the guards whose series are `pool.series` turn negative first, within a part of the shortest span.

    near : the lanes that are concerned
    order : how many of a guard's derivatives are zero at the beginning, itself included
    noise, scale : its rounding, and what its grazing is relative to

    Returns
    -------
    found, lost, grazed : int
        The lanes where it does, where nothing is finite, and where it does not turn negative, but turns back within
        GRAZING.
    s : Vector
        In shares of the shortest span.
    """
    c = pool.series
    start = vectors.load(c, 0)
    lost = near & ~(start - start == 0.0)
    near &= ~lost
    within = vectors.larger(noise, GRAZING * scale)
    order = vectors.choose((order == 0.0) & (start <= noise) & (start >= -within), 1.0, order)
    for n in range(3):  # zeros at the beginning are divided out
        shifted = order > float(n)
        if shifted == 0:
            break
        for j in range(TERMS - 1):
            vectors.store(c, j, vectors.choose(shifted, vectors.load(c, j + 1), vectors.load(c, j)))
        vectors.store(c, TERMS - 1, vectors.choose(shifted, 0.0, vectors.load(c, TERMS - 1)))
    found, positive, s, fall, half = curves.crossing(c, part, False)
    unclear = near & ~found & ~positive
    if unclear != 0:
        vectors.store(pool.notes, 0, s)
        vectors.store(pool.notes, 1, fall)
        vectors.store(pool.notes, 2, half)
        vectors.store(pool.notes, 3, part)
        found |= _cross_alone(pool, unclear)
        s, fall, half = vectors.load(pool.notes, 0), vectors.load(pool.notes, 1), vectors.load(pool.notes, 2)
    # only where it falls at once can it turn back within rounding
    start = vectors.load(c, 0)
    fall = vectors.choose(order > 0.0, start, fall)
    bend = vectors.choose(order > 0.0, 2.0 * vectors.load(c, 1), 2.0 * half)
    tangent = (s > 0.0) | (order > 0.0) | (start >= -within)
    tangent &= (bend > 0.0) & (order < 2.0) & (fall * fall <= 2.0 * bend * GRAZING * scale)
    found &= near
    return found & ~tangent, lost, found & tangent, s


@unowned_inlined
def _cross_alone(pool: Pool, bits: int) -> int:
    """Zero, slope and half the curvature of some lanes' series, one by one, into the first notes; whose has a zero."""
    notes, c, found = pool.notes, pool.single[0], 0
    while bits != 0:
        lane = vectors.first_of(bits)
        bits &= bits - 1
        for j in range(TERMS):
            c[j] = vectors.number(pool.series, j * WIDTH + lane)
        zero = polynomial.first_negative_of(c, notes[3, lane], pool.single[1], pool.ladder)
        if zero >= 0.0:
            found |= 1 << lane
            notes[0, lane] = zero
            _, notes[1, lane], notes[2, lane] = polynomial.derivatives(c, TERMS, zero)
    return found


@unowned_inlined
def _accelerate(pool: Pool, watch: FloatArray, origin: Vector, sixth: Vector, h: Vector, beaten: int, size: int) -> int:
    """See what the acceleration did within a time h; in which lanes it may have had an extreme that counts.

    beaten : the lanes where it can exceed what its window holds
    """
    work, notes, field = pool.work, pool.notes, fields(size)
    none = vectors.splat(0.0)
    start = curves.Curve(
        row_of(pool, field + rows.SEEN),
        row_of(pool, field + rows.SEEN_SLOPE),
        row_of(pool, field + rows.SEEN_CURVATURE),
        none,
        sixth,
    )
    seen = curves.glance(watch, work, size, none, 0, start)
    last = seen.value + origin
    end = curves.Curve(last, seen.slope, seen.curvature, none, sixth)
    high, low = (
        vectors.larger(row_of(pool, field + rows.HIGH), last),
        vectors.smaller(row_of(pool, field + rows.LOW), last),
    )
    turns = 0
    if beaten != 0:
        least, greatest, parts = curves.between(start, end, h)
        monotone, _ = curves.turns_not(start, end, parts, none, h)
        turns = ((greatest > high) | (least < low)) & beaten & ~monotone
    vectors.store(work, field + rows.HIGH, high)
    vectors.store(work, field + rows.LOW, low)
    vectors.store(work, field + rows.LARGEST, vectors.larger(row_of(pool, field + rows.LARGEST), last))
    vectors.store(work, field + rows.SMALLEST, vectors.smaller(row_of(pool, field + rows.SMALLEST), last))
    vectors.store(work, field + rows.SEEN, last)
    vectors.store(work, field + rows.SEEN_SLOPE, seen.slope)
    vectors.store(work, field + rows.SEEN_CURVATURE, seen.curvature)
    if turns != 0:
        vectors.store(notes, 1, h)
        vectors.store(notes, 2, origin)
        bits = turns
        while bits != 0:
            lane = vectors.first_of(bits)
            bits &= bits - 1
            pool.here[0], pool.here[1], pool.here[2] = notes[2, lane], 0.0, 0.0
            ask(pool, pool.who[lane], rows.EXTREMES_TASK, size, notes[1, lane], 1.0, 0.0)
    return int(turns)


@unowned_inlined
def _seek_turns(
    pool: Pool,
    flows: Flows,
    flow: int,
    f: int,
    g: int,
    bits: int,
    h: Vector,
    sign: Vector,
    shift: Vector,
    elapsed: Vector,
) -> None:
    """In some lanes, let the lowest turn of a guard within the step be looked for."""
    notes, numbers, size = pool.notes, pool.numbers, flows.basis.shape[1]
    field = fields(size)
    vectors.store(notes, 1, h)
    vectors.store(notes, 2, sign)
    vectors.store(notes, 3, shift)
    vectors.store(notes, 4, elapsed)
    while bits != 0:
        lane = vectors.first_of(bits)
        bits &= bits - 1
        slot = pool.who[lane]
        torque, gap_input = (
            numbers[slot, field + rows.TORQUE],
            numbers[slot, field + rows.SIDE] * numbers[slot, field + rows.HALF_GAP],
        )
        find_origin(pool, flows, flow, f, torque, gap_input, numbers[slot, field + rows.ELAPSED])
        ask(pool, slot, rows.TURN_TASK + g, size, notes[1, lane], notes[2, lane], notes[3, lane])
        pool.asked[slot * rows.TASKS + rows.TURN_TASK + g, field + rows.COUNTS] = (
            notes[4, lane] - numbers[slot, field + rows.HELD_FROM]
        )


@unowned_inlined
def _longest(
    shortest: float, one: curves.Curve, other: curves.Curve, alone: int, at_most: Vector
) -> tuple[Vector, Vector]:
    """`curves.longest`; a single guard is not looked at twice."""
    if alone != 0:
        return curves.longest(shortest, one, one, at_most)
    return curves.longest(shortest, one, other, at_most)


@unowned_inlined
def _from_zero(guard: curves.Curve, bits: int) -> curves.Curve:
    """A guard that is known to be zero in some lanes."""
    value = vectors.choose(bits, 0.0, guard.value)
    return curves.Curve(value, guard.slope, guard.curvature, guard.jerk, guard.sixth)


@unowned_inlined
def _leave(pool: Pool, flows: Flows, flow: int, torque: Vector, gap_input: Vector, elapsed: Vector, bits: int) -> None:
    """The states of some lanes, into `pool.state`."""
    origins, basis, left, size = flows.origin[flow], flows.basis[flow], pool.left, flows.basis.shape[1]
    half = 0.5 * elapsed * elapsed
    for n in range(flows.coordinates.shape[1]):
        origin = vectors.fused(gap_input, vectors.number(origins, size + n), torque * vectors.number(origins, n))
        if flows.steady[flow] == 0:
            slope = torque * vectors.number(origins, 2 * size + n) + gap_input * vectors.number(origins, 3 * size + n)
            bend = torque * vectors.number(origins, 4 * size + n) + gap_input * vectors.number(origins, 5 * size + n)
            origin += slope * elapsed
            origin += bend * half
        away = vectors.splat(0.0)
        for j in range(size):
            away = vectors.fused(vectors.load(pool.work, j), vectors.number(basis, j * size + n), away)
        vectors.store(left, n, origin + away)
    nobody = pool.state.shape[0] - 1
    for lane in range(WIDTH):
        pool.others[lane] = (pool.who[lane] if (bits >> lane) & 1 else nobody) * size
    for row in range(0, size, ROW):
        vectors.scatter(left, row, pool.state, pool.others, row)
