"""The same drivelines by a general integrator, SciPy's DOP853 with events: slow, and of independent mathematics.

Its dense output is of order 7: with steps of a third of a radian of the fastest mode an event is good to some 1e-11 s.
The load is T(t) as its table of profiles says it; the integration starts anew where that has a kink or a jump.
"""

import numpy as np
from scipy.integrate import solve_ivp

from helpers.reference import LOCKING, Friction, Lash, Stages

UNWATCHED = 2e-4  # s: a release of held flanks grows with the third power of time, below rounding at first
TURNED = 1e-9  # of the torques that add up to a rigid contact's: what is less negative may be rounding


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
            return after + load.amplitude * np.sin(2.0 * np.pi * load.frequency * t + load.phase)
    raise ValueError(load.name)


def kinks(plant):
    """Times after t = 0 at which T(t) has a kink or a jump, increasing."""
    load = plant.profile
    times = {"ramp": [load.duration], "smooth": [load.duration], "pulse": [load.duration], "table": load.times}
    return sorted({t for t in times.get(load.name, []) if t > 0.0})


class OneLash:
    """A plant's equations of motion, and what ends each of its regimes."""

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

    def turned(self, t, x, regime):
        """Whether the load's jump has already turned the torque that held rigid flanks."""
        if not self.rigid or regime[0] != "closed":
            return False
        scale = (np.abs(self.q) * self.inverse @ np.abs(self.loads(t, x))) / (self.q * self.inverse @ self.q)
        return self.contact(t, x, regime[1]) < -TURNED * scale

    def guards(self, regime):
        """What turns negative: (function of time and state, kind, side)."""
        name, side = regime
        if name == "open":
            return [(lambda t, x, s=s: -self.overlap(x, s), "touch", s) for s in (1, -1)]
        if name == "parted":
            return [
                (lambda t, x: self.overlap(x, side), "opening", side),
                (lambda t, x: -self.contact(t, x, side), "rejoin", side),
            ]
        if self.rigid or self.plant.separation == "force":
            return [(lambda t, x: self.contact(t, x, side), "separation", side)]
        return [(lambda t, x: self.overlap(x, side), "separation", side)]

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


def run(plant, end_time, state=None, most=40):
    """[(kind, side, time, q' before)] of the events after the load step, at most so many."""
    lash, n = OneLash(plant), plant.n
    if state is None:
        side, x = plant.preload()
        regime = ("closed", side)
    else:
        regime, x = ("open", 0), np.array(state, float)
    corners = [t for t in kinks(plant) if t < end_time] + [end_time]
    time, events, fastest_touch, step, unwatched = 0.0, [], 0.0, 0.3 / lash.fastest(), 0.0
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-15, "max_step": step}
    while len(events) < most:
        guards = lash.guards(regime)
        ends = []
        for guard, _, _ in guards:
            ends.append(lambda t, x, guard=guard: guard(t, x))
            ends[-1].terminal, ends[-1].direction = True, -1

        def slope(t, x, regime=regime):
            return lash.slope(t, x, regime)

        watch = time + unwatched if time + unwatched < end_time else time
        unwatched = 0.0
        for until in corners:
            lash.until = until if until < end_time else np.inf
            if time < min(watch, until):
                x = solve_ivp(slope, (time, min(watch, until)), x, **options).y[:, -1]
                time = min(watch, until)
            if time >= until:
                continue
            if lash.turned(time, x, regime):
                hit = 0
                break
            solution = solve_ivp(
                slope, (time, until), x, events=ends, first_step=min(1e-6, step, until - time), **options
            )
            hit = min(
                (k for k, times in enumerate(solution.t_events) if times.size),
                key=lambda k: solution.t_events[k][0],
                default=None,
            )
            if hit is not None:
                time, x = solution.t_events[hit][0], solution.y_events[hit][0]
                break
            time, x = until, solution.y[:, -1]
        else:
            break
        _, kind, side = guards[hit]
        events.append((kind, side, time, float(lash.q @ x[n:])))
        if kind == "touch" and lash.rigid:
            kick = lash.q * lash.inverse / (lash.q * lash.inverse @ lash.q)
            speed = lash.q @ x[n:]
            fastest_touch = max(fastest_touch, abs(speed))
            held = plant.restitution * abs(speed) <= LOCKING * fastest_touch
            x[n:] -= (1.0 if held else 1.0 + plant.restitution) * speed * kick
            if held and lash.contact(time, x, side) > 0.0:
                regime = ("closed", side)
                events.append(("lock", side, time, 0.0))
        elif kind in ("touch", "rejoin"):
            regime = ("closed", side)
        elif kind == "opening" or plant.separation == "gap":
            regime = ("open", 0)
            unwatched = UNWATCHED if lash.rigid else 0.0
        elif plant.contact_damping == 0.0:  # without a damper the force ends where the gap opens
            regime = ("open", 0)
            events.append(("opening", side, time, events[-1][3]))
        else:
            regime = ("parted", side)
    return events[:most]


def torques(plant, t, x):
    """The torques on the inertias as a function of the state: what gaps, stages and dampers make of it, no friction."""
    n = plant.n
    total = torque(plant, t) * plant.load
    for row, stiffness, c in plant.joints():
        total = total - row * c * (row @ x[n:])
        if not np.ndim(stiffness):
            total = total - row * stiffness * (row @ x[:n])
    for _, row, element in plant.elements:
        q, rate = row @ x[:n], row @ x[n:]
        if isinstance(element, Stages):
            total = total - row * element.torque(q)
        elif isinstance(element, Lash):
            side = np.sign(q)
            overlap = side * q - element.backlash / 2
            if overlap > 0.0:
                pressing = element.stiffness * overlap + element.damping * side * rate
                total = total - row * side * (max(pressing, 0.0) if element.separation == "force" else pressing)
    return total


def integrated(plant, end_time, state, step):
    """The state at the end time by DOP853, which knows of no events: kinks and jumps cost it small steps."""
    inverse, time, x = 1.0 / np.array(plant.inertias), 0.0, np.array(state, float)
    for until in [*(t for t in kinks(plant) if t < end_time), end_time]:
        last = np.nextafter(until, -np.inf)

        def slope(t, x, last=last):
            return np.concatenate([x[plant.n :], inverse * torques(plant, min(t, last), x)])

        x = solve_ivp(slope, (time, until), x, method="DOP853", rtol=1e-11, atol=1e-13, max_step=step).y[:, -1]
        time = until
    return x


def stepped(plant, end_time, state, step):
    """The state at the end time by Moreau's time stepping, of first order; friction by projected Gauss-Seidel."""
    n, inverse = plant.n, 1.0 / np.array(plant.inertias)
    rubbing = [(row, element.torque) for _, row, element in plant.elements if isinstance(element, Friction)]
    x, count = np.array(state, float), round(end_time / step)
    impulses = np.zeros(len(rubbing))
    for k in range(count):
        x[:n] += 0.5 * step * x[n:]
        free = x[n:] + step * inverse * torques(plant, (k + 0.5) * step, x)
        for _ in range(100):
            before = impulses.copy()
            for j, (row, most) in enumerate(rubbing):
                rate = row @ (free + inverse * sum(p * r for p, (r, _) in zip(impulses, rubbing, strict=True)))
                impulses[j] = np.clip(impulses[j] - rate / (row * inverse @ row), -step * most, step * most)
            if np.all(np.abs(impulses - before) <= 1e-13 * step):
                break
        x[n:] = free + inverse * sum((p * r for p, (r, _) in zip(impulses, rubbing, strict=True)), np.zeros(n))
        x[:n] += 0.5 * step * x[n:]
    return x
