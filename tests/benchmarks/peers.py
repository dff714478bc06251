"""clunk beside the real alternatives: the same 400 runs on the same machine, and how far each one's events are off.

Run by hand: python tests/benchmarks/peers.py [--quick] [--repeats N]   (clunk's extra `bench`)

The runs are those of `events_table`: 20 x 20 cells, 1.5 s after the load step, every touch and separation located. One
row is a sweep of the same axes at 401 x 401 cells, as large as maps are: a sweep has milliseconds of its own, which
400 runs notice. heyoka is given the 400 runs ten times over at a time, since it has some of its own as well.

Each row is timed on one core and on two, in interleaved repeats, compilation before the clock starts; the table has the
medians, half the range of the repeats, and the ratio to heyoka's eight lanes. clunk's rows are whole calls of
`clunk.sweep` with as many threads as cores; the other rows are processes that already wait for work, timed until every
run's events are in this process. Errors are against the stored table of `reference_events.py`: the largest |time error|
of any event in the runs that have the right number of them, and how many runs have another number of events, or another
label.
"""

import argparse
import contextlib
import importlib
import multiprocessing
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import NamedTuple

import events_table
import figure
import numpy as np
from llvmlite.binding import get_host_cpu_name

import clunk
from clunk.core.events import EVENT
from clunk.core.sequence import COURSE, INITIAL, OPPOSITE, label, take_event
from clunk.simulation.driveline import Driveline
from clunk.study.designs import design_of
from clunk.study.study import replace_values
from clunk.sweeping import cells

CELLS = np.arange(events_table.RATIOS.size * events_table.BACKLASHES_DEG.size)
FINE = 401  # cells a side of the large sweep
CORES = (1, 2)
SAMPLE = CELLS[::7]  # of the rows that take half a minute for all: 58 runs from all over the map
YARDSTICK = "heyoka, tolerance 1e-9"
NOTES = """\
clunk's rows deliver label, Q, V and every primary impact of each cell, from all its events, and
stop a run when it is proved that nothing can follow; "full length" does not stop. The other rows
deliver time, kind and flank of every event and go to 1.5 s; their labels are made off the clock.
solve_ivp is timed on 58 of the 400 runs."""


@dataclass
class Row:
    """One line of the table.

    rates : cores -> runs/s, one for each repeat
    ready : float  [s], from nothing to the first run, with what it compiles
    """

    name: str
    ready: float = 0.0
    rates: dict[int, list[float]] = field(default_factory=lambda: {cores: [] for cores in CORES})
    time_error: float = float("nan")
    checked: int = 0
    wrong_events: int = 0
    wrong_labels: int = 0

    def rate(self, cores: int) -> float:
        """The median  [runs/s]."""
        return statistics.median(self.rates[cores])

    def spread(self, cores: int) -> float:
        """Half the range, as a share of the median."""
        return (max(self.rates[cores]) - min(self.rates[cores])) / 2 / self.rate(cores)


class Expected(NamedTuple):
    """The events of the 400 runs, with what double precision leaves of their times, and the labels."""

    events: list[np.ndarray]
    remainders: list[np.ndarray]
    labels: np.ndarray


class Clunk:
    """A method of clunk's, by the public sweep and, for the times of the events, by the public simulate."""

    def __init__(self, name: str, method: str, whole: bool = False, side: int = 0) -> None:
        self.row = Row(name)
        self.study = events_table.study(method)
        self.timed = events_table.study(method, finer(side)) if side else self.study
        self.whole = whole
        began = time.perf_counter()
        cells.warm_up(self.study)
        self.row.ready = time.perf_counter() - began
        self.work(1)

    def work(self, cores: int) -> tuple[int, float]:
        """Runs and seconds of one sweep."""
        return design_of(self.timed).cells, figure.timed(self.timed, cores, not self.whole)

    def check(self, all_cells: bool, expected: Expected) -> None:
        """Fill in the errors, of all runs or of a few."""
        results = clunk.sweep(self.study, boundaries=False)
        cells = CELLS if all_cells else SAMPLE
        labels = [results.labels[code] for code in results.sequence.flat[cells]]
        compare(self.row, cells, events_of(self.study, cells), labels, expected)

    def close(self) -> None:
        """Nothing is kept."""


def finer(side: int) -> tuple[np.ndarray, np.ndarray]:
    """The same axes, from end to end, in smaller steps: so many cells a side."""
    ratios, backlashes = events_table.RATIOS, events_table.BACKLASHES_DEG
    return np.linspace(ratios[0], ratios[-1], side), np.linspace(backlashes[0], backlashes[-1], side)


