"""`clunk sensitivity`: Sobol indices of tolerances."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.cli import cells, phrases, tables, terminal
from clunk.cli.options import PATH, at_option, json_option, set_option, workers_option
from clunk.sweeping import progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clunk.analysis.sobol import Indices, Sensitivity


@click.command()
@click.argument("config", type=PATH)
@set_option
@at_option
@click.option(
    "--of",
    "quantities",
    multiple=True,
    metavar="QUANTITY",
    help="severity, approach_velocity, primary_impacts, touches, last_event_time, nominal_label, double_sided or "
    "label=DS(1)SS(1), for example [severity and nominal_label]. May be repeated.",
)
@workers_option
@click.option("-o", "--output", type=PATH, help="Also draw the indices: .png .svg .pdf.")
@json_option
def sensitivity(
    config: Path,
    overrides: tuple[str, ...],
    at: tuple[str, ...],
    quantities: tuple[str, ...],
    workers: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Tell which of CONFIG's tolerances the spread at one operating point comes from.

    Prints first-order and total Sobol indices, from n (d + 2) runs for d tolerances; n is sweep.sampling.count, a power
    of two.

    \b
    Examples:
      clunk sensitivity tolerances.toml --set sweep.sampling.count=4096
      clunk sensitivity tolerances.toml --of severity --of double_sided -o bars.png
    """
    from clunk.analysis import sobol
    from clunk.results import targets
    from clunk.study.config import load_study, replace_values
    from clunk.study.designs import unused_parameters
    from clunk.sweeping.cells import warm_up

    study = load_study(config, overrides)
    if output is not None:
        targets.check(output, targets.PICTURES, reads=config)
    point = sobol.operating_point(replace_values(study, cells.cell_values(study, at, all_needed=False)))
    terminal.warn_of_coarse_step(point, point.solver.method)
    for parameter in unused_parameters(point):
        click.echo(f"note: {parameter} is drawn, but changes nothing in this model", err=True)
    terminal.say_if_compiling(point.solver.method)
    warm_up(point)
    began = time.perf_counter()
    with progress.shown(sobol.run_count(point), "runs") as show:
        found = sobol.sensitivity(point, of=quantities, workers=workers, progress=show)
    seconds = time.perf_counter() - began
    if as_json:
        tables.print_record(found.record())
    else:
        print_sensitivity(found)
    draws = len(found.parameters)
    what = f"{found.runs:,} runs, {found.samples:,} samples x ({draws} parameters + 2), in {seconds:.1f} s"
    click.echo(f"{what} ({found.runs / seconds:,.0f} runs/s)", err=True)
    if output is not None:
        from clunk.plot.indices import sobol_bars

        terminal.save_picture(sobol_bars(found), output)


def print_sensitivity(found: Sensitivity) -> None:
    """What is drawn and what came of it, then every quantity's Sobol indices by falling total index."""
    from clunk.analysis.sobol import distribution_phrase

    width = max(len(parameter) for parameter in found.parameters)
    for draw in found.draws:
        line = f"{draw.parameter:<{width}}  {distribution_phrase(found.study, draw)}"
        click.echo(phrases.fill(line, others=" " * (width + 2)))
    click.echo()
    click.echo(f"operating point     {', '.join(f'{key} = {value:g}' for key, value in found.at.items())}")
    hardness = (
        f"V {found.approach_velocity:.5f} rad/s" if math.isnan(found.severity) else f"Q {found.severity:.1f} rad/s²"
    )
    click.echo(f"without tolerances  {found.label}, {hardness}")
    wide = max(len(label) for label in found.labels)
    for k, (label, share) in enumerate(found.labels.items()):
        count = round(share * 2 * found.samples)
        click.echo(
            f"{'with tolerances' if k == 0 else '':<18}  {label:<{wide}}  {phrases.share(count, 2 * found.samples):>10}"
        )
    for indices in found.indices:
        click.echo()
        _print_indices(indices, found.parameters, width)


def _print_indices(indices: Indices, parameters: Sequence[str], width: int) -> None:
    from clunk.analysis.sobol import CONFIDENCE, QUANTILES

    click.echo(indices.heading)
    if not indices.varies:
        value = ("always" if indices.mean else "never") if indices.is_indicator else f"always {indices.mean:.6g}"
        click.echo(f"{value}: there is no variance to divide")
        return
    if indices.is_indicator:
        click.echo(f"in {100 * indices.mean:.2f} % of the runs")
    else:
        click.echo(f"mean {indices.mean:.6g}, standard deviation {indices.std:.4g}")
        quantiles = (f"{100 * q:g} %: {value:.6g}" for q, value in zip(QUANTILES, indices.quantiles, strict=True))
        click.echo(f"quantiles {', '.join(quantiles)}")
    interval = f"[{100 * CONFIDENCE:g} %]"
    heads = f"{f' alone, S {interval}':<23}   in all, ST {interval}"
    click.echo(f"{'share of the variance':<{width}}  {heads}")
    for k in indices.order:
        first = _with_interval(indices.first[k], *indices.first_interval[:, k])
        total = _with_interval(indices.total[k], *indices.total_interval[:, k])
        click.echo(f"{parameters[k]:<{width}}  {first:<23}  {total}")


def _with_interval(value: float, low: float, high: float) -> str:
    value, low, high = (round(number, 3) + 0.0 for number in (value, low, high))  # no -0.000
    return f"{value:6.3f} [{low:.3f}, {high:.3f}]"
