"""Numbers, shares and cells as text, for tables, messages and JSON records."""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clunk.study.axes import ResultAxis

WIDTH = 80  # columns of a terminal


def fill(text: str, first: str = "", others: str = "") -> str:
    """Wrap a text to the width of a terminal; the first line and the others begin with these indents."""
    return textwrap.fill(text, WIDTH, initial_indent=first, subsequent_indent=others, break_on_hyphens=False)


def at_cell(parameters: Sequence[ResultAxis], values: Sequence[float], indent: int = 2) -> str:
    """A cell by its parameters, for example at load.ratio = 5, wrapped."""
    named = ", ".join(f"{axis.parameter} = {value:.6g}" for axis, value in zip(parameters, values, strict=True))
    blank = " " * indent
    return fill(f"at {named}", blank, blank + "   ")


def cells(count: int) -> str:
    """A number of cells, for example 1,024 cells."""
    return f"{count:,} {'cell' if count == 1 else 'cells'}"


def share(count: int, of: int) -> str:
    """A share that never says none or all where that is not so."""
    share = count / of
    return "> 99.99 %" if 0.9999 < share < 1.0 else "< 0.01 %" if 0.0 < share < 0.0001 else f"{100.0 * share:.2f} %"


def number(value: float, form: str) -> str:
    """A number in a format, - where it is not defined."""
    return "-" if math.isnan(value) else f"{value:{form}}"


def or_none(value: float) -> float | None:
    """JSON has neither NaN nor infinities."""
    return value if math.isfinite(value) else None
