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

The restitution model (report §2.3.1) has the regimes open and closed too, but closed is the chain with q locked at
s φ/2, a constraint whose torque is the guard, and a touch *resets* the velocities (report Eq. 2.9): it rebounds into
the open regime, or, below the locking speed and under a compressive torque, locks.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.events import OPENING, REJOIN, SEPARATION, TOUCH
from clunk.core.status import Status

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

OPEN_FLOW, CLOSED_FLOW = 0, 1
OPEN, CLOSED_POSITIVE, CLOSED_NEGATIVE, PARTED_POSITIVE, PARTED_NEGATIVE = range(5)
# The functionals: q, θ'' of one inertia, and, where a guard needs it, the contact torque, signed like q: k q + c q', or
# the torque that locks q (one output less to step without it).
GAP, ACCELERATION, FORCE = range(3)

# On a step of length h, |p(s)| exceeds its larger end value by at most max|p''| h²/8 <= |c2|/4 + 3|c3|/4 + 3|c4|/2
# in the step's Taylor terms c_k = p_k h^k; these factors make that a plain sum.
BEND = (1.0, 0.25, 0.75, 1.5)
BLOCK = 4  # steps in one product: a third fewer operations a step than four products, and a quarter of their latency
LOCKING_SHARE = 1e-4  # of the run's fastest touch: chatter has then lost all but 1e-8 of its energy
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
    zero_order: IntArray  # (5, 2)  and how many of its derivatives, itself included, are
    # touches of the restitution model
    impulsive: int  # whether a touch resets the velocities
    impulse: FloatArray  # (N,)  change of x per unit of q'
    restitution: float  # e
    locking_speed: float  # rad/s; a negative one is relative to the fastest touch of the run so far
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
    restitution: float | None = None,
    locking_speed: float | None = None,
) -> System:
    """The switched linear system of a driveline with one lash (report Eqs 2.6, and 2.12 or 2.9).

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
    restitution : float, optional
        e of the restitution model; without it the contact is the spring and damper of the indentation model.
    locking_speed : float, optional  [rad/s]
        A rebound not faster than this locks; by default LOCKING_SHARE of the fastest touch of the run so far.
    """
    n = inertia.size
    impulsive = restitution is not None
    open_rates, open_inputs = chain(inertia, damping, stiffness, load)
    impulse = lash / inertia / np.sum(lash**2 / inertia)
    if impulsive:
        closed_rates, closed_inputs = _locked(open_rates, open_inputs, inertia, lash)
    else:
        coupling = np.outer(lash, lash)
        closed_rates, closed_inputs = chain(
            inertia, damping + contact_damping * coupling, stiffness + contact_stiffness * coupling, load
        )
        closed_inputs[n:, 1] = contact_stiffness * lash / inertia
    rates, inputs = np.stack([open_rates, closed_rates]), np.stack([open_inputs, closed_inputs])

    with_force = impulsive or separation_by_force
    functionals = np.zeros((2, 3 if with_force else 2, 2 * n))
    feedthrough = np.zeros((*functionals.shape[:2], 2))
    functionals[:, GAP, :n] = lash
    functionals[:, ACCELERATION] = rates[:, n + acceleration_of]
    feedthrough[:, ACCELERATION] = inputs[:, n + acceleration_of]
    if impulsive:  # the torque that keeps q'' at zero, also where nothing does
        mobility = np.sum(lash**2 / inertia)
        functionals[:, FORCE] = lash @ open_rates[n:] / mobility
        feedthrough[:, FORCE] = lash @ open_inputs[n:] / mobility
    elif separation_by_force:
        functionals[:, FORCE, :n] = contact_stiffness * lash
        functionals[:, FORCE, n:] = contact_damping * lash

    if impulsive:
        guards = _restitution_table()
    else:
        guards = _indentation_table(contact_stiffness, contact_damping, separation_by_force)
    propagator = _propagator(rates, inputs, functionals, feedthrough, step)
    reductions = [unconstrained(2 * n), constrained(lash) if impulsive else unconstrained(2 * n)]
    modal, stable = _modal_bound(rates, inputs, functionals, feedthrough, step, reductions)
    preload = np.zeros((2 * n, 2))
    if grounded:
        preload[:n] = _preload(stiffness, load, lash, None if impulsive else contact_stiffness)
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
        **_as_arrays(guards),
        impulsive=int(impulsive),
        impulse=np.concatenate([np.zeros(n), impulse]),
        restitution=restitution if restitution is not None else 0.0,
        locking_speed=locking_speed if locking_speed is not None else -LOCKING_SHARE,
        preload=preload,
        contact_torque=_contact_torque(stiffness, load, lash, preload[:n]),
        **modal,
        step=step,
        end_time=end_time,
        sticking_time=sticking_time,
        status=int(status),
    )


def stack(systems: list[System]) -> System:
    """Systems of equal size behind each other: every field gets a leading dimension of their number."""
    fields: list[Any] = [np.stack(field) for field in zip(*systems, strict=True)]
    return System(*fields)


