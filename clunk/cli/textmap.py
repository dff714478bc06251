"""Regime maps as text: a letter for each cell, within the width of a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from string import ascii_letters
from typing import TYPE_CHECKING

import numpy as np

from clunk.results.labels import FAILED
from clunk.study.arrays import Positions
from clunk.study.axes import RUN
from clunk.study.records import fill

if TYPE_CHECKING:
    from clunk.results.maps import AnyMap
    from clunk.study.axes import ResultAxis

_COLUMNS, _ROWS = 64, 20  # of a map, beside the numbers of its upward axis
_WIDEST = 3  # columns of a cell
_NO_BREAK = "\N{NO-BREAK SPACE}"
_SYMBOLS = {"NI": ".", FAILED: "?"}  # of other labels letters, and # where there are no more


def is_drawable(axes: Sequence[ResultAxis]) -> bool:
    """Whether one or two axes have several values, and of two neither is that of the runs, which have no order."""
    names = [axis.parameter for axis in axes if len(axis.values) > 1]
    return len(names) == 1 or (len(names) == 2 and RUN not in names)


def text_map(results: AnyMap) -> list[str]:
    """Lines of the map of one lash, for whose axes `is_drawable` holds: letters, the axes' values, and a legend.

    The load ratio, or else the first axis, goes from left to right. Of an axis with more values than there is room for,
    evenly spread ones are shown. Of a tolerance map the labels are the most likely ones.
    """
    swept = [axis for axis in results.axes if len(axis.values) > 1]
    codes = results.sequence.reshape([len(axis.values) for axis in swept])
    if len(swept) == 2 and swept[1].parameter == "load.ratio":
        swept, codes = swept[::-1], codes.T
    x, *upward = swept
    columns, rows = _shown(x, _COLUMNS), _shown(upward[0], _ROWS)[::-1] if upward else np.zeros(1, np.intp)
    names = np.array([*results.labels, FAILED])  # the code of failed cells, -1, is the last
    shown = names[codes.reshape(len(x.values), -1)[np.ix_(columns, rows)]]
    labels = [name for name in names.tolist() if name in shown]
    lettered = [name for name in labels if name not in _SYMBOLS]
    symbols = _SYMBOLS | dict.fromkeys(lettered, "#") | dict(zip(lettered, ascii_letters, strict=False))
    wide = min(_WIDEST, _COLUMNS // len(columns))
    ticks = [f"{value:.4g}" for value in upward[0].values[rows]] if upward else [""]
    margin = max(map(len, ticks))
    lines = [_heading(axis) for axis in upward]
    for tick, of_row in zip(ticks, shown.T.tolist(), strict=True):
        lines.append(f"{tick:>{margin}} |{''.join(symbols[name] * wide for name in of_row)}")
    first, last = (f"{x.values[columns[k]]:.4g}" for k in (0, -1))
    below = f"{first:<{len(columns) * wide - len(last)}} {last}", _heading(x)
    lines += [" " * (margin + 2) + line for line in below]
    legend = fill("   ".join(f"{symbols[name]}{_NO_BREAK}{name}" for name in labels))
    return [*lines, "", *legend.replace(_NO_BREAK, " ").splitlines()]


def _shown(axis: ResultAxis, most: int) -> Positions:
    """Positions of at most so many of an axis's values, evenly spread, the values ascending."""
    count = len(axis.values)
    places = np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)
    return np.argsort(axis.values, kind="stable")[places]


def _heading(axis: ResultAxis) -> str:
    return axis.parameter + ("" if axis.unit == "1" else f" [{axis.unit}]")
