"""An exact reference, written from the physics; it shares no code with clunk.

Between events and kinks of the load the motion is linear, and the load is B w with w' = S w. So z = (θ, θ', w) moves by
a matrix exponential, z(t) = exp(M t) z(0); under a constant load w = 1. Every phase is sampled densely (125 samples a
period of the fastest mode). A cell of that grid in which a guard is negative at the end, or has a minimum inside, is
expanded into a Taylor series of order 10 (truncated below 1e-20), whose real zeros cut it into pieces of one sign;
Brent's method polishes the first zero. Nothing is skipped, nothing stops before the end time.

With a coefficient of restitution the closed lash is a constraint instead, and a touch an impulse across it.

A driveline that nothing holds rolls away. Its angles are then written as twists and one rigid-body angle on which
nothing depends, so that rounding does not grow with them.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from scipy.linalg import expm, null_space
from scipy.optimize import brentq

ORDER = 10
BLOCK = 64  # cells sampled by one matrix product
CELL = 0.05  # of a cell: its length times the fastest mode's |λ|
LOCKING = 1e-4
FITS = 1e-9  # a rate across a joint, relative to those of its ends, that is rounding
GONE = 40.0  # time constants after which a lag has ended: exp(-40) = 4e-18
PARAMETERS = {  # of each profile, as a config names them too
    "ramp": ("duration",),
    "smooth": ("duration",),
    "lag": ("time_constant",),
    "pulse": ("duration",),
    "table": ("times", "torques"),
    "sine": ("amplitude", "frequency"),
}


class Piece(NamedTuple):
    """A stretch of the load: T = constant + slope u + Re(amplitude exp(rate u)) at the time u after `begin`."""

    begin: float
    constant: float
    slope: float = 0.0
    amplitude: complex = 0.0
    rate: complex = 0.0

    def inputs(self, u):
        """(4,): the ramp and its slope, and the real and imaginary part of the exponential."""
        wave = self.amplitude * np.exp(self.rate * u)
        return np.array([self.constant + self.slope * u, self.slope, wave.real, wave.imag])

    def torque(self, u):
        ramp, _, wave, _ = self.inputs(u)
        return ramp + wave


@dataclass(frozen=True)
class Profile:
    """A load profile by its name and the parameters that it uses  [s, N m, Hz, rad].

    `step`, `ramp`, `smooth`, `lag` and `pulse` lead from the plant's torque before the load step to the one after it, a
    `table` from its first torque to its last, and a `sine` swings about the torque after.
    """

    name: str = "step"
    duration: float = 0.0
    time_constant: float = 0.0
    times: tuple = ()
    torques: tuple = ()
    amplitude: float = 0.0
    frequency: float = 0.0
    phase: float = 0.0

    def pieces(self, before, after):
        """The load from t = 0 on, each piece up to where the next one begins."""
        change, d = after - before, self.duration
        if self.name == "ramp" and d > 0.0:
            return (Piece(0.0, before, change / d), Piece(d, after))
        if self.name == "smooth" and d > 0.0:
            return (Piece(0.0, before + change / 2, 0.0, -change / 2, 1j * np.pi / d), Piece(d, after))
        if self.name == "lag" and self.time_constant > 0.0:
            rate = -1.0 / self.time_constant
            return (Piece(0.0, after, 0.0, -change, rate), Piece(-GONE / rate, after))
        if self.name == "pulse":
            return (Piece(0.0, after), Piece(d, before)) if d > 0.0 else (Piece(0.0, before),)
        if self.name == "table":
            knots = list(zip(self.times, self.torques, strict=True))
            lines = [
                Piece(t, torque, (following - torque) / (until - t))
                for (t, torque), (until, following) in pairwise(knots)
                if until > t
            ]
            return (*lines, Piece(*knots[-1]))
        if self.name == "sine":
            swing = self.amplitude * np.exp(1j * (self.phase - np.pi / 2))
            return (Piece(0.0, after, 0.0, swing, 2j * np.pi * self.frequency),)
        return (Piece(0.0, after),)


def step():
    return Profile("step")


def ramp(duration):
    return Profile("ramp", duration=duration)


def smooth(duration):
    return Profile("smooth", duration=duration)


def lag(time_constant):
    return Profile("lag", time_constant=time_constant)


def pulse(duration):
    return Profile("pulse", duration=duration)


def table(times: Sequence[float], torques: Sequence[float]):
    """Straight lines between the torques; two equal times are a jump, of which the second torque holds from then on."""
    if times[0] != 0.0 or list(times) != sorted(times) or max(Counter(times).values()) > 2:
        raise ValueError("the times begin at 0, do not decrease, and no three are equal")
    return Profile("table", times=tuple(map(float, times)), torques=tuple(map(float, torques)))


def sine(amplitude, frequency, phase=0.0):
    """The torque after the load step, plus amplitude sin(2π frequency t + phase)."""
    return Profile("sine", amplitude=amplitude, frequency=frequency, phase=phase)


@dataclass(frozen=True)
class Plant:
    """A driveline with one lash under a load.

    inertias  [kg m2]; shafts: (one end, other end, stiffness [N m/rad], damping [N m s/rad]), ends numbered from 1 or
    "ground"; ratios: of the shafts in their order, none for all 1; lash: its two ends; contact_stiffness,
    contact_damping  [N m/rad], [N m s/rad]; backlash: total  [rad]; before, after  [N m]: the torque on inertia
    `loaded`, taken from the profile if that is a table. A joint's twist is θ of its first end less ratio θ of its
    second. With `restitution` the contact's stiffness and damping are not used; a rebound not faster than LOCKING times
    the fastest touch so far locks.
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
    profile: Profile = Profile()

    def __post_init__(self):
        if self.profile.name == "table":
            object.__setattr__(self, "before", self.profile.torques[0])
            object.__setattr__(self, "after", self.profile.torques[-1])

    @property
    def n(self):
        return len(self.inertias)

    def across(self, one, other, ratio=1.0):
        """The row that takes θ to the twist between two ends."""
        row = np.zeros(self.n)
        if one != "ground":
            row[one - 1] += 1.0
        if other != "ground":
            row[other - 1] -= ratio
        return row

    def joints(self):
        """Of each shaft the row of its twist, its stiffness and its damping."""
        ratios = self.ratios or (1.0,) * len(self.shafts)
        for (one, other, k, c), ratio in zip(self.shafts, ratios, strict=True):
            yield self.across(one, other, ratio), k, c

    def open_matrices(self):
        """Damping and stiffness of the open chain, from the torque that each shaft exerts on its two ends."""
        damping, stiffness = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for row, k, c in self.joints():
            stiffness += np.outer(row, k * row)
            damping += np.outer(row, c * row)
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

    def contact_period(self):
        shares = zip(self.lash, (1.0, self.lash_ratio**2), strict=True)
        yielding = sum(share / self.inertias[end - 1] for end, share in shares if end != "ground")
        return 2.0 * np.pi / np.sqrt(self.contact_stiffness * yielding)

    @property
    def rigid_motion(self):
        """(n, 0 or 1): the speeds, of length 1, that twist no joint with stiffness, the closed lash among them."""
        held = [self.twist, *(row for row, k, _ in self.joints() if k != 0.0)]
        motions = null_space(np.array([row / np.linalg.norm(row) for row in held]), rcond=FITS)
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
        """The side of the flank that carries a torque for good, and the state then; a rigid-body angle is zero."""
        damping, stiffness = self.open_matrices()
        speeds, accelerations = self.steady_speeds(torque)
        applied = torque * self.load - damping @ speeds - self.inertias * accelerations
        q, k = self.twist, self.contact_stiffness
        for side in (1, -1):
            # θ, then what keeps the twist of a rigid contact, then what keeps the rigid-body angle (nothing does)
            if self.restitution is None:
                matrix, forces = stiffness + k * np.outer(q, q), applied + side * k * self.backlash / 2 * q
                border, kept = self.rigid_motion, []
            else:
                matrix, forces = stiffness, applied
                border, kept = np.hstack((q[:, None], self.rigid_motion)), [side * self.backlash / 2]
            corner = np.zeros((border.shape[1], border.shape[1]))
            bordered = np.block([[matrix, border], [border.T, corner]])
            solution = np.linalg.solve(bordered, [*forces, *kept, *np.zeros(len(corner) - len(kept))])
            theta = solution[: self.n]
            pressing = side * solution[self.n] if kept else k * (side * (q @ theta) - self.backlash / 2)
            if pressing > 1e-9 * abs(torque):  # less is rounding: the load does not reach the lash
                return side, np.concatenate([theta, speeds])
        raise ValueError("no flank carries the torque")

    def preload(self):
        """The side of the flank that can carry the torque before the load step, and the state of that motion."""
        return self.steady_motion(self.before)


