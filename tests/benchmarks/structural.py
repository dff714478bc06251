"""Runs that each have a driveline of their own: clunk beside heyoka, which takes stiffnesses and inertias at run time.

Run by hand: python tests/benchmarks/structural.py [--runs N] [--repeats N] [--quick]   (clunk's extra `bench`;
without heyoka clunk alone)

The report's driveline at its nominal load and backlash, 1.5 s after the load step. Of each run the contact's and the
first shaft's stiffness and the inertias of pinion and ring are drawn within 30 % of nominal. heyoka runs eight in the
lanes of one vector, as in `peer_heyoka`, with these four as parameters; its two cores are two processes. clunk's row is
a whole sweep of these points, with labels and severities, from their values on: drivelines are prepared in it.

Both are timed in interleaved repeats, by the clock and by the processor time that they take, which others on the
machine disturb less. Then the events of each run are compared: how many, of which kind and flank, and when.
"""

import argparse
import multiprocessing
import os
import statistics
import time
from array import array

import numpy as np
from llvmlite.binding import get_host_cpu_name

import clunk
from clunk.simulation import batches
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import run_load
from clunk.simulation.system import preload
from clunk.study.config import study_from_text
from clunk.study.designs import design_of_points
from clunk.study.parameters import nominal_value
from clunk.sweeping import sweep as sweeping
from clunk.sweeping.cells import Grid

try:
    import heyoka as hy
except ImportError:
    hy = None

END_TIME = 1.5  # s
LANES = 8
CORES = (1, 2)
TOLERANCE = 1e-9
CONFIG = f"""
[driveline]
preset = "boere-2008"
[solver]
method = "exact"
end_time = {END_TIME}
"""
DRAWN = (
    "lash.contact.stiffness",
    "driveline.inertias[3]",
    "driveline.inertias[4]",
    "driveline.shafts[1].stiffness",
)


def points(study: clunk.Study, runs: int) -> dict[str, np.ndarray]:
    """The values of the four parameters in each run."""
    random = np.random.default_rng(20)
    return {key: nominal_value(study, key) * random.uniform(0.7, 1.3, runs) for key in DRAWN}


def make(study: clunk.Study):
    """A function of points and states at the load step, (runs, 8), that gives each run's events by heyoka: (E, 2)."""
    line = Driveline.from_study(study)
    n, half_gap, torque = line.inertia.size, np.deg2rad(study.lashes[0].backlash_deg) / 2, study.load.static_torque
    angles = hy.make_vars(*(f"angle_{k}" for k in range(n)))
    speeds = hy.make_vars(*(f"speed_{k}" for k in range(n)))
    of_gap, of_speed, overlap, first_stiffness, *of_inertias = (hy.par[k] for k in range(4 + n))
    gap, gap_speed = (sum_of(line.lashes[0], coordinates) for coordinates in (angles, speeds))
    contact = of_gap * gap + of_speed * gap_speed - overlap
    torques = [
        (first_stiffness if k == 0 else hy.expression(line.shaft_stiffness[k])) * sum_of(row, angles)
        + hy.expression(line.shaft_damping[k]) * sum_of(row, speeds)
        for k, row in enumerate(line.shafts)
    ]
    system = list(zip(angles, speeds, strict=True))
    for k in range(n):
        terms = [-row[k] * twist for row, twist in zip(line.shafts, torques, strict=True) if row[k]]
        terms += [-line.lashes[0][k] * contact] if line.lashes[0][k] else []
        terms += [hy.expression(torque)] if line.load[k] else []
        system.append((speeds[k], of_inertias[k] * hy.sum(terms)))
    log, stiffness = [array("d") for _ in range(LANES)], np.zeros(LANES)
    damping, radius = line.contact_dampings[0], study.lashes[0].radius

    def on_flank(side: int):
        def callback(_, sign: int, lane: int) -> bool:
            log[lane].append(times[lane])
            if sign == side:
                log[lane].append(1.0 * side)
                parameters[:3, lane] = stiffness[lane], damping, side * stiffness[lane] * half_gap
            else:
                log[lane].append(2.0 * side)
                parameters[:3, lane] = 0.0
            return True

        return callback

    integrator = hy.taylor_adaptive_batch(
        system,
        np.zeros((2 * n, LANES)),
        pars=np.zeros((4 + n, LANES)),
        tol=TOLERANCE,
        compact_mode=False,
        fast_math=True,
        t_events=[
            hy.t_event_batch(gap - half_gap, callback=on_flank(1)),
            hy.t_event_batch(gap + half_gap, callback=on_flank(-1)),
        ],
    )
    state, parameters, times = integrator.state, integrator.pars, integrator.time

    def solve(values: dict[str, np.ndarray], states: np.ndarray) -> list[np.ndarray]:
        events = []
        for begin in range(0, len(states), LANES):
            batch = np.resize(np.arange(begin, min(begin + LANES, len(states))), LANES)
            integrator.set_time(0.0)
            integrator.reset_cooldowns()
            state[:] = states[batch].T
            contact_stiffness, third, fourth, shaft = (values[key][batch] for key in DRAWN)
            stiffness[:] = radius**2 * contact_stiffness
            side = np.sign(line.lashes[0] @ state[:n])
            parameters[:4] = stiffness, np.full(LANES, damping), side * stiffness * half_gap, shaft
            parameters[4:] = 1.0 / line.inertia[:, None]
            parameters[6], parameters[7] = 1.0 / third, 1.0 / fourth
            for lane in log:
                del lane[:]
            integrator.propagate_until(END_TIME)
            events += [np.array(lane).reshape(-1, 2) for lane in log[: len(states) - begin]]
        return events

    return solve


