"""Rigid flanks, the restitution model: impacts, releases, and which lashes stay closed through them.

Where other lashes are closed, an impact acts on a driveline in which these are rigid joints. An impulse presses flanks
together and never pulls at them, so which closed lashes stay closed is decided for all of them at once. For flanks at
rest, whose torques only press, `clunk.core.rubbing` decides, together with frictions. In its choice, flanks may rest on
each other without a torque, where other constraints hold them: such a lash is open, but has not separated.
"""

import numpy as np

from clunk.core import rubbing
from clunk.core.arrays import FloatArray, Records
from clunk.core.events import INSTANT, LOCK, SEPARATION, STAGE, TOUCH
from clunk.core.jit import inlined_part, part
from clunk.core.regimes import ROUNDING, System, closed_lashes, gap_input, guard_of, lash_of, opened, speed_of
from clunk.core.runs import Entry, Log, Moment, record
from clunk.core.tables import CLOSED_NEGATIVE, CLOSED_POSITIVE, FORCE, GAP

# Share of its terms: a larger holding torque at a release means that a jump of the load parted the flanks.
_CLEARLY_NOT_ZERO = 1e-9
_MOST_IMPULSES = 100  # on each of the lashes that touch at one time
_STILL = 1e-9  # share of a lash's fastest touch: whether slower flanks of another lash approach, only rounding decides
_SWING = 0.1  # rad, amplitude assumed for the motion to come, whose rounding adds to that of a gap
# Share of the terms of a gap: the gap given to a lash at rest that parts beside another one; within twice that, two
# lashes touch at the same time.
_APART = 1e-13


@part
def strike(at: Moment, log: Log, regime: int, guard: int, speed: float, count: int) -> Entry:
    """Resolve a touch of rigid flanks: the impact, and the rebound or the lock that follows it at once.

    If the touch is faster than the locking speed, closed lashes that the impact would pull apart separate. A rebound
    not faster than the locking speed ends with q' = 0: the flanks lock, unless the torque that would hold them locked
    pulls at them; then they are open, with the gap at zero and about to open. Other open lashes that touch at the same
    time, as those of equal branches do, rebound or come to rest together with this one, each by its own speed before. A
    touch as slow as the fall of flanks that `_part_by` has moved apart leaves frictions stuck that stuck before.
    """
    system, x = at.system, at.x
    side, lash = system.guards[regime, guard].side, lash_of(system, regime, guard)
    speed = side * max(side * speed, 0.0)  # flanks that part within rounding may seem to touch as they move apart
    regime = opened(system, _resting_on(at, log, regime, count), lash)
    slowest, before = _locking_speed(at, log, regime, lash, speed), regime
    rebounds = system.restitution[lash] * abs(speed) > slowest
    held = closed = closed_lashes(system, regime, lash)
    if abs(speed) > slowest:
        held = _held_through(system, regime, lash, side, at.inputs)
    parted = closed & ~held
    for other in range(system.lash_count):
        if parted >> other & 1:
            # first the lash that touches: placed later, it would move the others
            _place(system, held, lash, x, 0, side * at.inputs[gap_input(lash)])
            _part_by(ROUNDING, at, held, other, system.contacts[before, other].side)
            regime = opened(system, regime, other)
    events = log.events
    events[count].lash, events[count].speed, events[count].side = lash, speed, side
    touches = events[count : _note_touches_beside(at, log, before, lash, rebounds, count)]
    _strike_together(system, held, rebounds, x, touches)
    stops = system.friction_count > 0 and abs(speed) <= _falling_speed(at, regime, lash, 2.0 * _APART)
    fastest = abs(speed)
    if stops:  # rates up to those that this touch gives count as rounding
        for k in range(x.size):
            fastest = max(fastest, abs(speed * system.impulse[held, lash, k]))
        fastest /= rubbing.WITHIN
    for _ in range(_MOST_IMPULSES if stops else touches.size**4):  # placing one moves the others, by less each time
        if stops:  # else stuck frictions would slip, and flanks part and touch again, slower and slower, without end
            regime = rubbing.in_motion(system, regime, fastest, x)
            rubbing.stop_all(system, regime, x)
            keep_locked(system, regime, x, at.inputs)
        touched, resting = 0, held
        for touch in touches:
            gap = touch.side * at.inputs[gap_input(touch.lash)]
            if touches.size > 1:  # else they would no longer touch at one time once they are slow
                _place(system, held, touch.lash, x, 0, gap)
            if not rebounds:
                _hold(system, resting, touch.lash, x, gap)
            touched, resting = touched | 1 << touch.lash, resting | 1 << touch.lash
    if system.friction_count > 0:
        regime = rubbing.in_motion(system, regime, fastest, x)
        rubbing.stick_all(system, x, at.inputs)
    for touch in touches:
        record(at, log, count, touch.speed, TOUCH, regime, touch.lash, touch.side)
        count += 1
    for other in range(system.lash_count):
        if parted >> other & 1:
            record(at, log, count, 0.0, SEPARATION, regime, other, system.contacts[before, other].side)
            count += 1
    if rebounds:
        return Entry(count, regime, _touch_of(system, regime, lash, side), 1)
    for touch in touches:
        regime = system.guards[regime, _touch_of(system, regime, touch.lash, touch.side)].successor
    return enter_chosen(at, log, regime, -1, touched, count)


