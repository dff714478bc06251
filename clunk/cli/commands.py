"""The command line: parse, call the library, print. Data goes to stdout, everything else to stderr.

What a command needs is imported inside it, so that `--help` and `--version` wait for neither numba nor matplotlib.
"""

from __future__ import annotations

import io
import json
import os
import re
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from clunk import __version__
from clunk.cli import terminal
from clunk.study.errors import ClunkError
from clunk.sweeping import progress

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from clunk.results.tolerancemap import ToleranceMap
    from clunk.simulation.trajectory import Trajectory
    from clunk.study.axes import ResultAxis
    from clunk.study.config import Study
    from clunk.sweeping.engines import Engine
    from clunk.sweeping.output import Output

EXIT_INTERNAL = 1
EXIT_USAGE = 2
EXIT_FAILED_CELLS = 3
EXIT_MISMATCH = 4
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

_FEWEST_STEPS = 10  # a period of the fastest oscillation

_set_option = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY=VALUE",
    help="Override a key of the config, for example --set load.ratio=7. May be repeated.",
)
_at_option = click.option(
    "--at", "at", multiple=True, metavar="KEY=VALUE", help="Value of a swept key. May be repeated."
)
_json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON for scripts.")


def main() -> NoReturn:
    """Entry point: runs the command and turns what a user can cause into one message and an exit code."""
    signal.signal(signal.SIGTERM, _terminate)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without σ shows a ? instead of a traceback
    try:
        cli.main(standalone_mode=False)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "clunk"
        terminal.complain(f"{error.format_message()}\nTry '{command} --help'.")
        sys.exit(EXIT_USAGE)
    except click.ClickException as error:
        terminal.complain(error.format_message())
        sys.exit(EXIT_USAGE)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    except BrokenPipeError:  # the reader of our output has gone, for example `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(EXIT_INTERNAL)
    except ClunkError as error:
        terminal.complain(str(error))
        sys.exit(EXIT_USAGE)
    sys.exit(0)


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
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads, or local processes [one for each core].")
@click.option("--scheduler", metavar="ADDRESS", help="Run on dask workers: tcp://HOST:8786, or local.")
@click.option("--force", is_flag=True, help="Overwrite a results file of another config.")
@click.option("--restart", is_flag=True, help="Begin anew: neither go on with a stopped sweep nor keep a finished one.")
@click.option("--refine", is_flag=True, help="Run only where labels change, and infer the other cells' labels.")
@click.option(
    "--retry-failed", is_flag=True, help="Run the failed cells of the finished file again; [solver] may differ."
)
@_json_option
def sweep(
    config: Path,
    output: Path | None,
    overrides: tuple[str, ...],
    workers: int | None,
    scheduler: str | None,
    force: bool,
    restart: bool,
    refine: bool,
    retry_failed: bool,
    as_json: bool,
) -> None:
    """Run the grid of CONFIG in parallel and write a results file.

    Stopped by whatever, the same command goes on where it was.

    \b
    Examples:
      clunk sweep configs/figure_3_4.toml --set solver.step=5e-5
      clunk sweep configs/figure_3_4.toml --refine -o refined.h5
      clunk sweep configs/figure_3_4.toml --retry-failed --set solver.max_events=4096
      clunk sweep configs/figure_3_4.toml --scheduler tcp://localhost:8786
    """
    if retry_failed and (refine or force):
        raise click.UsageError("--retry-failed goes with neither --refine nor --force.")
    from clunk.results import targets
    from clunk.study.config import load_study

    study = load_study(config, overrides)
    tolerances = study.sweep is not None and bool(study.sweep.tolerances)
    if tolerances and (refine or retry_failed):
        option = "--refine" if refine else "--retry-failed"
        raise click.UsageError(f"{option} does not go with [[sweep.tolerances]]: every cell has its own probabilities.")
    target = output or Path("results") / f"{config.stem}.h5"
    targets.check(target, targets.RESULTS, reads=config)
    from clunk.sweeping.output import engine_of, opened

    opening = engine_of(scheduler, workers, say=lambda text: click.echo(text, err=True))
    with opened(target, study, refine=refine, retry=retry_failed, restart=restart, force=force) as output_file:
        counts = output_file.counts
        if counts is not None:
            click.echo(f"{target} {'has no failed cells' if retry_failed else 'is already complete'}.", err=True)
            if tolerances:
                from clunk.results import tolerancefile

                failed = _report_tolerances(tolerancefile.read(target), target, 0.0, as_json)
            else:
                failed = _report_counts(counts, target, 0.0, as_json)
        else:
            failed = _sweep_into(output_file, opening, as_json)
    if failed:
        sys.exit(EXIT_FAILED_CELLS)


