"""What the command line prints: complaints on stderr, tables for 80 columns on stdout."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from clunk.analysis.sobol import Indices, Sensitivity
    from clunk.analysis.verification import Verification
    from clunk.report.claims import Claim
    from clunk.results.results import Results
    from clunk.results.tolerancemap import ToleranceMap
    from clunk.simulation.energy import EnergyBalance
    from clunk.simulation.trajectory import Trajectory
    from clunk.study.axes import ResultAxis

_WIDTH = 80


def complain(text: str) -> None:
    """Print what is wrong, within the width of a terminal; a report that is laid out already stays as it is."""
    for line in text.splitlines():
        click.echo(line if len(line) <= _WIDTH else textwrap.fill(line, _WIDTH, break_on_hyphens=False), err=True)


def report_resumed(taken_up: int, discarded: int) -> None:
    """What a stopped sweep had left."""
    if taken_up:
        click.echo(f"{_cells(taken_up)} were finished before; going on from there", err=True)
    if discarded:
        what = "part" if discarded == 1 else "parts"
        click.echo(f"{discarded:,} {what} of other versions, or damaged: their cells are run again", err=True)


def report_speed(
    total: int, ran: int, taken_up: int, seconds: float, target: Path, *, inferred: bool = False, draws: int = 0
) -> None:
    """How many cells ran, how many of them were taken up, and how fast; of a tolerance map, each for all draws."""
    runs = (ran - taken_up) * (draws + 1)  # and nominally
    rate = f" ({runs / seconds:,.0f} runs/s)" if ran > taken_up and seconds > 0.0 else ""
    each = f" x {draws:,} draws" if draws else ""
    click.echo(f"{_cells(total)}{each} in {seconds:.1f} s{rate} -> {target}", err=True)
    if inferred:
        click.echo(f"{ran:,} of them were run; the others are inferred from their neighbours", err=True)


def _cells(count: int) -> str:
    return f"{count:,} {'cell' if count == 1 else 'cells'}"


def report_failures(results: Results | ToleranceMap, how: str = "") -> None:
    """Failed cells by cause, and where the first few are; `how` goes after "failed"."""
    import numpy as np

    from clunk.core.status import Status
    from clunk.results.results import values_at

    for status in Status:
        cells = np.argwhere(results.status == status)
        if status == Status.OK or cells.size == 0:
            continue
        complain(f"{_cells(len(cells))} failed{how}: {status.sentence}")
        for cell in cells[:3]:
            values = values_at(results.axes, cell, results.coordinates)
            click.echo(at_cell(results.parameters, values), err=True)
        if len(cells) > 3:
            click.echo(f"  and {len(cells) - 3:,} more", err=True)


def at_cell(parameters: Sequence[ResultAxis], values: Sequence[float], indent: int = 2) -> str:
    """A cell by its parameters, for example at load.ratio = 5, wrapped."""
    named = ", ".join(f"{axis.parameter} = {value:.6g}" for axis, value in zip(parameters, values, strict=True))
    blank = " " * indent
    look: dict[str, Any] = {"initial_indent": blank, "subsequent_indent": blank + "   ", "break_on_hyphens": False}
    return textwrap.fill(f"at {named}", _WIDTH, **look)


def print_counts(counts: dict[str, int]) -> None:
    """How many cells each label has."""
    total = sum(counts.values())
    width = max(len(label) for label in counts)
    for label, count in counts.items():
        if label != "failed" or count:
            click.echo(f"{label:<{width}}  {count:>9,} {'cell ' if count == 1 else 'cells'}  {count / total:6.1%}")


def print_tolerances(found: ToleranceMap) -> None:
    """In how many cells each label is the most likely one, its share of all runs, and how many cells are uncertain."""
    from clunk.results.tolerancemap import CERTAIN

    counts, shares = found.counts(), found.shares()
    cells, width = sum(counts.values()), max(len(label) for label in counts)
    click.echo(f"{'':<{width}}  {'most likely in':>15}  {'of all runs':>19}")
    for label, count in counts.items():
        if label != "failed" or shares[label]:
            click.echo(f"{label:<{width}}  {_cells(count):>15}  {count / cells:6.1%}  {shares[label]:11.4%}")
    click.echo()
    uncertain = f"{_cells(found.uncertain)} of {cells:,}, {found.uncertain / cells:.1%}"
    click.echo(f"uncertain (no label has {CERTAIN:.0%} of the {found.draws:,} draws): {uncertain}")
    moved = int((found.sequence != found.nominal_sequence).sum())
    click.echo(f"another most likely label than without tolerances: {_cells(moved)} of {cells:,}")
    if found.failed:
        runs = cells * found.draws
        complain(f"{found.failed:,} of {runs:,} runs failed, in {_cells(int((found.runs[..., -1] > 0).sum()))}")


def tolerance_record(found: ToleranceMap) -> dict[str, Any]:
    """A tolerance map for JSON."""
    counts = found.counts()
    return {
        "cells": sum(counts.values()),
        "draws": found.draws,
        "counts": counts,
        "shares": found.shares(),
        "uncertain_cells": found.uncertain,
        "failed_runs": found.failed,
    }


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
        name: [_or_none(item) for item in value] if isinstance(value, tuple) else _or_none(value)
        for name, value in record.items()
    }


def trajectory_record(trajectory: Trajectory) -> dict[str, Any]:
    """A run for JSON; what is not defined is null."""
    primaries = set(trajectory.primaries.tolist())
    return {
        "label": trajectory.label,
        "severity": _or_none(trajectory.severity),
        "approach_velocity": trajectory.approach_velocity,
        "impact_severity": [_or_none(value) for value in trajectory.impact_severity.tolist()],
        "complete": trajectory.complete,
        "margin": _or_none(trajectory.margin),
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


def _or_none(value: float) -> float | None:
    """JSON has neither NaN nor infinities."""
    return value if math.isfinite(value) else None


def print_claims(claims: Sequence[Claim]) -> None:
    """The report's claims beside ours."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1), show_lines=False, leading=1)
    table.add_column("where", max_width=10)
    table.add_column("the report", ratio=2)
    table.add_column("clunk", ratio=3)
    table.add_column("verdict", max_width=11)
    for claim in claims:
        table.add_row(claim.where, claim.report, claim.ours, claim.verdict.value + (" (!)" if claim.failed else ""))
    Console(highlight=False, markup=False).print(table)


