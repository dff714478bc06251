"""Numbers, shares and cells as text, for tables, messages and JSON records."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING, Any

from clunk.study.summaries import WIDTH, cut

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from clunk.study.axes import ResultAxis


def fill(text: str, first: str = "", rest: str = "") -> str:
    """Wrap a text to the width of a terminal, its first line and the rest with these indents."""
    return textwrap.fill(text, WIDTH, initial_indent=first, subsequent_indent=rest, break_on_hyphens=False)


def at_cell(parameters: Sequence[ResultAxis], values: Sequence[float], indent: int = 2) -> str:
    """A cell by its parameters, for example at load.ratio = 5, wrapped."""
    named = ", ".join(
        f"{axis.parameter} = {text}" for axis, text in zip(parameters, texts(parameters, values), strict=True)
    )
    blank = " " * indent
    return fill(f"at {named}", blank, blank + "   ")


def at_record(parameters: Sequence[ResultAxis], values: Sequence[float]) -> dict[str, float | str]:
    """A cell by its parameters for JSON, words for numbers that have them; empty without parameters."""
    return {axis.parameter: axis.word(value) or value for axis, value in zip(parameters, values, strict=False)}


def texts(parameters: Sequence[ResultAxis], values: Sequence[float]) -> list[str]:
    """Parameters' values, as numbers or words."""
    return [axis.word(value) or number(value) for axis, value in zip(parameters, values, strict=True)]


def share(count: int, of: int) -> str:
    """A share in percent, which never reads as none or all where it is not."""
    share = count / of
    return "> 99.99 %" if 0.9999 < share < 1.0 else "< 0.01 %" if 0.0 < share < 0.0001 else f"{100.0 * share:.2f} %"


def number(value: float, form: str = ".6g") -> str:
    """A number in a format, - where it is not defined."""
    return "-" if math.isnan(value) else f"{value:{form}}"


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


def cells_with_two_labels(
    parameters: Sequence[ResultAxis],
    cells: Sequence[tuple[Sequence[float], Sequence[str]]],
    heads: Sequence[str],
    sentence: str,
) -> Iterator[str]:
    """Cells as a table of their parameters and what differs there, or of many parameters one after the other.

    cells : values of the parameters, and words
    heads : of the words' columns
    sentence : format of the words of one cell, for example ``{} in A, {} in B``
    """
    if len(parameters) > 2:  # a table of more would be too wide
        for values, words in cells:
            yield f"  {sentence.format(*words)}"
            yield at_cell(parameters, values, indent=4)
        return
    rows = [[*texts(parameters, values), *words] for values, words in cells]
    yield from table([[*(axis.parameter for axis in parameters), *heads], *rows])


def plain(value: Any) -> Any:
    """A value as JSON has it: None for NaN and infinities, lists for tuples, text for dates and times."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