def _sweep_into(output: Output, opening: AbstractContextManager[Engine], as_json: bool) -> int:
    """Run, write, report; how many cells, or runs of a tolerance map, have failed."""
    import clunk.sweeping.sweep as sweeping
    from clunk.results.tolerancemap import ToleranceMap
    from clunk.sweeping.engines import EngineError

    study, target, parts, earlier = output.study, output.path, output.parts, output.earlier
    total = sweeping.cell_count(study)
    _warn_of_coarse_step(study, study.solver.method)
    for parameter in sweeping.unused_parameters(study):
        click.echo(f"note: {parameter} is swept, but changes nothing in this model", err=True)
    _say_if_compiling(study.solver.method)
    sweeping.warm_up(study)
    known, ran = 0 if earlier is None else total - earlier.counts()["failed"], 0
    told = False
    try:
        with opening as engine, progress.shown(total) as show:
            began = time.perf_counter()

            def tell(done: int, total: int) -> None:
                nonlocal ran, told
                if not told:
                    terminal.report_resumed(parts.taken_up, parts.discarded)
                told, ran = True, done - known
                show(done, total)

            results = output.run(engine=engine, progress=tell)
    except (KeyboardInterrupt, SystemExit, EngineError) as stopped:
        if isinstance(stopped, EngineError):
            terminal.complain(str(stopped))
        terminal.complain(f"stopped: {output.kept}")
        if isinstance(stopped, SystemExit):
            raise
        if isinstance(stopped, EngineError):
            sys.exit(EXIT_USAGE)
        click.echo("interrupted", err=True)
        sys.exit(EXIT_INTERRUPTED)
    seconds = time.perf_counter() - began
    output.save(results)
    if isinstance(results, ToleranceMap):
        failed = _report_tolerances(results, target, seconds, as_json)
        terminal.report_speed(total, ran, parts.taken_up, seconds, target, draws=results.draws)
        terminal.report_failures(results, " for some draws")
        return failed
    failed = _report_counts(results.counts(), target, seconds, as_json)
    terminal.report_speed(total, ran, parts.taken_up, seconds, target, inferred=output.refine)
    if failed:
        terminal.report_failures(results)
    return failed


def _warn_of_coarse_step(study: Study, method: str) -> None:
    """A step of rk4 that is stable and yet too coarse for the contact gives wrong labels without any other sign."""
    from clunk.simulation.driveline import steps_a_period

    if method == "rk4" and (steps := steps_a_period(study)) < _FEWEST_STEPS:
        click.echo(
            f"warning: solver.step = {study.solver.step:g} s: {steps:.1f} steps a period of the fastest oscillation;\n"
            f"  with fewer than {_FEWEST_STEPS} weak rebounds are lost",
            err=True,
        )


def _say_if_compiling(*methods: str) -> None:
    from clunk.sweeping.cells import compiling_note

    note = compiling_note(*methods)
    if note:
        click.echo(note, err=True)


def _report_counts(counts: dict[str, int], target: Path, seconds: float, as_json: bool) -> int:
    """Print the counts; returns how many cells have failed."""
    if as_json:
        cells = sum(counts.values())
        summary = {"file": str(target), "cells": cells, "seconds": round(seconds, 3), "counts": counts}
        click.echo(json.dumps(summary, ensure_ascii=False))
    else:
        terminal.print_counts(counts)
    return counts["failed"]