class Event(NamedTuple):
    """As it happens; the extremes are the acceleration's over the phase that follows."""

    time: float
    kind: str
    side: int
    speed: float
    state: np.ndarray
    coordinates: np.ndarray  # of the state: those that the run is computed in
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
    """One linear flow with the guards that end it.

    `held` is the number of an input that stays 1 exactly; without it, it is off by some 1e-14 after a block.
    """

    def __init__(self, generator, guards, acceleration, cell, held=None):
        self.generator, self.guards, self.acceleration, self.cell = generator, guards, acceleration, cell
        rows = np.array([guard.row for guard in guards] + [acceleration])
        across = expm(generator * cell)
        if held is not None:
            across[held:, :held] = 0.0
            across[held] = np.eye(len(across))[held]
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


class Flow:
    """The regimes of a plant under each piece of its load.

    The state is (y, y') with θ = basis y. In general y = θ; of a driveline that rolls, if `rolling`, the last of y is
    the rigid-body angle, which no torque depends on, and the others are at right angles to it.
    """

    def __init__(self, plant, rolling):
        self.plant, self.n = plant, plant.n
        self.pieces = plant.pieces
        self.constant = all(piece.slope == 0.0 and piece.amplitude == 0.0 for piece in self.pieces)
        self.basis = np.eye(plant.n)
        self.rolls = rolling and plant.rigid_motion.size > 0
        if self.rolls:
            self.basis = np.hstack((null_space(plant.rigid_motion.T), plant.rigid_motion))
        self.mobility = self.basis.T @ np.diag(1.0 / np.array(plant.inertias)) @ self.basis
        self.twist = self.row(plant.twist)
        # a constant load on a driveline that does not roll keeps the bits that it has always had
        self.held = None if self.constant and not self.rolls else 2 * plant.n
        self._known = {}

    def row(self, twist):
        """The row of a twist for y in place of θ; one that fits the rigid-body motion is exactly zero there."""
        row = twist @ self.basis
        if self.rolls and abs(row[-1]) <= FITS * np.linalg.norm(twist):
            row[-1] = 0.0
        return row

    def coordinates(self, state):
        return (self.basis.T @ state.reshape(2, self.n).T).T.ravel()

    def state(self, coordinates):
        return (self.basis @ coordinates.reshape(2, self.n).T).T.ravel()

    def until(self, k):
        """The time at which piece `k` of the load ends."""
        return self.pieces[k + 1].begin if k + 1 < len(self.pieces) else np.inf

    def augmented(self, coordinates, k, time):
        """(y, y', w) in piece `k` of the load."""
        inputs = [] if self.constant else self.pieces[k].inputs(time - self.pieces[k].begin)
        return np.concatenate([coordinates, [1.0], inputs])

    def regimes(self, k):
        """All regimes in piece `k` of the load, by name."""
        piece = self.pieces[k]
        key = piece.constant if self.constant else complex(piece.rate)
        if key not in self._known:
            self._known[key] = self._build(piece)
        return self._known[key]

    def generator(self, piece, side):
        """Of z' = M z; `side` is that of the flank in contact, 0 for none."""
        n, plant, q = self.n, self.plant, self.twist
        damping, stiffness = np.zeros((n, n)), np.zeros((n, n))
        for twist, k, c in plant.joints():
            row = self.row(twist)
            stiffness += np.outer(row, k * row)
            damping += np.outer(row, c * row)
        closed, k, c = 1.0 if side else 0.0, plant.contact_stiffness, plant.contact_damping
        offset, load = side * k * plant.backlash / 2 * q, plant.load @ self.basis
        matrix = np.zeros((2 * n + 1 + 4 * (not self.constant),) * 2)
        matrix[:n, n : 2 * n] = np.eye(n)
        matrix[n : 2 * n, :n] = -self.mobility @ (stiffness + closed * k * np.outer(q, q))
        matrix[n : 2 * n, n : 2 * n] = -self.mobility @ (damping + closed * c * np.outer(q, q))
        if self.constant:
            matrix[n : 2 * n, 2 * n] = self.mobility @ (load * piece.constant + offset)
            return matrix
        matrix[n : 2 * n, 2 * n] = self.mobility @ offset
        matrix[n : 2 * n, 2 * n + 1] = matrix[n : 2 * n, 2 * n + 3] = self.mobility @ load
        matrix[2 * n + 1, 2 * n + 2] = 1.0
        decay, turn = complex(piece.rate).real, complex(piece.rate).imag
        matrix[2 * n + 3 :, 2 * n + 3 :] = [[decay, -turn], [turn, decay]]
        return matrix

    def _build(self, piece):
        plant, q, k, c, half = self.plant, self.twist, *self._contact()
        loose = self.generator(piece, 0)
        inputs = np.zeros(len(loose) - 2 * self.n - 1)

        def overlap(side):
            return np.concatenate([side * q, np.zeros(self.n), [-half], inputs])

        def force(side):
            return np.concatenate([side * k * q, side * c * q, [-k * half], inputs])

        def acceleration(matrix):
            return self.basis[plant.acceleration_of - 1] @ matrix[self.n : 2 * self.n]

        if plant.restitution is not None:
            return self._build_rigid(loose, overlap, acceleration)
        fastest = max(np.max(np.abs(np.linalg.eigvals(self.generator(piece, side)))) for side in (0, 1))
        cell = CELL / fastest
        by_force = plant.separation == "force"
        touch_zero = -1 if by_force and c > 0.0 else 0
        touches = [_Guard(-overlap(side), "touch", side, f"closed{side:+d}", touch_zero) for side in (1, -1)]
        regimes = {"open": _Regime(loose, touches, acceleration(loose), cell, self.held)}
        for side in (1, -1):
            reached = 0 if side > 0 else 1
            if by_force:
                closed = [_Guard(force(side), "separation", side, f"parted{side:+d}", 1)]
                parted = [
                    _Guard(overlap(side), "opening", side, "open", reached),
                    _Guard(-force(side), "rejoin", side, f"closed{side:+d}", 0),
                ]
                regimes[f"parted{side:+d}"] = _Regime(loose, parted, acceleration(loose), cell, self.held)
            else:
                closed = [_Guard(overlap(side), "separation", side, "open", reached)]
            tight = self.generator(piece, side)
            regimes[f"closed{side:+d}"] = _Regime(tight, closed, acceleration(tight), cell, self.held)
        return regimes

    def _contact(self):
        return self.plant.contact_stiffness, self.plant.contact_damping, self.plant.backlash / 2

    def _build_rigid(self, loose, overlap, acceleration):
        """Open, and locked on either flank: there the torque across the lash is what keeps q'' = 0."""
        n, q = self.n, self.twist
        yielding = self.mobility @ q
        holding = q @ loose[n : 2 * n] / (yielding @ q)  # the row of that torque, signed like q
        held = loose.copy()
        held[n : 2 * n] -= np.outer(yielding, holding)
        rates = [np.max(np.abs(np.linalg.eigvals(matrix)), initial=0.0) for matrix in (loose, held)]
        cell = CELL / max(rates) if max(rates) > 1e-6 else 1e-3
        touches = [_Guard(-overlap(side), "touch", side, "open", -1) for side in (1, -1)]
        regimes = {"open": _Regime(loose, touches, acceleration(loose), cell, self.held)}
        for side in (1, -1):
            guards = [_Guard(side * holding, "separation", side, "open", 0 if side > 0 else 1, 3)]
            regimes[f"closed{side:+d}"] = _Regime(held, guards, acceleration(held), cell, self.held)
        return regimes


