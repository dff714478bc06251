"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells in which labels differ are cut into triangles. Where the ends of an edge differ, a crossing is located
(`clunk.analysis.search`). One operation refines what is not told well enough, a node on an edge: between two crossings
of the same edge; on the far edge of a triangle whose line is further from its chord than `CHORD`; and beside the
crossing on the longest edge of a triangle of three labels, until these meet in a triangle as small as `JUNCTION`.

It ends because it takes `_MOST_ROUNDS` rounds at most, and nodes are added only with the first part of the runs that
there are (`most_runs`). The network is closed whatever is cut, as it follows from the labels of the nodes alone: an
edge is split in both of its triangles, two labels in a triangle are parted by one line from edge to edge, and three
meet in a point. Where a line is not located, its place is kept as unresolved.
"""

from collections.abc import Callable

import numpy as np

from clunk.analysis.search import TOUCHES_OF_A_RUN, Points, narrow, with_hidden
from clunk.study.arrays import Bools, Codes, Floats, Nodes

CHORD = 1e-4  # of the map, that a line may be off its chord
JUNCTION = 1e-7  # of the map, a triangle in which three labels meet
RESOLUTION = 1e-8  # of the map: crossings on an edge that are nearer to each other are not parted by a node
_MOST_ROUNDS = 128
_HALVINGS = 4  # of an edge, where another label may be hidden between two nodes of one label
_MOST_CROSSINGS = 8  # on an edge, that are told apart
_BESIDE = 0.03  # of the way from a crossing to the far end of its edge, where that is cut
_RUNS_PER_CELL, _RUNS_OF_ANY_MAP = 6, 20_000
# Of these, with which edges are cut that have several crossings, with which others are, and crossings located on edges.
_SEVERAL, _CUT, _ON_EDGES = 0.5, 0.75, 0.9
_LOCATED = 4.0 * RESOLUTION  # of the map, the widest bracket of a crossing, or of several that are not parted
_SHIFT = 32  # bits of a node's number in an edge's key


def most_runs(cells: int, cost: int = 1) -> int:
    """Number of runs with which the lines of a map are traced at most, but for one batch; fewer of many touches.

    cost : see `PointRuns`
    """
    return _RUNS_OF_ANY_MAP // cost + _RUNS_PER_CELL * cells


def keys_of(first: Nodes, second: Nodes) -> Codes:
    """Number of the edge between two nodes, whichever comes first."""
    keys: Codes = (np.minimum(first, second) << _SHIFT) | np.maximum(first, second)
    return keys


def ends_of(keys: Codes) -> tuple[Nodes, Nodes]:
    """The two nodes of edges, the smaller number first."""
    return keys >> _SHIFT, keys & ((1 << _SHIFT) - 1)


def cross(one: Floats, other: Floats) -> Floats:
    """Cross products of vectors, (..., 2) each."""
    product: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return product


def _length(vectors: Floats) -> Floats:
    lengths: Floats = np.hypot(vectors[..., 0], vectors[..., 1])
    return lengths


class Triangles:
    """The triangles of a map, two in each cell, and those that they become where their edges get nodes.

    positions, runs : (nodes, 2) float64, on each axis from 0 to 1, and (nodes,) POINT, first the map's, in C order
    corners : (n, 3) nodes, anticlockwise
    is_new : (n,) whether a triangle was added since this was last cleared
    """

    def __init__(self, across: Floats, upward: Floats, runs: Points) -> None:
        self.positions: Floats = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1).reshape(-1, 2)
        self.runs: Points = runs.ravel()
        self.nodes: Nodes = np.arange(runs.size).reshape(runs.shape)  # of the map
        a, b, c, d = self.nodes[:-1, :-1], self.nodes[1:, :-1], self.nodes[1:, 1:], self.nodes[:-1, 1:]
        self.corners: Nodes = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        self.is_new: Bools = np.ones(len(self.corners), bool)

    @property
    def outcome(self) -> Codes:
        """Code of each node's label, (nodes,)."""
        codes: Codes = self.runs["outcome"]
        return codes

    def mixed(self, *, only_new: bool = False) -> tuple[Nodes, Nodes]:
        """Triangles of two labels, the corner of the other label first, and triangles of three: (n, 3) nodes each."""
        corners = self.corners[self.is_new] if only_new else self.corners
        one, other, third = self.outcome[corners].T
        corners = corners[(one != other) | (other != third)]  # few of a large map's
        labels = self.outcome[corners]
        alike = labels == np.roll(labels, -1, axis=1)
        two = alike.any(axis=1)
        turns = (np.argmax(alike[two], axis=1)[:, None] + [2, 3, 4]) % 3
        return np.take_along_axis(corners[two], turns, 1), corners[~two]

    def add(self, keys: Codes, positions: Floats, runs: Points) -> None:
        """Add a node on each of these edges, of which none comes twice."""
        order = np.argsort(keys)
        nodes = len(self.runs) + order
        self.positions, self.runs = np.concatenate([self.positions, positions]), np.concatenate([self.runs, runs])
        is_end = np.zeros(len(self.runs), bool)
        is_end[np.concatenate(ends_of(keys))] = True
        one, other, third = is_end[self.corners].T
        near = np.flatnonzero(one & other | other & third | third & one)
        while near.size:
            near = self._halve(near, keys[order], nodes)

    def _halve(self, near: Nodes, keys: Codes, nodes: Nodes) -> Nodes:
        """Halve each of some triangles at one of these nodes that is on an edge of it; returns all halves.

        keys : of the edges, ascending
        """
        corners = self.corners[near]
        edges = keys_of(corners, np.roll(corners, -1, axis=1))
        at = np.minimum(np.searchsorted(keys, edges), keys.size - 1)
        is_cut = keys[at] == edges
        cut = np.flatnonzero(is_cut.any(axis=1))
        turns = np.argmax(is_cut[cut], axis=1)
        first, second, last = np.take_along_axis(corners[cut], (turns[:, None] + [0, 1, 2]) % 3, 1).T
        middle, begin = nodes[at[cut, turns]], len(self.corners)
        self.corners[near[cut]], self.is_new[near[cut]] = np.stack([first, middle, last], 1), True
        self.corners = np.concatenate([self.corners, np.stack([middle, second, last], 1)])
        self.is_new = np.append(self.is_new, np.ones(cut.size, bool))
        return np.concatenate([near[cut], np.arange(begin, len(self.corners))])


