"""Triangles that cover a map of two axes, with a run at each of their nodes.

An edge is known by its key, a number made of those of its two nodes in either order. Lengths are those of the map's
axes scaled from 0 to 1.
"""

import numpy as np

from clunk.analysis.search import Points
from clunk.study.arrays import Array, Codes, Floats, Nodes

_SHIFT = 32  # bits of a node's number in an edge's key


def keys_of(first: Nodes, second: Nodes) -> Codes:
    """Keys of the edges between pairs of nodes, whichever of the two comes first."""
    return (np.minimum(first, second) << _SHIFT) | np.maximum(first, second)


def ends_of(keys: Codes) -> tuple[Nodes, Nodes]:
    """The two nodes of each edge of these keys, the smaller number first."""
    return keys >> _SHIFT, keys & ((1 << _SHIFT) - 1)


def following(corners: Array) -> Array:
    """The next entry after each one in rows, (n, m, …), such as corners of triangles; after the last, the first."""
    return np.roll(corners, -1, axis=1)


def edges_of(corners: Nodes) -> Codes:
    """Keys of the edges from each node to the next in its row, and from the last to the first, (n, m)."""
    return keys_of(corners, following(corners))


def cross(one: Floats, other: Floats) -> Floats:
    """Cross products of vectors, (..., 2) each."""
    return one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]


def length_of(vectors: Floats) -> Floats:
    """Lengths of vectors, (..., 2)."""
    return np.hypot(vectors[..., 0], vectors[..., 1])


def height_of(corners: Floats) -> Floats:
    """The least height of each triangle, (n,), by the positions of the corners, (n, 3, 2)."""
    sides = following(corners) - corners
    return abs(cross(sides[:, 0], sides[:, 1])) / length_of(sides).max(axis=1)


def _append(rows: Array, more: Array) -> None:
    """Append rows to an array in place; no other array may be a view of it.

    Nodes are added a few at a time: to copy all rows of a large map each time takes a fifth of the time of tracing it.
    """
    count = len(rows)
    rows.resize((count + len(more), *rows.shape[1:]), refcheck=False)
    rows[count:] = more


class Triangles:
    """Triangles of a map: two in each cell, which are halved where nodes are added on their edges.

    positions, runs : of the nodes, (nodes, 2) float64, on each axis from 0 to 1, and (nodes,) POINT; the nodes of the
        map come first, in C order
    corners : (n, 3) nodes, anticlockwise
    is_new : (n,) whether a triangle was added since this was last cleared
    """

    def __init__(self, across: Floats, upward: Floats, runs: Points) -> None:
        self.positions = np.stack(np.meshgrid(across, upward, indexing="ij"), axis=-1).reshape(-1, 2).copy()
        self.runs = runs.flatten()
        self.nodes = np.arange(runs.size).reshape(runs.shape)  # numbers of the map's nodes, in its shape
        a, b, c, d = self.nodes[:-1, :-1], self.nodes[1:, :-1], self.nodes[1:, 1:], self.nodes[:-1, 1:]
        self.corners = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).copy()
        self.is_new = np.ones(len(self.corners), bool)

    @property
    def outcome(self) -> Codes:
        """Code of each node's label, (nodes,)."""
        return self.runs["outcome"]

    def mixed(self, *, only_new: bool = False) -> tuple[Nodes, Nodes]:
        """Triangles of two labels, the corner of the single label first, and triangles of three: (n, 3) nodes each."""
        corners = self.corners[self.is_new] if only_new else self.corners
        one, other, third = self.outcome[corners].T
        corners = corners[(one != other) | (other != third)]  # few of the triangles of a large map
        labels = self.outcome[corners]
        alike = labels == following(labels)
        two = alike.any(axis=1)
        turns = (alike[two].argmax(axis=1)[:, None] + [2, 3, 4]) % 3
        return np.take_along_axis(corners[two], turns, 1), corners[~two]

    def add(self, keys: Codes, positions: Floats, runs: Points) -> None:
        """Add a node on each edge of these keys, of which none comes twice, and halve the triangles there."""
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
        """Halve each triangle that has one of some nodes on an edge, at that node; returns the numbers of all halves.

        near : numbers of the triangles
        keys, nodes : edges, ascending, and the node on each
        """
        corners = self.corners[near]
        edges = edges_of(corners)
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
