"""`clunk export`: a results file in the formats of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from clunk.cli import terminal
from clunk.cli.options import PATH
from clunk.study.errors import ClunkError


@click.command()
@click.argument("file", type=PATH)
@click.argument("output", type=PATH)
@click.option("--boundaries", is_flag=True, help="The boundaries instead of the map.")
def export(file: Path, output: Path, boundaries: bool) -> None:
    """Write a map, or its boundaries, for other programs.

    FILE is a results file. OUTPUT.csv has a row for each cell, codes as words and units in the header. OUTPUT.mat has
    the variables of FILE as arrays. OUTPUT.geojson has the regions as polygons and the boundaries between them as
    lines, if `clunk sweep --boundaries` has traced them; with --boundaries OUTPUT.csv has a row for each of their
    vertices.

    \b
    Examples:
      clunk export results/figure_3_4.h5 map.csv
      clunk export results/figure_3_4.h5 map.mat
      clunk export results/smoke.h5 boundaries.geojson
      clunk export results/smoke.h5 boundaries.csv --boundaries
    """
    from clunk.results import export as exporting
    from clunk.results import targets
    from clunk.results.store import read_map

    of_map = [] if boundaries else [*exporting.WRITERS]
    targets.check(output, [*dict.fromkeys([*of_map, *exporting.OF_BOUNDARIES])], reads=file)
    results = read_map(file)
    if output.suffix.lower() in of_map:
        exporting.save(output, results)
    else:
        if results.boundaries is None:
            raise ClunkError(f"{file} has no boundaries; clunk sweep CONFIG --boundaries adds them to its file.")
        exporting.save_boundaries(output, results.boundaries)
    terminal.say_written(output)
