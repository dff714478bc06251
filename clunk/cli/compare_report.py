"""Comparisons of maps as text for 80 columns and as records for JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, cast

from clunk.analysis.comparison import Comparison, Deviation, Extreme
from clunk.analysis.measurements import CAVEAT
from clunk.analysis.trends import ExperimentComparison, Trend
from clunk.cli import phrases
from clunk.results.quantities import CELL_QUANTITIES
from clunk.study.axes import ResultAxis
from clunk.study.problems import shorten
from clunk.study.summaries import WIDTH, counted, cut, percent

_MOST_TRANSITIONS = 12
_MOST_CELLS = 12


def report(comparison: Comparison | ExperimentComparison, names: tuple[str, str] | None = None) -> str:
    """A comparison as text for 80 columns; `names` are what to call the two sides, for example their files."""
    if isinstance(comparison, Comparison):
        lines = [*_map_report(comparison, names or comparison.titles)]
    else:
        lines = [*_experiment_report(comparison, names or (comparison.title, comparison.experiment.name))]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def _map_report(comparison: Comparison, names: tuple[str, str]) -> Iterator[str]:
    for letter, name in zip("AB", names, strict=True):
        yield f"{letter}  {cut(name, WIDTH - 3)}"
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
        cells = [(cell.values, (cell.a, cell.b)) for cell in comparison.differing_cells()]
        yield from phrases.cells_with_two_labels(comparison.parameters, cells, "AB", "{} in A, {} in B")
    if comparison.deviation is not None and not comparison.identical:
        yield ""
        yield from _deviation_report(comparison.parameters, comparison.deviation)
    yield ""
    yield from _config_report(comparison)


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
    yield from phrases.table(
        [["A", "B", "cells"], *([each.a, each.b, f"{each.cells:,}"] for each in shown)], right=(False, False, True)
    )
    if rest:
        yield f"  and {len(rest)} transitions more, {sum(each.cells for each in rest):,} cells"


def _deviation_report(axes: tuple[ResultAxis, ...], deviation: Deviation) -> Iterator[str]:
    quantity = CELL_QUANTITIES[deviation.quantity]
    name, unit = quantity.heading[:1].upper() + quantity.heading[1:], quantity.unit_symbol
    yield f"{name}, B over A, in {counted(deviation.cells, 'cell')} where neither is zero"
    if deviation.quantity != "severity":
        yield "  (in place of the severity Q, which is not defined in both)"
    yield f"  median {deviation.median:.4g}; 5 % to 95 % of the cells: {deviation.low:.4g} to {deviation.high:.4g}"
    furthest, largest = deviation.largest_ratio, deviation.largest_difference
    for what, extreme, value in (
        ("furthest ratio", furthest, f"{furthest.ratio:.4g}"),
        ("largest difference", largest, f"{largest.difference:+.4g} {unit}"),
    ):
        yield f"  {what} {value}: {extreme.a:.5g} in A, {extreme.b:.5g} in B {unit}"
        yield phrases.at_cell(axes, extreme.values, indent=4)
    if deviation.zero_in_one:
        yield f"  {counted(deviation.zero_in_one, 'cell')} more in which one of the two is zero"


def _config_report(comparison: Comparison) -> Iterator[str]:
    differences = comparison.config_differences
    decides = "The configs' digests are the same" if comparison.configs_equal else "The configs differ"
    if not differences:
        yield f"{decides}." if comparison.configs_equal else "The configs' texts are the same, their digests are not."
    else:
        keys = counted(len(differences), "key")
        yield f"{decides}, but for {keys} that decide nothing:" if comparison.configs_equal else f"{decides} in {keys}:"
        absent = "(not given)"
        rows = [
            [each.key, *(absent if value is None else shorten(value, 60) for value in (each.a, each.b))]
            for each in differences
        ]
        yield from phrases.table([["key", "A", "B"], *rows])
    if comparison.provenance_differences:
        yield ""
        yield "Computed with or on other:"
        yield from phrases.table(
            [["", "A", "B"], *([name, *both] for name, both in comparison.provenance_differences.items())]
        )


def _experiment_report(comparison: ExperimentComparison, names: tuple[str, str]) -> Iterator[str]:
    experiment = comparison.experiment
    yield f"computed  {cut(names[0], WIDTH - 10)}"
    yield f"measured  {cut(names[1], WIDTH - 10)}"
    yield phrases.fill(f"A {experiment.caveat}." if experiment.caveat == CAVEAT else f"{_capital(experiment.caveat)}.")
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
            yield f"Not counted: {counted(count, 'point')} {what}."
    yield ""
    yield from phrases.table(
        [
            [*(axis.variable for axis in comparison.axes), "measured", "computed", ""],
            *(
                [
                    *map(phrases.number, point.values),
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
    yield from phrases.table([["along", "pairs", "measured", "computed", "alike", "opposed"], *rows])
    yield "  (in brackets: pairs in which it rises, stays the same, falls)"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:].rstrip(".")


def as_record(comparison: Comparison | ExperimentComparison) -> dict[str, Any]:
    """A comparison for JSON: numbers, text, lists and dictionaries, null in place of NaN."""
    record = _map_record(comparison) if isinstance(comparison, Comparison) else _experiment_record(comparison)
    return cast("dict[str, Any]", phrases.plain(record))


def _map_record(comparison: Comparison) -> dict[str, Any]:
    axes, deviation = comparison.parameters, comparison.deviation
    deviation_record: dict[str, Any] | None = None
    if deviation is not None:
        deviation_record = {name: getattr(deviation, name) for name in ("quantity", "cells", "zero_in_one")}
        quantiles = {"median": deviation.median, "quantile_5": deviation.low, "quantile_95": deviation.high}
        deviation_record["ratio"] = quantiles
        for name in ("largest_ratio", "largest_difference"):
            extreme: Extreme = getattr(deviation, name)
            deviation_record[name] = {
                "at": phrases.at_record(axes, extreme.values),
                "a": extreme.a,
                "b": extreme.b,
                "ratio": extreme.ratio,
                "difference": extreme.difference,
            }
    return {
        "titles": {"a": comparison.titles[0], "b": comparison.titles[1]},
        "same_regimes": comparison.same_regimes,
        "identical": comparison.identical,
        "cells_compared": comparison.cells,
        "cells_differing": comparison.differing,
        "share_differing": comparison.share,
        "failed": {
            "a_only": comparison.failed_in_a_only,
            "b_only": comparison.failed_in_b_only,
            "both": comparison.failed_in_both,
        },
        "transitions": [asdict(transition) for transition in comparison.transitions],
        "deviation": deviation_record,
        "configs_equal": comparison.configs_equal,
        "config_differences": [asdict(each) for each in comparison.config_differences],
        "provenance_differences": {
            name: {"a": a, "b": b} for name, (a, b) in comparison.provenance_differences.items()
        },
        "differing_cells": [
            {"at": phrases.at_record(axes, cell.values), "a": cell.a, "b": cell.b}
            for cell in comparison.differing_cells()
        ],
    }


def _experiment_record(comparison: ExperimentComparison) -> dict[str, Any]:
    axes = comparison.axes
    return {
        "title": comparison.title,
        "experiment": comparison.experiment.name,
        "caveat": comparison.experiment.caveat,
        "points_counted": comparison.counted,
        "points_agreeing": comparison.agreeing,
        "share_agreeing": comparison.share,
        "points_same_double_sided": comparison.same_double_sided,
        "same_regimes": comparison.same_regimes,
        "points_outside": comparison.outside,
        "points_failed": comparison.failed,
        "trends": [asdict(trend) | {"pairs": trend.pairs, "share_alike": trend.share} for trend in comparison.trends],
        "points": [
            {
                "at": phrases.at_record(axes, point.values),
                "cell": None if point.cell is None else phrases.at_record(axes, point.cell),
                "measured": point.measured,
                "computed": point.computed,
                "agrees": point.agrees,
            }
            for point in comparison.points
        ],
    }
