"""What a sweep costs beside its runs: `python tests/benchmarks/scale.py 1e6 1e7` with a kernel that is empty.

Every tile is a copy of a real one, so that impacts, labels and the size of the file are those of the report's map.
Each size runs in a process of its own, in the directory that TMPDIR names.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from clunk.results import netcdf, store
from clunk.study.config import study_from_text
from clunk.study.designs import design_of
from clunk.study.study import Study, to_toml
from clunk.sweeping import cells, sweep as sweeping
from clunk.sweeping.parts import Parts, WorkingDirectory
from clunk.sweeping.reduction import Reduction

CONFIG = """
[driveline]
preset = "boere-2008"
[solver]
method = "exact"
[[sweep.axes]]
parameter = "load.ratio"
start = 0.0
stop = 10.0
count = {rows}
[[sweep.axes]]
parameter = "lash.backlash_deg"
start = 0.0
stop = 20.0
count = {columns}
"""
REAL = 1 << 16  # cells of the map that the tiles are copies of


class Stages:
    """Seconds of each stage, and the most memory by its end, without what the system can write out to files."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.memory: dict[str, int] = {}
        self._most = 0
        threading.Thread(target=self._look, daemon=True).start()

    def _look(self):
        while True:
            status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
            self._most = max(self._most, 1024 * int(status["RssAnon"].split()[0]))
            time.sleep(0.05)

    def watch(self, name, function):
        @functools.wraps(function)
        def watched(*arguments, **options):
            began = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began
                self.memory[name] = self._most

        return watched


@functools.cache
def real_tile(study_text: str) -> tuple[cells.Tile, np.ndarray]:
    """Some cells of a map, run once, and where the impacts of each begin."""
    grid = cells.Grid(study_from_text(study_text))
    numbers = np.arange(0, grid.design.cells, max(1, grid.design.cells // REAL))[:REAL]
    tile = RUN(grid, numbers, np.zeros(1, np.uint8))
    return tile, np.concatenate(([0], np.cumsum(tile.records["primary_impacts"], dtype=np.int64)))


RUN = cells.Grid.run


def empty_run(grid, wanted, _stop):
    """A stand-in for `Grid.run`: cells that have been run before."""
    real, first = real_tile(to_toml(grid.study))
    begin = int(wanted[0] * REAL // grid.design.cells) % max(1, real.cells.size - wanted.size)
    end = begin + wanted.size
    return cells.Tile(wanted, real.records[begin:end].copy(), real.details[first[begin] : first[end]].copy())


def study_of(count: float) -> Study:
    """The report's map with about so many cells."""
    rows = round(math.sqrt(count))
    return study_from_text(CONFIG.format(rows=rows, columns=round(count / rows)))


def measure(count: float) -> dict[str, object]:
    """One sweep with the empty kernel, from the first tile to the checked file."""
    study = study_of(count)
    stages = Stages()
    cells.Grid.run = stages.watch("tiles", empty_run)
    Reduction.add = stages.watch("reduction: tiles", Reduction.add)
    sweeping.regime_map = stages.watch("reduction: results", sweeping.regime_map)
    Parts.add = stages.watch("parts", Parts.add)
    with tempfile.TemporaryDirectory() as scratch, WorkingDirectory(Path(scratch) / "map.h5") as directory:
        results = stages.watch("sweep in all", sweeping.Job(study, directory=directory).run)()
        kept = sum(path.stat().st_size for path in directory.path.iterdir())
        stages.watch("file", store.write_results)(directory.target, results, directory.path)
        del results
        size = directory.target.stat().st_size
        directory.remove()
        try:
            stages.watch("info --check", netcdf.read)(directory.target)
        except netcdf.StoreError as error:
            print(error, file=sys.stderr)
    cells_run = design_of(study).cells
    return {
        "cells": cells_run,
        "seconds": stages.seconds,
        "memory": stages.memory,
        "parts": kept / cells_run,
        "file": size / cells_run,
    }


def main() -> None:
    """Print a table for each size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cells", nargs="*", type=float, default=[1e6])
    parser.add_argument("--quick", action="store_true", help="1e4 cells")
    parser.add_argument("--here", action="store_true", help="in this process, as JSON")
    options = parser.parse_args()
    sizes = [1e4] if options.quick else options.cells
    if options.here:
        print(json.dumps(measure(sizes[0])))
        return
    for count in sizes:
        done = subprocess.run(
            [sys.executable, __file__, "--here", str(count)], stdout=subprocess.PIPE, text=True, check=False
        )
        if done.returncode:
            sys.exit(f"{count:.0e} cells: ended with {done.returncode}")
        found = json.loads(done.stdout)
        print(f"{found['cells']:,} cells; parts {found['parts']:.0f} and file {found['file']:.0f} bytes a cell")
        print(f"{'':<20}{'s':>10}{'ns a cell':>12}{'GB at most by then':>21}")
        for name, seconds in found["seconds"].items():
            print(
                f"{name:<20}{seconds:>10.2f}{1e9 * seconds / found['cells']:>12.0f}{found['memory'][name] / 1e9:>21.2f}"
            )
        print()


if __name__ == "__main__":
    os.environ.setdefault("TMPDIR", ".")
    main()
