"""Summaries of objects: a heading and named values as text, and tables as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

Rows = Sequence[tuple[str, str]]

WIDTH = 80  # columns of a terminal
_LEFT = ' style="text-align: left"'  # browsers centre the headings of tables


def as_text(heading: str, rows: Rows) -> str:
    """A heading and a line for each row, none longer than a terminal is wide."""
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join(
        [f"<{cut(heading, WIDTH - 2)}>", *(cut(f"  {name:<{width}}  {text}", WIDTH) for name, text in rows)]
    )


def html_table(rows: Iterable[Sequence[str]], header: Sequence[str] = ()) -> str:
    """A table whose texts, which may be anyone's, are escaped."""
    head = "".join(f"<th{_LEFT}>{escape(text)}</th>" for text in header)
    body = "".join(f"<tr>{''.join(f'<td{_LEFT}>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    return f"<table>{f'<thead><tr>{head}</tr></thead>' if head else ''}<tbody>{body}</tbody></table>"


def counted(count: int, noun: str) -> str:
    """A number of things, for example 1,024 cells."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def percent(part: int, whole: int) -> str:
    """A share in percent, which never reads as none or all where it is not."""
    share = 100.0 * part / whole
    if 0 < share < 0.01:
        return "less than 0.01 %"
    if 99.99 < share < 100:
        return "more than 99.99 %"
    return f"{share:.2g} %" if share < 10 else f"{share:.4g} %" if share > 99 else f"{share:.3g} %"


def cut(text: str, width: int) -> str:
    """A text of at most `width` characters, the last of them … where it was longer."""
    return text if len(text) <= width else text[: width - 1] + "…"
