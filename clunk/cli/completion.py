"""`clunk completion`: what shells complete on a line of clunk, and the script that has them ask for it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from clunk.study.study import Study


@click.command()
@click.argument("shell", type=click.Choice(("bash", "zsh", "fish")))
def completion(shell: str) -> None:
    """Print a script by which a shell completes clunk's commands.

    It also completes options and files. The keys of --set, --at, --along and the like are those of the config or
    results file on the line.

    \b
    Examples:
      clunk completion bash > ~/.local/share/bash-completion/completions/clunk
      clunk completion zsh > ~/.zfunc/_clunk
      clunk completion fish > ~/.config/fish/completions/clunk.fish
    """
    from click.shell_completion import get_completion_class

    from clunk.cli import cli

    shells = get_completion_class(shell)
    assert shells is not None
    click.echo(shells(cli, {}, "clunk", "_CLUNK_COMPLETE").source(), nl=False)


def assignments(context: click.Context, option: click.Parameter, incomplete: str) -> list[str]:
    """Beginnings of KEY=VALUE for each key of the config on the line that `--set` may change."""
    from clunk.study.document import leaves

    study, axes = _study(context), swept(context, option, "")
    keys = [] if study is None else [key for key, _ in leaves(study.model_dump())]
    keys = [key for key in keys if "." in key or key == "title"]  # and not tables that the study leaves out
    return [f"{key}=" for key in keys if key.startswith(incomplete) and key not in axes]


def places(context: click.Context, option: click.Parameter, incomplete: str) -> list[str]:
    """Beginnings of KEY=VALUE for each swept key of the file on the line."""
    return [f"{key}=" for key in swept(context, option, incomplete)]


def swept(context: click.Context, _option: click.Parameter, incomplete: str) -> list[str]:
    """Swept keys of the config or results file on the line."""
    from clunk.study.designs import design_of

    study = _study(context)
    design = None if study is None else design_of(study)
    axes = () if design is None else (*design.axes, *design.coordinates)
    return [axis.parameter for axis in axes if axis.parameter.startswith(incomplete)]


def _study(context: click.Context) -> Study | None:
    """Study of the file on the line; None where it has none."""
    from clunk.cli.options import study_of
    from clunk.study.errors import ClunkError

    arguments = [each.name or "" for each in context.command.params if isinstance(each, click.Argument)]
    words = [*(context.params.get(name) for name in arguments), *context.args]  # while an option lacks its value
    path = next((Path(word) for word in words if word is not None and Path(word).is_file()), None)
    try:
        return None if path is None else study_of(path)
    except ClunkError:
        return None
