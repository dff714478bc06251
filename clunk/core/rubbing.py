"""What Coulomb frictions do at an event: each sticks or slips as the accelerations that follow have it.

A friction may stick while the torque that holds it is at most F, and slips one way with that acceleration. Of all
frictions whose twist rests, those states are taken that fit each other: accelerations of a driveline with convex
friction laws are unique, so that neither the order of frictions nor that of events matters. Where some hold what others
hold too, their torques are not unique, and no motion depends on them: as many stick as hold it, and the others have a
torque of F, either way, and a rate of twist that stays zero.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import part
from clunk.core.regimes import (
    System,
    frictions_of,
    input_of_friction,
    inputs_of,
    rate_of_friction,
    state_of_friction,
    stride_of_friction,
)
from clunk.core.tables import HOLDING, SLIPS_BACKWARD, SLIPS_FORWARD, STICKS, TORQUE, TORQUE_RATE

FloatArray = npt.NDArray[np.float64]

_WITHIN = 1e-11  # of its terms: a rate of twist, an acceleration or an excess of torque this small is zero
_KICK = 1e-13  # of what it could be: the rate with which a friction sets off that begins to slip beside another one
_MOMENT = 1e-3  # s, of the acceleration's terms, which say what that could be where all rests


@part
def stick_all(system: System, x: FloatArray, inputs: FloatArray) -> None:
    """Set the twists at which frictions stick, inputs of a run, to those of a state  [rad]."""
    for k in range(frictions_of(system)):
        inputs[input_of_friction(system, k) + 1] = _twist(system, k, x)


@part
def in_motion(system: System, regime: int, x: FloatArray) -> int:
    """The regime in which each friction whose rate of twist is not zero slips that way; the others are as they were."""
    for k in range(frictions_of(system)):
        rate, most = _rate(system, k, x)
        if abs(rate) > _WITHIN * most:
            state = SLIPS_FORWARD if rate > 0.0 else SLIPS_BACKWARD
            regime += stride_of_friction(system, k) * (state - state_of_friction(system, regime, k))
    return regime


@part
def settle(system: System, regime: int, ended: int, x: FloatArray, inputs: FloatArray) -> tuple[int, int, int]:
    """The regime that follows one in which a friction's guard turned negative, or in which torques or rates may jump.

    Parameters
    ----------
    ended : int
        The guard, or -1.
    x : (N,) float64  [rad, rad/s]
        Changed by less than rounding.
    inputs : (I,) float64
        d of the run; the twists of frictions that begin to stick are written to it.

    Returns
    -------
    regime : int
    zero_guard, zero_order : int
        Its guard that is zero, and how many of the guard's derivatives are, itself included; -1 and 0 without any.
    """
    count, event, resting = frictions_of(system), -1, 0
    for k in range(count):
        if ended >= 0 and system.guards[regime, ended].functional - rate_of_friction(system, k) in (0, 1):
            event = k
    if system.impulsive != 0 and event < 0:  # an impact may have set them in motion
        regime = in_motion(system, regime, x)
    for k in range(count):
        rate, most = _rate(system, k, x)
        rests = k == event or state_of_friction(system, regime, k) == STICKS or abs(rate) <= _WITHIN * most
        resting |= rests << k
    fits = system.excess[system.regimes[regime].flow] == 0
    for k in range(count):
        if state_of_friction(system, regime, k) == STICKS:
            torque, size = _holding(system, regime, k, x, inputs)
            most = system.friction_torques[k]
            fits = fits and abs(torque) - most <= _WITHIN * (size + most)
    if event < 0 and fits:
        return regime, -1, 0

    released = event if event >= 0 and state_of_friction(system, regime, event) == STICKS else -1
    combinations, base = 1, regime
    for k in range(count):
        if resting >> k & 1:
            combinations *= 3
            base -= state_of_friction(system, regime, k) * stride_of_friction(system, k)
    least, best = np.inf, regime
    for number in range(combinations):
        candidate, digits = base, number
        for k in range(count):
            if resting >> k & 1:
                candidate += digits % 3 * stride_of_friction(system, k)
                digits //= 3
        sticks_again = released >= 0 and state_of_friction(system, candidate, released) == STICKS
        if sticks_again or system.excess[system.regimes[candidate].flow] != 0:
            continue
        misfit = 0.0
        for k in range(count):
            if resting >> k & 1:
                misfit += _misfit(system, candidate, k, x, inputs)
        if misfit < least:
            least, best = misfit, candidate

    zero_guard, zero_order = -1, 0
    for k in range(count):
        state = state_of_friction(system, best, k)
        if state == STICKS:
            if state_of_friction(system, regime, k) != STICKS:
                inputs[input_of_friction(system, k) + 1] = _twist(system, k, x)
        elif resting >> k & 1 and not _is_held(system, best, k):
            speeds_up, size = _speeds_up(system, best, k, x, inputs)
            if k == event or (event < 0 and zero_guard < 0):
                zero_guard, zero_order = _guard_of(system, best, k), 1 if abs(speeds_up) > _WITHIN * size else 2
            elif not abs(speeds_up) > _WITHIN * size:
                fastest = _rate(system, k, x)[1] + _MOMENT * size
                _set_off(system, k, _KICK * (fastest if state == SLIPS_FORWARD else -fastest), x)
    return best, zero_guard, zero_order


@part
def _misfit(system: System, regime: int, friction: int, x: FloatArray, inputs: FloatArray) -> float:
    """By how much a friction at rest misses its state in a regime, as a share of the terms; 0 where it fits.

    Where it sticks that is the torque beyond F, where it slips the acceleration the other way. At the limit of a state
    it is `_WITHIN` if the friction is about to leave it.
    """
    state, most = state_of_friction(system, regime, friction), system.friction_torques[friction]
    if state == STICKS:
        torque, size = _holding(system, regime, friction, x, inputs)
        beyond, size = abs(torque) - most, size + most
        leaves = torque * _holding_slope(system, regime, friction, x, inputs) > 0.0
    elif _is_held(system, regime, friction):
        return 0.0
    else:
        way = 1.0 if state == SLIPS_FORWARD else -1.0
        speeds_up, size = _speeds_up(system, regime, friction, x, inputs)
        beyond, leaves = -way * speeds_up, way * _jerk(system, regime, friction, x, inputs) < 0.0
    if beyond > _WITHIN * size:
        return float(beyond / size)
    return _WITHIN if leaves and beyond > -_WITHIN * size else 0.0


@part
def _holding(system: System, regime: int, friction: int, x: FloatArray, inputs: FloatArray) -> tuple[float, float]:
    """The torque that holds a friction in a regime, and the sum of its terms' magnitudes  [N m]."""
    flow, functional, value, size = system.regimes[regime].flow, rate_of_friction(system, friction) + HOLDING, 0.0, 0.0
    for k in range(x.size):
        term = system.functionals[flow, functional, k] * x[k]
        value, size = value + term, size + abs(term)
    for k in range(inputs_of(system)):
        term = system.feedthrough[flow, functional, k] * (system.weights[regime, k] * inputs[k])
        value, size = value + term, size + abs(term)
    return value, size


