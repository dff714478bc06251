"""`clunk simulate`: one load step, its events, label and energy balance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import completion, tables, terminal
from clunk.cli.options import PATH, at_option, cell_values, json_option, set_option
from clunk.study.records import fill, number, words

if TYPE_CHECKING:
    from clunk.simulation.trajectory import Trajectory
    from clunk.study.study import Study

_LEGEND = (
    "(time: after the load step; q': rate of the gap just before the event; Qi: peak-to-peak acceleration from a "
    "primary impact to the next; O, I: primary impacts on the opposite and the initial flank; more: clunk help words)"
)
_FIGURES = ("everything", "angles", "backlash", "closeup", "acceleration", "small-gap")


@click.command()
@click.argument("source", type=PATH)
@set_option
@at_option
@click.option("--lash", metavar="NAME", help="Of several lashes, draw only this one.")
@click.option(
    "--overlay",
    metavar="KEY=V1,V2,…",
    shell_complete=completion.assignments,
    multiple=True,
    help="A run for each value. May be repeated.",
)
@click.option("-o", "--output", type=PATH, help="Picture (.png .svg .pdf), or data (.csv).")
@click.option(
    "--figure",
    type=click.Choice(_FIGURES),
    default="everything",
    metavar="NAME",
    help=f"Which picture: {', '.join(_FIGURES)} [everything].",
)
@json_option
def simulate(
    source: Path,
    overrides: tuple[str, ...],
    at: tuple[str, ...],
    lash: str | None,
    overlay: tuple[str, ...],
    output: Path | None,
    figure: str,
    as_json: bool,
) -> None:
    """Run one load step and print its events.

    Prints its label and energy balance, too, and draws or saves it. SOURCE is a config, or a results file of which --at
    names the cell.

    \b
    Examples:
      clunk simulate configs/nominal.toml --set load.ratio=7 -o run.png
      clunk simulate results/figure_3_4.h5 --at load.ratio=5 \\
          --at lash.backlash_deg=6
      clunk simulate configs/nominal.toml --figure closeup -o chatter.png \\
          --overlay lash.contact.model=indentation,restitution
    """
    from clunk.results import files
    from clunk.simulation.trajectory import simulate as run
    from clunk.study.models import lash_position
    from clunk.sweeping.cells import compiling_note

    if output is None and figure != "everything":
        raise click.UsageError("--figure needs -o, the file to draw.")
    studies = _studies_to_simulate(source, overrides, at, overlay)
    if output is not None:
        files.check(output, (*files.PICTURES, ".csv"), reads=source)
        if output.suffix.lower() == ".csv" and len(studies) > 1:
            raise click.UsageError(f"{output} takes one run; leave --overlay out, or name a picture.")
    if note := compiling_note(*(study for _, study in studies)):
        click.echo(note, err=True)
    for _, study in studies:
        terminal.warn_of_coarse_step(study, study.solver.method)
    positions = [lash_position(lash, study.lash_names) for _, study in studies]
    runs = [(name, run(study)) for name, study in studies]
    records = [{"run": name} | run_record(trajectory) for name, trajectory in runs]
    if as_json:
        tables.print_record(records if overlay else records[0])
    else:
        for k, ((name, trajectory), record) in enumerate(zip(runs, records, strict=True)):
            if overlay:
                click.echo(("\n" if k else "") + name)
            _print_run(trajectory, record)
        click.echo("\n" + fill(_LEGEND))
    if output is not None:
        if lash is not None:
            runs = [(name, each.lashes[k]) for (name, each), k in zip(runs, positions, strict=True)]
        _save_runs(runs, output, figure, each_lash=lash is None)


def _studies_to_simulate(
    source: Path, overrides: tuple[str, ...], at: tuple[str, ...], overlay: tuple[str, ...]
) -> list[tuple[str, Study]]:
    """Names and studies of the runs to make: one, or one for each combination of overlaid values."""
    from itertools import product

    from clunk.study.config import study_from_text
    from clunk.study.designs import has_tolerances
    from clunk.study.document import read_text
    from clunk.study.study import replace_values

    if source.suffix == ".h5":
        from clunk.results.store import read_map

        text, name = read_map(source).config, f"the config in {source}"
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
        study = study_from_text(text, name, [*overrides, *chosen], source.parent)
        values = cell_values(study, at, all_needed=source.suffix == ".h5")
        if has_tolerances(study) and not studies:
            terminal.complain("tolerances are left aside; this is the nominal run")
        single = replace_values(study.model_copy(update={"sweep": None}), values)
        studies.append((", ".join(chosen) or study.title, single))
    return studies


def _save_runs(runs: list[tuple[str, Trajectory]], output: Path, figure: str, *, each_lash: bool) -> None:
    """Save or draw runs; each_lash : whether pictures show every lash, or that of the trajectories alone."""
    from clunk.results.export import save_history
    from clunk.simulation import history as histories

    if output.suffix.lower() == ".csv":
        ((_, trajectory),) = runs
        save_history(output, histories.sample(trajectory))
        terminal.say_written(output)
        return
    from clunk.plot import histories as figures
    from clunk.simulation.small_gap import SmallGap

    latest = max(histories.shown_until(trajectory) for _, trajectory in runs)
    drawn = [histories.sample(trajectory, until=latest, name=name) for name, trajectory in runs]
    if figure == "small-gap":
        picture = figures.small_gap(runs[0][1].study.title, SmallGap.of(runs[0][1].study))
    else:
        picture = figures.history_figure(drawn, figure, each_lash=each_lash)
    terminal.save_picture(picture, output)


def run_record(trajectory: Trajectory) -> dict[str, Any]:
    """A run and its energies in J; of several lashes `lashes` has what is of each, by name."""
    from clunk.simulation.energy import balance

    primaries, load = {k for each in trajectory.lashes for k in each.primaries.tolist()}, trajectory.load
    several, energy = len(trajectory.lashes) > 1, balance(trajectory)
    of_lashes = {
        name: {
            "label": each.label,
            "severity": each.severity,
            "approach_velocity": each.approach_velocity,
            "impact_severity": each.impact_severity,
            "margin": each.margin,
            **_measures(each),
        }
        for name, each in zip(trajectory.study.lash_names, trajectory.lashes, strict=True)
    }
    return ({"lashes": of_lashes} if several else next(iter(of_lashes.values()))) | {
        "complete": trajectory.complete,
        "end": trajectory.end,
        "events": [
            {
                "time": float(event["time"]),
                "event": trajectory.kind_name(k),
                **({"lash": trajectory.lash_name(k)} if several else {}),
                "flank": trajectory.flank_name(k),
                "relative_velocity": float(event["speed"]),
                "load": float(load[k]),
                "primary": k in primaries,
            }
            for k, event in enumerate(trajectory.events)
            if k > 0
        ],
        "energy": vars(energy) | {"residual": energy.residual, "relative_residual": energy.relative_residual},
    }


def _measures(trajectory: Trajectory) -> dict[str, Any]:
    """Measures of a run that the config asks for besides Q and V; empty where it asks for none."""
    from clunk.sweeping.runner import Runner

    study = trajectory.study
    if not study.measured:
        return {}
    runs = Runner(study, ["load.step_time"])([[study.load.step_time]])
    run, of_impacts = runs.of_lash(study.lash_names[trajectory.lash]), study.impacts.quantities
    return {
        "measures": {name: run.values(name).item() for name in (*of_impacts, *(each.name for each in study.measures))},
        "impact_measures": {name: run.values(f"impact_{name}").tolist() for name in of_impacts},
    }


def _print_run(trajectory: Trajectory, record: dict[str, Any]) -> None:
    """Print the events, outcome, measures and energies of a run."""
    from clunk.results.quantities import measured_quantities

    heads, *rows = trajectory.event_table()
    tables.print_table([dict(zip(heads, row, strict=True)) for row in rows])
    click.echo(f"end at {trajectory.end:.7f} s: {trajectory.ending}\n")
    tables.print_values(trajectory.summary())
    study = trajectory.study
    quantities = measured_quantities(study.impacts.quantities, [dict(each) for each in study.measures])
    for lash, of_lash in record.get("lashes", {"": record}).items():
        if not study.measured:
            break
        click.echo(f"\n{lash}" if lash else "")
        values = []
        for name, value in of_lash["measures"].items():
            of_impacts = words(of_lash["impact_measures"].get(name, ()))
            each = f" (impacts: {of_impacts})" if of_impacts else ""
            values.append((name, f"{number(value)} {quantities[name].unit_symbol}{each}"))
        tables.print_values(values)
    click.echo()
    _print_energy(trajectory)


def _print_energy(trajectory: Trajectory) -> None:
    """Print the energies of a run: what it had and took up, what it still has, and where the rest went."""
    from clunk.simulation.driveline import Driveline
    from clunk.simulation.energy import balance

    energy = balance(trajectory)
    terms = {
        "stored before": energy.stored_before,
        "work of the load": energy.work,
        "regained at rejoins": energy.regained,
        "stored at the end": energy.stored_after,
        "damped in shafts": sum(energy.damped_in_shafts),
        "damped in contact": energy.damped_in_contact,
        "rubbed": energy.rubbed,
        "lost at impacts": energy.lost_at_impacts,
        "dropped at partings": energy.dropped,
    }
    texts = [(name, f"{term:.6g} J") for name, term in terms.items() if term]
    residual = f"{energy.residual:.6g} J, {energy.relative_residual:.1e} of the largest energy"
    tables.print_values([*texts, ("residual", residual)])
    rigid = Driveline.from_study(trajectory.study).rigid_motion
    if rigid.shape.size and not rigid.is_dragged:
        click.echo("(nothing resists the rolling: speeds are those above the speed at the load step)")