_QUANTITIES = {
    "impact_time": ("time of a primary impact", "s"),
    "last_event_time": ("time of the last event", "s"),
    "severity": ("severity Q", "rad/s²"),
    "impact_severity": ("an impact's Qi", "rad/s²"),
    "approach_velocity": ("approach velocity V", "rad/s"),
}
_MOST_DISAGREEMENTS = 8


def print_verification(found: Verification) -> None:
    """What two methods agree on and what not, and last of all the verdict."""
    from clunk.analysis.verification import GUARDED

    rates = ["" if found.events else f"; {found.cells / max(seconds, 1e-9):,.0f} runs/s" for seconds in found.seconds]
    click.echo(f"rk4    a fixed step of {found.study.solver.step:g} s{rates[0]}")
    click.echo(f"exact  {GUARDED}{rates[1]}")
    click.echo()
    if found.events:
        _print_event_pairs(found)
    else:
        _print_cell_counts(found)
    _print_largest(found)
    if not found.events:
        for flagged, count in ((False, found.differing_elsewhere), (True, found.differing_flagged)):
            _print_disagreements(found, flagged, count)
    click.echo()
    click.echo(textwrap.fill(found.verdict, _WIDTH))


def _print_cell_counts(found: Verification) -> None:
    from clunk.core.status import QUALITY_COMPLETE, QUALITY_GRAZING, QUALITY_UNDECIDED

    tolerance = found.study.solver.margin_tolerance
    rows = [
        ("cells", found.cells),
        ("failed", found.failed),
        ("labels equal", found.equal),
        ("labels differ in flagged cells", found.differing_flagged),
        ("labels differ elsewhere", found.differing_elsewhere),
        ("number of touches equal", found.equal_touches),
        (f"flagged: undecided, |margin| < {tolerance:g}", found.count("exact", QUALITY_UNDECIDED)),
        ("flagged: grazing", found.count("exact", QUALITY_GRAZING)),
        ("complete by exact", found.count("exact", QUALITY_COMPLETE)),
        ("complete by rk4", found.count("rk4", QUALITY_COMPLETE)),
    ]
    for what, count in rows:
        if count or what != "failed":
            click.echo(f"{what:<40}{count:>11,}  {_share(count, found.cells):>10}")


