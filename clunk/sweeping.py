"""A sweep: axes -> tiles -> Results.

The grid is cut into tiles of consecutive cells; a jitted kernel without the interpreter lock runs each on a pool of
threads. A cell's result depends on nothing but its parameters, so neither the cut nor the number of threads can change
a bit of it.
"""

import math
import os
import platform
import threading
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
import numpy.typing as npt

import clunk
from clunk import driveline
from clunk.config import Study, digest, quantity, replace_values, to_toml
from clunk.core import tile
from clunk.core.regimes import System, stack
from clunk.core.sequence import OPPOSITE, label
from clunk.core.status import Status
from clunk.load import load_step
from clunk.results import CELL_FIELDS, FAILED_CODE, IMPACT_FIELDS, ResultAxis, Results

FloatArray = npt.NDArray[np.float64]

# Parameters that only change what drives a system, not the system: these fly.
_DRIVING = {
    "load.ratio",
    "load.static_torque",
    "load.initial_torque",
    "load.final_torque",
    "load.step_time",
    "lash.backlash_deg",
}
_TILE_CELLS = 512  # 0.1 s of the report's driveline: progress is smooth, overhead small
_KEPT_SYSTEMS = 4096  # about 10 KB each
_BYTES_PER_CELL = 400  # the most that a cell's results, their assembly and writing take


class SweepError(Exception):
    """A sweep that cannot start; its text is one sentence for the user."""


@dataclass(frozen=True)
class Tile:
    """Consecutive cells `start` to `stop` of the grid in C order."""

    start: int
    stop: int