def _strike(flow, z, regimes, side, fastest):
    """The state after an impulsive touch on the flank of `side`, and the regime and the zero that follow."""
    n, restitution = flow.n, flow.plant.restitution
    q, yielding = flow.twist, flow.mobility @ flow.twist
    speed, z = q @ z[n : 2 * n], z.copy()
    guard = 0 if side > 0 else 1
    kick = yielding / (yielding @ q) * speed
    if restitution * abs(speed) > LOCKING * fastest:
        z[n : 2 * n] -= (1.0 + restitution) * kick
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
    flow = Flow(plant, rolling=regime != "open")
    motion, speed_row = 2 * plant.n, np.concatenate([np.zeros(plant.n), flow.twist])
    time, piece, zero, order, fastest = 0.0, 0, -1, 1, 0.0
    z = flow.augmented(flow.coordinates(np.asarray(state, float)), piece, time)

    def header(time, kind, side, speed):
        return time, kind, side, speed, flow.state(z[:motion]), z[:motion]

    begin = header(0.0, "load step", int(regime[-2:]) if regime != "open" else 0, 0.0)
    events = []
    while len(events) < max_events:
        time, piece, hit, z, largest, smallest = _travel(flow, regime, z, time, piece, end_time, zero, order)
        events.append(Event(*begin, largest, smallest))
        if hit is None:
            return events, flow.state(z[:motion])
        regimes = flow.regimes(piece)
        guard = regimes[regime].guards[hit]
        regime, zero, order, speed = guard.successor, guard.zero_after, guard.order, float(speed_row @ z[:motion])
        if plant.restitution is not None and guard.kind == "separation":
            # a torque that the load itself turns parts the flanks with a curvature, not with a third derivative
            order = 2 if guard.row @ z < -1e-9 * (np.abs(guard.row) @ np.abs(z)) else 3
        if plant.restitution is not None and guard.kind == "touch":
            fastest = max(fastest, abs(speed))
            z, regime, zero, order = _strike(flow, z, regimes, guard.side, fastest)
        begin = header(time, guard.kind, guard.side, speed)
        if plant.restitution is not None and regime != "open":
            events.append(Event(*begin, -np.inf, np.inf))
            begin = header(time, "lock", guard.side, 0.0)
    raise RuntimeError("more events than allowed")


