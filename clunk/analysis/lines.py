"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells of the map are cut into triangles (`clunk.analysis.triangles`). On each edge whose two nodes have different
labels a crossing is located (`clunk.analysis.search`). As lines are smooth, known lines are continued to the edge where
that is possible (`Crossings`), and two runs then locate the crossing.

A line that is not known well enough is refined by one operation, a node on an edge: between two crossings of the same
edge; on the far edge of a triangle, which is opposite the corner of the single label, where its line is further from
its chord than `CHORD`, or nodes on its other edges have made it flat, as lines that leave through the far edge have no
crossing there; and beside the crossings on the long edges of a triangle of three labels, until these meet in a triangle
as small as `JUNCTION`.
When no line is left to follow, edges with a crossing are searched once for labels hidden beside it (`with_hidden`);
then the lines in flat triangles are compared with their chords, too.
Refinement needs crossings only to within `_NEAR`. The crossings of the final network are narrowed to the tolerance with
the runs that are left, so that the course of the lines comes before its last digits.

Tracing ends because it takes `_MOST_ROUNDS` rounds at most, and adds nodes only during the first part of the runs that
it may take (`most_runs`). Each round takes all edges and triangles that wait, so that a place where labels change on
all scales does not delay the others. The network is closed wherever edges are cut, as it follows from the labels of the
nodes alone: an edge is split in both of its triangles, two labels in a triangle are parted by one line from edge to
edge, and three meet in a point. No triangle turns over, as the edges of triangles no higher than `_THIN` are not cut.
Where a line is not located, its place is kept as unresolved.
"""

from collections.abc import Callable

import numpy as np

from clunk.analysis.search import OFF_FAILURES, POINT, TOLERANCE, Points, narrow, with_hidden
from clunk.analysis.triangles import Triangles, cross, edges_of, ends_of, following, height_of, keys_of, length_of
from clunk.results.labels import FAILED_CODE
from clunk.study.arrays import Bools, Codes, Floats, Nodes

# Lengths of the map are those of its axes scaled from 0 to 1.
CHORD = 1.3e-4  # of the map, the greatest distance of a line from its chord
JUNCTION = 5e-8  # of the map, the longest edge of a triangle in which three labels meet at a point
RESOLUTION = 1e-8  # of the map: crossings on an edge that are nearer to each other are not parted by a node
_THIN = 1e-11  # of the map: edges of triangles of at most this height are not cut, as rounding would lose the height
_MOST_ROUNDS, _LAST_ROUNDS = 128, 8  # of all rounds, and of the last ones, in which flat triangles are checked, too
_HALVINGS = 4  # of an edge in search of another label between two nodes of the same label
_MOST_CROSSINGS = 4  # on an edge, that are told apart
_LONG = 0.5  # of a triangle's longest edge, above which an edge is long
_FLAT = 0.1  # of the far edge, the height over it below which a triangle with several crossings on another edge is flat
_BESIDE = 0.03  # of the way from a crossing on a long edge to the edge's far end, the place of a node
_RUNS_PER_CELL, _ON_ANY_MAP = 7, 5_000_000  # most runs, for each cell and for any map, the latter over a run's cost
TOUCHES = 10  # touches that take as long as a run without any
_CUT, _ON_EDGES = 0.85, 0.95  # shares of the most runs, up to which edges are cut, and crossings on new edges located
_LOCATED = 4.0 * RESOLUTION  # of the map, the widest bracket of a located crossing, or of several that are not parted
_NEAR, _OF_EDGE = 7e-5, 5e-3  # of the map and of the edge, the widest bracket of a crossing before the last narrowing
_POINTS, _NEIGHBOURS = 4, 8  # crossings through which a line is continued, and nearest ones of which they are chosen
_REACH = 15.0  # lengths of the edge to which a line is continued, the distance within which they lie
_OFF = 0.15  # of the change by the last of these crossings, the error of the expected place
_OTHERS = 10.0  # maps, the distance put between crossings of different labels so that the nearest ones are of the same


def most_runs(cells: int, cost: int) -> int:
    """Most runs without touches for tracing the lines of a map, which only the last batch may exceed.

    cells : number of the map's cells, and one more for each `TOUCHES` touches of their runs
    cost : see `PointRuns`
    """
    return _ON_ANY_MAP // cost + _RUNS_PER_CELL * cells


def _cost_of(runs: Points) -> int:
    """Cost of runs: the number of runs without touches that take as long."""
    return runs.size + runs["touches"].sum() // TOUCHES


class Crossings:
    """Known crossings of lines with edges, from which the lines are continued to other edges.

    brackets, outcomes : ends of each crossing's bracket (n, 2, 2), and codes of the outcomes there (n, 2)
    """

    def __init__(self, brackets: Floats, outcomes: Codes) -> None:
        from scipy.spatial import KDTree  # takes a third of a second: only where lines are traced

        self._places = brackets.mean(axis=1).repeat(2, axis=0)
        self._ways = np.diff(brackets[:, [0, 1, 0]], axis=1).reshape(-1, 2)
        sides = np.stack([outcomes, outcomes[:, ::-1]], axis=1).reshape(-1, 2)
        self._tree = KDTree(np.column_stack([self._places, _OTHERS * sides]))

    def continued(self, begin: Floats, way: Floats, sides: Codes, but: Floats) -> Floats:
        """Expected crossings of lines with edges, as shares of the way along each edge, and their errors, (n, 2).

        A polynomial through `_POINTS` crossings nearby continues each line. NaN where there are too few of these.

        begin, way : of the edges, the first end and the vector to the other end, (n, 2) each
        sides : outcomes at these two ends, which the line parts, (n, 2)
        but : places of crossings that are left out, (n, k, 2)
        """
        shares = np.full((len(begin), 2), np.nan)
        if len(self._places) < _NEIGHBOURS:
            return shares
        distance, at = self._tree.query(np.column_stack([begin + 0.5 * way, _OTHERS * sides]), _NEIGHBOURS)
        places, length = self._places[at], length_of(way)[:, None]
        is_near = (distance < _REACH * length) & ((self._ways[at] * way[:, None]).sum(axis=2) > 0.0)
        is_near &= (length_of(places[:, :, None] - but[:, None]) > _NEAR).all(axis=2)
        rows = np.flatnonzero(is_near.sum(axis=1) >= _POINTS)
        places, way = places[rows] - begin[rows, None], way[rows, None] / length[rows, None] ** 2
        apart, points = np.where(is_near[rows], 1.0, -np.inf), np.empty((len(rows), _POINTS, 2))
        for k in range(_POINTS):  # each as far as possible from those before it
            points[:, k] = places[np.arange(len(rows)), apart.argmax(axis=1)]
            apart = np.minimum(apart, length_of(places - points[:, k, None]))
        off, along = cross(way, points), (way * points).sum(axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            for k in range(1, _POINTS):  # Neville's scheme
                less, right, left = along, off[:, k:], off[:, :-k]
                along = (right * less[:, :-1] - left * less[:, 1:]) / (right - left)
            expected = np.column_stack([along[:, 0], _OFF * abs(along[:, 0] - less[:, 0])])
        shares[rows] = np.where(np.isfinite(expected), expected, np.nan)
        return shares


class Lines:
    """Lines of a map while they are traced; positions are on each axis from 0 to 1.

    triangles : Triangles
    run : runs points (n, 2); returns (n,) POINT
    cost : see `PointRuns`
    beside : cost of each run, in runs without touches, that is not its own nor that of its touches: preparing its
        driveline, and the touches of other lashes
    keys, brackets, runs : (n,) keys of edges with a crossing, ascending; the two ends of each crossing's bracket
        (n, 2, 2), the one nearer to the edge's first node first; and POINT at these ends (n, 2)
    met, met_labels : (m, 2) triple points, and the codes of the labels that meet there (m, 3), set by `segments`
    unresolved : (n, 2) places where lines are not located
    """

    def __init__(self, triangles: Triangles, run: Callable[[Floats], Points], cost: int, beside: int) -> None:
        self.triangles, self._run_points = triangles, run
        self._most_runs, self._beside = most_runs(_cost_of(triangles.runs), cost), beside
        self._spent, self._rounds = 0, 0
        self._asks_flat = False  # whether lines in triangles less high than `CHORD` are compared with their chords, too
        self.keys, self.brackets = np.zeros(0, np.int64), np.zeros((0, 2, 2))
        self._thin = np.zeros(0, np.int64)  # keys of edges of triangles no higher than `_THIN`
        self._cuts: list[tuple[Codes, Floats, Points]] = []
        self.runs = np.zeros((0, 2), POINT)
        self.met, self.met_labels = np.zeros((0, 2)), np.zeros((0, 3), np.int64)
        self.unresolved = np.zeros((0, 2))

    def trace(self) -> None:
        """Locate crossings on edges and add nodes until all lines are known well enough or the runs are used up."""
        for nodes in (self.triangles.nodes, self.triangles.nodes.T):
            self._find_hidden(edges_of(nodes), self.triangles.positions[nodes], self.triangles.runs[nodes])
        self._follow()
        self._find_beside_crossings()
        self._follow()
        self._rounds = max(self._rounds, _MOST_ROUNDS - _LAST_ROUNDS)
        self._asks_flat = True
        self.triangles.is_new[:] = height_of(self.triangles.positions[self.triangles.corners]) <= CHORD
        self._refine()
        self._follow()
        self._sharpen()
        self.unresolved = np.concatenate([self.unresolved, self.triangles.positions[self._wide()].mean(axis=1)])

    def _follow(self) -> None:
        """Add the nodes that wait and locate crossings on new edges, in rounds, until no node waits."""
        while self._cuts or not self._rounds:
            self.triangles.is_new[:] = not self._rounds
            for cut in self._cuts:
                self.triangles.add(*cut)
            new = self.triangles.corners[self.triangles.is_new]
            self._thin = np.union1d(self._thin, edges_of(new[height_of(self.triangles.positions[new]) <= _THIN]))
            self._cuts, self._rounds = [], self._rounds + 1
            self._locate()
            self._refine()

    def segments(self) -> tuple[Codes, Codes]:
        """Pieces of lines in triangles: nodes at their ends (n, 2), and codes of the labels on their left and right.

        A node is here the key of an edge with a crossing, or -1 minus the number of a triple point.
        """
        two, three = self.triangles.mixed()
        self.met = self.position(edges_of(three).ravel()).reshape(-1, 3, 2).mean(axis=1)
        self.met_labels = self.triangles.outcome[three]
        from_junction = np.repeat(-1 - np.arange(len(three)), 3)
        sides = np.stack([following(three), three], axis=2).reshape(-1, 2)
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
        """Ends of the brackets of the crossings on edges, (2, n, 2), the end nearer to the edge's first node first."""
        return self.brackets[self.keys.searchsorted(keys)].swapaxes(0, 1)

    def _widths(self) -> Floats:
        return length_of(self.brackets[:, 1] - self.brackets[:, 0])

    def position(self, nodes: Codes) -> Floats:
        """Positions of nodes as `segments` numbers them, (n, 2)."""
        positions = np.empty((nodes.size, 2))
        positions[nodes >= 0] = self.bracket(nodes[nodes >= 0]).mean(axis=0)
        positions[nodes < 0] = self.met[-1 - nodes[nodes < 0]]
        return positions

    def _find_hidden(self, keys: Codes, places: Floats, runs: Points) -> None:
        """Cut edges on which another label is hidden between two known points of the same label.

        keys : of the edge between each point and the next of its row (n, m); those of the last points have no meaning
        places, runs : positions (n, m, 2) of points in rows along straight lines, in their order, and (n, m) POINT
        """
        begin, way = places[:, 0], places[:, -1] - places[:, 0]
        way /= length_of(way)[:, None]
        runs["cell"], runs["value"] = np.arange(len(runs))[:, None], length_of(places - begin[:, None])

        def place(lines: Codes, values: Floats) -> Floats:
            return begin[lines] + values[:, None] * way[lines]

        points = runs.ravel()
        every, before = with_hidden(points, lambda *at: self._run(place(*at)), _HALVINGS, self._may_cut)
        hits = np.flatnonzero(every["outcome"] != points["outcome"][before])
        keys, first = np.unique(keys.ravel()[before[hits]], return_index=True)
        runs = every[hits[first]]
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
        keys = np.unique(edges_of(np.concatenate(self.triangles.mixed(only_new=only_new))))
        first, second = ends_of(keys)
        return keys[self.triangles.outcome[first] != self.triangles.outcome[second]]

    def _locate(self) -> None:
        """Locate crossings on new edges to `_NEAR`, and cut edges between each two of several, so that none is lost."""
        keys = self._mixed_edges(only_new=True)
        keys = keys[~np.isin(keys, self.keys)]
        if not keys.size:
            return
        nodes = np.stack(ends_of(keys), axis=1)
        brackets, runs = self.triangles.positions[nodes], self.triangles.runs[nodes]
        lines, ends, runs = self._crossings(keys, brackets, runs, _NEAR)
        edges, begins, counts = np.unique(lines, return_index=True, return_counts=True)
        is_narrow = np.repeat(counts <= _MOST_CROSSINGS, counts)  # brackets on edges with more are left wide
        (node, last), added = ends_of(keys[edges]), len(self.triangles.runs)
        while begins.size:  # keep the next crossing of each edge, and add a node beyond it unless it is the last
            is_cut, beyond = counts > 1, last.copy()
            at = begins[is_cut]
            beyond[is_cut] = new = added + np.arange(at.size)
            kept, turned, brackets, pairs = is_narrow[begins], node > beyond, ends[begins], runs[begins]
            brackets[turned], pairs[turned] = brackets[turned, ::-1], pairs[turned, ::-1]
            self._keep(keys_of(node, beyond)[kept], brackets[kept], pairs[kept])
            self._cuts.append((keys_of(node, last)[is_cut], 0.5 * (ends[at, 1] + ends[at + 1, 0]), runs[at, 1]))
            begins, counts, node, last, added = at + 1, counts[is_cut] - 1, new, last[is_cut], added + at.size

    def _sharpen(self) -> None:
        """Narrow the brackets of the crossings of the final network to `TOLERANCE`."""
        width = self._widths()
        at = np.flatnonzero(np.isin(self.keys, self._mixed_edges()) & (width > TOLERANCE) & (width < 2.0 * _NEAR))
        if at.size:
            _, self.brackets[at], self.runs[at] = self._crossings(
                self.keys[at], self.brackets[at], self.runs[at], TOLERANCE
            )

    def _crossings(self, keys: Codes, brackets: Floats, runs: Points, tolerance: float) -> tuple[Codes, Floats, Points]:
        """Locate crossings on edges within brackets (n, 2, 2), with runs at their ends (n, 2), to a tolerance.

        Crossings nearer to each other than `RESOLUTION` count as one, and so do all crossings of an edge that is not to
        be cut: one of a thin triangle, and any edge once nodes may not be added or the tolerance is `TOLERANCE`.

        Returns, for m crossings, the positions of their edges among the keys (m,), brackets (m, 2, 2), and runs at the
        ends of these (m, 2).
        """
        first, second = ends_of(keys)
        begin = self.triangles.positions[first]
        way = self.triangles.positions[second] - begin
        length = length_of(way)
        runs["cell"], runs["value"] = np.arange(keys.size)[:, None], length_of(brackets - begin[:, None])
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
        # where both ends have the same outcome, the label between them has no width
        ends = np.stack([low, high], axis=1)[low["outcome"] != high["outcome"]]
        return ends["cell"][:, 0], place(ends["cell"], ends["value"]), ends

    def _keep(self, keys: Codes, brackets: Floats, runs: Points) -> None:
        """Keep located crossings, see `Lines`: keys of their edges (n,), brackets (n, 2, 2) and runs (n, 2)."""
        every = np.concatenate([self.keys, keys])
        order = every.argsort()
        self.keys, self.brackets = every[order], np.concatenate([self.brackets, brackets])[order]
        self.runs = np.concatenate([self.runs, runs])[order]

    def _refine(self) -> None:
        """Cut edges of new triangles whose line is located but not known well enough, and of triangles made flat."""
        two, three = self.triangles.mixed(only_new=True)
        positions = self.triangles.positions
        is_located, three = self._is_located(two), three[self._is_located(three)]
        several, two = two[~is_located], two[is_located]
        tip, begin, end = positions[several.T]
        far, length = end - begin, length_of(end - begin)
        is_flat = (length > CHORD) & (abs(cross(begin - tip, far)) < _FLAT * length**2)
        off, places = self._off_chord(two)
        off, places = np.concatenate([off, several[is_flat]]), np.concatenate([places, 0.5 * (begin + end)[is_flat]])
        sides = np.stack([three, following(three)], axis=2)
        lengths = length_of(np.diff(positions[sides], axis=2)[:, :, 0])
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
        to_far_end = away[np.arange(len(long)), length_of(away).argmax(axis=1)]
        places = np.concatenate([places, crossing + _BESIDE * to_far_end])
        keys, at = np.unique(keys_of(*np.concatenate([off[:, 1:], long]).T), return_index=True)
        is_thin = np.isin(keys, self._thin)
        self.unresolved = np.concatenate([self.unresolved, places[at[is_thin]]])
        keys, at = keys[~is_thin], at[~is_thin]
        if keys.size:
            self._cuts.append((keys, places[at], self._run(places[at])))

    def _is_located(self, corners: Nodes) -> Bools:
        """Whether every edge of a triangle that joins two labels has a located crossing, (n,), by corners (n, 3)."""
        labels = self.triangles.outcome[corners]
        return ((labels == following(labels)) | np.isin(edges_of(corners), self.keys)).all(axis=1)

    def _off_chord(self, corners: Nodes) -> tuple[Nodes, Floats]:
        """Triangles whose line may be off its chord by `CHORD`, with the edge to cut last, and where to cut it, (n, 2).

        A line counts as near its chord where lines, continued from crossings nearby, pass the chord's middle within
        half of `CHORD`; or where two runs, off the middle at a right angle to the chord, have the labels of their
        sides. These are at the distance `CHORD`, or where the way ends at the triangle's edge before that. Of any other
        triangle the far edge is cut in its middle; but where a run on an edge of a flat triangle had another label,
        that edge is cut there, as two crossings are hidden beside it. A triangle as thin as `RESOLUTION` is not cut.
        Once the runs are used up, every line may be off.

        corners : (m, 3) of triangles of two labels, the corner of the single label first
        """
        ends = self.position(keys_of(corners[:, :1], corners[:, 1:]).ravel()).reshape(-1, 2, 2)
        positions, labels = self.triangles.positions[corners], self.triangles.outcome[corners[:, :2]]
        # beside failed runs crossings are located less precisely, see `narrow`
        limit = np.where((labels == FAILED_CODE).any(axis=1), OFF_FAILURES, CHORD)
        is_asked = (length_of(ends[:, 1] - ends[:, 0]) > limit) & ((height_of(positions) > limit) | self._asks_flat)
        corners, ends, labels, limit = corners[is_asked], ends[is_asked], labels[is_asked], limit[is_asked, None]
        positions = positions[is_asked]
        places = positions[:, 1:].mean(axis=1)
        if not len(corners) or not self._may_run():
            return corners, places
        chord, middle, sides = ends[:, 1] - ends[:, 0], ends.mean(axis=1), following(positions) - positions
        back = chord[:, ::-1] * [1.0, -1.0] / length_of(chord)[:, None]  # unit vector away from the corner listed first
        way = back * length_of(sides).max(axis=1, keepdims=True)
        lines = Crossings(self.brackets, self.runs["outcome"])
        expected, error = lines.continued(middle - 0.5 * way, way, labels, ends).T
        is_near = (abs(expected - 0.5) + error) * length_of(way) < 0.5 * CHORD
        # positive where the way ahead, toward that corner, or back comes nearer to a side
        leaves = cross(sides, back[:, None])[:, None] * [[1.0], [-1.0]]
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
            along, length = end - begin, length_of(end - begin)
            share = ((at_ends[off, side] - begin) * along).sum(axis=1) / length**2
            share[abs(share - 0.5) * length > 0.5 * length - RESOLUTION] = 0.5  # rather than at a node or beyond it
            places = begin + share[:, None] * along
        return corners, places

    def _wide(self) -> Nodes:
        """Triangles with an edge on which the bracket of the crossing is too wide, (n, 3)."""
        mixed = np.concatenate(self.triangles.mixed())
        # where the runs did not suffice for all crossings, brackets as wide as `CHORD` will do
        far = _LOCATED if self._may_run(_ON_EDGES) else CHORD
        fails = (self.runs["outcome"] == FAILED_CODE).any(axis=1)  # located less precisely, see `narrow`
        wide = self.keys[self._widths() > np.where(fails, OFF_FAILURES, far)]
        return mixed[np.isin(edges_of(mixed), wide).any(axis=1)]
