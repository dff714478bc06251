"""An exact reference, written from the physics; it shares no code with clunk.

Between events and kinks of the load the motion is linear, and the load is B w with w' = S w. So z = (θ, θ', 1, w)
moves by a matrix exponential, z(t) = exp(M t) z(0). Every phase is sampled densely (125 samples a period of the fastest
mode). A cell of that grid in which a guard is negative at the end, or has a minimum inside, is expanded into a Taylor
series of order 10 (truncated below 1e-20), whose zeros, by Brent's method between those of its derivative, cut it into
pieces of one sign. Nothing is skipped, nothing stops before the end time.

Friction that sticks and flanks that are rigid and closed are constraints. The torques that can hold them together are
the products of each one's bounds, so one guard watches each direction in which as few as can would move; it is
negative where a torque along that direction exceeds what holds. What follows is the combination of modes, of all
elements at rest, in which no guard is about to turn negative: the Taylor series of its guards decide, term by term. A
touch of rigid flanks is an impulse across it, which closed rigid flanks pass on and friction does not.

A driveline that nothing holds rolls away. Its angles are then written as twists and one rigid-body angle on which
nothing depends, so that rounding does not grow with them.
"""

import re
from functools import cached_property
from itertools import combinations, groupby, pairwise, product
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import brentq

from helpers.configs import config_of, study_of
from helpers.elements import OPEN, STICK, Friction, Lash, Mode, Stages
from helpers.loads import PROFILES, Profile, lag, pulse, ramp, sine, smooth, step, table
from helpers.plant import CONTACTS, FITS, Plant, Shaft, boere

__all__ = [
    "CONTACTS", "PROFILES", "Friction", "Lash", "Mode", "Plant", "Profile", "Shaft", "Stages", "boere", "config_of",
    "lag", "pulse", "ramp", "sine", "smooth", "step", "study_of", "table",
]  # fmt: skip

ORDER = 10
BLOCK = 64  # cells sampled by one matrix product
CELL = 0.05  # of a cell: its length times the fastest mode's |λ|
LONGEST = 1e-3  # s, a cell where nothing swings
LOCKING = 1e-4
ROUNDING = 1e-13  # of the terms that add up to a guard or one of its derivatives
LEAST = 1e-17  # of what a guard changes by in a cell: less is rounding, and all that is left of a rate that was zero
SETTLING = 1e3  # times as much where elements settle
INSTANT = 1e-12  # s: events closer than this are at the same time


class Event(NamedTuple):
    """As it happens; the extremes are the acceleration's over the phase that follows, `modes` those of the elements.

    touch, separation, opening, rejoin and lock, with the flank for a side; stage, with the next stage's number; stick,
    and slip, with the direction in which the twist slides.
    """

    time: float
    kind: str
    side: int
    speed: float
    state: np.ndarray
    coordinates: np.ndarray  # of the state: those that the run is computed in
    largest: float
    smallest: float
    element: str
    modes: tuple


class Guard(NamedTuple):
    """A row that is positive in a regime, and what happens, to which element by its number, where it no longer is."""

    row: np.ndarray
    kind: str
    side: int
    successor: Mode | None
    element: int

    @property
    def settles(self):
        """Whether it turns negative at rest, and what follows depends on the other elements too."""
        return self.successor is None and self.kind != "touch"


