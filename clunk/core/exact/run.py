"""The exact method: runs follow the modes of each regime, over spans within which no guard turns negative.

The length of a span is an estimate, and the span counts only if it is then proved that no guard turned negative within
it: from the guard's value, slope and curvature at both ends of the span, and a bound of its sixth derivative. Where not
even the shortest span can be expected to pass this proof, the guard is expanded over it into its Taylor series, exact
to rounding; the first zero of the series, if it has one, is the event. So, to rounding, no event of this model is
skipped.

The extremes of the acceleration, which make the severity, are located by the same means wherever the acceleration could
exceed the extremes of its window so far; and so are the near misses that make the margin of a run, see `margins`.

A run is a row of `Workspace.numbers`. It waits in a queue until `advance` takes it, together with others in the same
group of regimes, for a step side by side. A run that cannot just take its next step (after an event, at the end of the
run or of the load's piece, after searches) goes through `_follow`.
"""

import numpy as np

from clunk.core.arrays import FloatArray, StopFlag
from clunk.core.events import INSTANT
from clunk.core.exact import functionals, moving, rows
from clunk.core.exact.margins import (
    MOST,
    note_holding,
    note_impacts,
    set_static,
    take_margin_of_event,
    take_margins_of_load,
)
from clunk.core.exact.search import search
from clunk.core.exact.step import take_step
from clunk.core.exact.workspace import Workspace, log_of, system_at, system_of
from clunk.core.jit import inlined_part, part
from clunk.core.lanes.pool import push, put_back, take
from clunk.core.lanes.vectors import WIDTH
from clunk.core.regimes import gap_input, roll, turn_back
from clunk.core.rubbing import OF_MODES, WITHIN, tolerance_after
from clunk.core.runs import (
    Entry,
    Moment,
    Start,
    begin_windows,
    end_of_piece,
    go_on,
    roll_states,
    set_torque,
)
from clunk.core.status import EVENT_BUFFER_FULL, NON_FINITE, OK, QUALITY_COMPLETE
from clunk.core.sums import copy, weigh
from clunk.core.switching import begin_run, chooses, is_instant, may_switch, recheck, set_weighed, switch


@inlined_part
def begin(space: Workspace, slot: int, driveline: int, start: Start) -> None:
    """Begin a run of a driveline, in an empty slot of a workspace."""
    row, system = space.runs[slot], system_at(space, driveline)
    row.driveline, row.status, row.quality, row.stages, row.searches = driveline, OK, 0, 0, 0
    row.load, row.ended = start.load, rows.GOES_ON
    row.piece, row.rolled = begin_run(system, start, space.inputs[slot], log_of(space, slot))
    for lash in range(system.lash_count):
        space.of_lashes[slot, lash, rows.MARGIN] = MOST
    _open_windows(space, slot, 0)
    set_static(space, slot, start)
    _enter(space, slot, 0.0, start.x, Entry(1, start.regime, -1, 0))


