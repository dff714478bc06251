"""Reasons why a candidate misses a measured label: the two events that would have to change their order."""

from __future__ import annotations

import math
from itertools import zip_longest

from clunk.analysis.fitruns import Records
from clunk.analysis.fitting import Fitted
from clunk.core.sequence import INITIAL
from clunk.results.labels import flanks_of_label
from clunk.sweeping.assembly import flanks_of


def reason_of(fitted: Fitted, at: int) -> str:
    """Sentence on why the best candidate misses a measurement; at : its number from 0."""
    match: Records = fitted.estimate_matches[at]
    if match["pattern"] == 0:
        return "The run failed."
    measured = flanks_of_label(fitted.experiment.measurements[at].label)
    return f"{order_of_events(measured, flanks_of(int(match['pattern'])))} {_remedy(fitted, match)}"


def order_of_events(measured: tuple[int, ...], computed: tuple[int, ...]) -> str:
    """Sentence on the first impact in which two sequences differ: what would have to come before what."""
    pairs = enumerate(zip_longest(measured, computed), 1)
    number, wanted, there = next((n, *pair) for n, pair in pairs if pair[0] != pair[1])
    before = "the initial flank" if number == 1 else f"the flank of impact {number - 1}"
    if wanted is None:
        return f"The lash would have to stay at {before} instead of parting from it before impact {number}."
    if there is None:
        return f"The lash would have to part from {before} once more before it comes to rest there."
    if wanted == INITIAL:
        return f"Impact {number} would have to be on the initial flank, before the gap is crossed."
    return f"Impact {number} would have to be on the opposite flank, before the gap turns back."


def _remedy(fitted: Fitted, match: Records) -> str:
    """Sentence on the least change of the measured value that brings about the measured label."""
    axis, change = fitted.axes[fitted.axis], float(match["change"])
    if change == 0.0:
        return f"No change of {axis} alone brings about the measured label."
    return f"At {math.exp(change):.2f} times {axis} it would be the measured label."