def events_of(study: clunk.Study, cells: np.ndarray = CELLS) -> list[np.ndarray]:
    """The events of some of the 400 runs by a method of clunk's: (E, 2) each, time [s] and kind times side."""
    events = []
    for sigma, degrees in zip(*(values[cells] for values in events_table.grid()), strict=True):
        cell = {"load.ratio": float(sigma), "lash.backlash_deg": float(degrees)}
        run = clunk.simulate(replace_values(study, cell)).events[1:]
        events.append(np.column_stack([run["time"], run["kind"] * run["side"]]))
    return events


def expected() -> Expected:
    """The stored table."""
    table, runs = events_table.read(), [events_table.read().of(cell) for cell in CELLS]
    kinds = table.kind.astype(np.float64) * table.side
    events = [np.column_stack([table.time[run], kinds[run]]) for run in runs]
    return Expected(events, [table.remainder[run] for run in runs], table.label)


class Peer:
    """Another package: a process for each core, that has made its solver and waits for cells."""

    def __init__(self, name: str, module: str, timed: np.ndarray, **options: object) -> None:
        self.row = Row(name)
        self.timed = timed
        importlib.import_module(module)  # ImportError here, not in a process
        context = multiprocessing.get_context("spawn")
        self.pipes, self.processes = [], []
        for _ in range(max(CORES)):
            here, there = context.Pipe()
            process = context.Process(target=serve, args=(there, module, options), daemon=True)
            process.start()
            self.pipes.append(here)
            self.processes.append(process)
        self.row.ready = max(pipe.recv() for pipe in self.pipes)

    def work(self, cores: int) -> tuple[int, float]:
        """Runs and seconds until their events are here."""
        began = time.perf_counter()
        self.solve(self.timed, cores)
        return self.timed.size, time.perf_counter() - began

    def solve(self, cells: np.ndarray, cores: int) -> list[np.ndarray]:
        """The events of each cell; eights of neighbours are dealt out in turn, so that all take equally long."""
        shares = [cells[np.arange(cells.size) // 8 % cores == k] for k in range(cores)]
        busy = [(pipe, part) for pipe, part in zip(self.pipes, shares, strict=False) if part.size]
        for pipe, part in busy:
            pipe.send(part)
        events = {}
        for pipe, part in busy:
            counts, flat = pipe.recv()
            events |= dict(zip(part.tolist(), np.split(flat, np.cumsum(counts)[:-1]), strict=True))
        return [events[cell] for cell in cells.tolist()]

    def check(self, all_cells: bool, expected: Expected) -> None:
        """Fill in the errors, of all runs or of those that are timed."""
        cells = CELLS if all_cells else np.unique(self.timed)
        found = self.solve(cells, max(CORES))
        driveline = Driveline.from_study(events_table.study())
        _, _, sides = events_table.preload(events_table.study(), driveline)
        labels = [
            label_of(run, int(side), driveline.contact_periods[0])
            for run, side in zip(found, sides[cells], strict=True)
        ]
        compare(self.row, cells, found, labels, expected)

    def close(self) -> None:
        """End its processes."""
        for pipe, process in zip(self.pipes, self.processes, strict=True):
            pipe.send(None)
            process.join()


def serve(pipe, module: str, options: dict) -> None:
    """In a process: solve what comes."""
    began = time.perf_counter()
    solve = importlib.import_module(module).make(**options)
    solve(CELLS[200:208] if module == "peer_heyoka" else CELLS[200:201])  # which compiles for eight
    pipe.send(time.perf_counter() - began)
    while (cells := pipe.recv()) is not None:
        found = solve(cells)
        pipe.send((np.array([len(run) for run in found]), np.concatenate(found)))


def label_of(run: np.ndarray, initial_side: int, sticking_time: float) -> str:
    """The label of a run's events, by clunk's rules."""
    events = np.zeros(len(run) + 1, EVENT)
    events["side"][0] = initial_side
    events["time"][1:], events["kind"][1:], events["side"][1:] = run[:, 0], np.abs(run[:, 1]), np.sign(run[:, 1])
    course = np.zeros(1, COURSE).view(np.recarray)[0]
    course.last_side, course.contact_began = initial_side, -np.inf
    primaries = [take_event(course, event, sticking_time) for event in events.view(np.recarray)]
    return label(np.where(events["side"][primaries] == initial_side, INITIAL, OPPOSITE))


def compare(row: Row, cells: np.ndarray, runs: list[np.ndarray], labels: list[str], expected: Expected) -> None:
    """Errors of these cells' runs."""
    errors = [0.0]
    for cell, run in zip(cells, runs, strict=True):
        events = expected.events[cell]
        if not np.array_equal(run[:, 1], events[:, 1]):
            row.wrong_events += 1
        else:
            errors += np.abs(run[:, 0] - events[:, 0] - expected.remainders[cell]).tolist()
    row.time_error = max(errors)
    row.checked = cells.size
    row.wrong_labels = int(np.count_nonzero(np.array(labels) != expected.labels[cells]))


def contestants(quick: bool = False) -> dict[str, Callable[[str], Clunk | Peer]]:
    """What makes each row, by its name."""

    def heyoka(tolerance: float) -> Callable[[str], Peer]:
        return lambda name: Peer(name, "peer_heyoka", np.tile(CELLS, 10), tolerance=tolerance)

    def solve_ivp(**options: object) -> Callable[[str], Peer]:
        return lambda name: Peer(name, "peer_scipy", SAMPLE[:1] if quick else SAMPLE, **options)

    side = 101 if quick else FINE
    tight = {
        "solve_ivp RK45, 1e-6": solve_ivp(method="RK45", rtol=1e-6, atol=1e-9, first_step=1e-6),
        "solve_ivp DOP853, 1e-9": solve_ivp(method="DOP853", rtol=1e-9, atol=1e-12, first_step=1e-6),
    }
    return {
        YARDSTICK: heyoka(1e-9),
        "heyoka, tolerance 1e-12": heyoka(1e-12),
        "clunk exact": lambda name: Clunk(name, "exact"),
        f"clunk exact, {side} x {side}": lambda name: Clunk(name, "exact", side=side),
        "clunk rk4": lambda name: Clunk(name, "rk4"),
        "clunk rk4, full length": lambda name: Clunk(name, "rk4", whole=True),
        **({} if quick else tight),
        "solve_ivp, its defaults": solve_ivp(),
    }


def main() -> None:
    """Time, check, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--quick", action="store_true", help="one short repeat of small maps, one run by solve_ivp")
    options = parser.parse_args()
    repeats, at_least = (1, 0.0) if options.quick else (options.repeats, 0.5)
    rows = []
    with contextlib.ExitStack() as stack:
        for name, make in contestants(options.quick).items():
            try:
                rows.append(make(name))
            except ImportError as error:
                print(f"{name}: skipped, {error}", file=sys.stderr)
            else:
                stack.callback(rows[-1].close)
        for repeat in range(repeats):
            for contestant in rows:
                for cores in CORES:
                    contestant.row.rates[cores].append(rate(contestant, cores, at_least))
            print(f"repeat {repeat + 1} of {repeats}", file=sys.stderr)
        table = expected()
        for contestant in rows:
            contestant.check(not options.quick, table)
    machine = f"{get_host_cpu_name()}, {len(os.sched_getaffinity(0))} cores"
    report([contestant.row for contestant in rows], machine, repeats)


def rate(contestant: Clunk | Peer, cores: int, at_least: float) -> float:
    """Runs/s over at least so many seconds."""
    runs, seconds = 0, 0.0
    while runs == 0 or seconds < at_least:
        more, took = contestant.work(cores)
        runs, seconds = runs + more, seconds + took
    return runs / seconds


def report(table: list[Row], machine: str, repeats: int) -> None:
    """The table for people."""
    packages = ", ".join(f"{name} {version(name)}" for name in installed("heyoka", "scipy", "numba", "numpy"))
    print(f"{machine}; medians of {repeats}; {packages}")
    yardstick = next((row for row in table if row.name == YARDSTICK), None)
    print(f"{'':<24}{'1 core':>10}{'':>6}{'of':>8}{'2 cores':>10}{'':>6}{'of':>8}{'time':>8}{'wrong':>8}{'wrong':>8}")
    print(f"{'':<24}", *(f"{'runs/s':>10}{'+-':>6}{'heyoka':>8}" for _ in CORES), sep="", end="")
    print(f"{'error':>8}{'events':>8}{'labels':>8}")
    for row in table:
        speeds = ""
        for cores in CORES:
            share = f"{row.rate(cores) / yardstick.rate(cores):.2g}" if yardstick else ""
            speeds += f"{row.rate(cores):>10,.0f}{row.spread(cores):>6.0%}{share:>8}"
        wrong = f"{row.wrong_events:>8}{row.wrong_labels:>8}" + (
            f" of {row.checked}" if row.checked < CELLS.size else ""
        )
        print(f"{row.name:<24}{speeds}{row.time_error:>8.0e}{wrong}")
    print(f"{NOTES}\nSeconds to the first run, not counted: ", end="")
    print(", ".join(f"{row.name} {row.ready:.1f}" for row in table) + ".")


def installed(*names: str) -> Iterator[str]:
    """Those of these packages that are installed."""
    for name in names:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            version(name)
            yield name


if __name__ == "__main__":
    main()
