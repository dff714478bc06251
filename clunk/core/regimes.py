"""A driveline with one lash as a switched linear system: a list of regimes, as data.

A run has the inputs d = (T, φ/2, T', 1, …): load torque, half gap, the torque's rate of change, and a 1 for each staged
shaft. Within a regime x' = A x + B u, with x = (θ, θ') and u = weights · d, each input by the regime's own
weight: u = (T, s φ/2, T', c, …), s the side of the flank in contact (0: none), and c the torque at twist 0 of the line
that a staged shaft's torque is on. Between kinks of the load T' is constant; a load that swings or decays adds its wave
w to x = (θ, θ', w), w' = S w, whose first number is added to the torque.

A regime ends when one of its *guards*, sign · functional(x, u) + offsets · d, positive inside it, turns negative;
`clunk.core.tables` names its successor.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.equilibrium import contact_torque, preload
from clunk.core.reductions import chain, locked
from clunk.core.status import Status
from clunk.core.tables import (
    ACCELERATION,
    FORCE,
    GAP,
    HALF_GAP,
    INPUTS,
    TORQUE,
    TORQUE_RATE,
    StagedShaft,
    indentation_tables,
    restitution_tables,
    stages_of,
)

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

LOCKING_SHARE = 1e-4  # of the run's fastest touch: chatter has then lost all but 1e-8 of its energy
_SINGULAR = 1e-12  # of the largest eigenvalue: a smaller one is rounding


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
    weights: FloatArray  # (R, I)  u = weights · d
    leaders: IntArray  # (U,)  the first regime of each group
    lash_states: int  # regimes of each combination of stages
    # touches of the restitution model
    impulsive: int  # whether a touch resets the velocities
    impulse: FloatArray  # (N,)  change of x per unit of q'
    restitution: float  # e
    locking_speed: float  # rad/s; a negative one is relative to the fastest touch of the run so far
    # before the step
    preload: FloatArray  # (S, N, I)  steady motion in contact at the load step, in each combination of stages, by u
    contact_torque: FloatArray  # (S, I)  the torque across the lash in it, signed like q
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
    staged: Sequence[StagedShaft] = (),
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
    staged : of StagedShaft
        Shafts whose stiffness is not part of `stiffness`.
    """
    n = inertia.size
    impulsive, driven = restitution is not None, INPUTS + len(staged)
    mobility = (lash**2 / inertia).sum()
    springs = [stiffness + _of_stages(staged, stages) for stages in stages_of(staged)]
    open_flows, closed_flows = [], []
    for spring in springs:
        rates, inputs = chain(inertia, damping, spring, load, driven)
        for k, shaft in enumerate(staged, INPUTS):
            inputs[n:, k] = -shaft.twist / inertia
        open_flows.append((rates, inputs))
        if impulsive:
            closed_flows.append(locked(rates, inputs, inertia, lash))
            continue
        coupling = lash[:, None] * lash
        rates, _ = chain(inertia, damping + contact_damping * coupling, spring + contact_stiffness * coupling, load)
        inputs = inputs.copy()
        inputs[n:, HALF_GAP] = contact_stiffness * lash / inertia
        closed_flows.append((rates, inputs))
    rates, inputs = (np.array(arrays) for arrays in zip(*open_flows, *closed_flows, strict=True))

    first_twist = 3 if impulsive or separation_by_force else 2
    functionals = np.zeros((len(rates), first_twist + len(staged), 2 * n))
    feedthrough = np.zeros((*functionals.shape[:2], driven))
    functionals[:, GAP, :n] = lash
    functionals[:, ACCELERATION] = rates[:, n + acceleration_of]
    feedthrough[:, ACCELERATION] = inputs[:, n + acceleration_of]
    for k, shaft in enumerate(staged, first_twist):
        functionals[:, k, :n] = shaft.twist
    for k, (open_rates, open_inputs) in enumerate(open_flows * 2 if impulsive else []):
        # the torque that keeps q'' at zero, also where nothing does
        functionals[k, FORCE] = lash @ open_rates[n:] / mobility
        feedthrough[k, FORCE] = lash @ open_inputs[n:] / mobility
    if separation_by_force and not impulsive:
        functionals[:, FORCE, :n] = contact_stiffness * lash
        functionals[:, FORCE, n:] = contact_damping * lash

    if impulsive:
        tables = restitution_tables(staged)
    else:
        tables = indentation_tables(contact_stiffness, contact_damping, separation_by_force, staged)
    motions = rigid.shape.shape[1]
    steady, carried = np.zeros((len(springs), 2 * n, driven)), np.zeros((len(springs), driven))
    inertial = load - damping @ rigid.speeds - inertia * rigid.accelerations if motions else load
    for k, spring in enumerate(springs if motions <= 1 else []):
        momentum = inertia[:, None] * rigid.shape
        if staged and _is_loose(spring, inertia, lash, motions):
            steady[k] = np.nan  # no equilibrium, or many
            continue
        contact = None if impulsive else contact_stiffness
        angles = preload(spring, inertial, lash, momentum, contact)
        steady[k, :n, :TORQUE_RATE], steady[k, n:, TORQUE] = angles, rigid.speeds
        carried[k, :TORQUE_RATE] = contact_torque(spring, inertial, lash, angles)
        for j, shaft in enumerate(staged, INPUTS):
            angles = preload(spring, -shaft.twist, lash, momentum, contact)
            steady[k, :n, j] = angles[:, TORQUE]
            carried[k, j] = contact_torque(spring, -shaft.twist, lash, angles)[TORQUE]
    system = System(
        rates=rates,
        inputs=inputs,
        functionals=functionals,
        feedthrough=feedthrough,
        lash=np.concatenate([np.zeros(n), lash]),
        inertias=n,
        ramps=int(ramps),
        **tables._asdict(),
        impulsive=int(impulsive),
        impulse=np.concatenate([np.zeros(n), lash / inertia / mobility]),
        restitution=restitution if restitution is not None else 0.0,
        locking_speed=locking_speed if locking_speed is not None else -LOCKING_SHARE,
        preload=steady,
        contact_torque=carried,
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
        preload=_wider(system.preload.swapaxes(1, 2)).swapaxes(1, 2).copy(),
    )


def _of_stages(staged: Sequence[StagedShaft], stages: tuple[int, ...]) -> FloatArray | float:
    """What staged shafts add to the stiffness in some stages: (n, n)  [N m/rad]."""
    parts = (
        shaft.stiffness[stage] * shaft.twist[:, None] * shaft.twist for shaft, stage in zip(staged, stages, strict=True)
    )
    return sum(parts, 0.0)


def _is_loose(stiffness: FloatArray, inertia: FloatArray, lash: FloatArray, motions: int) -> bool:
    """Whether springs and the closed lash leave the driveline more rigid-body motions than it has in other stages."""
    root = np.sqrt(inertia)
    scaled = stiffness / (root[:, None] * root)
    tied = lash / root
    scaled = scaled + np.abs(scaled).max(initial=0.0) * tied[:, None] * tied / (tied @ tied)
    squared = np.linalg.eigvalsh(scaled)
    return bool(np.count_nonzero(squared <= _SINGULAR * squared[-1]) > motions)


def _wider(array: FloatArray) -> FloatArray:
    """An array whose last dimension is longer by two zeros."""
    return np.concatenate([array, np.zeros((*array.shape[:-1], 2))], axis=-1)