def _travel(flow, name, z, time, piece, end_time, zero, order):
    """Through the pieces of the load until a guard turns negative, or to the end: time, piece, guard, state, extremes.

    The extremes of the acceleration take both limits where the load jumps.
    """
    began, fresh = time, True
    largest, smallest = -np.inf, np.inf
    while True:
        until = min(flow.until(piece), end_time)
        if until > time:
            regime = flow.regimes(piece)[name]
            releasing = zero if fresh or time - began < regime.cell else -1
            duration, hit, z, high, low = _phase(regime, z, until - time, releasing, order, fresh)
            if fresh or hit is None or duration > 0.0:  # an acceleration that lasts no time does not count
                largest, smallest = max(largest, high), min(smallest, low)
            if hit is not None:
                return time + duration, piece, hit, z, largest, smallest
            time, fresh = until, False
        if until == end_time:
            return time, piece, None, z, largest, smallest
        piece += 1
        z = flow.augmented(z[: 2 * flow.n], piece, time)


def _phase(regime, z, remaining, zero, order=1, exact=True):
    """Until the first guard turns negative, or for the remaining time: duration, guard, state, extremes.

    Guard `zero` begins at zero with its first `order` derivatives, itself included: exactly, or but for rounding.
    """
    duration, first = 0.0, True
    largest, smallest = -np.inf, np.inf
    count = len(regime.guards)

    def located(z, length, zero):
        series = regime.series(z, length)
        earliest, hit = 1.0, None
        for k, guard in enumerate(regime.guards):
            coefficients = series @ guard.row
            if k == zero and exact:
                coefficients = coefficients[order:]
            elif k == zero:
                rounding = 1e-13 * (np.abs(series[:order]) @ np.abs(guard.row))
                small = np.abs(coefficients[:order]) < rounding
                coefficients[:order][small] = np.maximum(coefficients[:order][small], 0.0)
            u = _first_negative(coefficients)
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


