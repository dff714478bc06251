"""Comparisons as text for people."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence

from clunk.analysis.comparison.maps import Comparison, Deviation
from clunk.analysis.comparison.measurements import ExperimentComparison, Trend
from clunk.analysis.experiments import CAVEAT
from clunk.study.axes import ResultAxis
from clunk.study.configfile import shorten

_WIDTH = 80  # characters
_MOST_TRANSITIONS = 12
_MOST_CELLS = 12
_SYMBOL = {"severity": ("Severity Q", "rad/s²"), "approach_velocity": ("Approach velocity V", "rad/s")}


def report(comparison: Comparison | ExperimentComparison, names: tuple[str, str] | None = None) -> str:
    """A comparison as text for 80 columns; `names` are what to call the two sides, for example their files."""
    if isinstance(comparison, Comparison):
        lines = [*_map_report(comparison, names or comparison.titles)]
    else:
        lines = [*_experiment_report(comparison, names or (comparison.title, comparison.experiment.name))]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _map_report(comparison: Comparison, names: tuple[str, str]) -> Iterator[str]:
    for letter, name in zip("AB", names, strict=True):
        yield f"{letter}  {_cut(name, _WIDTH - 3)}"
    yield ""
    yield _regimes_sentence(comparison)
    failed = comparison.failed_in_a_only, comparison.failed_in_b_only, comparison.failed_in_both
    if any(failed):
        yield f"Failed, not compared: {failed[0]:,} cells in A only, {failed[1]:,} in B only, {failed[2]:,} in both."
    if comparison.identical:
        yield "All arrays are identical, bit for bit."
    yield from _transition_report(comparison)
    if 0 < comparison.differing <= _MOST_CELLS:
        yield ""
        yield from _cell_report(comparison)
    if comparison.deviation is not None and not comparison.identical:
        yield ""
        yield from _deviation_report(comparison.parameters, comparison.deviation)
    yield ""
    yield from _config_report(comparison)


def _cell_report(comparison: Comparison) -> Iterator[str]:
    if len(comparison.parameters) > 2:  # a table of more would be too wide
        for cell in comparison.differing_cells():
            yield f"  {cell.a} in A, {cell.b} in B"
            yield from _where(comparison.parameters, cell.values)
        return
    yield from _table(
        [
            [*(axis.parameter for axis in comparison.parameters), "A", "B"],
            *([*map(_number, cell.values), cell.a, cell.b] for cell in comparison.differing_cells()),
        ]
    )


def _regimes_sentence(comparison: Comparison) -> str:
    if not comparison.cells:
        return "No cell has a label in both maps."
    if not comparison.differing:
        return f"The regimes are the same in all {comparison.cells:,} cells."
    differ = "differs" if comparison.differing == 1 else "differ"
    return (
        f"The regimes of {comparison.differing:,} of {comparison.cells:,} cells {differ} "
        f"({percent(comparison.differing, comparison.cells)})."
    )


def _transition_report(comparison: Comparison) -> Iterator[str]:
    if not comparison.transitions:
        return
    shown, rest = comparison.transitions[:_MOST_TRANSITIONS], comparison.transitions[_MOST_TRANSITIONS:]
    yield ""
    yield from _table(
        [["A", "B", "cells"], *([found.a, found.b, f"{found.cells:,}"] for found in shown)], right=(False, False, True)
    )
    if rest:
        yield f"  and {len(rest)} transitions more, {sum(found.cells for found in rest):,} cells"


def _deviation_report(axes: tuple[ResultAxis, ...], found: Deviation) -> Iterator[str]:
    name, unit = _SYMBOL[found.quantity]
    cells = "cell" if found.cells == 1 else "cells"
    yield f"{name}, B over A, in {found.cells:,} {cells} where neither is zero"
    if found.quantity != "severity":
        yield "  (in place of the severity Q, which is not defined in both)"
    yield f"  median {found.median:.4g}; 5 % to 95 % of the cells: {found.low:.4g} to {found.high:.4g}"
    for what, extreme, value in (
        ("furthest ratio", found.largest_ratio, f"{found.largest_ratio.ratio:.4g}"),
        ("largest difference", found.largest_difference, f"{found.largest_difference.difference:+.4g} {unit}"),
    ):
        yield f"  {what} {value}: {extreme.a:.5g} in A, {extreme.b:.5g} in B {unit}"
        yield from _where(axes, extreme.values)
    if found.zero_in_one:
        cells = "cell" if found.zero_in_one == 1 else "cells"
        yield f"  {found.zero_in_one:,} {cells} more in which one of the two is zero"


def _config_report(comparison: Comparison) -> Iterator[str]:
    found = comparison.config_differences
    decides = "The configs' digests are the same" if comparison.configs_equal else "The configs differ"
    if not found:
        yield f"{decides}." if comparison.configs_equal else "The configs' texts are the same, their digests are not."
    else:
        keys = "1 key" if len(found) == 1 else f"{len(found)} keys"
        yield f"{decides}, but for {keys} that decide nothing:" if comparison.configs_equal else f"{decides} in {keys}:"
        absent = "(not given)"
        rows = [
            [each.key, *(absent if value is None else shorten(value, 60) for value in (each.a, each.b))]
            for each in found
        ]
        yield from _table([["key", "A", "B"], *rows])
    if comparison.provenance_differences:
        yield ""
        yield "Computed with or on other:"
        yield from _table(
            [["", "A", "B"], *([name, *both] for name, both in comparison.provenance_differences.items())]
        )


def _experiment_report(comparison: ExperimentComparison, names: tuple[str, str]) -> Iterator[str]:
    experiment = comparison.experiment
    yield f"computed  {_cut(names[0], _WIDTH - 10)}"
    yield f"measured  {_cut(names[1], _WIDTH - 10)}"
    yield from _wrapped(f"A {experiment.caveat}." if experiment.caveat == CAVEAT else f"{_capital(experiment.caveat)}.")
    yield ""
    yield _points_sentence(comparison)
    if comparison.counted:
        number = comparison.same_double_sided
        share = percent(number, comparison.counted)
        yield f"The number of double-sided impacts is the same at {number:,} of them ({share})."
    for count, what in (
        (comparison.outside, "outside the swept range"),
        (comparison.failed, "nearest to a failed cell"),
    ):
        if count:
            yield f"Not counted: {count:,} point{'' if count == 1 else 's'} {what}."
    yield ""
    yield from _table(
        [
            [*(axis.variable for axis in comparison.axes), "measured", "computed", ""],
            *(
                [
                    *map(_number, point.values),
                    point.measured,
                    "outside" if point.computed is None else point.computed,
                    "agrees" if point.agrees else "",
                ]
                for point in comparison.points
            ),
        ]
    )
    yield ""
    yield from _trend_report(comparison.trends)


def _points_sentence(comparison: ExperimentComparison) -> str:
    if not comparison.counted:
        return "No measured point lies where a label was computed."
    points = "point agrees" if comparison.counted == 1 else "points agree"
    return (
        f"{comparison.agreeing:,} of {comparison.counted:,} measured {points} with the nearest cell "
        f"({percent(comparison.agreeing, comparison.counted)})."
    )


def _trend_report(trends: tuple[Trend, ...]) -> Iterator[str]:
    yield "Number of double-sided impacts, from each measured point to the next"
    rows = []
    for trend in trends:
        label = f"{trend.name} {trend.symbol.split('=')[0].strip()}".strip()
        if not trend.pairs:
            rows.append([label, "0", "-", "-", "-", "-"])
            continue
        alike = f"{trend.alike} ({percent(trend.alike, trend.pairs)})"
        sides = [
            f"{tally.direction} ({tally.rises}, {tally.same}, {tally.falls})"
            for tally in (trend.measured, trend.computed)
        ]
        rows.append([label, str(trend.pairs), *sides, alike, str(trend.opposed)])
    yield from _table([["along", "pairs", "measured", "computed", "alike", "opposed"], *rows])
    yield "  (in brackets: pairs in which it rises, stays the same, falls)"


def _table(rows: list[list[str]], right: Sequence[bool] = ()) -> Iterator[str]:
    """Rows as columns two blanks apart, indented by two; the widest columns are cut until the table fits."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    while 2 + sum(widths) + 2 * (len(widths) - 1) > _WIDTH and max(widths) > 8:
        widths[widths.index(max(widths))] -= 1
    for row in rows:
        cells = [
            f"{_cut(cell, width):{'>' if k < len(right) and right[k] else '<'}{width}}"
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield ("  " + "  ".join(cells)).rstrip()


def _wrapped(text: str) -> Iterator[str]:
    line = ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > _WIDTH:
            yield line
            line = ""
        line = f"{line} {word}".strip()
    yield line


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else text[: width - 1] + "…"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".")


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.6g}"


def percent(part: int, whole: int) -> str:
    """A share in words that never says none or all where that is not so."""
    share = 100.0 * part / whole
    if 0 < share < 0.01:
        return "less than 0.01 %"
    if 99.99 < share < 100:
        return "more than 99.99 %"
    return f"{share:.2g} %" if share < 10 else f"{share:.4g} %" if share > 99 else f"{share:.3g} %"


def _where(axes: tuple[ResultAxis, ...], values: tuple[float, ...]) -> Iterator[str]:
    named = ", ".join(f"{axis.parameter} = {_number(value)}" for axis, value in zip(axes, values, strict=True))
    yield from textwrap.wrap(
        f"at {named}", _WIDTH, initial_indent="    ", subsequent_indent="       ", break_on_hyphens=False
    )
