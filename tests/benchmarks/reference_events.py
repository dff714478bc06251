"""Every event of the 400 runs of `events_table` to 30 digits, by the modes of each regime.

Run by hand: python tests/benchmarks/reference_events.py [--digits 50] [--check] [--quick]

Writes `reference_events.npz`; about a minute on one core. `--check` computes without writing and prints how far the
stored table is from what was computed: with another number of digits this shows how many of them hold. `--quick`
checks every 40th run.

Which events there are, and the peaks of the acceleration (Q_i), are those of the tests' independent reference,
`helpers.reference`, which skips none. Its event times, good to some 1e-12 s, are where Newton's method begins here.
Between events x' = A x + b with constant b. With the eigenvectors of A, computed once to `digits` decimals, every
functional of x is g(t) = α + β t + Σ Re u_k exp(λ_k t); β belongs to the eigenvalue 0 of the open chain, that of its
drift. The inputs are clunk's float64 numbers, taken exactly; nothing else of clunk's is used.
"""

import argparse
import sys
import time as clock
from dataclasses import dataclass
from pathlib import Path

import events_table
import mpmath
import numpy as np
from events_table import END_TIME, EventTable
from mpmath import mp, mpc, mpf

from clunk.simulation.driveline import Driveline

KINDS = {"touch": 1, "separation": 2}


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

    def zero(self, near):
        """The zero at a time that is known to double precision, to the working precision by Newton's method."""
        t = near
        for _ in range(20):
            step = self.at(t) / self.at(t, 1)
            t -= step
            if abs(t - near) > 1e-9:
                break
            if abs(step) < mpf(10) ** (5 - mp.dps):
                return t
        raise RuntimeError("Newton's method did not converge")


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
            self.flows[name] = Flow(rates, inputs, {"gap": gap, "speed": speed})

    @staticmethod
    def incidence(between, n):
        row = mp.zeros(n, 1)
        for end, sign in zip(between, (1, -1), strict=True):
            if end != "ground":
                row[end - 1] += sign
        return row

    def preload(self, torque, side, half_gap):
        """The equilibrium on a flank before the load step."""
        forces = self.load * torque + self.lash * (self.contact_stiffness * side * half_gap)
        return mp.matrix([*mp.lu_solve(self.closed_stiffness, forces), *([0] * self.n)])

    def run(self, before, after, half_gap, events):
        """(time, speed) of every event of the reference after the load step."""
        half_gap, after, now = mpf(half_gap), mpf(after), mpf(0)
        side = events[0].side
        x = self.preload(mpf(before), side, half_gap)
        for event in events[1:]:
            flow = self.flows["closed" if side else "open"]
            modes = flow.modes(x, mp.matrix([after, side * half_gap]))
            at = flow.functional("gap", modes, -event.side * half_gap).zero(mpf(event.time) - now)
            now += at
            yield now, flow.functional("speed", modes, 0).at(at)
            x, side = flow.state(modes, at), event.side if event.kind == "touch" else 0


def compute(digits, every=1):
    """The table of the 400 runs, or of each so many-th."""
    sys.path.append(str(Path(__file__).parents[1]))
    from helpers import reference

    mp.dps = digits
    study = events_table.study()
    plant, static = Plant(study), study.load.static_torque
    print({name: mpmath.nstr(flow.residual, 3) for name, flow in plant.flows.items()}, "residuals", file=sys.stderr)
    ratio, backlash_deg = (values[::every] for values in events_table.grid())
    first, happened, rows, is_primary, severity, labels = [0], [], [], [], [], []
    for sigma, degrees in zip(ratio, backlash_deg, strict=True):
        driveline = reference.boere(sigma, degrees)
        events, _ = reference.run(driveline, END_TIME)
        found = reference.primary_impacts(events, driveline.contact_period())
        severity += reference.severities(events, found).tolist()
        labels.append(reference.label(events, found))
        is_primary += [k in found for k in range(1, len(events))]
        happened += events[1:]
        rows += plant.run(static * (1.0 + sigma), static, np.deg2rad(degrees) / 2, events)
        first.append(len(rows))
        if len(first) % 20 == 1:
            print(f"{len(first) - 1} of {ratio.size} runs, {clock.process_time():.0f} s", file=sys.stderr)
    times = np.array([float(time) for time, _ in rows])
    return EventTable(
        ratio=ratio,
        backlash_deg=backlash_deg,
        first=np.array(first),
        time=times,
        remainder=np.array([float(exact - mpf(at)) for (exact, _), at in zip(rows, times, strict=True)]),
        kind=np.array([KINDS[event.kind] for event in happened], np.int8),
        side=np.array([event.side for event in happened], np.int8),
        speed=np.array([float(speed) for _, speed in rows]),
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
