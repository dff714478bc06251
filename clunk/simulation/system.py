"""The switched linear system of a study, and the tables of its flows; the steady motion before the load step."""

from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from clunk.core import switching
from clunk.core.arrays import FloatArray
from clunk.core.exact.flows import Flows, build_flows
from clunk.core.exact.modes import Chain
from clunk.core.reductions import constrained, product
from clunk.core.regimes import LOCKING_SHARE, System, build_system, driveline_at, rolling_apart
from clunk.core.status import Status
from clunk.core.tables import OF_FRICTION, FlowOf, Lashes, combinations, half_gap_of
from clunk.simulation import rolling
from clunk.simulation.driveline import Driveline, numbers_at
from clunk.simulation.load import WAVES, run_load, wave_rates
from clunk.study.errors import listing
from clunk.study.study import Study


def prepare(study: Study, driveline: Driveline) -> tuple[System, Flows]:
    """The switched linear system of a study, and the tables of its flows, of which rk4 makes its steps.

    driveline : the study's driveline, or one with other numbers; for a batch, system and tables are those of a batch
    """
    system = build(study, driveline, ramps=study.solver.method == "exact")
    return system, _flows(study, driveline, system)


def explained(study: Study, status: Status) -> str:
    """Phrase on why runs of a study fail with a status; it names the part of the driveline that causes this."""
    if status == Status.NO_INITIAL_FLANK and len(study.lashes) > 1:
        before, _ = run_load(study)
        carried = build(study).contact_torque[0, :, : before.size] @ before
        idle = [name for name, torque in zip(study.lash_names, carried, strict=True) if torque == 0.0]
        return status.sentence.replace("the lash", listing(idle, "or") or "a lash")
    if status != Status.NO_EQUILIBRIUM:
        return status.sentence
    driveline = Driveline.from_study(study)
    for friction, shares in driveline.frictions:
        if rolling.rubs(friction, driveline.rigid_motion):
            key = f"driveline.shafts[{np.flatnonzero(shares)[0] + 1}]"
            return (
                f"no steady motion before the load step: {key} slips as the driveline rolls, where its friction would "
                f"carry nothing; leave out {key}.friction, and give it {key}.damping if something resists the rolling"
            )
    if driveline.rigid_motion.shape.shape[1] <= 1:
        if all(shaft.stiffness.all() for _, shaft in driveline.staged):
            return (
                "no steady motion before the load step: so little resists it that a part would turn faster than 10⁷ "
                "rad/s, or by more than 10⁶ rad per N m; give a bearing more damping, a spring more stiffness or, "
                "where gear ratios along a loop all but fit, these more digits"
            )
        return (
            "no steady motion before the load step that is the only one: a staged shaft carries a torque at which a "
            "stage of it has no stiffness"
        )
    return rolling.separate_part(driveline.rigid_motion, driveline.load, driveline.names)


def build(study: Study, driveline: Driveline | None = None, *, ramps: bool = False) -> System:
    """The switched linear system of a study, with two further states for the wave of a load that has one.

    driveline : a driveline with other numbers than the study's, or a batch; by default the study's
    ramps : whether a torque that changes at a constant rate is an input (exact method); otherwise it is a wave (rk4)
    """
    driveline = driveline or Driveline.from_study(study)
    rates = wave_rates(study.load, driveline.varied)
    is_ramp = study.load.profile in ("ramp", "table")
    staged, motions = [shaft for _, shaft in driveline.staged], driveline.rigid_motion.shape.shape[-1]
    frictions = [friction for friction, _ in driveline.frictions]
    return build_system(
        inertia=driveline.inertia,
        chains=_chains(study, driveline),
        load=driveline.load,
        lashes=_core_lashes(study, driveline),
        end_time=numbers_at(driveline.varied, [("solver", "end_time")], [study.solver.end_time]),
        rigid=driveline.rigid_motion,
        wave_rates=np.eye(2, k=1) if is_ramp and not ramps else rates,
        ramps=is_ramp and ramps,
        staged=staged,
        loose=[driveline.in_stages(each).rigid_motion.shape.shape[-1] > motions for each in stages_of(driveline)],
        frictions=frictions,
        rubs=any(rolling.rubs(each, driveline.rigid_motion) for each in frictions),
    )


