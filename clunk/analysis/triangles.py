"""Triangles between labelled nodes of a map: where labels differ, and new nodes on edges. No runs, no physics.

A triangle has at most three labels, so its edges tell how its regions meet: two labels are parted by one line from edge
to edge, three meet in a point. Whatever nodes are added, an edge is split in both of its triangles, and the network of
lines stays closed.
"""

from __future__ import annotations

import numpy as np

from clunk.analysis.pointruns import Runs
from clunk.study.arrays import Bools, Codes, Floats, Nodes

_OUTWARD = np.array([[-1], [1]])  # from the first and from the second end of an edge
_STRAIGHT = 1e-12  # of the map: such a cross product is of one line
_SHIFT = 32  # bits of a node's number in an edge's key


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


class Triangles:
    """The triangles of a map's cells in which labels differ, and of such as get a node on an edge.

    positions : (nodes, 2) float64, on each axis from 0 to 1; first those of the map, in C order
    runs : (nodes,) RUN
    corners : (n, 3) nodes, anticlockwise
    """

    def __init__(self, across: Floats, upward: Floats, runs: Runs) -> None:
        self.shape, outcome = runs.shape, runs["outcome"]
        self.positions: Floats = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1).reshape(-1, 2)
        self.runs: Runs = runs.ravel()
        self._before: Nodes = np.arange(self.runs.size)  # numbers of points before nodes, else the nodes'
        self.corners: Nodes = np.zeros((0, 3), np.int64)
        self._is_open: Bools = np.zeros((self.shape[0] - 1, self.shape[1] - 1), bool)
        alike = (outcome[:-1, :-1] == outcome[1:, :-1]) & (outcome[:-1, :-1] == outcome[:-1, 1:])
        self._open(np.argwhere(~(alike & (outcome[:-1, :-1] == outcome[1:, 1:]))))

    def _open(self, cells: Nodes) -> None:
        """Add both triangles of cells (n, 2) that are not there yet."""
        within = ((cells >= 0) & (cells < self._is_open.shape)).all(axis=1)
        cells = np.unique(cells[within], axis=0)
        cells = cells[~self._is_open[tuple(cells.T)]]
        self._is_open[tuple(cells.T)] = True
        a = cells[:, 0] * self.shape[1] + cells[:, 1]
        b, c, d = a + self.shape[1], a + self.shape[1] + 1, a + 1
        self.corners = np.concatenate([self.corners, np.stack([a, b, c], 1), np.stack([a, c, d], 1)])

    @property
    def outcome(self) -> Codes:
        """Code of each node's label, (nodes,)."""
        codes: Codes = self.runs["outcome"]
        return codes

    @property
    def mixed(self) -> Nodes:
        """The triangles whose labels differ: (n, 3) nodes."""
        labels = self.outcome[self.corners]
        differ: Bools = (labels != labels[:, :1]).any(axis=1)
        return self.corners[differ]

    def along(self, first: Nodes, second: Nodes) -> Nodes:
        """Four points on the lines of edges, (n, 4): those nearest to a crossing, and before and behind these the next.

        They are the edge's ends and the next nodes of the map, or once more the ends; or the first end and a point that
        is kept before the second one.
        """
        ends, shape = np.stack([first, second], axis=1), np.array(self.shape)
        way = self.positions[second] - self.positions[first]
        steps = np.sign(way).astype(np.int64)[:, None] * _OUTWARD
        beyond = np.stack(np.divmod(ends, shape[1]), axis=2) + steps
        inside = (ends < shape.prod()) & ((beyond >= 0) & (beyond < shape)).all(axis=2)
        numbers = np.where(inside, beyond @ [shape[1], 1], ends)
        nearest = self._before[second]
        numbers = np.stack([numbers[:, 0], nearest, numbers[:, 1]], axis=1)
        apart = self.positions[numbers] - self.positions[first, None]
        is_straight = np.abs(cross(way[:, None], apart)) < _STRAIGHT
        share = (apart[:, 1] * way).sum(axis=1) / (way * way).sum(axis=1)
        is_between = is_straight[:, 1] & (share > 0.0) & (share < 1.0) & (nearest != second)
        before = np.where(is_straight[:, 0] & ~is_between, numbers[:, 0], first)
        behind = np.where(is_straight[:, 2], numbers[:, 2], second)
        return np.stack([before, np.where(is_between, nearest, first), second, behind], axis=1)

    def keep_before(self, nodes: Nodes, positions: Floats, runs: Runs) -> None:
        """Keep points before nodes on their edges, with no crossing nearer to the edges' ends."""
        self._before[nodes] = self.runs.size + np.arange(nodes.size)
        self._append(positions, runs)

    def _append(self, positions: Floats, runs: Runs) -> None:
        self._before = np.append(self._before, self.runs.size + np.arange(runs.size))
        self.positions = np.concatenate([self.positions, positions])
        self.runs = np.concatenate([self.runs, runs])

    def add(self, keys: Codes, positions: Floats, runs: Runs) -> None:
        """Add a node on each of these edges, of which none comes twice."""
        self._open_beside(keys)
        order = np.argsort(keys)
        middle = np.full(keys.size + 1, -1)  # the last is of edges that stay whole
        middle[:-1] = self.runs.size + order
        keys = keys[order]
        self._append(positions, runs)
        every = keys_of(self.corners, np.roll(self.corners, -1, axis=1))
        at = np.minimum(np.searchsorted(keys, every), keys.size - 1)
        new = middle[np.where(keys[at] == every, at, -1)]  # on the edges behind each corner
        count = (new >= 0).sum(axis=1)
        parts = [self.corners[count == 0]]
        # turned so that of one new node the edge is the first, and of two the whole one is the last
        turns = np.where(count == 1, np.argmax(new >= 0, axis=1), (np.argmax(new < 0, axis=1) + 1) % 3)
        turned = (turns[:, None] + np.arange(3)) % 3
        corners, new = np.take_along_axis(self.corners, turned, 1), np.take_along_axis(new, turned, 1)
        for split, pattern in _PATTERNS.items():
            six = np.concatenate([corners[count == split], new[count == split]], axis=1)
            parts += [six[:, three] for three in pattern]
        self.corners = np.concatenate(parts)

    def _open_beside(self, keys: Codes) -> None:
        """Add the cells beside edges of the map's own nodes."""
        first, second = ends_of(keys)
        grid = second < self.shape[0] * self.shape[1]
        low, high = (np.stack(np.divmod(ends[grid], self.shape[1]), axis=1) for ends in (first, second))
        step = high - low
        straight = step.sum(axis=1) == 1  # of a diagonal the cell is open
        self._open(np.concatenate([low[straight], low[straight] - step[straight][:, ::-1], low[~straight]]))


# Corners 0 to 2, and new nodes 3 to 5 on the edges behind them: triangles by the number of new nodes.
_PATTERNS = {
    1: ([0, 3, 2], [3, 1, 2]),
    2: ([3, 1, 4], [0, 3, 4], [0, 4, 2]),
    3: ([0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]),
}
