"""The margin of a run: how near each of its lashes came to another label, by the exact method.

The margin of a lash is the number of the smallest magnitude among these, all without unit:

- positive, for what did not happen: the distance to a flank where the gap coordinate turned back, as a share of the
  whole gap; the least overlap of flanks that have been in contact for longer than the sticking time (restitution: the
  least torque that locks them), as a share of its value at rest; and where rigid flanks rebound, and touch again on the
  same side, the larger of two shares: the speed of the rebound, as a share of the fastest touch's, and the torque that
  would lock them, as a share of its value at rest;
- negative, for what did happen: how much deeper the guard of a primary touch, or of the end of a sticking contact,
  would have gone if the contact had not changed, as a share of the same gap or value at rest; where rigid flanks lock,
  and touch again on the same side, the torque that locks them, as a share of its value at rest;
- of either sign: 1 - (length of a contact)/(sticking time), at each separation; and the torque in contact before the
  load step, as a share of the one at rest at the load's end.

How low guards turn within a step, and how deep they would go beyond it, is located by `search`.
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

MOST = 0.25  # larger margins are not looked for, and are written as this one


@inlined_part
def _take(lash_fields: FloatArray, margin: float) -> None:
    """Keep a margin of a lash if it is the smallest in magnitude so far; NaN is ignored.

    lash_fields : the lash's row of `Workspace.of_lashes`
    """
    if abs(margin) < abs(lash_fields[rows.MARGIN]):
        lash_fields[rows.MARGIN] = margin


@part
def set_static(space: Workspace, slot: int, start: Start) -> None:
    """Set `static` of each lash to the overlap of its flanks at rest, or between rigid ones to the torque at rest.

    At rest means in steady motion in contact under the load's last torque or, if there is no such motion, before the
    load step; if there is none either, `static` is zero. Units are rad and N m. Also takes the margin of the torque in
    contact before the load step. Overwrites the run's row of `Workspace.state` and the torque in its inputs.
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
        lash_fields = space.of_lashes[slot, lash]
        _take(lash_fields, steady_torque(system, start.regime, lash, start.before) / torque)
        space.courses[slot, lash].static = max(static, 0.0) if status == OK else 0.0


@inlined_part
def take_margin_of_event(space: Workspace, slot: int, at: Moment) -> None:
    """Take the margin that the event which ended a run's phase gives its lash, if any.

    A touch on the flank touched last gives the margin noted at that touch; a separation, that of the contact's length;
    a rejoin after the sticking time, that of the overlap.
    """
    system, row = at.system, space.runs[slot]
    guard, lash = system.guards[row.regime, row.guard], lash_of(system, row.regime, row.guard)
    course, lash_fields = space.courses[slot, lash], space.of_lashes[slot, lash]
    if guard.event_kind == TOUCH and guard.side == course.last_side:
        _take(lash_fields, course.margin)
    elif guard.event_kind == SEPARATION:
        _take(lash_fields, 1.0 - (at.time - course.contact_began) / system.sticking_time[lash])
    elif guard.event_kind == REJOIN and at.time - course.contact_began > system.sticking_time[lash]:
        # the overlap is least here or soon after: a near miss; where it is all but zero, rounding decides what follows
        _take(lash_fields, max(overlap_of(system, lash, guard.side, at.x, at.inputs), 0.0) / course.static)


@inlined_part
def note_impacts(space: Workspace, slot: int, at: Moment, entry: Entry) -> None:
    """Set COURSE `margin` of rigid flanks that have just touched: how near a rebound is to a lock, or a lock to none.

    On the boundary between runs whose flanks lock and runs whose flanks rebound until they part, the speed after the
    touch is the slowest that rebounds, and the torque that locks the flanks is zero. So the margin of a rebound is the
    larger of its speed and that torque, and the margin of a lock is minus the torque, as shares.
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
    """Note the torques that lock rigid flanks, and their rates of change, before another piece of the load begins.

    They are written to `Workspace.held`, for `take_margins_of_load`.
    """
    for lash in range(at.system.lash_count * at.system.impulsive):
        space.held[lash, 0], _, space.held[lash, 1], _ = holding_torque(at, space.runs[slot].regime, lash)


@inlined_part
def take_margins_of_load(space: Workspace, slot: int, at: Moment) -> None:
    """Take the margins of rigid flanks in contact where another piece of the load has begun.

    The torque that locks them may jump or bend at that time and so be least there: a near miss that no step sees.
    """
    system, regime = at.system, space.runs[slot].regime
    for lash in range(system.lash_count * system.impulsive):
        side, lash_fields = system.contacts[regime, lash].side, space.of_lashes[slot, lash]
        before, slope = side * space.held[lash, 0], side * space.held[lash, 1]
        after, _, slope_after, _ = holding_torque(at, regime, lash)
        jump, rounding = side * after - before, GRAZING * lash_fields[rows.SCALE]
        falls = slope < 0.0 or jump < -rounding
        rises = side * slope_after > 0.0 or jump > rounding
        least = min(before, side * after) / lash_fields[rows.SCALE]
        if falls and rises and least >= 0.0:
            _take(lash_fields, least)


@inlined_part
def label_hangs_on_depth(space: Workspace, slot: int, n: int) -> bool:
    """Whether a label hangs on how deep guard `n`, which ended a run's phase, would go."""
    system, row = system_of(space, slot), space.runs[slot]
    guard, lash = system.guards[row.regime, n], lash_of(system, row.regime, n)
    course, now = space.courses[slot, lash], row.time + space.fields[slot, rows.ELAPSED]
    if guard.event_kind == TOUCH:
        return is_primary(guard.side, course.last_side, course.from_sticking != 0)
    if guard.event_kind == OPENING:  # separation by force: it counts after sticking
        return course.from_sticking != 0
    return guard.event_kind == SEPARATION and now - course.contact_began > system.sticking_time[lash]


@inlined_part
def take_margin_of_guard(space: Workspace, slot: int, guard: int, turn: float, deep: bool) -> None:
    """Take the margin that a search has found for a guard of a run, and flag the run if the guard grazes zero.

    turn : the guard's lowest turning point; if `deep`, the lowest value to which the guard of an event would go
    """
    run = space.runs[slot]
    lash_fields = space.of_lashes[slot, lash_of(space.system, run.regime, guard)]
    scale = lash_fields[rows.SCALE]
    if abs(turn) < abs(lash_fields[rows.MARGIN]) * scale:
        margin = (min(turn, 0.0) if deep else max(turn, 0.0)) / scale
        lash_fields[rows.MARGIN] = margin
        if not deep and margin <= GRAZING:
            run.quality |= QUALITY_GRAZING
