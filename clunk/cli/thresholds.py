"""`clunk thresholds`: the values of a swept key at which an outcome changes."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import completion, tables, terminal
from clunk.cli.options import (
    EXIT_FAILED_CELLS,
    PATH,
    at_option,
    json_option,
    lash_option,
    nearest_values,
    set_option,
    workers_option,
)
from clunk.study.errors import ClunkError
from clunk.study.records import counted, fill, number

if TYPE_CHECKING:
    from clunk.analysis.thresholds import Thresholds


def _numbers(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    """Numbers separated by commas."""
    try:
        return None if text is None else tuple(float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is no list of numbers such as 0.5,0.95.") from None


@click.command()
@click.argument("config", type=PATH)
@click.option(
    "--along",
    required=True,
    metavar="KEY",
    shell_complete=completion.swept,
    help="The axis of CONFIG along which they are looked for.",
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
@set_option
@at_option
@workers_option
@click.option("-o", "--output", type=PATH, help="Data (.csv .json), or a picture (.png .svg .pdf).")
@json_option
def thresholds(
    config: Path,
    along: str,
    outcome: str,
    quantiles: tuple[float, ...] | None,
    overrides: tuple[str, ...],
    at: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Locate the values of a key at which an outcome changes.

    Finds all of them, to 1e-9 of the key's axis, for every cell of CONFIG's other axes or where --at says, with the
    outcomes below and above each. With [[sweep.tolerances]]: where the outcome is the same in 50 % and in 95 % of the
    drawn drivelines.

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
    from clunk.analysis.thresholds import check_quantiles, threshold_quantiles
    from clunk.results import files
    from clunk.results.files import write_text
    from clunk.study.config import load_study
    from clunk.study.designs import has_tolerances, nominal, with_axes_at

    study = load_study(config, overrides)
    _, axes = analysis.axes_of(study, along)
    if at:
        study = with_axes_at(study, nearest_values([axis for axis in axes if axis.parameter != analysis.DRAW], (), at))
    is_toleranced = has_tolerances(study)
    if quantiles and not is_toleranced:
        raise ClunkError("--quantiles need [[sweep.tolerances]], and the config has none.")
    shares = quantiles or (0.5, 0.95)
    check_quantiles(shares)
    is_picture = output is not None and output.suffix.lower() in files.PICTURES
    if output is not None:
        files.check(output, (".csv", ".json", *files.PICTURES), reads=config)
    if is_picture:
        from clunk.plot import analyses as plot

        plot.other_axis(analysis.axes_of(study, along)[1])
    terminal.warn_of_coarse_step(study, study.solver.method)
    located = analysis.thresholds(study, along=along, of=outcome, progress=True, **options)
    result = threshold_quantiles(located, shares) if is_toleranced else located
    if as_json:
        tables.print_record(result.cells())
    else:
        print_thresholds(result)
    cells = "drawn cell" if is_toleranced else "cell"
    found = f"{counted(located.value.size, 'threshold')} in {counted(located.lowest.size, cells)}"
    click.echo(f"{found}, {located.runs:,} runs", err=True)
    if output is not None and is_picture:
        if is_toleranced:
            undrawn = analysis.thresholds(nominal(study), along=along, of=outcome, **options)
            figure = plot.threshold_figure(result, undrawn)
        else:
            figure = plot.threshold_figure(located)
        terminal.save_picture(figure, output)
    elif output is not None:
        is_csv = output.suffix.lower() == ".csv"
        text = result.csv() if is_csv else json.dumps(result.cells(), ensure_ascii=False) + "\n"
        write_text(output, text)
        terminal.say_written(output)
    if places := located.unresolved:
        cell, begin, end = places[0]
        where = "".join(f", {key} = {number(value)}" for key, value in located.at(cell).items())
        terminal.complain(
            f"note: in {counted(len(places), 'place')} {located.outcome.words} changes too often along {along} to be "
            f"followed; the first is from {begin:.10g} to {end:.10g}{where}"
        )
    for status, count in located.failures.items():
        terminal.complain(f"{count:,} runs failed: {status.sentence}")
    if located.failures:
        sys.exit(EXIT_FAILED_CELLS)


def print_thresholds(result: Thresholds) -> None:
    """Print a row for each threshold, with its value and the outcomes below and above."""
    from clunk.results.quantities import YES_NO

    along = result.along
    unit = "" if along.unit == "1" else f" [{along.unit}]"
    what = f"{'whether ' if result.outcome.type == YES_NO else ''}{result.outcome.heading_with_unit}"
    what += f" of {result.lash}" if result.lash else ""
    click.echo(fill(f"thresholds of {along.parameter}{unit}, scanned from {along.spread}: {what}"))
    if not result.value.size:
        words = " or ".join(sorted({row["below"] for row in result.rows()}))
        click.echo(f"none, it never changes along {along.parameter}: {words}")
        return
    values = [math.nan if row[along.parameter] is None else row[along.parameter] for row in result.rows()]
    rows = [row | {along.parameter: number(value, ".10g")} for row, value in zip(result.rows(), values, strict=True)]
    tables.print_table(rows)
