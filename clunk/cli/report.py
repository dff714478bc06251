"""`clunk report`: one page on a results file."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.cli import terminal
from clunk.cli.options import PATH, at_option, nearest_values

if TYPE_CHECKING:
    from clunk.results.maps import AnyMap


@click.command()
@click.argument("file", type=PATH)
@click.option("-o", "--output", type=PATH, help="Page: .html [FILE.html].")
@at_option
def report(file: Path, output: Path | None, at: tuple[str, ...]) -> None:
    """Write a page of HTML on a results file.

    It has the maps, thresholds, config, versions and digests of FILE. It is one file, which asks for no other. Of three
    or four axes it has a map for each value of the further ones, or a slice by --at.

    Example: clunk report results/figure_3_4.h5 -o report.html
    """
    from clunk.plot.page import page
    from clunk.results import files
    from clunk.results.files import write_text
    from clunk.results.netcdf import content_digest
    from clunk.results.store import dataset_of, read_map

    target = output or file.with_suffix(".html")
    files.check(target, (".html",), reads=file)
    results = part = read_map(file)
    if at:
        part = results.at(nearest_values(results.axes, results.coordinates, at))
    digests = [("config digest", results.config_digest), ("content digest", content_digest(dataset_of(results)))]
    write_text(target, page(part, _commands(results, file, target, at), digests))
    terminal.say_written(target)


def _commands(results: AnyMap, file: Path, target: Path, at: tuple[str, ...]) -> list[str]:
    """Lines of a shell that make the results again from their config, and then the page."""
    config, copy = f"{file.stem}.toml", f"{file.stem}.h5"
    sweep = ["clunk", "sweep", config, "-o", copy]
    if results.boundaries is not None:
        sweep += ["--boundaries", *(["--lash", results.boundaries.lash] if results.boundaries.lash else [])]
    made = [f"# the config below is {config}", shlex.join(sweep)]
    if results.setting("sweep") is None:
        made = ["# by clunk.run_points, for the config below at points that a script names"]
    slices = [word for place in at for word in ("--at", place)]
    return [*made, shlex.join(["clunk", "report", copy, "-o", target.name, *slices])]
