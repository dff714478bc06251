"""What a second lash costs: runs/s of the report's rig and of a car, with one lash and with two, by either method.

Run by hand: python tests/benchmarks/lashes.py [--repeats N] [--quick]

The rig's second lash is in the place of its second shaft, between flange and pinion. Medians of interleaved repeats, on
all cores.
"""

import argparse
import os
import statistics
import time
from pathlib import Path

from clunk.study.config import load_study, study_from_text
from clunk.study.designs import design_of
from clunk.study.study import Study
from clunk.sweeping import sweep as sweeping

CONFIGS = Path(__file__).parents[2] / "configs"
RIG_OF_TWO = """
[driveline]
preset = "boere-2008"
shafts = [
    { between = ["motor", "flange"], stiffness = 31.3, damping = 0.08 },
    { between = ["ring", "ground"], stiffness = 31.3, damping = 0.1 },
    { between = ["motor", "ground"], damping = 0.1 },
]
"""
LASH = """
[[lash]]
between = {}
backlash_deg = {}
radius = 0.08
contact = {{ stiffness = 4.092e5, damping = 94.0 }}
"""
AXIS = '[[sweep.axes]]\nparameter = "{}"\nstart = 0.0\nstop = {}\ncount = 3\n'
RIG_OF_TWO += LASH.format('["flange", "pinion"]', 3.0) + LASH.format('["pinion", "ring"]', 6.0)
RIG_OF_TWO += AXIS.format("load.ratio", 10.0) + AXIS.format("lash[2].backlash_deg", 20.0)


def studies(largest: int = 201) -> dict[tuple[str, str, int], Study]:
    """Each study, by its driveline, its method and the number of its lashes; axes have `largest` values at most."""
    sizes = {("rig", "exact"): 201, ("rig", "rk4"): 41, ("car", "exact"): 121, ("car", "rk4"): 5}
    cases = {}
    for (driveline, method), whole in sizes.items():
        count = min(whole, largest)
        settings = [f"solver.method = '{method}'", *(f"sweep.axes[{axis}].count = {count}" for axis in (1, 2))]
        if driveline == "rig":
            cases[driveline, method, 1] = load_study(CONFIGS / "figure_3_4.toml", settings)
            cases[driveline, method, 2] = study_from_text(RIG_OF_TWO, overrides=settings)
        else:
            cases[driveline, method, 1] = load_study(CONFIGS / "car_tip_out.toml", [*settings, "solver.step = 1e-5"])
            cases[driveline, method, 2] = load_study(CONFIGS / "two_lashes.toml", settings)
    return cases


def main(repeats: int, largest: int) -> None:
    """Print the table."""
    cases, cores = studies(largest), len(os.sched_getaffinity(0))
    touches = {case: touches_of(study) for case, study in cases.items()}
    seconds: dict[tuple[str, str, int], list[float]] = {case: [] for case in cases}
    for _ in range(repeats):
        for case, study in cases.items():
            began = time.perf_counter()
            sweeping.sweep(study, workers=cores)
            seconds[case].append(time.perf_counter() - began)
    print(f"{cores} cores")
    print(f"{'driveline':<10}{'method':<8}{'lashes':>6}{'runs':>8}{'touches/run':>13}{'runs/s':>10}{'of one lash':>13}")
    for case, study in cases.items():
        driveline, method, lashes = case
        pairs = zip(seconds[driveline, method, 1], seconds[case], strict=True)
        share = statistics.median(of_one / of_these for of_one, of_these in pairs)
        runs = design_of(study).cells
        speed = runs / statistics.median(seconds[case])
        print(f"{driveline:<10}{method:<8}{lashes:>6}{runs:>8}{touches[case]:>13.1f}{speed:>10.0f}{share:>13.2f}")


def touches_of(study: Study) -> float:
    """How often flanks touch in a run, on average; all kernels are compiled behind it."""
    return float(sweeping.sweep(study).touches.sum() / design_of(study).cells)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="one repeat on 3 x 3 cells")
    options = parser.parse_args()
    main(*((1, 3) if options.quick else (options.repeats, 201)))
