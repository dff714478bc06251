"""A driveline with one lash as a switched linear system: a list of regimes, as data.

Within a regime x' = A x + B u, with x = (θ, θ') and the constant input u = (T, s φ/2): the load torque after the step,
and the half gap on the side s of the flank in contact (s = 0: none). A regime ends when one of its *guards*, linear
functionals of x that are positive inside it, turns negative; a table names its successor. For the indentation model
(report §2.3.2):

    regime      flow     guards                       successor
    open        open     φ/2 - q,  q + φ/2            closed on the flank reached (touch)
    closed, s   closed   separation by gap:   s q - φ/2        open (separation)
                         separation by force: contact force    parted (separation)
    parted, s   open     s q - φ/2                    open (opening)
                         minus the contact force      closed (rejoin)

where q = θi - θj across the lash, and the contact torque is k (s q - φ/2) + c s q'. *Parted* exists only for separation
by force: the flanks still overlap, but no longer press on each other.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.events import OPENING, REJOIN, SEPARATION, TOUCH
from clunk.core.status import Status

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

OPEN_FLOW, CLOSED_FLOW = 0, 1
OPEN, CLOSED_POSITIVE, CLOSED_NEGATIVE, PARTED_POSITIVE, PARTED_NEGATIVE = range(5)
# the functionals: q, θ'' of one inertia, and where separation is by force k q + c q' (one SIMD block less without it)
GAP, ACCELERATION, FORCE = range(3)

# On a step of length h, |p(s)| exceeds its larger end value by at most max|p''| h²/8 <= |c2|/4 + 3|c3|/4 + 3|c4|/2
# in the step's Taylor terms c_k = p_k h^k; these factors make that a plain sum.
BEND = (1.0, 0.25, 0.75, 1.5)
BLOCK = 4  # steps in one product: a third fewer operations a step than four products, and a quarter of their latency
_LANES = 8  # states and outputs are padded to whole SIMD blocks; rk4.advance unrolls over one block of columns
_MAX_CONDITION = 1e8  # of an eigenbasis; beyond it half the digits of the modal amplitudes are gone


class System(NamedTuple):
    """One driveline with its lash, contact and solver step, ready to run; N states, F functionals, 2 flows, 5 regimes.

    `stack` puts several behind each other: every field gets a leading dimension.
    """

    # the continuous system
    rates: FloatArray  # (2, N, N)  A of each flow
    inputs: FloatArray  # (2, N, 2)  B of each flow, for (T, s φ/2)
    functionals: FloatArray  # (2, F, N)  C of each flow
    feedthrough: FloatArray  # (2, F, 2)  D of each flow
    lash: FloatArray  # (N,)  q' = lash · x
    # one full step of length `step`, x -> (x, outputs); outputs are each functional's value and its Taylor terms of
    # order 2, 3, 4 over the next step, times BEND
    transfer: FloatArray  # (2, columns, rows)  rows contiguous
    transfer_input: FloatArray  # (2, 2, rows)
    # BLOCK full steps at once, x -> (x, outputs at every step)
    block: FloatArray  # (2, columns, rows)
    block_input: FloatArray  # (2, 2, rows)
    observe: FloatArray  # (2, columns, outputs)
    observe_input: FloatArray  # (2, 2, outputs)
    # the regimes
    flow: IntArray  # (5,)
    side: IntArray  # (5,)  s
    guards: IntArray  # (5,)  how many
    guard_functional: IntArray  # (5, 2)
    guard_sign: FloatArray  # (5, 2)  guard = sign · functional + offset · φ/2
    guard_offset: FloatArray  # (5, 2)
    successor: IntArray  # (5, 2)
    event_kind: IntArray  # (5, 2)
    zero_guard: IntArray  # (5, 2)  the successor's guard that is zero on entry, or -1
    # before the step
    preload: FloatArray  # (N, 2)  static equilibrium in contact for (T, s φ/2)
    contact_torque: FloatArray  # (2,)  the static torque across the lash, signed like q, for (T, s φ/2)
    # a bound on all that can follow: amplitudes of decaying modes
    provable: IntArray  # (2,)  whether the flow's modes give such a bound
    mode_rows: FloatArray  # (2, 2, N, N)  real and imaginary part of the left eigenvectors, one of each pair
    mode_reach: FloatArray  # (2, F, N)  largest change of a functional per unit amplitude of a mode
    rest_state: FloatArray  # (2, N, 2)  equilibrium for (T, s φ/2)
    rest_functional: FloatArray  # (2, F, 2)
    # scalars
    step: float  # s
    end_time: float  # s after the load step
    sticking_time: float  # s
    status: int  # why this system cannot be run, or OK


def build_system(
    *,
    inertia: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    load: FloatArray,
    lash: FloatArray,
    contact_stiffness: float,
    contact_damping: float,
    separation_by_force: bool,
    acceleration_of: int,
    step: float,
    end_time: float,
    sticking_time: float,
    grounded: bool,
) -> System:
    """The switched linear system of the Indentation Force Model (report Eqs 2.6 and 2.12).

    Parameters
    ----------
    inertia : (n,) float64  [kg m2]
    damping, stiffness : (n, n) float64  [N m s/rad], [N m/rad]
        Of the open chain, report Eq. 2.6.
    load : (n,) float64
        1 at the loaded inertia.
    lash : (n,) float64
        q = lash · θ.
    contact_stiffness, contact_damping : float  [N m/rad], [N m s/rad]
    acceleration_of : int
        Index from 0 of the inertia whose acceleration is watched.
    step, end_time, sticking_time : float  [s]
    grounded : bool
        Whether every inertia has a path of stiffness to ground while the lash is closed.
    """
    n = inertia.size
    size = 2 * n
    rates = np.zeros((2, size, size))
    inputs = np.zeros((2, size, 2))
    for flow in (OPEN_FLOW, CLOSED_FLOW):
        coupling = np.outer(lash, lash) * flow
        rates[flow, :n, n:] = np.eye(n)
        rates[flow, n:, :n] = -(stiffness + contact_stiffness * coupling) / inertia[:, None]
        rates[flow, n:, n:] = -(damping + contact_damping * coupling) / inertia[:, None]
        inputs[flow, n:, 0] = load / inertia
        inputs[flow, n:, 1] = flow * contact_stiffness * lash / inertia

    count = 3 if separation_by_force else 2
    functionals = np.zeros((2, count, size))
    feedthrough = np.zeros((2, count, 2))
    functionals[:, GAP, :n] = lash
    if separation_by_force:
        functionals[:, FORCE, :n] = contact_stiffness * lash
        functionals[:, FORCE, n:] = contact_damping * lash
    functionals[:, ACCELERATION] = rates[:, n + acceleration_of]
    feedthrough[:, ACCELERATION] = inputs[:, n + acceleration_of]

    table = _regime_table(contact_stiffness, contact_damping, separation_by_force)
    propagator = _propagator(rates, inputs, functionals, feedthrough, step)
    modal, stable = _modal_bound(rates, inputs, functionals, feedthrough, step)
    preload, contact_torque = _preload(stiffness, load, lash, contact_stiffness, grounded)
    status = Status.OK if grounded else Status.NO_EQUILIBRIUM
    if not stable:
        status = Status.UNSTABLE_STEP
    return System(
        rates=rates,
        inputs=inputs,
        functionals=functionals,
        feedthrough=feedthrough,
        lash=np.concatenate([np.zeros(n), lash]),
        **propagator,
        **table,
        preload=preload,
        contact_torque=contact_torque,
        **modal,
        step=step,
        end_time=end_time,
        sticking_time=sticking_time,
        status=int(status),
    )


def stack(systems: list[System]) -> System:
    """Systems of equal size behind each other: every field gets a leading dimension of their number."""
    return System(*(np.stack(field) for field in zip(*systems, strict=True)))


def rk4_growth(eigenvalues: npt.NDArray[np.complex128], step: float) -> FloatArray:
    """|R(h λ)| with RK4's stability polynomial R(z) = 1 + z + z²/2 + z³/6 + z⁴/24."""
    z = eigenvalues * step
    return np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))


