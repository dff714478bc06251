"""`clunk init`: write a starter config."""

from __future__ import annotations

from pathlib import Path

import click

from clunk.cli.options import PATH

_STARTERS = {"rig": ("starter.toml",), "car": ("car.toml", "car-sweep.toml")}  # the files that make each


@click.command()
@click.argument("path", type=PATH, default="clunk.toml")
@click.option("--from", "origin", type=click.Choice(tuple(_STARTERS)), default="rig", help="What to start from [rig].")
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
@click.option("--schema", is_flag=True, help="Print the JSON Schema by which editors check configs.")
def init(path: Path, origin: str, force: bool, schema: bool) -> None:
    """Write a commented starter config to PATH [clunk.toml]; - prints it.

    The rig has every key there is; the car is a driveline that rolls, with gears, from engine to body.

    Example: clunk init study.toml

    Example: clunk init car.toml --from car

    Example: clunk init --schema > clunk.schema.json
    """
    from importlib.resources import files

    if schema:
        import json

        from clunk.study.keys import json_schema

        click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
        return
    presets = files("clunk.study.presets")
    text = "".join(presets.joinpath(name).read_text(encoding="utf-8") for name in _STARTERS[origin])
    if str(path) == "-":
        click.echo(text, nl=False)
        return
    if path.is_dir():
        raise click.ClickException(f"{path} is a directory; name a file in it.")
    if path.exists() and not force:
        raise click.ClickException(f"{path} exists; --force overwrites it.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{path} cannot be written: {error.strerror}.") from error
    click.echo(f"wrote {path}; next: clunk sweep {path}", err=True)
