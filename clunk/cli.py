"""The command line: parse, call the library, print. Data goes to stdout, everything else to stderr.

What a command needs is imported inside it, so that `--help` and `--version` wait for neither numba nor matplotlib.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from clunk import __version__

if TYPE_CHECKING:
    from clunk.config import Study
    from clunk.results import Results
    from clunk.simulation import Trajectory

EXIT_INTERNAL = 1
EXIT_USAGE = 2
EXIT_FAILED_CELLS = 3
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a key of the config, for example --set load.ratio=7. May be repeated.",
)
_json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for scripts.")


def main() -> NoReturn:
    """Entry point: runs the command and turns what a user can cause into one message and an exit code."""
    signal.signal(signal.SIGTERM, _terminate)
    try:
        cli.main(standalone_mode=False)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(EXIT_USAGE)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader of our output has gone, for example `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_INTERNAL)
    except Exception as error:
        if not _is_for_the_user(error):
            raise
        click.echo(str(error), err=True)
        sys.exit(EXIT_USAGE)
    sys.exit(0)


def _is_for_the_user(error: Exception) -> bool:
    """Whether an error's text was written for people; told by name, so that nothing is imported to ask."""
    names = {"ConfigError", "StoreError", "PlotError", "SweepError", "SimulationError"}
    return type(error).__module__.startswith("clunk.") and type(error).__name__ in names


def _terminate(_signal: int, _frame: object) -> NoReturn:
    click.echo("terminated", err=True)
    sys.exit(EXIT_TERMINATED)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 80})
@click.version_option(__version__, prog_name="clunk")
def cli() -> None:
    """Impact regime maps of drivelines with backlash.

    \b
    clunk init study.toml                     write a commented starter config
    clunk sweep configs/figure_3_4.toml       run its grid
    clunk plot results/figure_3_4.h5          draw the regime and severity maps
    """


