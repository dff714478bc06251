"""Tables and JSON records that several commands print on stdout."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, TypeVar

import click

from clunk.cli import terminal
from clunk.study.records import Record, Row, fill, plain, table, text_of, value_lines
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


def print_counts(counts: dict[str, int]) -> None:
    """Print the number and the share of cells of each label."""
    total = sum(counts.values())
    print_table(
        [
            {"label": label, "cells": f"{count:,}", "share": f"{count / total:.1%}"}
            for label, count in counts.items()
            if label != "failed" or count
        ]
    )


def print_tolerances(tolerances: ToleranceMap) -> None:
    """Print how often each label is the most likely one, its share of all runs, and the number of uncertain cells."""
    from clunk.results.tolerancemap import CERTAIN

    counts, shares = tolerances.counts(), tolerances.shares()
    cells = sum(counts.values())
    print_table(
        [
            {"label": label, "cells where it is most likely": f"{count:,}", "share of all runs": f"{shares[label]:.4%}"}
            for label, count in counts.items()
            if label != "failed" or shares[label]
        ]
    )
    moved = int((tolerances.sequence != tolerances.nominal_sequence).sum())
    click.echo()
    click.echo(
        f"uncertain (no label has {CERTAIN:.0%} of the {tolerances.draws:,} draws): {tolerances.uncertain:,} of "
        f"{counted(cells, 'cell')}\nanother most likely label than without tolerances: {moved:,}"
    )
    if tolerances.failed:
        affected = counted(int((tolerances.runs[..., -1] > 0).sum()), "cell")
        terminal.complain(f"{tolerances.failed:,} of {cells * tolerances.draws:,} runs failed, in {affected}")


def print_outcomes(results: AnyMap) -> None:
    """Print how many cells each label has, lash by lash, or how likely it is."""
    from clunk.results.tolerancemap import ToleranceMap

    if isinstance(results, ToleranceMap):
        print_lashes(results.by_lash(), print_tolerances)
    else:
        print_lashes(results.counts_of_lashes, print_counts)


def outcomes(results: AnyMap) -> dict[str, Any]:
    """How many cells each label has, or how likely it is, for JSON; of several lashes, by lash."""
    from clunk.results.tolerancemap import ToleranceMap

    if not isinstance(results, ToleranceMap):
        return {"counts": of_lashes(results.counts_of_lashes)}
    records = {
        name: {
            "cells": sum(each.counts().values()),
            "draws": each.draws,
            "counts": each.counts(),
            "shares": each.shares(),
            "uncertain_cells": each.uncertain,
            "failed_runs": each.failed,
        }
        for name, each in results.by_lash().items()
    }
    return {"lashes": records} if len(records) > 1 else of_lashes(records)


def print_boundaries(boundaries: Boundaries) -> None:
    """Print how many boundaries there are, and the labels that meet at each junction."""
    ((name, numbers),) = boundaries.summary()
    click.echo(f"{name} {numbers}")
    if rows := boundaries.meeting_rows():
        print_table(rows)
    if boundaries.unresolved_sentence:
        click.echo(fill(boundaries.unresolved_sentence))


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
