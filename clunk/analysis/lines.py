"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells in which labels differ are cut into triangles. Where the ends of an edge differ, a crossing is located
(`clunk.analysis.search`), if it can be by continuing lines that are known (`Crossings`): they are smooth, and where one
is expected two runs locate it. One operation refines what is not told well enough, a node on an edge: between two
crossings of the same edge; on the far edge of a triangle whose line is further from its chord than `CHORD`, or which
nodes on its other edges have made flat, as lines that leave by the far edge have no crossing there; and beside the
crossings on the long edges of a triangle of three labels, until these meet in a triangle as small as `JUNCTION`.
When no line is left to follow, edges with a crossing are asked once for labels hidden beside it (`with_hidden`), and
then flat triangles, too, whether their line is where its chord is.
All that needs crossings to `_NEAR` only. Those that there are in the end are narrowed to the tolerance with the runs
that are left, so that what lies where comes before its digits.

It ends because it takes `_MOST_ROUNDS` rounds at most, and nodes are added only with the first part of the runs that
there are (`most_runs`). Each round takes all edges and triangles that wait, so that where labels change on all scales
nothing else has to. The network is closed whatever is cut, as it follows from the labels of the nodes alone: an edge is
split in both of its triangles, two labels in a triangle are parted by one line from edge to edge, and three meet in a
point. No triangle turns over, as the edges of one no higher than `_THIN` are not cut. Where a line is not located, its
place is kept as unresolved.
"""

from collections.abc import Callable

import numpy as np

from clunk.analysis.search import OFF_FAILURES, POINT, TOLERANCE, Points, narrow, with_hidden
from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Array, Bools, Codes, Floats, Nodes

CHORD = 1.3e-4  # of the map, that a line may be off its chord
JUNCTION = 5e-8  # of the map, a triangle in which three labels meet
RESOLUTION = 1e-8  # of the map: crossings on an edge that are nearer to each other are not parted by a node
_THIN = 1e-11  # of the map, a triangle whose edges are not cut any more: its height would be lost in rounding
_MOST_ROUNDS, _LAST_ROUNDS = 128, 8  # of these, those in which flat triangles are asked too
_HALVINGS = 4  # of an edge, where another label may be hidden between two nodes of one label
_MOST_CROSSINGS = 4  # on an edge, that are told apart
_LONG = 0.5  # of a triangle's longest edge
_FLAT = 0.1  # of the far edge, the height over it of a triangle with several crossings on another edge, where it is cut
_BESIDE = 0.03  # of the way from a crossing to the far end of its edge, where that is cut
_RUNS_PER_CELL, _ON_ANY_MAP = 7, 5_000_000  # the latter over what a run costs
TOUCHES = 10  # that take as long as a run without any
_CUT, _ON_EDGES = 0.85, 0.95  # of these, with which edges are cut, and crossings located on edges
_LOCATED = 4.0 * RESOLUTION  # of the map, the widest bracket of a crossing, or of several that are not parted
_NEAR, _OF_EDGE = 7e-5, 5e-3  # of the map and of the edge, the widest bracket of a crossing before it is narrowed
_POINTS, _NEIGHBOURS = 4, 8  # crossings that continue a line, of so many that are the nearest
_REACH = 15.0  # lengths of an edge, within which these are
_OFF = 0.15  # of the change by the last of these, that a crossing may be off
_OTHERS = 10.0  # maps: distance between crossings of other labels
_SHIFT = 32  # bits of a node's number in an edge's key


def most_runs(cells: int, cost: int) -> int:
    """Number of runs with which the lines of a map are traced at most, but for one batch; fewer of many touches.

    cells : of the map, and one more for each `TOUCHES` touches of their runs
    cost : see `PointRuns`
    """
    return _ON_ANY_MAP // cost + _RUNS_PER_CELL * cells


def _cost_of(runs: Points) -> int:
    """Number of runs without touches that take as long as some runs."""
    return runs.size + runs["touches"].sum() // TOUCHES


def keys_of(first: Nodes, second: Nodes) -> Codes:
    """Number of the edge between two nodes, whichever comes first."""
    return (np.minimum(first, second) << _SHIFT) | np.maximum(first, second)


def ends_of(keys: Codes) -> tuple[Nodes, Nodes]:
    """The two nodes of edges, the smaller number first."""
    return keys >> _SHIFT, keys & ((1 << _SHIFT) - 1)


def _following(corners: Array) -> Array:
    """The entry behind each one in rows, (n, m, …), such as corners of triangles; behind the last the first."""
    return np.roll(corners, -1, axis=1)


def _edges(corners: Nodes) -> Codes:
    """Numbers of the edges from each node to the one that follows in its row, (n, m)."""
    return keys_of(corners, _following(corners))


def cross(one: Floats, other: Floats) -> Floats:
    """Cross products of vectors, (..., 2) each."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def _length(vectors: Floats) -> Floats:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _height(corners: Floats) -> Floats:
    """The least height of triangles, (n,), whose corners are at some positions, (n, 3, 2)."""
    sides = _following(corners) - corners
    return abs(cross(sides[:, 0], sides[:, 1])) / _length(sides).max(axis=1)


