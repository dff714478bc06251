"""How much faster a map is with --refine: `python tests/benchmarks/refined.py [processes]`.

The report's map at 1001 x 1001 by the exact method. Dense and refined sweeps alternate: from Python without a file, in
processes whose first sweeps are over, and as commands from start to file, with the pictures after them.
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from scale import CONFIG

import clunk
from clunk.sweeping.engines import available_cores, cpu_model

ROUNDS = 3  # of a process
REFINED = 4  # sweeps a round, to one dense
CLUNK = [sys.executable, "-c", "from clunk.cli import main; main()"]


def main(processes: int) -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "map.toml"
        config.write_text(CONFIG.format(rows=1001, columns=1001))
        inside, outside = [], []
        for _ in range(processes):
            child = subprocess.run([sys.executable, __file__, "--child", config], capture_output=True, check=True)
            inside.append(json.loads(child.stdout))
            outside.append(commands(config))
    labels = "equal" if all(own["equal"] for own in inside) else "NOT equal"
    ran = f"{inside[0]['ran']:,} of 1,002,001 cells run"
    print(f"{cpu_model()}, {available_cores()} cores; {ran}, all labels {labels}")
    print(f"{'medians, and by process':<32}{'dense':>9}{'refined':>10}{'ratio':>8}")
    for name, rows in (("from Python, no file, s", inside), ("command to file, s", outside)):
        dense, refined = ([statistics.median(own[kind]) for own in rows] for kind in ("dense", "refined"))
        ratios = sorted(a / b for a, b in zip(dense, refined, strict=True))
        both = statistics.median(dense), statistics.median(refined)
        spread = f"({ratios[0]:.1f} to {ratios[-1]:.1f})"
        print(f"{name:<32}{both[0]:>9.2f}{both[1]:>10.3f}{both[0] / both[1]:>8.1f} {spread}")
    for kind in ("dense", "refined"):
        size, pictures = outside[0][f"{kind} MB"], statistics.median(own[f"{kind} pictures"] for own in outside)
        print(f"{kind}: file {size:.1f} MB, drawn in {pictures:.1f} s")


def child(config: str) -> None:
    """Print the seconds of sweeps in this process, as JSON."""
    study = clunk.load_study(config)
    dense, refined = clunk.sweep(study), clunk.sweep(study, refine=True)
    found = {
        "ran": int(np.count_nonzero(~refined.inferred)),
        "equal": bool(np.array_equal(dense.label_map, refined.label_map)),
        "dense": [],
        "refined": [],
    }
    del dense, refined
    for _ in range(ROUNDS):
        for kind in ["refined"] * REFINED + ["dense"]:
            began = time.perf_counter()
            clunk.sweep(study, refine=kind == "refined")
            found[kind].append(time.perf_counter() - began)
    print(json.dumps(found))


def commands(config: Path) -> dict[str, list[float] | float]:
    """Seconds of the commands, each kind once."""
    found: dict[str, list[float] | float] = {}
    for kind, options in (("dense", []), ("refined", ["--refine"])):
        file = config.with_name(f"{kind}.h5")
        file.unlink(missing_ok=True)
        found[kind] = [timed("sweep", config, "-o", file, *options)]
        found[f"{kind} pictures"] = timed("plot", file)
        found[f"{kind} MB"] = file.stat().st_size / 1e6
    return found


def timed(*arguments: object) -> float:
    """Seconds of a command."""
    began = time.perf_counter()
    subprocess.run([*CLUNK, *map(str, arguments)], capture_output=True, check=True)
    return time.perf_counter() - began


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(sys.argv[2])
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
