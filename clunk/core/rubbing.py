"""At an event, the choice of the frictions that stick or slip, and of the rigid flanks that stay locked or part.

Which flanks press depends on the torques that frictions hold, and these depend on which flanks are locked. So the
states of all elements at rest are chosen at once: of locked flanks, sticking frictions, and frictions whose rate of
twist is zero. Of all combinations of their states, that one is taken in which

- flanks that stay locked press on each other, and flanks that part accelerate apart;
- a friction that sticks holds with a torque of at most F, and one that slips accelerates the way it slips.

Where such a torque or acceleration is at its limit, its rate of change decides. There is such a combination, and its
accelerations are unique, as for any convex friction law and flanks that only press (Gauss's principle of least
constraint), so that neither the order of elements nor that of events matters. Where several elements hold the same
twist, their torques are not unique, and no motion depends on them: as many flanks stay locked as do not pull, as many
frictions stick as hold the rest, and the others have a torque of F, either way, and a rate of twist that stays zero.

An impact is over before a friction's torque makes an impulse: frictions whose twists it sets in motion slip, even if
they stuck before. Only an impact as slow as rounding leaves those stuck that stuck before.
"""

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.events import INSTANT
from clunk.core.jit import inlined_part, part
from clunk.core.regimes import (
    System,
    gap_input,
    guard_of,
    input_of_friction,
    opened,
    rate_of_friction,
    stride_of_friction,
    twist_of,
)
from clunk.core.runs import Moment
from clunk.core.sums import weigh
from clunk.core.tables import (
    ABOVE,
    CLOSED_NEGATIVE,
    CLOSED_POSITIVE,
    FORCE,
    HOLDING,
    OF_FRICTION,
    SLIPS_BACKWARD,
    SLIPS_FORWARD,
    STICKS,
)

WITHIN = 1e-11  # share of its terms: a rate of twist, an acceleration or an excess of torque no larger counts as zero
# Times that make rates of the terms of an acceleration [s]. A share WITHIN of the rate by _STARTING_TIME may be
# rounding, and counts as zero. A share _KICK of the rate by OF_STEPS is above the rounding of RK4's states, and still
# counts as zero; of the rate by OF_MODES, for the exact method, it is above the rounding of the slowest modes.
_STARTING_TIME, OF_STEPS, OF_MODES = 1e-4, 3e-4, 0.1
# Shares of the size of a rate of twist: the rate given to frictions that begin to slip at one time, or of which
# rounding decides that they begin; and how near to it all of these rates are brought. Farther apart, rigid flanks of
# equal branches would touch one by one.
_KICK, _EQUAL = 1e-13, 1e-15
_MOST_KICKS = 100  # of each friction: kicks change the rates of the other frictions, by less and less


@inlined_part
def tolerance_after(phase: float) -> float:
    """Share of its terms up to which a torque or rate is zero at an event: `WITHIN`, or 0 after a phase of no time.

    Where a phase is shorter than INSTANT, the states chosen at its beginning within rounding gave way at once, and
    would do so again: signs alone then decide.

    phase : float  [s]
        Length of the phase that the event ends.
    """
    return WITHIN if phase >= INSTANT else 0.0


@part
def stick_all(system: System, x: FloatArray, inputs: FloatArray) -> None:
    """Set the inputs that are the twists at which frictions stick to the twists in a state  [rad]."""
    for k in range(system.friction_count):
        inputs[input_of_friction(system, k) + 1] = twist_of(system, system.frictions[k], x)[0]


@part
def stop_all(system: System, regime: int, x: FloatArray) -> None:
    """Set the rates of twist, in a state, of the frictions that stick in a regime to zero."""
    for k in range(system.friction_count):
        if system.friction_states[regime, k] == STICKS:
            _speed_up(system, k, 0, -_rate(system, system.frictions[k], 0.0, x)[0], x)


@part
def in_motion(system: System, regime: int, speed: float, x: FloatArray) -> int:
    """The regime in which each friction whose rate of twist is not zero slips that way, and the others stick.

    speed : float  [rad/s]
        Of an impact just before, to which the rounding of rates is relative.
    """
    for k in range(system.friction_count):
        state, (rate, most) = STICKS, _rate(system, system.frictions[k], speed, x)
        if abs(rate) > WITHIN * most:
            state = SLIPS_FORWARD if rate > 0.0 else SLIPS_BACKWARD
        regime += stride_of_friction(system, k) * (state - system.friction_states[regime, k])
    return regime


