"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells in which labels differ are cut into triangles. Where the ends of an edge differ, a crossing is located
(`clunk.analysis.brackets`); a third label in between becomes a node, and a triangle of three labels has a triple point.
Where a line is further from its chord than `CHORD`, further crossings are located within the triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from clunk.analysis.crossings import located
from clunk.analysis.junctions import triple_points
from clunk.analysis.pointruns import RUN
from clunk.analysis.searches import Run, Search, side_by_side
from clunk.analysis.thin import hidden
from clunk.analysis.triangles import Triangles, cross, ends_of, keys_of
from clunk.study.arrays import Codes, Floats, Nodes, Records

CHORD = 1e-4  # of the map, that a line may be off its chord
_MOST_ROUNDS = 12  # of new nodes

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
_ASKED = np.dtype([("cell", "i8"), ("place", "f8", 2), ("run", RUN)])  # a node to add to an edge or segment


@dataclass
class Lines:
    """Lines of a map as they are traced; positions are on each axis from 0 to 1.

    triangles : Triangles
    run : runs points
    crossings : (n,) keys of edges, ascending, and of each the two ends of its bracket (n, 2, 2), from the first node on
    triples : corners of a triangle -> its triple point
    inner : name of a segment -> points within it
    met, met_labels : (n, 2) triple points of the segments, and (n, 3) the labels that meet there, ascending
    """

    triangles: Triangles
    run: Run
    keys: Codes = field(default_factory=lambda: np.zeros(0, np.int64))
    brackets: Floats = field(default_factory=lambda: np.zeros((0, 2, 2)))
    triples: dict[tuple[int, ...], Floats] = field(default_factory=dict)
    inner: dict[tuple[int, ...], Floats] = field(default_factory=dict)
    met: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    met_labels: Codes = field(default_factory=lambda: np.zeros((0, 3), np.int64))

    def trace(self) -> tuple[Codes, Codes, list[Floats]]:
        """Trace the lines; returns the ends, labels and inner points of their segments, see `paths_of`."""
        hits, _ = side_by_side(self.run, hidden(self.triangles), self._locate())
        if hits.size:
            numbers = self.triangles.runs.size + np.arange(hits.size)
            self.triangles.add(keys_of(hits["first"], hits["second"]), hits["place"], hits["run"])
            self.triangles.keep_before(numbers, hits["beside"], hits["of_beside"])
        for _ in range(_MOST_ROUNDS):
            side_by_side(self.run, self._locate())
            two, three = self._mixed()
            known = np.array([tuple(corners) in self.triples for corners in three.tolist()], bool)
            segments = np.concatenate([self._of_two(two), self._of_three(three[known])])
            asked, _ = side_by_side(self.run, self._bend(segments), self._locate_triples(three[~known]))
            if known.all() and not asked.size:
                break
            keys, first = np.unique(asked["cell"], return_index=True)
            if keys.size:
                self.triangles.add(keys, asked["place"][first], asked["run"][first])
        return segments["nodes"], segments["labels"], [self.inner[name] for name in _names(segments)]

    def _locate(self) -> Search[None]:
        """Locate crossings on edges, and on further edges where they have several."""
        while (yield from self._locate_new()):
            pass

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
        crossings = yield from located(positions[nodes], runs[nodes])
        ends = crossings.brackets
        edges, begins, counts = np.unique(crossings.lines, return_index=True, return_counts=True)
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
                next_ = begins[several] + k
                between = 0.5 * (ends[next_, 1] + ends[next_ + 1, 0])
                self.triangles.add(keys_of(begin, rest)[several], between, crossings.runs[next_, 1])
            begin = after
        return bool((counts > 1).any())

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
            points = yield from triple_points(positions, outcome, crossings)
            self.triples |= zip(map(tuple, triangles.tolist()), points, strict=True)

    def _bend(self, segments: Records) -> Search[Records]:
        """Follow lines that are bent within triangles; returns nodes to add, _ASKED, with the edges' keys as cells."""
        names = _names(segments)
        todo = np.array([k for k, name in enumerate(names) if name not in self.inner], np.int64)
        points, owner, share, asked = yield from bent(segments, todo)
        order = np.lexsort((share, owner))
        points, owner = points[order], owner[order]
        begins = np.searchsorted(owner, np.append(todo, len(names)))
        for k, number in enumerate(todo.tolist()):
            self.inner[names[number]] = points[begins[k] : begins[k + 1]]
        asked["cell"] = segments["far"][asked["cell"]]
        return asked[asked["cell"] >= 0]


def _names(segments: Records) -> list[tuple[int, ...]]:
    return [*map(tuple, segments["name"].tolist())]


def bent(segments: Records, todo: Codes) -> Search[tuple[Floats, Codes, Floats, Records]]:
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
        crossings = yield from located(places[each, around][clear], four[each, around][clear])
        counts = np.bincount(crossings.lines, minlength=int(clear.sum()))
        single = clear.copy()
        single[clear] = counts == 1
        asks = np.zeros(int((~single).sum()), _ASKED)
        asks["cell"], asks["run"] = segment[~single], runs[~single, 1]
        asks["place"] = middles[~single, 1]
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
