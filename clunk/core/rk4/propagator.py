"""RK4's full steps as matrices, and bounds on all that can follow a state."""

from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import ComplexArray, FloatArray, IntArray
from clunk.core.exact.flows import CURVATURE, PAIRS, SWAY, THIRD, Flows, halves
from clunk.core.lanes.pool import whole
from clunk.core.regimes import System, rolling_apart
from clunk.core.status import UNSTABLE_STEP
from clunk.core.tables import TORQUE, TORQUE_RATE

# On a step of length h, |p(s)| exceeds its larger end value by at most max|p''| h²/8 <= |c2|/4 + 3|c3|/4 + 3|c4|/2
# in the step's Taylor terms c_k = p_k h^k; these factors, of p and of c2, c3, c4, make that a plain sum.
BEND = (1.0, 0.25, 0.75, 1.5)
STRIDE = 64  # steps in one product, taken where a bound covers what is between its ends: a power of 2
# Tables in `Steps.transfer`: of no step, which computes the outputs of a state, of one step, and of a stride.
IN_PLACE, STEP, STRIDES = range(3)


class Steps(NamedTuple):
    """RK4's tables for one system; N states, I inputs, F functionals, K flows."""

    step: float  # s
    # x -> (x, outputs) by no step, one and a stride, rows contiguous; outputs are each functional's value and its
    # Taylor terms of order 2, 3, 4 over the next step, times BEND
    transfer: FloatArray  # (K, 3, columns, rows)
    # what each input adds to the states and outputs of these three, to coordinates y, which are relative to the steady
    # motion, and to a functional's distance from its chord over a stride, with its sign
    by_inputs: FloatArray  # (K, I, 3 rows + 2 M + F)
    # bounds on what follows, by the amplitudes of M pairs of coordinates, see `exact.flows`
    settles: IntArray  # (K,)  whether the amplitudes bound all that follows
    strides: IntArray  # (K,)  whether the amplitudes bound a stride
    mode_rows: FloatArray  # (K, columns, 2 M)  coordinates y of a state, first one member of each pair, then the other
    mode_reach: FloatArray  # (K, F, M)  largest change of a functional per unit amplitude of a pair
    mode_sag: FloatArray  # (K, F, M)  largest distance of a functional from its chord over a stride, likewise
    # (K, 3 or 0, F)  what a ramp adds to that distance, with its sign: by its torque and by its rate at the beginning
    # of a stride, and how much more by its rate until the stride ends
    ramp_sag: FloatArray
    rest_functional: FloatArray  # (K, F, I)  a functional in steady motion


def build_steps(system: System, flows: Flows, step: float) -> tuple[System, Steps]:
    """The system, with its status where RK4 is unstable, and RK4's tables for a step of `step` s.

    system : of one driveline, with the states of its load's wave
    flows : of that driveline, whose modes bound what can follow; for a load with ramps, without the states of ramps
    """
    stable, of_y, of_sag, *bounds = _bounds(system, flows, step)
    # an unstable step, which no run takes, is replaced by 0 s: its tables of STRIDE steps could overflow
    transfer, inputs = _propagators(system, step * stable)
    if not stable:
        system = system._replace(status=UNSTABLE_STEP)
    return system, Steps(step, transfer, np.concatenate([inputs, of_y, of_sag], axis=-1), *bounds)


def rk4_growth(eigenvalues: ComplexArray, step: float | FloatArray) -> FloatArray:
    """|R(h λ)| with RK4's stability polynomial R(z) = 1 + z + z²/2 + z³/6 + z⁴/24."""
    z = eigenvalues * step
    return np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))


def _propagators(system: System, step: float) -> tuple[FloatArray, FloatArray]:
    """RK4 steps as matrices, (K, 3, columns, rows), and what the inputs add to them, (K, I, 3 rows).

    One step is the Taylor polynomial of exp(hA) to degree 4, identical to the four stages. The outputs of the state
    after the step are appended to that state, so that one product yields both.
    """
    rates, inputs = step * system.rates, step * system.inputs
    flows, size, driven = inputs.shape
    identity = np.broadcast_to(np.eye(size), rates.shape)
    integral = identity + rates / 2 @ (identity + rates / 3 @ (identity + rates / 4))
    stride = power, power_input = identity + rates @ integral, integral @ inputs
    for _ in range(STRIDE.bit_length() - 1):
        stride = stride[0] @ stride[0], stride[0] @ stride[1] + stride[1]

    terms = [(system.functionals, system.feedthrough)]
    for order in range(1, 5):
        terms.append((terms[-1][0] @ rates / order, terms[-1][0] @ inputs / order))
    shown = [[bend * array for array in terms[order]] for bend, order in zip(BEND, (0, 2, 3, 4), strict=True)]
    rows, rows_input = (
        np.stack(arrays, axis=2).reshape(flows, -1, arrays[0].shape[-1]) for arrays in zip(*shown, strict=True)
    )
    columns = whole(size)
    end = columns + rows.shape[1]
    width = whole(end)
    transfer, by_inputs = np.zeros((flows, 3, columns, width)), np.zeros((flows, driven, 3, width))
    seen = slice(columns, end)
    for k, (across, across_input) in enumerate([(identity, 0.0 * inputs), (power, power_input), stride]):
        transfer[:, k, :size, :size], transfer[:, k, :size, seen] = across.mT, (rows @ across).mT
        by_inputs[:, :, k, :size] = across_input.mT
        by_inputs[:, :, k, seen] = (rows @ across_input + rows_input).mT
    return transfer, by_inputs.reshape(flows, driven, -1)


