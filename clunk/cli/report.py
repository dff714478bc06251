"""`clunk report`: one page on a results file."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.cli import cells, terminal
from clunk.cli.options import PATH, at_option

if TYPE_CHECKING:
    from clunk.results.store import Header


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
    from clunk.results import targets
    from clunk.results.files import write_text
    from clunk.results.store import read_header, read_map

    target = output or file.with_suffix(".html")
    targets.check(target, (".html",), reads=file)
    results, header = read_map(file), read_header(file)
    if at:
        results = results.at(cells.nearest_values(results.axes, results.coordinates, at))
    digests = [("config digest", header.config_digest), ("content digest", header.content_digest)]
    write_text(target, page(results, _commands(header, file, target, at), digests))
    terminal.say_written(target)


def _commands(header: Header, file: Path, target: Path, at: tuple[str, ...]) -> list[str]:
    """Lines of a shell that make the results again from their config, and then the page."""
    config, results = f"{file.stem}.toml", f"{file.stem}.h5"
    sweep = ["clunk", "sweep", config, "-o", results]
    if header.boundaries is not None:
        sweep += ["--boundaries", *(["--lash", header.boundaries.lash] if header.boundaries.lash else [])]
    made = [f"# the config below is {config}", shlex.join(sweep)]
    if header.setting("sweep") is None:
        made = ["# by clunk.run_points, for the config below at points that a script names"]
    slices = [word for place in at for word in ("--at", place)]
    return [*made, shlex.join(["clunk", "report", results, "-o", target.name, *slices])]
