"""A driveline with one lash as a switched linear system: a list of regimes, as data.

A run has the inputs d = (T, φ/2, T'): the load torque, the half gap, and the torque's rate of change. Within a regime
x' = A x + B u, with x = (θ, θ') and u = signs · d, each input by the regime's own sign: u = (T, s φ/2, T'), s the side
of the flank in contact (0: none). Between kinks of the load T' is constant; a load that swings or decays adds its wave
w to x = (θ, θ', w), w' = S w, whose first number is added to the torque.

A regime ends when one of its *guards*, sign · functional(x, u) + offsets · d, positive inside it, turns
negative; a table names its successor. For the indentation model (report §2.3.2):

    regime      flow     guards                       successor
    open        open     φ/2 - q,  q + φ/2            closed on the flank reached (touch)
    closed, s   closed   separation by gap:   s q - φ/2        open (separation)
                         separation by force: contact force    parted (separation)
    parted, s   open     s q - φ/2                    open (opening)
                         minus the contact force      closed (rejoin)

where q = lash · θ = θi - ratio θj, and the contact torque is k (s q - φ/2) + c s q'. *Parted* exists only for
separation by force: the flanks still overlap, but no longer press on each other.

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
TORQUE, HALF_GAP, TORQUE_RATE = range(3)
INPUTS = 3  # known to the compiler, which unrolls the loops over them
# The functionals: q, θ'' of one inertia, and the contact torque, signed like q: k q + c q', or the torque that locks q;
# the last is left out where no guard needs it, a functional less to step.
GAP, ACCELERATION, FORCE = range(3)

LOCKING_SHARE = 1e-4  # of the run's fastest touch: chatter has then lost all but 1e-8 of its energy

REGIME = np.dtype(
    [
        ("flow", np.int64),  # OPEN_FLOW or CLOSED_FLOW
        ("side", np.int64),  # s
        ("guards", np.int64),  # how many end it
        ("watched", np.int64),  # how many rows it has: those that end it, then those that make a margin only
        (
            "group",
            np.int64,
        ),  # of regimes with one flow and, but for the side, the same guards: runs in them step together
        ("of_gap", np.float64),  # margins in it are relative to of_gap · φ/2 + of_rest · what is at rest
        ("of_rest", np.float64),
    ],
    align=True,
)
GUARD = np.dtype(
    [
        ("functional", np.int64),  # guard = sign · functional + offsets · d
        ("sign", np.float64),
        ("successor", np.int64),  # the regime that follows where it turns negative, or -1
        ("event_kind", np.int64),  # the event that this is, or -1
        ("side", np.int64),  # and the flank that the event concerns
        ("zero_guard", np.int64),  # the successor's guard that is zero on entry, or -1
        ("zero_order", np.int64),  # and how many of its derivatives, itself included, are
        ("makes_margin", np.int64),  # whether its turning back or its depth does
        ("alike", np.int64),  # the regime's first guard of the same functional
    ],
    align=True,
)


class System(NamedTuple):
    """One driveline with its lash and contact, ready to run.

    n inertias, N states (2n, or 2n + 2 with a wave), I inputs, F functionals, L flows, R regimes in U groups, with at
    most G guards each.
    """

    # the flows
    rates: FloatArray  # (L, N, N)  A of each flow
    inputs: FloatArray  # (L, N, I)  B of each flow
    functionals: FloatArray  # (L, F, N)  C of each flow
    feedthrough: FloatArray  # (L, F, I)  D of each flow
    lash: FloatArray  # (N,)  q' = lash · x
    inertias: int  # n
    ramps: int  # whether the torque's rate of change can be other than zero
    # the regimes
    regimes: npt.NDArray[np.void]  # (R,) REGIME
    guards: npt.NDArray[np.void]  # (R, G) GUARD
    offsets: FloatArray  # (R, G, I)  of each guard
    signs: FloatArray  # (R, I)  u = signs · d
    leaders: IntArray  # (U,)  the first regime of each group
    # touches of the restitution model
    impulsive: int  # whether a touch resets the velocities
    impulse: FloatArray  # (N,)  change of x per unit of q'
    restitution: float  # e
    locking_speed: float  # rad/s; a negative one is relative to the fastest touch of the run so far
    # before the step
    preload: FloatArray  # (N, I)  steady motion in contact, at the load step, per unit of (T, s φ/2, 0)
    contact_torque: FloatArray  # (2,)  the torque across the lash in it, per unit of (T, s φ/2), signed like q
    drift: FloatArray  # (2n, 0 to 2)  what no torque depends on: the rigid-body angle and, without drag, its speed
    # scalars
    end_time: float  # s after the load step
    sticking_time: float  # s
    status: int  # why this system cannot be run, or OK


class RigidMotion(NamedTuple):
    """Motion of a driveline that twists no spring and no closed lash, if there is one, and what keeps it up."""

    shape: FloatArray  # (n, k)  speeds, relative to each other, of each of the k motions; more than one are refused
    speeds: FloatArray  # (n,)  constant speeds under a load of 1 N m, where dampers resist  [rad/s]
    accelerations: FloatArray  # (n,)  where none does  [rad/s2]
    is_dragged: bool  # whether dampers resist


def held(n: int) -> RigidMotion:
    """No rigid-body motion of `n` inertias: springs hold all of them to ground."""
    return RigidMotion(np.zeros((n, 0)), np.zeros(n), np.zeros(n), False)


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
    end_time: float,
    sticking_time: float,
    rigid: RigidMotion,
    restitution: float | None = None,
    locking_speed: float | None = None,
    wave_rates: FloatArray | None = None,
    ramps: bool = False,
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
    end_time, sticking_time : float  [s]
    rigid : RigidMotion
        Of the driveline with its lash closed.
    restitution : float, optional
        e of the restitution model; without it the contact is the spring and damper of the indentation model.
    locking_speed : float, optional  [rad/s]
        A rebound not faster than this locks; by default LOCKING_SHARE of the fastest touch of the run so far.
    wave_rates : (2, 2) float64, optional  [1/s]
        S of the load's wave, for loads that have one.
    ramps : bool
        Whether the torque's rate of change, an input, can be other than zero.
    """
    n = inertia.size
    impulsive = restitution is not None
    open_rates, open_inputs = chain(inertia, damping, stiffness, load)
    mobility = (lash**2 / inertia).sum()
    if impulsive:
        closed_rates, closed_inputs = _locked(open_rates, open_inputs, inertia, lash)
    else:
        coupling = lash[:, None] * lash
        closed_rates, closed_inputs = chain(
            inertia, damping + contact_damping * coupling, stiffness + contact_stiffness * coupling, load
        )
        closed_inputs[n:, HALF_GAP] = contact_stiffness * lash / inertia
    rates, inputs = np.array([open_rates, closed_rates]), np.array([open_inputs, closed_inputs])

    with_force = impulsive or separation_by_force
    functionals = np.zeros((2, 3 if with_force else 2, 2 * n))
    feedthrough = np.zeros((*functionals.shape[:2], INPUTS))
    functionals[:, GAP, :n] = lash
    functionals[:, ACCELERATION] = rates[:, n + acceleration_of]
    feedthrough[:, ACCELERATION] = inputs[:, n + acceleration_of]
    if impulsive:  # the torque that keeps q'' at zero, also where nothing does
        functionals[:, FORCE] = lash @ open_rates[n:] / mobility
        feedthrough[:, FORCE] = lash @ open_inputs[n:] / mobility
    elif separation_by_force:
        functionals[:, FORCE, :n] = contact_stiffness * lash
        functionals[:, FORCE, n:] = contact_damping * lash

    if impulsive:
        table = _restitution_table()
    else:
        table = _indentation_table(contact_stiffness, contact_damping, separation_by_force)
    motions = rigid.shape.shape[1]
    preload, inertial = np.zeros((2 * n, INPUTS)), load
    if motions:
        inertial = load - damping @ rigid.speeds - inertia * rigid.accelerations
    if motions <= 1:
        momentum = inertia[:, None] * rigid.shape
        angles = _preload(stiffness, inertial, lash, momentum, None if impulsive else contact_stiffness)
        preload[:n, :TORQUE_RATE], preload[n:, TORQUE] = angles, rigid.speeds
    system = System(
        rates=rates,
        inputs=inputs,
        functionals=functionals,
        feedthrough=feedthrough,
        lash=np.concatenate([np.zeros(n), lash]),
        inertias=n,
        ramps=int(ramps),
        **_tables(table),
        impulsive=int(impulsive),
        impulse=np.concatenate([np.zeros(n), lash / inertia / mobility]),
        restitution=restitution if restitution is not None else 0.0,
        locking_speed=locking_speed if locking_speed is not None else -LOCKING_SHARE,
        preload=preload,
        contact_torque=_contact_torque(stiffness, inertial, lash, preload[:n, :TORQUE_RATE]),
        drift=np.ascontiguousarray(np.kron(np.eye(2)[:, : 1 if rigid.is_dragged else 2], rigid.shape)),
        end_time=end_time,
        sticking_time=sticking_time,
        status=int(Status.OK if motions <= 1 else Status.NO_EQUILIBRIUM),
    )
    return system if wave_rates is None else _with_wave(system, wave_rates)


