"""Linear chains: their matrices, and the coordinates in which a constraint on q leaves them free.

Arrays have their shape for one driveline, or an axis more in front for each of a batch.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.batches import alike

_FITS = 1e-9  # a rate across a lash, relative to those of its ends, that is rounding
_ROUNDING = 1e-12  # of the terms of a product


def chain(inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, wave: int = 0) -> FloatArray:
    """A of M θ'' + C θ' + K θ = …; of one driveline, or of each of a batch.

    Behind θ and θ' are `wave` states more, of which nothing is told yet.
    """
    *batch, n = inertia.shape
    rates = np.zeros((*batch, 2 * n + wave, 2 * n + wave))
    rates[..., :n, n : 2 * n] = np.eye(n)
    rates[..., n : 2 * n, : 2 * n] = -np.concatenate([stiffness, damping], axis=-1) / inertia[..., None]
    return rates


def locked(matrix: FloatArray, inertia: FloatArray, ties: FloatArray) -> FloatArray:
    """A or B with q' = 0 of closed lashes as true constraints: inertias that they tie move in a fixed ratio.

    Without gear ratios such inertias share one acceleration, to the last bit.

    ties : `Reduction.expand` of these lashes
    """
    n, left = inertia.shape[-1], ties.shape[-1] // 2
    if left == n:
        return matrix
    matrix, basis = matrix.copy(), ties[..., :n, :left]
    weighed = inertia[..., None] * basis
    together = np.sum(weighed * basis, axis=-2)[..., None]
    matrix[..., n : 2 * n, :] = basis @ (weighed.mT @ matrix[..., n : 2 * n, :] / together)
    return matrix


class Reduction(NamedTuple):
    """Coordinates y in which a flow has no constraint: (θ, θ') = expand y + shift (s φ/2) and y = pick (θ, θ').

    There is a column of shift, and an s φ/2, for each lash; and for each friction, with the twist at which it sticks.
    """

    expand: FloatArray
    pick: FloatArray
    shift: FloatArray


def constrained(lashes: FloatArray, closed: Sequence[int]) -> Reduction:
    """Without the angle of one inertia at each closed lash, which q = s φ/2 and q' = 0 give; so of stuck frictions.

    It is the last of those that turn as q does, not through the gear ratio: q' is then zero to the last bit. Of the
    rows of `expand`, none has more than one entry for the angles. A lash that the others lock adds nothing.

    lashes : (L, n) float64
        q = row · θ.
    closed : (L,) of int
        Whether each is.
    """
    *batch, count, n = lashes.shape
    basis = np.eye(n)
    pick = np.eye(n)
    shift = np.zeros((*batch, 2 * n, count))
    for k in np.flatnonzero(closed):
        lash = lashes[..., k, None, :]
        row = (lash @ basis)[..., 0, :]
        row[abs(row) <= _FITS * abs(lash).max(axis=-1)] = 0.0
        ends = np.flatnonzero(alike(row != 0.0))
        if not ends.size:
            continue
        plain = ends[alike(abs(row[..., ends]) == 1.0)]
        pivot = plain[-1] if plain.size else ends[-1]
        offset = (-lash @ shift[..., :n, :])[..., 0, :]
        offset[..., k] += 1.0
        shift[..., :n, :] += basis[..., pivot, None] * (offset / row[..., pivot, None])[..., None, :]
        one = np.tile(np.eye(row.shape[-1]), (*batch, 1, 1))
        one[..., pivot, :] = -row / row[..., pivot, None]
        basis = basis @ np.delete(one, pivot, axis=-1)
        pick = np.delete(pick, pivot, axis=0)
    # for the angles, and for the speeds
    expand, pick = (np.asarray(np.kron(np.eye(2), matrix), np.float64) for matrix in (basis, pick))
    return Reduction(expand, pick, shift)


def product(one: FloatArray, other: FloatArray, rounding: float = _ROUNDING) -> FloatArray:
    """A product that is zero to the last bit where only rounding is left, a share of its terms."""
    result = one @ other
    result[abs(result) <= rounding * (abs(one) @ abs(other))] = 0.0
    return result
