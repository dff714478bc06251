"""`clunk simulate`: one load step, its events, label and energy balance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import tables, terminal
from clunk.cli.options import (
    at_option,
    cell_values,
    json_option,
    output_option,
    path_argument,
    repeated_option,
    set_option,
    study_of,
)
from clunk.study.records import Told, fill, words

if TYPE_CHECKING:
    from clunk.simulation.trajectory import Trajectory
    from clunk.study.study import Study

_LEGEND = (
    "(time: after the load step; q': rate of the gap just before the event; Qi: peak-to-peak acceleration from a "
    "primary impact to the next; O, I: primary impacts on the opposite and the initial flank; more: clunk help words)"
)
_FIGURES = ("everything", "angles", "backlash", "closeup", "acceleration", "small-gap")


@click.command()
@path_argument("source")
@set_option
@at_option
@repeated_option(
    "--overlay",
    metavar="KEY=V1,V2,…",
    help="Make a run for each value of KEY, or combination of values. May be repeated.",
)
@output_option(help="Picture (.png .svg .pdf), or data (.csv).")
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
    overlay: tuple[str, ...],
    output: Path | None,
    figure: str,
    as_json: bool,
) -> None:
    """Run one load step and print its events.

    Also prints the label and the energy balance of the run; -o draws it, or saves its history as data. SOURCE is a
    config, or a results file, of which --at names the cell.

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
    from clunk.sweeping.cells import compiling_note

    if output is None and figure != "everything":
        raise click.UsageError("--figure needs -o, the file to draw.")
    studies = _studies_to_simulate(source, overrides, at, overlay)
    if output is not None:
        files.check(output, (*files.PICTURES, ".csv"))
        if len(studies) > 1 and (output.suffix.lower() == ".csv" or figure == "small-gap"):
            raise click.UsageError(f"{output} takes one run; leave --overlay out, or draw another --figure.")
    if note := compiling_note(*(study for _, study in studies)):
        terminal.complain(note)
    for _, study in studies:
        terminal.warn(study.but(sweep=None))
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
        _save_runs(runs, output, figure)


def _studies_to_simulate(
    source: Path, overrides: tuple[str, ...], at: tuple[str, ...], overlay: tuple[str, ...]
) -> list[tuple[str, Study]]:
    """Name and study of each run to make: a single one, or one for each combination of the overlaid values."""
    from itertools import product

    from clunk.study.config import study_from_text
    from clunk.study.document import assigned
    from clunk.study.errors import ClunkError, ConfigError, report
    from clunk.study.parameters import numbered
    from clunk.study.study import replace_values, to_toml

    choices: dict[str, list[str]] = {}
    for assignment in overlay:
        key, listed = assigned(assignment)
        if not listed:
            raise click.UsageError(f"--overlay {assignment}: must be KEY=V1,V2, for example load.ratio=1,2,5.")
        choices.setdefault(key, []).extend(f"{key}={value}" for value in re.split(r",(?![^\[]*\])", listed))
    study = study_of(source, overrides)
    overlaid = numbered([*choices], study)
    values = cell_values(study, at, all_needed=source.suffix == ".h5", but=overlaid)
    if study.swept.tolerances:
        terminal.complain("tolerances are left aside; this is the nominal run")
    single = replace_values(study.but(sweep=None), values)
    if not choices:
        return [(study.title, single)]
    config = to_toml(single)
    try:
        return [
            (", ".join(chosen), study_from_text(config, str(source), chosen)) for chosen in product(*choices.values())
        ]
    except ConfigError as error:
        problems = [problem._replace(line=None) for problem in error.problems]  # lines are those of `config`
        raise ClunkError(str(report(str(source), problems)).replace("--set", "--overlay")) from None


def _save_runs(runs: list[tuple[str, Trajectory]], output: Path, figure: str) -> None:
    """Save a run as data (.csv), or draw the runs as the named figure."""
    from clunk.results.export import save_history
    from clunk.simulation import history as histories

    if output.suffix.lower() == ".csv":
        ((_, trajectory),) = runs
        save_history(output, histories.sample(trajectory, trajectory.study.solver.step))
        terminal.say_written(output)
        return
    from clunk.plot import histories as figures
    from clunk.simulation.small_gap import SmallGap

    if figure == "small-gap":
        picture = figures.small_gap(runs[0][1].study.title, SmallGap.of(runs[0][1].study))
    else:
        latest = max(histories.shown_until(trajectory) for _, trajectory in runs)
        drawn = [histories.sample(trajectory, until=latest, name=name) for name, trajectory in runs]
        picture = figures.history_figure(drawn, figure)
    terminal.save_picture(picture, output)


def run_record(trajectory: Trajectory) -> dict[str, Any]:
    """JSON record of a run, with its energies in J; with several lashes, what each lash has is in `lashes`, by name."""
    from clunk.simulation.energy import balance

    primaries = {k for each in trajectory.lashes for k in each.primaries.tolist()}
    several, measures = len(trajectory.lashes) > 1, _measures(trajectory.study)
    of_lashes = {
        name: {
            "label": each.label,
            "severity": each.severity,
            "approach_velocity": each.approach_velocity,
            "impact_severity": each.impact_severity,
            "margin": each.margin,
            "measures": measures[name],
        }
        for name, each in zip(trajectory.study.lash_names, trajectory.lashes, strict=True)
    }
    return tables.of_lashes(of_lashes) | {
        "complete": trajectory.complete,
        "end": trajectory.end,
        "events": [
            {
                "time": event["time"],
                "event": trajectory.kind_name(k),
                **({"lash": trajectory.lash_name(k)} if several else {}),
                "flank": trajectory.flank_name(k),
                "relative_velocity": event["speed"],
                "primary": k in primaries,
            }
            for k, event in enumerate(trajectory.events)
            if k > 0
        ],
        "energy": balance(trajectory),
    }


def _measures(study: Study) -> dict[str, dict[str, Any]]:
    """Measures besides Q and V that the config asks for: lash -> name -> value for the run, or values for its impacts.

    For each lash it is empty where the config asks for none.
    """
    from clunk.results.quantities import REGIME_QUANTITIES
    from clunk.sweeping.runner import Runner

    if not study.measured:
        return {lash: {} for lash in study.lash_names}
    runs = Runner(study, ["load.step_time"])([[study.load.step_time]])
    names = [name for name in runs.quantities if name not in REGIME_QUANTITIES]
    cells = {lash: runs.of_lash(lash).cell({"run": 1}) for lash in study.lash_names}
    return {lash: {name: cell[name] for name in names} for lash, cell in cells.items()}


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
        if measures := of_lash["measures"].items():
            click.echo(f"\n{lash}" if lash else "")
            tables.print_values(
                (name, words(value, Told(unit=quantities[name].unit_symbol))) for name, value in measures
            )
    click.echo()
    tables.tell(record["energy"], as_json=False)
