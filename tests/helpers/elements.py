"""Elements of a driveline whose torque is linear in pieces: lashes, staged shafts and Coulomb friction.

An element is in one mode at a time. A mode exerts on the element's twist q the torque offset - k q - c q', or holds
q' at zero with a torque between bounds; it lasts as long as all of its guards are positive.
"""

from typing import NamedTuple

import numpy as np


class Mode(NamedTuple):
    """A mode and its flank (closed, parted), number from 1 (stage) or direction of sliding (slip)."""

    name: str
    side: int = 0


OPEN, STICK = Mode("open"), Mode("stick")


class Limit(NamedTuple):
    """Where a mode ends: weights of (q, q', 1) in what is positive before, the event's kind and side, the next mode."""

    weights: tuple
    kind: str
    side: int
    successor: Mode | None  # None: what follows depends on the other elements too


class Lash(NamedTuple):
    """A lash: two ends, numbered from 1 or "ground", its whole gap  [rad] and its contact  [N m/rad, N m s/rad].

    Of a lash with a coefficient of restitution the closed contact is rigid, and stiffness and damping are not used.
    """

    between: tuple
    backlash: float
    stiffness: float = 0.0
    damping: float = 0.0
    separation: str = "gap"
    ratio: float = 1.0
    restitution: float | None = None

    @property
    def rigid(self):
        return self.restitution is not None

    def law(self, mode):
        if mode.name != "closed" or self.rigid:
            return 0.0, 0.0, 0.0
        return self.stiffness, self.damping, mode.side * self.stiffness * self.backlash / 2

    def limits(self, mode):
        name, s = mode
        overlap = np.array([s, 0.0, -self.backlash / 2])
        force = np.array([s * self.stiffness, s * self.damping, -self.stiffness * self.backlash / 2])
        if name == "open":
            return [
                Limit((-s, 0.0, self.backlash / 2), "touch", s, None if self.rigid else Mode("closed", s))
                for s in (1, -1)
            ]
        if name == "parted":
            return [Limit(overlap, "opening", s, OPEN), Limit(-force, "rejoin", s, Mode("closed", s))]
        if self.rigid:
            return []
        if self.separation == "force":
            return [Limit(force, "separation", s, Mode("parted", s))]
        return [Limit(overlap, "separation", s, OPEN)]

    def bounds(self, mode):
        """Least and largest torque that holds q' = 0, or None; a rigid flank only presses."""
        if not self.rigid or mode.name != "closed":
            return None
        return (-np.inf, 0.0) if mode.side > 0 else (0.0, np.inf)

    def alternatives(self, mode):
        """The modes that may follow where the flanks touch at rest."""
        return (mode, OPEN) if self.rigid and mode.name == "closed" else (mode,)


class Stages(NamedTuple):
    """A shaft's spring of m + 1 stiffnesses between m breakpoints, without torque at twist 0  [rad, N m/rad]."""

    breakpoints: tuple
    stiffnesses: tuple

    def torque(self, twist):
        """The torque that a twist takes, the integral of the stiffness from 0 on."""
        edges = np.array([-np.inf, *self.breakpoints, np.inf])
        low, high = min(twist, 0.0), max(twist, 0.0)
        lengths = np.maximum(np.minimum(edges[1:], high) - np.maximum(edges[:-1], low), 0.0)
        return np.sign(twist) * (lengths @ np.array(self.stiffnesses))

    def mode_at(self, twist):
        return Mode("stage", 1 + int(np.searchsorted(self.breakpoints, twist)))

    def law(self, mode):
        k, anchor = self.stiffnesses[mode.side - 1], self.breakpoints[max(mode.side - 2, 0)]
        return k, 0.0, k * anchor - self.torque(anchor)

    def limits(self, mode):
        stage, limits = mode.side, []
        if stage > 1:
            limits.append(Limit((1.0, 0.0, -self.breakpoints[stage - 2]), "stage", stage - 1, Mode("stage", stage - 1)))
        if stage <= len(self.breakpoints):
            limits.append(Limit((-1.0, 0.0, self.breakpoints[stage - 1]), "stage", stage + 1, Mode("stage", stage + 1)))
        return limits

    def bounds(self, mode):
        return None

    def alternatives(self, mode):
        return (mode,)


class Friction(NamedTuple):
    """A Coulomb torque  [N m] against the twist rate, anything up to it while sticking."""

    torque: float

    def law(self, mode):
        return 0.0, 0.0, -self.torque * mode.side

    def limits(self, mode):
        return [Limit((0.0, mode.side, 0.0), "stick", 0, None)] if mode.name == "slip" else []

    def bounds(self, mode):
        return (-self.torque, self.torque) if mode.name == "stick" else None

    def alternatives(self, mode):
        """The modes that may follow where the twist rate is zero."""
        return STICK, Mode("slip", 1), Mode("slip", -1)