def _with_wave(system: System, wave_rates: FloatArray) -> System:
    """A system with two states more, w, the first of which is added to the torque."""
    flows, size = system.rates.shape[:2]
    rates, functionals = np.zeros((flows, size + 2, size + 2)), _wider(system.functionals)
    rates[:, :size, :size], rates[:, size:, size:] = system.rates, wave_rates
    rates[:, :size, size], functionals[:, :, size] = system.inputs[:, :, TORQUE], system.feedthrough[:, :, TORQUE]
    return system._replace(
        rates=rates,
        inputs=_wider(system.inputs.swapaxes(1, 2)).swapaxes(1, 2).copy(),
        functionals=functionals,
        lash=_wider(system.lash),
        impulse=_wider(system.impulse),
        preload=_wider(system.preload.T).T.copy(),
    )


def _wider(array: FloatArray) -> FloatArray:
    """An array whose last dimension is longer by two zeros."""
    return np.concatenate([array, np.zeros((*array.shape[:-1], 2))], axis=-1)


class _Guard(NamedTuple):
    """A guard, sign · functional + offset · φ/2, and what follows where it turns negative."""

    functional: int
    sign: float
    offset: float
    successor: int = -1
    event_kind: int = -1
    zero_guard: int = -1
    zero_order: int = 0
    makes_margin: bool = False


