"""Regions thinner than a cell: nodes of another label between two nodes of a map that have the same one.

They are looked for along the lines on which the number of touches changes: such a region begins where a touch appears,
and so lies on one side of that line, however thin it is.
"""

from __future__ import annotations

from itertools import count

import numpy as np

from clunk.analysis.brackets import Codes, Floats
from clunk.analysis.crossings import Run
from clunk.analysis.pointruns import RUN_FIELDS, Runs
from clunk.analysis.triangles import Nodes, Triangles, keys_of
from clunk.core.exact.run import MOST
from clunk.results.labels import FAILED_CODE

_THINNEST = 1e-6  # of the map, a region that is looked for where touches change
_TOUCHES = 2  # by which neighbours differ, where no margin is known
_BEFORE = 0.9  # of the way to where a margin is expected to be zero
_NEXT = np.array([_BEFORE]), np.array([1.35]), np.array([_BEFORE, 1.02])  # the next points: at first one for each edge
_JUMP = 1000.0  # times as far from zero as expected beyond that place: a touch there is of no label's concern
_STAYS = 0.8, 2.0  # times itself, a margin that comes to no zero: a boundary passes by
_STEEPER = 2.0  # than between known values, as the margin may fall between them


def hidden(run: Run, triangles: Triangles) -> tuple[Codes, Floats, Runs]:
    """Nodes of another label on edges whose ends have one: keys of the edges, positions (n, 2), runs.

    A region thinner than a cell begins where the margin falls to zero. Where it falls towards a node, so that it may be
    zero before the next one, and is not small there, its zero is closed in on: from points at which it still falls, by
    the line through the last two, and points beyond. Without margins that is done with jumps of the touches by two.
    """
    nodes, margin = triangles.runs, triangles.runs["measure"]
    first, second, slope = _suspects(*(nodes[name].reshape(triangles.shape) for name in RUN_FIELDS))
    begin, size, touches = triangles.positions[first], np.abs(margin[first]), nodes["touches"][first]
    step, sign = triangles.positions[second] - begin, np.sign(margin[first])
    label, keys = triangles.outcome[first], keys_of(first, second)
    edges, low, high = np.arange(first.size), np.zeros(first.size), np.ones(first.size)
    new: list[tuple[Codes, Floats, Runs]] = [(keys[:0], np.zeros((0, 2)), nodes[:0])]
    thinnest = _THINNEST / np.hypot(*step.T)
    for round_ in count():
        if not edges.size:
            break
        with np.errstate(invalid="ignore", divide="ignore"):
            ahead = size / slope
        zero = low + ahead
        ahead = np.where((ahead > 0.0) & (zero < high), ahead, 0.5 * (high - low))
        shares = low[:, None] + ahead[:, None] * _NEXT[min(round_, len(_NEXT) - 1)]
        shares = np.minimum(shares, 0.5 * (low + _BEFORE * ahead + high)[:, None])
        places = begin[edges, None] + shares[..., None] * step[edges, None]
        runs = run(places.reshape(-1, 2)).reshape(shares.shape)
        differs = runs["outcome"] != label[edges, None]
        shows, at = differs.any(axis=1), np.argmax(differs, axis=1)
        new.append((keys[edges[shows]], places[shows, at[shows]], runs[shows, at[shows]]))
        left = sign[edges] * runs["measure"][:, 0] / size  # of the margin
        goes_on = ~shows & ~((_STAYS[0] < left) & (left < _STAYS[1]))
        beyond = shares[:, -1] - zero
        goes_on &= ~((beyond > 0.0) & (np.abs(runs["measure"][:, -1]) > _JUMP * slope * beyond))
        alike = runs["touches"] == touches[edges, None]
        for k, share in enumerate(shares.T):
            after = sign[edges] * runs["measure"][:, k]
            expected = size - slope * (share - low)
            falls = (after < size) & (after > np.maximum(0.1 * expected, 0.02 * size))
            falls = np.where(np.isnan(size), alike[:, k], falls) & (low < share) & (share < high)
            with np.errstate(invalid="ignore", divide="ignore"):
                slope = np.where(falls, (size - after) / (share - low), slope)
            low, size = np.where(falls, share, low), np.where(falls, after, size)
            high = np.where(falls, high, np.minimum(high, share))
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = size / slope
        goes_on &= high - low > thinnest[edges]
        goes_on &= np.isnan(distance) | ((distance > thinnest[edges]) & (distance < _STEEPER * (high - low)))
        edges, low, high, size, slope = (part[goes_on] for part in (edges, low, high, size, slope))
    every, places, shown = (np.concatenate(part) for part in zip(*new, strict=True))
    every, at = np.unique(every, return_index=True)
    return every, places[at], shown[at]


def _suspects(outcome: Codes, margin: Floats, touches: Codes) -> tuple[Nodes, Nodes, Floats]:
    """Both nodes of edges within which something may be hidden, and the margin's fall per edge up to the first."""
    numbers, size = np.arange(outcome.size).reshape(outcome.shape), np.abs(margin)
    size = np.where(size < MOST, size, np.nan)  # from there on margins are alike
    suspects = []
    for step in ((1, 0), (0, 1), (1, 1), (-1, 0), (0, -1), (-1, -1)):
        before, at, after = (_moved(outcome.shape, step, k) for k in (-1, 0, 1))
        fall = np.where(np.isnan(size[before]), MOST, size[before]) - size[at]
        alike = (outcome[at] == outcome[after]) & (outcome[at] != FAILED_CODE)
        known = (touches[at] >= 0) & (touches[after] >= 0)
        jump = np.where(known, np.abs(touches[at] - touches[after]), 0)
        is_fall = (fall > 0.0) & (size[at] <= _STEEPER * fall) & (~(size[after] < size[at]) | (jump > 0))
        is_jump = np.isnan(margin[at]) & (jump >= _TOUCHES) & (sum(step) > 0)
        suspect = alike & known & (is_fall | is_jump)
        suspects.append((numbers[at][suspect], numbers[after][suspect], fall[suspect]))
    first, second, falls = (np.concatenate(part) for part in zip(*suspects, strict=True))
    return first, second, falls


def _moved(shape: tuple[int, ...], step: tuple[int, int], times: int) -> tuple[slice, ...]:
    """The nodes so many steps from all those that have a neighbour on both sides."""
    rooms = zip(shape, step, strict=True)
    return tuple(slice(abs(k) + times * k, size - abs(k) + times * k) for size, k in rooms)
