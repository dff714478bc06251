"""`clunk verify`: one study by both methods."""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import phrases, tables, terminal
from clunk.cli.options import EXIT_FAILED_CELLS, EXIT_MISMATCH, PATH, json_option, set_option, workers_option
from clunk.study.summaries import WIDTH, counted
from clunk.sweeping import progress

if TYPE_CHECKING:
    from clunk.analysis.verification import Verification


@click.command()
@click.argument("config", type=PATH)
@set_option
@workers_option
@json_option
def verify(config: Path, overrides: tuple[str, ...], workers: int | None, as_json: bool) -> None:
    """Run a config by both methods and compare the results.

    The methods are rk4 and exact; labels, events and severity are compared. Exact is guarded: it cannot skip an event,
    to rounding, for this model. Where labels differ in a cell that it does not flag (undecided or grazing), the exit
    code is 4. A config without axes is compared event by event.

    \b
    Examples:
      clunk verify configs/smoke.toml
      clunk verify configs/figure_3_4.toml --set solver.step=5e-5
    """
    from clunk.analysis.verification import METHODS, by
    from clunk.analysis.verification import verify as run_both_methods
    from clunk.study.config import load_study
    from clunk.sweeping.sweep import cell_count

    study = load_study(config, overrides)
    terminal.warn_of_coarse_step(study, "rk4")
    terminal.say_if_compiling(*(by(study, method) for method in METHODS))
    with progress.shown(len(METHODS) * max(cell_count(study), 1)) as show:
        result = run_both_methods(study, workers=workers, progress=show)
    if as_json:
        tables.print_record(as_record(result))
    else:
        print_verification(result)
    for method, results in zip(METHODS, (result.rk4, result.exact), strict=True):
        terminal.report_failures(results, f" by {method}")
    if result.differing_elsewhere:
        sys.exit(EXIT_MISMATCH)
    if result.failed:
        sys.exit(EXIT_FAILED_CELLS)


_MOST_DISAGREEMENTS = 8


def print_verification(result: Verification) -> None:
    """Print the counts, the largest differences, the cells with two labels and the verdict."""
    from clunk.analysis.verification import GUARDED

    rates = [
        "" if result.events else f"; {result.cells / max(seconds, 1e-9):,.0f} runs/s" for seconds in result.seconds
    ]
    click.echo(f"rk4    a fixed step of {result.study.solver.step:g} s{rates[0]}")
    click.echo(f"exact  {GUARDED}{rates[1]}")
    click.echo()
    if result.events:
        _print_event_pairs(result)
    else:
        _print_cell_counts(result)
    _print_largest(result)
    if not result.events:
        for flagged, count in ((False, result.differing_elsewhere), (True, result.differing_flagged)):
            _print_disagreements(result, flagged, count)
    click.echo()
    click.echo(textwrap.fill(verdict(result), WIDTH))


def _print_cell_counts(result: Verification) -> None:
    from clunk.core.status import QUALITY_COMPLETE, QUALITY_GRAZING, QUALITY_UNDECIDED

    tolerance = result.study.solver.margin_tolerance
    rows = [
        ("cells", result.cells),
        ("failed", result.failed),
        ("labels equal", result.equal),
        ("labels differ in flagged cells", result.differing_flagged),
        ("labels differ elsewhere", result.differing_elsewhere),
        ("number of touches equal", result.equal_touches),
        (f"flagged: undecided, |margin| < {tolerance:g}", result.count("exact", QUALITY_UNDECIDED)),
        ("flagged: grazing", result.count("exact", QUALITY_GRAZING)),
        ("complete by exact", result.count("exact", QUALITY_COMPLETE)),
        ("complete by rk4", result.count("rk4", QUALITY_COMPLETE)),
    ]
    for what, count in rows:
        if count or what != "failed":
            click.echo(f"{what:<40}{count:>11,}  {phrases.share(count, result.cells):>10}")


def _print_event_pairs(result: Verification) -> None:
    happened = [pair for pair in result.events if pair.name != "load step"]
    several = len(result.study.lashes) > 1
    wide = max(map(len, result.study.lash_names)) if several else 0
    lash = f"  {'lash':<{wide}}" if several else ""
    click.echo(f"    rk4 [s]   exact [s]  difference  event     {lash}  flank" if happened else "no events")
    for pair in happened:
        times = f"{phrases.number(pair.rk4, '.7f'):>11} {phrases.number(pair.exact, '.7f'):>11}"
        difference = phrases.number(pair.rk4 - pair.exact, "+.1e")
        lash = f"  {pair.lash:<{wide}}" if several else ""
        click.echo(f"{times}  {difference:>10}  {pair.name:<10}{lash}  {pair.flank}")
    flag = "flagged" if result.flagged.any() else f"solver.margin_tolerance is {result.study.solver.margin_tolerance:g}"
    for name, rk4 in result.rk4.by_lash().items():
        exact = result.exact.of_lash(name)
        click.echo()
        click.echo(f"{name if several else '':<12}{'rk4':<24}exact")
        labels = [str(results.label_map.flat[0]) for results in (rk4, exact)]
        click.echo(f"{'label':<12}{labels[0]:<24}{labels[1]}")
        click.echo(f"{'touches':<12}{rk4.touches.flat[0]:<24}{exact.touches.flat[0]}")
        click.echo(f"{'margin':<12}{'-':<24}{phrases.number(float(exact.margin.flat[0]), '+.3g')}; {flag}")