def _append(rows: Array, more: Array) -> None:
    """Append rows to an array in place, which no other array may be a view of.

    Nodes come a few at a time: a copy of all rows of a large map for each takes a fifth of the time of tracing it.
    """
    count = len(rows)
    rows.resize((count + len(more), *rows.shape[1:]), refcheck=False)
    rows[count:] = more


class Triangles:
    """The triangles of a map, two in each cell, and those that they become where their edges get nodes.

    positions, runs : (nodes, 2) float64, on each axis from 0 to 1, and (nodes,) POINT, first the map's, in C order
    corners : (n, 3) nodes, anticlockwise
    is_new : (n,) whether a triangle was added since this was last cleared
    """

    def __init__(self, across: Floats, upward: Floats, runs: Points) -> None:
        self.positions = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1).reshape(-1, 2).copy()
        self.runs = runs.flatten()
        self.nodes = np.arange(runs.size).reshape(runs.shape)  # of the map
        a, b, c, d = self.nodes[:-1, :-1], self.nodes[1:, :-1], self.nodes[1:, 1:], self.nodes[:-1, 1:]
        self.corners = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).copy()
        self.is_new = np.ones(len(self.corners), bool)

    @property
    def outcome(self) -> Codes:
        """Code of each node's label, (nodes,)."""
        return self.runs["outcome"]

    def mixed(self, *, only_new: bool = False) -> tuple[Nodes, Nodes]:
        """Triangles of two labels, the corner of the other label first, and triangles of three: (n, 3) nodes each."""
        corners = self.corners[self.is_new] if only_new else self.corners
        one, other, third = self.outcome[corners].T
        corners = corners[(one != other) | (other != third)]  # few of a large map's
        labels = self.outcome[corners]
        alike = labels == _following(labels)
        two = alike.any(axis=1)
        turns = (alike[two].argmax(axis=1)[:, None] + [2, 3, 4]) % 3
        return np.take_along_axis(corners[two], turns, 1), corners[~two]

    def add(self, keys: Codes, positions: Floats, runs: Points) -> None:
        """Add a node on each of these edges, of which none comes twice."""
        order = keys.argsort()
        nodes = len(self.runs) + order
        _append(self.positions, positions)
        _append(self.runs, runs)
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
        edges = _edges(corners)
        at = np.minimum(keys.searchsorted(edges), keys.size - 1)
        is_cut = keys[at] == edges
        cut = np.flatnonzero(is_cut.any(axis=1))
        turns = is_cut[cut].argmax(axis=1)
        first, second, last = np.take_along_axis(corners[cut], (turns[:, None] + [0, 1, 2]) % 3, 1).T
        middle, begin = nodes[at[cut, turns]], len(self.corners)
        self.corners[near[cut]], self.is_new[near[cut]] = np.stack([first, middle, last], 1), True
        _append(self.corners, np.stack([middle, second, last], 1))
        _append(self.is_new, np.ones(cut.size, bool))
        return np.concatenate([near[cut], np.arange(begin, len(self.corners))])


