"""Every event of the 400 runs of `events_table` to 30 digits, by the modes of each regime.

Run by hand: python tests/benchmarks/reference_events.py [--digits 50] [--check] [--quick]

Writes `reference_events.npz`; about a minute on one core. `--check` computes without writing and prints how far the
stored table is from what was computed: with another number of digits this shows how many of them hold. `--quick`
checks every 40th run.

Between events x' = A x + b with constant b. With the eigenvectors of A, computed once to `digits` decimals, every
functional of x is g(t) = α + β t + Σ Re u_k exp(λ_k t); β belongs to the eigenvalue 0 of the open chain, that of its
drift. The inputs are clunk's float64 numbers, taken exactly; nothing else of clunk's is used.

No zero is skipped. With C = Σ |λ_k|³ |u_k|, which only falls, Taylor's formula gives on [0, Δ]

    g >= g₀ + g₁ Δ + min(g₂, 0) Δ²/2 - C Δ³/6  (concave in Δ: it holds all over [0, Δ] if it is positive at Δ)
    g' <= g₁ + max(g₂, 0) Δ + C Δ²/2

so that a step is either proved free of zeros, or proved to hold exactly one, or halved. That runs in double precision
with a margin above its rounding; the zero so bracketed is polished, and the state carried on, in mpmath. The
acceleration's extremes (Q_i) are stationary points found on a grid of 1/60 of the fastest period and polished in
double precision: an error ε of their time enters as ε² only.
"""

import argparse
import sys
import time as clock
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import events_table
import mpmath
import numpy as np
from events_table import END_TIME, EventTable
from mpmath import mp, mpc, mpf

from clunk.simulation.driveline import Driveline

TOUCH, SEPARATION = 1, 2
LONGEST = 0.02  # s, of a step
SHORTEST = 1e-9  # s: a step that cannot be decided at this length grazes
MARGIN = 1e-13  # of the sum of the terms' sizes, a hundred times the rounding of that sum
INITIAL, OPPOSITE = "I", "O"


@dataclass(frozen=True)
class Functional:
    """g(t) = α + β t + Σ Re u_k exp(λ_k t), in mpmath."""

    alpha: mpf
    beta: mpf
    u: list
    rates: list

    def at(self, t, order=0):
        """The derivative of this order at t."""
        terms = (u * rate**order * mpmath.exp(rate * t) for u, rate in zip(self.u, self.rates, strict=True))
        value = mpmath.fsum(term.real for term in terms)
        return value + (self.alpha + self.beta * t if order == 0 else self.beta if order == 1 else 0)

    @cached_property
    def rounded(self):
        """The same in double precision."""
        return Rounded(
            float(self.alpha),
            float(self.beta),
            np.array([complex(u) for u in self.u]),
            np.array([complex(rate) for rate in self.rates]),
        )

    def root(self, low, high):
        """The one zero in [low, high], to the working precision, by Newton's method held inside the bracket."""
        low, high = mpf(low), mpf(high)
        falling = self.at(high) < 0
        t = (low + high) / 2
        for _ in range(200):
            value = self.at(t)
            if (value < 0) == falling:
                high = t
            else:
                low = t
            step = value / self.at(t, 1)
            t -= step
            if not low <= t <= high:
                t, step = (low + high) / 2, high - low
            if abs(step) < mpf(10) ** (5 - mp.dps):
                return t
        raise RuntimeError("Newton's method did not converge")


@dataclass(frozen=True)
class Rounded:
    """The same in double precision: `values` at times, `first_fall` through zero, `extremes`."""

    alpha: float
    beta: float
    u: np.ndarray
    rates: np.ndarray

    def series(self, t):
        """Value, slope, curvature, the bound C of the third derivative, and the size of the terms at t."""
        terms = self.u * np.exp(self.rates * t)
        slopes = terms * self.rates
        curvatures = slopes * self.rates
        size = abs(self.alpha) + abs(self.beta * t) + np.sum(np.abs(terms))
        return (
            self.alpha + self.beta * t + np.sum(terms).real,
            self.beta + np.sum(slopes).real,
            np.sum(curvatures).real,
            np.sum(np.abs(curvatures * self.rates)),
            size,
        )

    def stays_positive(self):
        """Whether the modes, which decay, cannot reach from the rest value to zero."""
        return self.beta == 0.0 and self.alpha > 1.001 * np.sum(np.abs(self.u))

    def values(self, t, order=0):
        """Of the derivative of this order at times t, an array."""
        terms = (self.u * self.rates**order) @ np.exp(np.outer(self.rates, t))
        return terms.real + (self.alpha + self.beta * t if order == 0 else self.beta if order == 1 else 0.0)


