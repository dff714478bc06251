"""`clunk fit`: parameters fitted to measured sequences of impacts."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.cli import tables, terminal
from clunk.cli.options import EXIT_INTERRUPTED, PATH, json_option, lash_option, set_option, workers_option
from clunk.sweeping import progress

if TYPE_CHECKING:
    from clunk.analysis.fitting import Fitted
    from clunk.analysis.measurements import Experiment
    from clunk.study.study import Study
    from clunk.sweeping.parts import WorkingDirectory


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
    """Fit CONFIG's [[fit.parameters]] to MEASUREMENTS, a CSV file as clunk compare reads it, or table_4_1.

    Prints how many labels are met, each parameter's estimate and interval, what the data leave undetermined, and how
    many labels are predicted from the other measurements. A fit that was stopped goes on.

    \b
    Example:
      clunk fit configs/fit_table_4_1.toml table_4_1 -o results/rig.h5 \\
          --plot rig.png --write rig.toml
    """
    if tolerances is not None and fitted_config is None:
        raise click.UsageError("--tolerances goes with --write.")
    from clunk.analysis import fitfile, fitting
    from clunk.analysis.fittedstudy import require_single_draws
    from clunk.analysis.measurements import read_experiment
    from clunk.cli.fit_report import as_record, report
    from clunk.report.tables import TABLES
    from clunk.results import targets
    from clunk.study.config import load_study
    from clunk.sweeping.parts import WorkingDirectory

    study = load_study(config, overrides)
    experiment = read_experiment(measurements, TABLES)
    fitting.check(study, experiment)
    if tolerances is not None:
        require_single_draws(study)
    target = output or Path("results") / f"{config.stem}-fit.h5"
    targets.check(target, targets.RESULTS, reads=config)
    if picture is not None:
        targets.check(picture, targets.PICTURES)
    if fitted_config is not None:
        targets.check(fitted_config, (".toml",), reads=config)
    digest = fitting.identity(study, experiment, lash)
    finished = None
    if target.exists() and not force:
        finished = _finished(target, digest)
    if finished is not None and not restart:
        click.echo(f"{target} is already complete.", err=True)
    else:
        with WorkingDirectory(target) as directory:
            if restart:
                directory.clear()
            finished = _run(study, experiment, lash, workers, directory, target)
            fitfile.save(target, finished, lash, directory.path)
            directory.remove()
    if as_json:
        tables.print_record(as_record(finished))
    else:
        click.echo("\n".join(report(finished)))
    if fitted_config is not None:
        _write(finished, fitted_config, tolerances or 0)
    if picture is not None:
        _draw(finished, picture, workers)
    for sentence in finished.warnings():
        terminal.complain(f"warning: {sentence}")


def _finished(target: Path, digest: str) -> Fitted:
    """Fit that a file holds already. Raises FitError where it is another one."""
    from clunk.analysis import fitfile
    from clunk.analysis.fitparts import FitError

    ways_out = "Name another file, or overwrite it with --force."
    try:
        fitted, its_digest = fitfile.load(target)
    except FitError as error:
        raise FitError(f"{error} It is in the way of the fit. {ways_out}") from error
    if its_digest != digest:
        raise FitError(f"{target} holds the fit of another config or of other measurements. {ways_out}")
    return fitted


def _run(
    study: Study,
    experiment: Experiment,
    lash: str | None,
    workers: int | None,
    directory: WorkingDirectory,
    target: Path,
) -> Fitted:
    """Fit with a progress bar; print what is kept where it is stopped."""
    from clunk.analysis import fitting
    from clunk.study.designs import unused_parameters
    from clunk.sweeping.cells import warm_up

    assert study.fit is not None
    terminal.warn_of_coarse_step(study, study.solver.method)
    for parameter in unused_parameters(study.model_copy(update={"sweep": None})):
        click.echo(f"note: {parameter} is fitted, but changes nothing in this model", err=True)
    terminal.say_if_compiling(study)
    warm_up(study)
    began = time.perf_counter()
    try:
        with progress.shown(fitting.planned(study.fit), "candidates") as show:
            fitted = fitting.fit(study, experiment, lash=lash, workers=workers, progress=show, directory=directory)
    except (KeyboardInterrupt, SystemExit) as stopped:
        kept = f"{len(directory.parts())} populations are kept in {directory.path}; the same command goes on from there"
        terminal.complain(f"stopped: {kept if directory.parts() else 'nothing was finished'}")
        if isinstance(stopped, SystemExit):
            raise
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    seconds = time.perf_counter() - began
    click.echo(f"{fitted.candidates:,} candidates in {seconds:.1f} s -> {target}", err=True)
    return fitted


def _write(fitted: Fitted, path: Path, tolerances: int) -> None:
    """Write the fitted config, with the ensemble as tolerances if they are asked for."""
    from clunk.analysis.fitparts import FitError
    from clunk.analysis.fittedstudy import as_comment, fitted_study
    from clunk.results.files import write_whole, writing
    from clunk.study.study import to_toml

    text = as_comment(fitted) + to_toml(fitted_study(fitted, tolerances))
    with writing(path, FitError):
        write_whole(path, lambda file: file.write(text.encode()))
    terminal.say_written(path)


def _draw(fitted: Fitted, path: Path, workers: int | None) -> None:
    """Draw the pictures of a fit: PATH-ensemble, PATH-labels and, of two measured parameters, PATH-maps."""
    from clunk.analysis.fitmaps import FitMapError, fit_maps
    from clunk.plot import fit as figures

    pictures = {"ensemble": figures.corner(fitted), "labels": figures.label_probabilities(fitted)}
    try:
        pictures["maps"] = figures.measured_on_maps(fit_maps(fitted, workers), fitted)
    except FitMapError as error:
        terminal.complain(f"note: {error}")
    for name, figure in pictures.items():
        terminal.save_picture(figure, path.with_name(f"{path.stem}-{name}{path.suffix}"))