class _Regime(NamedTuple):
    """A regime, its guards, and those functionals that end nothing, but whose turning back makes a margin."""

    flow: int
    side: int
    guards: list[_Guard]
    watched: tuple[_Guard, ...] = ()
    of_gap: float = 0.0
    of_rest: float = 1.0


def _indentation_table(stiffness: float, damping: float, separation_by_force: bool) -> list[_Regime]:
    # at a touch the overlap is zero, but the contact force is c q' > 0, if there is damping
    order = 0 if separation_by_force and damping > 0.0 else 1
    regimes = [_open(0 if order else -1, order)]
    for side, parted in ((1, PARTED_POSITIVE), (-1, PARTED_NEGATIVE)):
        if separation_by_force:
            # the flanks may press less than nothing on each other; a miss is near where they all but cease to overlap
            force = _Guard(FORCE, side, -stiffness, parted, SEPARATION, 1, 1)
            regimes.append(_Regime(CLOSED_FLOW, side, [force], (_Guard(GAP, side, -1.0, makes_margin=True),)))
        else:
            overlap = _Guard(GAP, side, -1.0, OPEN, SEPARATION, _reached(side), 1, makes_margin=True)
            regimes.append(_Regime(CLOSED_FLOW, side, [overlap]))
    for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE)):
        if separation_by_force:
            opening = _Guard(GAP, side, -1.0, OPEN, OPENING, _reached(side), 1, makes_margin=True)
            rejoin = _Guard(FORCE, -side, stiffness, closed, REJOIN, 0, 1)
            regimes.append(_Regime(OPEN_FLOW, side, [opening, rejoin]))
    return regimes


def _restitution_table() -> list[_Regime]:
    # What follows a touch is decided at the touch; a separation leaves with value, slope and curvature of the gap zero.
    return [_open(-1, 0)] + [
        _Regime(
            CLOSED_FLOW,
            side,
            [_Guard(FORCE, side, 0.0, OPEN, SEPARATION, _reached(side), zero_order=3, makes_margin=True)],
        )
        for side in (1, -1)
    ]


