"""A sweep: axes -> tiles -> Results.

The cells to run are cut into tiles; an engine runs these, on this process's threads or on the workers of a scheduler.
"""

from __future__ import annotations

import functools
import math
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

import clunk
from clunk.results.labels import FAILED_CODE
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.config import Study, content, digest, study_from_text
from clunk.study.designs import Design, design_of, has_tolerances
from clunk.study.errors import ClunkError
from clunk.sweeping.assembly import Assembly
from clunk.sweeping.cells import Grid, warm_up
from clunk.sweeping.engines import Engine, EngineError, Threads, Work, available_cores
from clunk.sweeping.parts import Parts, WorkingDirectory
from clunk.sweeping.progress import Progress
from clunk.sweeping.refinement import Refinement, coarse_spacing
from clunk.sweeping.scratch import Scratch
from clunk.sweeping.tolerances import ToleranceAssembly, ToleranceGrid

__all__ = [
    "SweepError",
    "cell_count",
    "parts_of",
    "retry_failed",
    "sweep",
    "tolerance_map",
    "unused_parameters",
    "warm_up",
]

Cells = npt.NDArray[np.int64]
AnyGrid = TypeVar("AnyGrid", bound=Grid)

_BYTES_PER_CELL = 400  # the most that a cell's results, their assembly and writing take
_BYTES_IN_MEMORY = 50  # of them, what has to be in memory where the results are put together on the disk
_LARGE_SHARE = 0.25  # of the memory


HAS_TOLERANCES = "The study has [[sweep.tolerances]]: clunk.tolerance_map runs it."
NO_TOLERANCES = "The study has no [[sweep.tolerances]]: clunk.sweep runs it."


class SweepError(ClunkError):
    """A sweep that cannot start; its text is one sentence for the user."""


def sweep(
    study: Study,
    *,
    workers: int | None = None,
    engine: Engine | None = None,
    progress: Progress | None = None,
    refine: bool = False,
    parts: Parts | None = None,
    design: Design | None = None,
) -> Results:
    """Run the grid of a study.

    Parameters
    ----------
    study : Study
        With at least one axis or sample, and without tolerances.
    workers : int, optional
        Threads; by default one for each core that this process may use.
    engine : Engine, optional
        What runs the cells instead of these threads; see `clunk.sweeping.distributed`.
    progress : callable(done, total), optional
        Called in this thread with the number of cells after each finished tile.
    refine : bool
        Run only a coarse grid and what `clunk.sweeping.refinement` asks for; all other cells are marked as inferred.
        They have the label, flanks and initial flank of their neighbours, and of no quantity a value: NaN, -1 touches.
    parts : Parts, optional
        Where finished cells are kept as the sweep goes on, and taken up from; see `parts_of`.
    design : Design, optional
        Cells to run instead of those of the study's own sweep.

    Raises
    ------
    SweepError
        Where there is nothing to sweep, the grid does not fit in memory, no cell of it could run, or there are
        tolerances.
    PartsError
        Where finished cells cannot be kept.
    ScratchError
        Where the disk has no room for the results.
    EngineError
        Where the engine cannot go on; the finished cells have been kept.
    KeyboardInterrupt
        Passed on after the running cells have been abandoned, and the finished ones kept.
    """
    if has_tolerances(study):
        raise SweepError(HAS_TOLERANCES)
    grid = _checked(Grid(study, design), workers, parts)
    engine = engine or Threads(workers)
    assembly = Assembly(study, _scratch(grid, parts), grid.design, threads=workers or available_cores())
    _take_up(grid, assembly, progress, parts)
    if not refine:
        _run(grid, assembly, assembly.missing(), engine, progress, parts)
        return assembly.results(provenance(engine))
    refinement = Refinement(grid.shape, coarse_spacing(grid.design))

    def wanted(cells: Cells) -> Cells:
        return refinement.take(cells, assembly.kinds(cells), assembly.touches(cells))

    _run(grid, assembly, wanted(assembly.known()), engine, progress, parts, wanted)
    assembly.infer(refinement.kinds())
    note = _refinement_note(assembly.done, grid.cells, coarse_spacing(grid.design))
    return assembly.results({**provenance(engine), "refinement": note})


def tolerance_map(
    study: Study,
    *,
    workers: int | None = None,
    engine: Engine | None = None,
    progress: Progress | None = None,
    parts: Parts | None = None,
) -> ToleranceMap:
    """Run the grid of a study with tolerances, each cell for every draw of the sample.

    Parameters and errors are those of `sweep`.
    """
    if not has_tolerances(study):
        raise SweepError(NO_TOLERANCES)
    grid = _checked(ToleranceGrid(study), workers, parts)
    engine = engine or Threads(workers)
    assembly = ToleranceAssembly(study, grid)
    _take_up(grid, assembly, progress, parts)
    _run(grid, assembly, assembly.missing(), engine, progress, parts)
    return assembly.results(provenance(engine))