@part
def _note_touches_beside(at: Moment, log: Log, regime: int, lash: int, rebounds: bool, count: int) -> int:
    """Write lash, speed and side of other open lashes that touch at the same time, as those of equal branches do.

    Only those that rebound, or come to rest, as `lash` does are written, behind event `count`, the touch of `lash`.
    Returns the number of events with these.
    """
    system, events = at.system, log.events
    for other in range(system.lash_count):
        twist, _ = rubbing.gap_coordinate(at, other)
        its_speed = speed_of(system, other, at.x)
        gap = at.inputs[gap_input(other)]
        moved = _APART * _terms_of_gap(at, other)  # as `_part_by` may have moved this lash or the one that touches
        is_near = abs(gap - twist * np.sign(its_speed)) <= INSTANT * abs(its_speed) + 2.0 * moved
        is_near &= abs(its_speed) > _STILL * log.courses[lash].fastest
        if other == lash or system.contacts[regime, other].closed or not is_near:
            continue
        slowest = _locking_speed(at, log, regime, other, its_speed)
        if (system.restitution[other] * abs(its_speed) > slowest) == rebounds:
            count += 1
            events[count].lash, events[count].speed = other, its_speed
            events[count].side = 1 if its_speed > 0.0 else -1
    return count + 1


@part
def _strike_together(system: System, held: int, rebounds: bool, x: FloatArray, touches: Records) -> None:
    """Apply the impulses of lashes that touch at one time: θ' -= (1 + e) q' M⁻¹l/(lᵀM⁻¹l), report Eq. 2.9.

    M has the lashes in `held` as rigid joints, and e is 0 without rebound. Of several lashes, each in turn takes an
    impulse that brings it to its final speed, and changes the speeds of the others by less, until all have theirs.
    """
    for _ in range(_MOST_IMPULSES if touches.size > 1 else 1):
        is_done = True
        for touch in touches:
            excess = speed_of(system, touch.lash, x)
            if rebounds:
                excess += system.restitution[touch.lash] * touch.speed
            for k in range(x.size):
                x[k] -= excess * system.impulse[held, touch.lash, k]
            is_done = is_done and abs(excess) <= ROUNDING * abs(touch.speed)
        if is_done:
            break


@part
def _held_through(system: System, regime: int, lash: int, side: int, inputs: FloatArray) -> int:
    """The closed lashes of a regime, as bits, that stay closed through an impact on a flank of another lash.

    An impulse presses flanks together, and does not act on flanks that it lets part. One set of closed lashes fulfils
    this, and only one but for lashes through which no impulse passes, which stay closed. A lash without a gap always
    stays closed, as it has a flank on either side.
    """
    closed, always = closed_lashes(system, regime, lash), 0  # `always`: those with a flank on either side
    for other in range(system.lash_count):
        always |= (closed >> other & 1 and inputs[gap_input(other)] <= 0.0) << other
    held = closed
    while held > always:
        fits = held & always == always
        for other in range(system.lash_count):
            if fits and closed >> other & 1 and not always >> other & 1:
                pressing = side * system.contacts[regime, other].side
                if held >> other & 1:
                    through, size = system.passed[held, lash, other], system.passed[held, lash, lash]
                    fits = pressing * through >= -ROUNDING * size
                else:
                    moved = size = 0.0
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
def _touch_of(system: System, regime: int, lash: int, side: int) -> int:
    """The guard of a regime that is the gap of an open lash on one side."""
    return guard_of(system, regime, lash * system.functionals_per_lash + GAP, float(-side))