class Regime:
    """One linear flow with the guards that end it; input `held` stays 1 exactly."""

    def __init__(self, generator, guards, acceleration, held):
        self.generator, self.guards, self.acceleration, self.held = generator, guards, acceleration, held
        self.guard_rows = np.array([guard.row for guard in guards]).reshape(-1, len(generator))
        fastest = np.max(np.abs(np.linalg.eigvals(generator)))
        self.cell = min(CELL / fastest, LONGEST) if fastest > 0.0 else LONGEST
        terms = [np.abs(self.guard_rows)]
        for k in range(1, ORDER + 1):
            terms.append(terms[-1] @ np.abs(generator) * (self.cell / k))
        self.sizes = np.array(terms)  # (ORDER + 1, guards, N)

    @cached_property
    def powers(self):
        """The state after 0 to BLOCK cells."""
        across = _exponential(self.generator * self.cell)
        across[self.held :, : self.held] = 0.0  # or it is off by some 1e-14 after a block
        across[self.held] = np.eye(len(across))[self.held]
        powers = [np.eye(len(across))]
        for _ in range(BLOCK):
            powers.append(across @ powers[-1])
        return np.array(powers)

    @cached_property
    def samples(self):
        """Guards and the acceleration after 0 to BLOCK cells, and their derivatives: (BLOCK + 1, rows, N) each."""
        rows = np.vstack((self.guard_rows, self.acceleration))
        return rows @ self.powers, rows @ self.generator @ self.powers

    def series(self, z, length):
        """The Taylor terms of z over a cell of this length, in units of it."""
        terms = [z]
        for k in range(1, ORDER + 1):
            terms.append(self.generator @ terms[-1] * length / k)
        return np.array(terms)

    def leading(self, z, length, settled):
        """Of each guard's Taylor series over a cell: its terms from the first on that is more than rounding.

        There is more of it in the guards of elements that have just settled, whose state has been put right. A guard
        that makes elements settle is judged so all the time: what is rounding to `_settled` must not end a phase.
        """
        terms = self.series(z, length) @ self.guard_rows.T
        scale = (length / self.cell) ** np.arange(ORDER + 1)
        looseness = [SETTLING if guard.settles or guard.element in settled else 1.0 for guard in self.guards]
        sizes = self.sizes @ np.abs(z)
        rounding = ROUNDING * sizes + LEAST * sizes.max(axis=0)
        sure = np.abs(terms) > rounding * np.outer(scale, looseness)
        first = np.where(sure.any(axis=0), np.argmax(sure, axis=0), ORDER + 1)
        return [terms[k:, j] for j, k in enumerate(first)]


def _exponential(matrix):
    """exp of a matrix whose eigenvalues are at most `CELL`, by its Taylor series.

    Small entries keep their digits beside large ones: seconds beside the square of a mode's rate. Those of scipy's
    `expm` do so up to version 1.17 only.
    """
    total = term = np.eye(len(matrix))
    for k in range(1, 25):
        term = term @ matrix / k
        total = total + term
    return total


def _value(coefficients, u):
    value = 0.0
    for coefficient in reversed(coefficients):
        value = value * u + coefficient
    return value


def _cuts(coefficients):
    """0, the polynomial's zeros between and 1: it has one between turning points, which are cuts of its derivative.

    Eigenvalues of a companion matrix would lose a zero where the highest terms are rounding.
    """
    if len(coefficients) < 2 or abs(coefficients[0]) > sum(map(abs, coefficients[1:])):  # of which none can be 0
        return [0.0, 1.0]
    turns = _cuts([k * coefficient for k, coefficient in enumerate(coefficients)][1:])
    values = [_value(coefficients, u) for u in turns]
    zeros = [u for u, value in zip(turns, values, strict=True) if value == 0.0 and 0.0 < u < 1.0]
    for (low, high), (one, other) in zip(pairwise(turns), pairwise(values), strict=True):
        if one * other < 0.0:
            zeros.append(brentq(lambda u: _value(coefficients, u), low, high, xtol=1e-15, rtol=1e-15))
    return [0.0, *sorted(zeros), 1.0]


def _first_negative(coefficients):
    """The first u of [0, 1] from which on the polynomial is negative, or None."""
    for low, high in pairwise(_cuts(coefficients)):
        if _value(coefficients, 0.5 * (low + high)) < 0.0:
            return low
    return None


def _extremes(coefficients, length):
    """Largest and smallest value of the polynomial on [0, length]."""
    slopes = [k * coefficient for k, coefficient in enumerate(coefficients)][1:]
    values = [_value(coefficients, u) for u in (length, *(u for u in _cuts(slopes) if u < length))]
    return max(values), min(values)


