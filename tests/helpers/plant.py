"""Drivelines of the independent reference, and the steady motion that they are in before the load step."""

from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import null_space

from helpers.elements import STICK, Friction, Lash, Mode, Stages
from helpers.loads import STEP, Profile

CONTACTS = {"gap": {"separation": "gap"}, "force": {"separation": "force"}, "restitution": {"restitution": 0.5}}
FITS = 1e-9  # a rate across a joint, relative to those of its ends, that is rounding


class Shaft(NamedTuple):
    """Two ends, numbered from 1 or "ground"; stiffness  [N m/rad], damping  [N m s/rad], breakpoints  [rad]; friction.

    The friction is the Coulomb torque  [N m]. With m breakpoints, stiffness is a tuple of m + 1.
    """

    one: Any
    other: Any
    stiffness: Any
    damping: float
    breakpoints: tuple = ()
    friction: float = 0.0


class Element(NamedTuple):
    """A lash, stages or friction by the name of its lash or shaft, and the row that takes θ to its twist."""

    name: str
    row: np.ndarray
    behaviour: Lash | Stages | Friction


@dataclass(frozen=True)
class Plant:
    """A driveline with lashes under a load.

    inertias  [kg m2]; shafts: what a Shaft is made of; ratios: of the shafts in their order, none for all 1; lash: the
    two ends of the first, () for none; contact_stiffness, contact_damping  [N m/rad], [N m s/rad]; backlash: total
    [rad]; before, after  [N m]: the torque on inertia `loaded`, taken from the profile if that is a table. A joint's
    twist is θ of its first end less ratio θ of its second. With `restitution` the contact's stiffness and damping are
    not used; a rebound not faster than LOCKING times the lash's fastest touch so far locks.
    """

    inertias: tuple = (0.024, 0.002, 0.002, 0.002)
    shafts: tuple = ((1, 2, 31.3, 0.08), (2, 3, 31.3, 0.04), (4, "ground", 31.3, 0.1), (1, "ground", 0.0, 0.1))
    lash: tuple = (3, 4)
    contact_stiffness: float = 0.08**2 * 4.092e5
    contact_damping: float = 0.08**2 * 94.0
    backlash: float = np.deg2rad(6.0)
    before: float = -6.0
    after: float = -1.0
    loaded: int = 1
    acceleration_of: int = 3
    separation: str = "gap"
    restitution: float | None = None
    ratios: tuple = ()
    lash_ratio: float = 1.0
    profile: Profile = STEP
    other_lashes: tuple = ()

    def __post_init__(self):
        if self.profile.name == "table":
            object.__setattr__(self, "before", self.profile.torques[0])
            object.__setattr__(self, "after", self.profile.torques[-1])

    @property
    def n(self):
        return len(self.inertias)

    @property
    def lashes(self):
        if not self.lash:
            return self.other_lashes
        contact = self.contact_stiffness, self.contact_damping, self.separation
        first = Lash(self.lash, self.backlash, *contact, self.lash_ratio, self.restitution)
        return (first, *self.other_lashes)

    def across(self, one, other, ratio=1.0):
        """The row that takes θ to the twist between two ends."""
        row = np.zeros(self.n)
        if one != "ground":
            row[one - 1] += 1.0
        if other != "ground":
            row[other - 1] -= ratio
        return row

    def joints(self):
        """Of each shaft the row of its twist, its stiffness (a tuple if it is staged) and its damping."""
        for row, shaft in self._shafts():
            yield row, shaft.stiffness, shaft.damping

    def _shafts(self):
        ratios = self.ratios or (1.0,) * len(self.shafts)
        for ends, ratio in zip(self.shafts, ratios, strict=True):
            shaft = Shaft(*ends)
            yield self.across(shaft.one, shaft.other, ratio), shaft

    @property
    def elements(self):
        """Lashes, staged shafts and friction, in this order; friction of no torque is none."""
        shafts = [(f"shaft {number}", *shaft) for number, shaft in enumerate(self._shafts(), 1)]
        return (
            *(
                Element(f"lash {number}", self.across(*lash.between, lash.ratio), lash)
                for number, lash in enumerate(self.lashes, 1)
            ),
            *(
                Element(name, row, Stages(shaft.breakpoints, shaft.stiffness))
                for name, row, shaft in shafts
                if shaft.breakpoints
            ),
            *(Element(name, row, Friction(shaft.friction)) for name, row, shaft in shafts if shaft.friction),
        )

    def open_matrices(self):
        """Damping and stiffness of the open chain without staged springs, from each shaft's torque on its two ends."""
        damping, stiffness = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for row, shaft in self._shafts():
            if not shaft.breakpoints:
                stiffness += np.outer(row, shaft.stiffness * row)
            damping += np.outer(row, shaft.damping * row)
        return damping, stiffness

    @property
    def twist(self):
        return self.across(*self.lash, self.lash_ratio)

    @property
    def load(self):
        return self.across(self.loaded, "ground")

    @property
    def pieces(self):
        return self.profile.pieces(self.before, self.after)

    @property
    def final(self):
        """The torque that the load comes to rest at; of a sine, the one that it swings about."""
        return self.pieces[-1].constant

    def contact_period(self, number=1):
        """T_c of a lash  [s]."""
        lash = self.lashes[number - 1]
        shares = zip(lash.between, (1.0, lash.ratio**2), strict=True)
        yielding = sum(share / self.inertias[end - 1] for end, share in shares if end != "ground")
        return 2.0 * np.pi / np.sqrt(lash.stiffness * yielding)

    @property
    def rigid_motions(self):
        """(n, any): the speeds, of length 1, that twist no joint with stiffness, the closed lashes among them."""
        held = [element.row for element in self.elements if isinstance(element.behaviour, Lash)]
        held += [row for row, k, _ in self.joints() if np.any(k)]
        if not held:
            return np.eye(self.n)
        return null_space(np.array([row / np.linalg.norm(row) for row in held]), rcond=FITS)

    @property
    def rigid_motion(self):
        """(n, 0 or 1): the only rigid-body motion, if there is one."""
        motions = self.rigid_motions
        if motions.shape[1] > 1:
            raise ValueError("more than one rigid-body motion")
        return motions

    def steady_speeds(self, torque):
        """Speeds and accelerations of the rigid-body motion that a torque keeps up: (n,), (n,).

        Where a damper slips in it, all power goes into dampers; if none does, into speed, from rest.
        """
        speeds, accelerations = np.zeros(self.n), np.zeros(self.n)
        for r in self.rigid_motion.T:
            slips = [(row @ r, c) for row, _, c in self.joints() if abs(row @ r) > FITS * np.linalg.norm(row)]
            drag = sum(c * slip**2 for slip, c in slips)
            if drag > 0.0:
                speeds = r * (r @ self.load * torque / drag)
            else:
                accelerations = r * (r @ self.load * torque / (r * self.inertias @ r))
        return speeds, accelerations

    def steady_motion(self, torque):
        """The modes in which a torque is carried for good, without friction, and the state then.

        Every lash presses a flank. Where a rigid-body angle is free it is zero. The equilibrium of springs that only
        ever resist is unique, so the first combination of flanks and stages that holds is the one.
        """
        damping, stiffness = self.open_matrices()
        speeds, accelerations = self.steady_speeds(torque)
        applied = torque * self.load - damping @ speeds - self.inertias * accelerations
        elements = [element for element in self.elements if not isinstance(element.behaviour, Friction)]
        for modes in product(*map(_carrying, elements)):
            theta = self._equilibrium(stiffness, applied, elements, modes, 1e-9 * abs(torque))
            if theta is not None:
                sticking = (STICK,) * (len(self.elements) - len(elements))
                return (*modes, *sticking), np.concatenate([theta, speeds])
        raise ValueError("no flank carries the torque")

    def _equilibrium(self, stiffness, applied, elements, modes, least):
        """The angles at which the elements in these modes carry the torques, each flank more than `least`, or None."""
        forces, matrix, border, kept = applied.copy(), stiffness.copy(), [], []
        for (_, row, behaviour), mode in zip(elements, modes, strict=True):
            if behaviour.bounds(mode) is not None:
                border.append(row)
                kept.append(mode.side * behaviour.backlash / 2)
            else:
                k, _, offset = behaviour.law(mode)
                matrix += k * np.outer(row, row)
                forces += offset * row
        # θ, then what keeps the twists of rigid contacts, then what keeps the rigid-body angle (nothing does)
        border = np.array([*border, *self.rigid_motion.T]).reshape(-1, self.n)
        bordered = np.block([[matrix, border.T], [border, np.zeros((len(border), len(border)))]])
        if np.linalg.cond(bordered) > 1e15:  # a stage without stiffness; rigid flanks side by side
            return None
        solution = np.linalg.solve(bordered, [*forces, *kept, *np.zeros(len(border) - len(kept))])
        theta, held = solution[: self.n], iter(solution[self.n :])
        for (_, row, behaviour), mode in zip(elements, modes, strict=True):
            q = row @ theta
            if isinstance(behaviour, Stages):
                if any(np.dot(limit.weights, (q, 0.0, 1.0)) < -1e-12 * abs(q) for limit in behaviour.limits(mode)):
                    return None
            else:
                k, _, offset = behaviour.law(mode)
                pressing = mode.side * (next(held) if behaviour.rigid else k * q - offset)
                if pressing <= least:  # less is rounding: the load does not reach the lash
                    return None
        return theta

    def preload(self):
        """The flank of the first lash that carries the torque before the load step, and the state of that motion."""
        modes, state = self.steady_motion(self.before)
        return modes[0].side, state


def _carrying(element):
    """The modes in which an element carries torque in an equilibrium."""
    if isinstance(element.behaviour, Lash):
        return [Mode("closed", side) for side in (1, -1)]
    return [Mode("stage", stage) for stage in range(1, len(element.behaviour.stiffnesses) + 1)]


def boere(ratio, backlash_deg, **changes):
    """The report's driveline at one point of its map."""
    return Plant(backlash=np.deg2rad(backlash_deg), before=-1.0 * (1.0 + ratio), after=-1.0, **changes)
