"""A driveline with lashes as a switched linear system: a list of regimes, as data.

A run has the inputs d = (T, φ/2, T', …, 1, …): load torque, half gap of the first lash, the torque's rate of change,
the half gaps of the other lashes, a 1 for each staged shaft, and for each friction a 1 and the twist at which it
sticks. Within a regime x' = A x + B u, with x = (θ, θ') and u = weights · d, each input by the regime's own weight:
u = (T, s φ/2, T', …, c, …), s the side of a lash's flank in contact (0: none), and c the torque at twist 0 of the line
that a staged shaft's torque is on, or the torque of a friction that slips. Between kinks of the load T' is constant; a
load that swings or decays adds its wave w to x = (θ, θ', w), w' = S w, whose first number is added to the torque.

A regime ends when one of its *guards*, sign · functional(x, u) + offsets · d, positive inside it, turns negative;
`clunk.core.tables` names its successor.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray, Positions, Records
from clunk.core.batches import alike
from clunk.core.equilibrium import steady_motion
from clunk.core.jit import inlined_part, part
from clunk.core.reductions import chain, constrained, locked
from clunk.core.status import NO_EQUILIBRIUM, OK
from clunk.core.sums import weigh
from clunk.core.tables import (
    ACCELERATION,
    FORCE,
    GAP,
    HOLDING,
    INPUTS,
    OF_FRICTION,
    RATE,
    TORQUE,
    TORQUE_RATE,
    FlowOf,
    Friction,
    Lashes,
    StagedShaft,
    build_tables,
    functionals_of,
    half_gap_of,
)

LOCKING_SHARE = 1e-4  # default locking speed, as a share of the fastest touch: chatter has then 1e-8 of its energy left
ROUNDING = 8 * np.finfo(np.float64).eps  # relative to the terms of a sum of a few products
_SINGULAR = 1e-12  # share of a twist's mobility without constraints: with them, a smaller mobility is rounding


class System(NamedTuple):
    """One driveline with its lashes and contacts, ready to run.

    n inertias, N states (2n, or 2n + 2 with a wave), I inputs, F functionals, K flows, L lashes, R regimes in U groups,
    with at most G guards each, those that only make a margin included; E elements, M of them frictions, S combinations
    of stages, H sets of closed lashes.
    """

    # the flows
    rates: FloatArray  # (K, N, N)  A of each flow
    inputs: FloatArray  # (K, N, I)  B of each flow
    functionals: FloatArray  # (K, F, N)  C of each flow
    feedthrough: FloatArray  # (K, F, I)  D of each flow
    # (K, F, 3, 2, N + I)  for each functional and its first two time derivatives: coefficients of x and u, and
    # coefficients of |x| and |u|, which give the sum of the terms' magnitudes; (K, 0, …) without frictions and rigid
    # flanks
    outputs: FloatArray
    functionals_per_lash: int
    lashes: FloatArray  # (L, N)  q' = lashes · x
    inertias: int  # n
    lash_count: int  # L
    friction_count: int  # M
    input_count: int  # I
    element_count: int  # E
    ramps: int  # whether the torque's rate of change is an input: exact, loads with ramps; rk4 has ramps in the wave
    # the regimes
    regimes: Records  # (R,) REGIME
    contacts: Records  # (R, L) CONTACT
    guards: Records  # (R, G) GUARD
    offsets: FloatArray  # (R, G, I)  of each guard
    weights: FloatArray  # (R, I)  u = weights · d
    leaders: IntArray  # (U,)  the first regime of each group
    # (E + 1,)  by how much a regime's number changes with the state of each lash, shaft and friction
    regime_strides: IntArray
    # touches of the restitution model
    impulsive: int  # whether a touch resets the velocities
    # in row h of the next two, an impact leaves those lashes closed whose bits are set in h; H is 1 with one lash, and
    # without rigid flanks
    impulse: FloatArray  # (H, L, N)  change of x by an impulse across a lash, per unit of change of its q'
    passed: FloatArray  # (H, L, L)  impulse that then passes through each lash, per unit of change of q'  [kg m2]
    restitution: FloatArray  # (L,)  e
    locking_speed: FloatArray  # (L,)  rad/s; a negative one is minus a share of the lash's fastest touch so far
    # frictions
    frictions: FloatArray  # (M, N)  rate of twist = frictions · x
    friction_states: IntArray  # (R, M)  state of each friction in each regime
    friction_torques: FloatArray  # (M,)  largest torque that each friction holds  [N m]
    excess: IntArray  # (K,)  whether a friction sticks in a flow whose other constraints already hold its twist
    # before the load step
    steady_motion: FloatArray  # (S, N, I)  x in steady motion in contact, in each combination of stages, by u
    contact_torque: FloatArray  # (S, L, I)  torque across each lash in that motion, signed like q, by u
    # (2n, 0 to 2)  directions of (θ, θ') on which no torque depends: the driveline rolls by an angle, if it can roll,
    # and, without drag, at a speed; 1 at the first inertia that rolls
    drift: FloatArray
    first_rolling: int  # the first inertia that rolls, or -1
    # scalars
    end_time: FloatArray  # (1,)  s after the load step
    sticking_time: FloatArray  # (L,)  s; 0 of rigid flanks, which have no contact period
    status: int  # why this system cannot be run, or OK


# The fields in which drivelines of one structure differ: in a batch of D drivelines they have an axis of D in front.
VARYING = tuple(name for name, kind in System.__annotations__.items() if kind is FloatArray)


def driveline_at(systems: System, index: Positions | list[int] | int | None) -> System:
    """One driveline of a batch, or the batch of some of them; with None, the batch of one driveline alone."""
    return systems._replace(**{name: getattr(systems, name)[index] for name in VARYING})


gap_input = inlined_part(half_gap_of)


@part
def roll(system: System, angle: float, x: FloatArray) -> None:
    """Turn a state by an angle of the first inertia that rolls  [rad]."""
    for k in range(system.inertias if system.first_rolling >= 0 else 0):
        x[k] += system.drift[k, 0] * angle


@part
def turn_back(system: System, x: FloatArray) -> float:
    """Turn a state back by the angle of the first inertia that rolls, and return that angle  [rad]."""
    angle = x[system.first_rolling] if system.first_rolling >= 0 else 0.0
    roll(system, -angle, x)
    return angle


def rolling_apart(system: System, size: int) -> tuple[FloatArray, FloatArray]:
    """Matrix that subtracts the rolling from angles and speeds but the first rolling inertia's, and its inverse.

    size : number of states, N

    Returns (…, N, N) and (…, N, N) float64.
    """
    n, first = system.inertias, system.first_rolling
    together = np.zeros((*system.drift.shape[:-2], size, size)) + np.eye(size)
    together[..., :n, first] = together[..., n : 2 * n, n + first] = system.drift[..., :n, 0]
    return 2.0 * np.eye(size) - together, together


@inlined_part
def stride_of_friction(system: System, friction: int) -> int:
    """Stride of a regime's number with the state of a friction."""
    return system.regime_strides[system.element_count - system.friction_count + friction]