def _print_largest(result: Verification) -> None:
    from clunk.analysis.verification import SMALL
    from clunk.results.quantities import REGIME_QUANTITIES

    if not result.largest:
        return
    click.echo()
    where = "" if result.events else " in cells with equal labels"
    click.echo(f"{'largest difference' + where:<50}{'' if result.events else 'over largest':>13}{'over own':>12}")
    for each in result.largest:
        quantity = REGIME_QUANTITIES[each.quantity]
        unit = quantity.unit_symbol
        line = f"  {quantity.heading:<26}{f'{each.difference:.1e} {unit}':>22}"
        if unit != "s":
            of_largest = "" if result.events else format(each.of_largest, ".1e")
            line += f"{of_largest:>13}{phrases.number(each.relative, '.1e'):>12}"
        click.echo(line)
        if not result.events and each.difference > 0.0:
            click.echo(phrases.at_cell(result.comparison.parameters, each.values, indent=4))
            if each.touches[0] != each.touches[1]:
                click.echo(f"    with {each.touches[0]} touches by rk4 and {each.touches[1]} by exact")
    if not result.events:
        click.echo(f"  (largest: of the map; own: the value itself, where it is {100 * SMALL:g} % of that or more)")
    if result.study.lashes[0].contact.model == "restitution":
        click.echo("  (Q and Qi are not defined for the restitution model)")


def _print_disagreements(result: Verification, flagged: bool, count: int) -> None:
    from itertools import islice

    if not count:
        return
    shown = list(islice(result.disagreements(flagged=flagged), _MOST_DISAGREEMENTS))
    click.echo()
    what = "labels differ in flagged cells" if flagged else "labels differ elsewhere"
    click.echo(what + (f", the first {len(shown)} of {count:,}" if count > len(shown) else ""))
    cells = [(each.values, (each.a, each.b, f"{result.exact.margin[each.at]:+.2g}")) for each in shown]
    heads, sentence = ("rk4", "exact", "margin"), "{} by rk4, {} by exact; margin {}"
    click.echo("\n".join(phrases.cells_with_two_labels(result.comparison.parameters, cells, heads, sentence)))


def verdict(result: Verification) -> str:
    """Sentence on whether the methods agree."""
    compared, differing, step = (
        result.comparison.cells,
        result.differing_elsewhere,
        result.study.solver.step,
    )
    advice = f"a smaller solver.step than {step:g} s may mend it."
    if not compared:
        return "There is no verdict: no cell has a label by both methods."
    if result.events:
        if not result.comparison.differing:
            return "The methods agree: the run has the same label."
        if result.agrees:
            return "The methods agree: the run has two labels, and exact flags it."
        return f"The methods disagree: the run has two labels and exact does not flag it; {advice}"
    where = f"all {compared:,} cells" if compared > 1 else "the one cell"
    where += " that did not fail" if result.failed else ""
    if not result.comparison.differing:
        return f"The methods agree: the same label in {where}."
    if result.agrees:
        return (
            f"The methods agree: the same label in {where} but {result.differing_flagged:,}, and exact flags each of "
            "those."
        )
    return (
        f"The methods disagree: two labels in {counted(differing, 'cell')} of {compared:,} that exact does not flag; "
        f"{advice}"
    )


def as_record(result: Verification) -> dict[str, Any]:
    """A verification for JSON; NaN where something is not defined."""
    from clunk.analysis.verification import GUARDED, METHODS
    from clunk.core.status import QUALITY_COMPLETE, QUALITY_GRAZING, QUALITY_UNDECIDED, Status

    parameters = result.comparison.parameters if result.study.sweep else ()  # a single run has none
    return {
        "title": result.study.title,
        "agrees": result.agrees,
        "verdict": verdict(result),
        "exact_is": GUARDED,
        "step": result.study.solver.step,
        "margin_tolerance": result.study.solver.margin_tolerance,
        "cells": result.cells,
        "failed": {
            method: int((results.status != Status.OK).sum())
            for method, results in zip(METHODS, (result.rk4, result.exact), strict=True)
        },
        "seconds": dict(zip(METHODS, result.seconds, strict=True)),
        "labels_equal": result.equal,
        "labels_differ_flagged": result.differing_flagged,
        "labels_differ_elsewhere": result.differing_elsewhere,
        "touches_equal": result.equal_touches,
        "share_undecided": result.count("exact", QUALITY_UNDECIDED) / result.cells,
        "share_grazing": result.count("exact", QUALITY_GRAZING) / result.cells,
        "share_complete": {method: result.count(method, QUALITY_COMPLETE) / result.cells for method in METHODS},
        "largest_differences": [
            {
                "quantity": largest.quantity,
                "difference": largest.difference,
                "over_largest": largest.of_largest,
                "over_own": largest.relative,
                "at": phrases.at_record(parameters, largest.values),
                "touches": dict(zip(METHODS, largest.touches, strict=True)),
            }
            for largest in result.largest
        ],
        "differing_cells": [
            {
                "at": phrases.at_record(parameters, cell.values),
                "rk4": cell.a,
                "exact": cell.b,
                "margin": float(result.exact.margin[cell.at]),
                "flagged": flagged,
            }
            for flagged in (False, True)
            for cell in result.disagreements(flagged=flagged)
        ],
        "events": [
            {"event": event.name}
            | ({"lash": event.lash} if len(result.study.lashes) > 1 else {})
            | {"flank": event.flank, "rk4": event.rk4, "exact": event.exact}
            for event in result.events
        ],
    }
