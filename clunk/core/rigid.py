"""Rigid flanks, the restitution model: impacts, releases, and which lashes stay closed through them.

Where other lashes are closed, an impact is one of a driveline with these as rigid joints. An impulse presses flanks
together and never pulls them: which of the closed lashes stay so is decided for all of them at once. So it is with the
torques of flanks at rest, together with those of frictions: `clunk.core.rubbing`. There flanks may come to rest on each
other without a torque, where others hold them: they are open, but have not separated.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import rubbing
from clunk.core.events import INSTANT, LOCK, SEPARATION, STAGE, TOUCH
from clunk.core.jit import inlined_part, part
from clunk.core.regimes import (
    ROUNDING,
    System,
    frictions_of,
    gap_input,
    guard_of,
    lash_of,
    lashes_of,
    opened,
)
from clunk.core.runs import Entry, Log, record
from clunk.core.tables import CLOSED_NEGATIVE, CLOSED_POSITIVE, FORCE, GAP

FloatArray = npt.NDArray[np.float64]

# Share of its terms: a larger holding torque at a release means that a jump of the load parted the flanks.
_CLEARLY_NOT_ZERO = 1e-9
_MOST_IMPULSES = 100  # on each of the lashes that touch at one time
_APART = 1e-12  # of its terms: the gap with which a lash at rest begins to part beside another one, or touches with it


@part
def strike(
    system: System,
    regime: int,
    guard: int,
    time: float,
    speed: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
    fastest: FloatArray,
) -> Entry:
    """A touch of the restitution model, and the lock that may follow it at once.

    Closed lashes that it would pull apart part with it, if it is faster than the locking speed. A rebound not faster
    than that ends with q' = 0: then the flanks lock, unless the torque that holds them so would pull: then they are
    open, with the gap at zero and about to open. Where other open lashes touch at the same time, as those of equal
    branches do, all of them rebound, or come to rest, by their speeds before.
    """
    side, lash = system.guards[regime, guard].side, lash_of(system, regime, guard)
    fastest[lash] = max(fastest[lash], abs(speed))
    regime = opened(system, _resting_on(system, regime, x, inputs, log, count), lash)
    slowest, before = _locking_speed(system, regime, lash, x, inputs, fastest[lash]), regime
    rebounds = system.restitution[lash] * abs(speed) > slowest
    held = held_with(system, regime, lash)
    if held != 0 and abs(speed) > slowest:
        held = _held_through(system, regime, lash, side, inputs)
    for other in range(lashes_of(system)):
        if system.contacts[before, other].closed != 0 and not held >> other & 1:
            _part_by(ROUNDING, system, held, other, system.contacts[before, other].side, x, inputs)
            regime = opened(system, regime, other)
    first = last = count
    if rebounds or frictions_of(system) == 0:
        last = _note_touches_beside(system, before, lash, rebounds, x, inputs, log, count, fastest)
    if rebounds:  # θ' -= (1 + e) q' M⁻¹l/(lᵀM⁻¹l), report Eq. 2.9, M with what holds as rigid joints
        for k in range(x.size):
            x[k] -= (1.0 + system.restitution[lash]) * speed * system.impulse[held, lash, k]
    if last > first:
        _strike_together(system, held, lash, speed, rebounds, x, log, first, last)
    if not rebounds:
        _hold(system, held, lash, x, side * inputs[gap_input(lash)])
    if frictions_of(system) > 0:
        regime = rubbing.in_motion(system, regime, abs(speed), x)
        rubbing.stick_all(system, x, inputs)
    record(log, first, time, speed, TOUCH, regime, lash, side, x)
    for k in range(first + 1, last + 1):
        event = log.events[k]
        record(log, k, time, event.speed, TOUCH, regime, event.lash, 1 if event.speed > 0.0 else -1, x)
    count = last + 1
    for other in range(lashes_of(system)):
        if system.contacts[before, other].closed != 0 and not held >> other & 1:
            record(log, count, time, 0.0, SEPARATION, regime, other, system.contacts[before, other].side, x)
            count += 1
    guard = _touch_of(system, regime, lash, side)
    if rebounds:
        return Entry(count, regime, guard, 1)
    if frictions_of(system) > 0:
        return enter_chosen(system, system.guards[regime, guard].successor, -1, lash, time, x, inputs, log, count)
    stays_open = -1
    for k in range(first, last + 1):
        lash, side = log.events[k].lash, log.events[k].side
        if k > first:
            _hold(system, held_with(system, regime, lash), lash, x, side * inputs[gap_input(lash)])
        torque_held, slope, scale = holding_torque(system, regime, lash, x, inputs)
        pressing = side * torque_held
        if abs(pressing) <= ROUNDING * scale:  # zero: what it turns into decides
            pressing = side * slope
        if not pressing >= 0.0:
            stays_open = k
            continue
        regime = system.guards[regime, _touch_of(system, regime, lash, side)].successor
        record(log, count, time, 0.0, LOCK, regime, lash, side, x)
        count += 1
    if stays_open < 0:
        return Entry(count, regime, -1, 0)
    return Entry(count, regime, _touch_of(system, regime, log.events[stays_open].lash, log.events[stays_open].side), 2)


@part
def _note_touches_beside(
    system: System,
    regime: int,
    lash: int,
    rebounds: bool,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
    fastest: FloatArray,
) -> int:
    """Write lash and speed of the other open lashes that touch at the same time, as those of equal branches do.

    Of these, the ones that rebound, or do not, as the lash itself. They are behind the event `count`, which will be the
    touch of the lash; returns the number of the last of them.
    """
    last = count
    for other in range(lashes_of(system)):
        (twist, size), speed = rubbing.twist_of(system, system.lashes[other], x), 0.0
        for k in range(x.size):
            speed += system.lashes[other, k] * x[k]
        is_near = abs(inputs[gap_input(other)] - twist * np.sign(speed)) <= INSTANT * abs(speed) + _APART * size
        if other == lash or system.contacts[regime, other].closed != 0 or not is_near:
            continue
        fastest[other] = max(fastest[other], abs(speed))
        slowest = _locking_speed(system, regime, other, x, inputs, fastest[other])
        if (system.restitution[other] * abs(speed) > slowest) == rebounds:
            last += 1
            log.events[last].lash, log.events[last].speed = other, speed
    return last


@part
def _strike_together(
    system: System,
    held: int,
    lash: int,
    speed: float,
    rebounds: bool,
    x: FloatArray,
    log: Log,
    first: int,
    last: int,
) -> None:
    """Give lashes that touch at one time the speeds that they shall have, each by its own before the impacts.

    One impulse after the other brings its lash to its speed, and changes others by less, until all have theirs.
    """
    for _ in range(_MOST_IMPULSES):
        furthest = 0.0
        for k in range(first, last + 1):
            struck, before = (lash, speed) if k == first else (log.events[k].lash, log.events[k].speed)
            excess = system.restitution[struck] * before if rebounds else 0.0
            for j in range(x.size):
                excess += system.lashes[struck, j] * x[j]
            for j in range(x.size):
                x[j] -= excess * system.impulse[held, struck, j]
            furthest = max(furthest, abs(excess) / abs(before))
        if furthest <= ROUNDING:
            break


@part
def _held_through(system: System, regime: int, lash: int, side: int, inputs: FloatArray) -> int:
    """The closed lashes of a regime, as bits, that an impact on a flank of another one leaves closed.

    An impulse presses flanks together, and does not act on those that it lets part: of all sets of closed lashes the
    one for which that holds, and there is only one but for lashes through which nothing passes, which stay closed.
    Without a gap, there is a flank on either side.
    """
    closed, always = held_with(system, regime, lash), 0  # those with a flank on either side
    for other in range(lashes_of(system)):
        always |= (closed >> other & 1 and inputs[gap_input(other)] <= 0.0) << other
    held = closed
    while held > always:
        fits = held & always == always
        for other in range(lashes_of(system)):
            if fits and closed >> other & 1 and not always >> other & 1:
                pressing = side * system.contacts[regime, other].side
                if held >> other & 1:
                    through, size = system.passed[held, lash, other], system.passed[held, lash, lash]
                    fits = pressing * through >= -ROUNDING * size
                else:
                    moved, size = 0.0, 0.0
                    for k in range(system.lashes.shape[1]):
                        term = system.lashes[other, k] * system.impulse[held, lash, k]
                        moved += term
                        size += abs(term)
                    fits = pressing * moved > ROUNDING * size
        if fits:
            break
        held = (held - 1) & closed
    return held


@inlined_part
def held_with(system: System, regime: int, lash: int) -> int:
    """The closed lashes of a regime, as bits, but for one; -1 for none."""
    held = 0
    for other in range(lashes_of(system)):
        held |= (other != lash and system.contacts[regime, other].closed != 0) << other
    return held


@inlined_part
def _touch_of(system: System, regime: int, lash: int, side: int) -> int:
    """The guard of a regime that is the gap of an open lash to one of its flanks."""
    return guard_of(system, regime, lash * system.functionals_per_lash + GAP, float(-side))


@part
def release(
    system: System,
    regime: int,
    guard: int,
    time: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
) -> Entry:
    """A separation of the restitution model; without a gap the flanks lock on the other side at once.

    Where several lashes are closed or frictions stick, those part that can, whichever one's torque turned first.
    """
    row, lash = system.guards[regime, guard], lash_of(system, regime, guard)
    side, half_gap, others = row.side, inputs[gap_input(lash)], held_with(system, regime, lash)
    if half_gap <= 0.0:  # no free state
        _hold(system, others, lash, x, side * half_gap)
        record(log, count, time, 0.0, row.event_kind, row.successor, lash, side, x)
        free = opened(system, regime, lash)
        successor = free + (CLOSED_NEGATIVE if side > 0 else CLOSED_POSITIVE) * system.regime_strides[lash]
        record(log, count + 1, time, 0.0, TOUCH, free, lash, -side, x)
        record(log, count + 2, time, 0.0, LOCK, successor, lash, -side, x)
        return Entry(count + 3, successor, 0, 1)
    if others != 0 or frictions_of(system) > 0:
        return enter_chosen(system, regime, guard, -1, time, x, inputs, log, count)
    return _part(system, regime, -1, Entry(count, row.successor, -1, 0), time, x, inputs, log)


@part
def enter_chosen(
    system: System,
    regime: int,
    ended: int,
    touched: int,
    time: float,
    x: FloatArray,
    inputs: FloatArray,
    log: Log,
    count: int,
) -> Entry:
    """Entry into the regime of `rubbing.choose_states`, with the events that this makes.

    touched : int
        The lash that touches at this moment, which locks or never was closed, or -1.
    """
    before = _resting_on(system, regime, x, inputs, log, count)
    successor, zero_guard, zero_order = rubbing.choose_states(system, regime, before, ended, time, x, inputs)
    rests = touched >= 0 and rubbing.is_carried(system, successor, touched, x, inputs)
    if touched >= 0 and (rests or system.contacts[successor, touched].closed != 0):
        record(log, count, time, 0.0, LOCK, successor, touched, system.contacts[regime, touched].side, x)
        count += 1
    entry = _part(system, before, touched, Entry(count, successor, zero_guard, zero_order), time, x, inputs, log)
    count = entry.written
    if log.states.shape[0] > 0 and log.events[count - 1].regime != successor:
        record(log, count, time, 0.0, STAGE, successor, -1, 0, x)
        count += 1
    return Entry(count, successor, entry.zero_guard, entry.zero_order)


@part
def _resting_on(system: System, regime: int, x: FloatArray, inputs: FloatArray, log: Log, count: int) -> int:
    """The regime with those lashes closed that have not separated, as the log tells, and whose flanks others hold."""
    for lash in range(lashes_of(system) if frictions_of(system) > 0 and system.impulsive != 0 else 0):
        if system.contacts[regime, lash].closed == 0 and rubbing.is_carried(system, regime, lash, x, inputs):
            last = count - 1
            while last > 0 and log.events[last].lash != lash:
                last -= 1
            if log.events[last].kind != SEPARATION:
                twist, _ = rubbing.twist_of(system, system.lashes[lash], x)
                regime += (CLOSED_POSITIVE if twist > 0.0 else CLOSED_NEGATIVE) * system.regime_strides[lash]
    return int(regime)


@part
def _part(
    system: System, before: int, touched: int, entry: Entry, time: float, x: FloatArray, inputs: FloatArray, log: Log
) -> Entry:
    """Separations of flanks at rest: of those closed in the regime before, and open in the one that is entered.

    touched : int
        The lash that touches at this moment, whose flanks do not separate, or -1.
    """
    count, held, first, carried = entry.written, held_with(system, entry.regime, -1), -1, 0
    for lash in range(lashes_of(system)):
        side = system.contacts[before, lash].side
        if system.contacts[before, lash].closed == 0 or held >> lash & 1:
            continue
        if rubbing.is_carried(system, entry.regime, lash, x, inputs):
            _part_by(_APART, system, held, lash, side, x, inputs)
            rubbing.stick_all(system, x, inputs)
            carried |= 1 << lash
        elif first < 0 and entry.zero_guard < 0:  # released where it was held, but for what rounding has added up
            first = lash
            _hold(system, held, lash, x, side * inputs[gap_input(lash)])
        else:
            _part_by(_APART, system, held, lash, side, x, inputs)
    for lash in range(lashes_of(system)):
        contact = system.contacts[before, lash]
        if contact.closed != 0 and not (held | carried) >> lash & 1 and lash != touched:
            record(log, count, time, 0.0, SEPARATION, entry.regime, lash, contact.side, x)
            count += 1
    if first < 0:
        return Entry(count, entry.regime, entry.zero_guard, entry.zero_order)
    torque_held, slope, scale = holding_torque(system, entry.regime, first, x, inputs)
    # where a jump parts them, q'' is not zero; unless it presses, nothing but the load's slope may tell what zero is
    side = system.contacts[before, first].side
    clearly = abs(torque_held) > _CLEARLY_NOT_ZERO * (scale + abs(slope) * time) or side * slope > 0.0
    return Entry(count, entry.regime, _touch_of(system, entry.regime, first, side), 2 if clearly else 3)


@part
def _part_by(share: float, system: System, held: int, lash: int, side: int, x: FloatArray, inputs: FloatArray) -> None:
    """Move closed flanks apart by a share of the terms of their gap, so that rounding does not close it."""
    gap, (_, size) = inputs[gap_input(lash)], rubbing.twist_of(system, system.lashes[lash], x)
    _hold(system, held, lash, x, side * (gap - share * (gap + size)))


@part
def _locking_speed(system: System, regime: int, lash: int, x: FloatArray, inputs: FloatArray, fastest: float) -> float:
    """The speed at which touches in a regime count as at rest, or the one at which a rebound is as low as rounding."""
    tolerance = system.locking_speed[lash]
    tolerance = tolerance if tolerance >= 0.0 else -tolerance * fastest
    # a rebound lower than the rounding of the gap cannot be followed
    pull, _ = rubbing.change_of(system, regime, system.lashes[lash], x, inputs)
    _, place = rubbing.twist_of(system, system.lashes[lash], x)
    return float(max(tolerance, np.sqrt(2.0 * abs(pull) * ROUNDING * place)))


@part
def holding_torque(
    system: System, regime: int, lash: int, x: FloatArray, inputs: FloatArray
) -> tuple[float, float, float]:
    """The torque that keeps q'' at zero, its rate of change in a regime, and the size of the terms that make it."""
    force = lash * system.functionals_per_lash + FORCE
    torque_held, scale = rubbing.holding(system, regime, force, x, inputs)
    return torque_held, rubbing.holding_slope(system, regime, force, x, inputs)[0], scale


@part
def _hold(system: System, held: int, lash: int, x: FloatArray, gap: float) -> None:
    """Make q = `gap` and q' = 0 as an impulse would, which moves neither the centre of mass nor the lashes that hold.

    The last of the inertias at the lash that turn as q does, not through the gear ratio, then takes what is left of
    rounding, so that q' is zero to the last bit.
    """
    n, row, impulse = system.inertias, system.lashes[lash], system.impulse[held, lash]
    for first, target in ((0, gap), (n, 0.0)):
        excess = -target
        last = -1
        for k in range(n):
            excess += row[n + k] * x[first + k]
        rest = -target
        for k in range(n):
            weight = row[n + k]
            if weight != 0.0 or held != 0:
                x[first + k] -= excess * impulse[n + k]
            if weight != 0.0:
                rest += weight * x[first + k]
                if last < 0 or abs(weight) == 1.0:
                    last = k
        rest -= row[n + last] * x[first + last]
        x[first + last] = -rest / row[n + last]