class Flow:
    """The regimes of a plant under each piece of its load, one for each combination of its elements' modes.

    The state is (y, y') with θ = basis y. Where rigid-body motions are free, the last of y are their angles, which no
    torque depends on, and the others are at right angles to them.
    """

    def __init__(self, plant):
        self.plant, self.n = plant, plant.n
        self.pieces, self.elements = plant.pieces, plant.elements
        motions = plant.rigid_motions
        self.free = motions.shape[1]
        self.basis = np.hstack((null_space(motions.T), motions)) if self.free else np.eye(plant.n)
        self.mobility = self.basis.T @ np.diag(1.0 / np.array(plant.inertias)) @ self.basis
        self.rows = np.array([self.row(element.row) for element in self.elements]).reshape(-1, self.n)
        self.damping, self.stiffness = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for twist, k, c in plant.joints():
            row = self.row(twist)
            self.stiffness += (0.0 if np.ndim(k) else k) * np.outer(row, row)
            self.damping += c * np.outer(row, row)
        self._known = {}

    def row(self, twist):
        """The row of a twist for y in place of θ; one that fits a rigid-body motion is exactly zero there."""
        row = twist @ self.basis
        for k in range(self.n - self.free, self.n):
            if abs(row[k]) <= FITS * np.linalg.norm(twist):
                row[k] = 0.0
        return row

    def coordinates(self, state):
        return (self.basis.T @ np.reshape(state, (2, self.n)).T).T.ravel()

    def state(self, coordinates):
        return (self.basis @ coordinates.reshape(2, self.n).T).T.ravel()

    def until(self, k):
        """The time at which piece `k` of the load ends."""
        return self.pieces[k + 1].begin if k + 1 < len(self.pieces) else np.inf

    def augmented(self, coordinates, k, time):
        """(y, y', 1, w) in piece `k` of the load."""
        return np.concatenate([coordinates, [1.0], self.pieces[k].inputs(time - self.pieces[k].begin)])

    def rate(self, element, z):
        return float(self.rows[element] @ z[self.n : 2 * self.n])

    def regime(self, k, modes):
        """The regime of these modes in piece `k` of the load."""
        key = complex(self.pieces[k].rate), modes
        if key not in self._known:
            self._known[key] = self._build(*key)
        return self._known[key]

    def _generator(self, rate, modes):
        """Of z' = M z, without what holds constraints."""
        n, damping, stiffness, constant = self.n, self.damping.copy(), self.stiffness.copy(), np.zeros(self.n)
        for element, row, mode in zip(self.elements, self.rows, modes, strict=True):
            k, c, offset = element.behaviour.law(mode)
            stiffness += k * np.outer(row, row)
            damping += c * np.outer(row, row)
            constant += offset * row
        matrix = np.zeros((2 * n + 5,) * 2)
        matrix[:n, n : 2 * n] = np.eye(n)
        matrix[n : 2 * n, :n] = -self.mobility @ stiffness
        matrix[n : 2 * n, n : 2 * n] = -self.mobility @ damping
        matrix[n : 2 * n, 2 * n] = self.mobility @ constant
        load = self.plant.load @ self.basis
        matrix[n : 2 * n, 2 * n + 1] = matrix[n : 2 * n, 2 * n + 3] = self.mobility @ load
        matrix[2 * n + 1, 2 * n + 2] = 1.0
        matrix[2 * n + 3 :, 2 * n + 3 :] = [[rate.real, -rate.imag], [rate.imag, rate.real]]
        return matrix

    def _build(self, rate, modes):
        n, matrix, guards = self.n, self._generator(rate, modes), []
        bounds = {
            k: limits
            for k, (element, mode) in enumerate(zip(self.elements, modes, strict=True))
            if (limits := element.behaviour.bounds(mode)) is not None
        }
        for k, (element, row, mode) in enumerate(zip(self.elements, self.rows, modes, strict=True)):
            for (of_twist, of_rate, constant), kind, side, successor in element.behaviour.limits(mode):
                weights = np.concatenate([of_twist * row, of_rate * row, [constant], np.zeros(4)])
                guards.append(Guard(weights, kind, side, successor, k))
        if bounds:
            constraints = self.rows[list(bounds)]
            yielding = self.mobility @ constraints.T
            # the torques that hold all of them; where they are not unique, any do, as guards only see their sums
            inverse = np.linalg.pinv(constraints @ yielding, rcond=FITS)
            holding = -inverse @ constraints @ matrix[n : 2 * n]
            terms = np.abs(inverse) @ np.abs(constraints) @ np.abs(matrix[n : 2 * n])
            holding[np.abs(holding) <= ROUNDING * terms] = 0.0  # what carries nothing stays as it is
            matrix[n : 2 * n] += yielding @ holding
            guards += self._giving_way(constraints, holding, bounds, modes)
        return Regime(matrix, guards, self.basis[self.plant.acceleration_of - 1] @ matrix[n : 2 * n], 2 * n)

    def _giving_way(self, constraints, holding, bounds, modes):
        """The guards of torques that hold constraints: in each direction, what can be held less what is."""
        for pattern in slip_patterns(constraints):
            for direction in (pattern, -pattern):
                most = sum(x * limits[int(x > 0.0)] for x, limits in zip(direction, bounds.values(), strict=True) if x)
                if most < np.inf:
                    row = -direction @ holding
                    row[2 * self.n] += most
                    element = next(k for k, x in zip(bounds, direction, strict=True) if x)
                    kind = "separation" if modes[element].name == "closed" else "slip"
                    yield Guard(row, kind, modes[element].side, None, element)


