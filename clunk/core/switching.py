"""The preload before the load step, and at each event the switch from one regime to the next.

Events are not detected here: the method that advances the state finds which guard turned negative, and when.
"""

import numpy as np

from clunk.core import rigid, rubbing
from clunk.core.arrays import FloatArray
from clunk.core.events import INSTANT, LOAD_STEP, SEPARATION, STAGE, TOUCH
from clunk.core.jit import compiled, inlined_part, part
from clunk.core.references import refer
from clunk.core.regimes import System, guard_of, lash_of, speed_of, turn_back
from clunk.core.runs import Entry, Log, Moment, Start, go_on, record
from clunk.core.status import NO_EQUILIBRIUM, NO_INITIAL_FLANK, OK
from clunk.core.sums import copy
from clunk.core.tables import BEYOND, OPEN, TORQUE

# rad/s and rad/(N m), highest speed of a part in steady motion, and largest angle (less the rolling) for each N m of a
# load of 1 N m or more: above these, rounding leaves twists too few digits
_FASTEST, _FARTHEST = 1e7, 1e6
MOST_STAGES = 100_000  # most changes of stage, and of what sticks, in a run: only a run that never settles has more


@inlined_part
def set_weighed(system: System, regime: int, inputs: FloatArray, u: FloatArray) -> None:
    """Set `u`, the inputs of a regime, to the inputs of a run times the regime's weights."""
    for k in range(u.size):
        u[k] = system.weights[regime, k] * inputs[k]


@compiled
def preload(system: System, inputs: FloatArray, x: FloatArray) -> tuple[int, int]:
    """Set `x` to steady motion in contact; return the status and the regime.

    The initial flanks are those that press on each other in steady motion. The regime returned has all lashes closed,
    on the flanks that press, and stages that contain the shafts' steady twists; there is at most one such regime, as no
    stiffness is negative. Regimes in which a friction slips are not tried; their numbers come after those in which all
    frictions stick.

    Parameters
    ----------
    inputs : (INPUTS + L - 1 or more,) float64
        d before the load step  [N m, rad, N m/s, rad].
    x : (N,) float64  [rad, rad/s]
        Output if the status is OK; otherwise it may be overwritten.
    """
    system = refer(system)
    lashes, stages = system.lash_count, system.steady_motion.shape[0]
    status = NO_INITIAL_FLANK if stages == 1 else NO_EQUILIBRIUM
    for regime in range(stages * system.regime_strides[lashes]):
        stage, closed, presses = regime // system.regime_strides[lashes], True, True
        for lash in range(lashes):
            contact, torque = system.contacts[regime, lash], steady_torque(system, regime, lash, inputs)
            closed, presses = closed and contact.closed != 0, presses and contact.side * torque > 0.0
        if not closed or (not presses and status == NO_INITIAL_FLANK):
            continue
        is_lost, farthest = False, _FARTHEST * max(1.0, abs(inputs[TORQUE]))
        for k in range(x.size):
            x[k] = _of_inputs(system, regime, system.steady_motion[stage, k], inputs)
            is_lost = is_lost or not abs(x[k]) <= (_FASTEST if k >= system.inertias else farthest)
        is_in_stage, is_beside_loose = _is_in_stage(system, regime, x)
        if not is_in_stage:
            continue
        if is_beside_loose or is_lost:
            return NO_EQUILIBRIUM, OPEN
        if presses:
            return OK, regime
        status = NO_INITIAL_FLANK
    return status, OPEN


@inlined_part
def steady_torque(system: System, regime: int, lash: int, inputs: FloatArray) -> float:
    """Torque across a closed lash, and any friction beside it, in the steady motion of a regime  [N m]."""
    stage = regime // system.regime_strides[system.lash_count]
    return _of_inputs(system, regime, system.contact_torque[stage, lash], inputs)


@inlined_part
def _of_inputs(system: System, regime: int, by: FloatArray, inputs: FloatArray) -> float:
    """Sum of a run's inputs, each times its weight in a regime and its factor in `by`; inputs left out are 1."""
    total = by[0] * inputs[0]
    for k in range(1, system.input_count):
        total += by[k] * (system.weights[regime, k] * (inputs[k] if k < inputs.size else 1.0))
    return total


