"""A page of help in a terminal."""

from __future__ import annotations

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import Markdown, TableElement
from rich.table import Table


class _WholeWords(TableElement):
    """A table that cuts no key short: columns of single words keep their width, and the others are wrapped."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for table in super().__rich_console__(console, options):
            if isinstance(table, Table):
                for column in table.columns:
                    column.overflow = "fold"
                    column.no_wrap = not any(" " in str(cell) for cell in column.cells)
            yield table


class _Page(Markdown):
    elements = {**Markdown.elements, "table_open": _WholeWords}  # noqa: RUF012  # as rich declares it


def show(text: str, console: Console) -> None:
    """Print a page of Markdown."""
    console.print(_Page(text))
