"""`clunk help`: topics, the Markdown files beside this module."""

from __future__ import annotations

import sys
from importlib.resources import files

import click

from clunk.study.errors import nearest


@click.command()
@click.argument("topic", required=False)
def help(topic: str | None) -> None:  # noqa: A001  # as the command is named
    """Explain a TOPIC; without one, list the topics.

    Example: clunk help designs
    """
    topics = {
        entry.name.removesuffix(".md"): entry.read_text(encoding="utf-8")
        for entry in sorted(files(__package__).iterdir(), key=lambda entry: entry.name)
        if entry.name.endswith(".md")
    }
    if topic is None:
        width = max(map(len, topics))
        for name, text in topics.items():
            click.echo(f"{name:<{width}}  {text.splitlines()[0].partition(': ')[2]}")
        click.echo("clunk help TOPIC shows one of them", err=True)
    elif topic not in topics:
        likely = nearest(topic, topics)
        hint = f"did you mean {likely}? There" if likely else "there"
        raise click.UsageError(f"no topic {topic!r}; {hint} are {', '.join(topics)}.")
    elif sys.stdout.isatty():
        from rich.console import Console

        from clunk.cli.help.page import show

        show(topics[topic], Console(file=getattr(sys.stdout, "direct", sys.stdout)))
    else:
        click.echo(topics[topic], nl=False)
