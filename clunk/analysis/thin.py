"""Regions thinner than a cell: nodes of another label between two nodes of a map that have the same one.

They are looked for where margins vanish between nodes of one label, as they do on both sides of such a region or, where
no margins are known, along the lines on which the number of touches changes. From where such a region is hit it is
followed from triangle to triangle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from clunk.analysis.pointruns import RUN, RUN_FIELDS, Runs
from clunk.analysis.searches import Search
from clunk.analysis.triangles import Triangles, cross, keys_of
from clunk.core.exact.run import MOST
from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Codes, Floats, Nodes

_THINNEST = 1e-6  # of the map, a region that is looked for where touches change
_TOUCHES = 2  # by which neighbours differ, where no margin is known
_BEFORE = 0.9  # of the way to where a margin is expected to be zero
_NEXT = np.array([_BEFORE]), np.array([1.35]), np.array([_BEFORE, 1.02])  # the next points: at first one for each edge
_JUMP = 1000.0  # times as far from zero as expected beyond that place: a touch there is of no label's concern
_STAYS = 0.8, 2.0  # times itself, a margin that comes to no zero: a boundary passes by
_STEEPER = 2.0  # than between known values, as the margin may fall between them
_MOST_ROUNDS = 64  # of points on an edge, 10 as a rule
_ASTRAY = 0.02  # of an edge, by which a region that is followed may be off the straight line
_OPPOSITE = {(1, 0): ((1, 1), (0, -1)), (0, 1): ((1, 1), (-1, 0)), (1, 1): ((1, 0), (0, 1))}  # corners, by edge


Suspects = npt.NDArray[np.void]  # SUSPECT
Hits = npt.NDArray[np.void]  # HIT

# An edge between nodes of the same label, on which a margin may vanish: shares of the way between which it may, the run
# at the lower one, and by how much |margin| falls per edge there.
SUSPECT = np.dtype([("first", "i8"), ("second", "i8"), ("low", "f8"), ("high", "f8"), ("before", RUN), ("slope", "f8")])
# A point of another label on such an edge, and the nearest point before it of the edge's own label.
HIT = np.dtype(
    [
        *SUSPECT.descr,
        ("share", "f8"),
        ("place", "f8", 2),
        ("run", RUN),
        ("beside", "f8", 2),
        ("of_beside", RUN),
    ]
)


def hidden(triangles: Triangles, may_run: Callable[[], bool]) -> Search[Hits]:
    """Find points of another label on edges whose two ends have the same: HIT, one for each such edge.

    may_run : asked before each batch of runs
    """
    suspects, all_hits = _suspects(triangles), np.zeros(0, HIT)
    while True:
        hits = yield from _hits(triangles, suspects, may_run)
        known = keys_of(all_hits["first"], all_hits["second"])
        keys, at = np.unique(keys_of(hits["first"], hits["second"]), return_index=True)
        new = ~np.isin(keys, known)
        all_hits = np.concatenate([all_hits, hits[at[new]]])
        if not new.any() or not may_run():
            return all_hits
        suspects = yield from _onward(triangles, hits[at[new]], np.append(known, keys[new]))


def _hits(triangles: Triangles, suspects: Suspects, may_run: Callable[[], bool]) -> Search[Hits]:
    """Look for points of another label on suspected edges; returns HIT.

    A region thinner than a cell begins where the margin falls to zero. Where it falls towards a node, so that it may be
    zero before the next one, and is not small there, its zero is closed in on: from points at which it still falls, by
    the line through the last two, and points beyond. Without margins that is done with jumps of the touches by two.
    """
    begin, label = triangles.positions[suspects["first"]], triangles.outcome[suspects["first"]]
    step, edges = triangles.positions[suspects["second"]] - begin, np.arange(suspects.size)
    suspects, pieces = suspects.copy(), [np.zeros(0, HIT)]
    thinnest = _THINNEST / np.hypot(*step.T)
    for round_ in range(_MOST_ROUNDS):
        if not edges.size or not may_run():
            break
        low, high, before, slope = (suspects[name] for name in ("low", "high", "before", "slope"))
        size, sign = np.abs(before["measure"]), np.sign(before["measure"])
        with np.errstate(invalid="ignore", divide="ignore"):
            ahead = size / slope
        zero = low + ahead
        ahead = np.where((ahead > 0.0) & (zero < high), ahead, 0.5 * (high - low))
        shares = low[:, None] + ahead[:, None] * _NEXT[min(round_, len(_NEXT) - 1)]
        shares = np.minimum(shares, 0.5 * (low + _BEFORE * ahead + high)[:, None])
        places = begin[edges, None] + shares[..., None] * step[edges, None]
        runs = (yield places.reshape(-1, 2)).reshape(shares.shape)
        differs = runs["outcome"] != label[edges, None]
        left = sign * runs["measure"][:, 0] / size  # of the margin
        goes_on = ~differs.any(axis=1) & ~((_STAYS[0] < left) & (left < _STAYS[1]))
        beyond = shares[:, -1] - zero
        goes_on &= ~((beyond > 0.0) & (np.abs(runs["measure"][:, -1]) > _JUMP * slope * beyond))
        shows = np.flatnonzero(differs.any(axis=1))
        hits, at = np.zeros(shows.size, HIT), np.argmax(differs, axis=1)[shows]
        for name in SUSPECT.names or ():
            hits[name] = suspects[name][shows]
        hits["share"], hits["place"], hits["run"] = shares[shows, at], places[shows, at], runs[shows, at]
        is_first, lows = at == 0, begin[edges] + low[:, None] * step[edges]
        hits["beside"] = np.where(is_first[:, None], lows[shows], places[shows, 0])
        hits["of_beside"] = np.where(is_first, before[shows], runs[shows, 0])
        pieces.append(hits)
        for k, share in enumerate(shares.T):
            size, after = np.abs(before["measure"]), sign * runs["measure"][:, k]
            expected = size - slope * (share - low)
            falls = (after < size) & (after > np.maximum(0.1 * expected, 0.02 * size))
            falls = np.where(np.isnan(size), runs["touches"][:, k] == before["touches"], falls)
            falls &= (low < share) & (share < high)
            high[~falls] = np.minimum(high, share)[~falls]
            slope[falls] = ((size - after)[falls]) / (share - low)[falls]
            low[falls], before[falls] = share[falls], runs[falls, k]
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = np.abs(before["measure"]) / slope
        goes_on &= high - low > thinnest[edges]
        goes_on &= np.isnan(distance) | ((distance > thinnest[edges]) & (distance < _STEEPER * (high - low)))
        edges, suspects = edges[goes_on], suspects[goes_on]
    return np.concatenate(pieces)


def _onward(triangles: Triangles, hits: Hits, known: Codes) -> Search[Suspects]:
    """Suspected edges by which thin regions leave the triangles beside an edge on which they were hit.

    The margin before a region has the region's direction. From the margin's slopes along the edge and across it follows
    where the next edge is reached; beside that place the suspects begin, on either side.
    """
    shape, positions, outcome = triangles.shape, triangles.positions, triangles.outcome
    begin, low = positions[hits["first"]], hits["low"][:, None]
    along = positions[hits["second"]] - begin
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    aside = 0.5 * (hits["share"][:, None] - low)
    beside = np.abs((yield begin + low * along + aside * across)["measure"])
    way = (beside - np.abs(hits["before"]["measure"]))[:, None] * along + aside * hits["slope"][:, None] * across
    corners, other = np.minimum(hits["first"], hits["second"]), np.maximum(hits["first"], hits["second"])
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
                apart = hits["place"][at] - positions[start]
                with np.errstate(invalid="ignore", divide="ignore"):
                    share = cross(apart, way[at]) / cross(far, way[at])
                new = (share > 0.0) & (share < 1.0) & ~np.isin(keys_of(start, opposite), known)
                new &= (outcome[opposite] == outcome[corners[at]]) & (outcome[start] == outcome[corners[at]])
                reached.append((start[new], opposite[new], share[new]))
    first, second, share = (np.concatenate(part) for part in zip(*reached, strict=True))
    _, at = np.unique(keys_of(first, second), return_index=True)
    first, second, share = first[at], second[at], share[at]
    shares = np.clip(share[:, None] + _ASTRAY * np.array([-2.0, -1.0, 1.0, 2.0]), 0.0, 1.0)
    places = positions[first, None] + shares[..., None] * (positions[second] - positions[first])[:, None]
    runs = (yield places.reshape(-1, 2)).reshape(shares.shape)
    size = np.where(runs["outcome"] == outcome[first, None], np.abs(runs["measure"]), np.nan)
    both = []
    for one, two, outer, inner, last, turned in ((first, second, 0, 1, 3, False), (second, first, 3, 2, 0, True)):
        low, high, before = ((1.0 - shares if turned else shares)[:, k] for k in (inner, last, outer))
        with np.errstate(invalid="ignore", divide="ignore"):
            slope = (size[:, outer] - size[:, inner]) / (low - before)
        falls = (slope > 0.0) & (size[:, inner] < slope * (high + _ASTRAY - low))
        both.append(_suspected(one, two, low, high, runs[:, inner], slope)[falls])
    return np.concatenate(both)


def _suspected(first: Nodes, second: Nodes, low: Floats, high: Floats, before: Runs, slope: Floats) -> Suspects:
    suspects = np.zeros(first.size, SUSPECT)
    for name, values in zip(SUSPECT.names or (), (first, second, low, high, before, slope), strict=True):
        suspects[name] = values
    return suspects


def _suspects(triangles: Triangles) -> Suspects:
    """Edges of a map between nodes of one label on which a thin region may lie."""
    nodes = triangles.runs[: triangles.shape[0] * triangles.shape[1]].reshape(triangles.shape)
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
    begins = np.zeros(first.size)
    return _suspected(first, second, begins, begins + 1.0, triangles.runs[first], falls)


def _moved(shape: tuple[int, ...], step: tuple[int, int], times: int) -> tuple[slice, ...]:
    """Slices of the nodes that are this many steps from those with a neighbour on both sides."""
    rooms = zip(shape, step, strict=True)
    return tuple(slice(abs(k) + times * k, size - abs(k) + times * k) for size, k in rooms)
