"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells in which labels differ are cut into triangles. Where the ends of an edge differ, a crossing is located
(`clunk.analysis.brackets`); a third label in between becomes a node, and a triangle of three labels has a triple point.
Where a line is further from its chord than `CHORD`, further crossings are located within the triangle.

It ends because an edge is cut only between crossings that are `RESOLUTION` apart, in `_MOST_ROUNDS` rounds at most, and
only with the first half of the runs that there are (`most_runs`). With three quarters crossings on edges are located,
with the rest the lines between these, which takes a known number of rounds; without a run left they stay as they are
known. The network is closed whatever is cut, as it follows from the labels of the nodes alone. Where a line is not
located, its place is kept as unresolved.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clunk.analysis.brackets import TOLERANCE
from clunk.analysis.crossings import Crossings, located
from clunk.analysis.junctions import CLOSE, have_around, triple_points
from clunk.analysis.pointruns import RUN, Runs
from clunk.analysis.searches import TOUCHES_OF_A_RUN, Run, Search, side_by_side
from clunk.analysis.thin import hidden
from clunk.analysis.triangles import Triangles, cross, ends_of, keys_of
from clunk.study.arrays import Bools, Codes, Floats, Nodes, Records
from clunk.sweeping.progress import Progress

CHORD = 1e-4  # of the map, that a line may be off its chord
RESOLUTION = 1e-8  # of the map: crossings on an edge that are nearer to each other are not parted by a node
_MOST_ROUNDS, _MOST_CUTS = 32, 32  # of tracing lines, and in each of cutting edges
_NEAR, _INNER = 0.25, 0.05  # of an edge's length, how near to it a node is, and how far its foot is from its ends
_RUNS_PER_CELL, _RUNS_OF_ANY_MAP = 6, 20_000
_CUT, _ON_EDGES = 0.5, 0.75  # of these, with which edges are cut, and with which crossings on edges are located
_LOCATED = 4.0 * TOLERANCE  # of the map, the widest bracket of a single crossing

# A segment of a line within a triangle. Beside it are its rails, on which no other segment ends.
SEGMENT = np.dtype(
    [
        ("name", "i8", 4),  # corners of the triangle and, where it has three labels, the segment's number, else -1
        ("nodes", "i8", 2),  # keys of the edges on which it begins and ends, or of triple points -1 - their number
        ("labels", "i8", 2),  # codes on the left and on the right
        ("ends", "f8", (2, 2)),  # where it begins and ends
        ("sides", "f8", (2, 2, 2)),  # beside the begin and the end, points on the left and on the right rail
        ("far", "i8"),  # key of the edge that is the right rail of a triangle with two labels, else -1
    ]
)
# A node to add to an edge or a segment's far edge, whether that is long enough there, and the middle of the chord.
_ASKED = np.dtype([("cell", "i8"), ("place", "f8", 2), ("run", RUN), ("is_long", "?"), ("chord", "f8", 2)])


def most_runs(cells: int, cost: int = 1) -> int:
    """Number of runs with which the lines of a map are traced at most, but for one batch; fewer of many touches.

    cost : see `PointRuns`
    """
    return _RUNS_OF_ANY_MAP // cost + _RUNS_PER_CELL * cells