def _report_tolerances(found: ToleranceMap, target: Path, seconds: float, as_json: bool) -> int:
    """Print what a tolerance map comes to; returns how many runs have failed."""
    if as_json:
        summary = {"file": str(target), "seconds": round(seconds, 3)} | terminal.tolerance_record(found)
        click.echo(json.dumps(summary, ensure_ascii=False))
    else:
        terminal.print_tolerances(found)
    return found.failed


@cli.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Picture: .png, .svg or .pdf [FILE.png].")
@click.option(
    "--quantity", metavar="NAME", help="One picture only: regimes, severity, approach_velocity, touches, margin, …"
)
@_at_option
@click.option("--facet", "facets", multiple=True, metavar="KEY", help="A map for each value; twice: rows, columns.")
@click.option("--x", metavar="KEY", help="From left to right, of axes walked together or of a sample.")
@click.option("--y", metavar="KEY", help="Upwards, of a sample; without it a quantity over --x.")
def plot(
    file: Path,
    output: Path | None,
    quantity: str | None,
    at: tuple[str, ...],
    facets: tuple[str, ...],
    x: str | None,
    y: str | None,
) -> None:
    """Draw the maps of a results file: the regimes and their severity.

    A map has two axes: of more, --at takes a slice, and --facet draws a map for each value. Of a
    refined sweep: the regimes. Of a tolerance map: the most likely regimes, where they are uncertain, and
    how probable double-sided impacts are.

    \b
    Examples:
      clunk plot results/figure_3_4.h5 -o figure.svg
      clunk plot results/four_axes.h5 --at lash.contact.stiffness=4e5 \\
          --facet 'driveline.shafts[1].damping'
      clunk plot results/sample.h5 --x load.ratio --y lash.backlash_deg
      clunk plot results/tolerance.h5 --quantity severity_95
    """
    from clunk import plot as plots
    from clunk.plot import certainty
    from clunk.results import targets
    from clunk.results.store import read, read_header

    base = output or file.with_suffix(".png")
    if not base.suffix:
        base = base.with_name(base.name + ".png")
    if output is not None:
        targets.check(base, targets.PICTURES, reads=file)
    if read_header(file).tolerance_map:
        from clunk.results import tolerancefile

        if facets or x is not None or y is not None:
            raise click.UsageError(
                f"--facet, --x and --y do not go with a tolerance map, which {file} holds; --at does."
            )
        found = tolerancefile.read(file)
        if at:
            found = found.at(_nearest_values(found.axes, found.coordinates, at))
        for name in [quantity] if quantity else certainty.default_quantities(found):
            target = base if output and quantity else base.with_name(f"{base.stem}-{name}{base.suffix}")
            plots.save(certainty.draw(found, name), target)
            click.echo(str(target))
        return
    results = read(file)
    if at:
        results = results.at(_nearest_values(results.axes, results.coordinates, at))
    look: dict[str, Any] = {"facets": facets, "x": x, "y": y}
    names = [quantity] if quantity else plots.default_quantities(results, **look)
    for name in names:
        target = base if output and quantity else base.with_name(f"{base.stem}-{name}{base.suffix}")
        plots.save(plots.draw(results, name, plots.thresholds_of(results), **look), target)
        click.echo(str(target))
    if quantity is None and names == ["regimes"]:
        ran, total = int((~results.inferred).sum()), results.inferred.size
        terminal.complain(f"{ran:,} of {total:,} cells were run: --quantity draws what else is known of those")
    for axis in results.axes:
        shown = len(plots.shown_values(axis, len(facets))) if axis.parameter in facets else len(axis.values)
        if shown < len(axis.values):
            terminal.complain(f"{shown} of the {len(axis.values)} values of {axis.parameter} are drawn, evenly spaced")


_CLOSEUP_WIDTH = 0.1  # s
_FIGURES = ("everything", "angles", "backlash", "closeup", "acceleration", "small-gap")