@inlined_part
def input_of_friction(system: System, friction: int) -> int:
    """The input that is 1 for a friction; the next input is the twist at which the friction sticks."""
    return system.input_count - OF_FRICTION * (system.friction_count - friction)


@inlined_part
def rate_of_friction(system: System, friction: int) -> int:
    """The functional that is the rate of twist of a friction; the next functional is the torque that holds it."""
    return system.functionals.shape[1] - OF_FRICTION * (system.friction_count - friction)


@inlined_part
def lash_of(system: System, regime: int, guard: int) -> int:
    """The lash that a guard belongs to, or -1.

    Without this function, with the field read in place, the exact method takes a quarter longer.
    """
    return system.guards[regime, guard].lash


@inlined_part
def speed_of(system: System, lash: int, x: FloatArray) -> float:
    """The speed q' of a lash  [rad/s]."""
    return weigh(system.lashes[lash], x)


@inlined_part
def overlap_of(system: System, lash: int, side: int, x: FloatArray, inputs: FloatArray) -> float:
    """Overlap of the flanks of a lash on one side  [rad]."""
    return side * twist_of(system, system.lashes[lash], x)[0] - inputs[gap_input(lash)]


@part
def twist_of(system: System, weights: FloatArray, x: FloatArray) -> tuple[float, float]:
    """The twist whose rate is weights (N,) times the state, and the sum of its terms' magnitudes  [rad]."""
    twist = size = 0.0
    for k in range(system.inertias):
        term = weights[system.inertias + k] * x[k]
        twist, size = twist + term, size + abs(term)
    return twist, size


@part
def guard_of(system: System, regime: int, functional: int, sign: float) -> int:
    """The guard of a regime with a given functional and sign, or -1."""
    for g in range(system.regimes[regime].guards):
        guard = system.guards[regime, g]
        if guard.functional == functional and guard.sign == sign:
            return g
    return -1