class Crossings:
    """Known crossings of lines with edges, by which the lines are continued to other edges.

    brackets, outcomes : ends of each crossing's bracket (n, 2, 2), and codes there (n, 2)
    """

    def __init__(self, brackets: Floats, outcomes: Codes) -> None:
        from scipy.spatial import KDTree  # a third of a second: only where lines are traced

        self._places = brackets.mean(axis=1).repeat(2, axis=0)
        self._ways = np.diff(brackets[:, [0, 1, 0]], axis=1).reshape(-1, 2)
        sides = np.stack([outcomes, outcomes[:, ::-1]], axis=1).reshape(-1, 2)
        self._tree = KDTree(np.column_stack([self._places, _OTHERS * sides]))

    def continued(self, begin: Floats, way: Floats, sides: Codes, but: Floats) -> Floats:
        """Shares of the way along edges at which a line is expected, and by how much that may be off, (n, 2).

        It is the line between two outcomes (n, 2), continued by the polynomial through `_POINTS` crossings nearby but
        for those at some places (n, k, 2). NaN where there are too few.
        """
        shares = np.full((len(begin), 2), np.nan)
        if len(self._places) < _NEIGHBOURS:
            return shares
        distance, at = self._tree.query(np.column_stack([begin + 0.5 * way, _OTHERS * sides]), _NEIGHBOURS)
        places, length = self._places[at], _length(way)[:, None]
        is_near = (distance < _REACH * length) & ((self._ways[at] * way[:, None]).sum(axis=2) > 0.0)
        is_near &= (_length(places[:, :, None] - but[:, None]) > _NEAR).all(axis=2)
        rows = np.flatnonzero(is_near.sum(axis=1) >= _POINTS)
        places, way = places[rows] - begin[rows, None], way[rows, None] / length[rows, None] ** 2
        apart, points = np.where(is_near[rows], 1.0, -np.inf), np.empty((len(rows), _POINTS, 2))
        for k in range(_POINTS):  # each as far from those before as can be
            points[:, k] = places[np.arange(len(rows)), apart.argmax(axis=1)]
            apart = np.minimum(apart, _length(places - points[:, k, None]))
        off, along = cross(way, points), (way * points).sum(axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            for k in range(1, _POINTS):  # Neville's scheme
                less, right, left = along, off[:, k:], off[:, :-k]
                along = (right * less[:, :-1] - left * less[:, 1:]) / (right - left)
            expected = np.column_stack([along[:, 0], _OFF * abs(along[:, 0] - less[:, 0])])
        shares[rows] = np.where(np.isfinite(expected), expected, np.nan)
        return shares


class Lines:
    """Lines of a map as they are traced; positions are on each axis from 0 to 1.

    triangles : Triangles
    run : runs points (n, 2); returns (n,) POINT
    cost : see `PointRuns`
    beside : cost of a run beside its own and that of its touches: preparing it, and the touches of other lashes
    keys, brackets, runs : (n,) keys of edges with a crossing, ascending, and of each the two ends of its bracket
        (n, 2, 2), from the first node on, and POINT there (n, 2)
    met, met_labels : (m, 2) triple points, and the codes of the labels that meet there (m, 3)
    unresolved : (n, 2) places where lines are not located
    """

    def __init__(self, triangles: Triangles, run: Callable[[Floats], Points], cost: int, beside: int) -> None:
        self.triangles, self._run_points = triangles, run
        self._most_runs, self._beside = most_runs(_cost_of(triangles.runs), cost), beside
        self._spent, self._rounds = 0, 0
        self._asks_flat = False  # whether triangles not as high as `CHORD` are asked, too
        self.keys, self.brackets = np.zeros(0, np.int64), np.zeros((0, 2, 2))
        self._thin = np.zeros(0, np.int64)  # keys of edges of triangles no higher than `_THIN`
        self._cuts: list[tuple[Codes, Floats, Points]] = []
        self.runs = np.zeros((0, 2), POINT)
        self.met, self.met_labels = np.zeros((0, 2)), np.zeros((0, 3), np.int64)
        self.unresolved = np.zeros((0, 2))

    def trace(self) -> None:
        """Locate the crossings on edges, and add nodes, until all lines are told well enough or there are no runs."""
        for nodes in (self.triangles.nodes, self.triangles.nodes.T):
            self._find_hidden(_edges(nodes), self.triangles.positions[nodes], self.triangles.runs[nodes])
        self._follow()
        self._find_beside_crossings()
        self._follow()
        self._rounds = max(self._rounds, _MOST_ROUNDS - _LAST_ROUNDS)
        self._asks_flat = True
        self.triangles.is_new[:] = _height(self.triangles.positions[self.triangles.corners]) <= CHORD
        self._refine()
        self._follow()
        self._sharpen()
        self.unresolved = np.concatenate([self.unresolved, self.triangles.positions[self._wide()].mean(axis=1)])

    def _follow(self) -> None:
        """Locate crossings and add nodes, until nothing waits."""
        while self._cuts or not self._rounds:
            self.triangles.is_new[:] = not self._rounds
            for cut in self._cuts:
                self.triangles.add(*cut)
            new = self.triangles.corners[self.triangles.is_new]
            self._thin = np.union1d(self._thin, _edges(new[_height(self.triangles.positions[new]) <= _THIN]))
            self._cuts, self._rounds = [], self._rounds + 1
            self._locate()
            self._refine()

    def segments(self) -> tuple[Codes, Codes]:
        """Pieces of lines in triangles: the nodes at their ends (n, 2), and codes on their left and right.

        A node is the key of an edge, or -1 - the number of a triple point.
        """
        two, three = self.triangles.mixed()
        self.met = self.position(_edges(three).ravel()).reshape(-1, 3, 2).mean(axis=1)
        self.met_labels = self.triangles.outcome[three]
        from_junction = np.repeat(-1 - np.arange(len(three)), 3)
        sides = np.stack([_following(three), three], axis=2).reshape(-1, 2)
        nodes = [keys_of(two[:, :1], two[:, 1:]), np.column_stack([from_junction, keys_of(*sides.T)])]
        return np.concatenate(nodes), self.triangles.outcome[np.concatenate([two[:, :2], sides])]

    def _run(self, places: Floats) -> Points:
        runs = self._run_points(places)
        self._spent += _cost_of(runs) + self._beside * runs.size
        return runs

    def _may_run(self, share: float = 1.0) -> bool:
        return self._spent < share * self._most_runs

    def _may_cut(self) -> bool:
        return self._may_run(_CUT) and self._rounds < _MOST_ROUNDS

    def bracket(self, keys: Codes) -> Floats:
        """Ends of the brackets of the crossings on edges, (2, n, 2), from each edge's first node on."""
        return self.brackets[self.keys.searchsorted(keys)].swapaxes(0, 1)

    def _widths(self) -> Floats:
        return _length(self.brackets[:, 1] - self.brackets[:, 0])

    def position(self, nodes: Codes) -> Floats:
        """Positions of nodes of segments, (n, 2)."""
        positions = np.empty((nodes.size, 2))
        positions[nodes >= 0] = self.bracket(nodes[nodes >= 0]).mean(axis=0)
        positions[nodes < 0] = self.met[-1 - nodes[nodes < 0]]
        return positions

    def _find_hidden(self, keys: Codes, places: Floats, runs: Points) -> None:
        """Cut edges on which another label is hidden between two known points of the same label.

        keys : of the edge from each point to the next of its line (n, m), the last ones of no meaning
        places, runs : of points on straight lines, in their order, (n, m, 2) and (n, m) POINT
        """
        begin, way = places[:, 0], places[:, -1] - places[:, 0]
        way /= _length(way)[:, None]
        runs["cell"], runs["value"] = np.arange(len(runs))[:, None], _length(places - begin[:, None])

        def place(lines: Codes, values: Floats) -> Floats:
            return begin[lines] + values[:, None] * way[lines]

        points = runs.ravel()
        found, before = with_hidden(points, lambda *at: self._run(place(*at)), _HALVINGS, self._may_cut)
        hits = np.flatnonzero(found["outcome"] != points["outcome"][before])
        keys, first = np.unique(keys.ravel()[before[hits]], return_index=True)
        runs = found[hits[first]]
        if keys.size:
            self._cuts.append((keys, place(runs["cell"], runs["value"]), runs))

    def _find_beside_crossings(self) -> None:
        """Cut edges on which another label is hidden beside the crossing."""
        keys = np.intersect1d(self._mixed_edges(), self.keys)
        nodes, at = np.stack(ends_of(keys), axis=1), self.keys.searchsorted(keys)
        places = np.insert(self.triangles.positions[nodes], [1], self.brackets[at], axis=1)
        runs = np.insert(self.triangles.runs[nodes], [1], self.runs[at], axis=1)
        self._find_hidden(keys[:, None].repeat(4, axis=1), places, runs)

    def _mixed_edges(self, *, only_new: bool = False) -> Codes:
        """Keys of the edges whose ends have different labels, ascending."""
        keys = np.unique(_edges(np.concatenate(self.triangles.mixed(only_new=only_new))))
        first, second = ends_of(keys)
        return keys[self.triangles.outcome[first] != self.triangles.outcome[second]]

    def _locate(self) -> None:
        """Locate crossings on new edges, nearly, and cut those with several between each two, so that none is lost."""
        keys = self._mixed_edges(only_new=True)
        keys = keys[~np.isin(keys, self.keys)]
        if not keys.size:
            return
        nodes = np.stack(ends_of(keys), axis=1)
        brackets, runs = self.triangles.positions[nodes], self.triangles.runs[nodes]
        lines, ends, runs = self._crossings(keys, brackets, runs, _NEAR)
        edges, begins, counts = np.unique(lines, return_index=True, return_counts=True)
        is_told = np.repeat(counts <= _MOST_CROSSINGS, counts)  # others are not narrowed
        (node, last), added = ends_of(keys[edges]), len(self.triangles.runs)
        while begins.size:  # of each edge the next crossing, and, if it is not the last, a node behind it
            is_cut, beyond = counts > 1, last.copy()
            at = begins[is_cut]
            beyond[is_cut] = new = added + np.arange(at.size)
            told, turned, brackets, pairs = is_told[begins], node > beyond, ends[begins], runs[begins]
            brackets[turned], pairs[turned] = brackets[turned, ::-1], pairs[turned, ::-1]
            self._keep(keys_of(node, beyond)[told], brackets[told], pairs[told])
            self._cuts.append((keys_of(node, last)[is_cut], 0.5 * (ends[at, 1] + ends[at + 1, 0]), runs[at, 1]))
            begins, counts, node, last, added = at + 1, counts[is_cut] - 1, new, last[is_cut], added + at.size

    def _sharpen(self) -> None:
        """Narrow the brackets of the crossings that there are in the end."""
        width = self._widths()
        at = np.flatnonzero(np.isin(self.keys, self._mixed_edges()) & (width > TOLERANCE) & (width < 2.0 * _NEAR))
        if at.size:
            _, self.brackets[at], self.runs[at] = self._crossings(
                self.keys[at], self.brackets[at], self.runs[at], TOLERANCE
            )

    def _crossings(self, keys: Codes, brackets: Floats, runs: Points, tolerance: float) -> tuple[Codes, Floats, Points]:
        """Crossings on edges within brackets, of which those nearer to each other than the tolerance are one.

        Returns the numbers of the edges (n,), brackets (n, 2, 2), and runs at their ends (n, 2).
        """
        first, second = ends_of(keys)
        begin = self.triangles.positions[first]
        way = self.triangles.positions[second] - begin
        length = _length(way)
        runs["cell"], runs["value"] = np.arange(keys.size)[:, None], _length(brackets - begin[:, None])
        known = self._widths() <= 2.0 * tolerance
        lines = Crossings(self.brackets[known], self.runs["outcome"][known])

        def place(edges: Codes, distances: Floats) -> Floats:
            return begin[edges] + (distances / length[edges])[..., None] * way[edges]

        def guess(ends: Points) -> Floats:
            edges = ends["cell"][:, 0]
            shares = lines.continued(begin[edges], way[edges], ends["outcome"], begin[edges, None])
            return shares * length[edges, None]

        low, high = narrow(
            runs.ravel(),
            lambda edges, distances: self._run(place(edges, distances)),
            _MOST_CROSSINGS,
            may_run=lambda: self._may_run(_ON_EDGES if tolerance > TOLERANCE else 1.0),
            tolerances=np.clip(_OF_EDGE * length, TOLERANCE, tolerance),
            guess=guess,
        )
        edges = low["cell"]
        is_apart = (low["value"][1:] - high["value"][:-1] >= RESOLUTION) & self._may_cut() & (tolerance > TOLERANCE)
        is_apart &= ~np.isin(keys[edges[1:]], self._thin)
        is_parted = (edges[1:] != edges[:-1]) | is_apart
        low, high = low[np.append(True, is_parted)], high[np.append(is_parted, True)]
        ends = np.stack([low, high], axis=1)[low["outcome"] != high["outcome"]]  # else a label without width
        return ends["cell"][:, 0], place(ends["cell"], ends["value"]), ends

    def _keep(self, keys: Codes, brackets: Floats, runs: Points) -> None:
        """Keep crossings: keys of the edges (n,), and brackets (n, 2, 2) and runs (n, 2) from the first node on."""
        every = np.concatenate([self.keys, keys])
        order = every.argsort()
        self.keys, self.brackets = every[order], np.concatenate([self.brackets, brackets])[order]
        self.runs = np.concatenate([self.runs, runs])[order]

    def _refine(self) -> None:
        """Cut edges of new triangles whose lines are located, and not told well enough, or that have become flat."""
        two, three = self.triangles.mixed(only_new=True)
        positions = self.triangles.positions
        is_located, three = self._is_located(two), three[self._is_located(three)]
        several, two = two[~is_located], two[is_located]
        tip, begin, end = positions[several.T]
        far, length = end - begin, _length(end - begin)
        is_flat = (length > CHORD) & (abs(cross(begin - tip, far)) < _FLAT * length**2)
        off, places = self._off_chord(two)
        off, places = np.concatenate([off, several[is_flat]]), np.concatenate([places, 0.5 * (begin + end)[is_flat]])
        sides = np.stack([three, _following(three)], axis=2)
        lengths = _length(np.diff(positions[sides], axis=2)[:, :, 0])
        is_large = lengths.max(axis=1, initial=0.0) > JUNCTION
        three = three[is_large]
        if not len(off) + len(three):
            return
        if not self._may_cut():
            self.unresolved = np.concatenate([self.unresolved, positions[np.concatenate([off, three])].mean(axis=1)])
            return
        long = sides[is_large][lengths[is_large] > _LONG * lengths[is_large].max(axis=1, keepdims=True)]
        crossing = self.position(keys_of(*long.T))
        away = positions[long] - crossing[:, None]
        to_far_end = away[np.arange(len(long)), _length(away).argmax(axis=1)]
        places = np.concatenate([places, crossing + _BESIDE * to_far_end])
        keys, at = np.unique(keys_of(*np.concatenate([off[:, 1:], long]).T), return_index=True)
        is_thin = np.isin(keys, self._thin)
        self.unresolved = np.concatenate([self.unresolved, places[at[is_thin]]])
        keys, at = keys[~is_thin], at[~is_thin]
        if keys.size:
            self._cuts.append((keys, places[at], self._run(places[at])))

    def _is_located(self, corners: Nodes) -> Bools:
        """Whether all crossings on the edges of triangles are located, one on each."""
        labels = self.triangles.outcome[corners]
        return ((labels == _following(labels)) | np.isin(_edges(corners), self.keys)).all(axis=1)

    def _off_chord(self, corners: Nodes) -> tuple[Nodes, Floats]:
        """Triangles whose line may be off its chord by `CHORD`, with the edge to cut last, and where to cut it, (n, 2).

        It is not where the labels are those of its sides as far from the chord's middle, at a right angle to it, or
        where the triangle ends before that. Else the far edge is cut; of flat triangles the edge on which another label
        is, where it is, as two crossings are hidden there. What is as thin as `RESOLUTION` is not cut.

        corners : of triangles of two labels, the one of the other label first
        """
        ends = self.position(keys_of(corners[:, :1], corners[:, 1:]).ravel()).reshape(-1, 2, 2)
        positions, labels = self.triangles.positions[corners], self.triangles.outcome[corners[:, :2]]
        limit = np.where((labels == FAILED_CODE).any(axis=1), OFF_FAILURES, CHORD)  # told to less, see `narrow`
        is_asked = (_length(ends[:, 1] - ends[:, 0]) > limit) & ((_height(positions) > limit) | self._asks_flat)
        corners, ends, labels, limit = corners[is_asked], ends[is_asked], labels[is_asked], limit[is_asked, None]
        positions = positions[is_asked]
        places = positions[:, 1:].mean(axis=1)
        if not len(corners) or not self._may_run():
            return corners, places
        chord, middle, sides = ends[:, 1] - ends[:, 0], ends.mean(axis=1), _following(positions) - positions
        back = chord[:, ::-1] * [1.0, -1.0] / _length(chord)[:, None]  # from the corner of the other label
        way = back * _length(sides).max(axis=1, keepdims=True)
        lines = Crossings(self.brackets, self.runs["outcome"])
        expected, error = lines.continued(middle - 0.5 * way, way, labels, ends).T
        is_near = (abs(expected - 0.5) + error) * _length(way) < 0.5 * CHORD
        leaves = cross(sides, back[:, None])[:, None] * [[1.0], [-1.0]]  # ahead and back, through each side
        inside = cross(sides, middle[:, None] - positions)[:, None]
        reach = np.divide(inside, leaves, out=np.full(leaves.shape, np.inf), where=leaves > 0.0)
        begins, reach = reach.argmin(axis=2), reach.min(axis=2)
        is_thin, is_flat = reach <= RESOLUTION, reach < limit
        apart = np.where(is_thin | ~is_flat, limit, reach)
        asked = np.flatnonzero(~is_near | (self._asks_flat & is_flat.any(axis=1)))
        at_ends, beside = (
            middle[asked, None] + (each[asked] * [-1.0, 1.0])[..., None] * back[asked, None] for each in (reach, apart)
        )
        is_off = self._run(beside.reshape(-1, 2))["outcome"].reshape(-1, 2) != labels[asked]
        self.unresolved = np.concatenate([self.unresolved, middle[asked[(is_off & is_thin[asked]).any(axis=1)]]])
        is_off &= ~is_thin[asked]
        off = np.flatnonzero(is_off.any(axis=1))
        side, asked = 1 - (is_off & is_flat[asked])[off, 0], asked[off]
        corners, places = corners[asked], places[asked]
        if self._asks_flat:
            corners = np.take_along_axis(corners, (begins[asked, side, None] + [2, 0, 1]) % 3, 1)
            begin, end = self.triangles.positions[corners[:, 1:]].swapaxes(0, 1)
            along, length = end - begin, _length(end - begin)
            share = ((at_ends[off, side] - begin) * along).sum(axis=1) / length**2
            share[abs(share - 0.5) * length > 0.5 * length - RESOLUTION] = 0.5  # at a node, or beyond it
            places = begin + share[:, None] * along
        return corners, places

    def _wide(self) -> Nodes:
        """Triangles with an edge whose crossing is not located, (n, 3)."""
        mixed = np.concatenate(self.triangles.mixed())
        # where runs were too few for all crossings, those as near as chords are will do
        far = _LOCATED if self._may_run(_ON_EDGES) else CHORD
        fails = (self.runs["outcome"] == FAILED_CODE).any(axis=1)  # told to less, see `narrow`
        wide = self.keys[self._widths() > np.where(fails, OFF_FAILURES, far)]
        return mixed[np.isin(_edges(mixed), wide).any(axis=1)]
