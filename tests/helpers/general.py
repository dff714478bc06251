"""Equations of motion of a plant with one lash, for a general integrator: of independent mathematics, and slow."""

from bisect import bisect_right

import numpy as np


class OneLash:
    """A plant's equations of motion in each of its regimes."""

    def __init__(self, plant):
        self.plant, self.pieces = plant, plant.pieces
        self.damping, self.stiffness = plant.open_matrices()
        self.inverse, self.q, self.half = 1.0 / np.array(plant.inertias), plant.twist, plant.backlash / 2
        self.rigid = plant.restitution is not None
        self.until = np.inf  # the load's next kink, of which `loads` take the torque before

    def loads(self, t, x):
        """The torques on the inertias but for the contact's."""
        n, t = self.plant.n, min(t, np.nextafter(self.until, -np.inf))
        piece = self.pieces[bisect_right(self.pieces, t, key=lambda piece: piece.begin) - 1]
        return piece.torque(t - piece.begin) * self.plant.load - self.stiffness @ x[:n] - self.damping @ x[n:]

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