def _core_lashes(study: Study, driveline: Driveline) -> Lashes:
    """The lashes of a study and their contacts, as the `Lashes` of the core."""
    contacts, varied, periods = [lash.contact for lash in study.lashes], driveline.varied, driveline.contact_periods
    numbers = partial(numbers_at, varied, study.lash_places)
    are_rigid = study.has_rigid_flanks  # their locked state counts as sticking at once: the sticking time is 0
    sticking = 0.0 if are_rigid else varied.get(("impacts", "sticking_time"), study.impacts.sticking_time)
    return Lashes(
        twists=driveline.lashes,
        stiffness=driveline.contact_stiffnesses,
        damping=driveline.contact_dampings,
        are_rigid=are_rigid,
        separation_by_force=[each.separation == "force" for each in contacts],
        restitution=numbers([each.restitution or 0.0 for each in contacts], "contact", "restitution"),
        locking_speed=numbers([each.locking_speed or -LOCKING_SHARE for each in contacts], "contact", "locking_speed"),
        sticking_time=periods if sticking is None else np.full(periods.shape, np.asarray(sticking)[..., None]),
        acceleration_of=[number - 1 for number in study.watched],
    )


def _chains(study: Study, driveline: Driveline) -> dict[FlowOf, tuple[FloatArray, FloatArray]]:
    """Damping and stiffness matrices in each flow, before its constraints are applied."""

    @cache
    def matrices_of(stages: tuple[int, ...], closed: tuple[int, ...] | bool) -> tuple[FloatArray, FloatArray]:
        return driveline.in_stages(stages).matrices(closed=closed)

    return {each: matrices_of(each.stages, _in_contact(study, each)) for each in flows_of(driveline)}


def _in_contact(study: Study, flow: FlowOf) -> tuple[int, ...] | bool:
    """Whether each lash acts as a spring and a damper in a flow; False where flanks are rigid."""
    return False if study.has_rigid_flanks else flow.closed


def _flows(study: Study, driveline: Driveline, system: System) -> Flows:
    """Tables of each flow, from its matrices in the angles that its constraints (ties) leave free.

    These matrices are computed from the twists in the free angles, in which a twist that a constraint holds is exactly
    zero. Reducing the full matrices instead would leave rounding of the stiffest spring: a spurious stiffness on parts
    that nothing holds.
    """
    n, inertia = driveline.inertia.shape[-1], np.atleast_2d(driveline.inertia)
    rubbing, chains = [friction.twist[..., None, :] for friction, _ in driveline.frictions], []
    twists = np.concatenate([driveline.lashes, *rubbing], axis=-2)
    ties_of, line_in = cache(partial(constrained, twists)), cache(driveline.in_stages)  # many flows share them
    joints = np.concatenate([driveline.shafts, twists], axis=-2)
    parts_of = cache(lambda *some: rolling.rigid_motions(joints[..., some, :]))
    for flow, of_flow in _chains(study, driveline).items():
        (closed, stages, stuck), inertias, matrices = flow, inertia, of_flow
        line = line_in(stages)
        parts = driveline.rigid_motion.shape
        if stages or any(stuck) or parts.size:
            parts = parts_of(*np.flatnonzero([*line.is_spring, *closed, *stuck]))
        ties = ties_of((*(system.impulsive * lash for lash in closed), *stuck))
        left = ties.expand.shape[-1] // 2
        if left < n:  # each row of the basis has one entry at most, so that the inertia matrix stays diagonal
            basis, parts = ties.expand[..., :n, :left], ties.pick[..., :left, :n] @ parts
            inertias = (inertia[..., None, :] @ basis**2)[..., 0, :]
            line = replace(line, shafts=product(line.shafts, basis), lashes=product(line.lashes, basis))
            matrices = line.matrices(closed=_in_contact(study, flow))
        chains.append(Chain(inertias, *matrices, *ties, parts))
    system = system if driveline.varied else driveline_at(system, None)
    # leave out the wave states in which rk4 has a ramp; those of a profile with a wave stay
    states = slice(system.rates.shape[-1] if study.load.profile in WAVES else 2 * system.inertias)
    system = system._replace(
        rates=system.rates[..., states, states],
        inputs=system.inputs[..., states, :],
        functionals=system.functionals[..., states],
    )
    if system.drift.size:
        system, chains = _rolling_apart(system, chains)
    return build_flows(system, chains, held_inputs(driveline, system))