def _regime_table(stiffness: float, damping: float, separation_by_force: bool) -> dict[str, npt.NDArray[np.generic]]:
    """The table of the module's docstring; guard = sign · functional + offset · φ/2."""
    touch_zero = -1 if separation_by_force and damping > 0.0 else 0  # at a touch the force is c q' > 0, the overlap 0
    rows: list[tuple[int, int, list[tuple[int, int, float, int, int, int]]]] = [
        (
            OPEN_FLOW,
            0,
            [(GAP, -1, 1.0, CLOSED_POSITIVE, TOUCH, touch_zero), (GAP, 1, 1.0, CLOSED_NEGATIVE, TOUCH, touch_zero)],
        )
    ]
    for side, parted in ((1, PARTED_POSITIVE), (-1, PARTED_NEGATIVE)):
        reached = 0 if side > 0 else 1  # the open regime's guard of this flank
        by_gap = (GAP, side, -1.0, OPEN, SEPARATION, reached)
        by_force = (FORCE, side, -stiffness, parted, SEPARATION, 1)
        rows.append((CLOSED_FLOW, side, [by_force if separation_by_force else by_gap]))
    for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE)):
        reached = 0 if side > 0 else 1
        opening = (GAP, side, -1.0, OPEN, OPENING, reached)
        rejoin = (FORCE, -side, stiffness, closed, REJOIN, 0)
        rows.append((OPEN_FLOW, side, [opening, rejoin]))

    columns: list[npt.NDArray[np.generic]] = []
    for column, kind in enumerate((np.int64, np.float64, np.float64, np.int64, np.int64, np.int64)):
        values = np.zeros((len(rows), 2), dtype=kind)
        for regime, (_, _, guards) in enumerate(rows):
            for k, guard in enumerate(guards):
                values[regime, k] = guard[column]
        columns.append(values)
    names = ("guard_functional", "guard_sign", "guard_offset", "successor", "event_kind", "zero_guard")
    return {
        "flow": np.array([row[0] for row in rows], dtype=np.int64),
        "side": np.array([row[1] for row in rows], dtype=np.int64),
        "guards": np.array([len(row[2]) for row in rows], dtype=np.int64),
        **dict(zip(names, columns, strict=True)),
    }


