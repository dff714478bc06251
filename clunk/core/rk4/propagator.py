"""RK4's full steps as matrices, and what bounds all that can follow."""

from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import ComplexArray, FloatArray, IntArray
from clunk.core.reductions import constrained, with_wave, without_drift
from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.core.tables import ACCELERATION, held_inputs

# On a step of length h, |p(s)| exceeds its larger end value by at most max|p''| h²/8 <= |c2|/4 + 3|c3|/4 + 3|c4|/2
# in the step's Taylor terms c_k = p_k h^k; these factors make that a plain sum.
BEND = (1.0, 0.25, 0.75, 1.5)
BLOCK = 4  # steps in one product: a third fewer operations a step than four products, and a quarter of their latency
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
    observe: FloatArray  # (K, columns, outputs)
    observe_input: FloatArray  # (K, I, outputs)
    # a bound on all that can follow: amplitudes of decaying modes
    provable: IntArray  # (K,)  whether the flow's modes give such a bound
    mode_rows: ComplexArray  # (K, N, N)  left eigenvectors, one of each pair
    mode_reach: FloatArray  # (K, F, N)  largest change of a functional per unit amplitude of a mode
    rest_state: FloatArray  # (K, N, I)  steady motion per unit of the inputs, without its drift
    rest_functional: FloatArray  # (K, F, I)


def build_steps(system: System, step: float) -> tuple[System, Steps]:
    """A system, of one driveline with the states of its load's wave, and the tables of RK4 with a step of `step` s."""
    stable, *bound = _modal_bound(system, step)
    propagator = _propagator(system.rates, system.inputs, system.functionals, system.feedthrough, step)
    if not stable:
        system = system._replace(status=int(Status.UNSTABLE_STEP))
    return system, Steps(step, *propagator, *bound)


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

    def product(steps: int) -> tuple[FloatArray, FloatArray]:
        """(x, outputs at every step) after `steps` steps."""
        width = _padded(columns + steps * outputs)
        transfer, transfer_input = np.zeros((flows, columns, width)), np.zeros((flows, driven, width))
        power, power_input = np.broadcast_to(identity, (flows, size, size)), np.zeros((flows, size, driven))
        for k in range(steps):
            power, power_input = across @ power, across @ power_input + across_input
            at = slice(columns + k * outputs, columns + (k + 1) * outputs)
            transfer[:, :size, at] = (rows @ power).transpose(0, 2, 1)
            transfer_input[:, :, at] = (rows @ power_input + rows_input).transpose(0, 2, 1)
        transfer[:, :size, :size] = power.transpose(0, 2, 1)
        transfer_input[:, :, :size] = power_input.transpose(0, 2, 1)
        return transfer, transfer_input

    return *product(1), *product(BLOCK), observe, observe_input


def _padded(count: int) -> int:
    return -(-count // _LANES) * _LANES


def _modal_bound(system: System, step: float) -> tuple[Any, ...]:
    """Per flow, what bounds a functional for all time: its rest value and its modes' amplitudes.

    With left eigenvectors w_k and right v_k, C x(t) = rest + sum of Re(C v_k  w_k·(x - x_rest) g_k(t)) and |g_k| <= 1
    both for exp(λ t) and for RK4's powers of R(h λ), within a step included (checked on a grid of partial steps).
    A flow with another mode at zero than the drift of the whole driveline, which no functional depends on, or with a
    badly conditioned eigenbasis has no such bound here. A wave that is a ramp is at rest where the bound matters.
    Returns whether RK4 is stable, and the fields of `Steps` from `provable` on.
    """
    flows, size, driven = system.inputs.shape
    mechanical, states = 2 * system.inertias, size
    if size > mechanical and not system.rates[0, mechanical + 1, mechanical:].any():
        states = mechanical  # a ramp
    rates, inputs = system.rates[:, :states, :states], system.inputs[:, :states]
    functionals, feedthrough = system.functionals[:, :, :states], system.feedthrough
    joints = np.vstack([system.lashes, system.frictions])[:, system.inertias : mechanical]
    lashes, rubbing = len(system.lashes), len(system.frictions)
    held = held_inputs(lashes, rubbing, driven)
    stuck_stride = flows >> rubbing
    provable = np.zeros(flows, dtype=np.int64)
    mode_rows = np.zeros((flows, size, size), np.complex128)
    mode_reach = np.zeros((flows, functionals.shape[1], size))
    rest_state = np.zeros((flows, size, driven))
    rest_functional = np.zeros((flows, functionals.shape[1], driven))
    stable = True
    for flow in range(flows):
        ties = [system.impulsive * (flow >> lash & 1) for lash in range(lashes)]
        ties += [flow // (stuck_stride << k) & 1 for k in range(rubbing)]
        reduction = constrained(joints, ties)
        expand, pick, shift = with_wave(without_drift(reduction, system.drift), states - mechanical)
        reduced = pick @ rates[flow] @ expand
        eigenvalues, right = np.linalg.eig(reduced)
        eigenvalues, right = eigenvalues.astype(np.complex128), right.astype(np.complex128)
        partial = rk4_growth(eigenvalues[:, None], step * np.arange(1, 9) / 8)
        # a rigid motion's double zero is found to half the digits; numerically an undamped mode grows by rounding
        at_zero = np.abs(eigenvalues) <= 1e-7 * np.max(np.abs(eigenvalues), initial=0.0)
        stable = stable and bool(np.all(partial[~at_zero, -1] <= 1 + 1e-9))
        if np.any(at_zero) or np.any(partial > 1 + 1e-12):
            continue
        if eigenvalues.size and np.linalg.cond(right) > _MAX_CONDITION:
            continue
        provable[flow] = 1
        count = eigenvalues.size
        weight = np.where(eigenvalues.imag > 0, 2.0, np.where(eigenvalues.imag < 0, 0.0, 1.0))
        mode_rows[flow, :count, :states] = np.linalg.inv(right) @ pick
        mode_reach[flow, :, :count] = weight * np.abs(functionals[flow] @ expand @ right)
        forcing = inputs[flow].copy()
        forcing[:, held] += rates[flow] @ shift
        rest_state[flow, :states] = -expand @ np.linalg.solve(reduced, pick @ forcing)
        rest_state[flow, :states, held] += shift.T
        rest_functional[flow] = functionals[flow] @ rest_state[flow, :states] + feedthrough[flow]
    if system.drift.shape[1] < 2:  # nothing accelerates for good; the product above leaves rounding
        rest_functional[:, ACCELERATION : lashes * system.functionals_per_lash : system.functionals_per_lash] = 0.0
    return stable, provable, mode_rows, mode_reach, rest_state, rest_functional
