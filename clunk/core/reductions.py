"""Matrices of linear chains, and coordinates of a chain that satisfy the constraints of locked lashes and frictions.

Arrays have the shape given here for one driveline, and one more axis in front for a batch.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.batches import alike

_FITS = 1e-9  # share of the largest entry of a lash's row: a smaller entry of the row in free coordinates is rounding
_ROUNDING = 1e-12  # share of the magnitudes of a product's terms: a smaller product is rounding


def chain(inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, wave: int = 0) -> FloatArray:
    """State matrix A, in (θ, θ'), of M θ'' + C θ' + K θ = …; of one driveline, or of each of a batch.

    Behind θ and θ' it has `wave` more rows and columns, which are zero, for the states of a load's wave.
    """
    *batch, n = inertia.shape
    rates = np.zeros((*batch, 2 * n + wave, 2 * n + wave))
    rates[..., :n, n : 2 * n] = np.eye(n)
    rates[..., n : 2 * n, : 2 * n] = -np.concatenate([stiffness, damping], axis=-1) / inertia[..., None]
    return rates


def locked(matrix: FloatArray, inertia: FloatArray, ties: FloatArray) -> FloatArray:
    """A or B under the constraints q' = 0 of locked lashes and frictions: inertias that they tie move in a fixed ratio.

    Without gear ratios, tied inertias have the same acceleration, to the last bit.

    ties : `Reduction.expand` of these constraints
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

    The columns of shift multiply s φ/2 of each lash, and then the twist at which each friction sticks.
    """

    expand: FloatArray  # (2n, 2m)  where m angles are left
    pick: FloatArray  # (2m, 2n)
    shift: FloatArray  # (2n, L + M)


def constrained(lashes: FloatArray, closed: Sequence[int]) -> Reduction:
    """Coordinates that leave out one angle for each closed lash and stuck friction, whose constraint determines it.

    The constraint of a closed lash is q = s φ/2 and q' = 0. The angle left out is that of the last inertia that turns
    as q does, not through the gear ratio: q' is then zero to the last bit. No row of `expand` has more than one entry
    for the angles. A lash that the constraints before it lock already adds no constraint.

    lashes : (L, n) float64
        q = row · θ; frictions, with the twist in place of q, are further rows.
    closed : (L,) of int
        Whether each lash is closed, or each friction sticks.
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
        elimination = np.tile(np.eye(row.shape[-1]), (*batch, 1, 1))
        elimination[..., pivot, :] = -row / row[..., pivot, None]
        basis = basis @ np.delete(elimination, pivot, axis=-1)
        pick = np.delete(pick, pivot, axis=0)
    # once for the angles, and once for the speeds
    expand, pick = (np.asarray(np.kron(np.eye(2), matrix), np.float64) for matrix in (basis, pick))
    return Reduction(expand, pick, shift)


def product(one: FloatArray, other: FloatArray, rounding: float = _ROUNDING) -> FloatArray:
    """Matrix product whose entries of rounding, at most a share `rounding` of their terms' magnitudes, are set to 0."""
    result = one @ other
    result[abs(result) <= rounding * (abs(one) @ abs(other))] = 0.0
    return result
