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
- negative, what did: how much further a primary touch, or the end of a sticking contact, would have gone, were the
  contact not to change;
- of either sign: 1 - (length of a contact)/(sticking time), at each separation.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.events import INSTANT, LOCK, REJOIN, SEPARATION, TOUCH
from clunk.core.exact import functionals, moving, rows
from clunk.core.exact.search import conclude, search
from clunk.core.exact.step import take_step
from clunk.core.exact.workspace import (
    GRAZING,
    Workspace,
    lash_at,
    log_of,
    set_field,
    system_at,
    system_of,
)
from clunk.core.jit import inlined_part, part
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import push, put_back, take
from clunk.core.lanes.vectors import WIDTH
from clunk.core.regimes import (
    System,
    elements_of,
    frictions_of,
    gap_input,
    inputs_of,
    lash_of,
    lashes_of,
    take_rolling,
)
from clunk.core.rigid import holding_torque
from clunk.core.runs import LEVEL, Entry, Moment, Start, begin_wave, end_of_piece, piece_at, roll_states, set_torque
from clunk.core.status import QUALITY_COMPLETE, Status
from clunk.core.switching import MOST_STAGES, begin_run, preload, recheck_frictions, room_for_a_switch, switch, weigh
from clunk.core.tables import GAP, TORQUE, TORQUE_RATE

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NON_FINITE = int(Status.NON_FINITE)
_EVENT_BUFFER_FULL = int(Status.EVENT_BUFFER_FULL)

MOST = 0.25  # larger margins are not looked for, and written as this


@inlined_part
def begin(space: Workspace, slot: int, driveline: int, start: Start) -> None:
    """Put a run of a driveline into an empty place of a workspace."""
    row, system = space.runs[slot], system_at(space, driveline)
    row.driveline, row.status, row.quality, row.stages, row.searches = driveline, _OK, 0, 0, 0
    row.load, row.piece = start.load, piece_at(start.loads[start.load], 0, 0.0)
    row.rolled = begin_run(system, start, row.piece, space.inputs[slot], log_of(space, slot))
    for lash in range(lashes_of(system)):
        course, own = space.courses[slot, lash], space.numbers[slot, lash_at(space, lash) :]
        course.last_side = system.contacts[start.regime, lash].side
        course.contact_began, course.from_sticking = -np.inf, 0
        space.fastest[slot, lash] = 0.0
        own[rows.MARGIN] = MOST
        # no acceleration counts before the first primary impact
        own[rows.WINDOW_MAX], own[rows.WINDOW_MIN] = np.inf, -np.inf
    _set_static(space, slot, start)
    _enter(space, slot, 0.0, start.x, Entry(written=1, regime=start.regime, zero_guard=-1, zero_order=0))


@inlined_part
def _enter(space: Workspace, slot: int, time: float, x: FloatArray, entry: Entry) -> None:
    """Enter a regime, or go on in it: the state, what it makes of the inputs and the guards, and the run's queue.

    The load goes on to its piece at that time, and what no longer sticks there begins to slip, as an event.
    """
    system, row, inputs = system_of(space, slot), space.runs[slot], space.inputs[slot]
    numbers, regime = space.numbers[slot, space.behind :], entry.regime
    load, before = space.loads[row.load], row.piece
    row.piece = piece_at(load, before, time)
    if row.piece != before:
        begin_wave(system, load, row.piece, x)
    set_torque(system, load, row.piece, time, inputs)
    numbers[rows.limit(lashes_of(system))] = end_of_piece(system, load, row.piece) - time
    space.numbers[slot, space.kink_at] = 1.0 if row.piece + 1 < load.shape[0] else 0.0
    if frictions_of(system) > 0:
        row.count = entry.written
        entry = recheck_frictions(Moment(system, time, x, inputs, log_of(space, slot)), entry)
        regime = entry.regime
        if entry.written > row.count:
            _close_phase(space, slot)
            _take_events(space, slot, row.count, entry.written)
    row.time, row.count, row.regime = time, entry.written, regime
    for k in range(x.size):
        space.numbers[slot, k] = x[k]  # a state for now; `_enter_coordinates` makes coordinates of it
    numbers[rows.ZERO_GUARD], numbers[rows.ZERO_ORDER] = entry.zero_guard, entry.zero_order
    entered = system.regimes[regime]
    for k in range(inputs_of(system)):
        space.numbers[slot, space.inputs_at + k] = system.weights[regime, k] * inputs[k]
    for lash in range(lashes_of(system)):
        contact, course = system.contacts[regime, lash], space.courses[slot, lash]
        own = space.numbers[slot, lash_at(space, lash) :]
        held_from = course.contact_began + system.sticking_time[lash] - time
        mirrored = contact.side * system.contacts[system.leaders[entered.group], lash].side < 0
        scale = contact.of_gap * inputs[gap_input(lash)] + contact.of_rest * course.static
        own[rows.HELD_FROM] = held_from if contact.closed != 0 else -np.inf
        own[rows.SIDE] = -1.0 if mirrored else 1.0
        own[rows.SCALE] = scale
        course.window_max, course.window_min = own[rows.WINDOW_MAX], own[rows.WINDOW_MIN]
    for n in range(entered.watched):
        shift = weigh(system.offsets[regime, n], inputs)
        numbers[rows.shift(n, lashes_of(system))] = shift
    push(space.pool, space.queues.enter + system.regimes[regime].group, slot)


