"""`clunk fit`: parameters fitted to measured sequences of impacts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import PATH, json_option, lash_option, set_option, workers_option
from clunk.study.errors import ClunkError


@click.command()
@click.argument("config", type=PATH)
@click.argument("measurements", type=PATH)
@set_option
@click.option("--plot", "picture", type=PATH, help="Also draw maps, ensemble and probabilities: .png .svg .pdf.")
@click.option("--write", "fitted_config", type=PATH, help="Also write the fitted config (.toml), to be swept.")
@click.option("--tolerances", type=click.IntRange(1), help="With --write: so many draws of the ensemble as tolerances.")
@lash_option
@workers_option
@json_option
def fit(
    config: Path,
    measurements: Path,
    overrides: tuple[str, ...],
    picture: Path | None,
    fitted_config: Path | None,
    tolerances: int | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Fit parameters of a driveline to measured labels.

    The parameters are the [[fit.parameters]] of CONFIG, the MEASUREMENTS a CSV file as clunk compare reads it, or
    table_4_1. Prints how many labels are met, each parameter's estimate and interval, what the data leave undetermined,
    and how many labels are predicted from the other measurements.

    \b
    Example:
      clunk fit configs/fit_table_4_1.toml table_4_1 --plot rig.png \\
          --write rig.toml
    """
    if tolerances is not None and fitted_config is None:
        raise click.UsageError("--tolerances goes with --write.")
    import clunk
    from clunk.results import files
    from clunk.results.files import write_text
    from clunk.study.study import to_toml

    study = clunk.load_study(config, overrides)
    if picture is not None:
        files.check(picture, files.PICTURES)
    if fitted_config is not None:
        files.check(fitted_config, (".toml",), reads=config)
    terminal.warn_of_coarse_step(study, study.solver.method)
    fitted = clunk.fit(study, measurements, progress=True, **options)
    tables.tell(fitted, as_json)
    if fitted_config is not None:
        comment = f"# Fitted to {fitted.experiment.name}: {fitted.met} of {fitted.count} labels.\n"
        write_text(fitted_config, comment + to_toml(clunk.fitted_study(fitted, tolerances or 0)))
        terminal.say_written(fitted_config)
    if picture is not None:
        from clunk.plot.analyses import FIGURES

        for name, figure_of in FIGURES.items():
            try:
                terminal.save_picture(figure_of(fitted), picture.with_name(f"{picture.stem}-{name}{picture.suffix}"))
            except ClunkError as error:  # no map of other than two measured parameters
                terminal.complain(f"note: {error}")
    for sentence in fitted.warnings:
        terminal.complain(f"warning: {sentence}")
