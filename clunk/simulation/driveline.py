"""A driveline: inertias that shafts and lashes join to each other or to ground, or that are free.

M θ'' + C θ' + K θ = b T (report Eq. 2.6), where closing a lash adds a spring and a damper across it (Eq. 2.12). Shafts
are linear or have stages, in each of which they are linear; friction adds a constant torque, or a constraint.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.batches import alike
from clunk.core.exact.flows import Flows, build_flows
from clunk.core.exact.modes import Chain
from clunk.core.reductions import chain, constrained, locked, product
from clunk.core.regimes import LOCKING_SHARE, RigidMotion, System, build_system, driveline_at, rolling_apart
from clunk.core.status import Status
from clunk.core.tables import OF_FRICTION, FlowOf, Friction, Lashes, StagedShaft, combinations, half_gap_of
from clunk.simulation import rigid
from clunk.simulation.load import WAVES, run_load, wave_rates
from clunk.simulation.phases import preload
from clunk.study.arrays import Bools
from clunk.study.document import Place
from clunk.study.errors import ClunkError, listing
from clunk.study.models import Lash, Shaft
from clunk.study.records import Record, told
from clunk.study.study import Study

Varied = Mapping[Place, FloatArray]  # values of keys in a batch of D drivelines, (D,) each, in the keys' units

_SIDE_BY_SIDE = 1e-12  # 1 - |cos| of the angle between the twist rows of shafts side by side, at most: rounding


class Modes(Record, eq=False):
    """Oscillating modes of a driveline, lowest frequency first, and the decay rates of its other modes."""

    frequency: FloatArray = told(key="frequency_hz")  # (k,)  Hz, undamped natural frequency |λ|/2π
    damping_ratio: FloatArray = told()  # (k,)  ζ = -Re λ/|λ|
    overdamped: FloatArray = told(key="decay_rate_per_s")  # (m,)  1/s; a rigid-body drift has 0
    # (k, n)  share of each inertia in the mode's kinetic energy, J |θ|² over the sum of all
    energy_shares: FloatArray = told(key="kinetic_energy_share")


@dataclass(frozen=True, eq=False)
class Driveline:
    """The numbers and matrices of a driveline; n inertias, S shafts, L lashes.

    In a batch of D drivelines of the same structure, numbers and matrices have an axis of D in front; the rows of
    twists have it only where gear ratios differ.
    """

    names: tuple[str, ...]  # (n,)  of the inertias
    inertia: FloatArray  # (n,)  kg m2
    shafts: FloatArray  # (S, n)  twist of each shaft = row · θ
    shaft_stiffness: FloatArray  # (S,)  N m/rad; of staged shafts the stiffness at twist 0
    shaft_damping: FloatArray  # (S,)  N m s/rad
    lashes: FloatArray  # (L, n)  q of each lash = row · θ = θi - ratio θj
    contact_stiffnesses: FloatArray  # (L,)  N m/rad, r² k34 of each closed lash; 0 for rigid flanks without stiffness
    contact_dampings: FloatArray  # (L,)  N m s/rad, r² c34
    load: FloatArray  # (n,)  1 at the loaded inertia
    staged: tuple[tuple[int, StagedShaft], ...]  # shafts with stages, each behind its index in `shafts`
    shaft_friction: FloatArray  # (S,)  N m, 0 without friction
    varied: Varied  # the values that differ in a batch; empty for one driveline

    @classmethod
    def from_study(cls, study: Study, varied: Varied | None = None) -> "Driveline":
        """Make the driveline of a study's config, or a batch of drivelines with other values of some keys.

        Raises UnlikeError where the drivelines of a batch differ in structure and not in numbers only, and ClunkError
        where rigid lashes are in a ring or side by side.
        """
        n, shafts, lashes, varied = len(study.driveline.inertias), study.driveline.shafts, study.lashes, varied or {}
        of_shafts, of_lashes = [("driveline", "shafts", k) for k in range(len(shafts))], study.lash_places
        shaft_rows, rows = _incidence(varied, of_shafts, shafts, n), _incidence(varied, of_lashes, lashes, n)
        if study.has_rigid_flanks and alike(np.linalg.matrix_rank(rows) < len(lashes), 0):
            raise ClunkError(
                "Rigid lashes in a ring or side by side share a torque that nothing divides between them: "
                'give each contact.model = "indentation".'
            )

        staged = tuple(
            (k, _staged(varied, of_shafts[k], shaft, shaft_rows[..., k, :]))
            for k, shaft in enumerate(shafts)
            if shaft.breakpoints_deg
        )
        stiffness = _numbers(varied, of_shafts, [shaft.stages[0] for shaft in shafts], "stiffness")
        for k, each in staged:  # where a breakpoint is at twist 0, the stiffness of the stage above it
            stiffness[..., k] = each.stiffness[..., np.count_nonzero(alike(each.breakpoints <= 0.0))]
        radii = _numbers(varied, of_lashes, [lash.radius for lash in lashes], "radius")
        stiffnesses, dampings = (
            radii**2
            * _numbers(varied, of_lashes, [getattr(lash.contact, key) or 0.0 for lash in lashes], "contact", key)
            for key in ("stiffness", "damping")
        )
        return cls(
            names=study.driveline.names or tuple(f"inertia {k}" for k in range(1, n + 1)),
            inertia=_numbers(varied, [("driveline", "inertias", k) for k in range(n)], study.driveline.inertias),
            shafts=shaft_rows,
            shaft_stiffness=stiffness,
            shaft_damping=_numbers(varied, of_shafts, [shaft.damping for shaft in shafts], "damping"),
            lashes=rows,
            contact_stiffnesses=stiffnesses,
            contact_dampings=dampings,
            load=np.eye(n)[study.load.on - 1],
            staged=staged,
            shaft_friction=_numbers(varied, of_shafts, [shaft.friction for shaft in shafts], "friction"),
            varied=varied,
        )

    def matrices(self, *, closed: bool | Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Damping [N m s/rad] and stiffness [N m/rad], (n, n) each, with the dampers and springs of closed lashes.

        closed : (L,), whether each lash is closed, or one value for all lashes
        """
        damping, stiffness = (
            (self.shafts.mT * sizes[..., None, :]) @ self.shafts for sizes in (self.shaft_damping, self.shaft_stiffness)
        )
        for k in np.flatnonzero(np.broadcast_to(closed, self.lashes.shape[-2])):
            coupling = self.lashes[..., k, :, None] * self.lashes[..., k, None, :]
            damping = damping + self.contact_dampings[..., k, None, None] * coupling
            stiffness = stiffness + self.contact_stiffnesses[..., k, None, None] * coupling
        return damping, stiffness

    @cached_property
    def frictions(self) -> tuple[tuple[Friction, FloatArray], ...]:
        """Frictions, each with the share of every shaft in its torque, (S,); shafts side by side have one together."""
        frictions = []
        units = self.shafts / np.maximum(np.linalg.norm(self.shafts, axis=-1, keepdims=True), 1e-300)
        rest = self.shaft_friction.copy()
        for k in range(rest.shape[-1]):
            shaft = self.shafts[..., k, :]
            beside = alike(abs(units @ units[..., k, :, None])[..., 0] > 1.0 - _SIDE_BY_SIDE)
            if not (alike(rest[..., k] > 0.0, 0) and beside.any()):
                continue
            along = (self.shafts @ shaft[..., None])[..., 0]
            torques = np.where(beside, rest * (abs(along) / along[..., k, None]), 0.0)
            total = torques.sum(axis=-1)
            frictions.append((Friction(shaft, total), torques / total[..., None]))
            rest[..., beside] = 0.0
        return tuple(frictions)

    @cached_property
    def is_spring(self) -> Bools:
        """(S,) whether a shaft has a stiffness, in any stage."""
        springs = self.shaft_stiffness > 0.0
        for k, shaft in self.staged:
            springs[..., k] = shaft.stiffness.any(axis=-1)
        return alike(springs)

    def in_stages(self, stages: tuple[int, ...]) -> "Driveline":
        """The driveline whose staged shafts have the stiffness of the given stages, counted from 0, at every twist."""
        if not self.staged:
            return self
        stiffness = self.shaft_stiffness.copy()
        for (k, shaft), stage in zip(self.staged, stages, strict=True):
            stiffness[..., k] = shaft.stiffness[..., stage]
        return replace(self, shaft_stiffness=stiffness, staged=())

    def shaft_energy(self, angles: FloatArray) -> FloatArray:
        """(S,) the energy that each shaft stores at these angles, (n,)  [J]."""
        twists = self.shafts @ angles
        energy = self.shaft_stiffness * twists**2 / 2.0
        for k, shaft in self.staged:
            ends = sorted([0.0, twists[k]])
            nodes = np.unique(np.clip([*ends, *shaft.breakpoints], *ends))
            stages = shaft.breakpoints.searchsorted(nodes)
            torques = shaft.stiffness[stages] * nodes + shaft.torques[stages]
            energy[k] = np.sign(twists[k]) * np.sum((torques[1:] + torques[:-1]) * np.diff(nodes)) / 2.0
        return energy

    @cached_property
    def rigid_motion(self) -> RigidMotion:
        """Rigid-body motion with the lashes closed, and its speed or acceleration under a load of 1 N m."""
        springs = np.concatenate([self.shafts[..., self.is_spring, :], self.lashes], axis=-2)
        dampers = np.sqrt(self.shaft_damping)[..., None] * self.shafts
        return rigid.steady_motion(self.inertia, springs, dampers, self.load)

    @property
    def contact_periods(self) -> FloatArray:
        """(L,) contact periods T_c = 2π sqrt(J_red/k)  [s]; 0 for rigid flanks without stiffness.

        J_red is that of the two inertias at a lash in series, or the one inertia at a lash to ground.
        """
        mobility = np.sum(self.lashes**2 / self.inertia[..., None, :], axis=-1)
        rates = np.sqrt(self.contact_stiffnesses * mobility)
        return np.divide(2.0 * np.pi, rates, out=np.zeros_like(rates), where=rates > 0.0)

    def modes(self, *, closed: bool) -> Modes:
        """Modes with all lashes closed, or all open; closed lashes without contact stiffness are locked."""
        is_locked = closed & (self.contact_stiffnesses == 0.0)
        ties = constrained(self.lashes, is_locked)
        damping, stiffness = self.matrices(closed=closed)
        rates = locked(chain(self.inertia, damping, stiffness), self.inertia, ties.expand)
        eigenvalues, vectors = np.linalg.eig(ties.pick @ rates @ ties.expand)
        order, springs = abs(eigenvalues).argsort(), np.concatenate([stiffness, self.lashes[is_locked]])
        # Set eigenvalues that are zero to exactly that: one for a motion that no spring holds, and two if no damper
        # holds it either. Such a double zero is computed to half the digits of the fastest mode only.
        held = [np.linalg.matrix_rank(rows) for rows in (springs, np.concatenate([springs, damping]))]
        eigenvalues[order[: 2 * self.inertia.size - sum(held)]] = 0.0
        order = order[eigenvalues[order].imag > 0.0]
        oscillating, monotone = eigenvalues[order], eigenvalues[eigenvalues.imag == 0.0]
        shapes = (ties.expand @ vectors)[: self.inertia.size, order].T
        energy = self.inertia * abs(shapes) ** 2
        return Modes(
            frequency=np.abs(oscillating) / (2.0 * np.pi),
            damping_ratio=-oscillating.real / np.abs(oscillating),
            overdamped=np.sort(abs(monotone.real)),
            energy_shares=energy / energy.sum(axis=1, keepdims=True),
        )


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
        if rigid.rubs(friction, driveline.rigid_motion):
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
    return rigid.separate_part(driveline.rigid_motion, driveline.load, driveline.names)


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
        end_time=_numbers(driveline.varied, [("solver", "end_time")], [study.solver.end_time]),
        rigid=driveline.rigid_motion,
        wave_rates=np.array([[0.0, 1.0], [0.0, 0.0]]) if is_ramp and not ramps else rates,
        ramps=is_ramp and ramps,
        staged=staged,
        loose=[driveline.in_stages(each).rigid_motion.shape.shape[-1] > motions for each in stages_of(driveline)],
        frictions=frictions,
        rubs=any(rigid.rubs(each, driveline.rigid_motion) for each in frictions),
    )


