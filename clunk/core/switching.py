"""What happens at the ends of a run and at its events: preload, the regime a state is in, and switching to the next.

Detection is not here: whoever flows through a regime says which guard turned negative, and where.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.events import LOCK, STAGE, TOUCH
from clunk.core.jit import unowned, unowned_inlined
from clunk.core.regimes import System
from clunk.core.runs import Log, record
from clunk.core.status import Status
from clunk.core.tables import (
    CLOSED_NEGATIVE,
    CLOSED_POSITIVE,
    FORCE,
    GAP,
    HALF_GAP,
    INPUTS,
    OPEN,
    TORQUE,
    TORQUE_RATE,
)

FloatArray = npt.NDArray[np.float64]

# Share of its terms: a larger holding torque at a release means that a jump of the load parted the flanks.
_CLEARLY_NOT_ZERO = 1e-9
_OK = int(Status.OK)
_NO_EQUILIBRIUM = int(Status.NO_EQUILIBRIUM)
_NO_INITIAL_FLANK = int(Status.NO_INITIAL_FLANK)
_WITHIN = 1e-11  # of its terms: the steady twist of a staged shaft this little beyond a breakpoint is at it
MOST_STAGES = 16  # changes of stage an event, of all that a run may have: a twist at rest at a breakpoint has many
ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative to the terms of a sum of a few products


class Entry(NamedTuple):
    """Entry into the regime that follows an event."""

    written: int  # events so far
    regime: int
    zero_guard: int  # the regime's guard that is zero on entry, or -1
    zero_order: int  # and how many of its derivatives, itself included, are


@unowned_inlined
def weigh(weights: FloatArray, inputs: FloatArray) -> float:
    """The sum of weights times inputs."""
    total = weights[0] * inputs[0]
    for k in range(1, weights.size):
        total += weights[k] * inputs[k]
    return float(total)


@unowned_inlined
def set_weighed(system: System, regime: int, inputs: FloatArray, u: FloatArray) -> None:
    """Set `u` to what a regime makes of the inputs of a run."""
    for k in range(u.size):
        u[k] = system.weights[regime, k] * inputs[k]


@unowned
def preload(system: System, inputs: FloatArray, x: FloatArray) -> tuple[int, int]:
    """Set `x` to steady motion in contact; return the status and the regime.

    The initial flank is the one that carries the contact torque in it. Of the combinations of stages it is the first
    one within which the shafts' steady twists lie.

    Parameters
    ----------
    inputs : (INPUTS or more,) float64
        d before the load step  [N m, rad, N m/s].
    x : (N,) float64  [rad, rad/s]
        Output.
    """
    torque, half_gap = inputs[TORQUE], inputs[HALF_GAP]
    for stage in range(system.preload.shape[0]):
        by, first = system.preload[stage], stage * system.lash_states
        carried = system.contact_torque[stage, TORQUE] * torque
        for j in range(INPUTS, by.shape[1]):
            carried += system.contact_torque[stage, j] * system.weights[first, j]
        side = 1 if carried > 0.0 else -1
        if not abs(carried) + system.contact_torque[stage, HALF_GAP] * half_gap > 0.0:
            side = 0
        for k in range(x.size):
            x[k] = by[k, TORQUE] * torque + by[k, HALF_GAP] * side * half_gap
            for j in range(INPUTS, by.shape[1]):
                x[k] += by[k, j] * system.weights[first, j]
        # a call is dear: all of the system is handed over
        if system.preload.shape[0] == 1 or _is_in_stage(system, first, x):
            if system.preload.shape[0] > 1 and _is_beside_loose(system, first, x):
                break
            return (_OK if side != 0 else _NO_INITIAL_FLANK), first + closed_on(side)
    return _NO_EQUILIBRIUM, OPEN


@unowned_inlined
def breakpoint_of(system: System, regime: int, guard: int) -> float:
    """The offset of a guard of a staged shaft, its breakpoint with the guard's sign  [rad]."""
    total = 0.0
    for k in range(INPUTS, system.offsets.shape[2]):
        total += system.offsets[regime, guard, k]
    return float(total)


@unowned
def _within_stage(system: System, regime: int, guard: int, x: FloatArray) -> float:
    """How far the twist of a staged shaft lies within a breakpoint, as a share of both; 0 where rounding decides."""
    row, value = system.guards[regime, guard], breakpoint_of(system, regime, guard)
    scale = abs(value)
    for k in range(x.size):
        term = system.functionals[0, row.functional, k] * x[k]
        value += row.sign * term
        scale += abs(term)
    return value / scale if abs(value) > _WITHIN * scale else 0.0


@unowned
def _is_in_stage(system: System, regime: int, x: FloatArray) -> bool:
    """Whether the twists of the staged shafts lie, but for rounding, within the stages of a regime."""
    for g in range(system.regimes[regime].guards):
        if system.guards[regime, g].event_kind == STAGE and _within_stage(system, regime, g, x) < 0.0:
            return False
    return True


