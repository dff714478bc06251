"""`clunk simulate`: one load step, its events, label and energy balance."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import cells, phrases, terminal
from clunk.cli.options import at_option, json_option, set_option

if TYPE_CHECKING:
    from clunk.simulation.energy import EnergyBalance
    from clunk.simulation.trajectory import Trajectory
    from clunk.study.config import Study


_CLOSEUP_WIDTH = 0.1  # s
_FIGURES = ("everything", "angles", "backlash", "closeup", "acceleration", "small-gap")


@click.command()
@click.argument("source", type=click.Path(path_type=Path))
@set_option
@at_option
@click.option("--overlay", metavar="KEY=V1,V2,…", multiple=True, help="A run for each value. May be repeated.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Picture (.png .svg .pdf), or data (.csv .h5).")
@click.option("--figure", type=click.Choice(_FIGURES), default="everything", help="Which picture [everything].")
@click.option("--around", type=float, metavar="T", help="Of a close-up: its moment [first impact], s.")
@click.option("--width", type=float, default=_CLOSEUP_WIDTH, metavar="T", help="Of a close-up: its length [0.1], s.")
@click.option("--until", type=float, metavar="T", help="End of the time axis [when it has died down], s.")
@click.option("--step", type=float, metavar="T", help="Between saved or drawn samples [solver.step], s.")
@json_option
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
    terminal.say_if_compiling(*(study.solver.method for _, study in studies))
    for _, study in studies:
        terminal.warn_of_coarse_step(study, study.solver.method)
    runs = [(name, run(study)) for name, study in studies]
    if as_json:
        records = [
            {"run": name} | trajectory_record(trajectory) | {"energy": energy_record(balance(trajectory))}
            for name, trajectory in runs
        ]
        click.echo(json.dumps(records if overlay else records[0], ensure_ascii=False))
    else:
        for k, (name, trajectory) in enumerate(runs):
            if overlay:
                click.echo(("\n" if k else "") + name)
            print_trajectory(trajectory)
            click.echo()
            print_energy(trajectory, balance(trajectory))
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
    from clunk.study.document import read_text

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
        values = cells.cell_values(study, at, all_needed=source.suffix == ".h5")
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
    from clunk.simulation.recording import Recording
    from clunk.simulation.small_gap import SmallGap

    end = until if until is not None else max(histories.shown_until(trajectory) for _, trajectory in runs)
    if figure == "closeup" and around is not None:
        end = max(end, around + 0.6 * width)
    drawn = [Recording(name, trajectory, histories.sample(trajectory, step, end)) for name, trajectory in runs]
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


def print_trajectory(trajectory: Trajectory) -> None:
    """A run's events, its primary impacts and what they amount to."""
    from clunk.simulation.trajectory import EVENT_COLUMNS

    widths = "{:>11}  {:<10}  {:<8}  {:>10}  {:<9}  {:>11}"
    for row in (EVENT_COLUMNS, *trajectory.event_table()):
        click.echo(widths.format(*row).rstrip())
    click.echo(f"{trajectory.end:11.7f}  end: {trajectory.ending}")
    click.echo()
    for name, value in trajectory.summary():
        click.echo(f"{name:<19} {value}")


def trajectory_record(trajectory: Trajectory) -> dict[str, Any]:
    """A run for JSON; what is not defined is null."""
    primaries = set(trajectory.primaries.tolist())
    return {
        "label": trajectory.label,
        "severity": phrases.or_none(trajectory.severity),
        "approach_velocity": trajectory.approach_velocity,
        "impact_severity": [phrases.or_none(value) for value in trajectory.impact_severity.tolist()],
        "complete": trajectory.complete,
        "margin": phrases.or_none(trajectory.margin),
        "end": trajectory.end,
        "events": [
            {
                "time": float(event["time"]),
                "event": trajectory.kind_name(k),
                "flank": trajectory.flank_name(k),
                "relative_velocity": float(event["speed"]),
                "primary": k in primaries,
            }
            for k, event in enumerate(trajectory.events)
            if k > 0
        ],
    }


def print_energy(trajectory: Trajectory, balance: EnergyBalance) -> None:
    """Where a run's energy went: stored before and after, taken by dampers and flanks, and what does not add up."""
    click.echo(f"{'energy [J]':<20}" + "".join(f"{word:>14}" for word in ("before", "after", "change", "damped")))
    contact = balance.contact_before, balance.contact_after, balance.damped_in_contact
    rows = [("inertias", balance.kinetic_before, balance.kinetic_after, 0.0)]
    rows += zip(
        (shaft_name(trajectory, k) for k in range(len(balance.shafts_before))),
        balance.shafts_before,
        balance.shafts_after,
        balance.damped_in_shafts,
        strict=True,
    )
    rows.append(("contact", *contact))
    rows.append(("together", balance.stored_before, balance.stored_after, balance.damped))
    for name, before, after, damped in rows:
        numbers = "".join(_joule(value) for value in (before, after, after - before, damped))
        click.echo(f"{name:<20}{numbers}")
    lines = [("work of the load", balance.work)]
    if trajectory.study.lash.contact.model == "restitution":
        lines.append(("lost at impacts", balance.lost_at_impacts))
    elif trajectory.study.lash.contact.separation == "force":
        lines += [("dropped at partings", balance.dropped), ("regained at rejoins", balance.regained)]
    for name, value in lines:
        click.echo(f"{name:<20}{_joule(value)}")
    click.echo(f"{'residual':<20}{_joule(balance.residual)}, {balance.relative_residual:.1e} of the largest energy")


def shaft_name(trajectory: Trajectory, k: int) -> str:
    """A shaft by its number and ends, for example shaft 3, 4-ground."""
    one, other = trajectory.study.driveline.shafts[k].between
    return f"shaft {k + 1}, {one}-{other}"


def _joule(value: float) -> str:
    return f"{value:>14.6g}"


def energy_record(balance: EnergyBalance) -> dict[str, Any]:
    """An energy balance for JSON, in J; what is not defined is null."""
    record: dict[str, Any] = dict(vars(balance))
    record |= {name: getattr(balance, name) for name in ("residual", "relative_residual")}
    return {
        name: [phrases.or_none(item) for item in value] if isinstance(value, tuple) else phrases.or_none(value)
        for name, value in record.items()
    }