def label(events, primaries):
    """The label of the primary impacts, for example DS(1)SS(1)."""
    letters = "".join("I" if events[k].side == events[0].side else "O" for k in primaries)
    excursions = []
    for excursion in re.findall("O+I?|I", letters):  # from the initial flank and, but for the last, back to it
        back = "SS" if excursion == "I" else "DS" if excursion.endswith("I") else "CR"
        excursions += ["OS"] * (excursion.count("O") - 1) + [back]
    return "".join(f"{name}({len(list(run))})" for name, run in groupby(excursions)) or "NI"


def severities(events, primaries):
    """Q_i: the acceleration's peak-to-peak value from each primary impact up to the next, or the end."""
    windows = [events[begin:end] for begin, end in pairwise([*primaries, len(events)])]
    return np.array(
        [max(event.largest for event in window) - min(event.smallest for event in window) for window in windows]
    )


def boere(ratio, backlash_deg, **changes):
    """The report's driveline at one point of its map."""
    return Plant(backlash=np.deg2rad(backlash_deg), before=-1.0 * (1.0 + ratio), after=-1.0, **changes)


# Of the report's driveline at φθ = 6°, separation by gap: the load ratio, the profile, then labels and the durations or
# time constants  [s] at which they change
THRESHOLDS = [
    (5.0, ramp, "DS(1)SS(1)", 0.14258357, "DS(1)", 0.18773531, "SS(1)", 0.24012633, "NI"),
    (5.0, smooth, "DS(1)SS(1)", 0.19129479, "DS(1)", 0.25453100, "SS(1)", 0.33055417, "NI"),
    (5.0, lag, "DS(1)SS(1)", 0.04711069, "DS(1)", 0.06814334, "SS(1)", 0.09666195, "NI"),
    (5.0, pulse, "NI", 0.07546593, "SS(1)", 0.08881033, "DS(1)", 0.45754921, "DS(1)SS(1)"),
    # longer is not always safer: the NI window between two SS(1)
    (10.0, ramp, "DS(1)", 0.24911306, "SS(1)", 0.28324346, "NI", 0.37526758, "SS(1)", 0.51055251, "NI"),
]


