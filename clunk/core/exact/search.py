"""What runs look for within a step: extremes of the acceleration, the lowest turn of a guard, how deep one would go.

Located, not sampled: a span is passed in which there can be nothing, since the functional is monotone, or cannot exceed
what is known. Elsewhere the shortest span is expanded into its Taylor series and searched.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.exact import curves, polynomial, rows
from clunk.core.exact.flows import TERMS, Flows
from clunk.core.exact.stride import GRAZING
from clunk.core.jit import unowned_inlined
from clunk.core.lanes import queues, vectors
from clunk.core.lanes.pool import Pool, fields, gather_spans, push, push_all, put_back, row_of, scale_of
from clunk.core.lanes.vectors import WIDTH, Vector
from clunk.core.regimes import ACCELERATION
from clunk.core.status import QUALITY_GRAZING

FloatArray = npt.NDArray[np.float64]


@unowned_inlined
def search(pool: Pool, flows: Flows, queue: int, count: int) -> None:
    """Take one span of what `count` runs look for that have been taken from one of the queues EXTREMES, TURN, DEPTH.

    TOP and BOTTOM are the extremes that are known. A turn counts below TOP, and is then both. A depth, of a guard that
    falls, is BOTTOM, and need not be known beyond TOP.
    """
    turn, depth = queues.TURN <= queue < queues.DEPTH, queue >= queues.DEPTH
    at = queue - queues.DEPTH if depth else (queue - queues.TURN if turn else 2 * (queue - queues.EXTREMES))
    kind, g = at // 2, at % 2
    flow, f = pool.kinds[kind].flow, pool.guards[kind, g].functional if turn or depth else ACCELERATION
    size, work, c, notes = flows.basis.shape[1], pool.work, pool.series, pool.notes
    watch, modes, steady = flows.watch[flow, f], flows.modal[flow] != 0, flows.steady[flow] != 0
    field, shortest, none, present = fields(size), flows.span[flow, 0], vectors.splat(0.0), (1 << count) - 1

    rest, sign, shift = (
        row_of(pool, field + rows.REST),
        row_of(pool, field + rows.SIGN),
        row_of(pool, field + rows.SHIFT),
    )
    o, p, q = (
        row_of(pool, field + rows.AT),
        row_of(pool, field + rows.AT_SLOPE),
        row_of(pool, field + rows.AT_CURVATURE),
    )
    top, bottom, counts = (
        row_of(pool, field + rows.TOP),
        row_of(pool, field + rows.BOTTOM),
        row_of(pool, field + rows.COUNTS),
    )
    most, sixth, _ = curves.bounds(watch, work, size)
    seen = curves.glance(watch, work, size, none, 0, curves.Curve(none, none, none, most, sixth))
    v, d, e = sign * (seen.value + o) + shift, sign * (seen.slope + p), sign * (seen.curvature + q)
    done = 0
    if depth:
        bottom = -v
        done = bottom >= top
    elif not turn:
        top, bottom = vectors.larger(top, v), vectors.smaller(bottom, v)

    # the longest span that passes
    idle = rest - counts  # before what counts
    h, k = none + shortest, none
    near = ~_passes(turn, depth, v, d, e, most, top, bottom, idle, h)
    if modes:
        step = 8
        while step > 0:
            longer = h * float(1 << step)
            passes = _passes(turn, depth, v, d, e, most, top, bottom, idle, longer)
            h, k = vectors.choose(passes, longer, h), vectors.choose(passes, k + 2.0 * step, k)
            step //= 2
        longer = h * 1.5
        passes = _passes(turn, depth, v, d, e, most, top, bottom, idle, longer) & ~near
        h, k = vectors.choose(passes, longer, h), vectors.choose(passes, k + 1.0, k)
        h, k = vectors.choose(near, shortest, h), vectors.choose(near, 0.0, k)
    near &= present & ~done
    if near != 0:
        curves.expand(flows.series[flow, f], work, size, shortest, sign, shift, (o, p, q), c)
        falls = vectors.load(c, 1) < 0.0
        if depth:
            done |= near & ~falls
            near &= falls
        length = none + 1.0 if depth else vectors.smaller(rest / shortest, none + 1.0)
        found, straight, s = curves.turning(c, pool.moved, length)
        value, unclear = curves.value(c, s), near & ~found & ~straight
        found &= near
        if turn:
            found &= falls & (value < top) & (rest - s * shortest <= counts)
            top, bottom = vectors.choose(found, value, top), vectors.choose(found, value, bottom)
        elif depth:
            bottom = vectors.choose(found, -value, bottom)
            done |= found
        else:
            top = vectors.choose(found, vectors.larger(top, value), top)
            bottom = vectors.choose(found, vectors.smaller(bottom, value), bottom)
        if unclear != 0:
            vectors.store(notes, 0, top)
            vectors.store(notes, 1, bottom)
            vectors.store(notes, 2, length)
            vectors.store(notes, 3, idle / shortest)
            done |= _turn_alone(pool, turn, depth, unclear)
            top, bottom = vectors.load(notes, 0), vectors.load(notes, 1)

    # go there
    if depth:
        rest -= 1.0
        done |= rest <= 0.0
    else:
        done |= rest <= h
        rest -= h
    done &= present
    if done != present:
        if modes:
            vectors.store(notes, 0, k)
            gather_spans(pool, flows.propagator[flow], size)
            curves.jump(pool.moved, work, size)
        else:
            curves.move(flows.power[flow], flows.generator[flow], modes, none + 1.0, work, size, pool.moved)
            curves.measure(work, size)
        if not steady:
            vectors.store(work, field + rows.AT, o + h * (p + 0.5 * h * q))
            vectors.store(work, field + rows.AT_SLOPE, p + h * q)
    vectors.store(work, field + rows.REST, rest)
    vectors.store(work, field + rows.TOP, top)
    vectors.store(work, field + rows.BOTTOM, bottom)
    put_back(pool, pool.asked, field + (rows.AT if steady else rows.AT_CURVATURE), present & ~done)
    push_all(pool, queue, present & ~done)
    while done != 0:
        lane = vectors.first_of(done)
        done &= done - 1
        _conclude(pool, kind, turn, depth, lane, field)


@unowned_inlined
def _passes(
    turn: bool,
    depth: bool,
    v: Vector,
    d: Vector,
    e: Vector,
    most: Vector,
    top: Vector,
    bottom: Vector,
    idle: Vector,
    h: Vector,
) -> int:
    """Where there is nothing to be found within times h; if so, not within shorter ones either.

    v, d, e, most : value, slope, curvature and a bound of the third derivative
    """
    if depth:
        return int(-d > h * (e + h * (0.5 * most)))
    none = vectors.splat(0.0)
    bend = h * (0.5 * vectors.magnitude(e) + h * (most * curves.A_SIXTH))  # off its tangent, over h
    away = vectors.choose(d > 0.0, -e, e)
    monotone = h * (away + h * (0.5 * most)) < vectors.magnitude(d)
    if turn:
        above = top - v + h * (vectors.larger(-d, none) + bend) <= 0.0
        return int(above | monotone | (e + h * most < 0.0) | (h <= idle))
    within = v - top + h * (vectors.larger(d, none) + bend) <= 0.0
    within &= bottom - v + h * (vectors.larger(-d, none) + bend) <= 0.0
    return int(within | monotone)


@unowned_inlined
def _turn_alone(pool: Pool, turn: bool, depth: bool, bits: int) -> int:
    """The turning points of some lanes' series, one by one; into the first two notes. Whose depth is known now."""
    notes, c, found, known = pool.notes, pool.single[0], pool.single[1], 0
    while bits != 0:
        lane = vectors.first_of(bits)
        bits &= bits - 1
        for j in range(TERMS):
            c[j] = vectors.number(pool.series, j * WIDTH + lane)
        falls = c[1] < 0.0
        for k in range(polynomial.turning_points(c, notes[2, lane], found, pool.ladder)):
            value = polynomial.value_of(c, TERMS, found[k])
            if depth:
                notes[1, lane] = -value
                known |= 1 << lane
                break
            if not turn:
                notes[0, lane], notes[1, lane] = max(notes[0, lane], value), min(notes[1, lane], value)
            elif falls and value < notes[0, lane] and found[k] >= notes[3, lane]:
                notes[0, lane], notes[1, lane] = value, value
            falls = not falls
    return known


