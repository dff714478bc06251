"""`clunk info`: what a results file holds."""

from pathlib import Path

import click

from clunk.cli import tables
from clunk.cli.options import file_argument, flag_option, json_option
from clunk.study.records import fill, table


@click.command()
@file_argument
@flag_option("--config", "show_config", help="Print the whole resolved config (TOML) instead.")
@flag_option("--check", help="Also check that the bytes of FILE match its checksum.")
@json_option
def info(file: Path, show_config: bool, check: bool, as_json: bool) -> None:
    """Say what a results file holds.

    Prints its axes, load, versions and how many cells each label has.

    Example: clunk info results/figure_3_4.h5 --check
    """
    from clunk.results import store

    results = store.read_map(file)
    boundaries = results.boundaries
    if show_config:
        click.echo(results.config, nl=not results.config.endswith("\n"))
        return
    if as_json:
        axes = [
            {"parameter": axis.parameter, "unit": axis.unit}
            | {"lowest": axis.values.min(), "highest": axis.values.max(), "count": len(axis)}
            for axis in results.parameters
            if not axis.words
        ]
        record = {"title": results.title, "axes": axes} | tables.outcomes(results)
        if boundaries is not None:
            record["boundaries"] = {"areas": boundaries.areas, "unresolved": boundaries.unresolved}
        record |= {"caveats": results.caveats, "config_digest": results.config_digest} | results.attributes
        record |= {"checked": {"data": True, "bytes": True}} if check else {}
        tables.print_record(record)
        return
    rows = [*results.summary()]
    if load := results.load_phrase():
        rows.append(("load", load))
    rows.append(("config", f"{results.config_digest[:16]}…"))
    rows += [(name.removesuffix("_version"), value) for name, value in results.attributes.items()]
    if check:
        rows.append(("checked", "the bytes match their checksum"))
    click.echo(f"{results.title}\n")
    tables.print_values(rows)
    click.echo()
    tables.print_outcomes(results)
    if boundaries is not None:
        if boundaries.meetings:
            click.echo()
            click.echo("\n".join(table(boundaries.meeting_rows())))
        if boundaries.unresolved_sentence:
            click.echo(fill(boundaries.unresolved_sentence))
    for caveat in results.caveats:
        click.echo(fill(f"note: {caveat}"))
