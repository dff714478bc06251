"""`clunk help`: topics, the Markdown files beside this module."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from clunk.study.errors import nearest

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderResult


@click.command()
@click.argument("topic", required=False)
def help(topic: str | None) -> None:  # noqa: A001  # as the command is named
    """Explain a TOPIC; without one, list the topics.

    Example: clunk help designs
    """
    pages = sorted(Path(__file__).parent.glob("*.md"))
    topics = {page.stem: page.read_text(encoding="utf-8") for page in pages}
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

        show(topics[topic], Console(file=getattr(sys.stdout, "direct", sys.stdout)))
    else:
        click.echo(topics[topic], nl=False)


def show(text: str, console: Console) -> None:
    """Print a page of Markdown, whose tables cut no key short."""
    from rich.markdown import Markdown, TableElement
    from rich.table import Table

    class WholeWords(TableElement):
        """A table whose columns of single words keep their width; the others are wrapped."""

        def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
            for table in super().__rich_console__(console, options):
                if isinstance(table, Table):
                    for column in table.columns:
                        column.overflow = "fold"
                        column.no_wrap = not any(" " in str(cell) for cell in column.cells)
                yield table

    class Page(Markdown):
        elements = {**Markdown.elements, "table_open": WholeWords}  # noqa: RUF012  # as rich declares it

    console.print(Page(text))