@part
def advance(space: Workspace, stop: npt.NDArray[np.uint8]) -> None:
    """Take steps until as many runs as lanes are over, or none is left, or `stop` is set.

    Those wait in the queue `over`. A queue has its turns while it fills the lanes, and then the longest one has.
    """
    vectors.align_stack()
    pool, queues, queue = space.pool, space.queues, space.queues.span
    while pool.length[queues.over] < WIDTH and stop[0] == 0:
        if pool.length[queue] < WIDTH:
            for other in range(queues.over):
                queue = other if pool.length[other] > pool.length[queue] else queue
            if pool.length[queue] == 0:
                break
        if queue < queues.search:
            count, group = take(pool, queue, space.numbers), queue % space.system.leaders.size
            short, flow = queues.short <= queue < queues.enter, space.system.regimes[space.system.leaders[group]].flow
            if space.mixed != 0:
                functionals.gather_tables(space, flow, 0, space.flows.watch.shape[2], 1)
            if queue >= queues.enter:  # and take the first step at once
                _enter_coordinates(space, flow, count)
                short = space.flows.modal[0, flow] == 0
            take_step(space, group, short, count)
        else:
            count = take(pool, queue, space.searches)
            flow, functional = divmod(queue - queues.search, space.flows.watch.shape[2])
            if space.mixed != 0:
                functionals.gather_tables(space, flow, functional, 1, space.searches_each)
            conclude(space, queue, count, search(space, flow, functional, count))
        for k in range(pool.length[queues.follow]):
            _follow(space, pool.waiting[queues.follow, k])
        pool.length[queues.follow] = 0


@inlined_part
def _enter_coordinates(space: Workspace, flow: int, count: int) -> None:
    """From the states of the runs taken to their coordinates in a flow."""
    moving.to_coordinates(space, flow)
    set_field(space, rows.ELAPSED, vectors.splat(0.0))
    set_field(space, rows.TRY, vectors.splat(np.inf))
    put_back(space.pool, space.numbers, space.behind + rows.changing(lashes_of(space.system)), (1 << count) - 1)


@inlined_part
def _follow(space: Workspace, slot: int) -> None:
    """Send a run on: end its phase, or take the next step."""
    row = space.runs[slot]
    now = row.time + space.numbers[slot, space.behind + rows.ELAPSED]
    if row.ended == rows.BY_EVENT:
        _switch(space, slot)
    elif row.ended == rows.SETTLED:
        row.quality |= QUALITY_COMPLETE
        _end(space, slot, _OK, now)
    elif row.ended == rows.AT_END:
        system = system_of(space, slot)
        end = end_of_piece(system, space.loads[row.load], row.piece)
        if end < system.end_time[0]:
            _go_on(space, slot, end)
        else:
            _end(space, slot, _OK, end)
    elif row.ended == rows.LOST:
        _end(space, slot, _NON_FINITE, now)
    else:
        entered = space.system.regimes[row.regime]
        short = row.ended == rows.NEARS or space.flows.modal[0, entered.flow] == 0
        push(space.pool, (space.queues.short if short else space.queues.span) + entered.group, slot)