def slip_patterns(constraints):
    """The rates of constraints, up to a factor, in the motions in which as few of them as possible give way."""
    span, sizes, _ = np.linalg.svd(constraints, full_matrices=False)
    span = span[:, sizes > FITS * sizes[0]]
    rank, patterns = span.shape[1], {}
    for fixed in combinations(range(len(span)), rank - 1):
        _, sizes, directions = np.linalg.svd(span[list(fixed)])
        if rank > 1 and sizes[-1] < FITS:
            continue  # other constraints fix the same
        pattern = span @ directions[-1]
        pattern[np.abs(pattern) < FITS * np.abs(pattern).max()] = 0.0
        pattern /= pattern[np.argmax(np.abs(pattern) > 0.99 * np.abs(pattern).max())]
        patterns[tuple(np.round(pattern, 9))] = pattern
    return list(patterns.values())


def _struck(flow, modes, z, guard, fastest):
    """Modes and state after a touch of rigid flanks, and of all others within an INSTANT, with what they do.

    No closed or touching flank is passed, each touching one leaves at least restitution times as fast as it came, and
    an impulse acts only on those that leave no faster. Touches as slow as LOCKING says part nothing.
    """
    n, modes, touching, flanks = flow.n, list(modes), [], {}
    for k, (element, mode) in enumerate(zip(flow.elements, modes, strict=True)):
        lash = element.behaviour
        if not isinstance(lash, Lash) or not lash.rigid:
            continue
        rate = flow.rate(k, z)
        side = guard.side if k == guard.element else int(np.sign(rate))
        near = lash.backlash / 2 - side * (flow.rows[k] @ z[:n]) < INSTANT * abs(rate)
        if mode.name == "closed":
            flanks[k] = mode.side
        elif k == guard.element or (side and near):
            touching.append(k)
            flanks[k] = side
    numbers = list(flanks)
    into = flow.rows[numbers] * np.array([[flanks[k]] for k in numbers])
    speeds, mobility = into @ z[n : 2 * n], into @ flow.mobility @ into.T
    asked = np.zeros(len(numbers))  # change of speed
    for j, k in enumerate(numbers):
        if k in touching:
            fastest[k] = max(fastest.get(k, 0.0), speeds[j])
            restitution = flow.elements[k].behaviour.restitution
            rebounds = restitution * speeds[j] > LOCKING * fastest[k]
            asked[j] = (1.0 + restitution * rebounds) * speeds[j]
            modes[k] = OPEN if rebounds else Mode("closed", flanks[k])
    if any(speeds[numbers.index(k)] > LOCKING * fastest[k] for k in touching):
        impulses = _complementary(mobility, asked)
    else:
        impulses = np.linalg.lstsq(mobility, asked, rcond=FITS)[0]
    kick = -flow.mobility @ into.T @ impulses
    terms = np.abs(flow.mobility @ into.T) @ np.abs(impulses)  # of it: what is less than their rounding is none
    z = z.copy()
    z[n : 2 * n] += kick
    for j, k in enumerate(numbers):
        if impulses[j] == 0.0 and into[j] @ kick < -FITS * (np.abs(into[j]) @ np.abs(kick)):
            modes[k] = OPEN
    for k, element in enumerate(flow.elements):
        if isinstance(element.behaviour, Friction):
            rate = flow.rate(k, z)
            if abs(flow.rows[k] @ kick) > FITS * (np.abs(flow.rows[k]) @ terms) and rate:
                modes[k] = Mode("slip", int(np.sign(rate)))
    return tuple(modes), z, [("touch", flanks[k], k, flanks[k] * speeds[numbers.index(k)]) for k in touching]


