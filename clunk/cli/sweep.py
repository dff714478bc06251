"""`clunk sweep`: run a grid and write a results file."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.cli import tables, terminal
from clunk.cli.options import EXIT_FAILED_CELLS, flag_option, json_option, output_option, study_argument
from clunk.study.records import counted

if TYPE_CHECKING:
    from clunk.results.maps import AnyMap
    from clunk.study.study import Study
    from clunk.sweeping.sweep import Job


@click.command()
@study_argument
@output_option(help="Results file [results/CONFIG.h5].")
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads, or local processes [one for each core].")
@click.option("--scheduler", metavar="ADDRESS", help="Run on dask workers: tcp://HOST:8786, or local.")
@flag_option("--force", help="Overwrite a results file of another config.")
@flag_option("--restart", help="Begin anew: neither go on with a stopped sweep nor keep a finished one.")
@click.option(
    "--boundaries/--no-boundaries",
    default=None,
    help="Trace the curves between labels of a map with two axes [yes].",
)
@click.option("--lash", metavar="NAME", help="Of several lashes, the one whose boundaries are traced [the first].")
@json_option
def sweep(
    config: Path,
    study: Study,
    output: Path | None,
    workers: int | None,
    scheduler: str | None,
    force: bool,
    restart: bool,
    boundaries: bool | None,
    lash: str | None,
    as_json: bool,
) -> None:
    """Run the grid of a config and write a results file.

    CONFIG is a TOML file with [[sweep.axes]]. If a sweep is stopped, for whatever reason, the same command goes on
    where it stopped.

    \b
    Examples:
      clunk sweep configs/figure_3_4.toml --set solver.step=5e-5
      clunk sweep configs/figure_3_4.toml --no-boundaries -o cells.h5
      clunk sweep configs/figure_3_4.toml --scheduler tcp://localhost:8786
    """
    from clunk.analysis.boundaries import is_traced
    from clunk.results import files

    traces = is_traced(study, boundaries, lash)
    if lash is not None and not traces:
        raise click.UsageError("--lash goes with --boundaries: a map has all lashes.")
    target = output or Path("results") / f"{config.stem}.h5"
    files.check(target, files.RESULTS, reads=config)
    from clunk.sweeping.sweep import engine_of, opened

    opening = engine_of(scheduler, workers)
    with opened(target, study, restart=restart, force=force) as job:
        result = job.held
        if result is not None:
            click.echo(f"{target} is already complete.", err=True)
        else:
            terminal.warn(study)
            with opening as engine:
                result = job.run(engine, progress=True)
        if traces:
            _trace(job, result, study, lash, workers, as_json)
        else:
            job.finish(result)
            _report(result, job, as_json)
        if job.held is None:
            terminal.say_written(target)
    if (result.status != 0).any():
        sys.exit(EXIT_FAILED_CELLS)


def _trace(job: Job, result: AnyMap, study: Study, lash: str | None, workers: int | None, as_json: bool) -> None:
    """Print a finished map, add its boundaries, and print how many there are."""
    from dataclasses import replace

    from clunk.analysis.boundaries import with_boundaries
    from clunk.results.maps import Results

    began = time.perf_counter()

    def addition(result: AnyMap) -> AnyMap:  # prints within `finish`, which keeps the map even if printing fails
        _report(replace(result, boundaries=None) if isinstance(result, Results) else result, job, as_json)
        return with_boundaries(study, result, lash=lash, workers=workers, progress=True)

    traced = job.finish(result, addition)
    if traced is not result and traced.boundaries is not None:
        ((_, numbers),) = traced.boundaries.summary()
        terminal.complain(f"boundaries: {numbers}, {time.perf_counter() - began:.1f} s")
        if traced.boundaries.unresolved_sentence:
            terminal.complain(traced.boundaries.unresolved_sentence)


def _report(result: AnyMap, job: Job, as_json: bool) -> None:
    """Print the outcomes of a finished map, and on stderr the number of cells, time, failures and caveats."""
    from clunk.results.maps import ToleranceMap

    draws = result.draws if isinstance(result, ToleranceMap) else 0
    if as_json:
        cells = {} if draws else {"cells": job.design.cells}
        head = {"file": job.path, "seconds": round(job.seconds, 3)} | cells
        tables.print_record(head | tables.outcomes(result))
    else:
        tables.print_outcomes(result)
    if job.held is None:
        each = f" x {draws:,} draws" if draws else ""
        terminal.complain(f"{counted(job.ran, 'cell')}{each} in {job.seconds:.1f} s")
    terminal.report_failures(result, " for some draws" if draws else "")
    for caveat in result.caveats:
        terminal.complain(f"note: {caveat}")