@cli.command()
@click.argument("source", type=click.Path(path_type=Path))
@_set_option
@_at_option
@click.option("--overlay", metavar="KEY=V1,V2,…", multiple=True, help="A run for each value. May be repeated.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Picture (.png .svg .pdf), or data (.csv .h5).")
@click.option("--figure", type=click.Choice(_FIGURES), default="everything", help="Which picture [everything].")
@click.option("--around", type=float, metavar="T", help="Of a close-up: its moment [first impact], s.")
@click.option("--width", type=float, default=_CLOSEUP_WIDTH, metavar="T", help="Of a close-up: its length [0.1], s.")
@click.option("--until", type=float, metavar="T", help="End of the time axis [when it has died down], s.")
@click.option("--step", type=float, metavar="T", help="Between saved or drawn samples [solver.step], s.")
@_json_option
def simulate(
    source: Path,
    overrides: tuple[str, ...],
    at: tuple[str, ...],
    overlay: tuple[str, ...],
    output: Path | None,
    figure: str,
    around: float | None,
    width: float,
    until: float | None,
    step: float | None,
    as_json: bool,
) -> None:
    """Run one load step; print its events, label and energy balance; draw or save it.

    SOURCE is a config, or a results file of which --at names the cell.

    \b
    Examples:
      clunk simulate configs/nominal.toml --set load.ratio=7 -o run.png
      clunk simulate results/figure_3_4.h5 --at load.ratio=5 --at lash.backlash_deg=6
      clunk simulate configs/nominal.toml --figure closeup -o chatter.png \\
          --overlay lash.contact.model=indentation,restitution
    """
    from clunk.results import targets
    from clunk.simulation.energy import balance
    from clunk.simulation.trajectory import simulate as run

    _check_drawing(output, figure, around, width, until, step)
    studies = _studies_to_simulate(source, overrides, at, overlay)
    if output is not None:
        targets.check(output, (*targets.PICTURES, *targets.DATA), reads=source)
        targets.spare_a_sweep(output)
        if output.suffix.lower() in targets.DATA and len(studies) > 1:
            raise click.UsageError(f"{output} takes one run; leave --overlay out, or name a picture.")
    _say_if_compiling(*(study.solver.method for _, study in studies))
    for _, study in studies:
        _warn_of_coarse_step(study, study.solver.method)
    runs = [(name, run(study)) for name, study in studies]
    if as_json:
        records = [
            {"run": name}
            | terminal.trajectory_record(trajectory)
            | {"energy": terminal.energy_record(balance(trajectory))}
            for name, trajectory in runs
        ]
        click.echo(json.dumps(records if overlay else records[0], ensure_ascii=False))
    else:
        for k, (name, trajectory) in enumerate(runs):
            if overlay:
                click.echo(("\n" if k else "") + name)
            terminal.print_trajectory(trajectory)
            click.echo()
            terminal.print_energy(trajectory, balance(trajectory))
    if output is not None:
        _save_runs(runs, output, figure, around, width, until, step)


def _check_drawing(
    output: Path | None, figure: str, around: float | None, width: float, until: float | None, step: float | None
) -> None:
    """Refuse what could not be drawn, before the run and not after it."""
    given = {"--around": around, "--until": until, "--step": step}
    if output is None:
        named = [option for option, value in given.items() if value is not None]
        named += ["--figure"] * (figure != "everything") + ["--width"] * (width != _CLOSEUP_WIDTH)
        if named:
            raise click.UsageError(f"{named[0]} needs -o, the file to draw or save to.")
    for option, value in {"--width": width, "--until": until, "--step": step}.items():
        if value is not None and not value > 0.0:
            raise click.UsageError(f"{option} {value:g}: must be greater than 0 (s).")


def _studies_to_simulate(
    source: Path, overrides: tuple[str, ...], at: tuple[str, ...], overlay: tuple[str, ...]
) -> list[tuple[str, Study]]:
    """The studies of the runs to make, each with a name to tell it from the others."""
    from itertools import product

    from clunk.study.config import replace_values, study_from_text
    from clunk.study.configfile import read_text

    if source.suffix == ".h5":
        from clunk.results.store import read_header

        text, name = read_header(source).config, f"the config in {source}"
    else:
        text, name = read_text(source), str(source)
    choices: dict[str, list[str]] = {}
    for assignment in overlay:
        key, equals, listed = assignment.partition("=")
        if not equals or not listed:
            raise click.UsageError(f"--overlay {assignment}: must be KEY=V1,V2, for example load.ratio=1,2,5.")
        if key in choices:
            raise click.UsageError(f"--overlay {assignment}: {key} is there twice; list its values in one.")
        choices[key] = [f"{key}={value}" for value in re.split(r",(?![^\[]*\])", listed)]
    studies: list[tuple[str, Study]] = []
    for chosen in product(*choices.values()):
        study = study_from_text(text, name, [*overrides, *chosen])
        values = _cell_values(study, at, all_needed=source.suffix == ".h5")
        if study.sweep is not None and study.sweep.tolerances and not studies:
            terminal.complain("tolerances are left aside; this is the nominal run")
        single = replace_values(study.model_copy(update={"sweep": None}), values)
        studies.append((", ".join(chosen) or study.title, single))
    return studies


