"""Tables and JSON records that several commands print on stdout."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from clunk.study.records import Record, Row, counted, plain, table, text_of, value_lines

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from clunk.results.maps import AnyMap

_MOST_LABELS = 24  # rows of a table of labels, about as many as a screen has


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
    """Print all rows as a table with aligned columns, see `clunk.study.records.table`."""
    click.echo("\n".join(table(rows, most=len(rows))))


def print_values(rows: Iterable[tuple[str, str]]) -> None:
    """Print pairs of a name and a text, one on each line, see `clunk.study.records.value_lines`."""
    click.echo("\n".join(value_lines(rows)))


def of_lashes(values: dict[str, Any]) -> dict[str, Any]:
    """Record for JSON of values by lash: under `lashes` if there are several, or the only lash's value itself."""
    return {"lashes": values} if len(values) > 1 else next(iter(values.values()))


def print_outcomes(results: AnyMap) -> None:
    """Print, lash by lash, how many cells each label has, or how likely it is, and other facts.

    Of more than 24 labels, only those with the most cells are printed.
    """
    for k, (name, part) in enumerate(results.by_lash().items()):
        if results.lashes:
            click.echo(("\n" if k else "") + name)
        rows, counts = part.label_table(), part.counts()
        shown = sorted(rows, key=lambda row: -counts[row["label"]])[:_MOST_LABELS]
        print_table([row for row in rows if row in shown])
        if len(shown) < len(rows):
            click.echo(f"  and {counted(len(rows) - len(shown), 'label')} of no more cells each; --json prints all")
        if part.facts:
            click.echo()
            print_values(part.facts)


def outcomes(results: AnyMap) -> dict[str, Any]:
    """Record for JSON of the number of cells of each label, by lash as of `of_lashes`.

    Of a tolerance map, it also has each label's share of the runs, and the numbers of cells, draws and failed runs.
    """
    from clunk.results.maps import ToleranceMap

    records: dict[str, dict[str, Any]] = {}
    for name, part in results.by_lash().items():
        records[name] = {"counts": part.counts()}
        if isinstance(part, ToleranceMap):
            records[name] |= {
                "cells": part.sequence.size,
                "draws": part.draws,
                "shares": part.shares(),
                "uncertain_cells": part.uncertain,
                "failed_runs": part.failed,
            }
    return of_lashes(records)
