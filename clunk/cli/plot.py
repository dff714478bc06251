"""`clunk plot`: draw the maps of a results file."""

import re
from pathlib import Path
from typing import Any

import click

from clunk.cli.options import at_option, file_argument, nearest_values, output_option, repeated_option

_NO_FILE = r"[^\w.-]+"  # characters that a file name should not have
_LONGEST = 40  # most characters of a lash's name in a file name


@click.command()
@file_argument
@output_option(help="Picture: .png, .svg or .pdf [FILE.png].")
@click.option(
    "--quantity",
    metavar="NAME",
    help="Draw one quantity only: regimes, severity, touches, double_sided_impacts, 'severity<=8000', …",
)
@at_option
@repeated_option(
    "--facet",
    "facets",
    metavar="KEY",
    help="Draw a map for each value of a key; of two keys, in rows and columns.",
)
@click.option("--lash", metavar="NAME", help="Draw this lash of several [each]; --facet lash draws all side by side.")
@click.option(
    "--x",
    metavar="KEY",
    help="Horizontal axis, for axes that are walked together or a sample.",
)
@click.option("--y", metavar="KEY", help="Vertical axis, for a sample; with --x or --y alone a quantity over it.")
def plot(
    file: Path,
    output: Path | None,
    quantity: str | None,
    at: tuple[str, ...],
    facets: tuple[str, ...],
    lash: str | None,
    x: str | None,
    y: str | None,
) -> None:
    """Draw the maps of a results file.

    The pictures are of the regimes and of the severity; of a tolerance map they show the most likely regimes, paler
    where these are uncertain, the probability of double-sided impacts, and the mean severity. Each of several lashes
    has its own pictures, FILE-NAME-regimes.png and so on.

    A map has two axes. Of more axes, --at takes a slice, and --facet draws a map for each value. With more than 16
    labels, a map shows the numbers of double-sided impacts instead; clunk info and clunk explore show the labels.

    \b
    Examples:
      clunk plot results/figure_3_4.h5 -o figure.svg
      clunk plot results/four_axes.h5 --at lash.contact.stiffness=4e5 \\
          --facet 'driveline.shafts[1].damping'
      clunk plot results/sample.h5 --x load.ratio --y lash.backlash_deg
      clunk plot results/tolerance.h5 --quantity severity_95
    """
    from clunk import plot as plots
    from clunk.analysis.marks import thresholds_of
    from clunk.results import files
    from clunk.results.store import read_map
    from clunk.study.axes import LASH

    files.check(output, files.PICTURES, reads=file)
    results = read_map(file)
    base = output or file.with_suffix(".png")
    results = results.at(nearest_values(results.axes, at, results.tables))
    look: dict[str, Any] = {"facets": facets, "x": x, "y": y}
    each = {"": results if LASH in facets else results.at_lash(lash)}
    if lash is None and results.lashes and LASH not in facets:
        stems = [re.sub(_NO_FILE, "_", name)[:_LONGEST] for name in results.lashes]
        if len(set(stems)) < len(stems):
            stems = [str(number) for number in range(1, len(stems) + 1)]
        each = {f"-{stem}": results.at_lash(name) for stem, name in zip(stems, results.lashes, strict=True)}
    for of_lash, part in each.items():
        thresholds = thresholds_of(part)
        names = [quantity] if quantity else plots.default_quantities(part, **look)
        for name in names:
            of_quantity = "" if output and quantity else f"-{re.sub(_NO_FILE, '_', name)}"
            target = base.with_name(f"{base.stem}{of_lash}{of_quantity}{base.suffix}")
            figure = plots.draw(part, name, thresholds, **look)
            plots.save(figure, target)
            click.echo(target)
