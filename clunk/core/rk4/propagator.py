"""RK4's full steps as matrices, and what bounds all that can follow."""

from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import ComplexArray, FloatArray, IntArray
from clunk.core.reductions import Reduction, constrained, with_wave, without_drift
from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.core.tables import ACCELERATION, held_inputs

# On a step of length h, |p(s)| exceeds its larger end value by at most max|p''| h²/8 <= |c2|/4 + 3|c3|/4 + 3|c4|/2
# in the step's Taylor terms c_k = p_k h^k; these factors make that a plain sum.
BEND = (1.0, 0.25, 0.75, 1.5)
BLOCK = 4  # steps in one product: a third fewer operations a step than four products, and a quarter of their latency
# steps in one product that tells nothing of what is between its ends, where a bound does: BLOCK times a power of 2
STRIDE = 64
_LANES = 8  # states and outputs are padded to whole SIMD blocks; `rk4.run` unrolls over one block of columns
_MAX_CONDITION = 1e8  # of an eigenbasis; beyond it half the digits of the modal amplitudes are gone


class Steps(NamedTuple):
    """RK4's tables for one system; N states, I inputs, F functionals, K flows."""

    step: float  # s
    # one full step, x -> (x, outputs); outputs are each functional's value and its Taylor terms of order 2, 3, 4 over
    # the next step, times BEND
    transfer: FloatArray  # (K, columns, rows)  rows contiguous
    transfer_input: FloatArray  # (K, I, rows)
    # BLOCK full steps at once, x -> (x, outputs at every step)
    block: FloatArray  # (K, columns, rows)
    block_input: FloatArray  # (K, I, rows)
    # STRIDE full steps at once, x -> (x, outputs)
    stride: FloatArray  # (K, columns, rows)
    stride_input: FloatArray  # (K, I, rows)
    observe: FloatArray  # (K, columns, outputs)
    observe_input: FloatArray  # (K, I, outputs)
    # bounds on what follows, by the amplitudes of decaying modes, of which a flow has M at most
    settles: IntArray  # (K,)  whether they bound all that follows
    strides: IntArray  # (K,)  whether they bound a stride
    mode_rows: FloatArray  # (K, columns, 2 M)  modal coordinates of a state, real parts, then imaginary parts
    mode_input: FloatArray  # (K, I, 2 M)  less those of the steady motion
    mode_reach: FloatArray  # (K, F, M)  largest change of a functional per unit amplitude of a mode
    mode_sag: FloatArray  # (K, F, M)  its largest distance from its chord over a stride, per unit amplitude
    steady_sag: FloatArray  # (K, I, F)  and that of the steady motion, signed
    ramp_sag: FloatArray  # (K, 3, F)  and what a ramp adds, per unit of its torque and rate, then its change per rate
    rest_functional: FloatArray  # (K, F, I)


def build_steps(system: System, step: float) -> tuple[System, Steps]:
    """A system, of one driveline with the states of its load's wave, and the tables of RK4 with a step of `step` s."""
    stable, *bounds = _modal_bounds(system, step)
    propagator = _propagator(system.rates, system.inputs, system.functionals, system.feedthrough, step)
    if not stable:
        system = system._replace(status=int(Status.UNSTABLE_STEP))
    return system, Steps(step, *propagator, *bounds)


def rk4_growth(eigenvalues: ComplexArray, step: float | FloatArray) -> FloatArray:
    """|R(h λ)| with RK4's stability polynomial R(z) = 1 + z + z²/2 + z³/6 + z⁴/24."""
    z = eigenvalues * step
    return np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))


