"""A sweep: axes -> tiles -> Results.

The cells to run are cut into tiles; a jitted kernel without the interpreter lock runs each on a pool of threads. A
cell's result depends on nothing but its parameters, so neither the cut, the order nor the number of threads can change
a bit of it.
"""

from __future__ import annotations

import functools
import math
import os
import platform
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

import clunk
from clunk import refinement
from clunk.assembly import Assembly
from clunk.cells import CELL, IMPACT, Grid, warm_up
from clunk.config import Study, digest, study_from_text
from clunk.parts import Parts, WorkingDirectory
from clunk.results import FAILED_CODE, Results
from clunk.tiles import Tile

__all__ = ["SweepError", "cell_count", "parts_of", "retry_failed", "sweep", "unused_axes", "warm_up"]

Cells = npt.NDArray[np.int64]
Progress = Callable[[int, int], None]

_TILE_CELLS = {"rk4": 512, "exact": 4096}  # 0.1 s of the report's driveline: progress is smooth, overhead small
_AHEAD = 8  # tiles handed to each worker: they go on while a part is written to the disk, 0.3 s
_BYTES_PER_CELL = 400  # the most that a cell's results, their assembly and writing take


class SweepError(Exception):
    """A sweep that cannot start; its text is one sentence for the user."""


def sweep(
    study: Study,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    refine: bool = False,
    parts: Parts | None = None,
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
    refine : bool
        Run only a coarse grid and what `clunk.refinement` asks for; all other cells are marked as inferred. They have
        the label, flanks and initial flank of their neighbours, and of no quantity a value: NaN, -1 touches.
    parts : Parts, optional
        Where finished cells are kept as the sweep goes on, and taken up from; see `parts_of`.

    Raises
    ------
    SweepError
        Where there is nothing to sweep, the grid does not fit in memory, or no cell of it could run.
    PartsError
        Where finished cells cannot be kept.
    KeyboardInterrupt
        Passed on after the running cells have been abandoned, and the finished ones kept.
    """
    grid = _checked(study, workers)
    assembly = Assembly(study)
    if not refine:
        _run(grid, assembly, iter([None]), workers, progress, parts)
        return assembly.results(provenance())
    spacing = refinement.spacings([axis.grid for axis in grid.axes])
    _run(grid, assembly, _refinements(assembly, spacing), workers, progress, parts)
    ran = assembly.done
    assembly.infer(*refinement.inferred(assembly.kinds(), assembly.touches(), spacing))
    return assembly.results({**provenance(), "refinement": _refinement_note(ran, grid.cells, spacing)})


def retry_failed(
    results: Results,
    study: Study,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    parts: Parts | None = None,
) -> Results:
    """Run the failed cells of finished results again, with another [solver].

    The other cells stay as they are, and so do the config and its digest; the attribute `retried` tells what was done.

    Raises SweepError where the study differs in anything but [solver]; else as `sweep`.
    """
    grid = _checked(study, workers)
    before = study_from_text(results.config, source="the results' config")
    if digest(before.model_copy(update={"solver": study.solver})) != digest(study):
        raise SweepError("The failed cells of another config cannot be run again: only [solver] may differ.")
    assembly = Assembly(study)
    assembly.add_results(results)
    failed = assembly.missing()
    _run(grid, assembly, iter([None]), workers, progress, parts)
    found = assembly.results(provenance())
    still = int(np.count_nonzero(found.sequence.ravel()[failed] == FAILED_CODE))
    changes = [
        f"solver.{key} = {value} instead of {getattr(before.solver, key)}"
        for key, value in study.solver.model_dump().items()
        if value != getattr(before.solver, key)
    ]
    note = (
        f"{failed.size} failed cells run again with {', '.join(changes) or 'the same solver'}: {still} failed again; "
        f"cells {_listed(failed)} in C order"
    )
    notes = [text for text in (results.attributes.get("retried"), note) if text]
    kept = {key: value for key, value in results.attributes.items() if key == "refinement"}
    return replace(
        found,
        title=results.title,
        config=results.config,
        config_digest=results.config_digest,
        attributes={**found.attributes, **kept, "retried": "; ".join(notes)},
    )


def parts_of(directory: WorkingDirectory, study: Study, *, refine: bool = False, retry: bool = False) -> Parts:
    """The parts of a sweep in its working directory.

    Raises PartsError where the directory holds another sweep's.
    """
    plan = "every cell"
    if refine:
        axes = study.sweep.axes if study.sweep else ()
        widest = max(refinement.spacings([axis.grid for axis in axes]), default=1)
        plan = f"what --refine needs (from spacing {widest})"
    elif retry:
        plan = "the failed cells again"
    content = study.model_dump(exclude_none=True, exclude={"title": True, "driveline": {"names"}})
    return Parts(directory, dict(_flat(content)), digest(study), plan, CELL, IMPACT)


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


def _checked(study: Study, workers: int | None) -> Grid:
    if study.sweep is None:
        raise SweepError("There is nothing to sweep: the config has no [[sweep.axes]].")
    if workers is not None and workers < 1:
        raise SweepError(f"A sweep needs at least one worker, not {workers}.")
    grid = Grid(study)
    _refuse_if_too_large(grid)
    complaint = grid.complaint()
    if complaint is not None:
        raise SweepError(f"No cell can run: {complaint}.")
    return grid


def _run(
    grid: Grid,
    assembly: Assembly,
    batches: Iterator[Cells | None],
    workers: int | None,
    progress: Progress | None,
    parts: Parts | None,
) -> None:
    """Run batches of cells, each asked for when those before it are assembled; None stands for all that is missing."""
    workers = workers or _available_cores()
    for tile in parts.read() if parts is not None else ():
        assembly.add(tile)
    if progress is not None and parts is not None and parts.taken_up:
        progress(assembly.done, max(assembly.done, grid.cells))
    try:
        for batch in batches:
            cells = assembly.missing() if batch is None else batch
            total = assembly.done + cells.size
            with closing(_run_tiles(grid, cells, workers)) as tiles:  # an interrupt anywhere abandons the running cells
                for tile in tiles:
                    assembly.add(tile)
                    if parts is not None:
                        parts.add(tile)
                    if progress is not None:
                        progress(assembly.done, total)
    except (KeyboardInterrupt, SystemExit):  # SIGINT, SIGTERM: keep what is done
        if parts is not None:
            parts.flush()
        raise
    if parts is not None and parts.on_disk:  # a sweep shorter than the first part is not worth a file
        parts.flush()


def _refinements(assembly: Assembly, spacing: tuple[int, ...]) -> Iterator[Cells]:
    while True:
        cells = refinement.wanted(assembly.kinds(), assembly.touches(), spacing)
        if not cells.size:
            return
        yield cells


def _refinement_note(ran: int, cells: int, spacing: tuple[int, ...]) -> str:
    steps = " x ".join(str(step) for step in spacing)
    return (
        f"{ran} of {cells} cells run, the others inferred from their neighbours; coarse grid every {steps} cells: "
        "regimes that none of its cells shows, nor any line followed from them, are missed"
    )


def _run_tiles(grid: Grid, cells: Cells, workers: int) -> Generator[Tile, None, None]:
    """Finished tiles in the order in which they finish. Leaving the generator early abandons the running cells."""
    stop = np.zeros(1, np.uint8)
    largest = _TILE_CELLS[grid.study.solver.method]
    size = min(max(-(-cells.size // (8 * workers)), largest // 32), largest)
    waiting = (cells[start : start + size] for start in range(0, cells.size, size))
    with ThreadPoolExecutor(workers, thread_name_prefix="clunk") as pool:
        running: set[Future[Tile]] = set()
        try:
            while True:
                while len(running) < _AHEAD * workers and (part := next(waiting, None)) is not None:
                    running.add(pool.submit(grid.run, part, stop))
                if not running:
                    return
                finished, running = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
        finally:
            stop[0] = 1
            for future in running:
                future.cancel()


def provenance() -> dict[str, str]:
    """Versions, date and machine, as the results file's attributes name them."""
    return {**_versions(), "created": datetime.now(UTC).isoformat(timespec="seconds"), "cpu": _cpu_model()}


@functools.cache
def _versions() -> dict[str, str]:
    return {
        "clunk_version": clunk.__version__,
        "python_version": platform.python_version(),
        **{f"{name}_version": version(name) for name in ("numpy", "numba", "h5py")},
    }


@functools.cache
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


def _refuse_if_too_large(grid: Grid) -> None:
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


def _flat(node: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """The leaves of a document by dotted key, list items by number from 1."""
    if isinstance(node, dict):
        for name, value in node.items():
            yield from _flat(value, f"{key}.{name}" if key else name)
    elif isinstance(node, list | tuple) and any(isinstance(item, dict) for item in node):
        for number, value in enumerate(node, 1):
            yield from _flat(value, f"{key}[{number}]")
    else:
        yield key, list(node) if isinstance(node, tuple) else node


def _listed(cells: Cells, most: int = 100) -> str:
    shown = ", ".join(str(cell) for cell in cells[:most].tolist())
    return f"{shown}, … ({cells.size - most} more)" if cells.size > most else shown