def _propagator(
    rates: FloatArray, inputs: FloatArray, functionals: FloatArray, feedthrough: FloatArray, step: float
) -> dict[str, FloatArray]:
    """One RK4 step as a matrix: the Taylor polynomial of exp(hA) to degree 4, identical to the four stages.

    The outputs of the next state are appended to it, so that stepping and watching are one product.
    """
    size = rates.shape[1]
    identity = np.eye(size)
    scaled = step * rates
    integral = identity + scaled / 2 @ (identity + scaled / 3 @ (identity + scaled / 4))
    across = identity + scaled @ integral
    across_input = step * integral @ inputs

    orders = (0, 2, 3, 4)
    count = functionals.shape[1]
    output = np.zeros((2, count, len(orders), size))
    output_input = np.zeros((2, count, len(orders), 2))
    for k, order in enumerate(orders):
        row, row_input = functionals, feedthrough
        for derivative in range(1, order + 1):
            row, row_input = step / derivative * row @ rates, step / derivative * row @ inputs
        output[:, :, k], output_input[:, :, k] = BEND[k] * row, BEND[k] * row_input
    output = output.reshape(2, -1, size)
    output_input = output_input.reshape(2, -1, 2)

    columns, outputs = _padded(size), output.shape[1]
    observe, observe_input = np.zeros((2, columns, outputs)), np.zeros((2, 2, outputs))
    observe[:, :size] = output.transpose(0, 2, 1)
    observe_input[:] = output_input.transpose(0, 2, 1)

    def product(steps: int) -> tuple[FloatArray, FloatArray]:
        """(x, outputs at every step) after `steps` steps."""
        rows = _padded(columns + steps * outputs)
        transfer, transfer_input = np.zeros((2, columns, rows)), np.zeros((2, 2, rows))
        power, power_input = np.broadcast_to(identity, (2, size, size)), np.zeros((2, size, 2))
        for k in range(steps):
            power, power_input = across @ power, across @ power_input + across_input
            at = slice(columns + k * outputs, columns + (k + 1) * outputs)
            transfer[:, :size, at] = (output @ power).transpose(0, 2, 1)
            transfer_input[:, :, at] = (output @ power_input + output_input).transpose(0, 2, 1)
        transfer[:, :size, :size] = power.transpose(0, 2, 1)
        transfer_input[:, :, :size] = power_input.transpose(0, 2, 1)
        return transfer, transfer_input

    transfer, transfer_input = product(1)
    block, block_input = product(BLOCK)
    return {
        "transfer": transfer,
        "transfer_input": transfer_input,
        "block": block,
        "block_input": block_input,
        "observe": observe,
        "observe_input": observe_input,
    }


