"""Numbers, shares and cells as text, for tables, messages and JSON records."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clunk.study.records import fill as fill
from clunk.study.records import number as number
from clunk.study.records import plain as plain
from clunk.study.summaries import WIDTH, cut

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from clunk.study.axes import ResultAxis


def at_cell(parameters: Sequence[ResultAxis], values: Sequence[float], indent: int = 2) -> str:
    """A cell by its parameters, for example at load.ratio = 5, wrapped."""
    named = ", ".join(
        f"{axis.parameter} = {text}" for axis, text in zip(parameters, texts(parameters, values), strict=True)
    )
    blank = " " * indent
    return fill(f"at {named}", blank, blank + "   ")


def texts(parameters: Sequence[ResultAxis], values: Sequence[float]) -> list[str]:
    """Parameters' values, as numbers or words."""
    return [axis.word(value) or number(value) for axis, value in zip(parameters, values, strict=True)]


def share(count: int, of: int) -> str:
    """A share in percent, which never reads as none or all where it is not."""
    share = count / of
    return "> 99.99 %" if 0.9999 < share < 1.0 else "< 0.01 %" if 0.0 < share < 0.0001 else f"{100.0 * share:.2f} %"


def table(rows: Sequence[Sequence[str]], right: Sequence[bool] = ()) -> Iterator[str]:
    """Rows as columns two blanks apart, indented by two; the widest columns are cut until the table fits."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    while 2 + sum(widths) + 2 * (len(widths) - 1) > WIDTH and max(widths) > 8:
        widths[widths.index(max(widths))] -= 1
    for row in rows:
        cells = [
            f"{cut(cell, width):{'>' if k < len(right) and right[k] else '<'}{width}}"
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield ("  " + "  ".join(cells)).rstrip()
