"""Tables and JSON records that several commands print on stdout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from clunk.cli import terminal
from clunk.study.records import Record, Row, plain, table, text_of, value_lines
from clunk.study.summaries import counted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from clunk.results.boundaries import Boundaries
    from clunk.results.tolerancemap import AnyMap, ToleranceMap

Value = TypeVar("Value")


def print_record(record: object) -> None:
    """Print a record as one line of JSON; numbers that are not finite are null."""
    click.echo(json.dumps(plain(record), ensure_ascii=False))


def tell(record: Record, as_json: bool) -> None:
    """Print a record as text, or as one line of JSON."""
    if as_json:
        print_record(record)
    else:
        click.echo(text_of(record), nl=False)


def print_table(rows: Sequence[Row]) -> None:
    """Print all rows as columns, see `clunk.study.records.table`."""
    click.echo("\n".join(table(rows, most=len(rows))))


def print_values(rows: Iterable[tuple[str, str]]) -> None:
    """Print names and texts, a line each, see `clunk.study.records.value_lines`."""
    click.echo("\n".join(value_lines(rows)))


def report_counts(counts: dict[str, dict[str, int]], target: Path, seconds: float, as_json: bool) -> int:
    """Print the number of cells of each label, lash by lash, or a record of it; returns the number of failed cells."""
    first = next(iter(counts.values()))
    if as_json:
        record = {"file": str(target), "cells": sum(first.values()), "seconds": round(seconds, 3)}
        print_record(record | {"counts": of_lashes(counts)})
    else:
        print_lashes(counts, print_counts)
    return first["failed"]  # all lashes of a cell fail together


def print_map(results: AnyMap) -> None:
    """Print the map of each lash as text."""
    from clunk.cli.textmap import text_map

    maps = {name: text_map(part) for name, part in results.by_lash().items()}
    print_lashes(maps, lambda lines: click.echo("\n".join(lines)))


def of_lashes(values: dict[str, Any]) -> Any:
    """Values by lash for JSON; those of an only lash alone."""
    return values if len(values) > 1 else next(iter(values.values()))


def print_lashes(values: dict[str, Value], show: Callable[[Value], None]) -> None:
    """Print values by lash, each under the lash's name if there are several."""
    for k, (name, value) in enumerate(values.items()):
        if len(values) > 1:
            click.echo(("\n" if k else "") + name)
        show(value)


def report_tolerances(tolerances: ToleranceMap, target: Path, seconds: float, as_json: bool) -> int:
    """Print the summary of a tolerance map, or a record of it; returns the number of failed runs."""
    if as_json:
        print_record({"file": str(target), "seconds": round(seconds, 3)} | tolerance_records(tolerances))
    else:
        print_lashes(tolerances.by_lash(), print_tolerances)
    return tolerances.of_lash().failed


def print_counts(counts: dict[str, int]) -> None:
    """Print the number and the share of cells of each label."""
    total = sum(counts.values())
    width = max(len(label) for label in counts)
    for label, count in counts.items():
        if label != "failed" or count:
            click.echo(f"{label:<{width}}  {count:>9,} {'cell ' if count == 1 else 'cells'}  {count / total:6.1%}")


def print_tolerances(tolerances: ToleranceMap) -> None:
    """Print how often each label is the most likely one, its share of all runs, and the number of uncertain cells."""
    from clunk.results.tolerancemap import CERTAIN

    counts, shares = tolerances.counts(), tolerances.shares()
    cells, width = sum(counts.values()), max(len(label) for label in counts)
    click.echo(f"{'':<{width}}  {'most likely in':>15}  {'of all runs':>19}")
    for label, count in counts.items():
        if label != "failed" or shares[label]:
            click.echo(f"{label:<{width}}  {counted(count, 'cell'):>15}  {count / cells:6.1%}  {shares[label]:11.4%}")
    click.echo()
    uncertain = f"{counted(tolerances.uncertain, 'cell')} of {cells:,}, {tolerances.uncertain / cells:.1%}"
    click.echo(f"uncertain (no label has {CERTAIN:.0%} of the {tolerances.draws:,} draws): {uncertain}")
    moved = int((tolerances.sequence != tolerances.nominal_sequence).sum())
    click.echo(f"another most likely label than without tolerances: {counted(moved, 'cell')} of {cells:,}")
    if tolerances.failed:
        runs = cells * tolerances.draws
        affected = counted(int((tolerances.runs[..., -1] > 0).sum()), "cell")
        terminal.complain(f"{tolerances.failed:,} of {runs:,} runs failed, in {affected}")


def print_boundaries(boundaries: Boundaries) -> None:
    """Print how many boundaries there are, and the labels that meet at each junction."""
    ((name, numbers),) = boundaries.summary()
    click.echo(f"{name} {numbers}")
    if rows := boundaries.meeting_rows():
        print_table(rows)
    if boundaries.unresolved_sentence:
        click.echo(click.wrap_text(boundaries.unresolved_sentence, 80))


def boundary_record(boundaries: Boundaries) -> dict[str, Any]:
    """Boundaries for JSON: the curves without their vertices, the junctions and the areas."""
    of_lash = {"lash": boundaries.lash} if boundaries.lash else {}
    return of_lash | {
        "curves": [
            {"left": curve.left, "right": curve.right, "event": curve.event, "vertices": len(curve.vertices)}
            | ({"value": float(curve.vertices[0, 0])} if len(boundaries.axes) == 1 else {})
            for curve in boundaries.curves
        ],
        "junctions": [{"at": place.tolist(), "labels": labels} for place, labels in boundaries.meetings],
        "areas": boundaries.areas,
        "unresolved": boundaries.unresolved.tolist(),
    }


def tolerance_records(tolerances: ToleranceMap) -> dict[str, Any]:
    """A tolerance map for JSON; of several lashes, by lash."""
    records = {name: tolerance_record(each) for name, each in tolerances.by_lash().items()}
    return {"lashes": records} if len(records) > 1 else of_lashes(records)


def tolerance_record(tolerances: ToleranceMap) -> dict[str, Any]:
    """A tolerance map for JSON."""
    counts = tolerances.counts()
    return {
        "cells": sum(counts.values()),
        "draws": tolerances.draws,
        "counts": counts,
        "shares": tolerances.shares(),
        "uncertain_cells": tolerances.uncertain,
        "failed_runs": tolerances.failed,
    }
