"""`clunk info`: what a results file holds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clunk.cli import tables
from clunk.cli.options import PATH, json_option
from clunk.study.records import fill


@click.command()
@click.argument("file", type=PATH)
@click.option("--config", "show_config", is_flag=True, help="Print the whole resolved config (TOML) instead.")
@click.option("--map", "show_map", is_flag=True, help="Also print the map, a letter for each cell.")
@click.option("--check", is_flag=True, help="Also say that its data and its bytes match their checksums.")
@json_option
def info(file: Path, show_config: bool, show_map: bool, check: bool, as_json: bool) -> None:
    """Say what a results file holds.

    Prints its axes, load, versions and how many cells each label has.

    \b
    Examples:
      clunk info results/figure_3_4.h5 --check
      clunk info results/figure_3_4.h5 --map
    """
    from clunk.cli.textmap import is_drawable
    from clunk.results import netcdf, store
    from clunk.study.loads import PROFILES, numbers

    has_checksum = netcdf.check(file) if check else False
    results = store.read_map(file)
    if show_map and as_json:
        raise click.UsageError("--map is for people and does not go with --json; clunk export writes each cell.")
    if show_map and not is_drawable(results.axes[:-1] if results.lashes else results.axes):
        raise click.UsageError("--map shows one axis or two; of more, clunk plot --at draws a slice.")
    if show_config:
        click.echo(results.config, nl=not results.config.endswith("\n"))
        return
    if as_json:
        axes = [
            {"parameter": axis.parameter, "unit": axis.unit}
            | {"start": axis.values[0], "stop": axis.values[-1], "count": len(axis.values)}
            for axis in results.axes
            if not axis.words
        ]
        coordinates = [
            {"parameter": axis.parameter, "unit": axis.unit, "lowest": axis.values.min(), "highest": axis.values.max()}
            for axis in results.coordinates
        ]
        record: dict[str, Any] = {"title": results.title, "axes": axes}
        record |= {"coordinates": coordinates} if coordinates else {}
        record |= tables.outcomes(results)
        if results.boundaries is not None:
            record |= {"boundaries": tables.boundary_record(results.boundaries)}
        record |= {"caveats": results.caveats, "config_digest": results.config_digest}
        checked: dict[str, Any] = {"checked": {"data": True, "bytes": has_checksum}} if check else {}
        tables.print_record(record | results.attributes | checked)
        return
    rows = [*results.summary()]
    load = results.setting("load")
    if load is not None:
        swept = {axis.parameter for axis in results.parameters}
        rows.append(("load", ", ".join([PROFILES[load["profile"]].name, *numbers(load, swept)])))
    rows.append(("config", f"{results.config_digest[:16]}…"))
    rows += [(name.removesuffix("_version"), str(value)) for name, value in results.attributes.items()]
    if check:
        of_bytes = ", the bytes their checksum" if has_checksum else "; another program has changed the file, so that"
        of_bytes += "" if has_checksum else " its bytes have no checksum"
        rows.append(("checked", f"the data match their digest{of_bytes}"))
    click.echo(f"{results.title}\n")
    tables.print_values(rows)
    click.echo()
    tables.print_outcomes(results)
    if results.boundaries is not None:
        click.echo()
        tables.print_boundaries(results.boundaries)
    for caveat in results.caveats:
        click.echo(fill(f"note: {caveat}"))
    if show_map:
        click.echo()
        tables.print_map(results)
