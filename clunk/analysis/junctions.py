"""Points at which the labels of a map of two axes meet, three of them or, where two boundaries cross, four."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clunk.analysis.brackets import TOLERANCE
from clunk.analysis.crossings import located
from clunk.analysis.searches import Search
from clunk.study.arrays import Bools, Codes, Floats

_NEARER = np.append(
    1 / np.array([64, 16, 8, 4, 2]), 1.0 - 0.5 ** np.array([2, 4, 8, 14, 20, 26])
)  # of a way to a corner
_SHARP = 1e-13, 1e-7  # of the map and of a triangle, crossings from which a triple point follows
_SETTLED = 1e-10  # of the map, by which a triple point moves at last
CLOSE = 1e-6  # of the map, within which a triple point is known from its crossings, or by how little it moves
_NEEDLE = 5e-8  # of the map, a triangle so narrow that its crossings tell where lines meet, and no directions
_RADII = 1e-7, 1e-8  # of the map, of circles around a junction: the smaller they are, the straighter lines leave them
_SHARPER = 2e-4  # of a circle's radius, crossings on it
_ANGLES = np.arange(16) * np.pi / 8 + 0.1
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_RUNS_OF_STEP = 3 * _NEARER.size  # of each triple point
_PARALLEL = 1e-12  # determinant of the equations of lines that have no point in common
_MOST_STEPS = 12  # towards a triple point, 5 as a rule


def triple_points(
    corners: Floats, labels: Codes, crossings: Floats, runs_left: Callable[[], int]
) -> Search[tuple[Floats, Bools]]:
    """Points (n, 2) at which the three labels of triangles meet, and which of them are known (n,).

    On the way from a guess to the corners are points of the same labels, and between these crossings. Lines through
    two crossings of each pair of labels, these and earlier ones, meet in the next guess; so often that the lines are
    short and straight. A pair that a fourth label parts is left out: where two boundaries cross, they are two lines.

    corners : (n, 3, 2)
    labels : (n, 3)
    crossings : (n, 3, 2), on the way from each corner to the next one
    runs_left : how many runs there may be, asked before each batch: the first points get them
    """
    corners, crossings, every = corners.copy(), crossings.copy(), np.arange(len(corners))
    after = np.roll(crossings, -1, axis=1)
    apart = np.hypot(*np.moveaxis(after - crossings, 2, 0))
    guess: Floats = 0.5 * (crossings + after)[every, np.argmin(apart, axis=1)]  # in a needle they meet near its tip
    active = every[apart.min(axis=1) > _NEEDLE]
    is_known = apart.min(axis=1) <= CLOSE
    for _ in range(_MOST_STEPS):
        active = active[: runs_left() // _RUNS_OF_STEP]
        if not active.size:
            break
        # on the way to each corner, the nearest points from which on the label is the corner's
        ways = corners[active] - guess[active, None]
        places = guess[active, None, None] + ways[:, :, None] * _NEARER[:, None]
        runs = (yield places.reshape(-1, 2)).reshape(places.shape[:3])
        fits = (runs["outcome"] == labels[active][..., None]).all(axis=1)
        nearest = np.argmax(np.cumprod(fits[:, ::-1], axis=1)[:, ::-1], axis=1)
        able = fits[:, -1]
        active, nearest, places, runs = active[able], nearest[able], places[able], runs[able]
        if not active.size:
            break
        nearer = places[np.arange(active.size), :, nearest]
        corner_runs = runs[np.arange(active.size), :, nearest]
        begin, end = nearer.reshape(-1, 2), np.roll(nearer, -1, axis=1).reshape(-1, 2)
        pairs = np.stack([corner_runs.ravel(), np.roll(corner_runs, -1, axis=1).ravel()], axis=1)
        sharp = max(_SHARP[0], _SHARP[1] * np.hypot(*(end - begin).T).max())
        ways = yield from located(np.stack([begin, end], 1), pairs, sharp, runs_left=runs_left)
        _, first, counts = np.unique(ways.lines, return_index=True, return_counts=True)
        new, single = ways.places[first].reshape(-1, 3, 2), (counts == 1).reshape(-1, 3)
        along = new - crossings[active]
        lengths = np.hypot(along[..., 0], along[..., 1])
        normal = np.stack([-along[..., 1], along[..., 0]], 2) / np.maximum(lengths, 1e-300)[..., None]
        weights = single & (lengths > TOLERANCE)
        matrix = np.einsum("nk,nki,nkj->nij", weights, normal, normal)
        right = np.einsum("nk,nki,nkj,nkj->ni", weights, normal, normal, new)
        solvable = (weights.sum(axis=1) >= 2) & (np.linalg.det(matrix) > _PARALLEL)
        # where the third label is between two, it ends elsewhere
        opposite = np.roll(labels[active], -2, axis=1).ravel()[ways.lines]
        is_around = np.ones(single.shape, bool)
        is_around.ravel()[ways.lines[ways.runs["outcome"][:, 0] == opposite]] = False
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
        is_known[active] |= moved <= CLOSE
        active = active[moved > _SETTLED]
    for radius in _RADII:
        guess = yield from _sharpened(guess, radius, runs_left)
    return guess, is_known


def have_around(points: Floats, labels: Codes) -> Search[Bools]:
    """Whether close around points (n, 2) runs have all of the labels (n, k)."""
    circles = points[:, None] + _RADII[-1] * _DIRECTIONS
    runs = (yield np.clip(circles, 0.0, 1.0).reshape(-1, 2)).reshape(circles.shape[:2])
    have: Bools = (runs["outcome"][:, None] == labels[..., None]).any(axis=2).all(axis=1)
    return have


def _sharpened(points: Floats, radius: float, runs_left: Callable[[], int]) -> Search[Floats]:
    """The points (n, 2), within the map where the lines meet that leave two circles around each of them.

    A junction of four labels is found in needles as narrow as crossings are sharp, whose directions say nothing.
    """
    points, size = points.copy(), len(_DIRECTIONS)
    inside = np.flatnonzero((np.abs(points - 0.5) < 0.5 - radius).all(axis=1))[: runs_left() // (2 * size)]
    circles = points[inside, None, None] + np.array([radius, 0.25 * radius])[:, None, None] * _DIRECTIONS
    runs = (yield circles.reshape(-1, 2)).reshape(circles.shape[:3])
    at = np.flatnonzero(runs["outcome"] != np.roll(runs["outcome"], -1, axis=2))
    after = np.where(at % size == size - 1, at + 1 - size, at + 1)
    begin, end = circles.reshape(-1, 2)[at], circles.reshape(-1, 2)[after]
    pairs = runs.ravel()[np.stack([at, after], 1)]
    crossings = yield from located(np.stack([begin, end], 1), pairs, _SHARPER * radius, runs_left=runs_left)
    circle, lines, places = at[crossings.lines] // size, crossings.runs["outcome"], crossings.places
    for k, point in enumerate(inside.tolist()):
        outer, inner = (np.flatnonzero(circle == number) for number in (2 * k, 2 * k + 1))
        outer, inner = (each[np.lexsort(lines[each].T)] for each in (outer, inner))
        if 2 < outer.size == inner.size and (lines[outer] == lines[inner]).all():
            along = places[inner] - places[outer]
            normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
            points[point] = np.linalg.lstsq(normal, (normal * places[inner]).sum(axis=1), rcond=None)[0]
    return points