@inlined_part
def _enter(space: Workspace, slot: int, time: float, x: FloatArray, entry: Entry) -> None:
    """Begin a stretch in a regime, entered or kept: set state, inputs and guards' shifts, and put the run in a queue.

    The load goes on to the piece that it has at this time. Frictions that can no longer stick then begin to slip, and
    rigid flanks that a jump of the load pulls apart separate; both are events. Neither is checked where the event that
    led here has just chosen the states of all frictions and flanks at rest.
    """
    system, row, inputs = system_of(space, slot), space.runs[slot], space.inputs[slot]
    numbers, load, jumps = space.fields[slot], space.loads[row.load], row.ended != rows.BY_EVENT
    row.piece = go_on(system, load, row.piece, time, x, inputs)
    numbers[rows.LIMIT] = end_of_piece(system, load, row.piece) - time
    numbers[rows.KINK] = row.piece + 1 < load.shape[0]
    if jumps or not chooses(system, row.regime, row.guard):
        row.count = entry.written
        entry = recheck(Moment(system, time, x, inputs, WITHIN, OF_MODES), log_of(space, slot), entry, jumps)
        _take_events(space, slot, entry.written)
    regime = entry.regime
    row.time, row.count, row.regime = time, entry.written, regime
    row.rolled += turn_back(system, x)  # not zero if rigid flanks were just moved
    copy(x, space.numbers[slot])  # a state for now; `moving.to_coordinates` makes coordinates of it
    if system.first_rolling >= 0:
        speeds = space.numbers[slot, system.inertias :]
        speeds[system.first_rolling] = turn_back(system, speeds)
    numbers[rows.ELAPSED], numbers[rows.TRY] = 0.0, np.inf
    numbers[rows.ZERO_GUARD], numbers[rows.ZERO_ORDER] = entry.zero_guard, entry.zero_order
    entered = system.regimes[regime]
    set_weighed(system, regime, inputs, space.weighed[slot])
    for lash in range(system.lash_count):
        contact, course = system.contacts[regime, lash], space.courses[slot, lash]
        lash_fields = space.of_lashes[slot, lash]
        held_from = course.contact_began + system.sticking_time[lash] - time
        mirrored = contact.side * system.contacts[system.leaders[entered.group], lash].side < 0
        lash_fields[rows.HELD_FROM] = held_from if contact.closed else -np.inf
        lash_fields[rows.SIDE] = -1.0 if mirrored else 1.0
        # margins are shares of the whole gap between the flanks or, in contact, of the overlap or torque at rest
        lash_fields[rows.SCALE] = course.static if contact.side else 2.0 * inputs[gap_input(lash)]
    for n in range(entered.watched):
        numbers[rows.shift(n, system.lash_count)] = weigh(system.offsets[regime, n], inputs)
    push(space.pool, space.queues.enter + entered.group, slot)


@part
def advance(space: Workspace, stop: StopFlag) -> None:
    """Take steps until at least as many runs are over as there are lanes, or no run is left, or `stop` is set.

    Runs that are over wait in the queue `over`. Steps are taken from one queue as long as it fills the lanes, and then
    from the longest one.
    """
    pool, queues, queue = space.pool, space.queues, space.queues.span
    while pool.length[queues.over] < WIDTH and not stop[0]:
        if pool.length[queue] < WIDTH:
            for other in range(queues.over):
                queue = other if pool.length[other] > pool.length[queue] else queue
            if not pool.length[queue]:
                break
        if queue < queues.search:
            count, group = take(pool, queue, space.numbers), queue % space.system.leaders.size
            short, flow = queues.short <= queue < queues.enter, space.system.regimes[space.system.leaders[group]].flow
            if space.mixed:
                functionals.gather_tables(space, flow, 1)
            if queue >= queues.enter:  # entered, the runs take their first step at once
                moving.to_coordinates(space, flow)
                put_back(pool, pool.work, space.numbers, space.behind, (1 << count) - 1)
                short = space.flows.modal[0, flow] == 0
            take_step(space, group, short, count)
        else:
            count = take(pool, queue, space.searches)
            flow, functional = divmod(queue - queues.search, space.flows.watch.shape[2])
            if space.mixed:
                functionals.gather_tables(space, flow, space.searches_each)
            search(space, flow, functional, queue, count)
        for k in range(pool.length[queues.follow]):
            _follow(space, pool.waiting[queues.follow, k])
        pool.length[queues.follow] = 0


@inlined_part
def _follow(space: Workspace, slot: int) -> None:
    """Decide how a run goes on after a step: end its stretch, queue its next step, or end the run."""
    row, system = space.runs[slot], system_of(space, slot)
    now = row.time + space.fields[slot, rows.ELAPSED]
    if row.ended in (rows.BY_EVENT, rows.AT_END):
        end = end_of_piece(system, space.loads[row.load], row.piece)
        if end - now < INSTANT and end < system.end_time[0]:
            row.ended = rows.AT_END  # whether the event happens depends on the next piece
        if row.ended == rows.AT_END:
            now = end
    if row.ended == rows.BY_EVENT or (row.ended == rows.AT_END and now < system.end_time[0]):
        _end_stretch(space, slot, now)
    elif row.ended in (rows.GOES_ON, rows.NEARS):
        queue = space.queues.short if row.ended == rows.NEARS else space.queues.span
        push(space.pool, queue + system.regimes[row.regime].group, slot)
    else:
        row.quality |= QUALITY_COMPLETE if row.ended == rows.SETTLED else 0
        _end(space, slot, NON_FINITE if row.ended == rows.LOST else OK, now)