def _complementary(matrix, least):
    """x ≥ 0 for which matrix x ≥ least, with equality where x > 0, by trying which are."""
    count, rounding = len(least), FITS * np.abs(least).max()
    for active in product((True, False), repeat=count):
        chosen, x = np.flatnonzero(active), np.zeros(count)
        x[chosen] = np.linalg.lstsq(matrix[np.ix_(chosen, chosen)], least[chosen], rcond=FITS)[0]
        if np.all(x * matrix.diagonal() >= -rounding) and np.all(matrix @ x >= least - rounding):
            return x
    raise RuntimeError("no impulses fit the touch")


def _settled(flow, piece, modes, z, at_rest):
    """The modes that follow of the elements at rest, and the state without rounding in their twist rates and gaps."""
    n, z = flow.n, _in_contact(flow, modes, z, at_rest)
    z[n : 2 * n] -= _least_change(flow, at_rest, flow.rows[at_rest] @ z[n : 2 * n])
    choices = [
        element.behaviour.alternatives(mode) if k in at_rest else (mode,)
        for k, (element, mode) in enumerate(zip(flow.elements, modes, strict=True))
    ]
    for combination in product(*choices):
        regime = flow.regime(piece, combination)
        series = zip(regime.guards, regime.leading(z, regime.cell, at_rest), strict=True)
        beginnings = [
            (terms[0] if terms.size else 0.0, combination[guard.element])
            for guard, terms in series
            if guard.element in at_rest
        ]
        if all(first > 0.0 or (first == 0.0 and mode.name != "slip") for first, mode in beginnings):
            return combination, z
    raise RuntimeError("no combination of modes is consistent")


def _in_contact(flow, modes, z, elements):
    """The state without the rounding that has moved the rigid flanks of those of these elements that are closed."""
    z = z.copy()
    closed = [k for k in elements if modes[k].name == "closed" and flow.elements[k].behaviour.rigid]
    flanks = [modes[k].side * flow.elements[k].behaviour.backlash / 2 for k in closed]
    z[: flow.n] -= _least_change(flow, closed, flow.rows[closed] @ z[: flow.n] - flanks)
    return z


def _least_change(flow, elements, twists):
    """The change of y, least by kinetic energy, that changes the twists of elements by as much."""
    rows = flow.rows[elements]
    yielding = flow.mobility @ rows.T
    return yielding @ np.linalg.pinv(rows @ yielding, rcond=FITS) @ twists


