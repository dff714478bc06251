"""`clunk compare`: two results files cell by cell, or one with measurements."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import EXIT_MISMATCH, PATH, json_option


@click.command()
@click.argument("a", type=PATH)
@click.argument("b", type=PATH)
@click.option("-o", "--output", type=PATH, help="Also draw where they differ: .png .svg .pdf.")
@click.option("--expect-equal", is_flag=True, help="Exit with 4 where any label differs.")
@click.option("--lash", metavar="NAME", help="Of several lashes, this one [all; with measurements the first].")
@json_option
def compare(a: Path, b: Path, output: Path | None, expect_equal: bool, lash: str | None, as_json: bool) -> None:
    """Compare a results file with another, or with measurements.

    Cell by cell: A is a results file, B one of the same grid, a CSV file of measured labels, or table_4_1, the report's
    experiment.

    \b
    Examples:
      clunk compare results/rk4.h5 results/force.h5 --expect-equal
      clunk compare results/figure_3_4.h5 table_4_1 -o experiment.png
    """
    from clunk.analysis.comparison import compare as compare_maps
    from clunk.analysis.measurements import is_experiment, read_experiment
    from clunk.analysis.trends import compare_experiment
    from clunk.results import files
    from clunk.results.store import read_results

    if output is not None:
        files.check(output, files.PICTURES)
    results = read_results(a)
    other = None if is_experiment(b) else read_results(b)
    if other is None or lash is not None:
        results = results.of_lash(lash)
    if other is not None and lash is not None:
        other = other.of_lash(lash)
    comparison: Any  # of two maps, or of a map and measurements
    comparison = compare_experiment(results, read_experiment(b)) if other is None else compare_maps(results, other)
    if not as_json:
        click.echo(f"A  {a}\nB  {b}\n")
    tables.tell(comparison, as_json)
    if output is not None:
        from clunk.plot.analyses import difference_map, experiment_map

        figure = experiment_map(results, comparison) if other is None else difference_map(results, comparison)
        terminal.save_picture(figure, output)
    if expect_equal and not comparison.same_regimes:
        sys.exit(EXIT_MISMATCH)