def retry_failed(
    results: Results,
    study: Study,
    *,
    workers: int | None = None,
    engine: Engine | None = None,
    progress: Progress | None = None,
    parts: Parts | None = None,
) -> Results:
    """Run the failed cells of finished results again, with another [solver].

    The other cells stay as they are, and so do the config and its digest; the attribute `retried` tells what was done.

    Raises SweepError where the study differs in anything but [solver]; else as `sweep`.
    """
    grid = _checked(Grid(study), workers, parts)
    engine = engine or Threads(workers)
    before = study_from_text(results.config, source="the results' config")
    if digest(before.model_copy(update={"solver": study.solver})) != digest(study):
        raise SweepError("The failed cells of another config cannot be run again: only [solver] may differ.")
    assembly = Assembly(study, _scratch(grid, parts), threads=workers or available_cores())
    assembly.add_results(results)
    failed = assembly.missing()
    _take_up(grid, assembly, progress, parts)
    _run(grid, assembly, assembly.missing(), engine, progress, parts)
    found = assembly.results(provenance(engine))
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
        widest = max(coarse_spacing(design_of(study)), default=1)
        plan = f"what --refine needs (from spacing {widest})"
    elif retry:
        plan = "the failed cells again"
    kind: type[Grid] = Grid
    if has_tolerances(study):
        plan, kind = "every cell for every draw", ToleranceGrid
    decisive = content(study)
    del decisive["title"]
    decisive["driveline"].pop("names", None)
    return Parts(directory, dict(_flat(decisive)), digest(study), plan, kind.record, kind.detail)


def cell_count(study: Study) -> int:
    """How many cells the grid of a study has; 0 without axes."""
    design = design_of(study)
    return design.cells if design.shape else 0


def unused_parameters(study: Study) -> list[str]:
    """The swept or drawn keys that change nothing in the study's contact model."""
    contact, sweep = study.lash.contact, study.sweep
    swept = [axis.parameter for axis in sweep.axes] if sweep else []
    swept += [draw.parameter for draw in (*sweep.samples, *sweep.tolerances)] if sweep else []
    if contact.model == "restitution":
        unused = {"lash.contact.stiffness", "lash.contact.damping", "impacts.sticking_time", "impacts.acceleration_of"}
    else:
        unused = {"lash.contact.restitution", "lash.contact.locking_speed"}
    return [parameter for parameter in swept if parameter in unused | {"load.step_time"}]


def _checked(grid: AnyGrid, workers: int | None, parts: Parts | None) -> AnyGrid:
    if not grid.shape:
        raise SweepError("There is nothing to sweep: the config has no [[sweep.axes]] and no [[sweep.samples]].")
    if workers is not None and workers < 1:
        raise SweepError(f"A sweep needs at least one worker, not {workers}.")
    _refuse_if_too_large(grid, parts)
    complaint = grid.complaint()
    if complaint is not None:
        raise SweepError(f"No cell can run: {complaint}.")
    return grid


def _take_up(
    grid: Grid, assembly: Assembly | ToleranceAssembly, progress: Progress | None, parts: Parts | None
) -> None:
    """Put together what there is of a sweep that was interrupted."""
    for tile in parts.read() if parts is not None else ():
        assembly.add(tile)
    if progress is not None and parts is not None and parts.taken_up:
        progress(assembly.done, max(assembly.done, grid.cells))


def _run(
    grid: Grid,
    assembly: Assembly | ToleranceAssembly,
    cells: Cells,
    engine: Engine,
    progress: Progress | None,
    parts: Parts | None,
    wanted: Callable[[Cells], Cells] | None = None,
) -> None:
    """Run cells, and what is `wanted` for the sake of each tile."""
    work, before = Work(grid, cells, may_grow=wanted is not None), assembly.done
    try:
        with closing(engine.run(grid, work)) as tiles:  # an interrupt anywhere abandons the running cells
            for tile in tiles:
                assembly.add(tile)
                if parts is not None:
                    parts.add(tile)
                if wanted is not None:
                    work.add(wanted(tile.cells))
                if progress is not None:
                    progress(assembly.done, before + work.known)
    except (KeyboardInterrupt, SystemExit, EngineError):  # SIGINT, SIGTERM, workers gone: keep what is done
        if parts is not None:
            parts.flush()
        raise
    if parts is not None and parts.on_disk:  # a sweep shorter than the first part is not worth a file
        parts.flush()


def _refinement_note(ran: int, cells: int, spacing: tuple[int, ...]) -> str:
    steps = " x ".join(str(step) for step in spacing)
    return (
        f"{ran} of {cells} cells run, the others inferred from their neighbours; coarse grid every {steps} cells: "
        "regimes that none of its cells shows, nor any line followed from them, are missed"
    )


def provenance(engine: Engine) -> dict[str, str]:
    """Versions, date and machine, as the results file's attributes name them."""
    return {**_versions(), "created": datetime.now(UTC).isoformat(timespec="seconds"), "cpu": engine.processors()}


@functools.cache
def _versions() -> dict[str, str]:
    return {
        "clunk_version": clunk.__version__,
        "python_version": platform.python_version(),
        **{f"{name}_version": version(name) for name in ("numpy", "numba", "h5py")},
    }


def _scratch(grid: Grid, parts: Parts | None) -> Scratch:
    """Where the results are put together: beside the parts, where they would be a large share of the memory."""
    large = grid.cells * _BYTES_PER_CELL > _LARGE_SHARE * _memory()
    return Scratch(parts.directory.path if large and parts is not None else None)


def _refuse_if_too_large(grid: Grid, parts: Parts | None) -> None:
    needed, memory = grid.cells * (_BYTES_PER_CELL if parts is None else _BYTES_IN_MEMORY), _memory()
    if needed > 0.8 * memory:
        sizes = " x ".join(str(count) for count in grid.shape)
        raise SweepError(
            f"The grid of {sizes} = {grid.cells:,} cells does not fit in memory: it takes about "
            f"{needed / 2**30:.0f} GiB, and this machine has {memory / 2**30:.0f} GiB."
        )


def _memory() -> float:
    """Of this machine, bytes; infinite where it does not tell."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


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
