"""`clunk sensitivity`: Sobol indices of tolerances."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import cells, phrases, tables, terminal
from clunk.cli.options import PATH, at_option, json_option, lash_option, set_option, workers_option
from clunk.sweeping import progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clunk.analysis.sobol import Indices, Sensitivity
    from clunk.study.study import Study
    from clunk.study.sweeps import Draw


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
    lash: str | None,
    workers: int | None,
    output: Path | None,
    as_json: bool,
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
    from clunk.results import targets
    from clunk.study.config import load_study
    from clunk.study.lashes import lash_position
    from clunk.study.study import replace_values

    study = load_study(config, overrides)
    if output is not None:
        targets.check(output, targets.PICTURES, reads=config)
    lash_position(lash, study.lash_names)
    point = sobol.operating_point(replace_values(study, cells.cell_values(study, at, all_needed=False)))
    terminal.warm_up(point, "drawn")
    began = time.perf_counter()
    with progress.shown(sobol.run_count(point), "runs") as show:
        result = sobol.sensitivity(point, of=quantities, lash=lash, workers=workers, progress=show)
    seconds = time.perf_counter() - began
    if as_json:
        tables.print_record(as_record(result))
    else:
        print_sensitivity(result)
    draws = len(result.parameters)
    what = f"{result.runs:,} runs, {result.samples:,} samples x ({draws} parameters + 2), in {seconds:.1f} s"
    click.echo(f"{what} ({result.runs / seconds:,.0f} runs/s)", err=True)
    if output is not None:
        from clunk.plot.indices import sobol_bars

        terminal.save_picture(sobol_bars(result), output)


def print_sensitivity(result: Sensitivity) -> None:
    """Print the distributions, the labels' shares and every quantity's Sobol indices by falling total index."""
    width = max(len(parameter) for parameter in result.parameters)
    for draw in result.draws:
        line = f"{draw.parameter:<{width}}  {_distribution(result.study, draw)}"
        click.echo(phrases.fill(line, rest=" " * (width + 2)))
    click.echo()
    click.echo(f"operating point     {', '.join(f'{key} = {value:g}' for key, value in result.at.items())}")
    hardness = (
        f"V {result.approach_velocity:.5f} rad/s" if math.isnan(result.severity) else f"Q {result.severity:.1f} rad/s²"
    )
    click.echo(f"without tolerances  {result.label}, {hardness}")
    wide = max(len(label) for label in result.labels)
    runs = 2 * result.samples
    for k, (label, share) in enumerate(result.labels.items()):
        part = phrases.share(round(share * runs), runs)
        click.echo(f"{'with tolerances' if k == 0 else '':<18}  {label:<{wide}}  {part:>10}")
    for indices in result.indices:
        click.echo()
        _print_indices(indices, result.parameters, width)


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


def _distribution(study: Study, draw: Draw) -> str:
    """A parameter's distribution, for example 409200 N/m times normal (mean 1, std 0.05)."""
    from clunk.study.parameters import nominal_value, quantity

    nominal = nominal_value(study, draw.parameter)
    listed = ", ".join(f"{name} {value:g}" for name, value in draw.numbers(nominal).items())
    unit = quantity(draw.parameter).unit
    suffix = "" if unit == "1" else f" {unit}"
    drawn = f"{draw.distribution} ({listed})"
    if draw.draws == "value":
        return drawn + suffix
    return f"{nominal:g}{suffix} {'times' if draw.draws == 'factor' else 'plus'} {drawn}"


def as_record(result: Sensitivity) -> dict[str, Any]:
    """Sobol indices for JSON; NaN where something is not defined."""
    from clunk.analysis.sobol import CONFIDENCE
    from clunk.study.parameters import nominal_value
    from clunk.study.study import digest

    assert result.study.sweep is not None
    sampling = result.study.sweep.sampling
    return {
        "title": result.study.title,
        "config_digest": digest(result.study),
        "at": result.at,
        "parameters": [
            draw.model_dump(exclude_none=True) | {"nominal": nominal_value(result.study, draw.parameter)}
            for draw in result.draws
        ],
        "samples": result.samples,
        "sampling": sampling.method,
        "seed": sampling.seed,
        "runs": result.runs,
        "nominal": {"label": result.label, "severity": result.severity, "approach_velocity": result.approach_velocity},
        "labels": result.labels,
        "confidence": CONFIDENCE,
        "quantities": {each.quantity: _indices_record(each, result.parameters) for each in result.indices},
    }


def _indices_record(indices: Indices, parameters: Sequence[str]) -> dict[str, Any]:
    from clunk.analysis.sobol import QUANTILES

    of_parameter = {
        parameter: {
            "first": float(indices.first[k]),
            "first_interval": indices.first_interval[:, k].tolist(),
            "total": float(indices.total[k]),
            "total_interval": indices.total_interval[:, k].tolist(),
        }
        for k, parameter in enumerate(parameters)
    }
    return {
        "nominal": indices.nominal,
        "mean": indices.mean,
        "std": indices.std,
        "quantiles": {f"{q:g}": float(value) for q, value in zip(QUANTILES, indices.quantiles, strict=True)},
        "indices": of_parameter if indices.varies else None,
    }