def _save_runs(
    runs: list[tuple[str, Trajectory]],
    output: Path,
    figure: str,
    around: float | None,
    width: float,
    until: float | None,
    step: float | None,
) -> None:
    from clunk.results import historyfile, targets
    from clunk.simulation import history as histories

    if output.suffix.lower() in targets.DATA:
        ((_, trajectory),) = runs
        save = historyfile.save_csv if output.suffix.lower() == ".csv" else historyfile.save_hdf5
        save(output, histories.sample(trajectory, step, until), trajectory)
        click.echo(f"-> {output}", err=True)
        return
    from clunk import plot as plots
    from clunk.plot import histories as figures
    from clunk.plot.small_gap import small_gap
    from clunk.simulation.small_gap import SmallGap

    end = until if until is not None else max(histories.shown_until(trajectory) for _, trajectory in runs)
    if figure == "closeup" and around is not None:
        end = max(end, around + 0.6 * width)
    drawn = [(name, trajectory, histories.sample(trajectory, step, end)) for name, trajectory in runs]
    draw = {
        "everything": lambda: figures.simulation_figure(drawn),
        "angles": lambda: figures.angles(drawn),
        "backlash": lambda: figures.backlash(drawn),
        "closeup": lambda: figures.closeup(drawn, around, width),
        "acceleration": lambda: figures.acceleration(drawn),
        "small-gap": lambda: small_gap(runs[0][1].study.title, SmallGap.of(runs[0][1].study)),
    }
    plots.save(draw[figure](), output)
    click.echo(f"-> {output}", err=True)


def _cell_values(study: Study, at: tuple[str, ...], *, all_needed: bool) -> dict[str, float]:
    """The swept keys' values that --at names, of `run` those of its coordinates.

    Where not all are needed, what is not named keeps the config's own value.
    """
    import shlex

    from clunk.study.axes import RUN
    from clunk.study.designs import design_of

    design = design_of(study)
    named = _nearest_values(design.axes, design.coordinates, at)
    missing = [axis for axis in design.axes if axis.parameter not in named]
    if missing and all_needed:
        options = (shlex.quote(f"{axis.parameter}={axis.values[len(axis.values) // 2]:.6g}") for axis in missing)
        raise click.UsageError(f"Which cell? Also name {' '.join(f'--at {each}' for each in options)}, for example.")
    own = [axis.parameter for axis in missing if axis.parameter != RUN]
    own += [axis.parameter for axis in design.coordinates] if any(axis.parameter == RUN for axis in missing) else []
    if own:
        listed = ", ".join(f"{key} = {_own_value(study, key):g}" for key in own)
        terminal.complain(f"swept keys at the config's own values: {listed}; --at names others")
    run = named.pop(RUN, None)
    if run is not None:
        named |= {axis.parameter: float(axis.values[int(run) - 1]) for axis in design.coordinates}
    return named


