"""Fixed-step RK4 with zero-crossing bisection through the regimes of a switched linear system.

On a linear regime a full step is one precomputed matrix product. It also yields each guard's value and a bound on how
far the guard bends within the step; while that shows that no guard can turn negative, nothing else is done (`coast`).
Where it does not, and right after every event, the step is expanded into its quartics, zeros are located by bisection,
and the rest of the step is finished in the successor regime, so that the time grid stays at multiples of the step.
"""

import numpy as np
import numpy.typing as npt

from clunk.core import polynomial
from clunk.core.events import LOAD_STEP, LOCK, TOUCH
from clunk.core.jit import compiled, inlined
from clunk.core.regimes import (
    ACCELERATION,
    BEND,
    BLOCK,
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
from clunk.core.sequence import find_primaries
from clunk.core.severity import window_extremes
from clunk.core.status import INTERRUPTED, Status

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NON_FINITE = int(Status.NON_FINITE)
_EVENT_BUFFER_FULL = int(Status.EVENT_BUFFER_FULL)

_STRIDE = 256  # full steps between two looks at whether the run is settled, and at the stop flag
# A remainder of a step shorter than this share of it is merged with the next one: right after an event the guard grows
# from zero, and needs some time to stand clear of rounding.
_SHORTEST = 0.01
_ROUNDING = 8 * float(np.finfo(np.float64).eps)  # relative to the terms of a sum of a few products


@compiled
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


@compiled
def closed_on(side: int) -> int:
    """The regime of contact on the flank of `side` (+1 or -1)."""
    return CLOSED_POSITIVE if side > 0 else CLOSED_NEGATIVE


@compiled
def regime_of(system: System, x: FloatArray, half_gap: float) -> int:
    """The regime that a given state is in: by its gap, and for separation by force by its contact force too.

    In the restitution model it is the open one; flanks that rest on each other lock by a touch at rest.
    """
    if system.impulsive != 0:
        return OPEN
    for regime in (CLOSED_POSITIVE, CLOSED_NEGATIVE, PARTED_POSITIVE, PARTED_NEGATIVE):
        side = system.side[regime]
        if side * _functional(system, 0, GAP, x) < half_gap:
            continue
        if _guard(system, regime, 0, x, half_gap) >= 0.0 or regime >= PARTED_POSITIVE:
            return regime
        if system.guard_functional[regime, 0] == FORCE:
            return PARTED_POSITIVE if side > 0 else PARTED_NEGATIVE
    return OPEN


@compiled
def _functional(system: System, flow: int, which: int, x: FloatArray) -> float:
    value = 0.0
    for k in range(x.size):
        value += system.functionals[flow, which, k] * x[k]
    return value


@compiled
def _guard(system: System, regime: int, guard: int, x: FloatArray, half_gap: float) -> float:
    value = _functional(system, system.flow[regime], system.guard_functional[regime, guard], x)
    return float(system.guard_sign[regime, guard] * value + system.guard_offset[regime, guard] * half_gap)


@compiled
def run(
    system: System,
    x: FloatArray,
    regime: int,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    stop: npt.NDArray[np.uint8],
) -> tuple[int, int, bool, float]:
    """Run from the load step to the end time, or until it is proved that nothing can follow.

    Parameters
    ----------
    system : System
    x : (N,) float64  [rad, rad/s]
        State at the load step; overwritten by the state at the end.
    regime : int
        The regime that `x` is in.
    torque : float  [N m]
        Load torque after the step.
    half_gap : float  [rad]
    events : (capacity,) EVENT
        Output. Event 0 is the load step.
    states : (capacity, N) float64  [rad, rad/s]
        Output: the state at each event; or no rows at all, and none are kept.
    stop : (1,) uint8
        Set to non-zero from another thread to abandon the run.

    Returns
    -------
    status : int
    count : int
        Events written, the load step included.
    complete : bool
        Whether it was proved that no event and no larger acceleration in an open window can follow.
    end : float  [s after the load step]
        Where the run stopped.
    """
    size = x.size
    columns, outputs = system.transfer.shape[1], system.observe.shape[2]
    affine, block_affine = np.empty(system.transfer.shape[2]), np.empty(system.block.shape[2])
    z, scratch = np.zeros(affine.size), np.zeros(block_affine.size)
    taylor = np.empty((5, size))
    guard_at, guard_sign, guard_shift = np.empty(2, np.int64), np.empty(2), np.empty(2)
    primaries = np.empty(events.size, np.int64)
    step = system.step
    full_steps = int(np.floor(system.end_time / step + 1e-9))
    rest = system.end_time - full_steps * step
    last_steps = full_steps + 1 if rest > 1e-9 * step else full_steps

    count = 1
    _record(events, states, 0, 0.0, 0.0, LOAD_STEP, regime, system.side[regime], x)
    index, offset = 0, 0.0  # the time is index · step + offset
    zero_guard, zero_order = -1, 0
    fastest = 0.0  # touch so far [rad/s]
    while True:
        flow = system.flow[regime]
        gap_input = system.side[regime] * half_gap
        transfer, block = system.transfer[flow], system.block[flow]
        _combine(system.transfer_input[flow], torque, gap_input, affine)
        _combine(system.block_input[flow], torque, gap_input, block_affine)
        for k in range(2):
            guard = min(k, system.guards[regime] - 1)  # a single guard stands for two
            guard_at[k] = 4 * system.guard_functional[regime, guard]
            guard_sign[k] = system.guard_sign[regime, guard]
            guard_shift[k] = system.guard_offset[regime, guard] * half_gap
        largest, smallest = -np.inf, np.inf
        while True:
            # one step, or what is left of it, with everything located
            length = (step if index < full_steps else rest) - offset
            steps = 1
            if length < _SHORTEST * step and index + 1 < last_steps:
                length += step if index + 1 < full_steps else rest
                steps = 2
            _expand(system, flow, x, torque, gap_input, taylor)
            s, guard = _first_event(system, regime, torque, half_gap, taylor, max(length, 0.0), zero_guard, zero_order)
            high, low = _acceleration_extremes(system, flow, torque, gap_input, taylor, s)
            largest, smallest = max(largest, high), min(smallest, low)
            events[count - 1].max_acceleration = largest
            events[count - 1].min_acceleration = smallest
            for k in range(size):
                x[k] = polynomial.evaluate(taylor[0, k], taylor[1, k], taylor[2, k], taylor[3, k], taylor[4, k], s)
                if not np.isfinite(x[k]):
                    return _NON_FINITE, count, False, index * step + offset
            if guard >= 0:
                offset += s
                break
            index, offset, zero_guard = index + steps, 0.0, -1

            # full steps as long as nothing can happen in them
            _load(system, flow, x, torque, gap_input, z, columns)
            clear = True
            while clear and index < full_steps:
                budget = min(_STRIDE, full_steps - index)
                taken, largest, smallest = _coast(
                    block,
                    block_affine,
                    transfer,
                    affine,
                    outputs,
                    guard_at,
                    guard_sign,
                    guard_shift,
                    z,
                    scratch,
                    budget,
                    largest,
                    smallest,
                )
                index += taken
                clear = taken == budget
                if stop[0] != 0:
                    return INTERRUPTED, count, False, index * step
                if clear and (taken == _STRIDE or index == full_steps):
                    events[count - 1].max_acceleration = largest
                    events[count - 1].min_acceleration = smallest
                    if _settled(system, regime, torque, half_gap, z, events, count, primaries):
                        x[:] = z[:size]
                        return _OK, count, True, index * step
            x[:] = z[:size]
            events[count - 1].max_acceleration = largest
            events[count - 1].min_acceleration = smallest
            if index >= last_steps:
                return _OK, count, False, system.end_time

        if count + (3 if system.impulsive != 0 else 1) > events.size:
            return _EVENT_BUFFER_FULL, count, False, index * step + offset
        time = index * step + offset
        speed = 0.0
        for k in range(size):
            speed += system.lash[k] * x[k]
        kind = system.event_kind[regime, guard]
        successor = system.successor[regime, guard]
        zero_order = system.zero_order[regime, guard]
        zero_guard = system.zero_guard[regime, guard]
        if system.impulsive != 0 and kind == TOUCH:
            side = 1 if guard == 0 else -1
            fastest = max(fastest, abs(speed))
            successor, zero_order = _rebound(system, x, torque, half_gap, side, speed, fastest)
            zero_guard = guard if successor == OPEN else -1
            _record(events, states, count, time, speed, TOUCH, OPEN, side, x)
            count += 1
            if successor != OPEN:
                _record(events, states, count, time, 0.0, LOCK, successor, side, x)
                count += 1
        else:
            side = system.side[successor] if system.side[successor] != 0 else system.side[regime]
            if system.impulsive != 0:  # released where it was held, but for what rounding has added up
                _hold(system, x, side * half_gap)
                speed = 0.0
            _record(events, states, count, time, speed, kind, successor, side, x)
            count += 1
            if system.impulsive != 0 and half_gap == 0.0:  # locked flanks without a gap between them: no free state
                successor, zero_guard, zero_order = closed_on(-side), 0, 1
                _record(events, states, count, time, 0.0, TOUCH, OPEN, -side, x)
                _record(events, states, count + 1, time, 0.0, LOCK, successor, -side, x)
                count += 2
        regime = successor
        if steps == 2 and offset >= step:
            index, offset = index + 1, offset - step


@compiled
def _rebound(
    system: System, x: FloatArray, torque: float, half_gap: float, side: int, speed: float, fastest: float
) -> tuple[int, int]:
    """The velocities after a touch, θ' -= (1 + e) q' M⁻¹l/(lᵀM⁻¹l) (report Eq. 2.9), and what follows.

    A rebound not faster than the locking speed ends with q' = 0: locked where the torque that holds it so presses the
    flanks together, else open, with the gap at zero and about to open.

    Returns
    -------
    successor : int
    zero_order : int
        Of the guard of this flank in the open regime.
    """
    tolerance = system.locking_speed if system.locking_speed >= 0.0 else -system.locking_speed * fastest
    if system.restitution * abs(speed) > tolerance:
        for k in range(x.size):
            x[k] -= (1.0 + system.restitution) * speed * system.impulse[k]
        return OPEN, 1
    _hold(system, x, side * half_gap)
    torque_held, slope, scale = 0.0, 0.0, 0.0
    for k in range(x.size):
        weight = system.functionals[OPEN_FLOW, FORCE, k]
        rate = system.inputs[OPEN_FLOW, k, 0] * torque
        for j in range(x.size):
            rate += system.rates[OPEN_FLOW, k, j] * x[j]
        torque_held += weight * x[k]
        slope += weight * rate
        scale += abs(weight * x[k])
    driven = system.feedthrough[OPEN_FLOW, FORCE, 0] * torque
    torque_held, scale = torque_held + driven, scale + abs(driven)
    pressing = side * torque_held
    if abs(pressing) <= _ROUNDING * scale:  # zero: what it turns into decides
        pressing = side * slope
    return (closed_on(side), 0) if pressing > 0.0 else (OPEN, 2)


@compiled
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


@compiled
def _combine(inputs: FloatArray, torque: float, gap_input: float, out: FloatArray) -> None:
    for r in range(out.size):
        out[r] = inputs[0, r] * torque + inputs[1, r] * gap_input


@compiled
def _record(
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
    events[k].time = time
    events[k].speed = speed
    events[k].kind = kind
    events[k].regime = regime
    events[k].side = side
    events[k].max_acceleration = -np.inf
    events[k].min_acceleration = np.inf
    if states.shape[0] > k:
        states[k, :] = x


@compiled
def _expand(system: System, flow: int, x: FloatArray, torque: float, gap_input: float, taylor: FloatArray) -> None:
    """The step as a polynomial of its length: x(s) = sum of taylor[k] s^k, RK4's own for a linear regime."""
    size = x.size
    for k in range(size):
        taylor[0, k] = x[k]
    for order in range(1, 5):
        for row in range(size):
            value = 0.0
            for k in range(size):
                value += system.rates[flow, row, k] * taylor[order - 1, k]
            if order == 1:
                value += system.inputs[flow, row, 0] * torque + system.inputs[flow, row, 1] * gap_input
            taylor[order, row] = value / order


@compiled
def _quartic(
    system: System, flow: int, which: int, torque: float, gap_input: float, taylor: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """A functional over the step: the coefficients of its quartic, and the size of the terms that make the first."""
    driven = system.feedthrough[flow, which, 0] * torque + system.feedthrough[flow, which, 1] * gap_input
    c0, c1, c2, c3, c4, scale = driven, 0.0, 0.0, 0.0, 0.0, abs(driven)
    for k in range(taylor.shape[1]):
        weight = system.functionals[flow, which, k]
        c0 += weight * taylor[0, k]
        c1 += weight * taylor[1, k]
        c2 += weight * taylor[2, k]
        c3 += weight * taylor[3, k]
        c4 += weight * taylor[4, k]
        scale += abs(weight * taylor[0, k])
    return c0, c1, c2, c3, c4, scale


@compiled
def _first_event(
    system: System,
    regime: int,
    torque: float,
    half_gap: float,
    taylor: FloatArray,
    length: float,
    zero_guard: int,
    zero_order: int,
) -> tuple[float, int]:
    """When the first of the regime's guards turns negative within `length`, and which; (length, -1) if none does.

    Where the last event left a guard at zero, with or without its first derivatives, those zeros are divided out; a
    guard within rounding of zero is taken to be zero, so that its derivatives decide.
    """
    earliest, which = length, -1
    flow, gap_input = system.flow[regime], system.side[regime] * half_gap
    for guard in range(system.guards[regime]):
        functional = system.guard_functional[regime, guard]
        sign, shift = system.guard_sign[regime, guard], system.guard_offset[regime, guard] * half_gap
        c0, c1, c2, c3, c4, scale = _quartic(system, flow, functional, torque, gap_input, taylor)
        c0, c1, c2, c3, c4 = sign * c0 + shift, sign * c1, sign * c2, sign * c3, sign * c4
        order = zero_order if guard == zero_guard else 0
        if order == 0 and abs(c0) <= _ROUNDING * (scale + abs(shift)):
            order = 1
        for _ in range(order):
            c0, c1, c2, c3, c4 = c1, c2, c3, c4, 0.0
        s = polynomial.first_negative(c0, c1, c2, c3, c4, length)
        if s >= 0.0 and (which < 0 or s < earliest):
            earliest, which = s, guard
    return earliest, which


@compiled
def _acceleration_extremes(
    system: System, flow: int, torque: float, gap_input: float, taylor: FloatArray, length: float
) -> tuple[float, float]:
    c0, c1, c2, c3, c4, _ = _quartic(system, flow, ACCELERATION, torque, gap_input, taylor)
    return polynomial.extremes(c0, c1, c2, c3, c4, length)


@compiled
def _load(
    system: System, flow: int, x: FloatArray, torque: float, gap_input: float, z: FloatArray, columns: int
) -> None:
    """Put a state and its outputs where `_coast` steps them."""
    for k in range(x.size):
        z[k] = x[k]
    for r in range(system.observe.shape[2]):
        value = system.observe_input[flow, 0, r] * torque + system.observe_input[flow, 1, r] * gap_input
        for k in range(x.size):
            value += system.observe[flow, k, r] * x[k]
        z[columns + r] = value


@inlined
def _advance(transfer: FloatArray, affine: FloatArray, z: FloatArray, out: FloatArray) -> None:
    """out = affine + transfer z: one full step. Summed in pairs, eight columns at a time, which LLVM vectorises."""
    x0, x1, x2, x3, x4, x5, x6, x7 = z[0], z[1], z[2], z[3], z[4], z[5], z[6], z[7]
    for r in range(affine.size):
        out[r] = affine[r] + (
            ((transfer[0, r] * x0 + transfer[1, r] * x1) + (transfer[2, r] * x2 + transfer[3, r] * x3))
            + ((transfer[4, r] * x4 + transfer[5, r] * x5) + (transfer[6, r] * x6 + transfer[7, r] * x7))
        )
    for b in range(8, transfer.shape[0], 8):
        x0, x1, x2, x3 = z[b], z[b + 1], z[b + 2], z[b + 3]
        x4, x5, x6, x7 = z[b + 4], z[b + 5], z[b + 6], z[b + 7]
        for r in range(affine.size):
            out[r] += (
                (transfer[b, r] * x0 + transfer[b + 1, r] * x1) + (transfer[b + 2, r] * x2 + transfer[b + 3, r] * x3)
            ) + (
                (transfer[b + 4, r] * x4 + transfer[b + 5, r] * x5)
                + (transfer[b + 6, r] * x6 + transfer[b + 7, r] * x7)
            )


@compiled
def _coast(
    block: FloatArray,
    block_affine: FloatArray,
    transfer: FloatArray,
    affine: FloatArray,
    outputs: int,
    guard_at: npt.NDArray[np.int64],
    guard_sign: FloatArray,
    guard_shift: FloatArray,
    z: FloatArray,
    scratch: FloatArray,
    budget: int,
    largest: float,
    smallest: float,
) -> tuple[int, float, float]:
    """Take up to `budget` full steps, stopping before the first one in which a guard might turn negative.

    On a step, a guard is at least the smaller of its end values less its bend (see `regimes.BEND`); the same bounds
    the acceleration's excess over its end values. Steps go by the block, and one by one where a block is in doubt.

    Returns
    -------
    taken : int
    largest, smallest : float  [rad/s2]
        The acceleration's extremes, updated.
    """
    columns = transfer.shape[0]
    width = columns + outputs
    at1, at2, acc = columns + guard_at[0], columns + guard_at[1], columns + 4 * ACCELERATION
    sign1, sign2 = guard_sign[0], guard_sign[1]
    shift1, shift2 = guard_shift[0], guard_shift[1]
    taken = 0
    while taken < budget:
        steps = 1
        if taken + BLOCK <= budget:
            _advance(block, block_affine, z, scratch)
            low1, low2, high_a, low_a = np.inf, np.inf, z[acc], z[acc]
            bend1, bend2, bend = _bend(z, at1), _bend(z, at2), _bend(z, acc)
            for k in range(BLOCK):
                shift = k * outputs
                low1 = min(low1, sign1 * scratch[at1 + shift] + shift1)
                low2 = min(low2, sign2 * scratch[at2 + shift] + shift2)
                high_a, low_a = max(high_a, scratch[acc + shift]), min(low_a, scratch[acc + shift])
                if k + 1 < BLOCK:
                    bend1 = max(bend1, _bend(scratch, at1 + shift))
                    bend2 = max(bend2, _bend(scratch, at2 + shift))
                    bend = max(bend, _bend(scratch, acc + shift))
            low1 = min(low1, sign1 * z[at1] + shift1)
            low2 = min(low2, sign2 * z[at2] + shift2)
            if low1 > bend1 and low2 > bend2:  # not when not a number
                if high_a + bend > largest or low_a - bend < smallest:
                    largest, smallest = _watch(z, scratch, acc, acc, largest, smallest)
                    for k in range(BLOCK - 1):
                        here = acc + k * outputs
                        largest, smallest = _watch(scratch, scratch, here, here + outputs, largest, smallest)
                for k in range(columns):
                    z[k] = scratch[k]
                last = (BLOCK - 1) * outputs
                for k in range(columns, width):
                    z[k] = scratch[k + last]
                taken += BLOCK
                continue
            steps = BLOCK
        for _ in range(steps):
            _advance(transfer, affine, z, scratch)
            low1 = min(sign1 * z[at1] + shift1, sign1 * scratch[at1] + shift1)
            low2 = min(sign2 * z[at2] + shift2, sign2 * scratch[at2] + shift2)
            if not (low1 > _bend(z, at1) and low2 > _bend(z, at2)):
                return taken, largest, smallest
            largest, smallest = _watch(z, scratch, acc, acc, largest, smallest)
            for k in range(width):
                z[k] = scratch[k]
            taken += 1
    return taken, largest, smallest


@inlined
def _bend(z: FloatArray, at: int) -> float:
    return float(abs(z[at + 1]) + abs(z[at + 2]) + abs(z[at + 3]))


@inlined
def _watch(
    before: FloatArray, after: FloatArray, here: int, there: int, largest: float, smallest: float
) -> tuple[float, float]:
    """Update the acceleration's extremes by one step from `before[here]` to `after[there]`."""
    a, next_a = before[here], after[there]
    largest, smallest = max(largest, next_a), min(smallest, next_a)
    bend = _bend(before, here)
    if max(a, next_a) + bend > largest or min(a, next_a) - bend < smallest:
        c2, c3, c4 = before[here + 1] / BEND[1], before[here + 2] / BEND[2], before[here + 3] / BEND[3]
        high, low = polynomial.extremes(a, next_a - a - c2 - c3 - c4, c2, c3, c4, 1.0)
        largest, smallest = max(largest, high), min(smallest, low)
    return largest, smallest


@compiled
def _settled(
    system: System,
    regime: int,
    torque: float,
    half_gap: float,
    x: FloatArray,
    events: npt.NDArray[np.void],
    count: int,
    primaries: npt.NDArray[np.int64],
) -> bool:
    """Whether it is proved that no event follows, and no acceleration beyond the extremes of the open window.

    Every functional stays within its rest value plus or minus the sum of its modes' present amplitudes, for ever.
    """
    flow = system.flow[regime]
    if system.provable[flow] == 0:
        return False
    size = system.rates.shape[1]
    gap_input = system.side[regime] * half_gap
    watched = system.mode_reach.shape[1]
    reach = np.zeros(watched)
    for mode in range(size):
        widest = 0.0
        for functional in range(watched):
            widest = max(widest, system.mode_reach[flow, functional, mode])
        if widest == 0.0:
            continue  # the other one of a complex pair, or without effect on anything that is watched
        real, imaginary = 0.0, 0.0
        for k in range(size):
            away = x[k] - system.rest_state[flow, k, 0] * torque - system.rest_state[flow, k, 1] * gap_input
            real += system.mode_rows[flow, 0, mode, k] * away
            imaginary += system.mode_rows[flow, 1, mode, k] * away
        amplitude = np.sqrt(real * real + imaginary * imaginary)
        for functional in range(watched):
            reach[functional] += amplitude * system.mode_reach[flow, functional, mode]
    for guard in range(system.guards[regime]):
        functional = system.guard_functional[regime, guard]
        at_rest = (
            system.rest_functional[flow, functional, 0] * torque
            + system.rest_functional[flow, functional, 1] * gap_input
        )
        value = system.guard_sign[regime, guard] * at_rest + system.guard_offset[regime, guard] * half_gap
        if not value > (1.0 + 1e-9) * reach[functional]:
            return False
    found = find_primaries(events, count, system.sticking_time, primaries)
    if found == 0 or system.impulsive != 0:  # nothing is asked of the acceleration
        return True
    largest, smallest = window_extremes(events, primaries[found - 1], count)
    swing = (1.0 + 1e-9) * reach[ACCELERATION]
    return bool(largest >= swing and smallest <= -swing)
