"""`clunk fit`: parameters fitted to measured sequences of impacts."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.cli import tables, terminal
from clunk.cli.options import PATH, json_option, lash_option, set_option, workers_option
from clunk.sweeping import progress

if TYPE_CHECKING:
    from clunk.analysis.fitted import Fitted
    from clunk.study.study import Study


@click.command()
@click.argument("config", type=PATH)
@click.argument("measurements", type=PATH)
@set_option
@click.option("-o", "--output", type=PATH, help="File of the fit [results/CONFIG-fit.h5].")
@click.option("--plot", "picture", type=PATH, help="Also draw maps, ensemble and probabilities: .png .svg .pdf.")
@click.option("--write", "fitted_config", type=PATH, help="Also write the fitted config (.toml), to be swept.")
@click.option("--tolerances", type=click.IntRange(1), help="With --write: so many draws of the ensemble as tolerances.")
@lash_option
@workers_option
@click.option("--restart", is_flag=True, help="Neither go on with a stopped fit nor keep a finished one.")
@click.option("--force", is_flag=True, help="Overwrite a file of another fit.")
@json_option
def fit(
    config: Path,
    measurements: Path,
    overrides: tuple[str, ...],
    output: Path | None,
    picture: Path | None,
    fitted_config: Path | None,
    tolerances: int | None,
    lash: str | None,
    workers: int | None,
    restart: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Fit parameters of a driveline to measured labels.

    The parameters are the [[fit.parameters]] of CONFIG, the MEASUREMENTS a CSV file as clunk compare reads it, or
    table_4_1. Prints how many labels are met, each parameter's estimate and interval, what the data leave undetermined,
    and how many labels are predicted from the other measurements. A fit that was stopped goes on.

    \b
    Example:
      clunk fit configs/fit_table_4_1.toml table_4_1 -o results/rig.h5 \\
          --plot rig.png --write rig.toml
    """
    if tolerances is not None and fitted_config is None:
        raise click.UsageError("--tolerances goes with --write.")
    from clunk.analysis import fitfile, fitting
    from clunk.analysis.measurements import read_experiment
    from clunk.cli.fit_report import as_record, report
    from clunk.report.tables import TABLES
    from clunk.results import targets
    from clunk.study.config import load_study

    study = load_study(config, overrides)
    experiment = read_experiment(measurements, TABLES)
    fitting.check(study, experiment)
    target = output or Path("results") / f"{config.stem}-fit.h5"
    targets.check(target, targets.RESULTS, reads=config)
    if picture is not None:
        targets.check(picture, targets.PICTURES)
    if fitted_config is not None:
        targets.check(fitted_config, (".toml",), reads=config)
    fitted = fitfile.finished(target, fitting.identity(study, experiment, lash), force)
    if fitted is not None and not restart:
        click.echo(f"{target} is already complete.", err=True)
    else:
        fitted = _run(study, measurements, target, lash, workers, restart, force)
    if as_json:
        tables.print_record(as_record(fitted))
    else:
        click.echo("\n".join(report(fitted)))
    if fitted_config is not None:
        _write(fitted, fitted_config, tolerances or 0)
    if picture is not None:
        _draw(fitted, picture, workers)
    for sentence in fitted.warnings():
        terminal.complain(f"warning: {sentence}")


def _run(
    study: Study, measurements: Path, target: Path, lash: str | None, workers: int | None, restart: bool, force: bool
) -> Fitted:
    """Fit with a progress bar; print what is kept where it is stopped."""
    from clunk import api
    from clunk.analysis.fitting import planned
    from clunk.sweeping.parts import WorkingDirectory

    assert study.fit is not None
    terminal.warm_up(study.model_copy(update={"sweep": None}), "fitted")
    began = time.perf_counter()

    def kept() -> str:
        directory = WorkingDirectory(target)
        populations = len(directory.parts())
        text = f"{populations} populations are kept in {directory.path}; the same command goes on from there"
        return text if populations else "nothing was finished"

    with terminal.telling_what_is_kept(kept), progress.shown(planned(study.fit), "candidates") as show:
        fitted = api.fit(
            study, measurements, target, progress=show, lash=lash, workers=workers, restart=restart, force=force
        )
    seconds = time.perf_counter() - began
    click.echo(f"{fitted.candidates:,} candidates in {seconds:.1f} s -> {target}", err=True)
    return fitted


def _write(fitted: Fitted, path: Path, tolerances: int) -> None:
    """Write the fitted config, with the ensemble as tolerances if they are asked for."""
    from clunk.analysis.fitparts import FitError
    from clunk.analysis.fittedstudy import as_comment, fitted_study
    from clunk.results.files import write_text
    from clunk.study.study import to_toml

    write_text(path, as_comment(fitted) + to_toml(fitted_study(fitted, tolerances)), FitError)
    terminal.say_written(path)


def _draw(fitted: Fitted, path: Path, workers: int | None) -> None:
    """Draw the pictures of a fit: PATH-ensemble, PATH-labels and, of two measured parameters, PATH-maps."""
    from clunk.analysis.fitmaps import FitMapError, fit_maps
    from clunk.plot import fit as figures

    pictures = {name: figure_of(fitted) for name, figure_of in figures.FIGURES.items()}
    try:
        pictures["maps"] = figures.measured_on_maps(fit_maps(fitted, workers), fitted)
    except FitMapError as error:
        terminal.complain(f"note: {error}")
    for name, figure in pictures.items():
        terminal.save_picture(figure, path.with_name(f"{path.stem}-{name}{path.suffix}"))