@part
def enter_chosen(at: Moment, log: Log, regime: int, ended: int, touched: int, count: int) -> Entry:
    """Entry into the regime that `rubbing.choose_states` chooses; writes the events that this choice makes.

    ended : int
        The guard that turned negative, or -1.
    touched : int
        The lashes that touch at this moment, as bits: each of them locks, or counts as never closed.
    """
    system, x, before = at.system, at.x, _resting_on(at, log, regime, count)
    successor, zero_guard, zero_order = rubbing.choose_states(at, regime, before, ended)
    lashes, held = range(system.lash_count * system.impulsive), closed_lashes(system, successor, -1)
    for lash in lashes:
        if touched >> lash & 1 and (held >> lash & 1 or rubbing.is_carried(at, successor, lash)):
            record(at, log, count, 0.0, LOCK, successor, lash, system.contacts[regime, lash].side)
            count += 1
    # Separations of flanks at rest. Flanks that were closed are now open, or, without a gap, closed on the other side,
    # which is a separation, a touch and a lock.
    # resting: flanks on each other, closed or not; near: also those so near that parting others could close them
    resting = near = 0
    for lash in lashes:
        rests = system.contacts[before, lash].closed != 0 or rubbing.rest(at, lash)
        gap = at.inputs[gap_input(lash)] - abs(rubbing.gap_coordinate(at, lash)[0])
        resting |= rests << lash
        near |= (rests or gap <= 2.0 * _APART * _terms_of_gap(at, lash)) << lash
    for lash in lashes:
        side, now = system.contacts[before, lash].side, system.contacts[successor, lash].side
        others = near & ~(1 << lash)
        if side == 0 and resting & others & ~held and resting >> lash & 1:  # releasing the others would move this one
            twist, _ = rubbing.gap_coordinate(at, lash)
            _part_by(_APART, at, others, lash, 1 if twist > 0.0 else -1)
        if side in (0, now):
            continue
        is_carried = now == 0 and rubbing.is_carried(at, successor, lash)
        torque_held, scale, slope, _ = rubbing.holding_torque(at, successor, lash)
        # where a jump of the load parts the flanks, q'' is not zero
        clearly = abs(torque_held) > _CLEARLY_NOT_ZERO * scale
        if now:
            _hold(system, held & ~(1 << lash), lash, x, 0.0)
            if zero_guard < 0 and not clearly:  # the torque is zero, though its rounding may pull
                force = lash * system.functionals_per_lash + FORCE
                zero_guard, zero_order = guard_of(system, successor, force, float(now)), 1
        elif not is_carried and zero_guard < 0 and (clearly or system.lash_count == 1):
            # The flanks are released where they were held, without the rounding added up since. Where their torque is
            # zero, q'' is zero too, and the torque's slope decides, unless that presses.
            zero_guard = _touch_of(system, successor, lash, side)
            zero_order = 2 if clearly or side * slope > 0.0 else 3
            _hold(system, others, lash, x, side * at.inputs[gap_input(lash)])
        else:
            _part_by(_APART, at, others, lash, side)
        if is_carried:
            rubbing.stick_all(system, x, at.inputs)
        elif not touched >> lash & 1:
            free = opened(system, successor, lash)
            record(at, log, count, 0.0, SEPARATION, free, lash, side)
            count += 1
            if now:
                record(at, log, count, 0.0, TOUCH, free, lash, now)
                record(at, log, count + 1, 0.0, LOCK, successor, lash, now)
                count += 2
    if log.states.shape[0] > 0 and log.events[count - 1].regime != successor:
        record(at, log, count, 0.0, STAGE, successor, -1, 0)
        count += 1
    return Entry(count, successor, zero_guard, zero_order)