@inlined_part
def _go_on(space: Workspace, slot: int, time: float) -> None:
    """Go on in a phase where another piece of the load begins.

    There the torque that locks the flanks may jump or bend, and be least: a miss that no step sees.
    """
    system, row, inputs = system_of(space, slot), space.runs[slot], space.inputs[slot]
    x, lashes = space.state[slot, : system.lashes.shape[1]], lashes_of(system)
    row.rolled += take_rolling(system, x)
    at = Moment(system, time, x, inputs, log_of(space, slot))
    if frictions_of(system) > 0 and not room_for_a_switch(at, row.count):
        _end(space, slot, _EVENT_BUFFER_FULL, time)
        return
    numbers = space.numbers[slot, space.behind :]
    zero_guard = int(numbers[rows.ZERO_GUARD]) if numbers[rows.ZERO_ORDER] > 0.0 else -1
    entry = Entry(row.count, row.regime, zero_guard, int(numbers[rows.ZERO_ORDER]))
    if system.impulsive != 0:
        set_torque(system, space.loads[row.load], row.piece, time, inputs)
        for lash in range(lashes):
            space.held[lash, 0], space.held[lash, 1], _ = holding_torque(at, row.regime, lash)
    _enter(space, slot, time, x, entry)
    for lash in range(lashes if system.impulsive != 0 else 0):
        contact, own = system.contacts[row.regime, lash], space.numbers[slot, lash_at(space, lash) :]
        scale = own[rows.SCALE]
        if contact.closed == 0 or not scale > 0.0:
            continue
        torque, slope = space.held[lash, 0], space.held[lash, 1]
        torque_after, slope_after, _ = holding_torque(at, row.regime, lash)
        jump, rounding = contact.side * (torque_after - torque), GRAZING * scale
        falls = contact.side * slope < 0.0 or jump < -rounding
        rises = contact.side * slope_after > 0.0 or jump > rounding
        least = min(contact.side * torque, contact.side * torque_after) / scale
        if falls and rises and 0.0 <= least < abs(own[rows.MARGIN]):
            own[rows.MARGIN] = least


@inlined_part
def _end(space: Workspace, slot: int, status: int, time: float) -> None:
    """End a run."""
    row = space.runs[slot]
    row.status, row.time = status, time
    for lash in range(lashes_of(space.system)):
        space.margins[slot, lash] = space.numbers[slot, lash_at(space, lash) + rows.MARGIN]
    _close_phase(space, slot)
    push(space.pool, space.queues.over, slot)


@inlined_part
def _close_phase(space: Workspace, slot: int) -> None:
    """Write the extremes of the accelerations in the windows so far to the event that began a run's phase."""
    last = space.runs[slot].count - 1
    for lash in range(lashes_of(space.system)):
        own = space.numbers[slot, lash_at(space, lash) :]
        space.extremes[slot, last, lash, 0] = own[rows.WINDOW_MAX]
        space.extremes[slot, last, lash, 1] = own[rows.WINDOW_MIN]


@inlined_part
def _forget_phase(space: Workspace, slot: int) -> None:
    """Forget the extremes of a phase that lasted no time."""
    for lash in range(lashes_of(space.system)):
        course, own = space.courses[slot, lash], space.numbers[slot, lash_at(space, lash) :]
        own[rows.WINDOW_MAX], own[rows.WINDOW_MIN] = course.window_max, course.window_min


@inlined_part
def _switch(space: Workspace, slot: int) -> None:
    """A guard turned negative: take what that says of the run's margin, and enter the regime that follows."""
    system, row, inputs, log = system_of(space, slot), space.runs[slot], space.inputs[slot], log_of(space, slot)
    numbers = space.numbers[slot, space.behind :]
    x, time, total = space.state[slot, : system.lashes.shape[1]], row.time + numbers[rows.ELAPSED], 0.0
    row.rolled += take_rolling(system, x)
    for k in range(x.size):
        total += abs(x[k])
    if not np.isfinite(total):
        _end(space, slot, _NON_FINITE, time)
        return
    at = Moment(system, time, x, inputs, log)
    if not room_for_a_switch(at, row.count) or row.stages > MOST_STAGES:
        _end(space, slot, _EVENT_BUFFER_FULL, time)
        return
    if system.ramps != 0:
        set_torque(system, space.loads[row.load], row.piece, time, inputs)
    _take_margin(space, slot, x, time)
    if elements_of(system) > 1 and time - log.events[row.count - 1].time < INSTANT:
        _forget_phase(space, slot)
    entry = switch(at, row.regime, row.guard, row.count, space.fastest[slot])
    if entry.written == row.count:  # a stage that is not written: the phase goes on
        row.stages += 1
    else:
        _close_phase(space, slot)
    _take_events(space, slot, row.count, entry.written)
    _enter(space, slot, time, x, entry)


