"""`clunk export`: a results file in the formats of other programs."""

from pathlib import Path

import click

from clunk.cli import terminal
from clunk.cli.options import file_argument, path_argument


@click.command()
@file_argument
@path_argument("output")
def export(file: Path, output: Path) -> None:
    """Write a map, or its boundaries, for other programs.

    FILE is a results file, and the suffix of OUTPUT chooses the format. OUTPUT.csv has a row for each cell, codes as
    words, and units in the header. OUTPUT.geojson has the regions as polygons and the boundaries between them as lines,
    if `clunk sweep` has traced them. MATLAB reads FILE itself, by ncread.

    \b
    Examples:
      clunk export results/figure_3_4.h5 map.csv
      clunk export results/smoke.h5 boundaries.geojson
    """
    from clunk.results import files
    from clunk.results.export import WRITERS, save
    from clunk.results.store import read_map

    files.check(output, [*WRITERS], reads=file)
    save(output, read_map(file))
    terminal.say_written(output)