def _print_event_pairs(found: Verification) -> None:
    happened = [pair for pair in found.events if pair.kind != "load step"]
    click.echo("    rk4 [s]   exact [s]  difference  event       flank" if happened else "no events")
    for pair in happened:
        times = f"{_number(pair.rk4, '.7f'):>11} {_number(pair.exact, '.7f'):>11}"
        difference = _number(pair.rk4 - pair.exact, "+.1e")
        click.echo(f"{times}  {difference:>10}  {pair.kind:<10}  {pair.flank}")
    click.echo()
    click.echo(f"{'':<12}{'rk4':<24}exact")
    labels = [results.labels[int(results.sequence.flat[0])] for results in (found.rk4, found.exact)]
    click.echo(f"{'label':<12}{labels[0]:<24}{labels[1]}")
    click.echo(f"{'touches':<12}{found.rk4.touches.flat[0]:<24}{found.exact.touches.flat[0]}")
    flag = "flagged" if found.flagged.any() else f"solver.margin_tolerance is {found.study.solver.margin_tolerance:g}"
    click.echo(f"{'margin':<12}{'-':<24}{_number(float(found.exact.margin.flat[0]), '+.3g')}; {flag}")


def _print_largest(found: Verification) -> None:
    from clunk.analysis.verification import SMALL

    if not found.largest:
        return
    click.echo()
    where = "" if found.events else " in cells with equal labels"
    of_largest = "" if found.events else "over largest"
    click.echo(f"{'largest difference' + where:<50}{of_largest:>13}{'over own':>12}")
    for each in found.largest:
        name, unit = _QUANTITIES[each.quantity]
        line = f"  {name:<26}{f'{each.difference:.1e} {unit}':>22}"
        if unit != "s":
            line += f"{'' if found.events else format(each.of_largest, '.1e'):>13}{_number(each.of_own, '.1e'):>12}"
        click.echo(line)
        if not found.events and each.difference > 0.0:
            click.echo(at_cell(found.comparison.parameters, each.values, indent=4))
            if each.touches[0] != each.touches[1]:
                click.echo(f"    with {each.touches[0]} touches by rk4 and {each.touches[1]} by exact")
    if not found.events:
        click.echo(f"  (largest: of the map; own: the value itself, where it is {100 * SMALL:g} % of that or more)")
    if found.study.lash.contact.model == "restitution":
        click.echo("  (Q and Qi are not defined for the restitution model)")


def _print_disagreements(found: Verification, flagged: bool, count: int) -> None:
    from itertools import islice

    if not count:
        return
    shown = list(islice(found.disagreements(flagged=flagged), _MOST_DISAGREEMENTS))
    click.echo()
    what = "labels differ in flagged cells" if flagged else "labels differ elsewhere"
    click.echo(what + (f", the first {len(shown)} of {count:,}" if count > len(shown) else ""))
    parameters = found.comparison.parameters
    if len(parameters) > 2:  # a table of more would be too wide
        for each in shown:
            click.echo(f"  {each.rk4} by rk4, {each.exact} by exact; margin {each.margin:+.2g}")
            click.echo(at_cell(parameters, each.values, indent=4))
        return
    rows = [[*(axis.parameter for axis in parameters), "rk4", "exact", "margin"]]
    rows += [[*(f"{v:.6g}" for v in each.values), each.rk4, each.exact, f"{each.margin:+.2g}"] for each in shown]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        click.echo("  " + "  ".join(f"{text:<{width}}" for text, width in zip(row, widths, strict=True)).rstrip())


def print_sensitivity(found: Sensitivity) -> None:
    """What is drawn and what came of it, then every quantity's Sobol indices by falling total index."""
    from clunk.analysis.sobol import distribution_phrase

    width = max(len(parameter) for parameter in found.parameters)
    for draw in found.draws:
        line = f"{draw.parameter:<{width}}  {distribution_phrase(found.study, draw)}"
        click.echo(textwrap.fill(line, _WIDTH, subsequent_indent=" " * (width + 2), break_on_hyphens=False))
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
            f"{'with tolerances' if k == 0 else '':<18}  {label:<{wide}}  {_share(count, 2 * found.samples):>10}"
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


def _share(count: int, of: int) -> str:
    """A share that never says none or all where that is not so."""
    share = count / of
    return "> 99.99 %" if 0.9999 < share < 1.0 else "< 0.01 %" if 0.0 < share < 0.0001 else f"{100.0 * share:.2f} %"


def _number(value: float, how: str) -> str:
    return "-" if math.isnan(value) else f"{value:{how}}"
