"""The exact method: through the regimes by their modes, over spans in which no guard can turn negative.

A span is chosen by guess, and counts only if it is then proved that no guard turned negative within it: from a guard's
value, slope and curvature at both its ends, and a bound of its sixth derivative. Where not even the shortest can be
expected to pass so, the guard is expanded there into its Taylor series, exact to rounding, and the series' first zero,
if it has one, is the event. So no event is skipped, to rounding, for this model.

The severity's extremes are located by the same means, where the acceleration could exceed what the window holds; and
so are the near misses, which give the run's margin: how near it came to another label. It is the smallest of

- positive, what did not happen: the distance to a flank where the gap coordinate turned back, as a share of the whole
  gap; and where a contact held, later than the sticking time, the least overlap of the flanks (restitution: the least
  torque that locks them), as a share of its value at rest;
- negative, what did: how much further a crossing, or the end of a sticking contact, would have gone, were the contact
  not to change; and one less the length of a contact over the sticking time, of either sign.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.events import LOAD_STEP, LOCK, OPENING, REJOIN, SEPARATION, TOUCH
from clunk.core.exact import curves, rows
from clunk.core.exact.flows import Flows
from clunk.core.exact.search import search
from clunk.core.exact.stride import stride
from clunk.core.jit import compiled, unowned, unowned_inlined
from clunk.core.lanes import queues, vectors
from clunk.core.lanes.pool import (
    AT_END,
    LOST,
    NEARS,
    SETTLED,
    Pool,
    ask,
    fields,
    find_origin,
    make_pool,
    push,
    put_back,
    scale_of,
    separates_by_force,
    take,
)
from clunk.core.lanes.vectors import WIDTH
from clunk.core.regimes import ACCELERATION, CLOSED_FLOW, FORCE, GAP, System
from clunk.core.status import INTERRUPTED, QUALITY_COMPLETE, Status
from clunk.core.switching import pass_on, record, room_for_a_switch, strike

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NON_FINITE = int(Status.NON_FINITE)
_EVENT_BUFFER_FULL = int(Status.EVENT_BUFFER_FULL)

MOST = 0.25  # margins from here on are all alike
CLOSED = -np.inf  # a window of severity that nothing can exceed
_MOST_SPANS = 1000.0  # of a depth: a guard that never turns back comes to rest


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
        State at the load step.
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
    pool = make_pool(system, flows, events.reshape(1, events.size), states.reshape(1, *states.shape))
    begin(pool, 0, system, flows, x, regime, torque, half_gap)
    advance(pool, system, flows, stop)
    own = pool.runs[0]
    margin = pool.numbers[0, fields(flows.basis.shape[1]) + rows.MARGIN]
    if pool.length[queues.OVER] == 0:
        return INTERRUPTED, own.count, own.quality, margin, own.time
    return own.status, own.count, own.quality, margin, own.time


@unowned
def begin(
    pool: Pool,
    slot: int,
    system: System,
    flows: Flows,
    x: FloatArray,
    regime: int,
    torque: float,
    half_gap: float,
) -> None:
    """Put a run into an empty place of a pool; the arguments are those of `run`."""
    size, numbers, own = flows.basis.shape[1], pool.numbers[slot], pool.runs[slot]
    field, side = fields(size), system.regimes[regime].side
    own.status, own.quality, own.count, own.regime, own.last_side = _OK, 0, 1, regime, side
    own.time, own.began, own.from_sticking, own.fastest = 0.0, -np.inf, 0, 0.0
    own.pending, own.measured = 0, 0
    for k in range(x.size):
        numbers[k] = x[k]
    numbers[field + rows.MARGIN] = MOST
    # nothing is asked of the acceleration before the first primary impact
    numbers[field + rows.HIGH], numbers[field + rows.LOW], numbers[field + rows.ZERO] = -CLOSED, CLOSED, 0.0
    numbers[field + rows.TORQUE], numbers[field + rows.HALF_GAP], numbers[field + rows.SIDE] = torque, half_gap, side
    numbers[field + rows.LIMIT], numbers[field + rows.HELD_FROM] = system.end_time, -np.inf
    numbers[field + rows.STATIC] = _static(system, flows, regime, torque, half_gap, x)
    record(pool.events[slot], pool.states[slot], 0, 0.0, 0.0, LOAD_STEP, regime, side, x)
    push(pool, queues.ENTER + queues.kind_of(regime), slot)


@unowned
def advance(pool: Pool, system: System, flows: Flows, stop: npt.NDArray[np.uint8]) -> None:
    """Take steps until some runs of the pool are over, or `stop` is set. They wait in the queue OVER.

    It is the turn of what most wait for, for as long as there are as many as there are lanes.
    """
    vectors.align_stack()
    queue = queues.SPAN
    while pool.length[queues.OVER] < WIDTH and stop[0] == 0:
        if pool.length[queue] < WIDTH:
            queue = int(np.argmax(pool.length[: queues.OVER]))
            if pool.length[queue] == 0:
                break
        if queue < queues.EXTREMES:
            count = take(pool, queue, pool.numbers)
            step = queue
            if queue >= queues.ENTER:  # and take the first step at once
                kind = queue - queues.ENTER
                _enter(pool, flows, kind, count)
                step = queues.SPAN + kind if flows.modal[pool.kinds[kind].flow] != 0 else queues.PART + kind
            stride(pool, flows, step, count)
        else:
            search(pool, flows, queue, take(pool, queue, pool.asked))
        for k in range(pool.length[queues.FOLLOW]):
            _follow(pool, system, flows, pool.waiting[queues.FOLLOW, k])
        pool.length[queues.FOLLOW] = 0


@unowned_inlined
def _enter(pool: Pool, flows: Flows, kind: int, count: int) -> None:
    """From the states of runs to their coordinates in the flow of a regime."""
    flow, size, work, left = pool.kinds[kind].flow, flows.basis.shape[1], pool.work, pool.left
    origins, coordinates, states = flows.origin[flow], flows.coordinates[flow], flows.coordinates.shape[1]
    field = fields(size)
    torque, half_gap = vectors.load(work, field + rows.TORQUE), vectors.load(work, field + rows.HALF_GAP)
    gap_input = vectors.load(work, field + rows.SIDE) * half_gap
    for k in range(states):
        origin = vectors.fused(gap_input, vectors.number(origins, size + k), torque * vectors.number(origins, k))
        vectors.store(left, k, vectors.load(work, k) - origin)
    for c in range(size):
        total = vectors.splat(0.0)
        for k in range(states):
            total = vectors.fused(vectors.load(left, k), vectors.number(coordinates, k * size + c), total)
        vectors.store(work, c, total)
    curves.measure(work, size)
    none = vectors.splat(0.0)
    acceleration = curves.glance(
        flows.watch[flow, ACCELERATION], work, size, none, 0, curves.Curve(none, none, none, none, none)
    )
    seen = acceleration.value + curves.origin(flows.origin_output[flow], ACCELERATION, True, torque, gap_input, none)[0]
    vectors.store(work, field + rows.ELAPSED, none)
    vectors.store(work, field + rows.LEVEL, none)
    vectors.store(work, field + rows.TRY, none + np.inf)
    vectors.store(work, field + rows.HIGH, vectors.larger(vectors.load(work, field + rows.HIGH), seen))
    vectors.store(work, field + rows.LOW, vectors.smaller(vectors.load(work, field + rows.LOW), seen))
    vectors.store(work, field + rows.LARGEST, seen)
    vectors.store(work, field + rows.SMALLEST, seen)
    vectors.store(work, field + rows.SEEN, seen)
    vectors.store(work, field + rows.SEEN_SLOPE, acceleration.slope)
    vectors.store(work, field + rows.SEEN_CURVATURE, acceleration.curvature)
    put_back(pool, pool.numbers, field + rows.CHANGING, (1 << count) - 1)


@unowned_inlined
def _follow(pool: Pool, system: System, flows: Flows, slot: int) -> None:
    """What a run does next: look for something within its step, end its phase, or go on."""
    own, numbers, size = pool.runs[slot], pool.numbers[slot], flows.basis.shape[1]
    kind, field = queues.kind_of(own.regime), fields(size)
    half_gap, static = numbers[field + rows.HALF_GAP], numbers[field + rows.STATIC]
    now = own.time + numbers[field + rows.ELAPSED]
    if own.pending & 1:
        own.pending &= 6
        row = slot * rows.TASKS + rows.EXTREMES_TASK
        pool.asked[row, field + rows.TOP], pool.asked[row, field + rows.BOTTOM] = (
            numbers[field + rows.HIGH],
            numbers[field + rows.LOW],
        )
        push(pool, queues.EXTREMES + kind, row)
    elif own.pending != 0:
        g = 0 if own.pending & 2 else 1
        own.pending = own.pending & 4 if g == 0 else 0
        row = slot * rows.TASKS + rows.TURN_TASK + g
        pool.asked[row, field + rows.TOP] = abs(numbers[field + rows.MARGIN]) * scale_of(
            pool, kind, g, half_gap, static
        )
        pool.asked[row, field + rows.BOTTOM] = np.inf
        push(pool, queues.TURN + 2 * kind + (g if pool.kinds[kind].two != 0 else 0), row)
    elif own.ended >= 0:
        g = own.ended
        scale = scale_of(pool, kind, g, half_gap, static)
        if own.measured == 0 and scale > 0.0 and _matters(system, own, now):
            guard, side = pool.guards[kind, g], numbers[field + rows.SIDE]
            flow, row = pool.kinds[kind].flow, slot * rows.TASKS + rows.DEPTH_TASK
            torque, elapsed = numbers[field + rows.TORQUE], numbers[field + rows.ELAPSED]
            find_origin(pool, flows, flow, guard.functional, torque, side * half_gap, elapsed)
            sign = guard.sign * (side if guard.sided != 0 else 1.0)
            ask(pool, slot, rows.DEPTH_TASK, size, _MOST_SPANS, sign, guard.offset * half_gap)
            pool.asked[row, field + rows.TOP] = abs(numbers[field + rows.MARGIN]) * scale
            push(pool, queues.DEPTH + 2 * kind + (g if pool.kinds[kind].two != 0 else 0), row)
        else:
            _switch(pool, system, slot, field)
    elif own.ended == SETTLED:
        own.quality |= QUALITY_COMPLETE
        _end(pool, slot, field, _OK, now)
    elif own.ended == AT_END:
        _end(pool, slot, field, _OK, system.end_time)
    elif own.ended == LOST:
        _end(pool, slot, field, _NON_FINITE, now)
    else:
        near = own.ended == NEARS or flows.modal[pool.kinds[kind].flow] == 0
        push(pool, queues.PART + kind if near else queues.SPAN + kind, slot)


@unowned_inlined
def _matters(system: System, own: Any, now: float) -> bool:
    """Whether the label hangs on how deep the guard goes that ended a run's phase."""
    event_kind = system.guards[own.regime, own.ended].event_kind
    if event_kind == TOUCH:  # a crossing
        return bool((1 if own.ended == 0 else -1) != own.last_side)
    if separates_by_force(system):  # it is the opening that counts, after a contact that held
        return bool(event_kind == OPENING and own.from_sticking != 0)
    return bool(event_kind == SEPARATION and now - own.began > system.sticking_time)


