"""`clunk simulate`: one load step, its events, label and energy balance."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from clunk.cli import cells, completion, tables, terminal
from clunk.cli.options import PATH, at_option, json_option, set_option
from clunk.study.records import fill, number, words

if TYPE_CHECKING:
    from clunk.simulation.energy import EnergyBalance
    from clunk.simulation.trajectory import Trajectory
    from clunk.study.study import Study

_FIGURES = ("everything", "angles", "speeds", "backlash", "closeup", "acceleration", "small-gap")


class Drawing(NamedTuple):
    """The options of pictures and saved histories; times in s, None where the default depends on the run."""

    around: float | None = None
    until: float | None = None
    step: float | None = None
    figure: str = "everything"
    width: float = 0.1

    def check(self, output: Path | None) -> None:
        """Refuse what could not be drawn or saved, before the run and not after it."""
        changed = [name for name, value in self._asdict().items() if value != self._field_defaults[name]]
        if output is None and changed:
            raise click.UsageError(f"--{changed[0]} needs -o, the file to draw or save to.")
        for name in ("width", "until", "step"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise click.UsageError(f"--{name} {value:g}: must be greater than 0 (s).")


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
@click.option("--around", type=float, metavar="T", help="Of a close-up: its moment [first impact], s.")
@click.option("--width", type=float, default=0.1, metavar="T", help="Of a close-up: its length [0.1], s.")
@click.option("--until", type=float, metavar="T", help="End of the time axis [when it has died down], s.")
@click.option("--step", type=float, metavar="T", help="Between saved or drawn samples [solver.step], s.")
@json_option
def simulate(
    source: Path,
    overrides: tuple[str, ...],
    at: tuple[str, ...],
    lash: str | None,
    overlay: tuple[str, ...],
    output: Path | None,
    as_json: bool,
    **drawing: Any,
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
    from clunk.results import targets
    from clunk.simulation.energy import balance
    from clunk.simulation.trajectory import simulate as run
    from clunk.study.lashes import lash_position

    options = Drawing(**drawing)
    options.check(output)
    studies = _studies_to_simulate(source, overrides, at, overlay)
    if output is not None:
        targets.check(output, (*targets.PICTURES, ".csv"), reads=source)
        if output.suffix.lower() == ".csv" and len(studies) > 1:
            raise click.UsageError(f"{output} takes one run; leave --overlay out, or name a picture.")
    terminal.say_if_compiling(*(study for _, study in studies))
    for _, study in studies:
        terminal.warn_of_coarse_step(study, study.solver.method)
    positions = [lash_position(lash, study.lash_names) for _, study in studies]
    runs = [(name, run(study)) for name, study in studies]
    if as_json:
        records = [
            {"run": name} | trajectory_record(trajectory) | {"energy": energy_record(balance(trajectory))}
            for name, trajectory in runs
        ]
        tables.print_record(records if overlay else records[0])
    else:
        for k, (name, trajectory) in enumerate(runs):
            if overlay:
                click.echo(("\n" if k else "") + name)
            print_trajectory(trajectory)
            click.echo()
            if k == 0:
                click.echo(fill(_legend(trajectory.study)) + "\n")
            print_energy(trajectory, balance(trajectory))
    if output is not None:
        if lash is not None:
            runs = [(name, each.lashes[k]) for (name, each), k in zip(runs, positions, strict=True)]
        _save_runs(runs, output, options, each_lash=lash is None)


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
        values = cells.cell_values(study, at, all_needed=source.suffix == ".h5")
        if has_tolerances(study) and not studies:
            terminal.complain("tolerances are left aside; this is the nominal run")
        single = replace_values(study.model_copy(update={"sweep": None}), values)
        studies.append((", ".join(chosen) or study.title, single))
    return studies


def _save_runs(runs: list[tuple[str, Trajectory]], output: Path, options: Drawing, *, each_lash: bool) -> None:
    """Save or draw runs; each_lash : whether pictures show every lash, or that of the trajectories alone."""
    from clunk.results import historyfile
    from clunk.simulation import history as histories

    if output.suffix.lower() == ".csv":
        ((_, trajectory),) = runs
        historyfile.save_csv(output, histories.sample(trajectory, options.step, options.until))
        terminal.say_written(output)
        return
    from clunk.plot import histories as figures
    from clunk.simulation.small_gap import SmallGap

    latest = max(histories.shown_until(trajectory) for _, trajectory in runs)
    end = latest if options.until is None else options.until
    if options.figure == "closeup" and options.around is not None:
        end = max(end, options.around + 0.6 * options.width)
    drawn = [histories.sample(trajectory, options.step, end, name=name) for name, trajectory in runs]
    if options.figure == "closeup":
        figure = figures.closeup(drawn, options.around, options.width)
    elif options.figure == "small-gap":
        figure = figures.small_gap(runs[0][1].study.title, SmallGap.of(runs[0][1].study))
    else:
        figure = figures.history_figure(drawn, options.figure, each_lash=each_lash)
    terminal.save_picture(figure, output)


def _legend(study: Study) -> str:
    """Meaning of the symbols in the tables of a run."""
    from clunk.simulation.driveline import Driveline

    names = Driveline.from_study(study).names
    first, second = study.lashes[0].between
    ratio = f"{study.lashes[0].ratio:g} " if study.lashes[0].ratio != 1.0 else ""
    ends = [str(end) if end == "ground" else names[int(end) - 1] for end in (first, second)]
    gap = f"the gap, {ends[0]} less {ratio}{ends[1]}," if len(study.lashes) == 1 else "a lash's gap"
    of = study.impacts.acceleration_of
    whose = "the lash's first inertia" if of is None else names[of - 1]
    return (
        f"(time: after the load step; q': rate of {gap} just before the event; Qi: peak-to-peak acceleration of "
        f"{whose} from a primary impact to the next; O, I: primary impacts on the opposite and the initial flank; "
        "more: clunk help words)"
    )


def print_trajectory(trajectory: Trajectory) -> None:
    """Print the events and the summary of a run, and the measures that its config asks for besides Q and V."""
    rows = trajectory.event_table()
    lash = f"{{:<{max(len(row[2]) for row in rows)}}}  " if len(trajectory.lashes) > 1 else ""
    widths = f"{{:>11}}  {{:<10}}  {lash}{{:<8}}  {{:>10}}  {{:<9}}  {{:>11}}"
    for row in rows:
        click.echo(widths.format(*row).rstrip())
    click.echo(f"{trajectory.end:11.7f}  end: {trajectory.ending}")
    click.echo()
    tables.print_values(trajectory.summary())
    if trajectory.study.measured:
        click.echo()
        tables.print_lashes(dict(zip(trajectory.study.lash_names, trajectory.lashes, strict=True)), print_measures)


def print_measures(trajectory: Trajectory) -> None:
    """Print the measures that the config asks for besides Q and V, of the run and then of its primary impacts."""
    from clunk.results.quantities import measured_quantities

    study, record, rows = trajectory.study, measures_record(trajectory), []
    quantities = measured_quantities(study.impacts.quantities, [dict(each) for each in study.measures])
    for name, value in record["measures"].items():
        of_impacts = words(record["impact_measures"].get(name, ()))
        each = f"; of the impacts {of_impacts}" if of_impacts else ""
        rows.append((name, f"{number(value)} {quantities[name].unit_symbol}{each}"))
    tables.print_values(rows)


def measures_record(trajectory: Trajectory) -> dict[str, Any]:
    """Measures of a run that the config asks for besides Q and V, for JSON; empty where it asks for none."""
    from clunk.simulation.measures import measured

    names = trajectory.study.impacts.quantities
    if not trajectory.study.measured:
        return {}
    totals, of_impacts = measured(trajectory)
    wanted = [*names, *(each.name for each in trajectory.study.measures)]
    return {
        "measures": {name: totals[name] for name in wanted},
        "impact_measures": {name: of_impacts[name].tolist() for name in names},
    }


def trajectory_record(trajectory: Trajectory) -> dict[str, Any]:
    """A run for JSON; of several lashes `lashes` has what is of each, by name."""
    primaries, load = {k for each in trajectory.lashes for k in each.primaries.tolist()}, trajectory.load
    several = len(trajectory.lashes) > 1
    of_lashes = {
        name: {
            "label": each.label,
            "severity": each.severity,
            "approach_velocity": each.approach_velocity,
            "impact_severity": each.impact_severity.tolist(),
            "margin": each.margin,
            **measures_record(each),
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
    }


def print_energy(trajectory: Trajectory, balance: EnergyBalance) -> None:
    """Print the energy balance of a run: stored before and after, taken by dampers and flanks, and the residual."""
    from clunk.simulation.driveline import Driveline

    shafts = trajectory.study.driveline.shafts
    names = [f"shaft {k}, {shaft.between[0]}-{shaft.between[1]}" for k, shaft in enumerate(shafts, 1)]
    shaft_terms = balance.shafts_before, balance.shafts_after, balance.damped_in_shafts, balance.rubbed_in_shafts
    rows = [
        ("inertias", balance.kinetic_before, balance.kinetic_after, 0.0, 0.0),
        *zip(names, *shaft_terms, strict=True),
        ("contact", balance.contact_before, balance.contact_after, balance.damped_in_contact, 0.0),
        ("together", balance.stored_before, balance.stored_after, balance.damped, balance.rubbed),
    ]
    columns = "energy [J]", "before", "after", "damped", "rubbed"
    tables.print_table([dict(zip(columns, row, strict=True)) for row in rows])
    terms = {
        "work of the load": balance.work,
        "lost at impacts": balance.lost_at_impacts,
        "dropped at partings": balance.dropped,
        "regained at rejoins": balance.regained,
    }
    texts = [(name, f"{term:.6g} J") for name, term in terms.items() if term]
    residual = f"{balance.residual:.6g} J, {balance.relative_residual:.1e} of the largest energy"
    tables.print_values([*texts, ("residual", residual)])
    rigid = Driveline.from_study(trajectory.study).rigid_motion
    if rigid.shape.size and not rigid.is_dragged:
        click.echo("(nothing resists the rolling: speeds are those above the speed at the load step)")


def energy_record(balance: EnergyBalance) -> dict[str, Any]:
    """An energy balance for JSON, in J."""
    return vars(balance) | {"residual": balance.residual, "relative_residual": balance.relative_residual}
