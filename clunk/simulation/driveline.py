"""A driveline: inertias that shafts and lashes join to each other or to ground, or that are free.

M θ'' + C θ' + K θ = b T (report Eq. 2.6), where closing a lash adds a spring and a damper across it (Eq. 2.12). Shafts
are linear or have stages, in each of which they are linear; friction adds a constant torque, or a constraint.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.batches import alike
from clunk.core.reductions import chain, constrained, locked
from clunk.core.regimes import RigidMotion
from clunk.core.tables import Friction, StagedShaft
from clunk.simulation import rolling
from clunk.study.arrays import Bools
from clunk.study.document import Place
from clunk.study.errors import ClunkError
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
        stiffness = numbers_at(varied, of_shafts, [shaft.stages[0] for shaft in shafts], "stiffness")
        for k, each in staged:  # where a breakpoint is at twist 0, the stiffness of the stage above it
            stiffness[..., k] = each.stiffness[..., np.count_nonzero(alike(each.breakpoints <= 0.0))]
        radii = numbers_at(varied, of_lashes, [lash.radius for lash in lashes], "radius")
        stiffnesses, dampings = (
            radii**2
            * numbers_at(varied, of_lashes, [getattr(lash.contact, key) or 0.0 for lash in lashes], "contact", key)
            for key in ("stiffness", "damping")
        )
        return cls(
            names=study.driveline.all_names,
            inertia=numbers_at(varied, [("driveline", "inertias", k) for k in range(n)], study.driveline.inertias),
            shafts=shaft_rows,
            shaft_stiffness=stiffness,
            shaft_damping=numbers_at(varied, of_shafts, [shaft.damping for shaft in shafts], "damping"),
            lashes=rows,
            contact_stiffnesses=stiffnesses,
            contact_dampings=dampings,
            load=np.eye(n)[study.load.on - 1],
            staged=staged,
            shaft_friction=numbers_at(varied, of_shafts, [shaft.friction for shaft in shafts], "friction"),
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
        units = self.shafts / np.linalg.norm(self.shafts, axis=-1, keepdims=True)
        rest = self.shaft_friction.copy()
        for k in range(rest.shape[-1]):
            if not alike(rest[..., k] > 0.0, 0):
                continue
            shaft = self.shafts[..., k, :]
            beside = alike(abs(units @ units[..., k, :, None])[..., 0] > 1.0 - _SIDE_BY_SIDE)
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
        return rolling.rigid_motion_of(self.inertia, springs, dampers, self.load)

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


def numbers_at(varied: Varied, places: Sequence[Place], own: Sequence[float], *key: str) -> FloatArray:
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
        numbers_at(varied, [(*place, key, k) for k in range(len(own))], own)
        for key, own in (("stiffness", shaft.stages), ("breakpoints_deg", shaft.breakpoints_deg or ()))
    )
    alike(np.diff(breakpoints) > 0.0)  # where breakpoints cross, split the batch: such drivelines are refused alone
    return StagedShaft(twist, stages, np.deg2rad(breakpoints))


def _incidence(varied: Varied, places: Sequence[Place], joints: Sequence[Shaft | Lash], n: int) -> FloatArray:
    """Rows of twist = row · θ, (…, joints, n): 1 at the first end, minus the ratio at the second, none at ground."""
    differ = any(place[-1] == "ratio" for place in varied)
    ratios = numbers_at(varied if differ else {}, places, [each.ratio for each in joints], "ratio")
    rows = np.zeros((*ratios.shape, n))
    for k, joint in enumerate(joints):
        one, other = joint.between
        if one != "ground":
            rows[..., k, one - 1] += 1.0
        if other != "ground":
            rows[..., k, other - 1] -= ratios[..., k]
    return rows
