"""Tables and JSON records that several commands print on stdout."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from clunk.study.records import Record, Row, fill, plain, table, text_of, value_lines

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from clunk.results.boundaries import Boundaries
    from clunk.results.maps import AnyMap


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


def by_lash(results: AnyMap) -> Iterator[Any]:
    """The map of each lash; of several, each is announced by its name."""
    for k, (name, part) in enumerate(results.by_lash().items()):
        if results.lashes:
            click.echo(("\n" if k else "") + name)
        yield part


def of_lashes(values: dict[str, Any]) -> Any:
    """Values by lash for JSON; those of an only lash alone."""
    return values if len(values) > 1 else next(iter(values.values()))


def print_outcomes(results: AnyMap) -> None:
    """Print how many cells each label has, or how likely it is, and other facts; lash by lash."""
    for part in by_lash(results):
        print_table(part.label_table())
        click.echo()
        print_values(part.facts)


def outcomes(results: AnyMap) -> dict[str, Any]:
    """How many cells each label has, or how likely it is, for JSON; of several lashes, by lash."""
    from clunk.results.maps import ToleranceMap

    parts = results.by_lash()
    if not isinstance(results, ToleranceMap):
        return {"counts": of_lashes({name: part.counts() for name, part in parts.items()})}
    records = {
        name: {
            "cells": part.sequence.size,
            "draws": part.draws,
            "counts": part.counts(),
            "shares": part.shares(),
            "uncertain_cells": part.uncertain,
            "failed_runs": part.failed,
        }
        for name, part in results.by_lash().items()
    }
    return {"lashes": records} if results.lashes else of_lashes(records)


def print_boundaries(boundaries: Boundaries) -> None:
    """Print the labels that meet at each junction, and what is unresolved."""
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
            for curve in boundaries.curves
        ],
        "junctions": [{"at": place.tolist(), "labels": labels} for place, labels in boundaries.meetings],
        "areas": boundaries.areas,
        "unresolved": boundaries.unresolved.tolist(),
    }
