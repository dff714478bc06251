"""`clunk sensitivity`: Sobol indices of tolerances."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import PATH, at_option, cell_values, json_option, lash_option, set_option, workers_option


@click.command()
@click.argument("config", type=PATH)
@set_option
@at_option
@click.option(
    "--of",
    "quantities",
    multiple=True,
    metavar="QUANTITY",
    help="severity, approach_velocity, primary_impacts, touches, last_event_time, severity<=8000, nominal_label, "
    "double_sided, chatter or label=DS(1)SS(1), for example [severity and nominal_label]. May be repeated.",
)
@lash_option
@workers_option
@click.option("-o", "--output", type=PATH, help="Also draw the indices: .png .svg .pdf.")
@json_option
def sensitivity(
    config: Path,
    overrides: tuple[str, ...],
    at: tuple[str, ...],
    quantities: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Tell from which tolerances the spread of an outcome comes.

    Takes the tolerances of CONFIG at one operating point. Prints first-order and total Sobol indices, from n (d + 2)
    runs for d tolerances; n is sweep.sampling.count, a power of two.

    \b
    Examples:
      clunk sensitivity tolerances.toml --set sweep.sampling.count=4096
      clunk sensitivity tolerances.toml --of severity --of double_sided \\
          -o bars.png
    """
    from clunk.analysis import sobol
    from clunk.results import files
    from clunk.study.config import load_study
    from clunk.study.study import replace_values

    study = load_study(config, overrides)
    if output is not None:
        files.check(output, files.PICTURES, reads=config)
    point = sobol.operating_point(replace_values(study, cell_values(study, at, all_needed=False)))
    terminal.warm_up(point, "drawn")
    result = sobol.sensitivity(point, of=quantities, progress=True, **options)
    tables.tell(result, as_json)
    if output is not None:
        from clunk.plot.analyses import sobol_bars

        terminal.save_picture(sobol_bars(result), output)