@part
def choose_states(at: Moment, regime: int, resting_on: int, ended: int) -> tuple[int, int, int]:
    """The regime that follows where a guard of an element at rest turned negative, or torques or rates may have jumped.

    Parameters
    ----------
    at : Moment
        Its state is changed by less than rounding.
    resting_on : int
        The regime in which all flanks are closed that rest on each other, see `rigid._resting_on`.
    ended : int
        The guard that turned negative, or -1.

    Returns
    -------
    regime : int
    zero_guard, zero_order : int
        The guard of a friction that is zero in that regime, and how many of the guard's derivatives are, the guard
        itself included; -1 and 0 without such a guard.
    """
    system, x, inputs = at.system, at.x, at.inputs
    count, event, resting, locked = system.friction_count, -1, 0, 0
    # frictions that stick, as bits: the highest digits of the flow's number
    sticking = system.regimes[regime].flow // (system.rates.shape[0] >> count)
    if ended >= 0:  # functionals of frictions are the last
        event = max((system.guards[regime, ended].functional - rate_of_friction(system, 0)) // OF_FRICTION, -1)
    for lash in range(system.lash_count * system.impulsive):
        locked |= system.contacts[resting_on, lash].closed << lash
    fits = ended < 0 and not system.excess[system.regimes[regime].flow]
    if fits and _misfits(at, regime, resting_on, locked, sticking) <= at.within:
        return regime, -1, 0
    for k in range(count):
        if not (k == event or sticking >> k & 1):
            rate, most = _rate(system, system.frictions[k], 0.0, x)
            _, terms = derivative(at, regime, rate_of_friction(system, k), 1)
            brake = weigh(system.frictions[k], system.inputs[0, :, input_of_friction(system, k)])
            most += (terms + system.friction_torques[k] * abs(brake)) * _STARTING_TIME
            if abs(rate) >= at.within * most:  # also where both are 0, as others hold the twist: no reason to stick
                continue
        resting |= 1 << k
    failed = regime if ended >= 0 and event < 0 else -1
    best = _fitting(at, resting_on, failed, event, resting, locked)

    zero_guard, zero_order, is_set_off, kicked = -1, 0, False, 0
    for j in range(_MOST_KICKS * count):
        if j - kicked == count:  # all have their rates
            break
        k = (event + 1 + j) % count  # the friction of the event comes last: another one may be set off before it
        state, row, functional = system.friction_states[best, k], system.frictions[k], rate_of_friction(system, k)
        way, (rate, most) = 1.0 if state == SLIPS_FORWARD else -1.0, _rate(system, row, 0.0, x)
        if state == STICKS:
            if system.friction_states[regime, k] != STICKS:
                inputs[input_of_friction(system, k) + 1] = twist_of(system, row, x)[0]
        # at rest, or with a rate against its slip, which is rounding where two begin to slip at one time
        elif (resting >> k & 1 or way * rate < 0.0) and not _is_held(system, best, functional):
            speeds_up, size = derivative(at, best, functional, 1)
            clearly, kick = way * speeds_up > at.within * size, _KICK * (most + at.rounded * size)
            sets_off = clearly or way * derivative(at, best, functional, 2)[0] > 0.0
            if is_set_off and abs(rate - way * kick) <= _EQUAL * most:
                continue
            if sets_off and not is_set_off and (k == event or (event < 0 and zero_guard < 0)):
                zero_guard, zero_order = guard_of(system, best, functional, way), 1 if clearly else 2
            else:
                _speed_up(system, k, system.regimes[best].flow, way * kick - rate, x)
                zero_guard, zero_order, is_set_off, kicked = -1, 0, True, j
    return best, zero_guard, zero_order


@part
def _speed_up(system: System, friction: int, flow: int, kick: float, x: FloatArray) -> None:
    """Add a kick [rad/s] to the rate of twist of a friction, by an impulse across it in a flow in which it slips."""
    along = system.inputs[flow, :, input_of_friction(system, friction)]
    rate = weigh(system.frictions[friction], along)
    for j in range(x.size):
        x[j] += kick * along[j] / rate


@part
def _misfits(at: Moment, regime: int, before: int, locked: int, resting: int) -> float:
    """Sum of the misfits, in a regime, of the `locked` lashes and the `resting` frictions, as bits; see `_misfit`."""
    misfit = 0.0
    for lash in range(at.system.lash_count):
        if locked >> lash & 1:
            misfit += _misfit_of_flanks(at, regime, before, lash)
    for k in range(at.system.friction_count):
        if resting >> k & 1:
            misfit += _misfit(at, regime, k)
    return misfit


@part
def _fitting(at: Moment, regime: int, failed: int, event: int, resting: int, locked: int) -> int:
    """The regime of the least misfit, of those that differ from a given one only in the states of elements at rest.

    Of several such regimes it is the first: one in which some flanks part comes after those in which only some of these
    part.

    failed : int
        The regime in which locked flanks turned out to pull, or -1.
    event : int
        The friction whose guard turned negative, or -1.
    resting, locked : int
        The frictions and the lashes at rest, as bits.
    """
    system, count, combinations = at.system, at.system.friction_count, 1
    for k in range(count):
        combinations *= 3 if resting >> k & 1 else 1
    least, best, closed = np.inf, regime, locked
    while closed >= 0:
        base = regime
        for lash in range(system.lash_count):
            if (locked & ~closed) >> lash & 1:
                base = opened(system, base, lash)
                if not at.inputs[gap_input(lash)] > 0.0:  # without a gap, they close on the other side
                    was_positive = system.contacts[regime, lash].side > 0
                    base += (CLOSED_NEGATIVE if was_positive else CLOSED_POSITIVE) * system.regime_strides[lash]
        for number in range(combinations):
            candidate, digits = base, number
            for j in range(count):  # the state of the event's friction changes first
                k = (max(event, 0) + j) % count
                if resting >> k & 1:
                    candidate += (digits % 3 - system.friction_states[regime, k]) * stride_of_friction(system, k)
                    digits //= 3
            stays = candidate == failed
            if event >= 0:  # a friction that could stick no longer does not stick again
                states = system.friction_states[regime, event], system.friction_states[candidate, event]
                stays = states == (STICKS, STICKS)
            if stays or system.excess[system.regimes[candidate].flow]:
                continue
            misfit = _misfits(at, candidate, regime, locked, resting)
            if misfit == 0.0:
                return candidate
            if misfit < least:
                least, best = misfit, candidate
        closed = (closed - 1) & locked if closed > 0 else -1
    return best


@part
def _misfit_of_flanks(at: Moment, regime: int, before: int, lash: int) -> float:
    """Misfit of rigid flanks at rest, closed before, to their state in a regime, as a share of terms; see `_misfit`.

    The misfit of closed flanks is the torque that pulls at them; that of flanks that part, the torque that presses.
    """
    system, way = at.system, at.system.contacts[before, lash].side
    if system.contacts[regime, lash].side != way:
        way = -way
    torque, size, slope, slope_size = holding_torque(at, regime, lash)
    if -way * torque > at.within * size:
        return -way * torque / size
    is_zero = way * torque <= at.within * size
    return WITHIN if is_zero and way * slope < -at.within * slope_size else 0.0


@part
def holding_torque(at: Moment, regime: int, lash: int) -> tuple[float, float, float, float]:
    """The torque that keeps q'' at zero in a regime, the size of its terms, its rate, and the size of the rate's terms.

    Returns four numbers  [N m, N m, N m/s, N m/s]. The size of the torque's terms includes that of its rate times the
    time so far: a torque that has fallen to zero has the rounding of what it has fallen by.
    """
    force = lash * at.system.functionals_per_lash + FORCE
    torque, size = derivative(at, regime, force, 0)
    slope, slope_size = derivative(at, regime, force, 1)
    return torque, size + slope_size * at.time, slope, slope_size


@part
def _misfit(at: Moment, regime: int, friction: int) -> float:
    """Misfit of a friction at rest to its state in a regime, as a share of the terms; 0 where it fits.

    The misfit of a sticking friction is the torque beyond F; that of a slipping one, the acceleration against its slip.
    At the limit of a state it is `within` if the friction is about to leave that state, not by rounding alone: the rate
    of change that decides takes long to compute, and is computed at the limit only.
    """
    system, most, way = at.system, at.system.friction_torques[friction], 1.0
    state, functional, order = system.friction_states[regime, friction], rate_of_friction(system, friction), 2
    if state == STICKS:
        functional, order = functional + HOLDING, 1
        torque, size = derivative(at, regime, functional, 0)
        beyond, size, way = abs(torque) - most, size + most, -torque
        # with rigid flanks the limit begins at F, not only at the slightly larger torque that the friction holds
        limit = most / (1.0 + ABOVE) if system.impulsive else most
        is_at_limit = abs(torque) - limit > -at.within * size
    elif _is_held(system, regime, functional):
        return 0.0
    else:
        way = 1.0 if state == SLIPS_FORWARD else -1.0
        speeds_up, size = derivative(at, regime, functional, 1)
        beyond = -way * speeds_up
        is_at_limit = beyond > -at.within * size
    if beyond > at.within * size:
        return beyond / size
    if not is_at_limit:
        return 0.0
    onwards, size = derivative(at, regime, functional, order)
    return at.within if way * onwards < -at.within * size else 0.0


@part
def derivative(at: Moment, regime: int, functional: int, order: int) -> tuple[float, float]:
    """A functional's derivative by time in a regime, of order 0, 1 or 2, and the sum of its terms' magnitudes."""
    rows, size = at.system.outputs[at.system.regimes[regime].flow, functional, order], at.x.size
    value = by_inputs = magnitude = 0.0  # separate sums, which the processor adds up in parallel
    for k in range(size):
        value, magnitude = value + rows[0, k] * at.x[k], magnitude + rows[1, k] * abs(at.x[k])
    for k in range(at.inputs.size):
        weighed = at.system.weights[regime, k] * at.inputs[k]
        by_inputs, magnitude = by_inputs + rows[0, size + k] * weighed, magnitude + rows[1, size + k] * abs(weighed)
    return value + by_inputs, magnitude


@part
def _rate(system: System, weights: FloatArray, fastest: float, x: FloatArray) -> tuple[float, float]:
    """The rate that is weights (N,) times the state, and its bound by the fastest inertia's speed  [rad/s].

    fastest : float  [rad/s]
        The least speed that the bound assumes for the fastest inertia.
    """
    value = total = 0.0
    for k in range(system.inertias, 2 * system.inertias):
        value += weights[k] * x[k]
        total += abs(weights[k])
        fastest = max(fastest, abs(x[k]))
    return value, total * fastest


@part
def gap_coordinate(at: Moment, lash: int) -> tuple[float, float]:
    """q of a lash, and the sum of its terms' magnitudes  [rad]."""
    return twist_of(at.system, at.system.lashes[lash], at.x)


@part
def _is_held(system: System, regime: int, functional: int) -> bool:
    """Whether a functional of an element is identically zero in a regime, as others hold the element's twist."""
    flow = system.regimes[regime].flow
    by_state, by_inputs = system.functionals[flow, functional], system.feedthrough[flow, functional]
    # not by `any`: numba's imports scipy's linear algebra
    return weigh(by_state, by_state) + weigh(by_inputs, by_inputs) == 0.0


@part
def is_carried(at: Moment, regime: int, lash: int) -> bool:
    """Whether the rigid flanks of an open lash rest on each other, held there by other elements that stick or lock."""
    held = _is_held(at.system, regime, lash * at.system.functionals_per_lash + FORCE)
    return at.system.friction_count > 0 and held and rest(at, lash)


@part
def rest(at: Moment, lash: int) -> bool:
    """Whether the rigid flanks of a lash rest on each other, but for rounding."""
    half_gap, (twist, size) = at.inputs[gap_input(lash)], gap_coordinate(at, lash)
    rate, most = _rate(at.system, at.system.lashes[lash], 0.0, at.x)
    return half_gap - abs(twist) <= WITHIN * (half_gap + size) and abs(rate) <= WITHIN * most
