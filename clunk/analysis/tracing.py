"""Tracing the lines between the labels of a map of two axes, by batches of runs.

The cells in which labels differ are cut into triangles. Where the ends of an edge differ, a crossing is located
(`clunk.analysis.brackets`); a third label in between becomes a node, and a triangle of three labels has a triple point.
Where a line is further from its chord than `CHORD`, further crossings are located within the triangle.

Regions thinner than a cell are looked for along the lines on which the number of touches changes: such a region begins
where a touch appears, and so lies on one side of that line, however thin it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from clunk.analysis.brackets import POINT, TOLERANCE, Codes, Floats, Points, narrow
from clunk.analysis.network import Segments
from clunk.analysis.pointruns import RUN, RUN_FIELDS, Runs
from clunk.analysis.triangles import Nodes, Triangles, ends_of, keys_of
from clunk.core.exact.run import MOST
from clunk.results.labels import FAILED_CODE

CHORD = 1e-4  # of the map, that a line may be off its chord
_THINNEST = 1e-6  # of the map, a region that is looked for where touches change
_NEARER = np.append(
    1 / np.array([64, 16, 8, 4, 2]), 1.0 - 0.5 ** np.array([2, 4, 8, 14, 20, 26])
)  # of a way to a corner
_SHARP = 1e-13, 1e-7  # of the map and of a triangle, crossings from which a triple point follows
_SETTLED = 1e-10  # of the map, by which a triple point moves at last
_NEEDLE = 5e-8  # of the map, a triangle so narrow that its crossings tell where lines meet, and no directions
_RADII = 1e-7, 1e-8  # of the map, of circles around a junction: the smaller they are, the straighter lines leave them
_SHARPER = 1e-3  # of a circle's radius, crossings on it
_ANGLES = np.arange(16) * np.pi / 8 + 0.1
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_PARALLEL = 1e-12  # determinant of the equations of lines that have no point in common
_MOST_STEPS = 12  # towards a triple point, 5 as a rule
_MOST_ROUNDS = 12  # of new nodes
_TOUCHES = 2  # by which neighbours differ, where no margin is known
_AROUND = np.array([0.9, 1.02])  # of the way to where a margin is expected to be zero, the next points
_STAYS = 0.8, 2.0  # times itself, a margin that comes to no zero: a boundary passes by
_STEEPER = 2.0  # than between known values, as the margin may fall between them

Run = Callable[[Floats], Runs]  # of points (n, 2), on each axis from 0 to 1


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
        low, high = located(self.run, positions[first], positions[second], runs[first], runs[second])
        lengths = np.hypot(*(positions[second] - positions[first]).T)
        order = np.lexsort((low["value"], low["cell"]))
        low, high = low[order], high[order]
        edges, begins, counts = np.unique(low["cell"], return_index=True, return_counts=True)
        begin, rest = ends_of(keys[edges])
        shares = np.stack([low["value"], high["value"]], axis=1) / lengths[low["cell"]][:, None]
        steps = positions[second] - positions[first]
        ends = positions[first[low["cell"]], None] + shares[..., None] * steps[low["cell"], None]
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
                self.triangles.add(keys_of(begin, rest)[several], between, _as_runs(high[next_]))
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
            for radius in _RADII:
                points = sharpened(self.run, points, radius)
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


def located(
    run: Run, low: Floats, high: Floats, below: Runs, above: Runs, tolerance: float = TOLERANCE
) -> tuple[Points, Points]:
    """Narrow brackets on straight lines between points (n, 2) of different labels, by default to 1e-9 of each axis.

    below, above : (n,) runs at these points

    The points that come back have the line's number as their cell, and the distance from its first end as their value.
    """
    lengths = np.hypot(*(high - low).T)
    steps = np.divide(high - low, lengths[:, None], out=np.zeros_like(low), where=lengths[:, None] > 0.0)

    def run_at(lines: Codes, distances: Floats) -> Points:
        return _points(lines, distances, run(low[lines] + distances[:, None] * steps[lines]))

    lines = np.arange(lengths.size)
    begin, end = _points(lines, np.zeros(lines.size), below), _points(lines, lengths, above)
    return narrow(begin, end, run_at, tolerance=tolerance)


def _points(lines: Codes, distances: Floats, runs: Runs) -> Points:
    points = np.zeros(lines.size, POINT)
    points["cell"], points["value"] = lines, distances
    for name in RUN_FIELDS:
        points[name] = runs[name]
    return points


def _as_runs(points: Points) -> Runs:
    runs = np.zeros(points.size, RUN)
    for name in RUN_FIELDS:
        runs[name] = points[name]
    return runs


def triple_points(run: Run, corners: Floats, labels: Codes, crossings: Floats) -> Floats:
    """Points (n, 2) at which the three labels of triangles meet.

    On the way from a guess to the corners are points of the same labels, and between these crossings. Lines through
    two crossings of each pair of labels, these and earlier ones, meet in the next guess; so often that the lines are
    short and straight. A pair that a fourth label parts is left out: where two boundaries cross, they are two lines.

    corners : (n, 3, 2)
    labels : (n, 3)
    crossings : (n, 3, 2), on the way from each corner to the next one
    """
    corners, crossings, every = corners.copy(), crossings.copy(), np.arange(len(corners))
    after = np.roll(crossings, -1, axis=1)
    apart = np.hypot(*np.moveaxis(after - crossings, 2, 0))
    guess: Floats = 0.5 * (crossings + after)[every, np.argmin(apart, axis=1)]  # in a needle they meet near its tip
    active = every[apart.min(axis=1) > _NEEDLE]
    for _ in range(_MOST_STEPS):
        # on the way to each corner, the nearest points from which on the label is the corner's
        ways = corners[active] - guess[active, None]
        places = guess[active, None, None] + ways[:, :, None] * _NEARER[:, None]
        runs = run(places.reshape(-1, 2)).reshape(places.shape[:3])
        fits = (runs["outcome"] == labels[active][..., None]).all(axis=1)
        nearest = np.argmax(np.cumprod(fits[:, ::-1], axis=1)[:, ::-1], axis=1)
        able = fits[:, -1]
        active, nearest, places, runs = active[able], nearest[able], places[able], runs[able]
        if not active.size:
            break
        nearer = places[np.arange(active.size), :, nearest]
        corner_runs = runs[np.arange(active.size), :, nearest]
        begin, end = nearer.reshape(-1, 2), np.roll(nearer, -1, axis=1).reshape(-1, 2)
        pairs = corner_runs.ravel(), np.roll(corner_runs, -1, axis=1).ravel()
        way = end - begin
        low, high = located(run, begin, end, *pairs, max(_SHARP[0], _SHARP[1] * np.hypot(*way.T).max()))
        _, first, counts = np.unique(low["cell"], return_index=True, return_counts=True)
        middle = 0.5 * (low["value"] + high["value"])[first] / np.maximum(np.hypot(*way.T), 1e-300)
        new = (begin + middle[:, None] * way).reshape(-1, 3, 2)
        single = (counts == 1).reshape(-1, 3)
        along = new - crossings[active]
        lengths = np.hypot(along[..., 0], along[..., 1])
        normal = np.stack([-along[..., 1], along[..., 0]], 2) / np.maximum(lengths, 1e-300)[..., None]
        weights = single & (lengths > TOLERANCE)
        matrix = np.einsum("nk,nki,nkj->nij", weights, normal, normal)
        right = np.einsum("nk,nki,nkj,nkj->ni", weights, normal, normal, new)
        solvable = (weights.sum(axis=1) >= 2) & (np.linalg.det(matrix) > _PARALLEL)
        # where the third label is between two, it ends elsewhere
        opposite = np.roll(labels[active], -2, axis=1).ravel()[low["cell"]]
        is_around = np.ones(single.shape, bool)
        is_around.ravel()[low["cell"][low["outcome"] == opposite]] = False
        around = is_around.all(axis=1)
        corners[active[around]], crossings[active[around]] = nearer[around], new[around]
        at_once = single & (lengths <= 0.01 * TOLERANCE)  # a crossing that stays where it is: the lines end there
        rests = at_once.any(axis=1)
        matrix[rests], right[rests] = np.eye(2), new[rests, np.argmax(at_once[rests], axis=1)]
        solvable |= rests
        active = active[solvable]
        solution = np.clip(np.linalg.solve(matrix[solvable], right[solvable][..., None])[..., 0], 0.0, 1.0)
        moved = np.abs(solution - guess[active]).max(axis=1)
        guess[active] = solution
        active = active[moved > _SETTLED]
    return guess


def sharpened(run: Run, points: Floats, radius: float) -> Floats:
    """The points (n, 2), within the map where the lines meet that leave two circles around each of them.

    A junction of four labels is found in needles as narrow as crossings are sharp, whose directions say nothing.
    """
    points, size = points.copy(), len(_DIRECTIONS)
    inside = np.flatnonzero((np.abs(points - 0.5) < 0.5 - radius).all(axis=1))
    circles = points[inside, None, None] + np.array([radius, 0.25 * radius])[:, None, None] * _DIRECTIONS
    runs = run(circles.reshape(-1, 2)).reshape(circles.shape[:3])
    at = np.flatnonzero(runs["outcome"] != np.roll(runs["outcome"], -1, axis=2))
    after = np.where(at % size == size - 1, at + 1 - size, at + 1)
    begin, end = circles.reshape(-1, 2)[at], circles.reshape(-1, 2)[after]
    low, high = located(run, begin, end, runs.ravel()[at], runs.ravel()[after], _SHARPER * radius)
    cell = low["cell"]
    share = 0.5 * (low["value"] + high["value"]) / np.hypot(*(end - begin).T)[cell]
    crossings = begin[cell] + share[:, None] * (end - begin)[cell]
    circle, lines = at[cell] // size, np.stack([low["outcome"], high["outcome"]], axis=1)
    for k, point in enumerate(inside.tolist()):
        outer, inner = (np.flatnonzero(circle == number) for number in (2 * k, 2 * k + 1))
        outer, inner = (each[np.lexsort(lines[each].T)] for each in (outer, inner))
        if 2 < outer.size == inner.size and (lines[outer] == lines[inner]).all():
            along = crossings[inner] - crossings[outer]
            normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
            points[point] = np.linalg.lstsq(normal, (normal * crossings[inner]).sum(axis=1), rcond=None)[0]
    return points


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
        low, high = located(run, middles[clear, 0], middles[clear, 1], *runs[clear].T)
        lines, counts = np.unique(low["cell"], return_counts=True)
        single = np.zeros(len(middles), bool)
        single[np.flatnonzero(clear)[lines[counts == 1]]] = True
        asks = np.zeros(int((~single).sum()), _ASKED)
        asks["cell"], asks["run"] = segment[~single], runs[~single, 1]
        asks["x"], asks["y"] = middles[~single, 1].T
        asked.append(asks)
        order = np.argsort(low["cell"], kind="stable")
        keep = order[np.repeat(counts == 1, counts)]
        begin, end = (middles[clear][low["cell"][keep], k] for k in (0, 1))
        distance = 0.5 * (low["value"] + high["value"])[keep]
        line = np.hypot(*(end - begin).T)
        found = begin + (distance / line)[:, None] * (end - begin)
        segment, ends, sides, shares, middles = (part[single] for part in (segment, ends, sides, shares, middles))
        chord = ends[:, 1] - ends[:, 0]
        aside = np.abs(chord[:, 0] * (found - ends[:, 0])[:, 1] - chord[:, 1] * (found - ends[:, 0])[:, 0])
        off = aside > CHORD * np.hypot(*chord.T)  # not where a region is thinner than that
        found = found[off]
        segment, ends, sides, shares, middles = (part[off] for part in (segment, ends, sides, shares, middles))
        middle_share = shares.mean(axis=1)
        points.append((found, segment, middle_share))
        ends = np.concatenate([np.stack([ends[:, 0], found], 1), np.stack([found, ends[:, 1]], 1)])
        sides = np.concatenate([np.stack([sides[:, 0], middles], 1), np.stack([middles, sides[:, 1]], 1)])
        shares = np.concatenate([np.stack([shares[:, 0], middle_share], 1), np.stack([middle_share, shares[:, 1]], 1)])
        segment = np.tile(segment, 2)
    located_points, owner, share = (np.concatenate(part) for part in zip(*points, strict=True))
    return located_points, owner, share, np.concatenate(asked)


def hidden(run: Run, triangles: Triangles) -> tuple[Codes, Floats, Runs]:
    """Nodes of another label on edges whose ends have one: keys of the edges, positions (n, 2), runs.

    A region thinner than a cell begins where the margin falls to zero. Where it falls towards a node, so that it may be
    zero before the next one, and is not small there, its zero is closed in on: from points at which it still falls, by
    the line through the last two, and points beyond. Without margins that is done with jumps of the touches by two.
    """
    nodes, margin = triangles.runs, triangles.runs["measure"]
    first, second, slope = _suspects(*(nodes[name].reshape(triangles.shape) for name in RUN_FIELDS))
    begin, size, count = triangles.positions[first], np.abs(margin[first]), nodes["touches"][first]
    step, sign = triangles.positions[second] - begin, np.sign(margin[first])
    label, keys = triangles.outcome[first], keys_of(first, second)
    edges, low, high = np.arange(first.size), np.zeros(first.size), np.ones(first.size)
    new: list[tuple[Codes, Floats, Runs]] = [(keys[:0], np.zeros((0, 2)), nodes[:0])]
    thinnest = _THINNEST / np.hypot(*step.T)
    while edges.size:
        with np.errstate(invalid="ignore", divide="ignore"):
            ahead = size / slope
        close = (ahead > 0.0) & (low + ahead < high)
        ahead = np.where(close, ahead, 0.5 * (high - low))
        around = _AROUND if (low > 0.0).any() or (high < 1.0).any() else _AROUND[:1]  # at first one for each of many
        shares = low[:, None] + ahead[:, None] * around
        shares[:, 1:] = np.minimum(shares[:, 1:], 0.5 * (shares[:, :1] + high[:, None]))
        places = begin[edges, None] + shares[..., None] * step[edges, None]
        runs = run(places.reshape(-1, 2)).reshape(shares.shape)
        others = runs["outcome"] != label[edges, None]
        shows, at = others.any(axis=1), np.argmax(others, axis=1)
        new.append((keys[edges[shows]], places[shows, at[shows]], runs[shows, at[shows]]))
        left = sign[edges] * runs["measure"][:, 0] / size  # of the margin
        goes_on = ~shows & ~((_STAYS[0] < left) & (left < _STAYS[1]))
        alike = runs["touches"] == count[edges, None]
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
