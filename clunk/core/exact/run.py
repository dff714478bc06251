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
  not to change;
- of either sign: 1 - (length of a contact)/(sticking time), at each separation.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.events import LOAD_STEP, LOCK, OPENING, REJOIN, SEPARATION, STAGE, TOUCH
from clunk.core.exact import curves, moving, rows
from clunk.core.exact.flows import Flows
from clunk.core.exact.search import DEPTH, EXTREMES, TURN, conclude, search
from clunk.core.exact.step import GRAZING, origin_of_acceleration, take_step
from clunk.core.exact.workspace import (
    Workspace,
    begin_search,
    field,
    find_origin,
    log_of,
    make_workspace,
    push_search,
    scale_of,
    set_field,
    sign_of,
    step_queue,
)
from clunk.core.jit import compiled, unowned, unowned_inlined
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import push, put_back, take
from clunk.core.lanes.vectors import WIDTH
from clunk.core.regimes import System
from clunk.core.runs import BEGIN, LEVEL, Log, Outcome, Start, begin_wave, piece_at, record, set_torque
from clunk.core.status import INTERRUPTED, QUALITY_COMPLETE, Status
from clunk.core.switching import (
    MOST_STAGES,
    Entry,
    breakpoint_of,
    holding_torque,
    room_for_a_switch,
    switch,
    weigh,
)
from clunk.core.tables import ACCELERATION, FORCE, GAP, HALF_GAP, INPUTS, TORQUE

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NON_FINITE = int(Status.NON_FINITE)
_EVENT_BUFFER_FULL = int(Status.EVENT_BUFFER_FULL)

MOST = 0.25  # margins from here on are all alike
_MOST_SPANS = 1000.0  # of a depth: a guard that never turns back comes to rest


@compiled
def run(system: System, flows: Flows, start: Start, log: Log, stop: npt.NDArray[np.uint8]) -> Outcome:
    """Run from the load step to the end time, or until nothing can follow.

    Parameters
    ----------
    log : Log
        Output.
    stop : (1,) uint8
        Set to non-zero from another thread to abandon the run.
    """
    events, states = log.events.reshape(1, log.events.size), log.states.reshape(1, *log.states.shape)
    space = make_workspace(system, flows, start.loads, events, states)
    begin(space, 0, start)
    advance(space, stop)
    row = space.runs[0]
    status = INTERRUPTED if space.pool.length[space.queues.over] == 0 else row.status
    return Outcome(status, row.count, row.quality, margin_of(space, 0), row.time)


@unowned_inlined
def margin_of(space: Workspace, slot: int) -> float:
    """How near a run came to another label: dimensionless, from -MOST to MOST."""
    return float(space.numbers[slot, space.behind + rows.MARGIN])


@unowned_inlined
def begin(space: Workspace, slot: int, start: Start) -> None:
    """Put a run into an empty place of a workspace."""
    row, numbers = space.runs[slot], space.numbers[slot, space.behind :]
    side = space.system.regimes[start.regime].side
    row.status, row.quality, row.last_side = _OK, 0, side
    row.contact_began, row.from_sticking, row.fastest, row.stages = -np.inf, 0, 0.0, 0
    row.load, row.piece = start.load, piece_at(start.loads[start.load], 0, 0.0)
    space.inputs[slot, HALF_GAP] = start.half_gap
    begin_wave(space.system, start.loads[start.load], row.piece, start.x)
    set_torque(space.system, start.loads[start.load], row.piece, 0.0, space.inputs[slot])
    row.static = _static(space.system, space.flows, start)
    numbers[rows.MARGIN] = MOST
    # no acceleration counts before the first primary impact
    numbers[rows.WINDOW_MAX], numbers[rows.WINDOW_MIN] = np.inf, -np.inf
    record(log_of(space, slot), 0, 0.0, 0.0, LOAD_STEP, start.regime, side, start.x)
    numbers[rows.PHASE_MAX], numbers[rows.PHASE_MIN] = -np.inf, np.inf
    _enter(space, slot, 0.0, start.x, Entry(written=1, regime=start.regime, zero_guard=-1, zero_order=0))


