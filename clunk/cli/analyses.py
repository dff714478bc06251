"""Commands that analyse a study: `fit`, `optimize`, `sensitivity` and `thresholds`."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import (
    EXIT_FAILED_CELLS,
    EXIT_MISMATCH,
    at_option,
    cell_values,
    json_option,
    lash_option,
    nearest_values,
    output_option,
    path_argument,
    path_option,
    repeated_option,
    study_argument,
    workers_option,
)
from clunk.study.errors import ClunkError
from clunk.study.records import counted, fill, number, with_unit

if TYPE_CHECKING:
    from clunk.analysis.thresholds import Thresholds
    from clunk.study.study import Study


@click.command()
@study_argument
@path_argument("measurements")
@path_option("--plot", "picture", help="Also draw the measured labels on maps: .png .svg .pdf.")
@path_option("--write", "fitted_config", help="Also write the fitted config (.toml), to be swept.")
@lash_option
@workers_option
@json_option
def fit(
    config: Path,
    study: Study,
    measurements: Path,
    picture: Path | None,
    fitted_config: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Fit parameters of a driveline to measured labels.

    The parameters are the [[fit.parameters]] of CONFIG. MEASUREMENTS is a CSV file of measured labels, as for clunk
    compare, or table_4_1, the report's experiment. Prints how many labels are met, each parameter's estimate and
    interval, what the data leave undetermined, and how many labels are predicted from the other measurements.

    \b
    Example:
      clunk fit configs/fit_table_4_1.toml table_4_1 --plot rig.png \\
          --write rig.toml
    """
    import clunk
    from clunk.results import files
    from clunk.study.study import to_toml

    files.check(picture, files.PICTURES)
    files.check(fitted_config, (".toml",))
    terminal.warn(study)
    fitted = clunk.fit(study, measurements, progress=True, **options)
    tables.tell(fitted, as_json)
    for sentence in fitted.warnings:
        terminal.complain(f"warning: {sentence}")
    if fitted_config is not None:
        comment = f"# Fitted to {fitted.experiment.name}: {fitted.met} of {fitted.count} labels.\n"
        files.write_text(fitted_config, comment + to_toml(clunk.fitted_study(fitted)))
        terminal.say_written(fitted_config)
    if picture is not None:
        terminal.save_picture(clunk.draw(fitted), picture)


