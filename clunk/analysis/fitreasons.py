"""Reasons why a candidate misses a measured label: the two events that would have to change their order."""

from __future__ import annotations

import math
from itertools import zip_longest

import numpy as np

from clunk.core.sequence import INITIAL
from clunk.results.labels import flanks_of_label
from clunk.sweeping.assembly import flanks_of


def reason_of(label: str, match: np.void, axis: str) -> str:
    """Sentences on why a run, MATCH, misses a measured label; axis : key of the value that was changed."""
    if match["pattern"] == 0:
        return "The run failed."
    events = order_of_events(flanks_of_label(label), flanks_of(int(match["pattern"])))
    if match["change"] == 0.0:
        return f"{events} No change of {axis} alone brings about the measured label."
    return f"{events} At {math.exp(match['change']):.2f} times {axis} it would be the measured label."


def order_of_events(measured: tuple[int, ...], computed: tuple[int, ...]) -> str:
    """Sentence on the first impact in which two sequences differ: which event would have to come before which."""
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