@unowned_inlined
def _conclude(pool: Pool, kind: int, turn: bool, depth: bool, lane: int, field: int) -> None:
    """What a run has looked for is known."""
    row, bottom = pool.who[lane], pool.work[field + rows.BOTTOM, lane]
    slot = row // rows.TASKS
    numbers, own = pool.numbers[slot], pool.runs[slot]
    half_gap, static, margin = (
        numbers[field + rows.HALF_GAP],
        numbers[field + rows.STATIC],
        abs(numbers[field + rows.MARGIN]),
    )
    if turn:
        nearest = bottom / scale_of(pool, kind, row - slot * rows.TASKS - rows.TURN_TASK, half_gap, static)
        if nearest < margin:
            numbers[field + rows.MARGIN] = max(nearest, 0.0)
            if nearest <= GRAZING:
                own.quality |= QUALITY_GRAZING
    elif depth:
        scale = scale_of(pool, kind, own.ended, half_gap, static)
        if max(bottom, 0.0) < margin * scale:
            numbers[field + rows.MARGIN] = -max(bottom, 0.0) / scale
        own.measured = 1
    else:
        top = pool.work[field + rows.TOP, lane]
        numbers[field + rows.HIGH], numbers[field + rows.LOW] = top, bottom
        numbers[field + rows.LARGEST] = max(numbers[field + rows.LARGEST], top)
        numbers[field + rows.SMALLEST] = min(numbers[field + rows.SMALLEST], bottom)
    push(pool, queues.FOLLOW, slot)
