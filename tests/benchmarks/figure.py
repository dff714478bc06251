"""How fast the report's figure is computed: the 201 x 201 map at h = 1e-4 s to 2.0 s, labels and severity.

Run by hand: python tests/benchmarks/figure.py [--repeats N] [--quick]

Prints runs/s and ns per step per core, as medians of interleaved repeats: runs that stop when nothing can
follow and runs of full length, on one thread and on all cores.
"""

import argparse
import os
import platform
import statistics
import time
from pathlib import Path

import numpy as np

from clunk.simulation import batches
from clunk.study.config import load_study
from clunk.study.designs import design_of
from clunk.study.study import Study
from clunk.sweeping import sweep as sweeping

FIGURE = Path(__file__).parents[2] / "configs" / "figure_3_4.toml"
STEPS = 20_000  # of a full-length run


def report_map(count: int) -> Study:
    """The sweep of Figure 3.4 with so many values an axis."""
    counts = [f"sweep.axes[{axis}].count={count}" for axis in (1, 2)]
    return load_study(FIGURE, counts)


def main(repeats: int, count: int) -> None:
    """Print the table, of a map of count x count cells."""
    study = report_map(count)
    cells = design_of(study).cells
    sweeping.sweep(report_map(3))  # compile
    cores = len(os.sched_getaffinity(0))
    cases = [(early, workers) for early in (True, False) for workers in sorted({1, cores})]
    seconds: dict[tuple[bool, int], list[float]] = {case: [] for case in cases}
    for _ in range(repeats):
        for early, workers in cases:
            seconds[early, workers].append(timed(study, workers, early))
    print(f"{platform.processor() or platform.machine()}, {cores} cores; {cells} runs of 2.0 s at h = 1e-4 s")
    print(f"{'runs':<24}{'threads':>8}{'seconds':>9}{'runs/s':>9}{'us/run/core':>13}{'ns/step/core':>14}")
    for early, workers in cases:
        median = statistics.median(seconds[early, workers])
        each = median * workers / cells
        name = "stopped when complete" if early else "full length"
        per_step = "" if early else f"{each / STEPS * 1e9:14.1f}"
        print(f"{name:<24}{workers:>8}{median:>9.2f}{cells / median:>9.0f}{each * 1e6:>13.1f}{per_step}")


def timed(study, workers: int, early: bool) -> float:
    """Seconds of one sweep; without `early` no flow bounds all that follows, so that each run goes to its end."""
    build_steps = batches.build_steps

    def unproved(*driveline):
        system, steps = build_steps(*driveline)
        return system, steps._replace(settles=np.zeros_like(steps.settles))

    batches.prepare_one.cache_clear()
    if not early:
        batches.build_steps = unproved
    try:
        began = time.perf_counter()
        sweeping.sweep(study, workers=workers)
        return time.perf_counter() - began
    finally:
        batches.build_steps = build_steps
        batches.prepare_one.cache_clear()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="one repeat on 21 x 21 cells")
    options = parser.parse_args()
    main(*((1, 21) if options.quick else (options.repeats, 201)))