def _rolling_apart(system: System, chains: list[Chain]) -> tuple[System, list[Chain]]:
    """System and chains of a driveline that rolls, in angles and speeds less their rolling: `regimes.rolling_apart`."""
    n, size = system.inertias, system.rates.shape[-1]
    apart, together = (matrix[..., None, :, :] for matrix in rolling_apart(system, size))
    system = system._replace(
        rates=apart @ system.rates @ together,
        inputs=apart @ system.inputs,
        functionals=product(system.functionals, together),
    )
    apart, together = (matrix[..., 0, : 2 * n, : 2 * n] for matrix in (apart, together))
    return system, [
        chain._replace(expand=product(apart, chain.expand), pick=chain.pick @ together, shift=apart @ chain.shift)
        for chain in chains
    ]


def held_inputs(driveline: Driveline, system: System) -> list[int]:
    """Inputs that are twists held by constraints: the half gap of each lash, the sticking twist of each friction."""
    inputs = system.inputs.shape[-1]
    return [
        *map(half_gap_of, range(driveline.lashes.shape[-2])),
        *(inputs - OF_FRICTION * k + 1 for k in range(len(driveline.frictions), 0, -1)),
    ]


def stages_of(driveline: Driveline) -> list[tuple[int, ...]]:
    """All combinations of one stage, counted from 0, of each staged shaft, in the order of regimes."""
    return combinations([shaft.stiffness.shape[-1] for _, shaft in driveline.staged])


def flows_of(driveline: Driveline) -> list[FlowOf]:
    """The flows of a driveline in the order of their numbers."""
    of_lashes = combinations([2] * driveline.lashes.shape[-2])
    return [
        FlowOf(closed, stages, stuck)
        for stuck in combinations([2] * len(driveline.frictions))
        for stages in stages_of(driveline)
        for closed in of_lashes
    ]


class Preload(NamedTuple):
    """Steady motion in contact, and the status of runs that begin in it."""

    status: Status
    regime: int
    x: FloatArray  # (N,)  [rad, rad/s]


def preload(system: System, inputs: FloatArray) -> Preload:
    """Steady motion in contact under constant inputs."""
    x = np.zeros(system.rates.shape[1])
    status, regime = switching.preload(system, inputs, x)
    return Preload(Status(status), regime, x)


def steady_stages(study: Study) -> dict[int, int]:
    """Stage of each staged shaft in the steady motion before the load step, both numbered from 1."""
    driveline = Driveline.from_study(study)
    if not driveline.staged:
        return {}
    system = build(study, driveline)
    rest = preload(system, run_load(study)[0])
    stages = stages_of(driveline)[rest.regime // system.regime_strides[len(driveline.lashes)]]
    return {k + 1: stage + 1 for (k, _), stage in zip(driveline.staged, stages, strict=True)}


def steady_driveline(study: Study) -> Driveline:
    """The linear driveline that has the stages of the steady motion before the load step, for modes and the like."""
    return Driveline.from_study(study).in_stages(tuple(stage - 1 for stage in steady_stages(study).values()))


def steps_a_period(study: Study) -> float:
    """Number of solver steps in a period of the fastest oscillation; infinite where nothing oscillates.

    RK4 is stable down to about 2 to 3 steps a period. Below about 10, it damps the oscillation of the contact spring,
    so that weak rebounds are lost. The restitution model has no such oscillation.
    """
    fastest = abs(np.linalg.eigvals(build(study).rates).imag).max()
    return 2.0 * np.pi / (fastest * study.solver.step) if fastest > 0.0 else float("inf")
