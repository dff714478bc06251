"""An exact reference, written from the physics; it shares no code with clunk.

Between events the motion is linear with a constant load, so z = (θ, θ', 1) moves by a matrix exponential:
z(t) = exp(M t) z(0). Every phase is sampled densely (125 samples a period of the fastest mode). A cell of that grid in
which a guard is negative at the end, or has a minimum inside, is expanded into a Taylor series of order 10 (truncated
below 1e-20), whose real zeros cut it into pieces of one sign; Brent's method polishes the first zero. Nothing is
skipped, nothing stops before the end time.

With a coefficient of restitution the closed lash is a constraint instead, and a touch an impulse across it.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from scipy.linalg import expm
from scipy.optimize import brentq

ORDER = 10
BLOCK = 64  # cells sampled by one matrix product
CELL = 0.05  # of a cell: its length times the fastest mode's |λ|
LOCKING = 1e-4


@dataclass(frozen=True)
class Plant:
    """A driveline with one lash under a load step.

    inertias  [kg m2]; shafts: (one end, other end, stiffness [N m/rad], damping [N m s/rad]), ends numbered from 1 or
    "ground"; lash: its two ends; contact_stiffness, contact_damping  [N m/rad], [N m s/rad]; backlash: total  [rad];
    before, after  [N m]: the torque on inertia `loaded`. With `restitution` the contact's stiffness and damping are not
    used; a rebound not faster than LOCKING times the fastest touch so far locks.
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

    @property
    def n(self):
        return len(self.inertias)

    def across(self, one, other):
        """The row that takes θ to the twist between two ends."""
        row = np.zeros(self.n)
        if one != "ground":
            row[one - 1] += 1.0
        if other != "ground":
            row[other - 1] -= 1.0
        return row

    def open_matrices(self):
        """Damping and stiffness of the open chain, from the torque that each shaft exerts on its two ends."""
        damping, stiffness = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for one, other, k, c in self.shafts:
            for end, sign in ((one, 1.0), (other, -1.0)):
                if end != "ground":
                    stiffness[end - 1] += sign * k * self.across(one, other)
                    damping[end - 1] += sign * c * self.across(one, other)
        return damping, stiffness

    @property
    def twist(self):
        return self.across(*self.lash)

    @property
    def load(self):
        return self.across(self.loaded, "ground")

    def contact_period(self):
        yielding = sum(1.0 / self.inertias[end - 1] for end in self.lash if end != "ground")
        return 2.0 * np.pi / np.sqrt(self.contact_stiffness * yielding)

    def preload(self):
        """The side of the flank that can carry the torque before the load step, and the equilibrium state on it."""
        _, stiffness = self.open_matrices()
        q, k = self.twist, self.contact_stiffness
        for side in (1, -1):
            if self.restitution is None:
                forces = self.before * self.load + side * k * self.backlash / 2 * q
                theta = np.linalg.solve(stiffness + k * np.outer(q, q), forces)
                torque = k * (side * (q @ theta) - self.backlash / 2)
            else:  # the torque on the constraint q θ = side φ/2 is its multiplier
                bordered = np.block([[stiffness, q[:, None]], [q[None], np.zeros((1, 1))]])
                solution = np.linalg.solve(bordered, [*(self.before * self.load), side * self.backlash / 2])
                theta, torque = solution[:-1], side * solution[-1]
            if torque > 1e-9 * abs(self.before):  # less is rounding: the load does not reach the lash
                return side, np.concatenate([theta, np.zeros(self.n)])
        raise ValueError("no flank carries the torque")


class Event(NamedTuple):
    """As it happens; the extremes are the acceleration's over the phase that follows."""

    time: float
    kind: str
    side: int
    speed: float
    state: np.ndarray
    largest: float
    smallest: float


class _Guard(NamedTuple):
    row: np.ndarray  # positive inside the regime
    kind: str
    side: int
    successor: str
    zero_after: int  # the successor's guard that is zero then, or -1
    order: int = 1  # and how many of its derivatives, itself included, are


class _Regime:
    """One linear flow with the guards that end it."""

    def __init__(self, generator, guards, acceleration, cell):
        self.generator, self.guards, self.acceleration, self.cell = generator, guards, acceleration, cell
        rows = np.array([guard.row for guard in guards] + [acceleration])
        across = expm(generator * cell)
        self.powers = [np.eye(generator.shape[0])]
        for _ in range(BLOCK):
            self.powers.append(across @ self.powers[-1])
        powers = np.array(self.powers)
        self.values = rows @ powers  # (BLOCK + 1, rows, N + 1)
        self.slopes = rows @ generator @ powers

    def series(self, z, length):
        """The Taylor terms of z over a cell of this length, in units of it."""
        terms = [z]
        for k in range(1, ORDER + 1):
            terms.append(self.generator @ terms[-1] * length / k)
        return np.array(terms)