class Lines:
    """Lines of a map as they are traced; positions are on each axis from 0 to 1.

    triangles : Triangles
    run : runs points (n, 2); returns (n,) POINT
    cost : see `PointRuns`
    keys, brackets : (n,) keys of edges with a crossing, ascending, and of each the two ends of its bracket (n, 2, 2),
        from the first node on
    met, met_labels : (m, 2) triple points, and the codes of the labels that meet there (m, 3)
    unresolved : (n, 2) places where lines are not located
    """

    def __init__(self, triangles: Triangles, run: Callable[[Floats], Points], cost: int = 1) -> None:
        self.triangles, self._run_points = triangles, run
        self._most_runs, self._spent, self._rounds = most_runs(triangles.nodes.size, cost), 0, 0
        self.keys, self.brackets = np.zeros(0, np.int64), np.zeros((0, 2, 2))
        self.met, self.met_labels = np.zeros((0, 2)), np.zeros((0, 3), np.int64)
        self.unresolved = np.zeros((0, 2))

    def trace(self) -> None:
        """Locate the crossings on edges, and add nodes, until all lines are told well enough or there are no runs."""
        for axis in (0, 1):
            self._find_hidden(axis)
        while self._locate() or self._refine():
            self._rounds += 1

    def segments(self) -> tuple[Codes, Codes]:
        """Pieces of lines in triangles: the nodes at their ends (n, 2), and codes on their left and right.

        A node is the key of an edge, or -1 - the number of a triple point.
        """
        two, three = self.triangles.mixed()
        self.met = self.position(keys_of(three, np.roll(three, -1, axis=1)).ravel()).reshape(-1, 3, 2).mean(axis=1)
        self.met_labels = self.triangles.outcome[three]
        from_junction = np.repeat(-1 - np.arange(len(three)), 3)
        sides = np.stack([np.roll(three, -1, axis=1), three], axis=2).reshape(-1, 2)
        nodes = [keys_of(two[:, :1], two[:, 1:]), np.column_stack([from_junction, keys_of(*sides.T)])]
        return np.concatenate(nodes), self.triangles.outcome[np.concatenate([two[:, :2], sides])]

    def _run(self, places: Floats) -> Points:
        runs = self._run_points(places)
        self._spent += len(places) + int(np.maximum(runs["touches"], 0).sum()) // TOUCHES_OF_A_RUN
        return runs

    def _may_run(self, share: float = 1.0) -> bool:
        return self._spent < share * self._most_runs

    def _may_cut(self, share: float = _CUT) -> bool:
        return self._may_run(share) and self._rounds < _MOST_ROUNDS

    def bracket(self, keys: Codes) -> Floats:
        """Ends of the brackets of the crossings on edges, (2, n, 2), from each edge's first node on."""
        ends: Floats = self.brackets[np.searchsorted(self.keys, keys)]
        return ends.swapaxes(0, 1)

    def position(self, nodes: Codes) -> Floats:
        """Positions of nodes of segments, (n, 2)."""
        positions = np.empty((nodes.size, 2))
        positions[nodes >= 0] = self.bracket(nodes[nodes >= 0]).mean(axis=0)
        positions[nodes < 0] = self.met[-1 - nodes[nodes < 0]]
        return positions

    def _find_hidden(self, axis: int) -> None:
        """Add nodes of other labels that are hidden between two nodes of the map of the same label, along an axis."""
        nodes, positions = np.moveaxis(self.triangles.nodes, axis, 1), self.triangles.positions

        def place(lines: Codes, values: Floats) -> Floats:
            places: Floats = positions[nodes[lines, 0]]
            places[:, axis] = values
            return places

        points = self.triangles.runs[nodes]
        points["cell"], points["value"] = np.arange(len(nodes))[:, None], positions[nodes, axis]
        points, nodes_in_order = points.ravel(), nodes.ravel()
        found, before = with_hidden(points, lambda *at: self._run(place(*at)), _HALVINGS, self._may_cut)
        hits = np.flatnonzero(found["outcome"] != points["outcome"][before])
        at, first = np.unique(before[hits], return_index=True)
        runs = found[hits[first]]
        keys = keys_of(nodes_in_order[at], nodes_in_order[at + 1])
        self.triangles.add(keys, place(runs["cell"], runs["value"]), runs)

    def _locate(self) -> bool:
        """Locate crossings on new edges; returns whether there are new nodes, on edges with several."""
        mixed = np.concatenate(self.triangles.mixed(only_new=True))
        keys = np.unique(keys_of(mixed, np.roll(mixed, -1, axis=1)))
        first, second = ends_of(keys)
        differ = self.triangles.outcome[first] != self.triangles.outcome[second]
        keys = keys[differ & ~np.isin(keys, self.keys)]
        if not keys.size:
            return False
        lines, ends, runs = self._crossings(keys)
        edges, begins, counts = np.unique(lines, return_index=True, return_counts=True)
        single, several = counts == 1, counts > 1
        self._keep(keys[edges[single]], ends[begins[single]])
        left, middle = keys[edges[several]], (begins + counts // 2 - 1)[several]
        begin, rest = ends_of(left)
        nodes = len(self.triangles.runs) + np.arange(left.size)
        self.triangles.add(left, 0.5 * (ends[middle, 1] + ends[middle + 1, 0]), runs[middle])
        is_first, is_last = counts[several] < 4, counts[several] == 2
        self._keep(keys_of(begin, nodes)[is_first], ends[middle[is_first]])
        self._keep(keys_of(rest, nodes)[is_last], ends[middle[is_last] + 1, ::-1])
        return bool(several.any())

    def _crossings(self, keys: Codes) -> tuple[Codes, Floats, Points]:
        """Crossings on edges, of which those nearer to each other than the resolution are one, or all of an edge.

        Returns the numbers of the edges (n,), brackets (n, 2, 2), and runs behind each (n,).
        """
        nodes = np.stack(ends_of(keys), axis=1)
        begin, way = self.triangles.positions[nodes[:, 0]], np.diff(self.triangles.positions[nodes], axis=1)[:, 0]
        length = _length(way)
        points = self.triangles.runs[nodes]
        points["cell"], points["value"] = np.arange(keys.size)[:, None], length[:, None] * [0, 1]

        def place(edges: Codes, distances: Floats) -> Floats:
            return begin[edges] + (distances / length[edges])[..., None] * way[edges]

        low, high = narrow(
            points.ravel(),
            lambda edges, distances: self._run(place(edges, distances)),
            _MOST_CROSSINGS,
            may_run=lambda: self._may_run(_ON_EDGES),
        )
        edges = low["cell"]
        is_apart = (low["value"][1:] - high["value"][:-1] >= RESOLUTION) & self._may_cut(_SEVERAL)
        is_parted = (edges[1:] != edges[:-1]) | is_apart
        low, high = low[np.append(True, is_parted)], high[np.append(is_parted, True)]
        differ = low["outcome"] != high["outcome"]  # else a label without width
        low, high = low[differ], high[differ]
        ends = np.stack([low["value"], high["value"]], axis=1)
        return low["cell"], place(low["cell"][:, None], ends), high

    def _keep(self, keys: Codes, brackets: Floats) -> None:
        """Keep crossings: keys of the edges (n,), and brackets (n, 2, 2) from the first node on."""
        every = np.concatenate([self.keys, keys])
        order = np.argsort(every)
        self.keys, self.brackets = every[order], np.concatenate([self.brackets, brackets])[order]

    def _refine(self) -> bool:
        """Add nodes on edges of new triangles whose lines are not told well enough; returns whether there are any."""
        two, three = self.triangles.mixed(only_new=True)
        self.triangles.is_new[:] = False
        positions = self.triangles.positions
        two = two[self._is_off_chord(two)]
        sides = np.stack([three, np.roll(three, -1, axis=1)], axis=2)
        lengths = _length(np.diff(positions[sides], axis=2)[:, :, 0])
        is_large = lengths.max(axis=1, initial=0.0) > JUNCTION
        three = three[is_large]
        if not len(two) + len(three) or not self._may_cut():
            self.unresolved = positions[np.concatenate([two, three, self._wide()])].mean(axis=1)
            return False
        longest = sides[is_large, np.argmax(lengths, axis=1)[is_large]]
        crossing = self.position(keys_of(*longest.T))
        away = positions[longest] - crossing[:, None]
        to_far_end = away[np.arange(len(longest)), np.argmax(_length(away), axis=1)]
        places = np.concatenate([positions[two[:, 1:]].mean(axis=1), crossing + _BESIDE * to_far_end])
        keys, at = np.unique(keys_of(*np.concatenate([two[:, 1:], longest]).T), return_index=True)
        self.triangles.add(keys, places[at], self._run(places[at]))
        return True

    def _is_off_chord(self, corners: Nodes) -> Bools:
        """Whether the line in triangles of two labels may be further from its chord than `CHORD`.

        It is not where the labels are those of its sides as far from the chord, on the way from the corner of the other
        label to the middle of the far edge.
        """
        positions = self.triangles.positions[corners]
        ends = self.position(keys_of(corners[:, :1], corners[:, 1:]).ravel()).reshape(-1, 2, 2)
        chord, sides = ends[:, 1] - ends[:, 0], np.roll(positions, -1, axis=1) - positions
        height = np.abs(cross(sides[:, 0], sides[:, 1])) / _length(sides).max(axis=1)
        is_off: Bools = (_length(chord) > CHORD) & (height > CHORD)
        asked = np.flatnonzero(is_off)
        if not asked.size or not self._may_run():
            return is_off
        tip, chord = positions[asked, 0], chord[asked]
        way = positions[asked, 1:].mean(axis=1) - tip
        slant = cross(chord, way)
        at, apart = cross(chord, ends[asked, 0] - tip) / slant, CHORD * _length(chord) / np.abs(slant)
        shares = np.clip(np.stack([at - apart, at + apart], axis=1), 0.0, 1.0)
        places = tip[:, None] + shares[..., None] * way[:, None]
        labels = self._run(places.reshape(-1, 2))["outcome"].reshape(-1, 2)
        is_off[asked] = (labels != self.triangles.outcome[corners[asked, :2]]).any(axis=1)
        return is_off

    def _wide(self) -> Nodes:
        """Triangles with an edge whose crossing is not located, (n, 3)."""
        mixed = np.concatenate(self.triangles.mixed())
        # where runs were too few for all crossings, those as near as chords are will do
        far = _LOCATED if self._may_run(_ON_EDGES) else CHORD
        wide = self.keys[_length(self.brackets[:, 1] - self.brackets[:, 0]) > far]
        return mixed[np.isin(keys_of(mixed, np.roll(mixed, -1, axis=1)), wide).any(axis=1)]
