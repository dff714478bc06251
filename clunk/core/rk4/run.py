"""Fixed-step RK4 with zero-crossing bisection through the regimes of a switched linear system.

On a linear regime a full step is one precomputed matrix product. It also yields each guard's value and a bound on how
far the guard bends within the step; while that shows that no guard can turn negative, nothing else is done (`coast`).
Where it does not, and right after every event, the step is expanded into its quartics, zeros are located by bisection,
and the rest of the step is finished in the successor regime, so that the time grid stays at multiples of the step.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.events import LOAD_STEP
from clunk.core.jit import compiled, inlined
from clunk.core.regimes import ACCELERATION, System
from clunk.core.rk4 import quartic
from clunk.core.rk4.propagator import BEND, BLOCK, Steps
from clunk.core.rk4.settling import settled
from clunk.core.rk4.step import acceleration_extremes, expand, finish, first_event
from clunk.core.status import INTERRUPTED, QUALITY_COMPLETE, Status
from clunk.core.switching import record, room_for_a_switch, switch

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NON_FINITE = int(Status.NON_FINITE)
_EVENT_BUFFER_FULL = int(Status.EVENT_BUFFER_FULL)

_STRIDE = 256  # full steps between two looks at whether the run is settled, and at the stop flag
# A remainder of a step shorter than this share of it is merged with the next one: right after an event the guard grows
# from zero, and needs some time to stand clear of rounding.
_SHORTEST = 0.01


@compiled
def _unknown(value: int) -> int:
    """An integer that numba does not know: for a known one it would compile again what that is passed to."""
    return int(np.int64(value))


@compiled
def run(
    system: System,
    steps: Steps,
    x: FloatArray,
    regime: int,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    stop: npt.NDArray[np.uint8],
) -> tuple[int, int, int, float, float]:
    """Run from the load step to the end time, or until it is proved that nothing can follow.

    Parameters
    ----------
    system : System
    steps : Steps
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
    quality : int
        QUALITY_COMPLETE where it was proved that no event and no larger acceleration in an open window can follow.
    margin : float
        Not known to this method: NaN.
    end : float  [s after the load step]
        Where the run stopped.
    """
    size = x.size
    columns, outputs = steps.transfer.shape[1], steps.observe.shape[2]
    affine, block_affine = np.empty(steps.transfer.shape[2]), np.empty(steps.block.shape[2])
    z, scratch = np.zeros(affine.size), np.zeros(block_affine.size)
    taylor = np.empty((5, size))
    guard_at, guard_sign, guard_shift = np.empty(2, np.int64), np.empty(2), np.empty(2)
    primaries = np.empty(events.size, np.int64)
    step = steps.step
    full_steps = int(np.floor(system.end_time / step + 1e-9))
    rest = system.end_time - full_steps * step
    last_steps = full_steps + 1 if rest > 1e-9 * step else full_steps

    count, none = _unknown(1), _unknown(0)
    record(events, states, 0, 0.0, 0.0, LOAD_STEP, regime, system.regimes[regime].side, x)
    index, offset = 0, 0.0  # the time is index · step + offset
    zero_guard, zero_order = none - 1, none
    fastest = 0.0  # touch so far [rad/s]
    while True:
        flow = system.regimes[regime].flow
        gap_input = system.regimes[regime].side * half_gap
        transfer, block = steps.transfer[flow], steps.block[flow]
        _combine(steps.transfer_input[flow], torque, gap_input, affine)
        _combine(steps.block_input[flow], torque, gap_input, block_affine)
        for k in range(2):
            row = system.guards[regime, min(k, system.regimes[regime].guards - 1)]  # a single guard stands for two
            guard_at[k], guard_sign[k], guard_shift[k] = 4 * row.functional, row.sign, row.offset * half_gap
        largest, smallest = -np.inf, np.inf
        while True:
            # one step, or what is left of it, with everything located
            length = (step if index < full_steps else rest) - offset
            spanned = 1
            if length < _SHORTEST * step and index + 1 < last_steps:
                length += step if index + 1 < full_steps else rest
                spanned = 2
            expand(system, flow, x, torque, gap_input, taylor)
            s, guard = first_event(system, regime, torque, half_gap, taylor, max(length, 0.0), zero_guard, zero_order)
            high, low = acceleration_extremes(system, flow, torque, gap_input, taylor, s)
            largest, smallest = max(largest, high), min(smallest, low)
            events[count - 1].max_acceleration = largest
            events[count - 1].min_acceleration = smallest
            if not finish(taylor, s, x):
                return _NON_FINITE, count, 0, np.nan, index * step + offset
            if guard >= 0:
                offset += s
                break
            index, offset, zero_guard = index + spanned, 0.0, none - 1

            # full steps as long as nothing can happen in them
            _load(steps.observe, steps.observe_input, flow, x, torque, gap_input, z, columns)
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
                    return INTERRUPTED, count, 0, np.nan, index * step
                if clear and (taken == _STRIDE or index == full_steps):
                    events[count - 1].max_acceleration = largest
                    events[count - 1].min_acceleration = smallest
                    if settled(system, steps, regime, torque, half_gap, z, events, count, primaries):
                        x[:] = z[:size]
                        return _OK, count, QUALITY_COMPLETE, np.nan, index * step
            x[:] = z[:size]
            events[count - 1].max_acceleration = largest
            events[count - 1].min_acceleration = smallest
            if index >= last_steps:
                return _OK, count, 0, np.nan, system.end_time

        if not room_for_a_switch(system.impulsive, half_gap, events.size, count):
            return _EVENT_BUFFER_FULL, count, 0, np.nan, index * step + offset
        count, regime, zero_guard, zero_order, fastest = switch(
            system, regime, guard, index * step + offset, x, torque, half_gap, events, states, count, fastest
        )
        if spanned == 2 and offset >= step:
            index, offset = index + 1, offset - step


@compiled
def _combine(inputs: FloatArray, torque: float, gap_input: float, out: FloatArray) -> None:
    for r in range(out.size):
        out[r] = inputs[0, r] * torque + inputs[1, r] * gap_input


@compiled
def _load(
    observe: FloatArray,
    observe_input: FloatArray,
    flow: int,
    x: FloatArray,
    torque: float,
    gap_input: float,
    z: FloatArray,
    columns: int,
) -> None:
    """Put a state and its outputs where `_coast` steps them."""
    for k in range(x.size):
        z[k] = x[k]
    for r in range(observe.shape[2]):
        value = observe_input[flow, 0, r] * torque + observe_input[flow, 1, r] * gap_input
        for k in range(x.size):
            value += observe[flow, k, r] * x[k]
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

    On a step, a guard is at least the smaller of its end values less its bend (see `steps.BEND`); the same bounds
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
        high, low = quartic.extremes(a, next_a - a - c2 - c3 - c4, c2, c3, c4, 1.0)
        largest, smallest = max(largest, high), min(smallest, low)
    return largest, smallest