@unowned
def _is_beside_loose(system: System, regime: int, x: FloatArray) -> bool:
    """Whether a staged shaft's twist is at a breakpoint behind which no stiffness tells what it is."""
    for g in range(system.regimes[regime].guards):
        guard = system.guards[regime, g]
        is_at = guard.event_kind == STAGE and _within_stage(system, regime, g, x) == 0.0
        if is_at and np.isnan(system.preload[guard.successor // system.lash_states, 0, TORQUE]):
            return True
    return False


@unowned
def closed_on(side: int) -> int:
    """The lash's state of contact on the flank of `side` (+1 or -1)."""
    return CLOSED_POSITIVE if side > 0 else CLOSED_NEGATIVE


@unowned_inlined
def opened(system: System, regime: int) -> int:
    """The regime of the same stages in which the lash is open."""
    return regime - regime % system.lash_states


@unowned
def regime_of(system: System, x: FloatArray, inputs: FloatArray) -> int:
    """The regime of a state: the first one with a flank whose overlap and guards are not negative, else the open one.

    In the restitution model it is the open one; flanks that rest on each other lock by a touch at rest.
    """
    first = 0
    while first + system.lash_states < system.regimes.size and not _is_in_stage(system, first, x):
        first += system.lash_states
    if system.impulsive != 0:
        return first + OPEN
    for regime in range(first, first + system.lash_states):
        row = system.regimes[regime]
        inside = row.side != 0 and row.side * _functional(system, 0, GAP, x) >= inputs[HALF_GAP]
        for g in range(row.guards):
            guard = system.guards[regime, g]
            value = guard.sign * _functional(system, row.flow, guard.functional, x)
            within = value + weigh(system.offsets[regime, g], inputs) >= 0.0
            inside = inside and (within or guard.event_kind == STAGE)
        if inside:
            return regime
    return first + OPEN


@unowned
def _functional(system: System, flow: int, which: int, x: FloatArray) -> float:
    value = 0.0
    for k in range(x.size):
        value += system.functionals[flow, which, k] * x[k]
    return value


@unowned_inlined
def room_for_a_switch(system: System, inputs: FloatArray, log: Log, count: int) -> bool:
    """Whether the event buffer holds what one switch may write: up to a separation, a touch and its lock."""
    most = 1 if system.impulsive == 0 else (2 if inputs[HALF_GAP] > 0.0 else 3)
    return bool(count + most <= log.events.size)


@unowned_inlined
def switch(
    system: System,
    regime: int,
    guard: int,
    time: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
    fastest: float,
) -> tuple[Entry, float]:
    """Leave a regime by one of its guards: record the event, reset the state where the contact does, name what follows.

    Parameters
    ----------
    x : (N,) float64  [rad, rad/s]
        State at the event; reset in place.
    log : Log
        Output, from `count` on.
    fastest : float  [rad/s]
        Touch so far; returned updated.
    """
    row = system.guards[regime, guard]
    if row.event_kind == STAGE and log.states.shape[0] == 0:
        return Entry(count, row.successor, row.zero_guard, row.zero_order), fastest
    speed = 0.0
    for k in range(x.size):
        speed += system.lash[k] * x[k]
    if system.impulsive != 0 and row.event_kind != STAGE:
        if row.event_kind == TOUCH:
            fastest = max(fastest, abs(speed))
            return _strike(system, regime, guard, time, speed, x, inputs, log, count, fastest), fastest
        return _release(system, regime, guard, time, x, inputs, log, count), fastest
    record(log, count, time, speed, row.event_kind, row.successor, row.side, x)
    return Entry(count + 1, row.successor, row.zero_guard, row.zero_order), fastest


@unowned
def _strike(
    system: System,
    regime: int,
    guard: int,
    time: float,
    speed: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
    fastest: float,
) -> Entry:
    """A touch of the restitution model, and the lock that may follow it at once."""
    side = system.guards[regime, guard].side
    successor, zero_order = _rebound(system, regime, x, inputs, side, speed, fastest)
    record(log, count, time, speed, TOUCH, regime, side, x)
    if successor == regime:
        return Entry(count + 1, regime, guard, zero_order)
    record(log, count + 1, time, 0.0, LOCK, successor, side, x)
    return Entry(count + 2, successor, -1, 0)


@unowned
def _release(
    system: System,
    regime: int,
    guard: int,
    time: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
) -> Entry:
    """A separation of the restitution model; without a gap the flanks lock on the other side at once."""
    row, side = system.guards[regime, guard], system.regimes[regime].side
    _hold(system, x, side * inputs[HALF_GAP])  # released where it was held, but for what rounding has added up
    record(log, count, time, 0.0, row.event_kind, row.successor, side, x)
    if inputs[HALF_GAP] > 0.0:
        torque_held, slope, scale = holding_torque(system, row.successor, x, inputs)
        # where a jump of the load parts them, q'' is not zero; nothing but the load's own slope may tell what zero is
        order = 2 if abs(torque_held) > _CLEARLY_NOT_ZERO * (scale + abs(slope) * time) else int(row.zero_order)
        return Entry(count + 1, row.successor, row.zero_guard, order)
    # locked flanks without a gap between them: no free state
    successor = opened(system, regime) + closed_on(-side)
    record(log, count + 1, time, 0.0, TOUCH, opened(system, regime), -side, x)
    record(log, count + 2, time, 0.0, LOCK, successor, -side, x)
    return Entry(count + 3, successor, 0, 1)


@unowned
def _rebound(
    system: System, regime: int, x: FloatArray, inputs: FloatArray, side: int, speed: float, fastest: float
) -> tuple[int, int]:
    """The velocities after a touch in an open regime, θ' -= (1 + e) q' M⁻¹l/(lᵀM⁻¹l) (report Eq. 2.9).

    A rebound not faster than the locking speed, or not higher than rounding, ends with q' = 0: locked where the torque
    that holds it so presses the flanks together, else open, with the gap at zero and about to open.

    Returns
    -------
    successor : int
    zero_order : int
        Of the guard of this flank in the open regime.
    """
    tolerance = system.locking_speed if system.locking_speed >= 0.0 else -system.locking_speed * fastest
    # a rebound lower than the rounding of the gap cannot be followed
    place, pull, n = 0.0, 0.0, system.inertias
    for k in range(n, 2 * n):
        weight = system.lash[k]
        if weight != 0.0:
            place += abs(weight * x[k - n])
            pull += weight * _rate(system, regime, k, x, inputs)
    tolerance = max(tolerance, np.sqrt(2.0 * abs(pull) * ROUNDING * place))
    if system.restitution * abs(speed) > tolerance:
        for k in range(x.size):
            x[k] -= (1.0 + system.restitution) * speed * system.impulse[k]
        return regime, 1
    _hold(system, x, side * inputs[HALF_GAP])
    torque_held, slope, scale = holding_torque(system, regime, x, inputs)
    pressing = side * torque_held
    if abs(pressing) <= ROUNDING * scale:  # zero: what it turns into decides
        pressing = side * slope
    return (opened(system, regime) + closed_on(side), 0) if pressing > 0.0 else (regime, 2)


@unowned_inlined
def _driven(system: System, regime: int, weights: FloatArray, inputs: FloatArray) -> float:
    """Weights times the torque and what the staged shafts add to it; of the restitution model, no gap has a weight."""
    total = weights[TORQUE] * inputs[TORQUE]
    for k in range(INPUTS, weights.size):
        total += weights[k] * system.weights[regime, k]
    return float(total)


@unowned_inlined
def _rate(system: System, regime: int, k: int, x: FloatArray, inputs: FloatArray) -> float:
    """The rate of change of state `k` of the restitution model in a regime."""
    flow = system.regimes[regime].flow
    rate = _driven(system, regime, system.inputs[flow, k], inputs)
    for j in range(x.size):
        rate += system.rates[flow, k, j] * x[j]
    return float(rate)


@unowned
def holding_torque(system: System, regime: int, x: FloatArray, inputs: FloatArray) -> tuple[float, float, float]:
    """The torque that keeps q'' at zero, its rate of change in a regime, and the size of the terms that make it."""
    flow = system.regimes[regime].flow
    torque_held = _driven(system, regime, system.feedthrough[flow, FORCE], inputs)
    slope = system.feedthrough[flow, FORCE, TORQUE] * inputs[TORQUE_RATE]
    scale = abs(torque_held)
    for k in range(x.size):
        weight = system.functionals[flow, FORCE, k]
        torque_held += weight * x[k]
        slope += weight * _rate(system, regime, k, x, inputs)
        scale += abs(weight * x[k])
    return torque_held, slope, scale


@unowned
def _hold(system: System, x: FloatArray, gap: float) -> None:
    """Make q = `gap` and q' = 0 without moving the centre of mass: by a share of the difference that its inertia sets.

    The last of the inertias at the lash that turn as q does, not through the gear ratio, then takes what is left of
    rounding, so that q' is zero to the last bit.
    """
    n = system.inertias
    for first, target in ((0, gap), (n, 0.0)):
        excess = -target
        last = -1
        for k in range(n):
            excess += system.lash[n + k] * x[first + k]
        rest = -target
        for k in range(n):
            weight = system.lash[n + k]
            if weight != 0.0:
                x[first + k] -= excess * system.impulse[n + k]
                rest += weight * x[first + k]
                if last < 0 or abs(weight) == 1.0:
                    last = k
        rest -= system.lash[n + last] * x[first + last]
        x[first + last] = -rest / system.lash[n + last]