@inlined_part
def opened(system: System, regime: int, lash: int) -> int:
    """The regime that differs from a given one only in that a lash is open."""
    stride = system.regime_strides[lash]
    return regime - regime % system.regime_strides[lash + 1] // stride * stride


@inlined_part
def closed_lashes(system: System, regime: int, lash: int) -> int:
    """The closed lashes of a regime, as bits, without one of them; with -1, all."""
    closed = 0
    for other in range(system.lash_count):
        closed |= (other != lash and system.contacts[regime, other].closed != 0) << other
    return closed


class RigidMotion(NamedTuple):
    """Rigid-body motion of a driveline, which twists no spring and no closed lash, and its response to the load."""

    shape: FloatArray  # (…, n, k)  relative speeds of the inertias in each of k motions; more than one are refused
    speeds: FloatArray  # (…, n)  constant speeds under a load of 1 N m, where dampers resist  [rad/s]
    accelerations: FloatArray  # (…, n)  accelerations under that load, where no damper resists  [rad/s2]
    is_dragged: bool  # whether dampers resist


def build_system(
    *,
    inertia: FloatArray,
    chains: Mapping[FlowOf, tuple[FloatArray, FloatArray]],
    load: FloatArray,
    lashes: Lashes,
    end_time: FloatArray,
    rigid: RigidMotion,
    wave_rates: FloatArray | None,
    ramps: bool,
    staged: Sequence[StagedShaft],
    loose: Sequence[bool],
    frictions: Sequence[Friction],
    rubs: bool,
) -> System:
    """The switched linear system of a driveline with lashes (report Eqs 2.6, and 2.12 or 2.9).

    For a batch of drivelines that differ in numbers only, inertias, dampings, stiffnesses, speeds and the numbers of
    lashes, shafts and frictions have one more axis in front; twists and the shapes of rigid motions may have it. Raises
    UnlikeError where the drivelines differ in more than numbers.

    Parameters
    ----------
    inertia : (n,) float64  [kg m2]
    chains : of (n, n), (n, n) float64  [N m s/rad], [N m/rad]
        Damping and stiffness in each flow, in the order of the flows' numbers, without the flow's constraints.
    load : (n,) float64
        1 at the loaded inertia.
    lashes : Lashes
    end_time : (1,) float64  [s]
    rigid : RigidMotion
        Of the driveline with all lashes closed.
    wave_rates : (2, 2) float64, optional  [1/s]
        S of the load's wave, for loads that have one.
    ramps : bool
        Whether the torque's rate of change is an input, and can be other than zero.
    staged : of StagedShaft
        Their stiffness in the stages of a flow is part of the flow's stiffness in `chains`.
    loose : of bool
        For each combination of stages, with all lashes closed: whether a part of the driveline is free to turn that
        the stiffness of other stages holds.
    frictions : of Friction
    rubs : bool
        Whether a friction would slip in steady motion.
    """
    (*batch, n), twists, stride = inertia.shape, lashes.twists, functionals_of(lashes)
    speeds, mechanical = slice(n, 2 * n), 2 * n
    states = mechanical if wave_rates is None else mechanical + 2
    count, impulsive = twists.shape[-2], lashes.are_rigid
    constants, pressing = INPUTS + count - 1, lashes.stiffness[..., None] * twists
    rubbing = constants + len(staged)
    driven, every = rubbing + OF_FRICTION * len(frictions), list(chains)
    impulse, passed = _impacts(inertia, twists, 2**count if impulsive and count > 1 else 1)
    tied = np.concatenate([twists, *(friction.twist[..., None, :] for friction in frictions)], axis=-2)

    def by_speeds(array: FloatArray) -> FloatArray:
        """Rows (…, n) that multiply θ, placed at θ' among all states."""
        rows = np.zeros((*array.shape[:-1], states))
        rows[..., speeds] = array
        return rows

    # the constraints of each flow: whether each of the rigid lashes is closed, and each of the frictions sticks
    held = [(*(impulsive * closed for closed in flow.closed), *flow.stuck) for flow in every]

    @cache
    def ties_of(closed: tuple[int, ...]) -> FloatArray:
        return constrained(tied, closed).expand

    @cache
    def yielding_of(tie: int, closed: tuple[int, ...]) -> FloatArray:
        """(…, 1) acceleration of a twist by a torque of 1 N m across it, under other constraints  [rad/s2]."""
        pushed = by_speeds(tied[..., tie, :] / inertia)[..., None]
        return _across(tied[..., tie, :], locked(pushed, inertia, ties_of(closed))[..., speeds, :])

    torques = np.zeros((*batch, n, driven))  # on the inertias, in every flow, by each input
    torques[..., TORQUE] = load
    for k, shaft in enumerate(staged, constants):
        torques[..., k] = -shaft.twist
    for k, friction in enumerate(frictions):
        torques[..., rubbing + OF_FRICTION * k] = -friction.twist

    def flow_of(flow: int) -> list[FloatArray]:
        inputs = np.zeros((*batch, states, driven))
        inputs[..., speeds, :] = torques / inertia[..., None]
        for k in range(count):
            if every[flow].closed[k] and not impulsive:
                inputs[..., speeds, half_gap_of(k)] = pressing[..., k, :] / inertia
        matrices = chain(inertia, *chains[every[flow]], states - mechanical), inputs
        return [locked(matrix, inertia, ties_of(held[flow])) for matrix in matrices]

    flows = range(len(every))
    rates, inputs = (np.stack(matrices, axis=-3) for matrices in zip(*map(flow_of, flows), strict=True))
    first_rate, stuck_stride = count * stride + len(staged), len(every) >> len(frictions)
    functionals = np.zeros((*batch, len(every), first_rate + OF_FRICTION * len(frictions), states))
    feedthrough = np.zeros((*functionals.shape[:-1], driven))

    def set_holding(flow: int, tie: int, functional: int) -> bool:
        """Make a functional the torque that holds a twist in a flow; false where other constraints hold it already."""
        tie_stride = 1 << tie if tie < count else stuck_stride << tie - count
        others, twist = flow - held[flow][tie] * tie_stride, tied[..., tie, :]
        yielding = yielding_of(tie, held[others])
        if alike(yielding[..., 0] <= _SINGULAR * np.sum(twist**2 / inertia, axis=-1), 0):
            return False
        functionals[..., flow, functional, :] = _across(twist, rates[..., others, speeds, :]) / yielding
        feedthrough[..., flow, functional, :] = _across(twist, inputs[..., others, speeds, :]) / yielding
        return True

    for k, inertia_watched in enumerate(lashes.acceleration_of):
        of_lash, fed = functionals[..., k * stride :, :], feedthrough[..., k * stride :, :]
        of_lash[..., GAP, :n] = twists[..., k, None, :]
        of_lash[..., ACCELERATION, :] = rates[..., n + inertia_watched, :]
        fed[..., ACCELERATION, :] = inputs[..., n + inertia_watched, :]
        for flow in flows if impulsive else ():  # the torque that locks it, or, where it is open, that would lock it
            set_holding(flow, k, k * stride + FORCE)
        if lashes.separation_by_force[k] and not impulsive:
            of_lash[..., FORCE, :n] = pressing[..., k, None, :]
            of_lash[..., FORCE, speeds] = (lashes.damping[..., None] * twists)[..., k, None, :]
    for k, shaft in enumerate(staged, count * stride):
        functionals[..., k, :n] = shaft.twist[..., None, :]
    excess = np.zeros(len(every), np.int64)
    for k, friction in enumerate(frictions):
        rate, torque = first_rate + OF_FRICTION * k + RATE, rubbing + OF_FRICTION * k
        for flow in flows:
            if set_holding(flow, count + k, rate + HOLDING):
                functionals[..., flow, rate, speeds] = friction.twist
                feedthrough[..., flow, rate + HOLDING, torque] = 0.0
            else:
                excess[flow] |= every[flow].stuck[k]
    if wave_rates is not None:
        rates[..., mechanical:, mechanical:] = wave_rates[..., None, :, :]
        rates[..., :mechanical, mechanical] = inputs[..., :mechanical, TORQUE]
        functionals[..., mechanical] = feedthrough[..., TORQUE]

    motion = np.zeros((*rates.shape[:-2], states + driven, states + driven))  # of x and u
    motion[..., :states, :states], motion[..., :states, states:] = rates, inputs
    motion[..., states + TORQUE, states + TORQUE_RATE] = 1.0
    rows = np.concatenate([functionals, feedthrough], axis=-1)[..., : None if frictions or impulsive else 0, :]
    tables = build_tables(lashes, staged, frictions, batch)
    for k, friction in enumerate(frictions):
        rate = first_rate + OF_FRICTION * k + RATE
        rows[..., rate, speeds] = friction.twist[..., None, :]  # also where other constraints hold the twist
        # there the rate stays zero: an offset of 1 keeps its guard from ending the regime
        is_held = ~alike(functionals[..., tables["regimes"]["flow"], rate, :].any(axis=-1))[:, None]
        tables["offsets"][..., is_held & (tables["guards"]["functional"] == rate), rubbing + OF_FRICTION * k] = 1.0
    outputs = np.stack([_derivatives(rows, motion), _derivatives(abs(rows), abs(motion))], axis=-2)

    motions = rigid.shape.shape[-1]
    steady = np.zeros((*batch, len(loose), states, driven))
    carried = np.zeros((*batch, len(loose), count, driven))
    gaps = np.eye(driven)[[*map(half_gap_of, range(count))]]
    drag = (chains[every[0]][0] @ rigid.speeds[..., None])[..., 0]
    torques[..., TORQUE] -= drag + inertia * rigid.accelerations
    compliance = 0.0 if impulsive else 1.0 / lashes.stiffness
    momentum = inertia[..., None] * rigid.shape
    for k, is_loose in enumerate(loose if motions <= 1 else ()):
        if is_loose:
            steady[..., k, :, :] = np.nan  # no equilibrium, or many
            continue
        stiffness = chains[every[k << count]][1]  # with all lashes open
        angles, carried[..., k, :, :] = steady_motion(stiffness, torques, twists, gaps, momentum, compliance)
        steady[..., k, :n, :], steady[..., k, speeds, TORQUE] = angles, rigid.speeds
    status = OK if motions <= 1 and not rubs else NO_EQUILIBRIUM
    rolling = np.broadcast_to(rigid.shape, (*batch, n, motions))[..., : int(status == OK)]
    # a column for the angles, and where nothing drags one for the speeds, too
    drift = np.asarray(np.kron(np.eye(2, 1 if rigid.is_dragged else 2), rolling), np.float64)
    joints = by_speeds(np.broadcast_to(tied, (*batch, *tied.shape[-2:])))

    return System(
        rates=rates,
        inputs=inputs,
        functionals=functionals,
        feedthrough=feedthrough,
        outputs=outputs,
        functionals_per_lash=stride,
        lashes=joints[..., :count, :],
        inertias=n,
        lash_count=count,
        friction_count=len(frictions),
        input_count=driven,
        element_count=count + len(staged) + len(frictions),
        ramps=int(ramps),
        **tables,
        impulsive=int(impulsive),
        impulse=by_speeds(impulse),
        passed=passed,
        restitution=lashes.restitution,
        locking_speed=lashes.locking_speed,
        frictions=joints[..., count:, :],
        friction_torques=np.array([each.most for each in frictions]).reshape(len(frictions), *batch).T.copy(),
        excess=excess,
        steady_motion=steady,
        contact_torque=carried,
        drift=drift,
        first_rolling=int(alike(rolling.any(axis=-1)).argmax()) if rolling.size else -1,
        end_time=end_time,
        sticking_time=lashes.sticking_time,
        status=status,
    )


