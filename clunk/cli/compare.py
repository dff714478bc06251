"""`clunk compare`: two results files cell by cell, or one with measurements; `clunk verify`: the two methods."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import (
    EXIT_FAILED_CELLS,
    EXIT_MISMATCH,
    flag_option,
    json_option,
    output_option,
    path_argument,
    study_argument,
    workers_option,
)

if TYPE_CHECKING:
    from clunk.study.study import Study


@click.command()
@path_argument("a")
@path_argument("b")
@output_option(help="Also draw where A and B differ, for the first lash: .png .svg .pdf.")
@flag_option("--expect-equal", help="Exit with 4 where any label differs.")
@json_option
def compare(a: Path, b: Path, output: Path | None, expect_equal: bool, as_json: bool) -> None:
    """Compare a results file with another, or with measurements.

    A is a results file. B is a results file of the same grid, a CSV file of measured labels, or table_4_1, the report's
    experiment. Maps are compared cell by cell, and each lash of a cell counts as a cell. Measurements are compared with
    the first lash, each with the cell nearest to it.

    \b
    Examples:
      clunk compare results/rk4.h5 results/force.h5 --expect-equal
      clunk compare results/figure_3_4.h5 table_4_1 -o experiment.png
    """
    from clunk.analysis.comparison import compare as compare_maps
    from clunk.analysis.measurements import compare_experiment, is_experiment, read_experiment
    from clunk.results import files
    from clunk.results.store import read_results

    files.check(output, files.PICTURES)
    results = read_results(a)
    first, other = results.of_lash(), None if is_experiment(b) else read_results(b)
    comparison: Any  # of two maps, or of a map and measurements
    comparison = compare_experiment(first, read_experiment(b)) if other is None else compare_maps(results, other)
    if not as_json:
        click.echo(f"A  {a}\nB  {b}\n")
    tables.tell(comparison, as_json)
    if output is not None:
        from clunk.plot.analyses import difference_map, experiment_map

        if other is None:
            figure = experiment_map(first, comparison)
        else:
            figure = difference_map(compare_maps(first, other.of_lash()))
        terminal.save_picture(figure, output)
    if expect_equal and not comparison.same_regimes:
        sys.exit(EXIT_MISMATCH)


@click.command()
@study_argument
@workers_option
@json_option
def verify(study: Study, workers: int | None, as_json: bool, **_: Any) -> None:
    """Run a config by both methods and compare the results.

    Prints the comparison of the maps by rk4 (A) and exact (B) as clunk compare does; each lash of a cell counts as a
    cell. The exact method is guarded: it cannot skip an event, to rounding, for this model. Where labels differ in a
    cell that it does not flag as undecided or grazing, the exit code is 4, and a smaller solver.step may bring them to
    agree. A config without axes is a map of one cell.

    \b
    Examples:
      clunk verify configs/smoke.toml
      clunk verify configs/figure_3_4.toml --set solver.step=5e-5
    """
    import clunk
    from clunk.analysis.comparison import METHODS

    if study.swept.tolerances:
        terminal.complain("tolerances are left aside; these are the nominal runs")
    terminal.warn(study, "rk4")
    comparison = clunk.verify(study, workers=workers, progress=True)
    tables.tell(comparison, as_json)
    for method, results in zip(METHODS, comparison.maps, strict=True):
        terminal.report_failures(results, f" by {method}")
    if comparison.differing_elsewhere:
        sys.exit(EXIT_MISMATCH)
    if any(comparison.failed.values()):
        sys.exit(EXIT_FAILED_CELLS)