def _padded(count: int) -> int:
    return -(-count // _LANES) * _LANES


def _modal_bound(
    rates: FloatArray, inputs: FloatArray, functionals: FloatArray, feedthrough: FloatArray, step: float
) -> tuple[dict[str, npt.NDArray[np.generic]], bool]:
    """Per flow, what bounds a functional for all time: its rest value and its modes' amplitudes.

    With left eigenvectors w_k and right v_k, C x(t) = rest + sum of Re(C v_k  w_k·(x - x_rest) g_k(t)) and |g_k| <= 1
    both for exp(λ t) and for RK4's powers of R(h λ), within a step included (checked on a grid of partial steps).
    A flow with a mode at zero (it can drift) or with a badly conditioned eigenbasis has no such bound here.
    """
    size = rates.shape[1]
    provable = np.zeros(2, dtype=np.int64)
    mode_rows = np.zeros((2, 2, size, size))
    mode_reach = np.zeros((2, functionals.shape[1], size))
    rest_state = np.zeros((2, size, 2))
    rest_functional = np.zeros((2, functionals.shape[1], 2))
    stable = True
    for flow in range(2):
        eigenvalues, right = np.linalg.eig(rates[flow])
        eigenvalues, right = eigenvalues.astype(np.complex128), right.astype(np.complex128)
        partial = rk4_growth(eigenvalues[:, None], step * np.arange(1, 9) / 8)
        # numerically an undamped or rigid-body mode has a growth of 1 + rounding
        stable = stable and bool(np.all(partial[:, -1] <= 1 + 1e-9))
        at_zero = np.abs(eigenvalues) <= 1e-7 * np.max(np.abs(eigenvalues))
        if np.any(at_zero) or np.any(partial > 1 + 1e-12) or np.linalg.cond(right) > _MAX_CONDITION:
            continue
        provable[flow] = 1
        left = np.linalg.inv(right)
        weight = np.where(eigenvalues.imag > 0, 2.0, np.where(eigenvalues.imag < 0, 0.0, 1.0))
        mode_rows[flow, 0], mode_rows[flow, 1] = left.real, left.imag
        mode_reach[flow] = weight * np.abs(functionals[flow] @ right)
        rest_state[flow] = -np.linalg.solve(rates[flow], inputs[flow])
        rest_functional[flow] = functionals[flow] @ rest_state[flow] + feedthrough[flow]
    rest_functional[:, ACCELERATION] = 0.0  # at rest by definition; the product above leaves rounding
    bound = {
        "provable": provable,
        "mode_rows": mode_rows,
        "mode_reach": mode_reach,
        "rest_state": rest_state,
        "rest_functional": rest_functional,
    }
    return bound, stable


def _preload(
    stiffness: FloatArray, load: FloatArray, lash: FloatArray, contact_stiffness: float, grounded: bool
) -> tuple[FloatArray, FloatArray]:
    """Static equilibrium in contact, and the static torque across the lash, per unit of (T, s φ/2)."""
    n = load.size
    preload = np.zeros((2 * n, 2))
    if not grounded:
        return preload, np.zeros(2)
    closed = stiffness + contact_stiffness * np.outer(lash, lash)
    preload[:n] = np.linalg.solve(closed, np.column_stack([load, contact_stiffness * lash]))
    contact_torque = contact_stiffness * (lash @ preload[:n] - np.array([0.0, 1.0]))
    # a load that does not reach the lash, or a gap that does not load it, leaves rounding only
    scale = np.array([1.0, contact_stiffness])
    contact_torque[np.abs(contact_torque) <= 1e-12 * scale] = 0.0
    return preload, contact_torque
