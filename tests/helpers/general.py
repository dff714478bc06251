"""Equations of motion of a plant with one lash, for a general integrator: of independent mathematics, and slow.

The load is T(t) as its table of profiles says it.
"""

import numpy as np


def torque(plant, t):
    """T(t) after the load step; at a jump the torque after it."""
    load, before, after = plant.profile, plant.before, plant.after
    change, d = after - before, load.duration
    match load.name:
        case "step":
            return after
        case "ramp":
            return before + change * min(t / d, 1.0) if d > 0.0 else after
        case "smooth":
            return before + change * (1.0 - np.cos(np.pi * t / d)) / 2.0 if t < d else after
        case "lag":
            return before + change * -np.expm1(-t / load.time_constant) if load.time_constant > 0.0 else after
        case "pulse":
            return after if t < d else before
        case "table":
            k = np.searchsorted(load.times, t, side="right") - 1
            if k + 1 == len(load.times):
                return load.torques[-1]
            share = (t - load.times[k]) / (load.times[k + 1] - load.times[k])
            return (1.0 - share) * load.torques[k] + share * load.torques[k + 1]
        case "sine":
            return after + load.amplitude * np.sin(2.0 * np.pi * load.frequency * t)
    raise ValueError(load.name)


def kinks(plant):
    """Times after t = 0 at which T(t) has a kink or a jump, increasing."""
    load = plant.profile
    times = {"ramp": [load.duration], "smooth": [load.duration], "pulse": [load.duration], "table": load.times}
    return sorted({t for t in times.get(load.name, []) if t > 0.0})


class OneLash:
    """A plant's equations of motion in each of its regimes."""

    def __init__(self, plant):
        self.plant = plant
        self.damping, self.stiffness = plant.open_matrices()
        self.inverse, self.q, self.half = 1.0 / np.array(plant.inertias), plant.twist, plant.backlash / 2
        self.rigid = plant.restitution is not None
        self.until = np.inf  # the load's next kink, of which `loads` take the torque before

    def loads(self, t, x):
        """The torques on the inertias but for the contact's."""
        n = self.plant.n
        t = min(t, np.nextafter(self.until, -np.inf))
        return torque(self.plant, t) * self.plant.load - self.stiffness @ x[:n] - self.damping @ x[n:]

    def contact(self, t, x, side):
        """The torque across the closed lash, positive where it presses the flanks together."""
        if self.rigid:
            return side * (self.q * self.inverse @ self.loads(t, x)) / (self.q * self.inverse @ self.q)
        n = self.plant.n
        return self.plant.contact_stiffness * self.overlap(x, side) + self.plant.contact_damping * side * (
            self.q @ x[n:]
        )

    def overlap(self, x, side):
        return side * (self.q @ x[: self.plant.n]) - self.half

    def slope(self, t, x, regime):
        loads = self.loads(t, x)
        if regime[0] == "closed":
            loads = loads - regime[1] * self.contact(t, x, regime[1]) * self.q
        return np.concatenate([x[self.plant.n :], self.inverse * loads])

    def fastest(self):
        n, rates = self.plant.n, []
        for closed in (0.0, 0.0 if self.rigid else 1.0):
            coupling = closed * np.outer(self.q, self.q)
            matrix = np.block(
                [
                    [np.zeros((n, n)), np.eye(n)],
                    [
                        -self.inverse[:, None] * (self.stiffness + self.plant.contact_stiffness * coupling),
                        -self.inverse[:, None] * (self.damping + self.plant.contact_damping * coupling),
                    ],
                ]
            )
            rates.append(np.abs(np.linalg.eigvals(matrix)).max())
        return max(*rates, 2.0 * np.pi * self.plant.profile.frequency, 1.0)