def _nearest_values(
    axes: Sequence[ResultAxis], coordinates: Sequence[ResultAxis], at: tuple[str, ...]
) -> dict[str, float]:
    """The axes' values that --at names, each taken to the nearest one of its axis."""
    import numpy as np

    known = {axis.parameter: axis for axis in axes}
    values: dict[str, float] = {}
    for assignment in at:
        key, _, text = assignment.partition("=")
        key = key.strip()
        along_run = next((axis for axis in coordinates if axis.parameter == key), None)
        if key not in known and along_run is None:
            swept = ", ".join([*known, *(axis.parameter for axis in coordinates)]) or "nothing"
            raise click.UsageError(f"--at {assignment}: {key!r} is not swept; swept here: {swept}.")
        axis = along_run or known[key]
        lowest, highest = float(axis.values.min()), float(axis.values.max())
        try:
            wanted = float(text)
        except ValueError:
            raise click.UsageError(f"--at {assignment}: {text!r} is not a number.") from None
        if not lowest <= wanted <= highest:  # also when not a number
            raise click.UsageError(f"--at {assignment}: {key} is swept from {lowest:g} to {highest:g}.")
        nearest = float(axis.values[axis.nearest(wanted)])
        if along_run is not None:
            raise click.UsageError(
                f"--at {assignment}: {key} changes together with the other keys of its run; name the run, --at "
                f"run={axis.nearest(wanted) + 1}, where it is {nearest:.6g}."
            )
        values[key] = nearest
        if not np.isclose(nearest, wanted, rtol=1e-9, atol=0.0):
            terminal.complain(f"{key} = {nearest:.6g} is the nearest value of its axis")
    return values


def _own_value(study: Study, key: str) -> float:
    from clunk.study.config import get_value

    return get_value(study, key)


