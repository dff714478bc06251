"""The same drivelines by a general integrator, SciPy's DOP853 with events: slow, and of independent mathematics.

Its dense output is of order 7: with steps of a third of a radian of the fastest mode an event is good to some 1e-11 s.
"""

import numpy as np
from scipy.integrate import solve_ivp

from helpers.reference import LOCKING

UNWATCHED = 2e-4  # s: a release of held flanks grows with the third power of time, below rounding at first


class Lash:
    """A plant's equations of motion, and what ends each of its regimes."""

    def __init__(self, plant):
        self.plant = plant
        self.damping, self.stiffness = plant.open_matrices()
        self.inverse, self.q, self.half = 1.0 / np.array(plant.inertias), plant.twist, plant.backlash / 2
        self.rigid = plant.restitution is not None

    def load(self, x):
        """The torques on the inertias but for the contact's."""
        n = self.plant.n
        return self.plant.after * self.plant.load - self.stiffness @ x[:n] - self.damping @ x[n:]

    def contact(self, x, side):
        """The torque across the closed lash, positive where it presses the flanks together."""
        if self.rigid:
            return side * (self.q * self.inverse @ self.load(x)) / (self.q * self.inverse @ self.q)
        n = self.plant.n
        return self.plant.contact_stiffness * self.overlap(x, side) + self.plant.contact_damping * side * (
            self.q @ x[n:]
        )

    def overlap(self, x, side):
        return side * (self.q @ x[: self.plant.n]) - self.half

    def slope(self, x, regime):
        torque = self.load(x)
        if regime[0] == "closed":
            torque = torque - regime[1] * self.contact(x, regime[1]) * self.q
        return np.concatenate([x[self.plant.n :], self.inverse * torque])

    def guards(self, regime):
        """What turns negative: (function of the state, kind, side)."""
        name, side = regime
        if name == "open":
            return [(lambda x, s=s: -self.overlap(x, s), "touch", s) for s in (1, -1)]
        if name == "parted":
            return [
                (lambda x: self.overlap(x, side), "opening", side),
                (lambda x: -self.contact(x, side), "rejoin", side),
            ]
        pressed = self.rigid or self.plant.separation == "force"
        return [
            ((lambda x: self.contact(x, side)) if pressed else (lambda x: self.overlap(x, side)), "separation", side)
        ]

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
        return max(*rates, 1.0)


def run(plant, end_time, state=None, most=40):
    """[(kind, side, time, q' before)] of the events after the load step, at most so many."""
    lash, n = Lash(plant), plant.n
    if state is None:
        side, x = plant.preload()
        regime = ("closed", side)
    else:
        regime, x = ("open", 0), np.array(state, float)
    time, found, fastest_touch, step, unwatched = 0.0, [], 0.0, 0.3 / lash.fastest(), 0.0
    while len(found) < most:
        guards = lash.guards(regime)
        ends = []
        for guard, _, _ in guards:
            ends.append(lambda _, x, guard=guard: guard(x))
            ends[-1].terminal, ends[-1].direction = True, -1

        def slope(_, x, regime=regime):
            return lash.slope(x, regime)

        options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "max_step": step}
        if unwatched > 0.0 and time + unwatched < end_time:
            x = solve_ivp(slope, (time, time + unwatched), x, **options).y[:, -1]
            time += unwatched
        solution = solve_ivp(slope, (time, end_time), x, events=ends, first_step=min(1e-6, step), **options)
        hit = [k for k, times in enumerate(solution.t_events) if times.size]
        if not hit:
            break
        k = min(hit, key=lambda k: solution.t_events[k][0])
        time, x = solution.t_events[k][0], solution.y_events[k][0]
        _, kind, side = guards[k]
        found.append((kind, side, time, float(lash.q @ x[n:])))
        unwatched = 0.0
        if kind == "touch" and lash.rigid:
            kick = lash.q * lash.inverse / (lash.q * lash.inverse @ lash.q)
            speed = lash.q @ x[n:]
            fastest_touch = max(fastest_touch, abs(speed))
            held = plant.restitution * abs(speed) <= LOCKING * fastest_touch
            x[n:] -= (1.0 if held else 1.0 + plant.restitution) * speed * kick
            if held and lash.contact(x, side) > 0.0:
                regime = ("closed", side)
                found.append(("lock", side, time, 0.0))
        elif kind in ("touch", "rejoin"):
            regime = ("closed", side)
        elif kind == "opening" or plant.separation == "gap":
            regime = ("open", 0)
            unwatched = UNWATCHED if lash.rigid else 0.0
        elif plant.contact_damping == 0.0:  # without a damper the force ends where the gap opens
            regime = ("open", 0)
            found.append(("opening", side, time, found[-1][3]))
        else:
            regime = ("parted", side)
    return found[:most]
