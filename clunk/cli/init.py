"""`clunk init`: write a starter config."""

from pathlib import Path

import click

from clunk.cli.options import flag_option, path_argument
from clunk.study.errors import ClunkError

# Starter -> title line, and the preset files that follow it. A preset that other configs use, too, has no title of its
# own, and in TOML a title has to stand before the tables.
_STARTERS = {
    "rig": ("", "starter.toml"),
    "car": ('title = "A compact car lifts its foot"  # one line of text\n\n', "car.toml", "car-sweep.toml"),
}


@click.command()
@path_argument("path", required=False)
@click.option("--from", "origin", type=click.Choice(tuple(_STARTERS)), default="rig", help="What to start from [rig].")
@flag_option("--force", help="Overwrite an existing file.")
@flag_option("--schema", help="Print the JSON Schema by which editors check configs.")
def init(path: Path | None, origin: str, force: bool, schema: bool) -> None:
    """Write a commented starter config.

    PATH is the file to write; - prints the config instead. The starter rig [clunk.toml] has every key there is; the car
    [car.toml] is a driveline with gears, from engine to body, that rolls.

    Example: clunk init study.toml

    Example: clunk init car.toml --from car

    Example: clunk init --schema > clunk.schema.json
    """
    from importlib.resources import files

    from clunk.results.files import write_text

    if schema:
        import json

        from clunk.study.keys import json_schema

        click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))
        return
    if str(path) in _STARTERS:
        raise click.UsageError(f"{path} is a starter and no file name: clunk init {path}.toml --from {path}")
    path = path or Path("clunk.toml" if origin == "rig" else f"{origin}.toml")
    title, *names = _STARTERS[origin]
    presets = files("clunk.study.presets")
    text = title + "".join(presets.joinpath(name).read_text(encoding="utf-8") for name in names)
    if str(path) == "-":
        click.echo(text, nl=False)
        return
    text = text.replace("clunk.toml", path.name)
    if path.exists() and not force:
        raise ClunkError(f"{path} exists; --force overwrites it.")
    write_text(path, text)
    click.echo(f"wrote {path}; next: clunk sweep {path}", err=True)