class Lines:
    """Lines of a map as they are traced; positions are on each axis from 0 to 1.

    triangles : Triangles
    run : runs points
    progress : called with the number of points that have been run, after each batch
    runs : this number
    keys, brackets : (n,) keys of edges, ascending, and of each the two ends of its bracket (n, 2, 2), from the first
        node on
    triples : corners of a triangle -> its triple point
    inner : name of a segment -> points within it
    met, met_labels : (n, 2) triple points of the segments, and (n, 3) the labels that meet there, ascending
    unresolved : (n, 2) places where lines are not located
    """

    def __init__(self, triangles: Triangles, run: Run, progress: Progress | None = None, cost: int = 1) -> None:
        self.triangles, self.runs = triangles, 0
        self._run, self._most_runs, self._rounds = run, most_runs(triangles.runs.size, cost), 0
        self._spent = 0  # runs, those of many touches more than once
        self._cuts, self._progress, self._is_rough = 0, progress, False
        self._checked = triangles.runs.size  # nodes that have been looked at, whether a region passes an edge near them
        self.keys, self.brackets = np.zeros(0, np.int64), np.zeros((0, 2, 2))
        self.triples: dict[tuple[int, ...], Floats] = {}
        self.inner: dict[tuple[int, ...], Floats] = {}
        self._off_chord: dict[tuple[int, ...], Floats] = {}  # name of a segment -> a place where it may be off
        self._unknown: set[tuple[int, ...]] = set()  # corners of triangles whose triple point is not located
        self.met, self.met_labels = np.zeros((0, 2)), np.zeros((0, 3), np.int64)
        self.unresolved = np.zeros((0, 2))

    def trace(self) -> tuple[Codes, Codes, list[Floats]]:
        """Trace the lines; returns the ends, labels and inner points of their segments, see `paths_of`."""
        hits, _ = self._search(hidden(self.triangles, self._may_cut), self._locate())
        if hits.size:
            numbers = self.triangles.runs.size + np.arange(hits.size)
            self.triangles.add(keys_of(hits["first"], hits["second"]), hits["place"], hits["run"])
            self.triangles.keep_before(numbers, hits["beside"], hits["of_beside"])
        while True:
            self._search(self._locate())
            two, three = self._mixed()
            known = np.array([tuple(corners) in self.triples for corners in three.tolist()], bool)
            segments = np.concatenate([self._of_two(two), self._of_three(three[known])])
            asked, _ = self._search(self._bend(segments), self._locate_triples(three[~known]))
            cuts = np.zeros(0, np.int64)
            self._rounds, self._cuts = self._rounds + 1, 0
            if self._may_cut():
                cuts, first = np.unique(asked["cell"], return_index=True)
                if cuts.size:
                    self.triangles.add(cuts, asked["place"][first], asked["run"][first])
            if known.all() and not cuts.size:
                break
        self._search(self._join_triples(three))
        self.unresolved = self._find_unresolved(two, three, _names(segments))
        return segments["nodes"], segments["labels"], [self.inner[name] for name in _names(segments)]

    def _search(self, *searches: Search[Any]) -> list[Any]:
        """Do searches side by side, counting the points that are run."""

        def run(places: Floats) -> Runs:
            runs = self._run(places)
            self.runs += len(places)
            self._spent += len(places) + int(np.maximum(runs["touches"], 0).sum()) // TOUCHES_OF_A_RUN
            if self._progress is not None:
                self._progress(self.runs, 0)
            return runs

        return side_by_side(run, *searches)

    def _runs_left(self, share: float = 1.0) -> int:
        return max(int(share * self._most_runs) - self._spent, 0)

    def _may_cut(self) -> bool:
        return self._runs_left(_CUT) > 0 and self._rounds < _MOST_ROUNDS and self._cuts < _MOST_CUTS

    def _join_triples(self, triangles: Nodes) -> Search[None]:
        """Put triple points that are one junction at one place, with the crossing between them.

        Where two boundaries cross, no edge parts the two triangles of three labels without a third label in between.
        """
        keys = keys_of(triangles, np.roll(triangles, -1, axis=1)).ravel()
        order = np.argsort(keys, kind="stable")
        same = np.flatnonzero(keys[order[:-1]] == keys[order[1:]])
        at = np.searchsorted(self.keys, keys[order[same]])
        pairs = np.stack([order[same], order[same + 1]], axis=1) // 3
        wide = np.hypot(*(self.brackets[at, 1] - self.brackets[at, 0]).T) > _LOCATED
        wide |= np.abs(self.met[pairs[:, 1]] - self.met[pairs[:, 0]]).max(axis=1, initial=0.0) < CLOSE
        edges, pairs = at[wide], pairs[wide]
        points, labels = self.met[pairs], self.met_labels[pairs].reshape(-1, 6)
        is_junction = yield from have_around(points.reshape(-1, 2), np.repeat(labels, 2, axis=0))
        for edge, pair, is_met in zip(edges, pairs, is_junction.reshape(-1, 2), strict=True):
            if is_met.any():
                self.met[pair] = self.brackets[edge] = self.met[pair[np.argmax(is_met)]]

    def _find_unresolved(self, two: Nodes, three: Nodes, names: list[tuple[int, ...]]) -> Floats:
        """Places of edges whose crossing is not located, of such triple points, and of chords that may be off."""
        mixed = np.concatenate([two, three])
        keys = np.unique(keys_of(mixed, np.roll(mixed, -1, axis=1)))
        keys = keys[np.isin(keys, self.keys)]
        ends = self.bracket(keys)
        # where runs were too few for all crossings, those as near as chords are will do
        wide = np.hypot(*(ends[:, 1] - ends[:, 0]).T) > (CHORD if self._is_rough else _LOCATED)
        points = [self.triples[name] for name in map(tuple, three.tolist()) if name in self._unknown]
        points += [self._off_chord[name] for name in names if name in self._off_chord]
        return np.concatenate([ends[wide].mean(axis=1), np.array(points).reshape(-1, 2)])

    def _locate(self) -> Search[None]:
        """Locate crossings on edges, and on further edges where they have several."""
        self._cuts = 0
        while (yield from self._locate_new()):
            self._cuts += 1
            yield from self._look_through()

    def _look_through(self) -> Search[None]:
        """Add nodes on edges that a region passes without a crossing, where a new node of another label is close.

        Without these, edges from that node on would be cut nearer and nearer to the one that the region passes.
        """
        checked, self._checked = self._checked, self.triangles.runs.size
        corners = self.triangles.corners[(self.triangles.corners >= checked).any(axis=1)]
        corners = np.concatenate([np.roll(corners, -k, axis=1) for k in range(3)])
        labels = self.triangles.outcome[corners]
        corners = corners[(labels[:, 0] != labels[:, 1]) & (labels[:, 0] != labels[:, 2])]
        tips, begin, end = np.moveaxis(self.triangles.positions[corners], 1, 0)
        base, slant = end - begin, tips - begin
        length = np.hypot(*base.T)
        share, height = (base * slant).sum(axis=1) / length**2, np.abs(cross(base, slant)) / length
        near = (share > _INNER) & (share < 1.0 - _INNER) & (height < _NEAR * length) & (height > RESOLUTION)
        keys, at = np.unique(keys_of(*corners[near, 1:].T), return_index=True)
        places = (begin + share[:, None] * base)[near][at]
        if keys.size and self._may_cut():
            runs = yield places
            passes = (runs["outcome"] != self.triangles.outcome[np.array(ends_of(keys))]).all(axis=0)
            if passes.any():
                self.triangles.add(keys[passes], places[passes], runs[passes])

    def _locate_new(self) -> Search[bool]:
        """Locate crossings on new edges; returns whether there are new nodes, and so further edges."""
        mixed = self.triangles.mixed
        keys = np.unique(keys_of(mixed, np.roll(mixed, -1, axis=1)))
        first, second = ends_of(keys)
        runs, positions = self.triangles.runs, self.triangles.positions
        differ = runs["outcome"][first] != runs["outcome"][second]
        keys = keys[differ & ~np.isin(keys, self.keys)]
        first, second = ends_of(keys)
        nodes = self.triangles.along(first, second)
        crossings = yield from located(positions[nodes], runs[nodes], runs_left=lambda: self._runs_left(_ON_EDGES))
        self._is_rough |= crossings.lines.size > 0 and not self._runs_left(_ON_EDGES)
        lines, ends, middle = self._parted(crossings)
        edges, begins, counts = np.unique(lines, return_index=True, return_counts=True)
        begin, rest = ends_of(keys[edges])
        for k in range(counts.max(initial=0)):
            # the k-th crossing of each edge, and behind it a node, if there is another
            counted = counts > k
            begin, rest, begins, counts = begin[counted], rest[counted], begins[counted], counts[counted]
            several = counts > k + 1
            after = rest.copy()
            after[several] = self.triangles.runs.size + np.arange(several.sum())
            each = ends[begins + k]
            self._keep(keys_of(begin, after), np.where((begin < after)[:, None, None], each, each[:, ::-1]))
            if several.any():
                behind = begins[several] + k
                self.triangles.add(keys_of(begin, rest)[several], middle["place"][behind], middle["run"][behind])
            begin = after
        return bool((counts > 1).any())

    def _parted(self, crossings: Crossings) -> tuple[Codes, Floats, Records]:
        """Crossings of which those nearer to each other than the resolution are one, or all of an edge.

        Returns the numbers of their lines (n,), their brackets (n, 2, 2), and nodes between each and the next (n,).
        """
        lines, ends, runs = crossings
        gaps = np.hypot(*(ends[1:, 0] - ends[:-1, 1]).T)
        parted = (lines[1:] != lines[:-1]) | ((gaps >= RESOLUTION) & self._may_cut())
        first, last = np.flatnonzero(np.append(True, parted)[: lines.size]), np.flatnonzero(np.append(parted, True))
        last = last[: first.size]
        differ = runs["outcome"][first, 0] != runs["outcome"][last, 1]  # else a label without width
        first, last = first[differ], last[differ]
        nodes = np.zeros(first.size, _ASKED)
        behind = np.minimum(last + 1, max(lines.size - 1, 0))
        nodes["place"], nodes["run"] = 0.5 * (ends[last, 1] + ends[behind, 0]), runs[last, 1]
        return lines[first], np.stack([ends[first, 0], ends[last, 1]], axis=1), nodes

    def _keep(self, keys: Codes, brackets: Floats) -> None:
        """Keep crossings: keys of the edges (n,), and brackets (n, 2, 2) from the smaller node on."""
        every = np.concatenate([self.keys, keys])
        order = np.argsort(every)
        self.keys, self.brackets = every[order], np.concatenate([self.brackets, brackets])[order]

    def bracket(self, keys: Codes) -> Floats:
        """Ends of the bracket of the crossing on edges, (n, 2, 2)."""
        ends: Floats = self.brackets[np.searchsorted(self.keys, keys)]
        return ends

    def position(self, nodes: Codes) -> Floats:
        """Position of the nodes of segments, (n, 2)."""
        positions = np.empty((nodes.size, 2))
        on_edge = nodes >= 0
        positions[on_edge] = self.bracket(nodes[on_edge]).mean(axis=1)
        positions[~on_edge] = self.met[-1 - nodes[~on_edge]]
        return positions

    def _mixed(self) -> tuple[Nodes, Nodes]:
        """Triangles of two labels, (n, 3), the corner of the other label first, and triangles of three."""
        mixed = self.triangles.mixed
        labels = self.triangles.outcome[mixed]
        alike = labels == np.roll(labels, -1, axis=1)
        two, three = mixed[alike.any(axis=1)], mixed[~alike.any(axis=1)]
        turns = np.argmax(np.roll(alike[alike.any(axis=1)], -1, axis=1), axis=1)
        return np.take_along_axis(two, (turns[:, None] + np.arange(3)) % 3, 1), three

    def _of_two(self, triangles: Nodes) -> Records:
        """Segments of triangles with two labels, one for each."""
        segments = np.zeros(len(triangles), SEGMENT)
        segments["name"] = np.column_stack([triangles, np.full(len(triangles), -1)])
        segments["nodes"] = keys_of(triangles[:, :1], triangles[:, 1:])
        segments["labels"] = self.triangles.outcome[triangles[:, :2]]
        segments["ends"] = self.position(segments["nodes"].ravel()).reshape(-1, 2, 2)
        segments["sides"] = self.triangles.positions[triangles[:, [[0, 1], [0, 2]]]]
        segments["far"] = keys_of(triangles[:, 1], triangles[:, 2])
        return segments

    def _of_three(self, triangles: Nodes) -> Records:
        """Segments of triangles with three labels, three for each, from its triple point on."""
        numbers = np.arange(len(triangles))
        self.met = np.array([self.triples[name] for name in map(tuple, triangles.tolist())]).reshape(-1, 2)
        self.met_labels = np.sort(self.triangles.outcome[triangles], axis=1)
        corners = np.concatenate([np.roll(triangles, -k, axis=1)[:, 1::-1] for k in range(3)])  # left and right
        segments = np.zeros(len(corners), SEGMENT)
        segments["name"] = np.column_stack([np.tile(triangles, (3, 1)), np.repeat(np.arange(3), len(triangles))])
        segments["nodes"] = np.stack([np.tile(-1 - numbers, 3), keys_of(*corners.T)], axis=1)
        segments["labels"] = self.triangles.outcome[corners]
        segments["ends"] = self.position(segments["nodes"].ravel()).reshape(-1, 2, 2)
        tips = np.tile(self.met[:, None], (3, 2, 1))
        segments["sides"] = np.stack([tips, self.triangles.positions[corners]], axis=1)
        segments["far"] = -1
        return segments

    def _locate_triples(self, triangles: Nodes) -> Search[None]:
        if len(triangles):
            edges = keys_of(triangles, np.roll(triangles, -1, axis=1))
            crossings = self.position(edges.ravel()).reshape(-1, 3, 2)
            positions, outcome = self.triangles.positions[triangles], self.triangles.outcome[triangles]
            points, is_known = yield from triple_points(positions, outcome, crossings, self._runs_left)
            is_within = _within(positions, points)
            is_known &= is_within
            points[~is_within] = crossings[~is_within].mean(axis=1)
            names = [*map(tuple, triangles.tolist())]
            self.triples |= zip(names, points, strict=True)
            self._unknown |= {name for name, known in zip(names, is_known.tolist(), strict=True) if not known}

    def _bend(self, segments: Records) -> Search[Records]:
        """Follow lines that are bent within triangles; returns nodes to add, _ASKED, with the edges' keys as cells."""
        names = _names(segments)
        todo = np.array([k for k, name in enumerate(names) if name not in self.inner], np.int64)
        points, owner, share, asked = yield from bent(segments, todo, self._runs_left)
        order = np.lexsort((share, owner))
        points, owner = points[order], owner[order]
        begins = np.searchsorted(owner, np.append(todo, len(names)))
        for k, number in enumerate(todo.tolist()):
            self.inner[names[number]] = points[begins[k] : begins[k + 1]]
        self._off_chord |= {names[k]: place for k, place in zip(asked["cell"].tolist(), asked["chord"], strict=True)}
        asked["cell"] = segments["far"][asked["cell"]]
        return asked.take(np.flatnonzero((asked["cell"] >= 0) & asked["is_long"]))