@unowned_inlined
def _enter(space: Workspace, slot: int, time: float, x: FloatArray, entry: Entry) -> None:
    """Enter a regime, or go on in it: the state, what it makes of the inputs and the guards, and the run's queue."""
    system, row, inputs = space.system, space.runs[slot], space.inputs[slot]
    numbers, regime = space.numbers[slot, space.behind :], entry.regime
    numbers[rows.LIMIT], space.numbers[slot, space.kink_at] = system.end_time - time, 0.0
    if space.loads.shape[1] > 1:
        _take_piece(space, slot, time, x)
    row.time, row.count, row.regime = time, entry.written, regime
    row.seeks_extremes, row.seeks_turns, row.depth_known = 0, 0, 0
    for k in range(x.size):
        space.numbers[slot, k] = x[k]  # a state for now; `_enter_coordinates` makes coordinates of it
    numbers[rows.ZERO] = rows.zero_of(entry.zero_guard, entry.zero_order)
    entered = system.regimes[regime]
    held_from = row.contact_began + system.sticking_time - time
    numbers[rows.HELD_FROM] = held_from if entered.closed != 0 else -np.inf
    for k in range(system.weights.shape[1]):
        space.numbers[slot, space.inputs_at + k] = system.weights[regime, k] * inputs[k]
    numbers[rows.SIDE] = -1.0 if entered.side * system.regimes[system.leaders[entered.group]].side < 0 else 1.0
    numbers[rows.SCALE] = entered.of_gap * inputs[HALF_GAP] + entered.of_rest * row.static
    for n in range(entered.watched):
        numbers[rows.SHIFT + n] = weigh(system.offsets[regime, n], inputs)
    push(space.pool, space.queues.enter + system.regimes[regime].group, slot)


@unowned_inlined
def _take_piece(space: Workspace, slot: int, time: float, x: FloatArray) -> None:
    """Set a run's torque to that of the load's piece at a time, and its limit to where that ends."""
    row, numbers, load = space.runs[slot], space.numbers[slot, space.behind :], space.loads[space.runs[slot].load]
    piece = piece_at(load, row.piece, time)
    if piece != row.piece:
        row.piece = piece
        begin_wave(space.system, load, piece, x)
    set_torque(space.system, load, piece, time, space.inputs[slot])
    if piece + 1 < load.shape[0]:
        numbers[rows.LIMIT] = min(space.system.end_time, load[piece + 1, BEGIN]) - time
        space.numbers[slot, space.kink_at] = 1.0


@unowned
def advance(space: Workspace, stop: npt.NDArray[np.uint8]) -> None:
    """Take steps until some runs are over, or `stop` is set. They wait in the queue `over`.

    It is the turn of what most wait for, for as long as there are as many as there are lanes.
    """
    vectors.align_stack()
    pool, queues, queue = space.pool, space.queues, space.queues.span
    while pool.length[queues.over] < WIDTH and stop[0] == 0:
        if pool.length[queue] < WIDTH:
            queue = int(np.argmax(pool.length[: queues.over]))
            if pool.length[queue] == 0:
                break
        if queue < queues.extremes:
            count, group = take(pool, queue, space.numbers, space.read), queue % space.system.leaders.size
            short = queues.short <= queue < queues.enter
            if queue >= queues.enter:  # and take the first step at once
                flow = space.system.regimes[space.system.leaders[group]].flow
                _enter_coordinates(space, flow, count)
                short = space.flows.modal[flow] == 0
            take_step(space, group, short, count)
        else:
            count, sought = take(pool, queue, space.searches, space.searches.shape[1]), EXTREMES
            first = queues.extremes
            if queue >= queues.depth:
                sought, first = DEPTH, queues.depth
            elif queue >= queues.turn:
                sought, first = TURN, queues.turn
            flow, functional = divmod(queue - first, space.flows.watch.shape[1])
            conclude(space, sought, queue, count, search(space, sought, flow, functional, count))
        for k in range(pool.length[queues.follow]):
            _follow(space, pool.waiting[queues.follow, k])
        pool.length[queues.follow] = 0


