"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells in which labels differ are cut into triangles. Where the ends of an edge differ, a crossing is located
(`clunk.analysis.brackets`); a third label in between becomes a node, and a triangle of three labels has a triple point.
Where a line is further from its chord than `CHORD`, further crossings are located within the triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clunk.analysis.brackets import Codes, Floats
from clunk.analysis.crossings import Run, located
from clunk.analysis.junctions import triple_points
from clunk.analysis.network import Segments
from clunk.analysis.pointruns import RUN
from clunk.analysis.triangles import Nodes, Triangles, ends_of, keys_of

CHORD = 1e-4  # of the map, that a line may be off its chord
_MOST_ROUNDS = 12  # of new nodes


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

    def trace(self) -> Segments:
        """Locate everything; returns the segments."""
        for _ in range(_MOST_ROUNDS):
            while self._locate():
                pass
            segments, rails = self._segments()
            if not self._bend(segments, rails):
                break
        return segments

    def _locate(self) -> bool:
        """Locate crossings on new edges; returns whether there are new nodes, and so further edges."""
        mixed = self.triangles.mixed
        keys = np.unique(keys_of(mixed, np.roll(mixed, -1, axis=1)))
        first, second = ends_of(keys)
        runs, positions = self.triangles.runs, self.triangles.positions
        differ = runs["outcome"][first] != runs["outcome"][second]
        keys = keys[differ & ~np.isin(keys, self.keys)]
        first, second = ends_of(keys)
        nodes = self.triangles.along(first, second)
        crossings = located(self.run, positions[nodes], runs[nodes])
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

    def _segments(self) -> tuple[Segments, Rails]:
        """The segments, one for each triangle of two labels and three for one of three, and where they may run."""
        mixed = self.triangles.mixed
        labels = self.triangles.outcome[mixed]
        is_triple = (labels[:, 0] != labels[:, 1]) & (labels[:, 1] != labels[:, 2]) & (labels[:, 2] != labels[:, 0])
        two, three = mixed[~is_triple], mixed[is_triple]
        labels = self.triangles.outcome[two]
        turns = np.select([labels[:, 1] == labels[:, 2], labels[:, 0] == labels[:, 2]], [0, 1], 2)
        two = np.take_along_axis(two, (turns[:, None] + np.arange(3)) % 3, 1)  # the corner of the other label first
        self._locate_triples(three)
        outcome, positions = self.triangles.outcome, self.triangles.positions
        centre = np.array([self.triples[tuple(corners)] for corners in three.tolist()]).reshape(-1, 2)
        numbers = np.tile(-1 - np.arange(len(three)), 3)
        self.met, self.met_labels = centre, np.sort(outcome[three], axis=1)
        a, b = (np.concatenate([np.roll(three, -k, axis=1)[:, 0] for k in range(s, s + 3)]) for s in (0, 1))
        tips = np.tile(centre, (3, 1))
        segments = Segments(
            begin=np.concatenate([keys_of(two[:, 0], two[:, 1]), numbers]),
            end=np.concatenate([keys_of(two[:, 0], two[:, 2]), keys_of(a, b)]),
            left=outcome[np.concatenate([two[:, 0], b])],
            right=outcome[np.concatenate([two[:, 1], a])],
            inner={},
        )
        rails = Rails(
            begin=np.concatenate([self.position(segments.begin[: len(two)]), tips]),
            end=self.position(segments.end),
            left=np.stack([np.concatenate([positions[two[:, 0]], tips]), positions[np.concatenate([two[:, 0], b])]], 1),
            right=np.stack(
                [np.concatenate([positions[two[:, 1]], tips]), positions[np.concatenate([two[:, 2], a])]], 1
            ),
            far=np.concatenate([keys_of(two[:, 1], two[:, 2]), np.full(a.size, -1)]),
            names=[
                *map(tuple, two.tolist()),
                *((*triple, k) for k in range(3) for triple in map(tuple, three.tolist())),
            ],
        )
        return segments, rails

    def _locate_triples(self, triangles: Nodes) -> None:
        new = [corners for corners in triangles.tolist() if tuple(corners) not in self.triples]
        if new:
            nodes = np.array(new)
            crossings = self.position(keys_of(nodes, np.roll(nodes, -1, axis=1)).ravel()).reshape(-1, 3, 2)
            positions, outcome = self.triangles.positions[nodes], self.triangles.outcome[nodes]
            points = triple_points(self.run, positions, outcome, crossings)
            self.triples |= {tuple(corners): point for corners, point in zip(new, points, strict=True)}

    def _bend(self, segments: Segments, rails: Rails) -> bool:
        """Follow lines that are bent within triangles; returns whether there are new nodes."""
        todo = np.array([k for k, name in enumerate(rails.names) if name not in self.inner], np.int64)
        points, owner, share, asked = bent(self.run, segments.left, segments.right, rails, todo)
        order = np.lexsort((share, owner))
        points, owner = points[order], owner[order]
        begins = np.searchsorted(owner, np.append(todo, len(rails.names)))
        for k, number in enumerate(todo.tolist()):
            self.inner[rails.names[number]] = points[begins[k] : begins[k + 1]]
        if asked.size:
            keys, first = np.unique(rails.far[asked["cell"]], return_index=True)
            keys, asked = keys[keys >= 0], asked[first[keys >= 0]]
            if keys.size:
                self.triangles.add(keys, np.stack([asked["x"], asked["y"]], 1), asked["run"])
                return True
        segments.inner.update(
            {k: self.inner[name] for k, name in enumerate(rails.names) if len(self.inner.get(name, ()))}
        )
        return False