def _impacts(inertia: FloatArray, twists: FloatArray, sets: int) -> tuple[FloatArray, FloatArray]:
    """Changes of speeds by impulses across each lash, and the impulses through all lashes, per unit of change of q'.

    Returns (…, H, L, n) float64, the speeds of `System.impulse`, and (…, H, L, L) float64, `System.passed`; both are
    zero where the lash itself is in the set that stays closed.
    """
    *batch, n = inertia.shape
    count = twists.shape[-2]
    change, passed = np.zeros((*batch, sets, count, n)), np.zeros((*batch, sets, count, count))
    for held in range(sets):
        bits = [k for k in range(count) if held >> k & 1]
        for lash in set(range(count)) - set(bits):
            tied = twists[..., [lash, *bits], :]
            across = tied / inertia[..., None, :]
            mobility = np.sum(across[..., None, :] * tied[..., None, :, :], axis=-1)
            impulses = np.linalg.solve(mobility, np.eye(1 + len(bits))[0])
            change[..., held, lash, :] = np.einsum("...k,...kn->...n", impulses, across)
            passed[..., held, lash, [lash, *bits]] = impulses
    return change, passed


def _derivatives(rows: FloatArray, motion: FloatArray) -> FloatArray:
    """(…, F, 3, N) the rows of functionals, (…, F, N), and of their first two derivatives where z' = motion z."""
    return np.stack([rows, rows @ motion, rows @ motion @ motion], axis=-2)


def _across(twist: FloatArray, matrix: FloatArray) -> FloatArray:
    """(…, columns) a twist times the columns of a matrix, (…, n, columns)."""
    return (twist[..., None, :] @ matrix)[..., 0, :]
