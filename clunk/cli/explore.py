"""`clunk explore`: a page in the browser with a map and the motion in the cell under the pointer."""

from pathlib import Path

import click

from clunk.cli import terminal
from clunk.cli.options import flag_option, path_argument, set_option


@click.command()
@path_argument("source")
@set_option
@flag_option("--no-browser", help="Only print the address of the page.")
@click.option("--port", type=click.IntRange(1, 65535), help="Port of this machine [any that is free].")
def explore(source: Path, overrides: tuple[str, ...], no_browser: bool, port: int | None) -> None:
    """Open a page in the browser: point at a map, see the motion.

    SOURCE is a results file, or a config, whose map is then run first. The page can be opened on this machine only;
    Ctrl-C ends it.

    \b
    Examples:
      clunk explore results/figure_3_4.h5
      clunk explore configs/ramp.toml --set solver.method=exact
    """
    from clunk.explorer.server import explore as serve

    if source.suffix == ".h5":
        from clunk.results.store import read_map

        if overrides:
            raise click.UsageError("--set goes with a config; on the page, the numbers of a file have sliders.")
        results = read_map(source)
    else:
        from clunk.study.config import load_study
        from clunk.study.designs import with_cells
        from clunk.sweeping.sweep import sweep

        study = load_study(source, overrides)
        if study.swept.tolerances:
            terminal.complain("tolerances are left aside; for their map, sweep first and explore the file")
        study = with_cells(study)
        terminal.warn(study)
        results = sweep(study, progress=True)
    explorer = serve(results, name=source.stem, port=port or 0, browser=False)
    click.echo(explorer.url)
    click.echo("Ctrl-C ends it", err=True)
    if not no_browser:
        explorer.open_browser()
    try:
        explorer.wait()
    except KeyboardInterrupt:
        explorer.stop()