@inlined_part
def _take_events(space: Workspace, slot: int, first: int, written: int) -> None:
    """Take what events from the first up to those written say of their lashes' contacts and windows."""
    system, log = system_of(space, slot), log_of(space, slot)
    roll_states(system, space.runs[slot].rolled, log, first, written)
    for k in range(first, written):
        event = log.events[k]
        if event.lash < 0:
            continue
        lash = event.lash
        course = space.courses[slot, lash]
        if event.kind == TOUCH:
            if event.side != course.last_side or course.from_sticking != 0:
                # a primary impact, by the rule of `sequence.find_primaries`: its window is empty, anything counts
                own = space.numbers[slot, lash_at(space, lash) :]
                own[rows.WINDOW_MAX], own[rows.WINDOW_MIN] = -np.inf, np.inf
            course.last_side, course.contact_began, course.from_sticking = event.side, event.time, 0
        elif event.kind == LOCK:
            course.contact_began = event.time
        elif event.kind == SEPARATION:
            course.from_sticking = int(event.time - course.contact_began > system.sticking_time[lash])


@inlined_part
def _take_margin(space: Workspace, slot: int, x: FloatArray, time: float) -> None:
    """Take what an event at state `x` says of the margin of its lash."""
    system, row = system_of(space, slot), space.runs[slot]
    guard, lash = system.guards[row.regime, row.guard], lash_of(system, row.regime, row.guard)
    if guard.event_kind != SEPARATION and guard.event_kind != REJOIN:
        return
    course, own = space.courses[slot, lash], space.numbers[slot, lash_at(space, lash) :]
    margin = own[rows.MARGIN]
    age, sticking_time = time - course.contact_began, system.sticking_time[lash]
    if guard.event_kind == SEPARATION and abs(age - sticking_time) < abs(margin) * sticking_time:
        margin = 1.0 - age / sticking_time
    if guard.event_kind == REJOIN and age > sticking_time and course.static > 0.0:
        # the overlap is least here or soon after: a near miss; where it is all but zero, rounding decides what follows
        overlap = max(_overlap(system, lash, guard.side, x, space.inputs[slot]), 0.0)
        if overlap / course.static < abs(margin):
            margin = overlap / course.static
    own[rows.MARGIN] = margin


@part
def _set_static(space: Workspace, slot: int, start: Start) -> None:
    """Set `static`: how far flanks overlap, or the torque that locks them, in steady motion at the load's end.

    Where there is none, it is that before the load step; without a flank it is zero. The run's state is overwritten.
    """
    system, inputs = system_of(space, slot), space.inputs[slot]
    x, torque, rate = space.state[slot, : system.lashes.shape[1]], inputs[TORQUE], inputs[TORQUE_RATE]
    inputs[TORQUE], inputs[TORQUE_RATE] = start.loads[start.load, -1, LEVEL], 0.0
    status, regime = preload(system, inputs, x)
    if status != _OK:
        inputs[TORQUE] = start.before[TORQUE]
        status, regime = preload(system, inputs, x)
    for lash in range(lashes_of(system)):
        side = system.contacts[regime, lash].side
        if system.impulsive != 0:
            static = side * holding_torque(Moment(system, 0.0, x, inputs, log_of(space, slot)), regime, lash)[0]
        else:
            static = _overlap(system, lash, side, x, inputs)
        space.courses[slot, lash].static = max(static, 0.0) if status == _OK else 0.0
    inputs[TORQUE], inputs[TORQUE_RATE] = torque, rate


@inlined_part
def _overlap(system: System, lash: int, side: int, x: FloatArray, inputs: FloatArray) -> float:
    """How far the flanks of a lash overlap on one side  [rad]."""
    overlap = -inputs[gap_input(lash)]
    for k in range(x.size):
        overlap += side * system.functionals[0, lash * system.functionals_per_lash + GAP, k] * x[k]
    return float(overlap)
