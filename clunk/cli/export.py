"""`clunk export`: a results file in the formats of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from clunk.cli import terminal
from clunk.cli.options import PATH


@click.command()
@click.argument("file", type=PATH)
@click.argument("output", type=PATH)
def export(file: Path, output: Path) -> None:
    """Write the map of a results FILE as comma-separated values or for MATLAB.

    OUTPUT.csv has a row for each cell, codes as words and units in the header. OUTPUT.mat has the
    variables of FILE as arrays.

    \b
    Examples:
      clunk export results/figure_3_4.h5 map.csv
      clunk export results/figure_3_4.h5 map.mat
    """
    from clunk.results import export as exporting
    from clunk.results import targets
    from clunk.results.store import read_map

    targets.check(output, (*exporting.WRITERS,), reads=file)
    exporting.save(output, read_map(file))
    terminal.say_written(output)
