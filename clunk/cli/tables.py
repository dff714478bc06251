"""Tables and JSON records that several commands print on stdout; numbers as text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clunk.cli import phrases, terminal

if TYPE_CHECKING:
    from clunk.results.tolerancemap import ToleranceMap


def print_record(record: object) -> None:
    """Print a record as one line of JSON; numbers that are not finite are null."""
    click.echo(json.dumps(phrases.plain(record), ensure_ascii=False))


def report_counts(counts: dict[str, int], target: Path, seconds: float, as_json: bool) -> int:
    """Print the counts; returns how many cells have failed."""
    if as_json:
        cells = sum(counts.values())
        summary = {"file": str(target), "cells": cells, "seconds": round(seconds, 3), "counts": counts}
        print_record(summary)
    else:
        print_counts(counts)
    return counts["failed"]


def report_tolerances(found: ToleranceMap, target: Path, seconds: float, as_json: bool) -> int:
    """Print what a tolerance map comes to; returns how many runs have failed."""
    if as_json:
        summary = {"file": str(target), "seconds": round(seconds, 3)} | tolerance_record(found)
        print_record(summary)
    else:
        print_tolerances(found)
    return found.failed


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
            click.echo(f"{label:<{width}}  {phrases.cells(count):>15}  {count / cells:6.1%}  {shares[label]:11.4%}")
    click.echo()
    uncertain = f"{phrases.cells(found.uncertain)} of {cells:,}, {found.uncertain / cells:.1%}"
    click.echo(f"uncertain (no label has {CERTAIN:.0%} of the {found.draws:,} draws): {uncertain}")
    moved = int((found.sequence != found.nominal_sequence).sum())
    click.echo(f"another most likely label than without tolerances: {phrases.cells(moved)} of {cells:,}")
    if found.failed:
        runs = cells * found.draws
        affected = phrases.cells(int((found.runs[..., -1] > 0).sum()))
        terminal.complain(f"{found.failed:,} of {runs:,} runs failed, in {affected}")


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