@click.command()
@study_argument
@output_option(help="Also write the config with the best values (.toml).")
@click.option("--front", "traded", metavar="QUANTITY", help="Also find optima under eight bounds on a quantity.")
@path_option("--plot", "picture", help="Draw the run before and after, or the front: .png .svg .pdf.")
@lash_option
@workers_option
@json_option
def optimize(
    config: Path,
    study: Study,
    output: Path | None,
    traded: str | None,
    picture: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Find the values of keys that make a quantity least.

    The table [optimize] of CONFIG says what is minimised, which conditions must hold, and which keys are free. With
    --front, each point of the trade-off is written as a config: -o FILE.toml gives FILE-1.toml and so on.

    \b
    Examples:
      clunk optimize configs/shaped_release.toml -o best.toml
      clunk optimize configs/car_release.toml --front severity --plot front.png
    """
    from clunk.analysis import optimisation
    from clunk.results import files
    from clunk.simulation.history import sample
    from clunk.simulation.trajectory import simulate
    from clunk.study.study import to_toml

    targets = [output]
    if output is not None and traded:
        targets = [output.with_stem(f"{output.stem}-{k}") for k in range(1, optimisation.FRONT + 1)]
    for target in targets:
        files.check(target, (".toml",))
    files.check(picture, files.PICTURES)
    terminal.warn(study)
    options["progress"] = True
    # run before the search, so that a config that cannot be run as it is fails at once
    drawn = [sample(simulate(study), name="as it is")] if picture and not traded else []
    interrupt = None
    try:
        found = optimisation.front(study, traded, **options) if traded else optimisation.optimize(study, **options)
    except KeyboardInterrupt as stopped:
        if not stopped.args:
            raise
        found, interrupt = stopped.args[0], stopped
    tables.tell(found, as_json)
    points = found.points if isinstance(found, optimisation.Front) else (found,)
    for target, best in zip(targets, points, strict=False):
        if target is not None:
            files.write_text(target, to_toml(best.study))
            terminal.say_written(target)
    if interrupt is not None:
        interrupt.add_note("the search was not finished; this is the best that it has found")
        raise interrupt
    if picture is not None:
        from clunk.plot import analyses, histories

        if isinstance(found, optimisation.Front):
            figure = analyses.trade_off(found)
        else:
            drawn.append(sample(simulate(found.study), name="best"))
            figure = histories.history_figure(drawn)
        terminal.save_picture(figure, picture)
    if not all(best.holds for best in points):
        sys.exit(EXIT_MISMATCH)


@click.command()
@study_argument
@at_option
@repeated_option(
    "--of",
    "quantities",
    metavar="QUANTITY",
    help="severity, approach_velocity, primary_impacts, touches, last_event_time, severity<=8000, nominal_label, "
    "double_sided, chatter or label=DS(1)SS(1), for example [severity and nominal_label]. May be repeated.",
)
@lash_option
@workers_option
@output_option(help="Also draw the indices: .png .svg .pdf.")
@json_option
def sensitivity(
    config: Path,
    study: Study,
    at: tuple[str, ...],
    quantities: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Tell from which tolerances the spread of an outcome comes.

    Takes the tolerances of CONFIG at one operating point. Prints first-order and total Sobol indices, that is each
    parameter's share of the variance, alone and with its interactions. They take n (d + 2) runs for d tolerances, where
    n is sweep.sampling.count, a power of two.

    \b
    Examples:
      clunk sensitivity configs/tolerance.toml --at load.ratio=5 \\
          --at lash.backlash_deg=6
      clunk sensitivity configs/tolerance.toml --of severity \\
          -o bars.png
    """
    from clunk.analysis import sobol
    from clunk.results import files
    from clunk.study.study import replace_values

    files.check(output, files.PICTURES)
    point = sobol.operating_point(replace_values(study, cell_values(study, at, all_needed=False)))
    terminal.warn(point)
    result = sobol.sensitivity(point, of=quantities, progress=True, **options)
    tables.tell(result, as_json)
    if output is not None:
        from clunk.plot.analyses import sobol_bars

        terminal.save_picture(sobol_bars(result), output)


def _numbers(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    """Parse numbers separated by commas; None where the option is not given."""
    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is no list of numbers such as 0.5,0.95.") from None


@click.command()
@study_argument
@click.option(
    "--along",
    required=True,
    metavar="KEY",
    help="The axis of CONFIG along which thresholds are looked for.",
)
@click.option(
    "--of",
    "outcome",
    default="label",
    metavar="OUTCOME",
    help="label, double_sided, chatter, label=DS(2), touches, primary_impacts, severity<=8000, approach_velocity<10, "
    "last_event_time<=0.5 and the like [label].",
)
@click.option(
    "--quantiles",
    metavar="SHARES",
    callback=_numbers,
    help="With tolerances: shares of the draws that have the same outcome, from 0.5 to 1 [0.5,0.95].",
)
@lash_option
@at_option
@workers_option
@output_option(help="Data (.csv .json), or a picture (.png .svg .pdf).")
@json_option
def thresholds(
    config: Path,
    study: Study,
    along: str,
    outcome: str,
    quantiles: tuple[float, ...] | None,
    at: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Locate the values of a key at which an outcome changes.

    Finds all of these thresholds, to 1e-9 of the key's axis, with the outcomes below and above each: in every cell of
    CONFIG's other axes, or only at the values that --at gives. With [[sweep.tolerances]], finds where the outcome is
    the same in 50 % and in 95 % of the drawn drivelines.

    \b
    Examples:
      clunk thresholds configs/shortest_ramp.toml --along load.duration \\
          --of double_sided
      clunk thresholds configs/largest_lash.toml --along lash.backlash_deg \\
          --of 'severity<=8000' -o lash.png
      clunk thresholds configs/tolerant_ramp.toml --along load.duration \\
          --of double_sided --quantiles 0.5,0.95,0.99
    """
    from clunk.analysis import thresholds as analysis
    from clunk.results import files
    from clunk.study.designs import nominal, with_axes_at

    _, axes = analysis.axes_of(study, along)
    swept = [axis for axis in axes if axis.parameter != analysis.DRAW]
    study = with_axes_at(study, nearest_values(swept, at, study))
    is_toleranced = study.swept.tolerances != ()
    if quantiles and not is_toleranced:
        raise ClunkError("--quantiles need [[sweep.tolerances]], and the config has none.")
    shares = quantiles or (0.5, 0.95)
    analysis.check_quantiles(shares)
    is_picture = output is not None and output.suffix.lower() in files.PICTURES
    files.check(output, (".csv", ".json", *files.PICTURES))
    if is_picture:
        from clunk.plot import analyses as plot

        plot.other_axis(analysis.axes_of(study, along)[1])
    terminal.warn(study)
    located = analysis.thresholds(study, along=along, of=outcome, progress=True, **options)
    result = analysis.threshold_quantiles(located, shares) if is_toleranced else located
    if as_json:
        tables.print_record(result.rows())
    else:
        print_thresholds(result)
    cells = "drawn cell" if is_toleranced else "cell"
    terminal.complain(
        f"{counted(located.value.size, 'threshold')} in {counted(located.lowest.size, cells)}, {located.runs:,} runs"
    )
    if output is not None and is_picture:
        without = analysis.thresholds(nominal(study), along=along, of=outcome, **options) if is_toleranced else None
        terminal.save_picture(plot.threshold_figure(result, without), output)
    elif output is not None:
        rows = json.dumps(result.rows(), ensure_ascii=False) + "\n"
        files.write_text(output, result.csv() if output.suffix.lower() == ".csv" else rows)
        terminal.say_written(output)
    if places := located.unresolved:
        cell, begin, end = places[0]
        where = "".join(f", {key} = {number(value)}" for key, value in located.at(cell).items())
        terminal.complain(
            f"note: in {counted(len(places), 'place')} {located.outcome.words} changes too often along {along} to be "
            f"followed; the first is from {begin:.10g} to {end:.10g}{where}"
        )
    for status, count in located.failures.items():
        terminal.complain(f"{counted(count, 'run')} failed: {status.sentence}")
    if located.failures:
        sys.exit(EXIT_FAILED_CELLS)


def print_thresholds(result: Thresholds) -> None:
    """Print a row for each threshold, with its value and the outcomes below and above."""
    from clunk.results.quantities import YES_NO

    along = result.along
    what = f"{'whether ' if result.outcome.type == YES_NO else ''}{result.outcome.heading_with_unit}"
    what += f", of {result.lash}" if result.lash else ""
    click.echo(fill(f"thresholds of {with_unit(along.parameter, along.unit)}, scanned from {along.spread}: {what}"))
    rows, offs = result.rows(), iter(result.off.tolist())
    for row in rows:
        value, text = row[along.parameter], "-"
        if value is not None:  # to as many digits as the threshold is located, at most ten
            share = max(next(offs) / abs(value or math.inf), 1e-9)
            text = f"{value:.{max(1 - math.floor(math.log10(share)), 1)}g}"
        row[along.parameter] = text
    tables.print_table(rows)
