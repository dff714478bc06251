"""RK4's full steps as matrices, and what bounds all that can follow."""

from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import ComplexArray, FloatArray, IntArray
from clunk.core.exact.flows import CURVATURE, PAIRS, SWAY, Flows, halves
from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.core.tables import TORQUE, TORQUE_RATE

# On a step of length h, |p(s)| exceeds its larger end value by at most max|p''| h²/8 <= |c2|/4 + 3|c3|/4 + 3|c4|/2
# in the step's Taylor terms c_k = p_k h^k; these factors make that a plain sum.
BEND = (1.0, 0.25, 0.75, 1.5)
BLOCK = 4  # steps in one product: a third fewer operations a step than four products, and a quarter of their latency
# steps in one product that tells nothing of what is between its ends, where a bound does: BLOCK times a power of 2
STRIDE = 64
_LANES = 8  # states and outputs are padded to whole SIMD blocks; `rk4.run` unrolls over one block of columns


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
    # bounds on what follows, by the amplitudes of M pairs of coordinates, see `exact.flows`
    settles: IntArray  # (K,)  whether they bound all that follows
    strides: IntArray  # (K,)  whether they bound a stride
    mode_rows: FloatArray  # (K, columns, 2 M)  coordinates y of a state, of all pairs the one, then the other
    mode_input: FloatArray  # (K, I, 2 M)  less those of the steady motion
    mode_reach: FloatArray  # (K, F, M)  largest change of a functional per unit amplitude of a pair
    mode_sag: FloatArray  # (K, F, M)  its largest distance from its chord over a stride, per unit amplitude
    steady_sag: FloatArray  # (K, I, F)  and that of the steady motion, signed
    ramp_sag: FloatArray  # (K, 3, F)  and what a ramp adds, per unit of its torque and rate, then its change per rate
    rest_functional: FloatArray  # (K, F, I)


def build_steps(system: System, flows: Flows, step: float) -> tuple[System, Steps]:
    """A system, of one driveline with the states of its load's wave, and the tables of RK4 with a step of `step` s.

    flows : of the driveline, whose modes tell what can follow; of a load with ramps, without these
    """
    stable, *bounds = _bounds(system, flows, step)
    # of 64 unstable steps, which no run takes, the tables may overflow: they are those of no step
    propagator = _propagator(system.rates, system.inputs, system.functionals, system.feedthrough, step * stable)
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


def _bounds(system: System, flows: Flows, step: float) -> tuple[Any, ...]:
    """Per flow, what bounds a functional for all time, and over a stride: its steady motion and its modes' amplitudes.

    With pairs of coordinates y and their rates λ, a functional is that of the origin and a sum of c · y. |y| never
    grows, neither by exp(λ t) nor by RK4's powers of R(h λ), within a step included (checked on a grid of partial
    steps). Over n steps c · y is away from its chord by at most n² h²/8 of the bound of its second derivative, which is
    1 + z + z²/2 of that on a partial step z, and by n² |h λ|³/96 of it more for the kinks between quartics; and by at
    most twice what such a derivative is of. The origin is, where parts of the driveline are free of each other, a
    parabola, and under a ramp a cubic: away from its chord by (n h)²/8 of its second derivative. A flow without modes
    has no such bounds.

    Returns whether RK4 is stable, and the fields of `Steps` from `settles` on.
    """
    states, size = flows.coordinates.shape[1], system.rates.shape[1]
    eigenvalues = np.linalg.eigvals(flows.generator).astype(np.complex128)
    stable = bool(np.all(rk4_growth(eigenvalues, step / flows.span[:, :1]) <= 1 + 1e-9))
    rates = flows.propagator[:, -1] / flows.span[:, 0, None, None, None]
    own, cross = np.moveaxis(rates.reshape(*rates.shape[:-1], 2, PAIRS), 2, 0)  # SELF and CROSS, (K, B, 2, 4)
    turning = -cross.prod(axis=-2, keepdims=True)  # ω², or 0
    partial_steps = step * (own + 1j * np.sqrt(turning)) * np.arange(1, 9).reshape(-1, 1, 1, 1, 1) / 8
    strides = flows.modal * (rk4_growth(partial_steps, 1.0) <= 1 + 1e-12).all(axis=(0, 2, 3, 4))
    curvature = np.abs(1 + partial_steps * (1 + partial_steps / 2)).max(axis=0) + np.abs(partial_steps[-1]) ** 3 / 12
    squared = own**2 + turning
    slowest = np.where(squared > 0.0, squared, np.inf).min(axis=-2)
    one, other = CURVATURE, CURVATURE + PAIRS
    bending = np.hypot(flows.watch[..., one:other], flows.watch[..., other : other + PAIRS])  # (K, F, B, 4)
    parabola = (STRIDE * step) ** 2 / 8
    sag = np.minimum(parabola * curvature.max(axis=-2)[:, None] * bending, 2.0 / slowest[:, None] * bending)
    reach, pairs = flows.watch[..., SWAY : SWAY + PAIRS], (*bending.shape[:2], -1)

    steady = flows.origin[:, 0, :, :states] @ flows.coordinates  # of y, by the inputs
    rows = np.zeros((len(steady), _padded(size), steady.shape[-1]))
    rows[:, :states] = flows.coordinates
    bent, bends_on = parabola * flows.origin_output[:, 2:].transpose(1, 0, 3, 2)
    of_ramp = np.zeros((len(steady), 3 if states < size else 0, pairs[1]))
    if states < size:
        by_ramp = [TORQUE, TORQUE_RATE]
        rows[:, states:size] = -steady[:, by_ramp]
        of_ramp[:, :2], of_ramp[:, 2] = bent[:, by_ramp], STRIDE * step * bends_on[:, TORQUE_RATE]
    by_member = (halves(array).swapaxes(-3, -2).reshape(array.shape) for array in (rows, -steady))
    bounds = *by_member, reach.reshape(pairs), sag.reshape(pairs), bent, of_ramp
    return stable, strides * flows.steady, strides, *bounds, flows.origin_output[:, 0].copy()