@part
def _holding_slope(system: System, regime: int, friction: int, x: FloatArray, inputs: FloatArray) -> float:
    """The rate of change of the torque that holds a friction in a regime  [N m/s]."""
    flow, functional = system.regimes[regime].flow, rate_of_friction(system, friction) + HOLDING
    value = system.feedthrough[flow, functional, TORQUE] * inputs[TORQUE_RATE]
    for k in range(x.size):
        if system.functionals[flow, functional, k] != 0.0:
            value += system.functionals[flow, functional, k] * _change(system, regime, k, x, inputs)[0]
    return float(value)


@part
def _change(system: System, regime: int, k: int, x: FloatArray, inputs: FloatArray) -> tuple[float, float]:
    """The rate of change of state `k` in a regime, and the sum of its terms' magnitudes."""
    flow, value, size = system.regimes[regime].flow, 0.0, 0.0
    for j in range(x.size):
        term = system.rates[flow, k, j] * x[j]
        value, size = value + term, size + abs(term)
    for j in range(inputs_of(system)):
        term = system.inputs[flow, k, j] * (system.weights[regime, j] * inputs[j])
        value, size = value + term, size + abs(term)
    return value, size


@part
def _speeds_up(system: System, regime: int, friction: int, x: FloatArray, inputs: FloatArray) -> tuple[float, float]:
    """The second derivative of a friction's twist in a regime, and the sum of its terms' magnitudes  [rad/s2]."""
    value, size = 0.0, 0.0
    for k in range(system.inertias, 2 * system.inertias):
        weight = system.frictions[friction, k]
        if weight != 0.0:
            change, terms = _change(system, regime, k, x, inputs)
            value, size = value + weight * change, size + abs(weight) * terms
    return value, size


@part
def _jerk(system: System, regime: int, friction: int, x: FloatArray, inputs: FloatArray) -> float:
    """The third derivative of a friction's twist in a regime  [rad/s3]."""
    flow, value = system.regimes[regime].flow, 0.0
    for k in range(system.inertias, 2 * system.inertias):
        weight = system.frictions[friction, k]
        if weight != 0.0:
            value += weight * system.inputs[flow, k, TORQUE] * inputs[TORQUE_RATE]
            for j in range(x.size):
                if system.rates[flow, k, j] != 0.0:
                    value += weight * system.rates[flow, k, j] * _change(system, regime, j, x, inputs)[0]
    return value


@part
def _rate(system: System, friction: int, x: FloatArray) -> tuple[float, float]:
    """The rate of twist of a friction, and the most that it could be at the fastest inertia's speed  [rad/s]."""
    value, weights, fastest = 0.0, 0.0, 0.0
    for k in range(system.inertias, 2 * system.inertias):
        value += system.frictions[friction, k] * x[k]
        weights += abs(system.frictions[friction, k])
        fastest = max(fastest, abs(x[k]))
    return value, weights * fastest


@part
def _twist(system: System, friction: int, x: FloatArray) -> float:
    """The twist of a friction's shaft  [rad]."""
    value = 0.0
    for k in range(system.inertias):
        value += system.frictions[friction, system.inertias + k] * x[k]
    return value


@part
def _is_held(system: System, regime: int, friction: int) -> bool:
    """Whether the rate of twist of a friction stays zero for others, so that it has no functional."""
    rate, flow = rate_of_friction(system, friction), system.regimes[regime].flow
    weights = 0.0
    for k in range(2 * system.inertias):
        weights += abs(system.functionals[flow, rate, k])
    return bool(weights == 0.0)


@part
def _guard_of(system: System, regime: int, friction: int) -> int:
    """The guard of a friction that slips."""
    rate = rate_of_friction(system, friction)
    for g in range(system.regimes[regime].guards):
        if system.guards[regime, g].functional == rate:
            return g
    return -1


@part
def _set_off(system: System, friction: int, rate: float, x: FloatArray) -> None:
    """Add a rate of twist  [rad/s] across a friction to a state, along the friction's row."""
    weights = 0.0
    for k in range(system.inertias, 2 * system.inertias):
        weights += system.frictions[friction, k] ** 2
    for k in range(system.inertias, 2 * system.inertias):
        x[k] += rate * system.frictions[friction, k] / weights