def _core_lashes(study: Study, driveline: Driveline) -> Lashes:
    """The lashes of a study and their contacts, as the `Lashes` of the core."""
    contacts, varied, periods = [lash.contact for lash in study.lashes], driveline.varied, driveline.contact_periods
    numbers = partial(_numbers, varied, study.lash_places)
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
    parts_of = cache(lambda *some: rigid.rigid_motions(joints[..., some, :]))
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


def _numbers(varied: Varied, places: Sequence[Place], own: Sequence[float], *key: str) -> FloatArray:
    """Numbers at m places of a config: those of the study, (m,), or in a batch those of each driveline, (D, m).

    own : (m,), the study's numbers
    key : what follows a place in the full key, such as contact, stiffness
    """
    numbers = np.tile(np.asarray(own, np.float64), (*next((each.shape for each in varied.values()), ()), 1))
    for k, place in enumerate(places):
        numbers[..., k] = varied.get((*place, *key), numbers[..., k])
    return numbers


def _staged(varied: Varied, place: Place, shaft: Shaft, twist: FloatArray) -> StagedShaft:
    stages, breakpoints = (
        _numbers(varied, [(*place, key, k) for k in range(len(own))], own)
        for key, own in (("stiffness", shaft.stages), ("breakpoints_deg", shaft.breakpoints_deg or ()))
    )
    alike(np.diff(breakpoints) > 0.0)  # where breakpoints cross, split the batch: such drivelines are refused alone
    return StagedShaft(twist, stages, np.deg2rad(breakpoints))


def _incidence(varied: Varied, places: Sequence[Place], joints: Sequence[Shaft | Lash], n: int) -> FloatArray:
    """Rows of twist = row · θ, (…, joints, n): 1 at the first end, minus the ratio at the second, none at ground."""
    differ = any(place[-1] == "ratio" for place in varied)
    ratios = _numbers(varied if differ else {}, places, [each.ratio for each in joints], "ratio")
    rows = np.zeros((*ratios.shape, n))
    for k, joint in enumerate(joints):
        one, other = joint.between
        if one != "ground":
            rows[..., k, one - 1] += 1.0
        if other != "ground":
            rows[..., k, other - 1] -= ratios[..., k]
    return rows
