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
@click.option("--check", is_flag=True, help="Also read it whole and compare it with its checksums.")
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
    from clunk.results.quantities import REGIME_QUANTITIES
    from clunk.results.tolerancemap import ToleranceMap
    from clunk.study.loads import PROFILES, numbers

    has_checksum = netcdf.check(file) if check else False
    results = store.read_map(file)
    tolerances = results if isinstance(results, ToleranceMap) else None
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
        if tolerances is None:
            record |= {"counts": tables.of_lashes(results.counts_of_lashes)}
        else:
            record |= tables.tolerance_records(tolerances)
        if results.boundaries is not None:
            record |= {"boundaries": tables.boundary_record(results.boundaries)}
        record |= {"caveats": results.caveats, "config_digest": results.config_digest}
        checked: dict[str, Any] = {"checked": {"data": True, "bytes": has_checksum}} if check else {}
        tables.print_record(record | results.attributes | checked)
        return
    click.echo(results.title)
    click.echo()
    for axis in results.axes:
        click.echo(f"{'lashes    ' if axis.words else f'axis      {axis.parameter}: '}{axis.spread}")
    for axis in results.coordinates:
        click.echo(f"along run {axis.parameter}: {axis.spread}")
    for each in results.sample:
        unit = "" if each.unit == "1" else f" {each.unit}"
        click.echo(f"drawn     {each.name}, {each.values.min():.4g} to {each.values.max():.4g}{unit}")
    for quantity in results.quantities.values() if tolerances is None else ():
        if not quantity.dimension and quantity.name not in REGIME_QUANTITIES:
            click.echo(f"measured  {quantity.name}: {quantity.words} [{quantity.unit_symbol}]")
    load = results.setting("load")
    if load is not None:
        swept = {axis.parameter for axis in results.parameters}
        click.echo(fill(f"load      {', '.join([PROFILES[load['profile']].name, *numbers(load, swept)])}"))
    click.echo(f"config    {results.config_digest[:16]}…")
    for name, value in results.attributes.items():
        click.echo(f"{name.removesuffix('_version'):<9} {value}")
    if check:
        checked_bytes = ", the bytes their checksum" if has_checksum else "; the bytes have no checksum:"
        click.echo(f"checked   the data match their digest{checked_bytes}")
        if not has_checksum:
            click.echo("          another program has changed the file")
    click.echo()
    if tolerances is None:
        tables.print_lashes(results.counts_of_lashes, tables.print_counts)
        if results.boundaries is not None:
            click.echo()
            tables.print_boundaries(results.boundaries)
    else:
        tables.print_lashes(tolerances.by_lash(), tables.print_tolerances)
    for caveat in results.caveats:
        click.echo(fill(f"note: {caveat}"))
    if show_map:
        click.echo()
        tables.print_map(results)
