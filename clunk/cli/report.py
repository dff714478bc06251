"""`clunk report`: one page on a results file."""

from pathlib import Path

import click

from clunk.cli import terminal
from clunk.cli.options import at_option, file_argument, nearest_values, output_option


@click.command()
@file_argument
@output_option(help="Page: .html [FILE.html].")
@at_option
def report(file: Path, output: Path | None, at: tuple[str, ...]) -> None:
    """Write a page of HTML on a results file.

    The page has the maps, numbers, config, versions and digests of FILE. It is a single file that loads no other. With
    three or four axes it has a map for each value of the further ones, or for evenly spaced ones if these are many; or
    --at takes a slice.

    Example: clunk report results/figure_3_4.h5 -o report.html
    """
    from clunk.plot.page import page
    from clunk.results import files
    from clunk.results.netcdf import content_digest
    from clunk.results.store import dataset_of, read_map

    results = read_map(file)
    target = output or file.with_suffix(".html")
    files.check(target, (".html",), reads=file)
    part = results.at(nearest_values(results.axes, at, results.tables))
    digests = [("config digest", results.config_digest), ("content digest", content_digest(dataset_of(results)))]
    files.write_text(target, page(part, digests))
    terminal.say_written(target)