@unowned_inlined
def _end(pool: Pool, slot: int, field: int, status: int, time: float) -> None:
    """A run is over."""
    own = pool.runs[slot]
    own.status, own.time = status, time
    last = pool.events[slot, own.count - 1]
    last.max_acceleration = pool.numbers[slot, field + rows.LARGEST]
    last.min_acceleration = pool.numbers[slot, field + rows.SMALLEST]
    push(pool, queues.OVER, slot)


@unowned_inlined
def _switch(pool: Pool, system: System, slot: int, field: int) -> None:
    """A guard turned negative: what the run's margin says to that, and the regime that follows."""
    own, numbers, events, states = pool.runs[slot], pool.numbers[slot], pool.events[slot], pool.states[slot]
    x = pool.state[slot, : system.lash.size]
    regimes, table, regime, ended = system.regimes, system.guards, own.regime, own.ended
    half_gap, static, margin = (
        numbers[field + rows.HALF_GAP],
        numbers[field + rows.STATIC],
        numbers[field + rows.MARGIN],
    )
    torque, count = numbers[field + rows.TORQUE], own.count
    events[count - 1].max_acceleration = numbers[field + rows.LARGEST]
    events[count - 1].min_acceleration = numbers[field + rows.SMALLEST]
    time, total = own.time + numbers[field + rows.ELAPSED], 0.0
    for k in range(x.size):
        total += abs(x[k])
    if not np.isfinite(total):
        _end(pool, slot, field, _NON_FINITE, time)
        return
    if not room_for_a_switch(system.impulsive, half_gap, events.size, count):
        _end(pool, slot, field, _EVENT_BUFFER_FULL, time)
        return

    own.time = time
    event_kind, age = table[regime, ended].event_kind, time - own.began
    if event_kind == SEPARATION and abs(age - system.sticking_time) < abs(margin) * system.sticking_time:
        margin = 1.0 - age / system.sticking_time
    if event_kind == REJOIN and age > system.sticking_time and static > 0.0:
        # the overlap is least here or soon after: where it all but vanishes, rounding decides which
        overlap = -half_gap
        for k in range(x.size):
            overlap += regimes[regime].side * system.functionals[CLOSED_FLOW, GAP, k] * x[k]
        if max(overlap, 0.0) / static < abs(margin):
            margin = max(overlap, 0.0) / static

    known = count
    if system.impulsive == 0:
        count, regime, zero_guard, zero_order = pass_on(
            regimes, table, system.lash, regime, ended, time, x, events, states, count
        )
    else:
        count, regime, zero_guard, zero_order, own.fastest = strike(
            system, regime, ended, time, x, torque, half_gap, events, states, count, own.fastest
        )
    for k in range(known, count):
        event_kind = events[k].kind
        if event_kind == TOUCH:
            if events[k].side != own.last_side or own.from_sticking != 0:
                # a primary impact: a new window
                numbers[field + rows.HIGH], numbers[field + rows.LOW] = CLOSED, -CLOSED
            own.last_side, own.began, own.from_sticking = events[k].side, time, 0
        elif event_kind == LOCK:
            own.began = time
        elif event_kind == SEPARATION:
            own.from_sticking = int(time - own.began > system.sticking_time)
    own.count, own.regime = count, regime
    for k in range(x.size):
        numbers[k] = x[k]
    numbers[field + rows.MARGIN] = margin
    numbers[field + rows.ZERO] = zero_order if zero_guard == 0 else (-zero_order if zero_guard == 1 else 0)
    numbers[field + rows.SIDE] = regimes[regime].side
    numbers[field + rows.LIMIT] = system.end_time - time
    closed = regimes[regime].flow == CLOSED_FLOW
    numbers[field + rows.HELD_FROM] = own.began + system.sticking_time - time if closed else -np.inf
    push(pool, queues.ENTER + queues.kind_of(regime), slot)


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
