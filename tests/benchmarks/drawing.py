"""What pictures of maps cost beside imports: processor time to draw and to save, the whole command, and memory.

Run by hand: python tests/benchmarks/drawing.py [--quick]

Each map is swept by the exact method first, which is not counted; each picture is drawn in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CONFIGS = Path(__file__).parents[2] / "configs"
MAPS = {  # name -> config, options of `clunk sweep` beside the exact method, and the quantities drawn
    "figure 3.4, 201 x 201, lines": ("figure_3_4", [], ["regimes", "severity", "double_sided_impacts"]),
    "figure 3.4, 201 x 201, cells": ("figure_3_4", ["--no-boundaries"], ["regimes"]),
    "figure 3.4, 2001 x 2001, cells": ("figure_3_4", ["count=2001", "--no-boundaries"], ["regimes", "severity"]),
    "two lashes, 121 x 156, lines": ("two_lashes", [], ["regimes"]),
    "two lashes, 121 x 156, cells": ("two_lashes", ["--no-boundaries"], ["regimes"]),
    "car, 121 x 156, lines": ("car_tip_out", [], ["regimes"]),
    "car, 121 x 156, cells": ("car_tip_out", ["--no-boundaries"], ["regimes"]),
}
QUICK = {"smoke": ("smoke", [], ["regimes"])}


def swept(config: str, options: list[str], directory: Path) -> Path:
    """A results file of a config, with other counts of its axes where the options say so."""
    text = (CONFIGS / f"{config}.toml").read_text("utf-8")
    changes = dict(option.split("=") for option in options if "=" in option)
    if count := changes.get("count"):
        text = "\n".join(f"count = {count}" if line.startswith("count =") else line for line in text.splitlines())
    source, target = directory / f"{config}.toml", directory / "map.h5"
    source.write_text(text, "utf-8")
    flags = [option for option in options if "=" not in option]
    command = [sys.executable, "-m", "clunk", "sweep", source, "-o", target, "--force", *flags]
    subprocess.run([*command, "--set", "solver.method=exact"], check=True, capture_output=True)
    return target


def draw(path: Path, quantity: str) -> dict[str, float]:
    """Seconds of processor time to draw and to save one picture, and the most memory by then  [s, MiB]."""
    from clunk import plot
    from clunk.analysis.marks import thresholds_of
    from clunk.plot import maps  # noqa: F401  what is imported is not counted
    from clunk.results.store import read_map

    results = read_map(path)
    part = results.at_lash(results.lash_names[0])
    thresholds = thresholds_of(part)
    times = [time.process_time()]
    figure = plot.draw(part, quantity, thresholds)
    times.append(time.process_time())
    plot.save(figure, path.with_suffix(".png"))
    times.append(time.process_time())
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    size = path.with_suffix(".png").stat().st_size / 1024.0
    return {"draw": times[1] - times[0], "save": times[2] - times[1], "memory": memory, "file": size}


def command_seconds(path: Path, quantity: str) -> float:
    """Processor time of the whole command  [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "clunk", "plot", path, "--quantity", quantity, "-o", path.with_suffix(".png")]
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a map of 21 x 21 cells")
    parser.add_argument("--draw", nargs=2, metavar=("FILE", "QUANTITY"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.draw:
        print(json.dumps(draw(Path(options.draw[0]), options.draw[1])))
        return
    print("| map | picture | draw [s] | save [s] | whole command [s] | memory [MiB] | file [KiB] |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, (config, flags, quantities) in (QUICK if options.quick else MAPS).items():
        with tempfile.TemporaryDirectory() as directory:
            path = swept(config, flags, Path(directory))
            for quantity in quantities:
                again = [sys.executable, __file__, "--draw", str(path), quantity]
                told = json.loads(subprocess.run(again, check=True, capture_output=True, text=True).stdout)
                seconds = command_seconds(path, quantity)
                figures = f"{told['draw']:.2f} | {told['save']:.2f} | {seconds:.2f} | {told['memory']:.0f}"
                print(f"| {name} | {quantity} | {figures} | {told['file']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