def _real_cuts(coefficients):
    scale = np.max(np.abs(coefficients))
    polynomial = Polynomial(coefficients / scale if scale > 0.0 else coefficients).trim(1e-17)
    if polynomial.degree() < 1:
        return [0.0, 1.0]
    inside = sorted(float(root.real) for root in polynomial.roots() if 0.0 < root.real < 1.0)
    return [0.0, *inside, 1.0]


def _first_negative(coefficients):
    """The first u of [0, 1] from which on the polynomial is negative, or None."""
    polynomial = Polynomial(coefficients)
    cuts = _real_cuts(coefficients)
    positive = None
    for low, high in pairwise(cuts):
        middle = 0.5 * (low + high)
        if polynomial(middle) < 0.0:
            return 0.0 if positive is None else brentq(polynomial, positive, middle, xtol=1e-15, rtol=1e-15)
        positive = middle
    return None


def _extremes(coefficients, length):
    """Largest and smallest value of the polynomial on [0, length]."""
    polynomial = Polynomial(coefficients)
    points = [0.0, length, *(u for u in _real_cuts(polynomial.deriv().coef) if u < length)]
    values = [float(polynomial(u)) for u in points]
    return max(values), min(values)


def _regimes(plant, torque):
    n = plant.n
    damping, stiffness = plant.open_matrices()
    inverse = 1.0 / np.array(plant.inertias)[:, None]
    q, k, c, half = plant.twist, plant.contact_stiffness, plant.contact_damping, plant.backlash / 2

    def generator(side):
        """Of z' = M z; `side` is that of the flank in contact, 0 for none."""
        closed = 1.0 if side else 0.0
        matrix = np.zeros((2 * n + 1, 2 * n + 1))
        matrix[:n, n : 2 * n] = np.eye(n)
        matrix[n : 2 * n, :n] = -inverse * (stiffness + closed * k * np.outer(q, q))
        matrix[n : 2 * n, n : 2 * n] = -inverse * (damping + closed * c * np.outer(q, q))
        matrix[n : 2 * n, 2 * n] = inverse[:, 0] * (plant.load * torque + side * k * half * q)
        return matrix

    def overlap(side):
        return np.concatenate([side * q, np.zeros(n), [-half]])

    def force(side):
        return np.concatenate([side * k * q, side * c * q, [-k * half]])

    def acceleration(matrix):
        return matrix[n + plant.acceleration_of - 1]

    if plant.restitution is not None:
        return _rigid_regimes(plant, generator(0), overlap, acceleration)
    fastest = max(np.max(np.abs(np.linalg.eigvals(generator(side)))) for side in (0, 1))
    cell = CELL / fastest
    by_force = plant.separation == "force"
    loose = generator(0)
    touch_zero = -1 if by_force and c > 0.0 else 0
    regimes = {
        "open": _Regime(
            loose,
            [_Guard(-overlap(side), "touch", side, f"closed{side:+d}", touch_zero) for side in (1, -1)],
            acceleration(loose),
            cell,
        )
    }
    for side in (1, -1):
        reached = 0 if side > 0 else 1
        if by_force:
            closed = [_Guard(force(side), "separation", side, f"parted{side:+d}", 1)]
            parted = [
                _Guard(overlap(side), "opening", side, "open", reached),
                _Guard(-force(side), "rejoin", side, f"closed{side:+d}", 0),
            ]
            regimes[f"parted{side:+d}"] = _Regime(loose, parted, acceleration(loose), cell)
        else:
            closed = [_Guard(overlap(side), "separation", side, "open", reached)]
        tight = generator(side)
        regimes[f"closed{side:+d}"] = _Regime(tight, closed, acceleration(tight), cell)
    return regimes