def _follow(flow, piece, modes, z, guard, fastest):
    """After a guard has turned negative: modes, state, (kind, side, element, twist rate) of events, what settled."""
    if guard.successor is not None:
        following = (*modes[: guard.element], guard.successor, *modes[guard.element + 1 :])
        return following, z, [(guard.kind, guard.side, guard.element, flow.rate(guard.element, z))], []
    before, happened, n = modes, [], flow.n
    moved = np.abs(z[n : 2 * n])  # a touch may stop all that moves
    if guard.kind == "touch":
        z = _in_contact(flow, modes, z, range(len(modes)))  # of which the touch may part some
        modes, z, happened = _struck(flow, modes, z, guard, fastest)
    regime = flow.regime(piece, modes)
    moved = moved + np.abs(z[n : 2 * n]) + regime.cell * np.abs(regime.generator[n : 2 * n] @ z)
    at_rest = []
    for k, (element, mode) in enumerate(zip(flow.elements, modes, strict=True)):
        held = element.behaviour.bounds(mode) is not None
        turning = mode.name == "slip" and abs(flow.rate(k, z)) <= INSTANT * (np.abs(flow.rows[k]) @ moved)
        if held or turning or (guard.kind == "stick" and k == guard.element):
            at_rest.append(k)
    if at_rest:
        modes, z = _settled(flow, piece, modes, z, at_rest)
    kinds = {"closed": "lock", "open": "separation"}
    for k, (old, new) in enumerate(zip(before, modes, strict=True)):
        if new != old:
            happened.append((kinds.get(new.name, new.name), new.side or old.side * (new == OPEN), k, flow.rate(k, z)))
    return modes, z, happened, at_rest


def _start(flow, plant, state, flank):
    """The modes in which a run starts from a state with all lashes in one mode."""
    n, modes = plant.n, []
    for element in flow.elements:
        twist, rate = element.row @ state[:n], element.row @ state[n:]
        match element.behaviour:
            case Lash():
                modes.append(flank)
            case Stages() as stages:
                modes.append(stages.mode_at(twist))
            case Friction():
                rests = abs(rate) <= INSTANT * (np.abs(element.row) @ np.abs(state[n:]))
                modes.append(STICK if rests else Mode("slip", int(np.sign(rate))))
    return tuple(modes)


def run(plant, end_time=2.0, state=None, flank=OPEN, max_events=5000):
    """Events from the load step on (event 0), and the state at the end time.

    From the steady motion before the load step, or from a state with all lashes open, or on one flank. Friction sticks
    at first where nothing moves; if it cannot hold, it slips at t = 0.
    """
    flow = Flow(plant)
    if state is None:
        carrying, state = plant.steady_motion(plant.before)
        modes = carrying[: len(plant.lashes)] + _start(flow, plant, state, OPEN)[len(plant.lashes) :]
    else:
        modes = _start(flow, plant, np.asarray(state, float), flank)
    motion, time, piece, fastest, settled, events = 2 * plant.n, 0.0, 0, {}, [], []
    z = flow.augmented(flow.coordinates(state), piece, time)
    begin = time, "load step", modes[0].side if plant.lashes else 0, 0.0, flow.state(z[:motion]), z[:motion]
    name = ""
    while len(events) < max_events:
        time, piece, guard, z, largest, smallest = _travel(flow, modes, z, time, piece, end_time, settled)
        events.append(Event(*begin, largest, smallest, name, modes))
        if guard is None:
            return events, flow.state(z[:motion])
        modes, z, happened, at_rest = _follow(flow, piece, modes, z, guard, fastest)
        settled = at_rest if time - begin[0] > INSTANT else [*settled, *at_rest]
        headers = [
            ((time, kind, side, speed, flow.state(z[:motion]), z[:motion]), flow.elements[k].name)
            for kind, side, k, speed in happened
        ]
        if not headers:
            raise RuntimeError(f"a guard is negative at {time} s, and all modes stay")
        for header, of in headers[:-1]:
            events.append(Event(*header, -np.inf, np.inf, of, modes))
        begin, name = headers[-1]
    raise RuntimeError("more events than allowed")


