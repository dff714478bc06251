"""What happens at the ends of a run and at its events: preload, the regime a state is in, and switching to the next.

Detection is not here: whoever flows through a regime says which guard turned negative, and where.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.events import LOCK, TOUCH
from clunk.core.jit import unowned, unowned_inlined
from clunk.core.regimes import (
    CLOSED_NEGATIVE,
    CLOSED_POSITIVE,
    FORCE,
    GAP,
    HALF_GAP,
    INPUTS,
    OPEN,
    OPEN_FLOW,
    TORQUE,
    TORQUE_RATE,
    System,
)
from clunk.core.runs import Log, record

FloatArray = npt.NDArray[np.float64]

# Share of its terms: a larger holding torque at a release means that a jump of the load parted the flanks.
_CLEARLY_NOT_ZERO = 1e-9
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
    for k in range(1, INPUTS):
        total += weights[k] * inputs[k]
    return float(total)


@unowned
def preload(system: System, inputs: FloatArray, x: FloatArray) -> int:
    """Set `x` to steady motion in contact; return the side of the initial flank, 0 if none.

    The initial flank is the one that carries the contact torque in it.

    Parameters
    ----------
    inputs : (INPUTS,) float64
        d before the load step  [N m, rad, N m/s].
    x : (N,) float64  [rad, rad/s]
        Output.
    """
    torque, half_gap = inputs[TORQUE], inputs[HALF_GAP]
    carried = system.contact_torque[TORQUE] * torque
    side = 1 if carried > 0.0 else -1
    if not abs(carried) + system.contact_torque[HALF_GAP] * half_gap > 0.0:
        side = 0
    for k in range(x.size):
        x[k] = system.preload[k, TORQUE] * torque + system.preload[k, HALF_GAP] * side * half_gap
    return side


@unowned
def closed_on(side: int) -> int:
    """The regime of contact on the flank of `side` (+1 or -1)."""
    return CLOSED_POSITIVE if side > 0 else CLOSED_NEGATIVE


@unowned
def regime_of(system: System, x: FloatArray, inputs: FloatArray) -> int:
    """The regime of a state: the first one with a flank whose overlap and guards are not negative, else the open one.

    In the restitution model it is the open one; flanks that rest on each other lock by a touch at rest.
    """
    if system.impulsive != 0:
        return OPEN
    for regime in range(system.regimes.size):
        row = system.regimes[regime]
        inside = row.side != 0 and row.side * _functional(system, OPEN_FLOW, GAP, x) >= inputs[HALF_GAP]
        for g in range(row.guards):
            guard = system.guards[regime, g]
            value = guard.sign * _functional(system, row.flow, guard.functional, x)
            inside = inside and value + weigh(system.offsets[regime, g], inputs) >= 0.0
        if inside:
            return regime
    return OPEN


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
    speed = 0.0
    for k in range(x.size):
        speed += system.lash[k] * x[k]
    if system.impulsive != 0:
        if row.event_kind == TOUCH:
            fastest = max(fastest, abs(speed))
            return _strike(system, guard, row.side, time, speed, x, inputs, log, count, fastest), fastest
        return _release(system, regime, guard, time, x, inputs, log, count), fastest
    record(log, count, time, speed, row.event_kind, row.successor, row.side, x)
    return Entry(count + 1, row.successor, row.zero_guard, row.zero_order), fastest


@unowned
def _strike(
    system: System,
    guard: int,
    side: int,
    time: float,
    speed: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
    fastest: float,
) -> Entry:
    """A touch of the restitution model, and the lock that may follow it at once."""
    successor, zero_order = _rebound(system, x, inputs, side, speed, fastest)
    record(log, count, time, speed, TOUCH, OPEN, side, x)
    if successor == OPEN:
        return Entry(count + 1, OPEN, guard, zero_order)
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
        torque_held, slope, scale = holding_torque(system, OPEN_FLOW, x, inputs)
        # where a jump of the load parts them, q'' is not zero; nothing but the load's own slope may tell what zero is
        order = 2 if abs(torque_held) > _CLEARLY_NOT_ZERO * (scale + abs(slope) * time) else int(row.zero_order)
        return Entry(count + 1, row.successor, row.zero_guard, order)
    # locked flanks without a gap between them: no free state
    successor = closed_on(-side)
    record(log, count + 1, time, 0.0, TOUCH, OPEN, -side, x)
    record(log, count + 2, time, 0.0, LOCK, successor, -side, x)
    return Entry(count + 3, successor, 0, 1)


@unowned
def _rebound(
    system: System, x: FloatArray, inputs: FloatArray, side: int, speed: float, fastest: float
) -> tuple[int, int]:
    """The velocities after a touch, θ' -= (1 + e) q' M⁻¹l/(lᵀM⁻¹l) (report Eq. 2.9), and what follows.

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
            pull += weight * _rate(system, OPEN_FLOW, k, x, inputs[TORQUE])
    tolerance = max(tolerance, np.sqrt(2.0 * abs(pull) * ROUNDING * place))
    if system.restitution * abs(speed) > tolerance:
        for k in range(x.size):
            x[k] -= (1.0 + system.restitution) * speed * system.impulse[k]
        return OPEN, 1
    _hold(system, x, side * inputs[HALF_GAP])
    torque_held, slope, scale = holding_torque(system, OPEN_FLOW, x, inputs)
    pressing = side * torque_held
    if abs(pressing) <= ROUNDING * scale:  # zero: what it turns into decides
        pressing = side * slope
    return (closed_on(side), 0) if pressing > 0.0 else (OPEN, 2)


@unowned_inlined
def _rate(system: System, flow: int, k: int, x: FloatArray, torque: float) -> float:
    """The rate of change of state `k` of the restitution model in a flow."""
    rate = system.inputs[flow, k, TORQUE] * torque
    for j in range(x.size):
        rate += system.rates[flow, k, j] * x[j]
    return float(rate)


@unowned
def holding_torque(system: System, flow: int, x: FloatArray, inputs: FloatArray) -> tuple[float, float, float]:
    """The torque that keeps q'' at zero, its rate of change in a flow, and the size of the terms that make it."""
    torque, direct = inputs[TORQUE], system.feedthrough[flow, FORCE, TORQUE]
    torque_held, slope = direct * torque, direct * inputs[TORQUE_RATE]
    scale = abs(torque_held)
    for k in range(x.size):
        weight = system.functionals[flow, FORCE, k]
        torque_held += weight * x[k]
        slope += weight * _rate(system, flow, k, x, torque)
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
