"""The margin of a run: how near each of its lashes came to another label, by the exact method.

It is the smallest in size of

- positive, what did not happen: the distance to a flank where the gap coordinate turned back, as a share of the whole
  gap; where a contact held, later than the sticking time, the least overlap of the flanks (restitution: the least
  torque that locks them), as a share of its value at rest; and where rigid flanks rebound, and touch again on the same
  side, the larger of their speed, as a share of the fastest touch's, and of that torque, likewise;
- negative, what did: how much further a primary touch, or the end of a sticking contact, would have gone, were the
  contact not to change; where rigid flanks lock, and touch again on the same side, the torque that locks them;
- of either sign: 1 - (length of a contact)/(sticking time), at each separation; and the torque in contact before the
  load step, as a share of the one at rest at the load's end.

The turns of guards, and how deep they would go, `search` finds within a step.
"""

from clunk.core.arrays import FloatArray
from clunk.core.events import OPENING, REJOIN, SEPARATION, TOUCH
from clunk.core.exact import rows
from clunk.core.exact.workspace import GRAZING, Workspace, system_of
from clunk.core.jit import inlined_part, part
from clunk.core.regimes import lash_of, overlap_of
from clunk.core.rubbing import holding_torque
from clunk.core.runs import LEVEL, Entry, Moment, Start
from clunk.core.sequence import is_primary
from clunk.core.status import OK, QUALITY_GRAZING
from clunk.core.switching import preload, steady_torque
from clunk.core.tables import TORQUE, TORQUE_RATE

MOST = 0.25  # larger margins are not looked for, and written as this


@inlined_part
def _take(own: FloatArray, margin: float) -> None:
    """Take a margin of a lash, whose numbers are `own`, where it is the smallest so far; NaN is none."""
    if abs(margin) < abs(own[rows.MARGIN]):
        own[rows.MARGIN] = margin


@part
def set_static(space: Workspace, slot: int, start: Start) -> None:
    """Set `static`: how far flanks overlap, or the torque that locks them, in steady motion at the load's end.

    Where there is none, it is that before the load step; without a flank it is zero. The run's state is overwritten.
    Takes the margin of the initial flanks.
    """
    system, inputs = system_of(space, slot), space.inputs[slot]
    x = space.state[slot, : system.lashes.shape[1]]
    inputs[TORQUE], inputs[TORQUE_RATE] = start.loads[start.load, -1, LEVEL], 0.0
    status, regime = preload(system, inputs, x)
    if status != OK:
        inputs[TORQUE] = start.before[TORQUE]
        status, regime = preload(system, inputs, x)
    for lash in range(system.lash_count):
        side = system.contacts[regime, lash].side
        torque = steady_torque(system, regime, lash, inputs)
        static = side * torque if system.impulsive else overlap_of(system, lash, side, x, inputs)
        own = space.of_lashes[slot, lash]
        _take(own, steady_torque(system, start.regime, lash, start.before) / torque)
        space.courses[slot, lash].static = max(static, 0.0) if status == OK else 0.0


@inlined_part
def take_margin_of_event(space: Workspace, slot: int, at: Moment) -> None:
    """Take what the event that ended a run's phase says of the margin of its lash."""
    system, row = at.system, space.runs[slot]
    guard, lash = system.guards[row.regime, row.guard], lash_of(system, row.regime, row.guard)
    course, own = space.courses[slot, lash], space.of_lashes[slot, lash]
    if guard.event_kind == TOUCH and guard.side == course.last_side:
        _take(own, course.margin)
    elif guard.event_kind == SEPARATION:
        _take(own, 1.0 - (at.time - course.contact_began) / system.sticking_time[lash])
    elif guard.event_kind == REJOIN and at.time - course.contact_began > system.sticking_time[lash]:
        # the overlap is least here or soon after: a near miss; where it is all but zero, rounding decides what follows
        _take(own, max(overlap_of(system, lash, guard.side, at.x, at.inputs), 0.0) / course.static)


@inlined_part
def note_impacts(space: Workspace, slot: int, at: Moment, entry: Entry) -> None:
    """Note how near rigid flanks that have just touched are to locking, or to not doing so: COURSE's `margin`.

    Between flanks that lock and those that rebound until they part lies a touch after which they are as slow, and as
    slightly held, as at a lock.
    """
    system, row = at.system, space.runs[slot]
    if not system.impulsive or system.guards[row.regime, row.guard].event_kind != TOUCH:
        return
    for n in range(row.count, entry.written):
        event = space.events[slot, n]
        lash = event.lash
        if event.kind == TOUCH:
            course = space.courses[slot, lash]
            speed = system.restitution[lash] * abs(event.speed) / course.fastest
            torque = abs(holding_torque(at, entry.regime, lash)[0]) / course.static
            course.margin = -torque if system.contacts[entry.regime, lash].closed else max(speed, torque)


@inlined_part
def note_holding(space: Workspace, slot: int, at: Moment) -> None:
    """Note the torques that lock rigid flanks, and their rates of change, before another piece of the load begins."""
    for lash in range(at.system.lash_count * at.system.impulsive):
        space.held[lash, 0], _, space.held[lash, 1], _ = holding_torque(at, space.runs[slot].regime, lash)


@inlined_part
def take_margins_of_load(space: Workspace, slot: int, at: Moment) -> None:
    """Take the margins of rigid flanks in contact where another piece of the load has begun.

    There the torque that locks them may jump or bend, and be least: a miss that no step sees.
    """
    system, regime = at.system, space.runs[slot].regime
    for lash in range(system.lash_count * system.impulsive):
        side, own = system.contacts[regime, lash].side, space.of_lashes[slot, lash]
        before, slope = side * space.held[lash, 0], side * space.held[lash, 1]
        after, _, slope_after, _ = holding_torque(at, regime, lash)
        jump, rounding = side * after - before, GRAZING * own[rows.SCALE]
        falls = slope < 0.0 or jump < -rounding
        rises = side * slope_after > 0.0 or jump > rounding
        least = min(before, side * after) / own[rows.SCALE]
        if falls and rises and least >= 0.0:
            _take(own, least)


@inlined_part
def label_hangs_on_depth(space: Workspace, slot: int, n: int) -> bool:
    """Whether a label hangs on how deep the guard goes that ended a run's phase."""
    system, row = system_of(space, slot), space.runs[slot]
    guard, lash = system.guards[row.regime, n], lash_of(system, row.regime, n)
    course, now = space.courses[slot, lash], row.time + space.fields[slot, rows.ELAPSED]
    if guard.event_kind == TOUCH:
        return is_primary(guard.side, course.last_side, course.from_sticking != 0)
    if guard.event_kind == OPENING:  # by force: it counts after a contact that held
        return course.from_sticking != 0
    return guard.event_kind == SEPARATION and now - course.contact_began > system.sticking_time[lash]


@inlined_part
def take_margin_of_guard(space: Workspace, slot: int, guard: int, turn: float, deep: bool) -> None:
    """Take what a search found: the lowest turn of a guard of a run, or how deep the guard of its event would go."""
    run = space.runs[slot]
    own = space.of_lashes[slot, lash_of(space.system, run.regime, guard)]
    scale = own[rows.SCALE]
    if abs(turn) < abs(own[rows.MARGIN]) * scale:
        margin = (min(turn, 0.0) if deep else max(turn, 0.0)) / scale
        own[rows.MARGIN] = margin
        if not deep and margin <= GRAZING:
            run.quality |= QUALITY_GRAZING