def rk4_growth(eigenvalues: npt.NDArray[np.complex128], step: float | FloatArray) -> FloatArray:
    """|R(h λ)| with RK4's stability polynomial R(z) = 1 + z + z²/2 + z³/6 + z⁴/24."""
    z = eigenvalues * step
    return np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4))))


class _Guard(NamedTuple):
    """A guard, sign · functional + offset · φ/2, and what follows where it turns negative."""

    functional: int
    sign: float
    offset: float
    successor: int
    event_kind: int
    zero_guard: int = -1
    zero_order: int = 0


_Regimes = list[tuple[int, int, list[_Guard]]]  # flow, side, guards


def _indentation_table(stiffness: float, damping: float, separation_by_force: bool) -> _Regimes:
    touch_order = 0 if separation_by_force and damping > 0.0 else 1  # at a touch the force is c q' > 0, the overlap 0
    rows: _Regimes = [
        (
            OPEN_FLOW,
            0,
            [
                _Guard(GAP, -1.0, 1.0, CLOSED_POSITIVE, TOUCH, 0 if touch_order else -1, touch_order),
                _Guard(GAP, 1.0, 1.0, CLOSED_NEGATIVE, TOUCH, 0 if touch_order else -1, touch_order),
            ],
        )
    ]
    for side, parted in ((1, PARTED_POSITIVE), (-1, PARTED_NEGATIVE)):
        if separation_by_force:
            rows.append((CLOSED_FLOW, side, [_Guard(FORCE, side, -stiffness, parted, SEPARATION, 1, 1)]))
        else:
            rows.append((CLOSED_FLOW, side, [_Guard(GAP, side, -1.0, OPEN, SEPARATION, _reached(side), 1)]))
    for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE)):
        opening = _Guard(GAP, side, -1.0, OPEN, OPENING, _reached(side), 1)
        rejoin = _Guard(FORCE, -side, stiffness, closed, REJOIN, 0, 1)
        rows.append((OPEN_FLOW, side, [opening, rejoin] if separation_by_force else [opening]))
    return rows


def _restitution_table() -> _Regimes:
    # What follows a touch is decided at the touch; a separation leaves with value, slope and curvature of the gap zero.
    touch = [_Guard(GAP, -1.0, 1.0, OPEN, TOUCH), _Guard(GAP, 1.0, 1.0, OPEN, TOUCH)]
    closed: _Regimes = [
        (CLOSED_FLOW, side, [_Guard(FORCE, side, 0.0, OPEN, SEPARATION, _reached(side), 3)]) for side in (1, -1)
    ]
    parted: _Regimes = [(OPEN_FLOW, side, [_Guard(GAP, side, -1.0, OPEN, OPENING)]) for side in (1, -1)]  # not entered
    return [(OPEN_FLOW, 0, touch), *closed, *parted]


def _reached(side: int) -> int:
    """The open regime's guard of the flank of `side`."""
    return 0 if side > 0 else 1


def _as_arrays(regimes: _Regimes) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "flow": np.array([flow for flow, _, _ in regimes], dtype=np.int64),
        "side": np.array([side for _, side, _ in regimes], dtype=np.int64),
        "guards": np.array([len(guards) for _, _, guards in regimes], dtype=np.int64),
    }
    names = {"functional": "guard_functional", "sign": "guard_sign", "offset": "guard_offset"}
    for field in _Guard._fields:
        values = np.zeros((len(regimes), 2), dtype=np.float64 if field in ("sign", "offset") else np.int64)
        for regime, (_, _, guards) in enumerate(regimes):
            for k, guard in enumerate(guards):
                values[regime, k] = getattr(guard, field)
        columns[names.get(field, field)] = values
    return columns


def chain(
    inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, load: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A and B of M θ'' + C θ' + K θ = b T."""
    n = inertia.size
    rates, inputs = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2))
    rates[:n, n:] = np.eye(n)
    rates[n:, :n] = -stiffness / inertia[:, None]
    rates[n:, n:] = -damping / inertia[:, None]
    inputs[n:, 0] = load / inertia
    return rates, inputs


