"""Regions thinner than a cell: nodes of another label between two nodes of a map that have the same one.

They are looked for where margins vanish between nodes of one label, as they do on both sides of such a region or, where
no margins are known, along the lines on which the number of touches changes. From where such a region is hit it is
followed from triangle to triangle.
"""

from __future__ import annotations

from itertools import count
from typing import NamedTuple

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
_ASTRAY = 0.02  # of an edge, by which a region that is followed may be off the straight line
_OPPOSITE = {(1, 0): ((1, 1), (0, -1)), (0, 1): ((1, 1), (-1, 0)), (1, 1): ((1, 0), (0, 1))}  # corners, by edge


class Suspects(NamedTuple):
    """Edges on which a margin may vanish beyond some point, in shares of the way from their first node on, (n,) each.

    first, second : nodes of the same label
    low, high : shares between which it may vanish
    size, slope : |margin| at `low`, and by how much it falls per edge there
    sign, touches : of the margin and number, at `low`
    """

    first: Nodes
    second: Nodes
    low: Floats
    high: Floats
    size: Floats
    slope: Floats
    sign: Floats
    touches: Codes

    def at(self, which: Codes) -> Suspects:
        """Some of them."""
        return Suspects._make(part[which] for part in self)


class Hits(NamedTuple):
    """Points of another label on suspects, whose `low` is the last one before: share, position (n, 2), run."""

    suspects: Suspects
    shares: Floats
    places: Floats
    runs: Runs

    @property
    def keys(self) -> Codes:
        """Keys of the edges."""
        return keys_of(self.suspects.first, self.suspects.second)

    def at(self, which: Codes) -> Hits:
        """Some of them."""
        return Hits(self.suspects.at(which), self.shares[which], self.places[which], self.runs[which])


def hidden(run: Run, triangles: Triangles) -> tuple[Codes, Floats, Runs]:
    """Nodes of another label on edges whose ends have one: keys of the edges, positions (n, 2), runs."""
    suspects, every = _suspects(triangles), list[Hits]()
    known = np.zeros(0, np.int64)
    while True:
        hits = _hits(run, triangles, suspects)
        keys, at = np.unique(hits.keys, return_index=True)
        hits = hits.at(at[~np.isin(keys, known)])
        every.append(hits)
        known = np.append(known, hits.keys)
        if not hits.keys.size:
            break
        suspects = _onward(run, triangles, hits, known)
    return known, np.concatenate([each.places for each in every]), np.concatenate([each.runs for each in every])


def _hits(run: Run, triangles: Triangles, suspects: Suspects) -> Hits:
    """Points of another label on suspects.

    A region thinner than a cell begins where the margin falls to zero. Where it falls towards a node, so that it may be
    zero before the next one, and is not small there, its zero is closed in on: from points at which it still falls, by
    the line through the last two, and points beyond. Without margins that is done with jumps of the touches by two.
    """
    first, second, low, high, size, slope, sign, touches = suspects
    begin, label = triangles.positions[first], triangles.outcome[first]
    step, edges = triangles.positions[second] - begin, np.arange(first.size)
    every = [Hits(suspects.at(edges[:0]), low[:0], begin[:0], triangles.runs[:0])]
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
        shows, at = np.flatnonzero(differs.any(axis=1)), np.argmax(differs, axis=1)
        at = at[shows]
        latest = suspects.at(edges[shows])._replace(low=low[shows], size=size[shows], slope=slope[shows])
        every.append(Hits(latest, shares[shows, at], places[shows, at], runs[shows, at]))
        left = sign[edges] * runs["measure"][:, 0] / size  # of the margin
        goes_on = ~differs.any(axis=1) & ~((_STAYS[0] < left) & (left < _STAYS[1]))
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
    parts = (np.concatenate(part) for part in zip(*(each.suspects for each in every), strict=True))
    shares, places, runs = (np.concatenate([each[k] for each in every]) for k in (1, 2, 3))
    return Hits(Suspects._make(parts), shares, places, runs)


