"""Quantiles of thresholds under tolerances: where along a key an outcome holds in so many of the drawn drivelines.

At a value of the key the probability of an outcome is the share of the draws that have it there. Along the key it is
constant between any draw's thresholds. Where each draw has one threshold, at which an outcome begins to hold, the least
value with a probability q is the quantile q of the thresholds; where outcomes come back, it is a list of intervals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clunk.analysis.thresholds import DRAW, UNCERTAIN_CODE, Thresholds
from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Codes, Floats
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError

QUANTILE = "quantile"  # the axis in the place of `draw`


def check(quantiles: Sequence[float]) -> None:
    """Raise ClunkError where quantiles are not such as `threshold_quantiles` takes."""
    for quantile in quantiles:
        if not 0.5 <= quantile <= 1.0:
            raise ClunkError(
                f"{quantile:g} is no quantile here: it is the share of the draws that have the same outcome, from 0.5 "
                "to 1."
            )
    if len(set(quantiles)) < max(len(quantiles), 1):
        raise ClunkError("A quantile is named twice." if quantiles else "There is no quantile.")


def threshold_quantiles(thresholds: Thresholds, quantiles: Sequence[float] = (0.5, 0.95)) -> Thresholds:
    """Thresholds between the values of the key at which so many of the drawn drivelines have the same outcome.

    Parameters
    ----------
    thresholds : Thresholds
        Of a study with tolerances.
    quantiles : sequence of float
        Shares of the draws, from 0.5 to 1.

    Returns
    -------
    Thresholds
        With an axis `quantile`, the last, in the place of `draw`. Where no outcome has the share of the draws, it is
        `uncertain`; of two outcomes that have half of the draws each, it is the first in the order of `words`.

    Raises
    ------
    ClunkError
        Where the thresholds are not those of drawn drivelines, or a quantile is not from 0.5 to 1.

    Examples
    --------
    >>> import clunk
    >>> axis = "sweep.axes=[{parameter='load.ratio', start=0.0, stop=10.0, count=11}]"
    >>> study = clunk.load_study("configs/tolerance.toml", [axis, "lash.backlash_deg=6.0", "sweep.sampling.count=16"])
    >>> drawn = clunk.thresholds(study, along="load.ratio", of="double_sided")
    >>> [(begin, round(end, 3)) for begin, end in clunk.threshold_quantiles(drawn, [0.95]).where(False, quantile=0.95)]
    [(0.0, 2.507)]
    """
    draws = _draws(thresholds)
    check(quantiles)
    cells = thresholds.lowest.size // draws
    needed = [math.ceil(quantile * draws - 1e-9) for quantile in quantiles]
    lowest, columns = [], []
    for cell in range(cells):
        counts, edges, off = _counts(thresholds, cell, cells)
        likely = counts.argmax(axis=1)
        codes = np.where(likely == len(thresholds.words), FAILED_CODE, likely)
        for k, count in enumerate(needed):
            certain = np.where(counts.max(axis=1) >= count, codes, UNCERTAIN_CODE)
            at = np.flatnonzero(certain[1:] != certain[:-1])
            lowest.append(certain[0])
            place = np.full(at.size, cell * len(needed) + k)
            columns.append((place, edges[at + 1], off[at], certain[at], certain[at + 1]))
    axis = ResultAxis(QUANTILE, np.array(quantiles, np.float64), "share of the draws", "", "1")
    place, value, off, below, above = map(np.concatenate, zip(*columns, strict=True))
    return replace(
        thresholds,
        axes=(*thresholds.axes[1:], axis),
        lowest=np.array(lowest),
        cell=place,
        value=value,
        off=off,
        below=below,
        above=above,
    )


def _draws(thresholds: Thresholds) -> int:
    if not thresholds.axes or thresholds.axes[0].parameter != DRAW:
        raise ClunkError("Quantiles are those of drawn drivelines: the config has no [[sweep.tolerances]].")
    return len(thresholds.axes[0].values)


def _counts(thresholds: Thresholds, cell: int, cells: int) -> tuple[Codes, Floats, Floats]:
    """Number of draws with each outcome between the thresholds of all draws, (m, words + 1), and the ends, (m + 1,).

    Also by how much each of the ends but the outer two may be off, (m - 1,).
    """
    outcomes = len(thresholds.words) + 1  # the code of failed runs, -1, is the last
    part = np.flatnonzero(thresholds.cell % cells == cell)
    part = part[np.argsort(thresholds.value[part], kind="stable")]
    steps = np.zeros((part.size + 1, outcomes), np.int64)
    steps[0] = np.bincount(thresholds.lowest[cell::cells] % outcomes, minlength=outcomes)
    rows = np.arange(1, part.size + 1)
    steps[rows, thresholds.above[part]] += 1
    steps[rows, thresholds.below[part]] -= 1
    edges = np.concatenate([thresholds.along.values[:1], thresholds.value[part], thresholds.along.values[-1:]])
    wide, off = np.diff(edges) > 0.0, np.append(0.0, thresholds.off[part])
    return steps.cumsum(axis=0)[wide], np.append(edges[:-1][wide], edges[-1]), off[wide][1:]