@unowned_inlined
def _enter_coordinates(space: Workspace, flow: int, count: int) -> None:
    """From the states of the runs taken to their coordinates in a flow, with the acceleration as it is there."""
    flows, work, size, zero = space.flows, space.pool.work, space.flows.basis.shape[1], vectors.splat(0.0)
    moving.to_coordinates(space, flow)
    acceleration = curves.evaluate_again(
        flows.watch[flow, ACCELERATION], work, size, zero, 0, curves.Curve(zero, zero, zero, zero, zero)
    )
    origin = origin_of_acceleration(space, flow, zero)
    seen = acceleration.value + origin.value
    set_field(space, rows.ELAPSED, zero)
    set_field(space, rows.LEFT_OUT, zero)
    set_field(space, rows.TRY, zero + np.inf)
    set_field(space, rows.WINDOW_MAX, vectors.larger(field(space, rows.WINDOW_MAX), seen))
    set_field(space, rows.WINDOW_MIN, vectors.smaller(field(space, rows.WINDOW_MIN), seen))
    set_field(space, rows.PHASE_MAX, vectors.larger(field(space, rows.PHASE_MAX), seen))
    set_field(space, rows.PHASE_MIN, vectors.smaller(field(space, rows.PHASE_MIN), seen))
    set_field(space, rows.SEEN, seen)
    set_field(space, rows.SEEN_SLOPE, acceleration.slope + origin.slope)
    set_field(space, rows.SEEN_CURVATURE, acceleration.curvature)
    put_back(space.pool, space.numbers, space.behind + rows.CHANGING, (1 << count) - 1)


@unowned_inlined
def _follow(space: Workspace, slot: int) -> None:
    """Send a run on: search something within its step, end its phase, or take the next step."""
    row = space.runs[slot]
    numbers, each, queues = space.numbers[slot, space.behind :], space.searches_each, space.queues
    now = row.time + numbers[rows.ELAPSED]
    if row.seeks_extremes != 0:
        row.seeks_extremes = 0
        wanted = space.searches[slot * each + rows.EXTREMES_SEARCH, space.behind :]
        wanted[rows.TOP], wanted[rows.BOTTOM] = numbers[rows.WINDOW_MAX], numbers[rows.WINDOW_MIN]
        push_search(space, queues.extremes, slot, rows.EXTREMES_SEARCH, ACCELERATION)
    elif row.seeks_turns != 0:
        guard = vectors.first_of(row.seeks_turns)
        row.seeks_turns &= row.seeks_turns - 1
        wanted = space.searches[slot * each + rows.TURN_SEARCH + guard, space.behind :]
        wanted[rows.TOP], wanted[rows.BOTTOM] = (
            abs(numbers[rows.MARGIN]) * scale_of(space, slot, guard),
            np.inf,
        )
        push_search(
            space, queues.turn, slot, rows.TURN_SEARCH + guard, space.system.guards[row.regime, guard].functional
        )
    elif row.ended == rows.BY_EVENT:
        scale = scale_of(space, slot, row.guard)
        if row.depth_known == 0 and scale > 0.0 and _label_hangs_on_depth(space.system, row, now):
            functional = space.system.guards[row.regime, row.guard].functional
            find_origin(space, slot, functional)
            sign = sign_of(space, slot, row.guard)
            begin_search(space, slot, rows.DEPTH_SEARCH, _MOST_SPANS, sign, numbers[rows.SHIFT + row.guard])
            wanted = space.searches[slot * each + rows.DEPTH_SEARCH, space.behind :]
            wanted[rows.TOP] = abs(numbers[rows.MARGIN]) * scale
            push_search(space, queues.depth, slot, rows.DEPTH_SEARCH, functional)
        else:
            _switch(space, slot)
    elif row.ended == rows.SETTLED:
        row.quality |= QUALITY_COMPLETE
        _end(space, slot, _OK, now)
    elif row.ended == rows.AT_END:
        load = space.loads[row.load]
        if row.piece + 1 < load.shape[0] and load[row.piece + 1, BEGIN] < space.system.end_time:
            _go_on(space, slot, load[row.piece + 1, BEGIN])
        else:
            _end(space, slot, _OK, space.system.end_time)
    elif row.ended == rows.LOST:
        _end(space, slot, _NON_FINITE, now)
    else:
        push(space.pool, step_queue(space, row.regime, row.ended == rows.NEARS), slot)