@inlined_part
def _end_stretch(space: Workspace, slot: int, time: float) -> None:
    """End a stretch, by an event or where another piece of the load begins, and begin the next one."""
    system, row = system_of(space, slot), space.runs[slot]
    x, by_event, total = space.state[slot, : system.lashes.shape[1]], row.ended == rows.BY_EVENT, 0.0
    at = Moment(system, time, x, space.inputs[slot], tolerance_after(time - row.time), OF_MODES)
    log = log_of(space, slot)
    if system.first_rolling >= 0:
        first, speeds = system.first_rolling, x[system.inertias :]
        row.rolled += x[first]
        speed, x[first], speeds[first] = speeds[first], 0.0, 0.0
        roll(system, speed, speeds)
    for k in range(x.size):
        total += abs(x[k])
    if not np.isfinite(total):
        _end(space, slot, NON_FINITE, time)
        return
    if not may_switch(system, log, row.count, row.stages):
        _end(space, slot, EVENT_BUFFER_FULL, time)
        return
    set_torque(system, space.loads[row.load], row.piece, time, at.inputs)
    if by_event:
        take_margin_of_event(space, slot, at)
        if is_instant(at, log, row.count):
            _open_windows(space, slot, row.count - 1)
        entry = switch(at, log, row.regime, row.guard, row.count)
        row.stages += entry.written == row.count  # a change of stage that is not written as an event
        note_impacts(space, slot, at, entry)
        _take_events(space, slot, entry.written)
    else:
        numbers = space.fields[slot]
        order = int(numbers[rows.ZERO_ORDER])
        entry = Entry(row.count, row.regime, int(numbers[rows.ZERO_GUARD]) if order > 0 else -1, order)
        note_holding(space, slot, at)
    _enter(space, slot, time, x, entry)
    if not by_event:
        take_margins_of_load(space, slot, at)


@inlined_part
def _end(space: Workspace, slot: int, status: int, time: float) -> None:
    """End a run."""
    row = space.runs[slot]
    row.status, row.time = status, time
    for lash in range(space.system.lash_count):
        space.courses[slot, lash].least = space.of_lashes[slot, lash, rows.MARGIN]
    _close_phase(space, slot, row.count - 1)
    push(space.pool, space.queues.over, slot)


@inlined_part
def _open_windows(space: Workspace, slot: int, k: int) -> None:
    """Set the windows of a run to what they are as the phase of event `k` begins, see `runs.begin_windows`."""
    begin_windows(log_of(space, slot), k)
    for lash in range(space.system.lash_count):
        copy(space.extremes[slot, k, lash], space.of_lashes[slot, lash])  # WINDOW_MAX and WINDOW_MIN


@inlined_part
def _close_phase(space: Workspace, slot: int, k: int) -> None:
    """Write the extremes that a run's windows hold so far beside event `k`, which began the phase that ends."""
    for lash in range(space.system.lash_count):
        copy(space.of_lashes[slot, lash, :2], space.extremes[slot, k, lash])  # WINDOW_MAX and WINDOW_MIN


@inlined_part
def _take_events(space: Workspace, slot: int, written: int) -> None:
    """Take in the events of a run from `count` on that have just been written, `written` in all.

    Turns the states kept at them by what the run has rolled by, ends the phase before each, and sets the windows after.
    """
    row, log = space.runs[slot], log_of(space, slot)
    roll_states(system_of(space, slot), row.rolled, log, row.count, written)
    for k in range(row.count, written):
        _close_phase(space, slot, k - 1)
        _open_windows(space, slot, k)