def _open(zero_guard: int, zero_order: int) -> _Regime:
    """The open regime, by the guard of a closed one that is zero at a touch, and its order; margins are of the gap."""
    return _Regime(
        OPEN_FLOW,
        0,
        [
            _Guard(GAP, -side, 1.0, closed, TOUCH, zero_guard, zero_order, makes_margin=True)
            for side, closed in ((1, CLOSED_POSITIVE), (-1, CLOSED_NEGATIVE))
        ],
        of_gap=2.0,
        of_rest=0.0,
    )


def _reached(side: int) -> int:
    """The open regime's guard of the flank of `side`."""
    return 0 if side > 0 else 1


def _tables(table: list[_Regime]) -> dict[str, npt.NDArray[Any]]:
    """The arrays of `System` for a list of regimes. Those with one flow and the same functionals are a group."""
    most = max(len(row.guards) + len(row.watched) for row in table)
    regimes, guards = np.zeros(len(table), REGIME), np.zeros((len(table), most), GUARD)
    offsets = np.zeros((len(table), most, INPUTS))
    alike = [_but_for_side(row) for row in table]
    leaders = [k for k, key in enumerate(alike) if alike.index(key) == k]
    for k, row in enumerate(table):
        rows = [*row.guards, *row.watched]
        group = leaders.index(alike.index(alike[k]))
        regimes[k] = (row.flow, row.side, len(row.guards), len(rows), group, row.of_gap, row.of_rest)
        for g, guard in enumerate(rows):
            side = row.side or (1 if guard.successor == CLOSED_POSITIVE else -1)
            first = [other.functional for other in rows].index(guard.functional)
            guards[k, g] = (*guard[:2], *guard[3:5], side, *guard[5:7], guard.makes_margin, first)
            offsets[k, g, HALF_GAP] = guard.offset
    signs = np.ones((len(table), INPUTS))
    signs[:, HALF_GAP] = regimes["side"]
    return {
        "regimes": regimes,
        "guards": guards,
        "offsets": offsets,
        "signs": signs,
        "leaders": np.array(leaders),
    }


def _but_for_side(row: _Regime) -> tuple[Any, ...]:
    """What regimes of a group have in common: their flow, and guards of the same functionals and signs but for side."""
    guards = [(guard.functional, (row.side or 1) * guard.sign) for guard in (*row.guards, *row.watched)]
    return row.flow, row.side != 0, guards


def chain(
    inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, load: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A and B of M θ'' + C θ' + K θ = b T."""
    n = inertia.size
    rates, inputs = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, INPUTS))
    rates[:n, n:] = np.eye(n)
    rates[n:, :n] = -stiffness / inertia[:, None]
    rates[n:, n:] = -damping / inertia[:, None]
    inputs[n:, TORQUE] = load / inertia
    return rates, inputs