@unowned_inlined
def _go_on(space: Workspace, slot: int, time: float) -> None:
    """Go on in a phase where another piece of the load begins.

    There the torque that locks the flanks may jump or bend, and be least: a miss that no step sees.
    """
    system, row, inputs = space.system, space.runs[slot], space.inputs[slot]
    numbers = space.numbers[slot, space.behind :]
    x, regime = space.state[slot, : system.lash.size], system.regimes[row.regime]
    entry = Entry(row.count, row.regime, *rows.guard_and_order(numbers[rows.ZERO]))
    locked = system.impulsive != 0 and regime.closed != 0
    torque, slope = 0.0, 0.0
    if locked:
        set_torque(system, space.loads[row.load], row.piece, time, inputs)
        torque, slope, _ = holding_torque(system, row.regime, x, inputs)
    _enter(space, slot, time, x, entry)
    scale = scale_of(space, slot, 0)
    if locked and scale > 0.0:
        torque_after, slope_after, _ = holding_torque(system, row.regime, x, inputs)
        jump, rounding = regime.side * (torque_after - torque), GRAZING * scale
        falls = regime.side * slope < 0.0 or jump < -rounding
        rises = regime.side * slope_after > 0.0 or jump > rounding
        least = min(regime.side * torque, regime.side * torque_after) / scale
        if falls and rises and 0.0 <= least < abs(numbers[rows.MARGIN]):
            numbers[rows.MARGIN] = least


@unowned_inlined
def _label_hangs_on_depth(system: System, row: Any, now: float) -> bool:
    """Whether the label hangs on how deep the guard goes that ended a run's phase."""
    guard = system.guards[row.regime, row.guard]
    if guard.event_kind == TOUCH:  # a crossing
        return bool(guard.side != row.last_side)
    if guard.event_kind == OPENING:  # by force: it counts after a contact that held
        return bool(row.from_sticking != 0)
    return bool(guard.event_kind == SEPARATION and now - row.contact_began > system.sticking_time)


@unowned_inlined
def _end(space: Workspace, slot: int, status: int, time: float) -> None:
    """End a run."""
    row = space.runs[slot]
    row.status, row.time = status, time
    _close_phase(space, slot)
    push(space.pool, space.queues.over, slot)


@unowned_inlined
def _close_phase(space: Workspace, slot: int) -> None:
    """Write the extremes of the acceleration to the event that began a run's phase."""
    last = space.events[slot, space.runs[slot].count - 1]
    last.max_acceleration = space.numbers[slot, space.behind + rows.PHASE_MAX]
    last.min_acceleration = space.numbers[slot, space.behind + rows.PHASE_MIN]


@unowned_inlined
def _switch(space: Workspace, slot: int) -> None:
    """A guard turned negative: take what that says of the run's margin, and enter the regime that follows."""
    system, row, inputs, log = space.system, space.runs[slot], space.inputs[slot], log_of(space, slot)
    numbers = space.numbers[slot, space.behind :]
    x, time, total = space.state[slot, : system.lash.size], row.time + numbers[rows.ELAPSED], 0.0
    for k in range(x.size):
        total += abs(x[k])
    if not np.isfinite(total):
        _end(space, slot, _NON_FINITE, time)
        return
    if not room_for_a_switch(system, inputs, log, row.count) or row.stages > MOST_STAGES * log.events.size:
        _end(space, slot, _EVENT_BUFFER_FULL, time)
        return
    if system.ramps != 0:
        set_torque(system, space.loads[row.load], row.piece, time, inputs)
    numbers[rows.MARGIN] = _margin_of_an_event(space, slot, x, time)
    entry, row.fastest = switch(system, row.regime, row.guard, time, x, inputs, log, row.count, row.fastest)
    if entry.written == row.count:  # a stage that is not written: the phase goes on
        row.stages += 1
    else:
        _close_phase(space, slot)
        numbers[rows.PHASE_MAX], numbers[rows.PHASE_MIN] = -np.inf, np.inf  # of the phase that begins
    for k in range(row.count, entry.written):
        event = log.events[k]
        if event.kind == TOUCH:
            if event.side != row.last_side or row.from_sticking != 0:
                # a primary impact, by the rule of `sequence.find_primaries`: its window is empty, anything counts
                numbers[rows.WINDOW_MAX], numbers[rows.WINDOW_MIN] = -np.inf, np.inf
            row.last_side, row.contact_began, row.from_sticking = event.side, time, 0
        elif event.kind == LOCK:
            row.contact_began = time
        elif event.kind == SEPARATION:
            row.from_sticking = int(time - row.contact_began > system.sticking_time)
    _enter(space, slot, time, x, entry)


