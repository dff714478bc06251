"""`clunk info`: what a results file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clunk.cli import tables
from clunk.cli.options import PATH, json_option


@click.command()
@click.argument("file", type=PATH)
@click.option("--config", "show_config", is_flag=True, help="Print the whole resolved config (TOML) instead.")
@click.option("--check", is_flag=True, help="Also read it whole and compare it with its checksums.")
@json_option
def info(file: Path, show_config: bool, check: bool, as_json: bool) -> None:
    """Say what a results file holds: config, versions, regime counts.

    Example: clunk info results/figure_3_4.h5 --check
    """
    from clunk.results import store

    header = store.check(file) if check else store.read_header(file)
    found = store.read_tolerance_map(file) if header.tolerance_map else None
    if show_config:
        click.echo(header.config, nl=not header.config.endswith("\n"))
        return
    if as_json:
        axes = [
            {"parameter": a.parameter, "unit": a.unit, "start": float(a.values[0]), "stop": float(a.values[-1])}
            | {"count": len(a.values)}
            for a in header.axes
        ]
        record: dict[str, Any] = {"title": header.title, "axes": axes}
        if header.coordinates:
            record["coordinates"] = [
                {"parameter": a.parameter, "unit": a.unit, "lowest": float(a.values.min())}
                | {"highest": float(a.values.max())}
                for a in header.coordinates
            ]
        record |= {"counts": header.counts} if found is None else tables.tolerance_record(found)
        record |= {"config_digest": header.config_digest}
        checked: dict[str, Any] = {"checked": {"data": True, "bytes": header.checksum}} if check else {}
        tables.print_record(record | header.attributes | checked)
        return
    click.echo(header.title)
    click.echo()
    for axis in header.axes:
        click.echo(f"axis      {axis.parameter}: {axis.spread}")
    for axis in header.coordinates:
        click.echo(f"along run {axis.parameter}: {axis.spread}")
    for each in header.sample:
        unit = "" if each.unit == "1" else f" {each.unit}"
        click.echo(f"drawn     {each.name}, {each.values.min():.4g} to {each.values.max():.4g}{unit}")
    click.echo(f"config    {header.config_digest[:16]}…")
    for name, value in header.attributes.items():
        click.echo(f"{name.removesuffix('_version'):<9} {value}")
    if check:
        data = "the data match their digest"
        click.echo(
            f"checked   {data}{', the bytes their checksum' if header.checksum else '; the bytes have no checksum:'}"
        )
        if not header.checksum:
            click.echo("          another program has changed the file")
    click.echo()
    if found is None:
        tables.print_counts(header.counts)
    else:
        tables.print_tolerances(found)