def _names(segments: Records) -> list[tuple[int, ...]]:
    return [*map(tuple, segments["name"].tolist())]


def _within(corners: Floats, points: Floats) -> Bools:
    """Whether points (n, 2) are within anticlockwise triangles (n, 3, 2), or no further outside than is close."""
    edges = np.roll(corners, -1, axis=1) - corners
    heights = cross(edges, points[:, None] - corners) / np.hypot(edges[..., 0], edges[..., 1])
    within: Bools = np.all(heights > -CLOSE, axis=1)
    return within


def bent(segments: Records, todo: Codes, runs_left: Callable[[], int]) -> Search[tuple[Floats, Codes, Floats, Records]]:
    """Points on lines between the ends of segments, so many that no chord is off its line by more than `CHORD`.

    A line is within that of its chord if the labels are those of its sides as far from the chord, where that meets the
    way between the middles of the rails. Else it is located on that way; where the middles have other labels, a node is
    asked for.

    Returns the points (n, 2), their segments, their shares of the way along these; and _ASKED, nodes on the far edges.
    """
    points: list[tuple[Floats, Codes, Floats]] = [(np.zeros((0, 2)), todo[:0], np.zeros(0))]
    asked = [np.zeros(0, _ASKED)]
    segment, ends, sides = todo, segments["ends"][todo], segments["sides"][todo]
    shares = np.tile([0.0, 1.0], (todo.size, 1))
    while segment.size:
        if not runs_left():
            left = np.zeros(segment.size, _ASKED)
            left["cell"], left["chord"] = segment, ends.mean(axis=1)
            asked.append(left)
            break
        long = np.hypot(*(ends[:, 1] - ends[:, 0]).T) > CHORD
        segment, ends, sides, shares = segment[long], ends[long], sides[long], shares[long]
        middles, expected = sides.mean(axis=1), segments["labels"][segment]  # of the rails, and the labels there
        way, chord = middles[:, 1] - middles[:, 0], ends[:, 1] - ends[:, 0]
        slant = cross(chord, way)
        with np.errstate(invalid="ignore", divide="ignore"):
            at, apart = cross(chord, ends[:, 0] - middles[:, 0]) / slant, CHORD * np.hypot(*chord.T) / np.abs(slant)
        across = np.nan_to_num(np.stack([at - apart, at + apart], 1), nan=0.5)
        beside = middles[:, :1] + np.clip(across, 0.0, 1.0)[..., None] * way[:, None]
        nearest = (yield beside.reshape(-1, 2)).reshape(-1, 2)
        off = np.flatnonzero((nearest["outcome"] != expected).any(axis=1))
        segment, ends, sides, shares, middles = (part[off] for part in (segment, ends, sides, shares, middles))
        runs, expected = (yield middles.reshape(-1, 2)).reshape(-1, 2), expected[off]
        clear = (runs["outcome"] == expected).all(axis=1)
        four = np.stack([runs[:, 0], nearest[off, 0], nearest[off, 1], runs[:, 1]], axis=1)
        side = (four["outcome"][:, 1:3, None] == expected[:, None]).all(axis=1)  # all on the left, all on the right
        around = np.select([side[:, :1], side[:, 1:]], [[1, 2, 3, 3], [0, 0, 1, 2]], [0, 0, 3, 3])
        places = np.stack([middles[:, 0], beside[off, 0], beside[off, 1], middles[:, 1]], axis=1)
        each = np.arange(off.size)[:, None]
        crossings = yield from located(places[each, around][clear], four[each, around][clear], runs_left=runs_left)
        counts = np.bincount(crossings.lines, minlength=int(clear.sum()))
        single = clear.copy()
        single[clear] = counts == 1
        asks = np.zeros(int((~single).sum()), _ASKED)
        asks["cell"], asks["run"] = segment[~single], runs[~single, 1]
        asks["place"], asks["chord"] = middles[~single, 1], ends[~single].mean(axis=1)
        asks["is_long"] = np.hypot(*(sides[~single, 1, 1] - sides[~single, 0, 1]).T) >= RESOLUTION
        asked.append(asks)
        bends = crossings.places[counts[crossings.lines] == 1]
        segment, ends, sides, shares, middles = (part[single] for part in (segment, ends, sides, shares, middles))
        chord = ends[:, 1] - ends[:, 0]
        aside = np.abs(cross(chord, bends - ends[:, 0]))
        off = aside > CHORD * np.hypot(*chord.T)  # not where a region is thinner than that
        bends = bends[off]
        segment, ends, sides, shares, middles = (part[off] for part in (segment, ends, sides, shares, middles))
        middle_share = shares.mean(axis=1)
        points.append((bends, segment, middle_share))
        ends = np.concatenate([np.stack([ends[:, 0], bends], 1), np.stack([bends, ends[:, 1]], 1)])
        sides = np.concatenate([np.stack([sides[:, 0], middles], 1), np.stack([middles, sides[:, 1]], 1)])
        shares = np.concatenate([np.stack([shares[:, 0], middle_share], 1), np.stack([middle_share, shares[:, 1]], 1)])
        segment = np.tile(segment, 2)
    located_points, owner, share = (np.concatenate(part) for part in zip(*points, strict=True))
    return located_points, owner, share, np.concatenate(asked)