def sum_of(row: np.ndarray, coordinates: "list[hy.expression]") -> "hy.expression":
    """row · coordinates."""
    return hy.sum([weight * each for weight, each in zip(row, coordinates, strict=True) if weight])


def serve(pipe) -> None:
    """In a process: solve what comes; answers with events and processor time."""
    solve = make(study_from_text(CONFIG))
    pipe.send(None)
    while (work := pipe.recv()) is not None:
        began = time.process_time()
        events = solve(*work)
        pipe.send((events, time.process_time() - began))


def states_of(study: clunk.Study, values: dict[str, np.ndarray]) -> np.ndarray:
    """(runs, 8) the states at the load step."""
    columns = np.stack([values[key] for key in DRAWN], axis=-1)
    before, _ = run_load(study)
    states = np.empty((len(columns), 2 * len(study.driveline.inertias)))
    for positions, batch in batches.prepare_many(study, DRAWN, columns):
        for number, k in enumerate(positions):
            states[k] = preload(batch.at([number]).system, before).x
    return states


def main() -> None:
    """Time, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="one repeat of 64 runs")
    options = parser.parse_args()
    if options.quick:
        options.runs, options.repeats = 64, 1
    study = study_from_text(CONFIG)
    values = points(study, options.runs)
    states = states_of(study, values)
    context, peers = multiprocessing.get_context("spawn"), []
    for _ in range(max(CORES) if hy else 0):
        here, there = context.Pipe()
        context.Process(target=serve, args=(there,), daemon=True).start()
        here.recv()
        peers.append(here)
    of_heyoka: list[np.ndarray] = []
    rates: dict[tuple[str, int], list[tuple[float, float]]] = {}

    def by_clunk(cores: int) -> float:
        began = time.process_time()
        sweeping.sweep(study, design_of_points(study, values), workers=cores)
        return time.process_time() - began

    def by_heyoka(cores: int) -> float:
        shares = np.array_split(np.arange(options.runs), cores)
        for pipe, share in zip(peers, shares, strict=False):
            pipe.send(({key: column[share] for key, column in values.items()}, states[share]))
        answers = [pipe.recv() for pipe, _ in zip(peers, shares, strict=False)]
        of_heyoka[:] = [run for events, _ in answers for run in events]
        return sum(seconds for _, seconds in answers)

    by_clunk(1)
    for _ in range(options.repeats):
        for cores in CORES:
            for name, run in (("clunk", by_clunk), ("heyoka", by_heyoka))[: 2 if hy else 1]:
                began = time.perf_counter()
                busy = run(cores)
                rates.setdefault((name, cores), []).append((time.perf_counter() - began, busy))
    for pipe in peers:
        pipe.send(None)

    machine = f"{get_host_cpu_name()}, {len(os.sched_getaffinity(0))} cores"
    print(f"{machine}; {options.runs} runs, medians of {options.repeats}")
    print(f"{'':<8}{'cores':>6}{'runs/s':>10}{'runs/s of processor time':>26}")
    medians = {
        case: [options.runs / statistics.median(each) for each in zip(*seconds, strict=True)]
        for case, seconds in rates.items()
    }
    for (name, cores), (by_clock, by_processor) in sorted(medians.items()):
        print(f"{name:<8}{cores:>6}{by_clock:>10,.0f}{by_processor:>26,.0f}")
    if not hy:
        print("heyoka is not installed: clunk alone")
        return
    for cores in CORES:
        ratios = (one / other for one, other in zip(medians["clunk", cores], medians["heyoka", cores], strict=True))
        print(f"clunk / heyoka, {cores}: " + ", ".join(f"{ratio:.2f}" for ratio in ratios))

    _, logs = Grid(study, design_of_points(study, values)).logged(values, options.runs)
    unlike, error = 0, 0.0
    for log, run in zip(logs, of_heyoka, strict=True):
        events = log[1:][~np.isnan(log["time"][1:])]
        if np.array_equal(events["kind"] * events["side"], run[:, 1]):
            error = max(error, float(np.abs(events["time"] - run[:, 0]).max(initial=0.0)))
        else:
            unlike += 1
    total = sum(map(len, of_heyoka))
    print(f"{unlike} of {options.runs} runs have other events; of all {total}, times differ by {error:.0e} s at most")


if __name__ == "__main__":
    main()
