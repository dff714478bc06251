"""The preload before the load step, and at each event the switch from one regime to the next.

Detection is not here: whoever flows through a regime says which guard turned negative, and where.
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

_FASTEST = 1e7  # rad/s, of a part in steady motion: beside such a speed the digits of twists are lost
MOST_STAGES = 100_000  # changes of stage, and of what sticks, of a run: what has more truly runs away


@inlined_part
def set_weighed(system: System, regime: int, inputs: FloatArray, u: FloatArray) -> None:
    """Set `u` to what a regime makes of the inputs of a run."""
    for k in range(u.size):
        u[k] = system.weights[regime, k] * inputs[k]


@compiled
def preload(system: System, inputs: FloatArray, x: FloatArray) -> tuple[int, int]:
    """Set `x` to steady motion in contact; return the status and the regime.

    The initial flanks are those that press in it. Of the regimes in which all lashes are closed it is the one in which
    they do, and within whose stages the shafts' steady twists lie; there is at most one, as no stiffness is
    negative. All frictions stick in these, whose numbers come before those of regimes in which one slips.

    Parameters
    ----------
    inputs : (INPUTS + L - 1 or more,) float64
        d before the load step  [N m, rad, N m/s, rad].
    x : (N,) float64  [rad, rad/s]
        Output, whatever the status.
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
        fastest = 0.0
        for k in range(x.size):
            x[k] = _of_inputs(system, regime, system.steady_motion[stage, k], inputs)
            fastest = max(fastest, abs(x[k])) if k >= system.inertias else 0.0
        is_in_stage, is_beside_loose = _is_in_stage(system, regime, x)
        if not is_in_stage:
            continue
        if is_beside_loose or fastest > _FASTEST:
            return NO_EQUILIBRIUM, OPEN
        if presses:
            return OK, regime
        status = NO_INITIAL_FLANK
    return status, OPEN


@inlined_part
def steady_torque(system: System, regime: int, lash: int, inputs: FloatArray) -> float:
    """The torque across a lash, and what rubs beside it, in steady motion in a regime in which it is closed  [N m]."""
    stage = regime // system.regime_strides[system.lash_count]
    return _of_inputs(system, regime, system.contact_torque[stage, lash], inputs)


@inlined_part
def _of_inputs(system: System, regime: int, by: FloatArray, inputs: FloatArray) -> float:
    """Sum of inputs, each times its weight in a regime and a factor; inputs that are not given are 1."""
    total = by[0] * inputs[0]
    for k in range(1, system.input_count):
        total += by[k] * (system.weights[regime, k] * (inputs[k] if k < inputs.size else 1.0))
    return total


@part
def _is_in_stage(system: System, regime: int, x: FloatArray) -> tuple[bool, bool]:
    """Whether the twists of the staged shafts lie, but for rounding, within the stages of a regime.

    And whether one of them is at a breakpoint behind which no stiffness tells what it is.
    """
    is_beside_loose = False
    for g in range(system.regimes[regime].guards):
        guard = system.guards[regime, g]
        if guard.event_kind == STAGE and guard.successor >= 0:  # what follows where a friction's ends is not known
            value = -BEYOND
            for k in range(system.input_count):
                value += system.offsets[regime, g, k]
            scale = abs(value)  # of the breakpoint, with its sign in the guard
            for k in range(x.size):
                term = guard.sign * system.functionals[0, guard.functional, k] * x[k]
                value += term
                scale += abs(term)
            is_at_breakpoint = abs(value) <= rubbing.WITHIN * scale
            if not (is_at_breakpoint or value >= 0.0):  # NaN where no stiffness tells the twist
                return False, False
            behind = system.steady_motion[guard.successor // system.regime_strides[system.lash_count], 0, TORQUE]
            is_beside_loose = is_beside_loose or (is_at_breakpoint and np.isnan(behind))
    return True, is_beside_loose


@inlined_part
def begin_run(system: System, start: Start, inputs: FloatArray, log: Log) -> tuple[int, float]:
    """Set state and inputs to those at the load step, and write that.

    Returns the piece of the load, and what the run has rolled by  [rad].

    inputs : output; what is no torque, gap or twist of a friction is 1 already
    """
    load, contacts = start.loads[start.load], system.contacts[start.regime]
    for lash in range(system.lash_count):
        course = log.courses[lash]
        course.last_side, course.contact_began, course.from_sticking = contacts[lash].side, -np.inf, 0
        course.fastest, course.margin, course.least = 0.0, np.inf, np.nan
    copy(start.before, inputs)
    rubbing.stick_all(system, start.x, inputs)
    piece = go_on(system, load, -1, 0.0, start.x, inputs)  # none before it
    at = Moment(system, 0.0, start.x, inputs, rubbing.WITHIN, rubbing.OF_STEPS)
    record(at, log, 0, 0.0, LOAD_STEP, start.regime, -1, contacts[0].side)
    return piece, turn_back(system, start.x)


@inlined_part
def may_switch(system: System, log: Log, count: int, stages: int) -> bool:
    """Whether the event buffer holds what one switch may write, and changes of stage that are not are not too many.

    That is an event, of each rigid lash a separation, a touch and its lock, and a friction that begins to slip; see
    `tile.capacity`.
    """
    return count + 2 + 3 * system.lash_count <= log.events.size and stages <= MOST_STAGES


@inlined_part
def is_instant(at: Moment, log: Log, count: int) -> bool:
    """Whether the phase that the last of `count` events began has lasted no time: then it has no extremes."""
    return at.system.element_count > 1 and at.time - log.events[count - 1].time < INSTANT


@inlined_part
def chooses(system: System, regime: int, guard: int) -> bool:
    """Whether what follows a guard is chosen with the states of all that rests: frictions need not be asked again."""
    row = system.guards[regime, guard]
    return row.successor < 0 or (system.impulsive != 0 and row.event_kind == SEPARATION)


@inlined_part
def switch(at: Moment, log: Log, regime: int, guard: int, count: int) -> Entry:
    """Leave a regime by one of its guards: record the event, reset the state where the contact does, name what follows.

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
    """Entry into the regime in which nothing sticks or is locked that cannot be: torques or rates may have jumped.

    State and inputs may change, and events be written, as at a switch. Of one lash its guard tells, and so it is for
    several of rigid flanks unless the load `jumps`, or its rate of change.
    """
    if not (at.system.friction_count or (jumps and at.system.impulsive and at.system.lash_count > 1)):
        return entry
    settled = rigid.enter_chosen(at, log, entry.regime, -1, 0, entry.written)
    if entry.zero_guard < 0:
        return settled
    before = at.system.guards[entry.regime, entry.zero_guard]
    # its number is another one there: an open lash has more guards than a closed one
    zero = guard_of(at.system, settled.regime, before.functional, before.sign)
    return Entry(settled.written, settled.regime, zero, entry.zero_order)