@dataclass(frozen=True, eq=False)
class Rails:
    """Room of segments: beside each end of one, a point of either label, on lines that no other segment crosses.

    begin, end : (n, 2) ends of the segments
    left, right : (n, 2, 2) points on either side, at the begin and at the end
    far : (n,) key of the edge that is the right rail of a triangle with two labels, else -1
    names : of each segment
    """

    begin: Floats
    end: Floats
    left: Floats
    right: Floats
    far: Codes
    names: list[tuple[int, ...]]


_ASKED = np.dtype([("cell", "i8"), ("x", "f8"), ("y", "f8"), ("run", RUN)])


def bent(
    run: Run, left: Codes, right: Codes, rails: Rails, todo: Codes
) -> tuple[Floats, Codes, Floats, npt.NDArray[np.void]]:
    """Points on lines between the ends of segments, so many that no chord is off its line by more than `CHORD`.

    A line is within that of its chord if the labels are those of its sides as far from the chord's middle. Else it is
    located between the middles of the rails; where their labels are others, a node is asked for.

    Returns the points (n, 2), their segments, their shares of the way along these; and _ASKED, nodes on the far edges.
    """
    points: list[tuple[Floats, Codes, Floats]] = [(np.zeros((0, 2)), todo[:0], np.zeros(0))]
    asked = [np.zeros(0, _ASKED)]
    segment, ends = todo, np.stack([rails.begin[todo], rails.end[todo]], 1)
    sides = np.stack([rails.left[todo], rails.right[todo]], 2)  # segment, begin or end, side, axis
    shares = np.tile([0.0, 1.0], (todo.size, 1))
    while segment.size:
        chord = ends[:, 1] - ends[:, 0]
        length = np.hypot(*chord.T)
        long = length > CHORD
        segment, ends, sides, shares = segment[long], ends[long], sides[long], shares[long]
        normal = np.stack([-chord[long, 1], chord[long, 0]], 1) / length[long, None]
        middle = ends.mean(axis=1)
        expected = np.stack([left[segment], right[segment]], 1)
        beside = np.clip(np.stack([middle + CHORD * normal, middle - CHORD * normal], 1), 0.0, 1.0)
        off = (run(beside.reshape(-1, 2))["outcome"].reshape(-1, 2) != expected).any(axis=1)
        segment, ends, sides, shares, expected = segment[off], ends[off], sides[off], shares[off], expected[off]
        middles = sides.mean(axis=1)  # of the rails
        runs = run(middles.reshape(-1, 2)).reshape(-1, 2)
        clear = (runs["outcome"] == expected).all(axis=1)
        crossings = located(run, middles[clear], runs[clear])
        counts = np.bincount(crossings.lines, minlength=int(clear.sum()))
        single = clear.copy()
        single[clear] = counts == 1
        asks = np.zeros(int((~single).sum()), _ASKED)
        asks["cell"], asks["run"] = segment[~single], runs[~single, 1]
        asks["x"], asks["y"] = middles[~single, 1].T
        asked.append(asks)
        bends = crossings.places[counts[crossings.lines] == 1]
        segment, ends, sides, shares, middles = (part[single] for part in (segment, ends, sides, shares, middles))
        chord = ends[:, 1] - ends[:, 0]
        aside = np.abs(chord[:, 0] * (bends - ends[:, 0])[:, 1] - chord[:, 1] * (bends - ends[:, 0])[:, 0])
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