@part
def _resting_on(at: Moment, log: Log, regime: int, count: int) -> int:
    """A regime with those open lashes closed whose flanks others hold and whose last event is no separation."""
    system, events = at.system, log.events
    for lash in range(system.lash_count * system.impulsive if system.friction_count > 0 else 0):
        if not system.contacts[regime, lash].closed and rubbing.is_carried(at, regime, lash):
            last = count - 1
            while last > 0 and events[last].lash != lash:
                last -= 1
            if events[last].kind != SEPARATION:
                twist, _ = rubbing.gap_coordinate(at, lash)
                regime += (CLOSED_POSITIVE if twist > 0.0 else CLOSED_NEGATIVE) * system.regime_strides[lash]
    return regime


@part
def _part_by(share: float, at: Moment, held: int, lash: int, side: int) -> None:
    """Move flanks in contact apart by a share of the terms of their gap, so that rounding does not close the gap."""
    _place(at.system, held, lash, at.x, 0, side * (at.inputs[gap_input(lash)] - share * _terms_of_gap(at, lash)))


@inlined_part
def _terms_of_gap(at: Moment, lash: int) -> float:
    """Size of the terms that round the gap of a lash, now and in the motion to come  [rad]."""
    _, size = rubbing.gap_coordinate(at, lash)
    return at.inputs[gap_input(lash)] + size + _SWING


@part
def _locking_speed(at: Moment, log: Log, regime: int, lash: int, speed: float) -> float:
    """The speed up to which rebounds of a lash lock: its locking speed, or a speed whose rebound is as low as rounding.

    speed : float  [rad/s]
        Of a touch, which is taken into the lash's COURSE, as it may be the fastest so far.
    """
    tolerance, course = at.system.locking_speed[lash], log.courses[lash]
    course.fastest = max(course.fastest, abs(speed))
    # flanks that `_part_by` has moved by ROUNDING fall back at half the last of these speeds
    return max(tolerance, -tolerance * course.fastest, _falling_speed(at, regime, lash, 4.0 * ROUNDING))


@part
def _falling_speed(at: Moment, regime: int, lash: int, share: float) -> float:
    """The speed of flanks that fall, by their q'' in a regime, through a share of the terms of their gap  [rad/s]."""
    pull, _ = rubbing.derivative(at, regime, lash * at.system.functionals_per_lash + GAP, 2)
    return np.sqrt(2.0 * abs(pull) * share * _terms_of_gap(at, lash))


@part
def keep_locked(system: System, regime: int, x: FloatArray, inputs: FloatArray) -> None:
    """Bring locked flanks back to q = s φ/2 and q' = 0, from which rounding moves them step by step."""
    for lash in range(system.lash_count * system.impulsive):
        contact = system.contacts[regime, lash]
        if contact.closed:
            _hold(system, closed_lashes(system, regime, lash), lash, x, contact.side * inputs[gap_input(lash)])


@part
def _hold(system: System, held: int, lash: int, x: FloatArray, gap: float) -> None:
    """Make q = `gap` and q' = 0 by a change like an impulse's, which moves no centre of mass and no lash in `held`."""
    _place(system, held, lash, x, 0, gap)
    _place(system, held, lash, x, system.inertias, 0.0)


@part
def _place(system: System, held: int, lash: int, x: FloatArray, first: int, target: float) -> None:
    """Make q = `target` in the angles (`first` is 0), or q' = `target` in the speeds (`first` is n).

    The last of the inertias at the lash that turn as q does, not through the gear ratio, takes the remaining rounding,
    so that q' is zero to the last bit where that is the target.
    """
    n, row, impulse = system.inertias, system.lashes[lash], system.impulse[held, lash]
    excess = -target
    last = -1
    for k in range(n):
        excess += row[n + k] * x[first + k]
    rest = -target
    for k in range(n):
        weight = row[n + k]
        if weight != 0.0 or held:
            x[first + k] -= excess * impulse[n + k]
        if weight != 0.0:
            rest += weight * x[first + k]
            if last < 0 or abs(weight) == 1.0:
                last = k
    rest -= row[n + last] * x[first + last]
    x[first + last] = -rest / row[n + last]