def plant_of(study):
    """The plant that a study's config spells out, in rad, N m and s."""
    contact, radius = study.lash.contact, study.lash.radius
    load, shafts = study.load, study.driveline.shafts
    name = "step" if load.profile == "tip-out" else load.profile
    before, after = load.initial_torque, load.final_torque
    if load.ratio is not None:
        before, after = load.static_torque * (1.0 + load.ratio), load.static_torque
    parameters = {key: getattr(load, key) for key in PARAMETERS.get(name, ())}
    if name == "table":
        parameters["torques"] = tuple(load.scale * torque for torque in load.torques)
    return Plant(
        inertias=study.driveline.inertias,
        shafts=tuple((*shaft.between, shaft.stiffness, shaft.damping) for shaft in shafts),
        lash=study.lash.between,
        contact_stiffness=radius**2 * contact.stiffness,
        contact_damping=radius**2 * contact.damping,
        backlash=np.pi / 180.0 * study.lash.backlash_deg,
        before=before,
        after=after,
        loaded=load.on,
        acceleration_of=study.impacts.acceleration_of,
        separation=contact.separation,
        restitution=contact.restitution if contact.model == "restitution" else None,
        ratios=tuple(shaft.ratio for shaft in shafts),
        lash_ratio=study.lash.ratio,
        profile=Profile(name, **parameters),
    )


def config_of(plant, step=1e-4, end_time=2.0, method="rk4"):
    """The config, as TOML, that spells out a plant; the contact at a radius of 0.1 m."""
    ratios = plant.ratios or (1.0,) * len(plant.shafts)
    shafts = "".join(
        f"[[driveline.shafts]]\nbetween = {_ends(one, other)}\nstiffness = {k!r}\ndamping = {c!r}\n{_ratio(ratio)}"
        for (one, other, k, c), ratio in zip(plant.shafts, ratios, strict=True)
    )
    model = "" if plant.restitution is None else f'model = "restitution"\nrestitution = {plant.restitution!r}\n'
    torques = f"initial_torque = {plant.before!r}\nfinal_torque = {plant.after!r}\n"
    if plant.profile.phase:
        raise ValueError("a config's sine begins at the torque after the load step")
    values = ((key, getattr(plant.profile, key)) for key in PARAMETERS.get(plant.profile.name, ()))
    parameters = "".join(
        f"{key} = {list(value) if isinstance(value, tuple) else repr(value)}\n" for key, value in values
    )
    return f"""
[driveline]
inertias = {list(plant.inertias)}
{shafts or "shafts = []"}
[lash]
between = {_ends(*plant.lash)}
backlash_deg = {float(np.rad2deg(plant.backlash))!r}
{_ratio(plant.lash_ratio)}radius = 0.1
[lash.contact]
stiffness = {plant.contact_stiffness / 0.01!r}
damping = {plant.contact_damping / 0.01!r}
separation = "{plant.separation}"
{model}[load]
on = {plant.loaded}
profile = "{plant.profile.name}"
{parameters}{"" if plant.profile.name == "table" else torques}[solver]
method = "{method}"
step = {step!r}
end_time = {end_time!r}
max_events = 4096
[impacts]
acceleration_of = {plant.acceleration_of}
"""


def _ratio(ratio):
    return "" if ratio == 1.0 else f"ratio = {ratio!r}\n"


def _ends(one, other):
    return "[" + ", ".join(f'"{end}"' if end == "ground" else str(end) for end in (one, other)) + "]"