def _rigid_regimes(plant, loose, overlap, acceleration):
    """Open, and locked on either flank: there the torque across the lash is what keeps q'' = 0."""
    n = plant.n
    q, inverse = plant.twist, 1.0 / np.array(plant.inertias)
    holding = q @ loose[n : 2 * n] / (q * inverse @ q)  # the row of that torque, signed like q
    held = loose.copy()
    held[n : 2 * n] -= np.outer(q * inverse, holding)
    rates = [np.max(np.abs(np.linalg.eigvals(matrix)), initial=0.0) for matrix in (loose, held)]
    cell = CELL / max(rates) if max(rates) > 1e-6 else 1e-3
    touches = [_Guard(-overlap(side), "touch", side, "open", -1) for side in (1, -1)]
    regimes = {"open": _Regime(loose, touches, acceleration(loose), cell)}
    for side in (1, -1):
        guards = [_Guard(side * holding, "separation", side, "open", 0 if side > 0 else 1, 3)]
        regimes[f"closed{side:+d}"] = _Regime(held, guards, acceleration(held), cell)
    return regimes


def _strike(plant, z, regimes, side, fastest):
    """The state after an impulsive touch on the flank of `side`, and the regime and the zero that follow."""
    n = plant.n
    q, inverse = plant.twist, 1.0 / np.array(plant.inertias)
    speed, z = q @ z[n : 2 * n], z.copy()
    guard = 0 if side > 0 else 1
    kick = q * inverse / (q * inverse @ q) * speed
    if plant.restitution * abs(speed) > LOCKING * fastest:
        z[n : 2 * n] -= (1.0 + plant.restitution) * kick
        return z, "open", guard, 1
    z[n : 2 * n] -= kick
    locked = f"closed{side:+d}"
    if regimes[locked].guards[0].row @ z > 0.0:
        return z, locked, -1, 0
    return z, "open", guard, 2


def run(plant, end_time=2.0, state=None, regime=None, max_events=5000):
    """Events from the load step on (event 0), and the state at the end time; from preload unless a state is given."""
    if state is None:
        side, state = plant.preload()
        regime = f"closed{side:+d}"
    regimes = _regimes(plant, plant.after)
    n = plant.n
    speed_row = np.concatenate([np.zeros(n), plant.twist, [0.0]])
    z = np.concatenate([state, [1.0]])
    time, zero, order, fastest = 0.0, -1, 1, 0.0
    header = (0.0, "load step", int(regime[-2:]) if regime != "open" else 0, 0.0, z[:-1])
    events = []
    while len(events) < max_events:
        here = regimes[regime]
        after, hit, z, largest, smallest = _phase(here, z, end_time - time, zero, order)
        events.append(Event(*header, largest, smallest))
        time += after
        if hit is None:
            return events, z[:-1]
        guard = here.guards[hit]
        regime, zero, order, speed = guard.successor, guard.zero_after, guard.order, float(speed_row @ z)
        if plant.restitution is not None and guard.kind == "separation":
            # a torque that the load step itself turns parts the flanks with a curvature, not with a third derivative
            order = 2 if guard.row @ z < -1e-9 * (np.abs(guard.row) @ np.abs(z)) else 3
        if plant.restitution is not None and guard.kind == "touch":
            fastest = max(fastest, abs(speed))
            z, regime, zero, order = _strike(plant, z, regimes, guard.side, fastest)
        header = (time, guard.kind, guard.side, speed, z[:-1])
        if plant.restitution is not None and regime != "open":
            events.append(Event(*header, -np.inf, np.inf))
            header = (time, "lock", guard.side, 0.0, z[:-1])
    raise RuntimeError("more events than allowed")


def _phase(regime, z, remaining, zero, order=1):
    """Until the first guard turns negative, or for the remaining time: duration, guard, state, extremes."""
    duration, first = 0.0, True
    largest, smallest = -np.inf, np.inf
    count = len(regime.guards)

    def located(z, length, zero):
        series = regime.series(z, length)
        earliest, hit = 1.0, None
        for k, guard in enumerate(regime.guards):
            coefficients = series @ guard.row
            u = _first_negative(coefficients[order:] if k == zero else coefficients)
            if u is not None and (hit is None or u < earliest):
                earliest, hit = u, k
        high, low = _extremes(series @ regime.acceleration, earliest)
        return earliest, hit, earliest ** np.arange(ORDER + 1) @ series, high, low

    while True:
        whole = min(BLOCK, int((remaining - duration) / regime.cell))
        if whole == 0:  # the last, shorter cell
            length = remaining - duration
            u, hit, z, high, low = located(z, length, zero if first else -1)
            return duration + u * length, hit, z, max(largest, high), min(smallest, low)
        values, slopes = regime.values[: whole + 1] @ z, regime.slopes[: whole + 1] @ z
        acceleration, jerk = values[:, -1], slopes[:, -1]
        suspect = np.any(values[1:, :count] < 0.0, axis=1)
        suspect |= np.any((slopes[:-1, :count] < 0.0) & (slopes[1:, :count] > 0.0), axis=1)
        suspect[0] |= first
        peaked = jerk[:-1] * jerk[1:] < 0.0
        for j in np.flatnonzero(suspect | peaked):
            at = regime.powers[j] @ z
            u, hit, end, high, low = located(at, regime.cell, zero if first and j == 0 else -1)
            largest, smallest = max(largest, high), min(smallest, low)
            if hit is not None:
                largest = max(largest, np.max(acceleration[: j + 1]))
                smallest = min(smallest, np.min(acceleration[: j + 1]))
                return duration + (j + u) * regime.cell, hit, end, largest, smallest
        largest, smallest = max(largest, np.max(acceleration)), min(smallest, np.min(acceleration))
        z = regime.powers[whole] @ z
        duration, first = duration + whole * regime.cell, False