def _propagator(
    rates: FloatArray, inputs: FloatArray, functionals: FloatArray, feedthrough: FloatArray, step: float
) -> tuple[Any, ...]:
    """One RK4 step as a matrix: the Taylor polynomial of exp(hA) to degree 4, identical to the four stages.

    The outputs of the next state are appended to it, so that stepping and watching are one product. Returns the fields
    of `Steps` from `transfer` to `observe_input`.
    """
    (flows, size), driven = rates.shape[:2], inputs.shape[2]
    identity = np.eye(size)
    scaled = step * rates
    integral = identity + scaled / 2 @ (identity + scaled / 3 @ (identity + scaled / 4))
    across = identity + scaled @ integral
    across_input = step * integral @ inputs

    orders = (0, 2, 3, 4)
    count = functionals.shape[1]
    output = np.zeros((flows, count, len(orders), size))
    output_input = np.zeros((flows, count, len(orders), driven))
    for k, order in enumerate(orders):
        row, row_input = functionals, feedthrough
        for derivative in range(1, order + 1):
            row, row_input = step / derivative * row @ rates, step / derivative * row @ inputs
        output[:, :, k], output_input[:, :, k] = BEND[k] * row, BEND[k] * row_input
    rows: FloatArray = output.reshape(flows, -1, size)
    rows_input: FloatArray = output_input.reshape(flows, -1, driven)

    columns, outputs = _padded(size), rows.shape[1]
    observe, observe_input = np.zeros((flows, columns, outputs)), rows_input.transpose(0, 2, 1).copy()
    observe[:, :size] = rows.transpose(0, 2, 1)

    def after(
        first: tuple[FloatArray, FloatArray], then: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """The state after some steps and then others, x -> power x + power_input u."""
        return then[0] @ first[0], then[0] @ first[1] + then[1]

    def product(powers: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
        """(x after the last of some numbers of steps, outputs after each)."""
        width = _padded(columns + len(powers) * outputs)
        transfer, transfer_input = np.zeros((flows, columns, width)), np.zeros((flows, driven, width))
        for k, (power, power_input) in enumerate(powers):
            at = slice(columns + k * outputs, columns + (k + 1) * outputs)
            transfer[:, :size, at] = (rows @ power).transpose(0, 2, 1)
            transfer_input[:, :, at] = (rows @ power_input + rows_input).transpose(0, 2, 1)
        transfer[:, :size, :size] = power.transpose(0, 2, 1)
        transfer_input[:, :, :size] = power_input.transpose(0, 2, 1)
        return transfer, transfer_input

    powers = [(across, across_input)]
    while len(powers) < BLOCK:
        powers.append(after(powers[-1], powers[0]))
    long, steps = powers[-1], BLOCK
    while steps < STRIDE:
        long, steps = after(long, long), 2 * steps
    return *product(powers[:1]), *product(powers), *product([long]), observe, observe_input


def _padded(count: int) -> int:
    return -(-count // _LANES) * _LANES


def _modal_bounds(system: System, step: float) -> tuple[Any, ...]:
    """Per flow, what bounds a functional for all time, and over a stride: its steady motion and its modes' amplitudes.

    With left eigenvectors w_k and right v_k, C x = C x_steady + sum of Re(C v_k w_k·(x - x_steady) g_k), where |g_k| is
    at most 1 both for exp(λ t) and for RK4's powers of R(h λ), within a step included (checked on a grid of partial
    steps). Over n steps g_k is away from its chord by at most n² |h λ|²/8 of the largest second derivative, which is
    1 + z + z²/2 on a partial step z, and by n² |h λ|⁵/96 more for the kinks between quartics; and by at most 2.

    The steady motion is at rest, or under a ramp of the torque C x_steady has a constant rate; where parts of the
    driveline are free of each other, it is a parabola, away from its chord by (n h)²/8 of its second derivative. (Rates
    below 1e-7 of the fastest are taken to be zero.) A flow with a badly conditioned eigenbasis has no such bounds.

    Returns whether RK4 is stable, and the fields of `Steps` from `settles` on.
    """
    flows, size, driven = system.inputs.shape
    mechanical, states = 2 * system.inertias, size
    ramp = size > mechanical and not system.rates[0, mechanical + 1, mechanical:].any()
    if ramp:  # its wave is no part of the modes
        states = mechanical
    joints = np.vstack([system.lashes, system.frictions])[:, system.inertias : mechanical]
    lashes, rubbing = len(system.lashes), len(system.frictions)
    held = held_inputs(lashes, rubbing, driven)
    stuck_stride = flows >> rubbing
    settles, strides = np.zeros((2, flows), dtype=np.int64)
    modes = np.zeros((flows, states, size), np.complex128)
    modes_input = np.zeros((flows, states, driven), np.complex128)
    reach, sag = np.zeros((2, flows, system.functionals.shape[1], states))
    steady_sag, rest_functional = np.zeros((2, flows, system.functionals.shape[1], driven))
    ramp_sag = np.zeros((flows, 3 if ramp else 0, system.functionals.shape[1]))
    stable, most, parabola = True, 0, (STRIDE * step) ** 2 / 8
    for flow in range(flows):
        ties = [system.impulsive * (flow >> lash & 1) for lash in range(lashes)]
        ties += [flow // (stuck_stride << k) & 1 for k in range(rubbing)]
        free = constrained(joints, ties)
        rates, inputs = system.rates[flow, :states, :states], system.inputs[flow, :states]
        shift = np.zeros((states, driven))
        shift[:mechanical, held] = free.shift
        forcing = inputs + rates @ shift
        expand, pick, decay, right = _modes(rates, free, system.drift)
        settles[flow] = not np.any(decay == 0.0)
        if settles[flow] == 0:
            expand, pick, decay, right = _modes(rates, free, _free_angles(rates[:mechanical, :mechanical], free))
        partial_steps = step * decay[:, None] * (np.arange(1, 9) / 8)
        growth = rk4_growth(partial_steps, 1.0)
        stable = stable and bool(np.all(growth[:, -1] <= 1 + 1e-9))
        if np.any(growth > 1 + 1e-12) or (decay.size and np.linalg.cond(right) > _MAX_CONDITION):
            settles[flow] = 0
            continue
        strides[flow] = 1
        chosen = np.flatnonzero((decay.imag >= 0) & (decay != 0.0))  # one of each pair
        kept, most = slice(chosen.size), max(most, chosen.size)
        weight = np.where(decay[chosen].imag > 0, 2.0, 1.0)
        left, right = (np.linalg.inv(right) @ pick)[chosen], expand @ right[:, chosen]
        decay, partial_steps = decay[chosen, None], partial_steps[chosen]
        modes[flow, kept, :states] = left
        modes_input[flow, kept] = left @ forcing / decay - left @ shift
        second = system.functionals[flow] @ system.rates[flow] @ system.rates[flow]  # rows of second derivatives
        functionals, curving = system.functionals[flow, :, :states], second[:, :states]
        bending = weight * np.abs(curving @ right)
        # of a slow mode that moves no functional, the curvature's rounding is no measure of its reach
        of_mode = weight * np.abs(functionals @ right) if settles[flow] else bending / np.abs(decay.T) ** 2
        each = np.abs(step * decay[:, 0])
        curvature = np.abs(1 + partial_steps * (1 + partial_steps / 2)).max(axis=1, initial=1.0)
        reach[flow, :, kept] = of_mode
        sag[flow, :, kept] = np.minimum(parabola * bending * (curvature + each**3 / 12), 2.0 * of_mode)
        if ramp:
            by_torque = left @ system.rates[flow, :states, states, None] / decay
            modes[flow, kept, states:] = np.hstack([by_torque, by_torque / decay])
        if settles[flow]:
            rest = shift - expand @ np.linalg.solve(pick @ rates @ expand, pick @ forcing)
            rest_functional[flow] = functionals @ rest + system.feedthrough[flow]
            continue
        rest = shift - np.real(weight * right @ (left @ forcing / decay))
        steady_sag[flow] = curving @ rest + functionals @ rates @ inputs
        if ramp:
            by_ramp = np.real(weight * right @ modes[flow, kept, states:])
            ramp_sag[flow, :2] = (second[:, states:] - curving @ by_ramp).T
            ramp_sag[flow, 2] = STRIDE * step * ramp_sag[flow, 0]
    if system.drift.shape[1] < 2:  # nothing accelerates for good; the product above leaves rounding
        rest_functional[:, ACCELERATION : lashes * system.functionals_per_lash : system.functionals_per_lash] = 0.0
    rows = _real_rows(modes[:, :most], modes_input[:, :most])
    bounds = *rows, reach[..., :most], sag[..., :most], parabola * steady_sag.swapaxes(1, 2), parabola * ramp_sag
    return stable, settles, strides, *bounds, rest_functional


def _modes(rates: FloatArray, free: Reduction, drift: FloatArray) -> tuple[FloatArray, FloatArray, Any, Any]:
    """Coordinates without constraints and drift, `expand` and `pick` of a `Reduction`, and the eigenvectors in them.

    Eigenvalues that are zero but for rounding are zero: a rigid motion's double zero is found to half the digits.
    """
    expand, pick, _ = with_wave(without_drift(free, drift), len(rates) - len(free.shift))
    decay, right = (array.astype(np.complex128) for array in np.linalg.eig(pick @ rates @ expand))
    decay[np.abs(decay) <= 1e-7 * np.max(np.abs(decay), initial=0.0)] = 0.0
    return expand, pick, decay, right


def _free_angles(rates: FloatArray, free: Reduction) -> FloatArray:
    """Rigid turns of the parts of a driveline that are free of each other and of the ground, (N, parts)."""
    n = len(free.pick) // 2
    stiffness = free.pick[n:] @ rates @ free.expand[:, :n]  # the angles' effect on the accelerations
    rounding = 1e-12 * np.max(np.abs(stiffness), initial=0.0)
    joined = (np.abs(stiffness) > rounding) | np.eye(n, dtype=bool)
    reached = np.linalg.matrix_power((joined | joined.T).astype(float), n) > 0.0
    turns = np.zeros((2 * n, 0))
    for part in np.unique(reached, axis=0):
        _, singular, right = np.linalg.svd(stiffness[np.ix_(part, part)])
        if singular[-1] <= rounding:
            turn = np.zeros((2 * n, 1))
            turn[:n][part, 0] = right[-1]
            turns = np.hstack([turns, turn])
    return free.expand @ turns


def _real_rows(modes: ComplexArray, modes_input: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Real and imaginary parts of modal coordinates, of states and of inputs, as the columns of products."""
    flows, count, size = modes.shape
    rows = np.zeros((flows, _padded(size), 2 * count))
    rows[:, :size] = np.concatenate([modes.real, modes.imag], axis=1).swapaxes(1, 2)
    return rows, np.concatenate([modes_input.real, modes_input.imag], axis=1).swapaxes(1, 2).copy()
