"""Networks of curves: segments linked to curves from junction to junction, and the rings around the regions between.

Positions are on each axis from 0 to 1. A junction is a triple point, or where a curve ends on the frame of the map.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from clunk.analysis.triangles import cross
from clunk.results.boundaries import NO_LABEL
from clunk.study.arrays import Codes, Floats, LabelCodes

SAME = 1e-6  # of the map: triple points within this distance of each other are one junction
_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


class Path(NamedTuple):
    """A curve: codes of the labels on its left and right, the lesser on the left, its nodes, and a vertex for each."""

    left: int
    right: int
    nodes: list[int]
    vertices: Floats


class Ring(NamedTuple):
    """A closed polygon with a label on its left: anticlockwise around it, or clockwise, as a hole in it."""

    label: int
    vertices: Floats
    area: float


def paths_of(ends: Codes, labels: Codes, position: Callable[[Codes], Floats]) -> list[Path]:
    """Link segments, pieces of lines that lie in a triangle each, to curves.

    ends : (n, 2) nodes at which segments begin and end: keys of edges, or -1 minus the number of a triple point
    labels : (n, 2) codes of the labels on the left and on the right
    position : returns the positions of nodes
    """
    begin, end = np.where(labels[:, 0] > labels[:, 1], ends.T[::-1], ends.T).tolist()
    left, right = np.sort(labels, axis=1).T.tolist()
    after = {node: k for k, node in enumerate(begin) if node >= 0}
    reached = {node for node in end if node >= 0}
    order = sorted(range(len(begin)), key=lambda k: begin[k] >= 0 and begin[k] in reached)  # closed curves last
    seen = [False] * len(begin)
    paths = []
    for first in order:
        if seen[first]:
            continue
        nodes, following = [begin[first]], first
        while not seen[following]:
            seen[following] = True
            nodes.append(end[following])
            following = after.get(end[following], following)
        paths.append(Path(left[first], right[first], nodes, position(np.array(nodes))))
    return paths


def junctions_of(points: Floats, labels: Codes) -> tuple[Floats, LabelCodes]:
    """Merge triple points (n, 2) with labels (n, 3) that are at the same place into junctions, (m, 2).

    Also returns the labels of each junction: rows of ascending codes, filled up with `NO_LABEL`, (m, 3 or more).
    """
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    tree = KDTree(points)
    _, place = connected_components(tree.sparse_distance_matrix(tree, SAME, p=np.inf))
    met = np.unique(np.column_stack([place.repeat(3), labels.ravel()]), axis=0)
    counts = np.bincount(met[:, 0])
    codes = np.full((counts.size, counts.max(initial=3)), NO_LABEL, np.int16)
    codes[np.arange(codes.shape[1]) < counts[:, None]] = met[:, 1]
    at = points[np.unique(place, return_index=True)[1]]
    order = np.lexsort(at.T[::-1])
    return at[order], codes[order]


def rings_of(paths: list[Path], corner: int) -> list[Ring]:
    """Rings around the regions; corner : label of the map's first corner, for a frame on which no curve ends."""
    rings = []
    starts = {}  # junction and label on the left -> path, and whether it is followed forward
    on_frame: dict[int, float] = {}
    for k, path in enumerate(paths):
        first, last = path.nodes[0], path.nodes[-1]
        if first == last:
            rings += [_ring(path.left, path.vertices), _ring(path.right, path.vertices[::-1])]
            continue
        starts[first, path.left], starts[last, path.right] = (k, True), (k, False)
        on_frame |= {node: _along_frame(path.vertices[end]) for node, end in ((first, 0), (last, -1)) if node >= 0}
    around = sorted(on_frame, key=on_frame.__getitem__)
    if not around:
        rings.append(_ring(corner, np.vstack([_CORNERS, _CORNERS[:1]])))
    following = dict(zip(around, around[1:] + around[:1], strict=True))
    while starts:
        node, label = next(iter(starts))
        points = []
        while (node, label) in starts:
            k, forward = starts.pop((node, label))
            path = paths[k]
            points.append(path.vertices if forward else path.vertices[::-1])
            node = path.nodes[-1 if forward else 0]
            if node in following:
                points.append(_corners_between(on_frame[node], on_frame[following[node]]))
                node = following[node]
        vertices = np.concatenate([*points, points[0][:1]])
        repeated = (vertices[1:] == vertices[:-1]).all(axis=1)
        rings.append(_ring(label, vertices[np.append(True, ~repeated)]))
    return rings


def regions_of(rings: list[Ring]) -> list[list[Ring]]:
    """Regions: each an outer ring and its holes, by label and falling area."""
    outer = sorted((ring for ring in rings if ring.area > 0.0), key=lambda ring: (ring.label, -ring.area))
    regions = [[ring] for ring in outer]
    low, high = (np.array([end(ring.vertices, axis=0) for ring in outer]) for end in (np.min, np.max))
    for hole in (ring for ring in rings if ring.area <= 0.0):
        place = hole.vertices[0]
        near = np.flatnonzero(((low <= place) & (place <= high)).all(axis=1))
        around = [regions[k] for k in near if outer[k].label == hole.label and _goes_around(outer[k].vertices - place)]
        if around:
            min(around, key=lambda region: region[0].area).append(hole)
    return regions


def _ring(label: int, vertices: Floats) -> Ring:
    places = vertices - vertices[0]
    return Ring(label, vertices, 0.5 * cross(places[:-1], places[1:]).sum())


def _goes_around(vertices: Floats) -> bool:
    """Whether a closed polygon goes around the origin: seen from there it turns by 2π, or by 0."""
    seen = vertices @ [1.0, 1.0j]
    return abs(np.angle(seen[1:] * seen[:-1].conj()).sum()) > np.pi


def _along_frame(point: Floats) -> float:
    """Distance along the frame from its first corner, anticlockwise, to a point on it: from 0 to 4."""
    x, y = point.tolist()
    if y == 0.0:
        return x
    return 1.0 + y if x == 1.0 else 3.0 - x if y == 1.0 else 4.0 - y


def _corners_between(begin: float, end: float) -> Floats:
    """Corners of the frame between two distances along it, anticlockwise."""
    last = end if end > begin else end + 4.0
    return _CORNERS[[corner % 4 for corner in range(1, 9) if begin < corner < last]]