def primary_impacts(events, sticking_time):
    """Indices of the touches on the other flank than the last one, or on the same one after it had stuck."""
    flank, touched, stuck = events[0].side, -np.inf, False  # a preload has lasted for ever
    found = []
    for k, event in enumerate(events):
        if event.kind == "touch":
            if event.side != flank or stuck:
                found.append(k)
            flank, touched, stuck = event.side, event.time, False
        elif event.kind == "lock":
            touched = event.time
        elif event.kind == "separation":
            stuck = event.time - touched > sticking_time
    return found


def severities(events, primaries):
    """Q_i: the acceleration's peak-to-peak value from each primary impact up to the next, or the end."""
    windows = [events[begin:end] for begin, end in pairwise([*primaries, len(events)])]
    return np.array(
        [max(event.largest for event in window) - min(event.smallest for event in window) for window in windows]
    )


def boere(ratio, backlash_deg, **changes):
    """The report's driveline at one point of its map."""
    return Plant(backlash=np.deg2rad(backlash_deg), before=-1.0 * (1.0 + ratio), after=-1.0, **changes)


def plant_of(study):
    """The plant that a study's config spells out, in rad, N m and s."""
    contact, radius = study.lash.contact, study.lash.radius
    load = study.load
    if load.ratio is None:
        before, after = load.initial_torque, load.final_torque
    else:
        before, after = load.static_torque * (1.0 + load.ratio), load.static_torque
    return Plant(
        inertias=study.driveline.inertias,
        shafts=tuple((*shaft.between, shaft.stiffness, shaft.damping) for shaft in study.driveline.shafts),
        lash=study.lash.between,
        contact_stiffness=radius**2 * contact.stiffness,
        contact_damping=radius**2 * contact.damping,
        backlash=np.pi / 180.0 * study.lash.backlash_deg,
        before=before,
        after=after,
        loaded=study.load.on,
        acceleration_of=study.impacts.acceleration_of,
        separation=contact.separation,
        restitution=contact.restitution if contact.model == "restitution" else None,
    )


def config_of(plant, step=1e-4, end_time=2.0, method="rk4"):
    """The config, as TOML, that spells out a plant; the contact at a radius of 0.1 m."""
    shafts = "".join(
        f"[[driveline.shafts]]\nbetween = {_ends(one, other)}\nstiffness = {k!r}\ndamping = {c!r}\n"
        for one, other, k, c in plant.shafts
    )
    model = "" if plant.restitution is None else f'model = "restitution"\nrestitution = {plant.restitution!r}\n'
    return f"""
[driveline]
inertias = {list(plant.inertias)}
{shafts or "shafts = []"}
[lash]
between = {_ends(*plant.lash)}
backlash_deg = {float(np.rad2deg(plant.backlash))!r}
radius = 0.1
[lash.contact]
stiffness = {plant.contact_stiffness / 0.01!r}
damping = {plant.contact_damping / 0.01!r}
separation = "{plant.separation}"
{model}[load]
on = {plant.loaded}
initial_torque = {plant.before!r}
final_torque = {plant.after!r}
[solver]
method = "{method}"
step = {step!r}
end_time = {end_time!r}
max_events = 4096
[impacts]
acceleration_of = {plant.acceleration_of}
"""


def _ends(one, other):
    return "[" + ", ".join(f'"{end}"' if end == "ground" else str(end) for end in (one, other)) + "]"