def _travel(flow, modes, z, time, piece, end_time, settled):
    """Through the pieces of the load until a guard turns negative, or to the end: time, piece, guard, state, extremes.

    The extremes of the acceleration take both limits where the load jumps; a state that lasts no time has none.
    """
    largest, smallest = -np.inf, np.inf
    while True:
        until = min(flow.until(piece), end_time)
        if until > time:
            duration, guard, z, high, low = _phase(flow.regime(piece, modes), z, until - time, settled)
            if guard is None or duration > INSTANT:
                largest, smallest = max(largest, high), min(smallest, low)
            if guard is not None:
                return time + duration, piece, guard, z, largest, smallest
            time, settled = until, []
        if until == end_time:
            return time, piece, None, z, largest, smallest
        piece += 1
        z = flow.augmented(z[: 2 * flow.n], piece, time)


def _phase(regime, z, remaining, settled):
    """Until the first guard turns negative, or for the remaining time: duration, guard, state, extremes."""
    duration, count = 0.0, len(regime.guards)
    largest, smallest = -np.inf, np.inf

    def located(z, length, first):
        series = regime.series(z, length)
        earliest, hit = 1.0, None
        leading = regime.leading(z, length, settled if first else [])
        for guard, coefficients in zip(regime.guards, leading, strict=True):
            u = _first_negative(coefficients.tolist())
            if u is not None and (hit is None or u < earliest):
                earliest, hit = u, guard
        high, low = _extremes((series @ regime.acceleration).tolist(), earliest)
        return earliest, hit, earliest ** np.arange(ORDER + 1) @ series, high, low

    while True:
        first = duration == 0.0
        whole = min(BLOCK, int((remaining - duration) / regime.cell))
        if whole == 0:  # the last, shorter cell
            length = remaining - duration
            u, hit, z, high, low = located(z, length, first)
            return duration + u * length, hit, z, max(largest, high), min(smallest, low)
        values, slopes = (sampled[: whole + 1] @ z for sampled in regime.samples)
        acceleration, jerk = values[:, -1], slopes[:, -1]
        suspect = np.any(values[1:, :count] < 0.0, axis=1)
        suspect |= np.any((slopes[:-1, :count] < 0.0) & (slopes[1:, :count] > 0.0), axis=1)
        suspect[0] |= first
        peaked = jerk[:-1] * jerk[1:] < 0.0
        for j in np.flatnonzero(suspect | peaked):
            at = regime.powers[j] @ z
            u, hit, end, high, low = located(at, regime.cell, first and j == 0)
            largest, smallest = max(largest, high), min(smallest, low)
            if hit is not None:
                largest = max(largest, np.max(acceleration[: j + 1]))
                smallest = min(smallest, np.min(acceleration[: j + 1]))
                return duration + (j + u) * regime.cell, hit, end, largest, smallest
        largest, smallest = max(largest, np.max(acceleration)), min(smallest, np.min(acceleration))
        z = regime.powers[whole] @ z
        duration += whole * regime.cell


def primary_impacts(events, sticking_time, lash=1):
    """Indices of a lash's touches on the other flank than the last one, or on the same one after it had stuck."""
    flank, touched, stuck = initial_flank(events, lash), -np.inf, False  # a preload has lasted for ever
    primaries = []
    for k, event in enumerate(events):
        if event.element != f"lash {lash}":
            continue
        if event.kind == "touch":
            if event.side != flank or stuck:
                primaries.append(k)
            flank, touched, stuck = event.side, event.time, False
        elif event.kind == "lock":
            touched = event.time
        elif event.kind == "separation":
            stuck = event.time - touched > sticking_time
    return primaries


def initial_flank(events, lash=1):
    """The flank that a lash is on before the load step, 0 for none."""
    return events[0].modes[lash - 1].side


def label(events, primaries, lash=1):
    """The label of a lash's primary impacts, for example DS(1)SS(1)."""
    letters = "".join("I" if events[k].side == initial_flank(events, lash) else "O" for k in primaries)
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
