"""What happens at the ends of a run and at its events: preload, the regime a state is in, and switching to the next.

Detection is not here: whoever flows through a regime says which guard turned negative, and where.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.events import LOCK, TOUCH
from clunk.core.jit import unowned
from clunk.core.regimes import (
    CLOSED_NEGATIVE,
    CLOSED_POSITIVE,
    FORCE,
    GAP,
    OPEN,
    OPEN_FLOW,
    PARTED_NEGATIVE,
    PARTED_POSITIVE,
    System,
)

FloatArray = npt.NDArray[np.float64]

_PARTED = 1e-9  # of its terms: what the torque across the flanks is not at a separation that was located
ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative to the terms of a sum of a few products


@unowned
def preload(system: System, torque: float, half_gap: float, x: FloatArray) -> int:
    """Set `x` to static equilibrium in contact under `torque`; return the side of the initial flank, 0 if none.

    The initial flank is the one that carries the static contact torque.

    Parameters
    ----------
    torque : float  [N m]
    half_gap : float  [rad]
    x : (N,) float64  [rad, rad/s]
        Output.
    """
    carried = system.contact_torque[0] * torque
    side = 1 if carried > 0.0 else -1
    if not abs(carried) + system.contact_torque[1] * half_gap > 0.0:
        side = 0
    for k in range(x.size):
        x[k] = system.preload[k, 0] * torque + system.preload[k, 1] * side * half_gap
    return side


@unowned
def closed_on(side: int) -> int:
    """The regime of contact on the flank of `side` (+1 or -1)."""
    return CLOSED_POSITIVE if side > 0 else CLOSED_NEGATIVE


@unowned
def regime_of(system: System, x: FloatArray, half_gap: float) -> int:
    """The regime that a given state is in: by its gap, and for separation by force by its contact force too.

    In the restitution model it is the open one; flanks that rest on each other lock by a touch at rest.
    """
    if system.impulsive != 0:
        return OPEN
    for regime in (CLOSED_POSITIVE, CLOSED_NEGATIVE, PARTED_POSITIVE, PARTED_NEGATIVE):
        side = system.regimes[regime].side
        if side * _functional(system, 0, GAP, x) < half_gap:
            continue
        if _guard(system, regime, 0, x, half_gap) >= 0.0 or regime >= PARTED_POSITIVE:
            return regime
        if system.guards[regime, 0].functional == FORCE:
            return PARTED_POSITIVE if side > 0 else PARTED_NEGATIVE
    return OPEN


@unowned
def _functional(system: System, flow: int, which: int, x: FloatArray) -> float:
    value = 0.0
    for k in range(x.size):
        value += system.functionals[flow, which, k] * x[k]
    return value


@unowned
def _guard(system: System, regime: int, guard: int, x: FloatArray, half_gap: float) -> float:
    row = system.guards[regime, guard]
    value = _functional(system, system.regimes[regime].flow, row.functional, x)
    return float(row.sign * value + row.offset * half_gap)


@unowned
def room_for_a_switch(impulsive: int, half_gap: float, capacity: int, count: int) -> bool:
    """Whether the event buffer holds what one switch may write: up to a separation, a touch and its lock."""
    most = 1 if impulsive == 0 else (2 if half_gap > 0.0 else 3)
    return count + most <= capacity


@unowned
def switch(
    system: System,
    regime: int,
    guard: int,
    time: float,
    x: FloatArray,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    count: int,
    fastest: float,
) -> tuple[int, int, int, int, float]:
    """Leave a regime by one of its guards: record the event, reset the state where the contact does, name what follows.

    Parameters
    ----------
    x : (N,) float64  [rad, rad/s]
        State at the event; reset in place.
    events, states : (capacity,) EVENT, (capacity, N) float64
        Output, from `count` on.
    fastest : float  [rad/s]
        Touch so far.

    Returns
    -------
    count : int
        Events written so far.
    successor : int
    zero_guard, zero_order : int
        The successor's guard that is zero on entry, and how many of its derivatives, itself included, are; -1 and 0
        if none is.
    fastest : float
    """
    if system.impulsive == 0:
        count, successor, zero_guard, zero_order = pass_on(
            system.regimes, system.guards, system.lash, regime, guard, time, x, events, states, count
        )
        return count, successor, zero_guard, zero_order, fastest
    return strike(system, regime, guard, time, x, torque, half_gap, events, states, count, fastest)


@unowned
def pass_on(
    regimes: npt.NDArray[np.void],
    guards: npt.NDArray[np.void],
    lash: FloatArray,
    regime: int,
    guard: int,
    time: float,
    x: FloatArray,
    events: npt.NDArray[np.void],
    states: FloatArray,
    count: int,
) -> tuple[int, int, int, int]:
    """`switch` where the contact resets nothing: of the indentation model."""
    speed = 0.0
    for k in range(x.size):
        speed += lash[k] * x[k]
    row = guards[regime, guard]
    successor = row.successor
    side = regimes[successor].side if regimes[successor].side != 0 else regimes[regime].side
    record(events, states, count, time, speed, row.event_kind, successor, side, x)
    return count + 1, successor, row.zero_guard, row.zero_order


@unowned
def strike(
    system: System,
    regime: int,
    guard: int,
    time: float,
    x: FloatArray,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    count: int,
    fastest: float,
) -> tuple[int, int, int, int, float]:
    """`switch` of the restitution model."""
    speed = 0.0
    for k in range(x.size):
        speed += system.lash[k] * x[k]
    row = system.guards[regime, guard]
    kind, successor, zero_guard, zero_order = row.event_kind, row.successor, row.zero_guard, row.zero_order
    if kind == TOUCH:
        side = 1 if guard == 0 else -1
        fastest = max(fastest, abs(speed))
        successor, zero_order = _rebound(system, x, torque, half_gap, side, speed, fastest)
        record(events, states, count, time, speed, TOUCH, OPEN, side, x)
        if successor == OPEN:
            return count + 1, OPEN, guard, zero_order, fastest
        record(events, states, count + 1, time, 0.0, LOCK, successor, side, x)
        return count + 2, successor, -1, 0, fastest
    side = system.regimes[regime].side
    _hold(system, x, side * half_gap)  # released where it was held, but for what rounding has added up
    record(events, states, count, time, 0.0, kind, successor, side, x)
    if half_gap > 0.0:
        torque_held, _, scale = _held(system, x, torque)
        if abs(torque_held) > _PARTED * scale:  # the load step itself parts them: q'' is not zero
            zero_order = 2
        return count + 1, successor, zero_guard, zero_order, fastest
    # locked flanks without a gap between them: no free state
    successor = closed_on(-side)
    record(events, states, count + 1, time, 0.0, TOUCH, OPEN, -side, x)
    record(events, states, count + 2, time, 0.0, LOCK, successor, -side, x)
    return count + 3, successor, 0, 1, fastest


@unowned
def record(
    events: npt.NDArray[np.void],
    states: FloatArray,
    k: int,
    time: float,
    speed: float,
    kind: int,
    regime: int,
    side: int,
    x: FloatArray,
) -> None:
    """Write event `k`, and the state at it; the extremes of the phase that it opens are still to come."""
    events[k].time = time
    events[k].speed = speed
    events[k].kind = kind
    events[k].regime = regime
    events[k].side = side
    events[k].max_acceleration = -np.inf
    events[k].min_acceleration = np.inf
    if states.shape[0] > k:
        for j in range(x.size):
            states[k, j] = x[j]


@unowned
def _rebound(
    system: System, x: FloatArray, torque: float, half_gap: float, side: int, speed: float, fastest: float
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
    place, pull, n = 0.0, 0.0, x.size // 2
    for k in range(n, x.size):
        weight = system.lash[k]
        if weight != 0.0:
            place += abs(weight * x[k - n])
            rate = system.inputs[OPEN_FLOW, k, 0] * torque
            for j in range(x.size):
                rate += system.rates[OPEN_FLOW, k, j] * x[j]
            pull += weight * rate
    tolerance = max(tolerance, np.sqrt(2.0 * abs(pull) * ROUNDING * place))
    if system.restitution * abs(speed) > tolerance:
        for k in range(x.size):
            x[k] -= (1.0 + system.restitution) * speed * system.impulse[k]
        return OPEN, 1
    _hold(system, x, side * half_gap)
    torque_held, slope, scale = _held(system, x, torque)
    pressing = side * torque_held
    if abs(pressing) <= ROUNDING * scale:  # zero: what it turns into decides
        pressing = side * slope
    return (closed_on(side), 0) if pressing > 0.0 else (OPEN, 2)


@unowned
def _held(system: System, x: FloatArray, torque: float) -> tuple[float, float, float]:
    """The torque that would keep q'' at zero, its rate of change, and the size of the terms that make it."""
    torque_held, slope = system.feedthrough[OPEN_FLOW, FORCE, 0] * torque, 0.0
    scale = abs(torque_held)
    for k in range(x.size):
        weight = system.functionals[OPEN_FLOW, FORCE, k]
        rate = system.inputs[OPEN_FLOW, k, 0] * torque
        for j in range(x.size):
            rate += system.rates[OPEN_FLOW, k, j] * x[j]
        torque_held += weight * x[k]
        slope += weight * rate
        scale += abs(weight * x[k])
    return torque_held, slope, scale


@unowned
def _hold(system: System, x: FloatArray, gap: float) -> None:
    """Make q = `gap` and q' = 0 without moving the centre of mass: by a share of the difference that its inertia sets.

    The last of the inertias at the lash then takes what is left of rounding, so that q' is zero to the last bit.
    """
    n = x.size // 2
    for first, target in ((0, gap), (n, 0.0)):
        excess = -target
        last = 0
        for k in range(n):
            excess += system.lash[n + k] * x[first + k]
        others = -target
        for k in range(n):
            weight = system.lash[n + k]
            if weight != 0.0:
                x[first + k] -= excess * system.impulse[n + k]
                others += weight * x[first + k]
                last = k
        others -= system.lash[n + last] * x[first + last]
        x[first + last] = -others / system.lash[n + last]