def first_fall(functional, starts_at_zero, until):
    """A bracket of the first zero at which the functional falls in (0, until], or None.

    starts_at_zero : whether the functional is zero at 0, exactly, and about to rise.
    """
    g = functional.rounded
    t, step = 0.0, LONGEST
    value, slope, curvature, bound, size = g.series(0.0)
    if starts_at_zero:
        value = 0.0
        assert slope > 0.0, "a zero guard that does not rise"
    while t < until:
        step = min(2.0 * step, LONGEST, until - t)
        while True:
            least = value + slope * step + min(curvature, 0.0) * step**2 / 2 - bound * step**3 / 6
            margin = 1e-6 * slope * step if starts_at_zero and t == 0.0 else MARGIN * size
            if value >= 0.0 and least > margin:
                break  # no zero
            steepest = slope + max(curvature, 0.0) * step + bound * step**2 / 2
            if steepest < 0.0 and value > margin and g.series(t + step)[0] < -MARGIN * size:
                return t, t + step  # exactly one
            step /= 2.0
            if step < SHORTEST:
                raise RuntimeError(f"undecided at {t!r} s: value {value!r}, slope {slope!r}")
        t += step
        value, slope, curvature, bound, size = g.series(t)
        if g.stays_positive():
            return None
    return None


class Flow:
    """x' = A x + b T + c s in modal coordinates."""

    def __init__(self, rates, inputs, rows):
        size = rates.rows
        eigenvalues, right = mp.eig(rates)
        largest = max(abs(value) for value in eigenvalues)
        drift = [k for k in range(size) if abs(eigenvalues[k]) < largest * mpf(10) ** (-mp.dps // 2)]
        assert len(drift) <= 1, "a defective double zero has no modes"
        self.drift = drift[0] if drift else None
        self.residual = mpmath.mnorm(rates * right - right * mp.diag(eigenvalues), "inf") / largest
        self.rates = [mpc(0) if k == self.drift else eigenvalues[k] for k in range(size)]
        self.right, self.left = right, right**-1
        self.forcing = self.left * inputs
        self.rows = {name: row * right for name, row in rows.items()}

    def modes(self, x, load):
        """Modal coordinates: of each mode its rest value (the drift has none) and its distance from it; the drift."""
        z, forced = self.left * x, self.forcing * load
        rest = [mpc(0) if k == self.drift else -forced[k] / rate for k, rate in enumerate(self.rates)]
        return [z[k] - rest[k] for k in range(len(rest))], rest, mpc(0) if self.drift is None else forced[self.drift]

    def functional(self, name, modes, offset):
        """`offset` plus the row of this name times x, as a function of time."""
        away, rest, drift = modes
        row = self.rows[name]
        alpha = mpf(offset) + mpmath.fsum((row[k] * rest[k]).real for k in range(len(rest)))
        beta = mpf(0)
        u, rates = [], []
        for k, rate in enumerate(self.rates):
            if k == self.drift:
                alpha += (row[k] * away[k]).real
                beta = (row[k] * drift).real
            else:
                u.append(row[k] * away[k])
                rates.append(rate)
        return Functional(alpha, beta, u, rates)

    def state(self, modes, t):
        """x after the time t."""
        away, rest, drift = modes
        z = mp.matrix([rest[k] + away[k] * mpmath.exp(rate * t) for k, rate in enumerate(self.rates)])
        if self.drift is not None:
            z[self.drift] += drift * t
        return (self.right * z).apply(lambda entry: entry.real)


class Plant:
    """The report's driveline in mpmath, from clunk's float64 parameters taken exactly."""

    def __init__(self, study):
        driveline = Driveline.from_study(study)  # of which only the numbers of the config in rad, N m and s are used
        inertia = [mpf(value) for value in study.driveline.inertias]
        n = len(inertia)
        lash = self.incidence(study.lash.between, n)
        self.contact_stiffness = mpf(driveline.contact_stiffnesses[0])
        contact_damping = mpf(driveline.contact_dampings[0])
        stiffness, damping = mp.zeros(n), mp.zeros(n)
        for shaft in study.driveline.shafts:
            twist = self.incidence(shaft.between, n)
            stiffness += mpf(shaft.stiffness) * twist * twist.T
            damping += mpf(shaft.damping) * twist * twist.T
        self.closed_stiffness = stiffness + self.contact_stiffness * lash * lash.T
        closed_damping = damping + contact_damping * lash * lash.T
        self.n, self.lash = n, lash
        self.load = self.incidence((study.load.on, "ground"), n)
        reduced = 1 / mpmath.fsum(lash[k] ** 2 / inertia[k] for k in range(n))
        self.contact_period = 2 * mp.pi * mpmath.sqrt(reduced / self.contact_stiffness)
        loud = study.impacts.acceleration_of - 1
        self.acceleration_input = {}
        self.flows = {}
        for name, k, c in (("open", stiffness, damping), ("closed", self.closed_stiffness, closed_damping)):
            rates, inputs = mp.zeros(2 * n), mp.zeros(2 * n, 2)
            for i in range(n):
                rates[i, n + i] = mpf(1)
                inputs[n + i, 0] = self.load[i] / inertia[i]
                if name == "closed":
                    inputs[n + i, 1] = self.contact_stiffness * lash[i] / inertia[i]
                for j in range(n):
                    rates[n + i, j] = -k[i, j] / inertia[i]
                    rates[n + i, n + j] = -c[i, j] / inertia[i]
            gap, speed = mp.zeros(1, 2 * n), mp.zeros(1, 2 * n)
            for i in range(n):
                gap[i], speed[n + i] = lash[i], lash[i]
            rows = {"gap": gap, "speed": speed, "acceleration": rates[n + loud, :]}
            self.acceleration_input[name] = inputs[n + loud, :]
            self.flows[name] = Flow(rates, inputs, rows)

    @staticmethod
    def incidence(between, n):
        row = mp.zeros(n, 1)
        for end, sign in zip(between, (1, -1), strict=True):
            if end != "ground":
                row[end - 1] += sign
        return row

    def preload(self, torque, half_gap):
        """The side of the flank that carries the torque before the load step, and the equilibrium on it."""
        for side in (1, -1):
            forces = self.load * torque + self.lash * (self.contact_stiffness * side * half_gap)
            theta = mp.lu_solve(self.closed_stiffness, forces)
            if side * (self.lash.T * theta)[0] > half_gap:
                return side, mp.matrix([*theta, *([0] * self.n)])
        raise ValueError("no flank carries the torque")

    def run(self, before, after, half_gap):
        """(time, kind, side, speed, largest, smallest) of the load step, with kind 0, and of every event."""
        half_gap, after, end = mpf(half_gap), mpf(after), mpf(END_TIME)
        side, x = self.preload(mpf(before), half_gap)
        now, kind, flank, speed, zero = mpf(0), 0, side, mpf(0), None
        events = []
        while True:
            name = "closed" if side else "open"
            flow, load = self.flows[name], mp.matrix([after, side * half_gap])
            modes = flow.modes(x, load)
            watched = (side,) if side else (1, -1)
            sign = 1 if side else -1  # positive inside: side q - φ/2 in contact, φ/2 - side q in the gap
            found = None
            for candidate in watched:
                guard = scaled(flow.functional("gap", modes, 0), sign * candidate, -sign * half_gap)
                bracket = first_fall(guard, candidate == zero, float(end - now))
                if bracket is not None:
                    at = guard.root(*bracket)
                    if found is None or at < found[0]:
                        found = at, candidate
            duration = float(end - now) if found is None else float(found[0])
            offset = (self.acceleration_input[name] * load)[0]
            extremes = largest_and_smallest(flow.functional("acceleration", modes, offset).rounded, duration)
            events.append((now, kind, flank, speed, *extremes))
            if found is None or now + found[0] > end:
                return events
            at, flank = found
            now += at
            speed = flow.functional("speed", modes, 0).at(at)
            x = flow.state(modes, at)
            kind, side, zero = (SEPARATION, 0, flank) if side else (TOUCH, flank, flank)


def scaled(functional, factor, offset):
    """offset + factor g."""
    return Functional(
        offset + factor * functional.alpha,
        factor * functional.beta,
        [factor * u for u in functional.u],
        functional.rates,
    )


def largest_and_smallest(g, duration):
    """The extremes of the functional over [0, duration], both ends included."""
    spacing = 2.0 * np.pi / np.max(np.abs(g.rates)) / 60.0
    largest, smallest = -np.inf, np.inf
    t = 0.0
    while t < duration:
        ahead = g.u * np.exp(g.rates * t)
        if g.beta == 0.0 and g.alpha + np.sum(np.abs(ahead)) <= largest and g.alpha - np.sum(np.abs(ahead)) >= smallest:
            break  # it can only be smaller from here on
        times = np.linspace(t, min(t + 256 * spacing, duration), 257)
        values, jerks = g.values(times), g.values(times, 1)
        turning = np.flatnonzero(jerks[:-1] * jerks[1:] < 0.0)
        low, high = times[turning], times[turning + 1]
        rising = jerks[turning] > 0.0
        for _ in range(60):
            middle = 0.5 * (low + high)
            before = (g.values(middle, 1) > 0.0) == rising
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        values = np.concatenate([values, g.values(0.5 * (low + high))])
        largest, smallest = max(largest, values.max()), min(smallest, values.min())
        t = times[-1]
    return largest, smallest


def primaries(events, contact_period):
    """Indices of the touches on the other flank than the last one, or on the same one after it had stuck."""
    flank, touched, stuck, found = events[0][2], -mpf("inf"), False, []
    for k, (time, kind, side, *_) in enumerate(events):
        if kind == TOUCH:
            if side != flank or stuck:
                found.append(k)
            flank, touched = side, time
        elif kind == SEPARATION:
            stuck = time - touched > contact_period
    return found


def name_of(letters):
    """The label of the primaries' flanks: OI is a double-sided impact, I alone a single-sided one; no other occurs."""
    shorter, text = letters.replace("OI", "D"), ""
    if set(shorter) - set("DI"):
        raise ValueError(f"{letters} is neither DS nor SS")
    while shorter:
        rest = shorter.lstrip(shorter[0])
        text += f"{'DS' if shorter[0] == 'D' else 'SS'}({len(shorter) - len(rest)})"
        shorter = rest
    return text or "NI"


def compute(digits, every=1):
    """The table of the 400 runs, or of each so many-th."""
    mp.dps = digits
    study = events_table.study()
    plant = Plant(study)
    print({name: mpmath.nstr(flow.residual, 3) for name, flow in plant.flows.items()}, "residuals", file=sys.stderr)
    ratio, backlash_deg = (values[::every] for values in events_table.grid())
    first, rows, is_primary, severity, labels = [0], [], [], [], []
    for sigma, degrees in zip(ratio, backlash_deg, strict=True):
        static = study.load.static_torque
        events = plant.run(static * (1.0 + sigma), static, np.deg2rad(degrees) / 2)
        found = primaries(events, plant.contact_period)
        for begin, end in pairwise([*found, len(events)]):
            severity.append(max(e[4] for e in events[begin:end]) - min(e[5] for e in events[begin:end]))
        labels.append(name_of("".join(INITIAL if events[k][2] == events[0][2] else OPPOSITE for k in found)))
        is_primary += [k in found for k in range(1, len(events))]
        rows += events[1:]
        first.append(len(rows))
        if len(first) % 20 == 1:
            print(f"{len(first) - 1} of {ratio.size} runs, {clock.process_time():.0f} s", file=sys.stderr)
    times = np.array([float(row[0]) for row in rows])
    return EventTable(
        ratio=ratio,
        backlash_deg=backlash_deg,
        first=np.array(first),
        time=times,
        remainder=np.array([float(row[0] - mpf(at)) for row, at in zip(rows, times, strict=True)]),
        kind=np.array([row[1] for row in rows], np.int8),
        side=np.array([row[2] for row in rows], np.int8),
        speed=np.array([float(row[3]) for row in rows]),
        primary=np.array(is_primary),
        severity=np.array(severity),
        label=np.array(labels),
    )


def main():
    """Compute, and write or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--digits", type=int, default=50)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--quick", action="store_true", help="check every 40th run")
    options = parser.parse_args()
    every = 40 if options.quick else 1
    table = compute(options.digits, every)
    if not (options.check or options.quick):
        np.savez_compressed(events_table.PATH, **table._asdict())
        print(f"{table.time.size} events of {table.ratio.size} runs, {events_table.PATH.stat().st_size} bytes")
        return
    stored = events_table.read().every(every)
    for name in ("first", "kind", "side", "primary", "label"):
        print(f"{name}: {'equal' if np.array_equal(getattr(stored, name), getattr(table, name)) else 'DIFFERENT'}")
    apart = (table.time - stored.time) + (table.remainder - stored.remainder)
    print(f"times differ by at most {np.max(np.abs(apart)):.1e} s")
    for name in ("speed", "severity"):
        print(f"{name} differs by at most {np.max(np.abs(getattr(table, name) / getattr(stored, name) - 1)):.1e} of it")


if __name__ == "__main__":
    main()