@part
def _is_in_stage(system: System, regime: int, x: FloatArray) -> tuple[bool, bool]:
    """Whether the staged shafts' twists lie, but for rounding, within a regime's stages, and whether one is loose.

    A twist is loose at a breakpoint beyond which its shaft has no stiffness that would determine it.
    """
    is_beside_loose = False
    for g in range(system.regimes[regime].guards):
        guard = system.guards[regime, g]
        if guard.event_kind == STAGE and guard.successor >= 0:  # a friction's guards have no successor
            value = -BEYOND
            for k in range(system.input_count):
                value += system.offsets[regime, g, k]
            scale = abs(value)  # the value so far is the breakpoint, or minus that
            for k in range(x.size):
                term = guard.sign * system.functionals[0, guard.functional, k] * x[k]
                value += term
                scale += abs(term)
            is_at_breakpoint = abs(value) <= rubbing.WITHIN * scale
            if not (is_at_breakpoint or value >= 0.0):  # also NaN, where no stiffness determines the twist
                return False, False
            behind = system.steady_motion[guard.successor // system.regime_strides[system.lash_count], 0, TORQUE]
            is_beside_loose = is_beside_loose or (is_at_breakpoint and np.isnan(behind))
    return True, is_beside_loose


@inlined_part
def begin_run(system: System, start: Start, inputs: FloatArray, log: Log) -> tuple[int, float]:
    """Set state and inputs of a run to those at the load step, and write the load step as event 0.

    Returns the piece of the load, and the angle of the first inertia that rolls, by which the state is turned back
    [rad].

    inputs : output, but for those that are always 1, which have to be set before
    """
    load, contacts = start.loads[start.load], system.contacts[start.regime]
    for lash in range(system.lash_count):
        course = log.courses[lash]
        course.last_side, course.contact_began, course.from_sticking = contacts[lash].side, -np.inf, 0
        course.fastest, course.margin, course.least = 0.0, np.inf, np.nan
    copy(start.before, inputs)
    rubbing.stick_all(system, start.x, inputs)
    piece = go_on(system, load, -1, 0.0, start.x, inputs)  # -1: no piece has begun before
    at = Moment(system, 0.0, start.x, inputs, rubbing.WITHIN, rubbing.OF_STEPS)
    record(at, log, 0, 0.0, LOAD_STEP, start.regime, -1, contacts[0].side)
    return piece, turn_back(system, start.x)


@inlined_part
def may_switch(system: System, log: Log, count: int, stages: int) -> bool:
    """Whether the event buffer has room for one more switch, and `stages` is at most MOST_STAGES.

    A switch may write one event, a separation, a touch and a lock of each rigid lash, and a change of what sticks; see
    `tile.capacity_of`.

    stages : changes of stage, and of what sticks, that were not written
    """
    return count + 2 + 3 * system.lash_count <= log.events.size and stages <= MOST_STAGES


@inlined_part
def is_instant(at: Moment, log: Log, count: int) -> bool:
    """Whether the phase after the last of `count` events is shorter than INSTANT, so that its extremes do not count."""
    return at.system.element_count > 1 and at.time - log.events[count - 1].time < INSTANT


@inlined_part
def chooses(system: System, regime: int, guard: int) -> bool:
    """Whether `rubbing.choose_states` chooses the regime that follows a guard, so that no `recheck` is needed."""
    row = system.guards[regime, guard]
    return row.successor < 0 or (system.impulsive != 0 and row.event_kind == SEPARATION)


@inlined_part
def switch(at: Moment, log: Log, regime: int, guard: int, count: int) -> Entry:
    """Leave a regime by one of its guards: record the event, and return the entry into the next regime.

    A touch of rigid flanks, and a choice among elements at rest, may change the state.

    Parameters
    ----------
    count : int
        Events written so far.
    """
    system, row, lash = at.system, at.system.guards[regime, guard], lash_of(at.system, regime, guard)
    speed, entry = 0.0, Entry(count, row.successor, row.zero_guard, row.zero_order)
    if lash >= 0:
        speed = speed_of(system, lash, at.x)
        if system.impulsive and row.event_kind == TOUCH:
            return rigid.strike(at, log, regime, guard, speed, count)
    is_chosen = chooses(system, regime, guard)
    if is_chosen:
        entry = rigid.enter_chosen(at, log, regime, guard, 0, count)
    is_written = log.states.shape[0] > 0 if lash < 0 else not is_chosen
    if is_written and entry.written == count:
        record(at, log, count, speed, row.event_kind, entry.regime, lash, row.side)
        return Entry(count + 1, entry.regime, entry.zero_guard, entry.zero_order)
    return entry


@inlined_part
def recheck(at: Moment, log: Log, entry: Entry, jumps: bool) -> Entry:
    """Entry into the regime in which no friction sticks, and no flanks are locked, that torques no longer hold.

    Torques, or their rates of change, may have jumped. State and inputs may change, and events be written, as at a
    switch. Without frictions, a regime is rechecked only where the load `jumps`, or its rate of change, and several
    lashes have rigid flanks: elsewhere the guards suffice.
    """
    if not (at.system.friction_count or (jumps and at.system.impulsive and at.system.lash_count > 1)):
        return entry
    settled = rigid.enter_chosen(at, log, entry.regime, -1, 0, entry.written)
    if entry.zero_guard < 0:
        return settled
    before = at.system.guards[entry.regime, entry.zero_guard]
    # the guard may have another number in the regime entered: an open lash has more guards than a closed one
    zero = guard_of(at.system, settled.regime, before.functional, before.sign)
    return Entry(settled.written, settled.regime, zero, entry.zero_order)