def _locked(
    rates: FloatArray, inputs: FloatArray, inertia: FloatArray, lash: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A and B with q' = 0 as a true constraint: the inertias at the lash share one acceleration, to the last bit."""
    n = inertia.size
    rates, inputs = rates.copy(), inputs.copy()
    ends = np.flatnonzero(lash)
    for matrix in (rates, inputs):
        rows = matrix[n + ends]
        matrix[n + ends] = 0.0 if ends.size == 1 else inertia[ends] @ rows / np.sum(inertia[ends])
    return rates, inputs


class Reduction(NamedTuple):
    """Coordinates y in which a flow has no constraint: x = expand y + shift s φ/2 and y = pick x."""

    expand: FloatArray
    pick: FloatArray
    shift: FloatArray


def unconstrained(size: int) -> Reduction:
    """Every coordinate its own."""
    return Reduction(np.eye(size), np.eye(size), np.zeros(size))


def constrained(lash: FloatArray) -> Reduction:
    """Without the last angle at the lash, which q = s φ/2 and q' = 0 give."""
    n = lash.size
    pivot = int(np.flatnonzero(lash)[-1])
    basis: FloatArray = np.eye(n)
    basis[pivot] = -lash / lash[pivot]
    basis = np.delete(basis, pivot, axis=1)
    pick = np.delete(np.eye(n), pivot, axis=0)
    shift = np.zeros(2 * n)
    shift[pivot] = 1.0 / lash[pivot]
    both: FloatArray = np.eye(2)
    return Reduction(np.kron(both, basis).astype(np.float64), np.kron(both, pick).astype(np.float64), shift)


def _propagator(
    rates: FloatArray, inputs: FloatArray, functionals: FloatArray, feedthrough: FloatArray, step: float
) -> dict[str, Any]:
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
    rows: FloatArray = output.reshape(2, -1, size)
    rows_input: FloatArray = output_input.reshape(2, -1, 2)

    columns, outputs = _padded(size), rows.shape[1]
    observe, observe_input = np.zeros((2, columns, outputs)), np.zeros((2, 2, outputs))
    observe[:, :size] = rows.transpose(0, 2, 1)
    observe_input[:] = rows_input.transpose(0, 2, 1)

    def product(steps: int) -> tuple[FloatArray, FloatArray]:
        """(x, outputs at every step) after `steps` steps."""
        width = _padded(columns + steps * outputs)
        transfer, transfer_input = np.zeros((2, columns, width)), np.zeros((2, 2, width))
        power, power_input = np.broadcast_to(identity, (2, size, size)), np.zeros((2, size, 2))
        for k in range(steps):
            power, power_input = across @ power, across @ power_input + across_input
            at = slice(columns + k * outputs, columns + (k + 1) * outputs)
            transfer[:, :size, at] = (rows @ power).transpose(0, 2, 1)
            transfer_input[:, :, at] = (rows @ power_input + rows_input).transpose(0, 2, 1)
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
    rates: FloatArray,
    inputs: FloatArray,
    functionals: FloatArray,
    feedthrough: FloatArray,
    step: float,
    reductions: list[Reduction],
) -> tuple[dict[str, Any], bool]:
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
    for flow, (expand, pick, shift) in enumerate(reductions):
        reduced = pick @ rates[flow] @ expand
        eigenvalues, right = np.linalg.eig(reduced)
        eigenvalues, right = eigenvalues.astype(np.complex128), right.astype(np.complex128)
        partial = rk4_growth(eigenvalues[:, None], step * np.arange(1, 9) / 8)
        # numerically an undamped or rigid-body mode has a growth of 1 + rounding
        stable = stable and bool(np.all(partial[:, -1] <= 1 + 1e-9))
        at_zero = np.abs(eigenvalues) <= 1e-7 * np.max(np.abs(eigenvalues), initial=0.0)
        if np.any(at_zero) or np.any(partial > 1 + 1e-12):
            continue
        if eigenvalues.size and np.linalg.cond(right) > _MAX_CONDITION:
            continue
        provable[flow] = 1
        count = eigenvalues.size
        left = np.linalg.inv(right) @ pick
        weight = np.where(eigenvalues.imag > 0, 2.0, np.where(eigenvalues.imag < 0, 0.0, 1.0))
        mode_rows[flow, 0, :count], mode_rows[flow, 1, :count] = left.real, left.imag
        mode_reach[flow, :, :count] = weight * np.abs(functionals[flow] @ expand @ right)
        forcing = inputs[flow].copy()
        forcing[:, 1] += rates[flow] @ shift
        rest_state[flow] = -expand @ np.linalg.solve(reduced, pick @ forcing)
        rest_state[flow, :, 1] += shift
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


def _preload(stiffness: FloatArray, load: FloatArray, lash: FloatArray, contact_stiffness: float | None) -> FloatArray:
    """Static equilibrium in contact, per unit of (T, s φ/2): (n, 2). Without a contact stiffness q is locked."""
    if contact_stiffness is None:
        n = load.size
        expand, _, shift = (part[:n] for part in constrained(lash))
        basis = expand[:, : n - 1]
        forces = np.column_stack([load, -stiffness @ shift])
        rest: FloatArray = basis @ np.linalg.solve(basis.T @ stiffness @ basis, basis.T @ forces)
        rest[:, 1] += shift
        return rest
    closed = stiffness + contact_stiffness * np.outer(lash, lash)
    return np.asarray(np.linalg.solve(closed, np.column_stack([load, contact_stiffness * lash])), np.float64)


def _contact_torque(stiffness: FloatArray, load: FloatArray, lash: FloatArray, preload: FloatArray) -> FloatArray:
    """The static torque across the lash, signed like q, per unit of (T, s φ/2): what balances one of its inertias."""
    end = int(np.flatnonzero(lash)[0])
    pull = stiffness[end] @ preload
    torque: FloatArray = lash[end] * (np.array([load[end], 0.0]) - pull)
    # a load that does not reach the lash, or a gap that does not load it, leaves rounding only
    scale = np.array([1.0, np.max(np.abs(stiffness), initial=0.0) + 1e-300])
    torque[np.abs(torque) <= 1e-11 * scale] = 0.0
    return torque