@unowned_inlined
def _margin_of_an_event(space: Workspace, slot: int, x: FloatArray, time: float) -> float:
    """A run's margin after an event at state `x`."""
    system, row, half_gap = space.system, space.runs[slot], space.inputs[slot, HALF_GAP]
    margin, event_kind = margin_of(space, slot), system.guards[row.regime, row.guard].event_kind
    age = time - row.contact_began
    if event_kind == SEPARATION and abs(age - system.sticking_time) < abs(margin) * system.sticking_time:
        margin = 1.0 - age / system.sticking_time
    if event_kind == REJOIN and age > system.sticking_time and row.static > 0.0:
        # the overlap is least here or soon after: where it all but vanishes, rounding decides which
        overlap = -half_gap
        for k in range(x.size):
            overlap += system.regimes[row.regime].side * system.functionals[0, GAP, k] * x[k]
        if max(overlap, 0.0) / row.static < abs(margin):
            margin = max(overlap, 0.0) / row.static
    return float(margin)


@unowned
def _static(system: System, flows: Flows, start: Start) -> float:
    """The overlap of the flanks, or the torque that locks them, at rest under the torque that the load ends at.

    Without such rest, what it is at the load step.
    """
    f, torque = FORCE if system.impulsive != 0 else GAP, start.loads[start.load, -1, LEVEL]
    offset = 0.0 if system.impulsive != 0 else start.half_gap
    most = 0.0
    for regime in range(system.regimes.size):
        row = system.regimes[regime]
        rests = row.closed != 0 and flows.steady[row.flow] != 0
        if rests and system.preload.shape[0] > 1:
            rests = _rests(system, flows, regime, torque, start.half_gap)
        if rests:
            value = _at_rest(system, flows, regime, f, torque, start.half_gap)
            most = max(most, row.side * value - offset)
    side, flow = system.regimes[start.regime].side, system.regimes[start.regime].flow
    if most > 0.0 or side == 0:
        return float(most)
    value = 0.0
    for k in range(start.x.size):
        value += system.functionals[flow, f, k] * start.x[k]
    return float(max(side * value - offset, 0.0))


@unowned_inlined
def _at_rest(system: System, flows: Flows, regime: int, f: int, torque: float, half_gap: float) -> float:
    """A functional of the particular solution of a regime under a torque."""
    output = flows.origin_output[system.regimes[regime].flow, 0, f]
    value = output[TORQUE] * torque + output[HALF_GAP] * (system.weights[regime, HALF_GAP] * half_gap)
    for k in range(INPUTS, output.size):
        value += output[k] * system.weights[regime, k]
    return float(value)


@unowned
def _rests(system: System, flows: Flows, regime: int, torque: float, half_gap: float) -> bool:
    """Whether a regime's particular solution under a torque lies within its stages."""
    for g in range(system.regimes[regime].guards):
        guard = system.guards[regime, g]
        if guard.event_kind == STAGE:
            value = _at_rest(system, flows, regime, guard.functional, torque, half_gap)
            if guard.sign * value + breakpoint_of(system, regime, g) < 0.0:
                return False
    return True