def _bounds(system: System, flows: Flows, step: float) -> tuple[Any, ...]:
    """Bounds of functionals in each flow, for all time and over a stride, by steady motion and amplitudes of modes.

    A functional is its value for the origin and a sum of c · y, over the pairs y of modal coordinates with rates λ. |y|
    never grows, neither by exp(λ t) nor by RK4's powers of R(h λ), nor within a step (checked on a grid of partial
    steps). Over n steps, c · y is away from its chord by at most n² h²/8 of the bound of its second derivative. RK4's
    second derivative is 1 + z + z²/2 times the exact one at a step's beginning, after a partial step z = λ s; and kinks
    between the quartics of steps add n² h² |h λ|³/96 of the bound. The distance is also at most twice the bound of
    |c · y|, that is, the second derivative's bound over |λ|². Where parts of the driveline are free of each other,
    the origin is a parabola in time, and under a ramp a cubic: away from its chord by (n h)²/8 of its second
    derivative. A flow without modes has no such bounds.

    Returns whether RK4 is stable, what the inputs add to y and to a sag, and the fields of `Steps` from `settles` on.
    """
    states, size = flows.coordinates.shape[1], system.rates.shape[1]
    eigenvalues = np.linalg.eigvals(flows.generator).astype(np.complex128)
    stable = np.all(rk4_growth(eigenvalues, step / flows.span[:, :1]) <= 1 + 1e-9)
    rates = flows.propagator[:, -1] / flows.span[:, 0, None, None, None]
    real, cross = np.moveaxis(rates.reshape(*rates.shape[:-1], 2, PAIRS), 2, 0)  # SELF and CROSS, (K, B, 2, 4)
    turning = -cross.prod(axis=-2, keepdims=True)  # ω², or 0
    partial_steps = step * (real + 1j * np.sqrt(turning + 0j)) * np.arange(1, 9).reshape(-1, 1, 1, 1, 1) / 8
    strides = flows.modal * (rk4_growth(partial_steps, 1.0) <= 1 + 1e-12).all(axis=(0, 2, 3, 4))
    curvature = abs(1 + partial_steps * (1 + partial_steps / 2)).max(axis=0) + abs(partial_steps[-1]) ** 3 / 12
    squared = real**2 + turning
    slowest = np.where(squared > 0.0, squared, np.inf).min(axis=-2)
    bending = np.hypot(*np.split(flows.watch[..., CURVATURE:THIRD], 2, axis=-1))  # (K, F, B, 4)
    parabola = (STRIDE * step) ** 2 / 8
    sag = np.minimum(parabola * curvature.max(axis=-2)[:, None] * bending, 2.0 / slowest[:, None] * bending)
    pairs = *bending.shape[:2], -1

    steady = flows.origin[:, 0, :, :states] @ flows.coordinates  # of y, by the inputs
    rows = np.zeros((len(steady), whole(size), steady.shape[-1]))
    rows[:, :states] = flows.coordinates
    if system.drift.size:
        rows[:, :states] = rolling_apart(system, states)[0].T @ rows[:, :states]
    bent, bends_on = parabola * flows.origin_output[:, 2:].transpose(1, 0, 3, 2)
    of_ramp = np.zeros((len(steady), 3 if states < size else 0, pairs[1]))
    if states < size:
        by_ramp = [TORQUE, TORQUE_RATE]
        rows[:, states:size] = -steady[:, by_ramp]
        of_ramp[:, :2], of_ramp[:, 2] = bent[:, by_ramp], STRIDE * step * bends_on[:, TORQUE_RATE]
    rows, by_inputs = (halves(array).swapaxes(-3, -2).reshape(array.shape) for array in (rows, -steady))
    reach = flows.watch[..., SWAY : SWAY + PAIRS].copy()  # contiguous: for other arrays, kernels are compiled anew
    bounds = rows, reach.reshape(pairs), sag.reshape(pairs), of_ramp
    return stable, by_inputs, bent, strides * flows.steady, strides, *bounds, flows.origin_output[:, 0].copy()