def sweep(
    study: Study,
    *,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Results:
    """Run the grid of a study.

    Parameters
    ----------
    study : Study
        With at least one axis.
    workers : int, optional
        Threads; by default one for each core that this process may use.
    progress : callable(done, total), optional
        Called in this thread with the number of cells after each finished tile.

    Raises
    ------
    SweepError
        Where there is nothing to sweep, the grid does not fit in memory, or no cell of it could run.
    KeyboardInterrupt
        Passed on after the running cells have been abandoned.
    """
    if study.sweep is None:
        raise SweepError("There is nothing to sweep: the config has no [[sweep.axes]].")
    if workers is not None and workers < 1:
        raise SweepError(f"A sweep needs at least one worker, not {workers}.")
    grid = _Grid(study)
    _refuse_if_too_large(grid)
    if not grid.structural:
        status = Status(grid.system(()).status)
        if status != Status.OK:
            raise SweepError(f"No cell can run: {status.sentence}.")
    assembly = _Assembly(grid)
    workers = workers or _available_cores()
    with closing(_run_tiles(grid, workers)) as finished_tiles:  # an interrupt anywhere abandons the running cells
        for finished in finished_tiles:
            assembly.add(finished)
            if progress is not None:
                progress(assembly.done, grid.cells)
    return assembly.results()


def cell_count(study: Study) -> int:
    """How many cells the grid of a study has; 0 without axes."""
    return 0 if study.sweep is None else math.prod(axis.count_of_values for axis in study.sweep.axes)


def unused_axes(study: Study) -> list[str]:
    """The swept keys that change nothing in the study's contact model."""
    contact, swept = study.lash.contact, study.sweep.axes if study.sweep else ()
    if contact.model == "restitution":
        unused = {"lash.contact.stiffness", "lash.contact.damping", "impacts.sticking_time", "impacts.acceleration_of"}
    else:
        unused = {"lash.contact.restitution", "lash.contact.locking_speed"}
    return [axis.parameter for axis in swept if axis.parameter in unused | {"load.step_time"}]


def warm_up(study: Study) -> None:
    """Compile the kernel, or load it: what a first call of it would otherwise do in the middle of a sweep."""
    nothing = np.zeros(0)
    systems = stack([driveline.build(study)])
    cells, impacts, stop = np.zeros(0, tile.CELL), np.zeros(0, tile.IMPACT), np.zeros(1, np.uint8)
    tile.run_tile(systems, np.zeros(0, np.int64), nothing, nothing, nothing, 0, 1, cells, impacts, stop)


@dataclass
class _Finished:
    tile: Tile
    cells: npt.NDArray[np.void]
    impacts: list[npt.NDArray[np.void]]


class _Grid:
    """The cells of a study: each one's system, torques and gap."""

    def __init__(self, study: Study) -> None:
        assert study.sweep is not None
        self.study = study
        self.axes = study.sweep.axes
        self.shape = tuple(axis.count_of_values for axis in self.axes)
        self.cells = math.prod(self.shape)
        self.structural = [k for k, axis in enumerate(self.axes) if axis.parameter not in _DRIVING]
        self._kept: OrderedDict[tuple[int, ...], System] = OrderedDict()
        self._lock = threading.Lock()

    def system(self, at: tuple[int, ...]) -> System:
        """The system at these positions on the structural axes; kept, since neighbouring tiles share systems."""
        with self._lock:
            found = self._kept.get(at)
            if found is not None:
                self._kept.move_to_end(at)
                return found
        values = {
            self.axes[axis].parameter: float(self.axes[axis].grid[position])
            for axis, position in zip(self.structural, at, strict=True)
        }
        system = driveline.build(replace_values(self.study, values) if values else self.study)
        with self._lock:
            self._kept[at] = system
            if len(self._kept) > _KEPT_SYSTEMS:
                self._kept.popitem(last=False)
        return system

    def drive(self, positions: tuple[npt.NDArray[np.intp], ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Torques before and after [N m] and half gap [rad] of the cells at these positions, each (cells,)."""
        swept: dict[str, FloatArray] = {
            axis.parameter: axis.grid[position] for axis, position in zip(self.axes, positions, strict=True)
        }
        torques = {key.removeprefix("load."): value for key, value in swept.items() if key.startswith("load.")}
        shape = positions[0].shape
        before, after = (
            np.broadcast_to(side, shape).astype(np.float64) for side in load_step(self.study.load, **torques)
        )
        gap = np.broadcast_to(swept.get("lash.backlash_deg", self.study.lash.backlash_deg), shape)
        return before, after, np.deg2rad(gap) / 2


def _tiles(cells: int, workers: int) -> Iterator[Tile]:
    size = max(1, min(_TILE_CELLS, -(-cells // (8 * workers))))
    for start in range(0, cells, size):
        yield Tile(start, min(start + size, cells))


def _run_tile(grid: _Grid, part: Tile, stop: npt.NDArray[np.uint8]) -> _Finished:
    positions = np.unravel_index(np.arange(part.start, part.stop), grid.shape)
    before, after, half_gap = grid.drive(positions)
    if grid.structural:
        combinations = np.stack([positions[axis] for axis in grid.structural], axis=1)
        unique, system_of = np.unique(combinations, axis=0, return_inverse=True)
        systems = [grid.system(tuple(int(k) for k in at)) for at in unique]
    else:
        systems, system_of = [grid.system(())], np.zeros(part.stop - part.start, np.int64)
    stacked, system_of = stack(systems), system_of.reshape(-1).astype(np.int64)
    count = part.stop - part.start
    max_events = grid.study.solver.max_events
    cells = np.zeros(count, tile.CELL)
    impacts: list[npt.NDArray[np.void]] = []
    buffer = np.zeros(8 * count + max_events, tile.IMPACT)
    done = 0
    while done < count and not stop[0]:
        done, written = tile.run_tile(
            stacked, system_of, before, after, half_gap, done, max_events, cells, buffer, stop
        )
        impacts.append(buffer[:written].copy())
    return _Finished(part, cells, impacts)


def _run_tiles(grid: _Grid, workers: int) -> Generator[_Finished, None, None]:
    """Finished tiles in the order in which they finish. Leaving the generator early abandons the running cells."""
    stop = np.zeros(1, np.uint8)
    waiting = _tiles(grid.cells, workers)
    with ThreadPoolExecutor(workers, thread_name_prefix="clunk") as pool:
        running: set[Future[_Finished]] = set()
        try:
            while True:
                while len(running) < 2 * workers and (part := next(waiting, None)) is not None:
                    running.add(pool.submit(_run_tile, grid, part, stop))
                if not running:
                    return
                finished, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
        finally:
            stop[0] = 1
            for future in running:
                future.cancel()


class _Assembly:
    """The results' arrays, filled tile by tile."""

    def __init__(self, grid: _Grid) -> None:
        self._grid = grid
        self.done = 0
        self._patterns = np.zeros(grid.cells, np.uint64)
        self._long: dict[int, str] = {}
        self._fields = {name: np.zeros(grid.cells, dtype) for name, dtype in CELL_FIELDS.items() if name != "sequence"}
        self._impacts: dict[int, dict[str, npt.NDArray[np.generic]]] = {}

    def add(self, finished: _Finished) -> None:
        part, cells = finished.tile, finished.cells
        self._patterns[part.start : part.stop] = cells["pattern"]
        for name, field in self._fields.items():
            field[part.start : part.stop] = cells[name]
        impacts = np.concatenate(finished.impacts)
        self._impacts[part.start] = {
            name: np.ascontiguousarray(impacts[name.removeprefix("impact_")]) for name in IMPACT_FIELDS
        }
        # sequences too long for a pattern are labelled here, from their flanks
        long = np.flatnonzero((cells["pattern"] == 0) & (cells["status"] == Status.OK))
        if long.size:
            ends = np.cumsum(cells["primary_impacts"])
            for k in long:
                flanks = impacts["flank"][ends[k] - cells["primary_impacts"][k] : ends[k]]
                self._long[part.start + int(k)] = label(flanks)
        self.done += part.stop - part.start

    def results(self) -> Results:
        study, shape = self._grid.study, self._grid.shape
        labels, sequence = self._sequence()
        parts = [self._impacts[start] for start in sorted(self._impacts)]
        impacts = {name: np.concatenate([part[name] for part in parts]) for name in IMPACT_FIELDS}
        axes = []
        for axis in self._grid.axes:
            what = quantity(axis.parameter)
            axes.append(ResultAxis(axis.parameter, axis.grid, what.name, what.symbol, what.unit))
        return Results(
            title=study.title,
            axes=tuple(axes),
            labels=labels,
            sequence=sequence.reshape(shape),
            **{name: field.reshape(shape) for name, field in self._fields.items()},
            **impacts,
            config=to_toml(study),
            config_digest=digest(study),
            attributes=provenance(),
        )

    def _sequence(self) -> tuple[tuple[str, ...], npt.NDArray[np.int16]]:
        """Codes by (number of primaries, label), so that they do not depend on who finished first."""
        patterns, inverse = np.unique(self._patterns, return_inverse=True)
        names: dict[str, int] = {text: _primaries(text) for text in self._long.values()}
        of_pattern = {}
        for pattern in patterns.tolist():
            if pattern:
                flanks = _flanks(pattern)
                of_pattern[pattern] = label(flanks)
                names[of_pattern[pattern]] = len(flanks)
        labels = tuple(sorted(names, key=lambda text: (names[text], text)))
        code = {text: k for k, text in enumerate(labels)}
        codes = np.array([code[of_pattern[p]] if p else FAILED_CODE for p in patterns.tolist()], np.int16)
        sequence = codes[inverse.reshape(-1)]
        for cell, text in self._long.items():
            sequence[cell] = code[text]
        return labels, sequence


def _flanks(pattern: int) -> list[int]:
    """The flanks that a pattern's bits stand for, behind its leading 1."""
    return [OPPOSITE if bit == "1" else -OPPOSITE for bit in bin(pattern)[3:]]


def _primaries(text: str) -> int:
    """How many primary impacts a label stands for."""
    runs = (run.split("(") for run in text.split(")") if run)
    return sum((2 if kind == "DS" else 1) * int(length) for kind, length in runs)


def provenance() -> dict[str, str]:
    """Versions, date and machine, as the results file's attributes name them."""
    versions = {f"{name}_version": version(name) for name in ("numpy", "numba", "h5py")}
    return {
        "clunk_version": clunk.__version__,
        "python_version": platform.python_version(),
        **versions,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "cpu": _cpu_model(),
    }


def _cpu_model() -> str:
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def _available_cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


def _refuse_if_too_large(grid: _Grid) -> None:
    needed = grid.cells * _BYTES_PER_CELL
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return
    if needed > 0.8 * memory:
        sizes = " x ".join(str(count) for count in grid.shape)
        raise SweepError(
            f"The grid of {sizes} = {grid.cells:,} cells does not fit in memory: it takes about "
            f"{needed / 2**30:.0f} GiB, and this machine has {memory / 2**30:.0f} GiB."
        )