def _onward(run: Run, triangles: Triangles, hits: Hits, known: Codes) -> Suspects:
    """Where regions go on: the edges by which they leave the triangles beside an edge on which they were hit.

    The margin before a region has the region's direction. From the margin's slopes along the edge and across it follows
    where the next edge is reached; beside that place the suspects begin, on either side.
    """
    edge, shape = hits.suspects, triangles.shape
    positions, outcome = triangles.positions, triangles.outcome
    begin = positions[edge.first]
    along = positions[edge.second] - begin
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    aside = 0.5 * (hits.shares - edge.low)
    beside = np.abs(run(begin + edge.low[:, None] * along + aside[:, None] * across)["measure"])
    way = (beside - edge.size)[:, None] * along + (aside * edge.slope)[:, None] * across
    corners, other = np.minimum(edge.first, edge.second), np.maximum(edge.first, edge.second)
    row, column = np.divmod(corners, shape[1])
    steps = np.stack(np.divmod(other, shape[1]), axis=1) - np.stack([row, column], axis=1)
    reached = []
    for step, offsets in _OPPOSITE.items():
        for offset in offsets:
            at = np.flatnonzero((steps == step).all(axis=1))
            i, j = row[at] + offset[0], column[at] + offset[1]
            inside = (i >= 0) & (i < shape[0]) & (j >= 0) & (j < shape[1])
            at, opposite = at[inside], (i * shape[1] + j)[inside]
            for start in (corners[at], other[at]):
                far = positions[opposite] - positions[start]
                apart = hits.places[at] - positions[start]
                with np.errstate(invalid="ignore", divide="ignore"):
                    share = _cross(apart, way[at]) / _cross(far, way[at])
                new = (share > 0.0) & (share < 1.0) & ~np.isin(keys_of(start, opposite), known)
                new &= (outcome[opposite] == outcome[corners[at]]) & (outcome[start] == outcome[corners[at]])
                reached.append((start[new], opposite[new], share[new]))
    first, second, share = (np.concatenate(part) for part in zip(*reached, strict=True))
    _, at = np.unique(keys_of(first, second), return_index=True)
    first, second, share = first[at], second[at], share[at]
    shares = np.clip(share[:, None] + _ASTRAY * np.array([-2.0, -1.0, 1.0, 2.0]), 0.0, 1.0)
    places = positions[first, None] + shares[..., None] * (positions[second] - positions[first])[:, None]
    runs = run(places.reshape(-1, 2)).reshape(shares.shape)
    size = np.where(runs["outcome"] == outcome[first, None], np.abs(runs["measure"]), np.nan)
    both = []
    for one, two, outer, inner, last, turned in ((first, second, 0, 1, 3, False), (second, first, 3, 2, 0, True)):
        low, high, before = ((1.0 - shares if turned else shares)[:, k] for k in (inner, last, outer))
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (size[:, outer] - size[:, inner]) / (low - before)
        sign = np.sign(runs["measure"][:, inner])
        each = Suspects(one, two, low, high, size[:, inner], slope, sign, runs["touches"][:, inner])
        falls = (slope > 0.0) & (each.size < slope * (high + _ASTRAY - low))
        both.append(each.at(np.flatnonzero(falls)))
    return Suspects._make(np.concatenate(parts) for parts in zip(*both, strict=True))


def _cross(one: Floats, other: Floats) -> Floats:
    """Cross product of vectors, (n, 2) each."""
    product: Floats = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return product


def _suspects(triangles: Triangles) -> Suspects:
    """Edges of a map within which something may be hidden."""
    nodes = triangles.runs.reshape(triangles.shape)
    outcome, margin, touches = (nodes[name] for name in RUN_FIELDS)
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
    begins, margins = np.zeros(first.size), margin.ravel()[first]
    return Suspects(
        first, second, begins, begins + 1.0, np.abs(margins), falls, np.sign(margins), touches.ravel()[first]
    )


def _moved(shape: tuple[int, ...], step: tuple[int, int], times: int) -> tuple[slice, ...]:
    """The nodes so many steps from all those that have a neighbour on both sides."""
    rooms = zip(shape, step, strict=True)
    return tuple(slice(abs(k) + times * k, size - abs(k) + times * k) for size, k in rooms)