@cli.command()
@click.argument("config", type=click.Path(path_type=Path))
@_set_option
@_json_option
def modes(config: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Print natural frequencies, damping ratios and small-gap thresholds.

    Example: clunk modes configs/nominal.toml
    """
    from clunk.simulation.driveline import Driveline, steps_a_period
    from clunk.simulation.linear import one_mode_thresholds, rigid_contact_thresholds
    from clunk.study.config import load_study

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
    click.echo(
        f"solver.step         {study.solver.step:g} s, {steps_a_period(study):.1f} steps a period of the fastest mode"
    )
    click.echo()
    click.echo("load ratio σr above which one more impact appears as the backlash vanishes")
    click.echo("  impacts       " + "".join(f"{n:>8}" for n in range(1, 5)))
    for name, ratios in thresholds.items():
        click.echo(f"  {name:<14}" + ("".join(f"{ratio:>8.2f}" for ratio in ratios) or "    none"))
    click.echo("(lowest mode: σr = exp(2π ζ1 (n - 1/2)); all modes: with the lash locked)")


@cli.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--config", "show_config", is_flag=True, help="Print the whole resolved config (TOML) instead.")
@click.option("--check", is_flag=True, help="Also read it whole and compare it with its checksums.")
@_json_option
def info(file: Path, show_config: bool, check: bool, as_json: bool) -> None:
    """Say what a results file holds: config, versions, regime counts.

    Example: clunk info results/figure_3_4.h5 --check
    """
    from clunk.results import store, tolerancefile

    header = store.read_header(file)
    found = tolerancefile.read(file) if header.tolerance_map else None
    bytes_checked = (store.check if found is None else tolerancefile.check)(file) if check else None
    if show_config:
        click.echo(header.config, nl=not header.config.endswith("\n"))
        return
    if as_json:
        axes = [
            {"parameter": a.parameter, "unit": a.unit, "start": float(a.values[0]), "stop": float(a.values[-1])}
            | {"count": len(a.values)}
            for a in header.axes
        ]
        record: dict[str, Any] = {"title": header.title, "axes": axes}
        if header.coordinates:
            record["coordinates"] = [
                {"parameter": a.parameter, "unit": a.unit, "lowest": float(a.values.min())}
                | {"highest": float(a.values.max())}
                for a in header.coordinates
            ]
        record |= {"counts": header.counts} if found is None else terminal.tolerance_record(found)
        record |= {"config_digest": header.config_digest}
        checked: dict[str, Any] = {"checked": {"data": True, "bytes": bytes_checked}} if check else {}
        click.echo(json.dumps(record | header.attributes | checked, ensure_ascii=False))
        return
    click.echo(header.title)
    click.echo()
    for axis in header.axes:
        click.echo(f"axis      {axis.parameter}: {axis.spread}")
    for axis in header.coordinates:
        click.echo(f"along run {axis.parameter}: {axis.spread}")
    for each in found.sample if found is not None else ():
        unit = "" if each.unit == "1" else f" {each.unit}"
        click.echo(f"drawn     {each.name}, {each.values.min():.4g} to {each.values.max():.4g}{unit}")
    click.echo(f"config    {header.config_digest[:16]}…")
    for name, value in header.attributes.items():
        click.echo(f"{name.removesuffix('_version'):<9} {value}")
    if bytes_checked is not None:
        data = "the data match their digest"
        click.echo(
            f"checked   {data}{', the bytes their checksum' if bytes_checked else '; the bytes have no checksum:'}"
        )
        if not bytes_checked:
            click.echo("          another program has changed the file")
    click.echo()
    if found is None:
        terminal.print_counts(header.counts)
    else:
        terminal.print_tolerances(found)


@cli.command()
@click.argument("path", type=click.Path(path_type=Path), default="clunk.toml")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def init(path: Path, force: bool) -> None:
    """Write a commented starter config to PATH [clunk.toml]; - prints it.

    Example: clunk init study.toml
    """
    from importlib.resources import files

    text = files("clunk.study.presets").joinpath("starter.toml").read_text(encoding="utf-8")
    if str(path) == "-":
        click.echo(text, nl=False)
        return
    if path.is_dir():
        raise click.ClickException(f"{path} is a directory; name a file in it.")
    if path.exists() and not force:
        raise click.ClickException(f"{path} exists; --force overwrites it.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{path} cannot be written: {error.strerror}.") from error
    click.echo(f"wrote {path}; next: clunk sweep {path}", err=True)


@cli.command()
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Also draw where they differ: .png .svg .pdf.")
@click.option("--expect-equal", is_flag=True, help="Exit with 4 where any label differs.")
@_json_option
def compare(a: Path, b: Path, output: Path | None, expect_equal: bool, as_json: bool) -> None:
    """Compare the results file A with another, B, cell by cell; or with measurements.

    B is a results file of the same grid, a CSV file of measured labels, or table_4_1, the report's experiment.

    \b
    Examples:
      clunk compare results/rk4.h5 results/force.h5 --expect-equal
      clunk compare results/figure_3_4.h5 table_4_1 -o experiment.png
    """
    from clunk.analysis import comparison as comparing
    from clunk.results import targets
    from clunk.results.store import read

    if output is not None:
        targets.check(output, targets.PICTURES)
    results = read(a)
    found: Any
    other = None
    if comparing.is_experiment(b):
        found = comparing.compare_experiment(results, comparing.read_experiment(b))
    else:
        other = read(b)
        found = comparing.compare(results, other)
    if as_json:
        click.echo(json.dumps(comparing.as_record(found), ensure_ascii=False))
    else:
        click.echo(comparing.report(found, (str(a), str(b))), nl=False)
    if output is not None:
        from clunk import plot as plots
        from clunk.plot.comparisons import difference_map, experiment_map

        figure = experiment_map(results, found) if other is None else difference_map(results, other, found)
        plots.save(figure, output)
        click.echo(f"-> {output}", err=True)
    if expect_equal and not found.same_regimes:
        sys.exit(EXIT_MISMATCH)


@cli.command()
@click.argument("config", type=click.Path(path_type=Path))
@_set_option
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads [one for each core].")
@_json_option
def verify(config: Path, overrides: tuple[str, ...], workers: int | None, as_json: bool) -> None:
    """Run CONFIG by both methods, rk4 and exact, and compare labels, events and severity.

    Exact is guarded: it cannot skip an event, to rounding, for this model. Where labels differ in a cell that it does
    not flag (undecided or grazing), the exit code is 4. A config without axes is compared event by event.

    \b
    Examples:
      clunk verify configs/smoke.toml
      clunk verify configs/figure_3_4.toml --set solver.step=5e-5
    """
    from clunk.analysis import verification
    from clunk.study.config import load_study
    from clunk.sweeping.sweep import cell_count

    study = load_study(config, overrides)
    _warn_of_coarse_step(study, "rk4")
    _say_if_compiling(*verification.METHODS)
    with progress.shown(len(verification.METHODS) * max(cell_count(study), 1)) as show:
        found = verification.verify(study, workers=workers, progress=show)
    if as_json:
        click.echo(json.dumps(found.record(), ensure_ascii=False))
    else:
        terminal.print_verification(found)
    for method, results in zip(verification.METHODS, (found.rk4, found.exact), strict=True):
        terminal.report_failures(results, f" by {method}")
    if found.differing_elsewhere:
        sys.exit(EXIT_MISMATCH)
    if found.failed:
        sys.exit(EXIT_FAILED_CELLS)


@cli.command()
@click.argument("config", type=click.Path(path_type=Path))
@_set_option
@click.option("--at", "at", multiple=True, metavar="KEY=VALUE", help="Value of a swept key. May be repeated.")
@click.option(
    "--of",
    "quantities",
    multiple=True,
    metavar="QUANTITY",
    help="severity, approach_velocity, primary_impacts, touches, last_event_time, nominal_label, double_sided or "
    "label=DS(1)SS(1), for example [severity and nominal_label]. May be repeated.",
)
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads [one for each core].")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Also draw the indices: .png .svg .pdf.")
@_json_option
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
    from clunk.sweeping.sweep import unused_parameters, warm_up

    study = load_study(config, overrides)
    if output is not None:
        targets.check(output, targets.PICTURES, reads=config)
    point = sobol.operating_point(replace_values(study, _cell_values(study, at, all_needed=False)))
    _warn_of_coarse_step(point, point.solver.method)
    for parameter in unused_parameters(point):
        click.echo(f"note: {parameter} is drawn, but changes nothing in this model", err=True)
    _say_if_compiling(point.solver.method)
    warm_up(point)
    began = time.perf_counter()
    with progress.shown(sobol.run_count(point), "runs") as show:
        found = sobol.sensitivity(point, of=quantities, workers=workers, progress=show)
    seconds = time.perf_counter() - began
    if as_json:
        click.echo(json.dumps(found.record(), ensure_ascii=False))
    else:
        terminal.print_sensitivity(found)
    draws = len(found.parameters)
    what = f"{found.runs:,} runs, {found.samples:,} samples x ({draws} parameters + 2), in {seconds:.1f} s"
    click.echo(f"{what} ({found.runs / seconds:,.0f} runs/s)", err=True)
    if output is not None:
        from clunk import plot as plots
        from clunk.plot.indices import sobol_bars

        plots.save(sobol_bars(found), output)
        click.echo(f"-> {output}", err=True)


@cli.command()
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default="results/reproduction", help="Directory of the figures."
)
@click.option("--workers", type=click.IntRange(1, 1024), help="Threads [one for each core].")
@click.option("--coarsen", type=click.IntRange(1, 20), default=1, help="About every n-th value of the maps' axes [1].")
@_json_option
def reproduce(output: Path, workers: int | None, coarsen: int, as_json: bool) -> None:
    """Recompute the report: every number and claim beside ours, every figure redrawn.

    Exits with 4 where a claim that is known to agree no longer does.

    Example: clunk reproduce
    """
    from clunk.report import claims as claiming
    from clunk.report import reproduction
    from clunk.results import targets
    from clunk.sweeping.sweep import cell_count

    targets.check(output / "figure_3_1.png", targets.PICTURES)
    _say_if_compiling("rk4")
    total = sum(cell_count(study) for study in claiming.map_studies(coarsen).values())
    with progress.shown(total) as show:
        maps = claiming.run_maps(coarsen, workers, show)
    evidence = claiming.Evidence(maps)
    found = claiming.claims(evidence)
    jobs = reproduction.figures(evidence)
    with progress.shown(len(jobs), "figures") as show:
        written = reproduction.save_all(jobs, evidence, found, output, show)
    if as_json:
        click.echo(json.dumps([claim.record() for claim in found], ensure_ascii=False))
    else:
        terminal.print_claims(found)
    click.echo(f"{len(written)} files -> {output}", err=True)
    failed = [claim for claim in found if claim.failed]
    if failed:
        click.echo(f"{len(failed)} of {len(found)} claims no longer agree (!)", err=True)
        sys.exit(EXIT_MISMATCH)