@cli.command()
@click.argument("config", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Results file [results/CONFIG.h5].")
@_set_option
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads [one for each core].")
@click.option("--force", is_flag=True, help="Overwrite a results file of another config.")
@click.option("--restart", is_flag=True, help="Run again although the results file is complete.")
@_json_option
def sweep(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    workers: int | None,
    force: bool,
    restart: bool,
    as_json: bool,
) -> None:
    """Run the grid of CONFIG in parallel and write a results file.

    Example: clunk sweep configs/figure_3_4.toml --set solver.step=5e-5
    """
    from clunk.config import digest, load_study

    study = load_study(config, overrides)
    target = output or Path("results") / f"{config.stem}.h5"
    if _already_complete(target, digest(study), force=force, restart=restart):
        click.echo(f"{target} is already complete.", err=True)
        return
    _check_writable(target)
    results, seconds = _run_sweep(study, workers)

    from clunk.store import write

    write(target, results)
    _report_sweep(results, target, seconds, as_json)
    if results.counts()["failed"]:
        sys.exit(EXIT_FAILED_CELLS)


def _already_complete(target: Path, config_digest: str, *, force: bool, restart: bool) -> bool:
    """Whether `target` holds this very sweep; whatever else is there is refused unless forced."""
    if not target.exists():
        return False
    if target.is_dir():
        raise click.ClickException(f"{target} is a directory; -o names a file.")
    if force:
        return False
    from clunk.store import StoreError, read_header

    try:
        header = read_header(target)
    except StoreError as error:
        raise click.ClickException(f"{error} It is in the way of the results; --force overwrites it.") from error
    if header.config_digest != config_digest:
        raise click.ClickException(
            f"{target} holds the results of another config ({header.title!r}). "
            "Name another file with -o, or overwrite it with --force."
        )
    return not restart


def _check_writable(target: Path) -> None:
    """Find out before the work, not after it, that the results have nowhere to go."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise click.ClickException(f"The directory {target.parent} cannot be made: {error.strerror}.") from error
    if not os.access(target.parent, os.W_OK):
        raise click.ClickException(f"The directory {target.parent} is not writable.")


def _run_sweep(study: Study, workers: int | None) -> tuple[Results, float]:
    import clunk.sweeping as sweeping

    total = sweeping.cell_count(study)
    _say_if_compiling()
    began = time.perf_counter()
    try:
        with _progress(total) as progress:
            results = sweeping.sweep(study, workers=workers, progress=progress)
    except KeyboardInterrupt:
        click.echo("interrupted: the sweep has stopped, and no results file was written", err=True)
        sys.exit(EXIT_INTERRUPTED)
    return results, time.perf_counter() - began


def _say_if_compiling() -> None:
    from clunk.core.jit import is_cold

    if is_cold():
        click.echo("compiling the kernel, once for this installation (about 15 s) …", err=True)


@contextmanager
def _progress(total: int) -> Iterator[Callable[[int, int], None]]:
    """A progress bar with rate and time left on a terminal, a line now and then elsewhere; both on stderr."""
    if not sys.stderr.isatty():
        yield _plain_progress()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("cells  {task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=total, rate="")
        began = time.perf_counter()

        def update(done: int, _total: int) -> None:
            rate = done / max(time.perf_counter() - began, 1e-9)
            bar.update(task, completed=done, rate=f"{rate:,.0f}/s ")

        yield update


def _plain_progress(every: float = 5.0) -> Callable[[int, int], None]:
    began = last = time.perf_counter()

    def update(done: int, total: int) -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last < every or done == total:
            return
        last = now
        rate = done / (now - began)
        left = (total - done) / rate
        click.echo(f"{done:,} of {total:,} cells, {rate:,.0f}/s, {left:.0f} s left", err=True)

    return update


def _report_sweep(results: Results, target: Path, seconds: float, as_json: bool) -> None:
    counts = results.counts()
    cells = results.sequence.size
    if as_json:
        summary = {"file": str(target), "cells": cells, "seconds": round(seconds, 3), "counts": counts}
        click.echo(json.dumps(summary, ensure_ascii=False))
    else:
        _print_counts(counts)
    click.echo(f"{cells:,} cells in {seconds:.1f} s ({cells / seconds:,.0f} runs/s) -> {target}", err=True)
    if counts["failed"]:
        _report_failures(results)


def _report_failures(results: Results) -> None:
    """Failed cells by cause, and where the first few are."""
    import numpy as np

    from clunk.core.status import Status

    for status in Status:
        cells = np.argwhere(results.status == status)
        if status == Status.OK or cells.size == 0:
            continue
        click.echo(f"{len(cells):,} cells failed: {status.sentence}", err=True)
        for cell in cells[:3]:
            where = ", ".join(
                f"{axis.parameter} = {axis.values[k]:.6g}" for axis, k in zip(results.axes, cell, strict=True)
            )
            click.echo(f"  at {where}", err=True)
        if len(cells) > 3:
            click.echo(f"  and {len(cells) - 3:,} more", err=True)


def _print_counts(counts: dict[str, int]) -> None:
    total = sum(counts.values())
    width = max(len(label) for label in counts)
    for label, count in counts.items():
        if label != "failed" or count:
            click.echo(f"{label:<{width}}  {count:>9,} cells  {count / total:6.1%}")


@cli.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Picture: .png, .svg or .pdf [FILE.png].")
@click.option("--quantity", metavar="NAME", help="One picture only: regimes, severity, approach_velocity, touches, …")
def plot(file: Path, output: Path | None, quantity: str | None) -> None:
    """Draw the maps of a results file: the regimes and their severity.

    Example: clunk plot results/figure_3_4.h5 -o figure.svg
    """
    from clunk import plot as plots
    from clunk.store import read

    results = read(file)
    base = output or file.with_suffix(".png")
    if not base.suffix:
        base = base.with_name(base.name + ".png")
    for name in [quantity] if quantity else _default_quantities(results):
        target = base if output and quantity else base.with_name(f"{base.stem}-{name}{base.suffix}")
        plots.save(plots.draw(results, name, _thresholds(results)), target)
        click.echo(str(target))


def _default_quantities(results: Results) -> list[str]:
    """The regimes and how hard the impacts are; Q is not defined for the restitution model, V is.

    A single axis has its labels in the same picture as the curve.
    """
    import numpy as np

    hardness = "severity" if np.isfinite(results.severity).any() else "approach_velocity"
    return ["regimes", hardness] if sum(count > 1 for count in results.shape) > 1 else [hardness]


def _thresholds(results: Results) -> list[float]:
    """Load ratios at which one more impact appears as the backlash vanishes, where the map has such an axis."""
    if all(axis.parameter != "load.ratio" for axis in results.axes):
        return []
    from clunk.config import study_from_text
    from clunk.linear import one_mode_thresholds

    study = study_from_text(results.config, source="the results file's config")
    return [float(ratio) for ratio in one_mode_thresholds(study)]


@cli.command()
@click.argument("source", type=click.Path(path_type=Path))
@_set_option
@click.option("--at", "at", multiple=True, metavar="KEY=VALUE", help="Value of a swept key. May be repeated.")
@_json_option
def simulate(source: Path, overrides: tuple[str, ...], at: tuple[str, ...], as_json: bool) -> None:
    """Run one load step and print its events, primary impacts and label.

    SOURCE is a config, or a results file of which --at names the cell.

    \b
    Examples:
      clunk simulate configs/nominal.toml --set load.ratio=7
      clunk simulate results/figure_3_4.h5 --at load.ratio=5 --at lash.backlash_deg=6
    """
    from clunk.config import load_study, replace_values, study_from_text
    from clunk.simulation import simulate as run

    if source.suffix == ".h5":
        from clunk.store import read_header

        if overrides:
            raise click.UsageError("--set changes a config; a cell of a results file is named by --at.")
        study = study_from_text(read_header(source).config, source=f"the config in {source}")
    else:
        study = load_study(source, overrides)
    values = _cell_values(study, at)
    study = replace_values(study.model_copy(update={"sweep": None}), values)
    _say_if_compiling()
    trajectory = run(study)
    if as_json:
        click.echo(json.dumps(_as_record(trajectory), ensure_ascii=False))
    else:
        _print_trajectory(trajectory)


def _cell_values(study: Study, at: tuple[str, ...]) -> dict[str, float]:
    """The swept keys' values named by --at, each taken to the axis's nearest one."""
    import numpy as np

    axes = {axis.parameter: axis.grid for axis in study.sweep.axes} if study.sweep else {}
    values: dict[str, float] = {}
    for assignment in at:
        key, _, text = assignment.partition("=")
        key = key.strip()
        if key not in axes:
            known = ", ".join(axes) or "nothing"
            raise click.UsageError(f"--at {assignment}: {key!r} is not swept; swept here: {known}.")
        try:
            wanted = float(text)
        except ValueError:
            raise click.UsageError(f"--at {assignment}: {text!r} is not a number.") from None
        values[key] = float(axes[key][np.argmin(np.abs(axes[key] - wanted))])
        if not np.isclose(values[key], wanted, rtol=1e-9, atol=0.0):
            click.echo(f"{key} = {values[key]:.6g} is the nearest value of its axis", err=True)
    missing = [key for key in axes if key not in values]
    if missing and at:
        raise click.UsageError("Which cell? Also give " + " ".join(f"--at {key}=…" for key in missing) + ".")
    if missing:
        raise click.UsageError(
            "This is a sweep; name one of its cells, for example "
            + " ".join(f"--at {key}={axes[key][len(axes[key]) // 2]:.6g}" for key in missing)
        )
    return values


def _print_trajectory(trajectory: Trajectory) -> None:
    primaries = {int(k): i for i, k in enumerate(trajectory.primaries)}
    click.echo("   time [s]  event       flank     q' [rad/s]  impact     Qi [rad/s²]")
    for k, event in enumerate(trajectory.events):
        if k == 0:
            continue
        kind = trajectory.kind_name(k)
        impact, severity = "", ""
        if kind == "touch":
            impact = "primary" if k in primaries else "secondary"
        if k in primaries:
            severity = f"{trajectory.impact_severity[primaries[k]]:.1f}"
        line = f"{event['time']:11.7f}  {kind:<10}  {trajectory.flank_name(k):<8}  {event['speed']:+10.6f}"
        click.echo(f"{line}  {impact:<9}  {severity:>11}".rstrip())
    ending = "nothing can follow" if trajectory.complete else "the end time; more may follow"
    click.echo(f"{trajectory.end:11.7f}  end: {ending}")
    click.echo()
    click.echo(f"events            {len(trajectory.events) - 1}, {trajectory.touches} of them touches")
    click.echo(f"primary impacts   {trajectory.letters or 'none'}")
    click.echo(f"label             {trajectory.label}")
    click.echo(f"severity Q        {trajectory.severity:.1f} rad/s²")
    click.echo(f"approach speed V  {trajectory.approach_velocity:.5f} rad/s")


def _as_record(trajectory: Trajectory) -> dict[str, Any]:
    primaries = set(trajectory.primaries.tolist())
    return {
        "label": trajectory.label,
        "severity": trajectory.severity,
        "approach_velocity": trajectory.approach_velocity,
        "impact_severity": trajectory.impact_severity.tolist(),
        "complete": trajectory.complete,
        "end": trajectory.end,
        "events": [
            {
                "time": float(event["time"]),
                "event": trajectory.kind_name(k),
                "flank": trajectory.flank_name(k),
                "speed": float(event["speed"]),
                "primary": k in primaries,
            }
            for k, event in enumerate(trajectory.events)
            if k > 0
        ],
    }


@cli.command()
@click.argument("config", type=click.Path(path_type=Path))
@_set_option
@_json_option
def modes(config: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Print natural frequencies, damping ratios and small-gap thresholds.

    Example: clunk modes configs/nominal.toml
    """
    from clunk.config import load_study
    from clunk.driveline import Driveline
    from clunk.linear import one_mode_thresholds, rigid_contact_thresholds

    study = load_study(config, overrides)
    driveline = Driveline.from_study(study)
    lash_states = {"closed": driveline.modes(closed=True), "open": driveline.modes(closed=False)}
    thresholds = {"lowest mode": one_mode_thresholds(study), "all modes": rigid_contact_thresholds(study)}
    if as_json:
        record: dict[str, Any] = {
            state: {
                "frequency_hz": found.frequency.tolist(),
                "damping_ratio": found.damping_ratio.tolist(),
                "decay_rate_per_s": found.overdamped.tolist(),
            }
            for state, found in lash_states.items()
        }
        record["thresholds"] = {name: ratios.tolist() for name, ratios in thresholds.items()}
        click.echo(json.dumps(record | {"contact_period": driveline.contact_period}))
        return
    for state, found in lash_states.items():
        click.echo(f"lash {state}")
        click.echo("  mode  frequency [Hz]  damping ratio ζ [-]")
        for k, (frequency, ratio) in enumerate(zip(found.frequency, found.damping_ratio, strict=True), 1):
            click.echo(f"  {k:>4}  {frequency:>14.1f}  {ratio:>19.3f}")
        for rate in found.overdamped:
            click.echo(f"     -  does not oscillate; {f'decays at {rate:.4g} 1/s' if rate > 0.0 else 'drifts'}")
        click.echo()
    click.echo(f"contact period T_c  {1e3 * driveline.contact_period:.2f} ms")
    click.echo()
    click.echo("load ratio σr above which one more impact appears as the backlash vanishes")
    click.echo("  impacts       " + "".join(f"{n:>8}" for n in range(1, 5)))
    for name, ratios in thresholds.items():
        click.echo(f"  {name:<14}" + "".join(f"{ratio:>8.2f}" for ratio in ratios))
    click.echo("(lowest mode: σr = exp(2π ζ1 (n - 1/2)); all modes: with the lash locked)")


@cli.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--config", "show_config", is_flag=True, help="Print the whole resolved config (TOML) instead.")
@_json_option
def info(file: Path, show_config: bool, as_json: bool) -> None:
    """Say what a results file holds: config, versions, regime counts.

    Example: clunk info results/figure_3_4.h5
    """
    from clunk.store import read_header

    header = read_header(file)
    if show_config:
        click.echo(header.config, nl=not header.config.endswith("\n"))
        return
    if as_json:
        axes = [
            {"parameter": a.parameter, "unit": a.unit, "start": float(a.values[0]), "stop": float(a.values[-1])}
            | {"count": len(a.values)}
            for a in header.axes
        ]
        record = {"title": header.title, "axes": axes, "counts": header.counts, "config_digest": header.config_digest}
        click.echo(json.dumps(record | header.attributes, ensure_ascii=False))
        return
    click.echo(header.title)
    click.echo()
    for axis in header.axes:
        span = f"{axis.values[0]:g} to {axis.values[-1]:g}"
        unit = "" if axis.unit == "1" else f" {axis.unit}"
        click.echo(f"axis      {axis.parameter}: {span}{unit}, {len(axis.values)} values")
    click.echo(f"config    {header.config_digest[:16]}…")
    for name, value in header.attributes.items():
        click.echo(f"{name.removesuffix('_version'):<9} {value}")
    click.echo()
    _print_counts(header.counts)


@cli.command()
@click.argument("path", type=click.Path(path_type=Path), default="clunk.toml")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def init(path: Path, force: bool) -> None:
    """Write a commented starter config to PATH [clunk.toml]; - prints it.

    Example: clunk init study.toml
    """
    from importlib.resources import files

    text = files("clunk.presets").joinpath("starter.toml").read_text(encoding="utf-8")
    if str(path) == "-":
        click.echo(text, nl=False)
        return
    if path.exists() and not force:
        raise click.ClickException(f"{path} exists; --force overwrites it.")
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{path} cannot be written: {error.strerror}.") from error
    click.echo(f"wrote {path}; next: clunk sweep {path}", err=True)
