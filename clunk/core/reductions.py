"""Linear chains: their matrices, and the coordinates in which a constraint on q leaves them free."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.tables import INPUTS, TORQUE

FloatArray = npt.NDArray[np.float64]

_FITS = 1e-9  # a rate across a lash, relative to those of its ends, that is rounding


def chain(
    inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, load: FloatArray, driven: int = INPUTS
) -> tuple[FloatArray, FloatArray]:
    """A and B of M θ'' + C θ' + K θ = b T, where B has `driven` columns; of one driveline, or of each of a batch."""
    *batch, n = inertia.shape
    rates, inputs = np.zeros((*batch, 2 * n, 2 * n)), np.zeros((*batch, 2 * n, driven))
    rates[..., :n, n:] = np.eye(n)
    rates[..., n:, :n] = -stiffness / inertia[..., None]
    rates[..., n:, n:] = -damping / inertia[..., None]
    inputs[..., n:, TORQUE] = load / inertia
    return rates, inputs


def locked(
    rates: FloatArray, inputs: FloatArray, inertia: FloatArray, lashes: FloatArray, closed: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """A and B with q' = 0 of the closed lashes as true constraints: inertias that they tie move in a fixed ratio.

    Without gear ratios such inertias share one acceleration, to the last bit.

    lashes : (L, n) float64
        q = row · θ.
    closed : (L,) of int
        Whether each is.
    """
    n = inertia.shape[-1]
    rates, inputs = rates.copy(), inputs.copy()
    basis = constrained(lashes, closed).expand[:n]
    for matrix in (rates, inputs):
        matrix[..., n:, :][..., ~basis.any(axis=1), :] = 0.0  # tied to ground
        for column in basis[:, : basis.shape[1] // 2].T:
            tied = np.flatnonzero(column)
            if tied.size > 1:
                motion, inertias = column[tied], inertia[..., tied]
                torques = (inertias * motion)[..., None, :] @ matrix.take(n + tied, axis=-2)
                together = np.sum(inertias * motion**2, axis=-1)[..., None, None]
                matrix[..., n + tied, :] = motion[:, None] * (torques / together)
    return rates, inputs


class Reduction(NamedTuple):
    """Coordinates y in which a flow has no constraint: (θ, θ') = expand y + shift (s φ/2) and y = pick (θ, θ').

    There is a column of shift, and an s φ/2, for each lash.
    """

    expand: FloatArray
    pick: FloatArray
    shift: FloatArray


def with_wave(reduction: Reduction, states: int) -> Reduction:
    """A reduction of a system with `states` of a wave more, which nothing constrains."""
    expand, pick = (
        np.block([[matrix, np.zeros((matrix.shape[0], states))], [np.zeros((states, matrix.shape[1])), np.eye(states)]])
        for matrix in (reduction.expand, reduction.pick)
    )
    return Reduction(expand, pick, np.vstack([reduction.shift, np.zeros((states, reduction.shift.shape[1]))]))


def constrained(lashes: FloatArray, closed: Sequence[int]) -> Reduction:
    """Without the angle of one inertia at each closed lash, which q = s φ/2 and q' = 0 give.

    It is the last of those that turn as q does, not through the gear ratio: q' is then zero to the last bit. Of the
    rows of `expand`, none has more than one entry for the angles. A lash that the others lock adds nothing.

    lashes, closed : as for `locked`
    """
    n = lashes.shape[1]
    basis: FloatArray = np.eye(n)
    pick: FloatArray = np.eye(n)
    shift = np.zeros((2 * n, len(lashes)))
    for k in np.flatnonzero(closed):
        row = lashes[k] @ basis
        row[np.abs(row) <= _FITS * np.abs(lashes[k]).max()] = 0.0
        ends = np.flatnonzero(row)
        if not ends.size:
            continue
        plain = ends[np.abs(row[ends]) == 1.0]
        pivot = int(plain[-1] if plain.size else ends[-1])
        offset = -lashes[k] @ shift[:n]
        offset[k] += 1.0
        shift[:n] += basis[:, pivot, None] * (offset / row[pivot])
        one: FloatArray = np.eye(row.size)
        one[pivot] = -row / row[pivot]
        basis = basis @ np.delete(one, pivot, axis=1)
        pick = np.delete(pick, pivot, axis=0)
    both: FloatArray = np.eye(2)
    return Reduction(np.kron(both, basis).astype(np.float64), np.kron(both, pick).astype(np.float64), shift)


def without_drift(reduction: Reduction, drift: FloatArray) -> Reduction:
    """The same coordinates, relative to some that are left out: as many as there are states that nothing depends on.

    drift : (N, D) float64, these states; each is zero where the others are not
    """
    if not drift.size:
        return reduction
    along = reduction.pick @ drift
    size, columns = along.shape
    pivots = np.abs(along).argmax(axis=0)
    every: FloatArray = np.eye(size)
    relative = every - along / along[pivots, np.arange(columns)] @ every[pivots]
    pick = np.delete(relative, pivots, axis=0) @ reduction.pick
    return Reduction(np.delete(reduction.expand, pivots, axis=1), pick, reduction.shift)