def _locked(
    rates: FloatArray, inputs: FloatArray, inertia: FloatArray, lash: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A and B with q' = 0 as a true constraint: the inertias at the lash move in the ratio that leaves q as it is.

    Without a gear ratio they share one acceleration, to the last bit.
    """
    n = inertia.size
    rates, inputs = rates.copy(), inputs.copy()
    ends = np.flatnonzero(lash)
    motion = constrained(lash).expand[ends, : n - 1].sum(axis=1)  # of the ends, where one of them turns by 1
    for matrix in (rates, inputs):
        torques = (inertia[ends] * motion) @ matrix[n + ends]
        matrix[n + ends] = motion[:, None] * (torques / np.sum(inertia[ends] * motion**2)) if ends.size > 1 else 0.0
    return rates, inputs


class Reduction(NamedTuple):
    """Coordinates y in which a flow has no constraint: (θ, θ') = expand y + shift s φ/2 and y = pick (θ, θ')."""

    expand: FloatArray
    pick: FloatArray
    shift: FloatArray


def unconstrained(size: int) -> Reduction:
    """Every coordinate its own."""
    return Reduction(np.eye(size), np.eye(size), np.zeros(size))


def with_wave(reduction: Reduction, states: int) -> Reduction:
    """A reduction of a system with `states` of a wave more, which nothing constrains."""
    expand, pick = (
        np.block([[matrix, np.zeros((matrix.shape[0], states))], [np.zeros((states, matrix.shape[1])), np.eye(states)]])
        for matrix in (reduction.expand, reduction.pick)
    )
    return Reduction(expand, pick, np.concatenate([reduction.shift, np.zeros(states)]))


def constrained(lash: FloatArray) -> Reduction:
    """Without the angle of one inertia at the lash, which q = s φ/2 and q' = 0 give.

    It is the last of those that turn as q does, not through the gear ratio: q' is then zero to the last bit.
    """
    n = lash.size
    ends = np.flatnonzero(lash)
    plain = ends[np.abs(lash[ends]) == 1.0]
    pivot = int(plain[-1] if plain.size else ends[-1])
    basis: FloatArray = np.eye(n)
    basis[pivot] = -lash / lash[pivot]
    basis = np.delete(basis, pivot, axis=1)
    pick = np.delete(np.eye(n), pivot, axis=0)
    shift = np.zeros(2 * n)
    shift[pivot] = 1.0 / lash[pivot]
    both: FloatArray = np.eye(2)
    return Reduction(np.kron(both, basis).astype(np.float64), np.kron(both, pick).astype(np.float64), shift)


def without_drift(reduction: Reduction, drift: FloatArray) -> Reduction:
    """The same coordinates, relative to some that are left out: as many as there are states that nothing depends on.

    drift : (N, D) float64, these states; each is zero where the others are not
    """
    if not drift.size:
        return reduction
    along = reduction.pick @ drift
    size, columns = along.shape
    pivots = np.abs(along).argmax(axis=0)
    every: FloatArray = np.eye(size)
    relative = every - along / along[pivots, np.arange(columns)] @ every[pivots]
    pick = np.delete(relative, pivots, axis=0) @ reduction.pick
    return Reduction(np.delete(reduction.expand, pivots, axis=1), pick, reduction.shift)


def _preload(
    stiffness: FloatArray, load: FloatArray, lash: FloatArray, momentum: FloatArray, contact_stiffness: float | None
) -> FloatArray:
    """Angles in steady motion in contact, per unit of (T, s φ/2): (n, 2). Without a contact stiffness q is locked.

    load : (n,) float64
        Less what drag and inertia take of it.
    momentum : (n, 0 or 1) float64
        Of the rigid-body motion: of the angles that differ by it, those are taken that have none of it in sum.
    """
    if contact_stiffness is None:
        n = load.size
        expand, _, shift = (part[:n] for part in constrained(lash))
        basis = expand[:, : n - 1]
        forces = np.column_stack([load, -stiffness @ shift])
        kept = np.column_stack([np.zeros(momentum.shape[1]), -momentum.T @ shift])
        rest: FloatArray = basis @ _solve(basis.T @ stiffness @ basis, basis.T @ forces, basis.T @ momentum, kept)
        rest[:, 1] += shift
        return rest
    closed = stiffness + contact_stiffness * lash[:, None] * lash
    forces = np.column_stack([load, contact_stiffness * lash])
    return _solve(closed, forces, momentum, np.zeros((momentum.shape[1], 2)))


def _solve(matrix: FloatArray, forces: FloatArray, momentum: FloatArray, kept: FloatArray) -> FloatArray:
    """The angles at which a stiffness matrix balances forces and whose momenta, if there are any, are `kept`."""
    count = momentum.shape[1]
    if not count:
        return np.asarray(np.linalg.solve(matrix, forces), np.float64)
    scale = np.abs(matrix).max(initial=0.0) / np.abs(momentum).max() or 1.0
    bordered = np.block([[matrix, scale * momentum], [scale * momentum.T, np.zeros((count, count))]])
    return np.asarray(np.linalg.solve(bordered, np.vstack([forces, scale * kept]))[: len(matrix)], np.float64)


def _contact_torque(stiffness: FloatArray, load: FloatArray, lash: FloatArray, preload: FloatArray) -> FloatArray:
    """The torque across the lash, signed like q, per unit of (T, s φ/2): what balances one of its inertias.

    load : as for `_preload`
    """
    end = int(np.flatnonzero(lash)[0])
    pull = stiffness[end] @ preload
    torque: FloatArray = (np.array([load[end], 0.0]) - pull) / lash[end]
    # a load that does not reach the lash, or a gap that does not load it, leaves rounding only
    scale = np.array([1.0, np.abs(stiffness).max(initial=0.0) + 1e-300])
    torque[np.abs(torque) <= 1e-11 * scale] = 0.0
    return torque
