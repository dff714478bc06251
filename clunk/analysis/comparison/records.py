"""Comparisons as data for scripts."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, cast

from clunk.analysis.comparison.maps import Comparison, Extreme
from clunk.analysis.comparison.measurements import ExperimentComparison
from clunk.study.axes import ResultAxis


def as_record(comparison: Comparison | ExperimentComparison) -> dict[str, Any]:
    """A comparison for JSON: numbers, text, lists and dictionaries, null in place of NaN."""
    record = _map_record(comparison) if isinstance(comparison, Comparison) else _experiment_record(comparison)
    return cast("dict[str, Any]", _plain(record))


def _at(axes: tuple[ResultAxis, ...], values: tuple[float, ...]) -> dict[str, float]:
    return {axis.parameter: value for axis, value in zip(axes, values, strict=True)}


def _map_record(comparison: Comparison) -> dict[str, Any]:
    axes, found = comparison.parameters, comparison.deviation
    deviation: dict[str, Any] | None = None
    if found is not None:
        deviation = {name: getattr(found, name) for name in ("quantity", "cells", "zero_in_one")}
        deviation["ratio"] = {"median": found.median, "quantile_5": found.low, "quantile_95": found.high}
        for name in ("largest_ratio", "largest_difference"):
            extreme: Extreme = getattr(found, name)
            deviation[name] = {
                "at": _at(axes, extreme.values),
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
        "transitions": [asdict(found) for found in comparison.transitions],
        "deviation": deviation,
        "configs_equal": comparison.configs_equal,
        "config_differences": [asdict(each) for each in comparison.config_differences],
        "provenance_differences": {
            name: {"a": a, "b": b} for name, (a, b) in comparison.provenance_differences.items()
        },
        "differing_cells": [
            {"at": _at(axes, cell.values), "a": cell.a, "b": cell.b} for cell in comparison.differing_cells()
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
                "at": _at(axes, point.values),
                "cell": None if point.cell is None else _at(axes, point.cell),
                "measured": point.measured,
                "computed": point.computed,
                "agrees": point.agrees,
            }
            for point in comparison.points
        ],
    }


def _plain(value: Any) -> Any:
    """What JSON can hold: None for NaN and infinities, text for dates and times."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)
