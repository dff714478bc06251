"""Linear chains: their matrices, and the coordinates in which a constraint on q leaves them free."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.tables import INPUTS, TORQUE

FloatArray = npt.NDArray[np.float64]


def chain(
    inertia: FloatArray, damping: FloatArray, stiffness: FloatArray, load: FloatArray, driven: int = INPUTS
) -> tuple[FloatArray, FloatArray]:
    """A and B of M θ'' + C θ' + K θ = b T, where B has `driven` columns."""
    n = inertia.size
    rates, inputs = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, driven))
    rates[:n, n:] = np.eye(n)
    rates[n:, :n] = -stiffness / inertia[:, None]
    rates[n:, n:] = -damping / inertia[:, None]
    inputs[n:, TORQUE] = load / inertia
    return rates, inputs


def locked(
    rates: FloatArray, inputs: FloatArray, inertia: FloatArray, lash: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A and B with q' = 0 as a true constraint: the inertias at the lash move in the ratio that leaves q as it is.

    Without a gear ratio they share one acceleration, to the last bit.
    """
    n = inertia.size
    rates, inputs = rates.copy(), inputs.copy()
    ends = np.flatnonzero(lash)
    motion = constrained(lash).expand[ends, : n - 1].sum(axis=1)  # of the ends, where one of them turns by 1
    for matrix in (rates, inputs):
        torques = (inertia[ends] * motion) @ matrix[n + ends]
        matrix[n + ends] = motion[:, None] * (torques / np.sum(inertia[ends] * motion**2)) if ends.size > 1 else 0.0
    return rates, inputs


class Reduction(NamedTuple):
    """Coordinates y in which a flow has no constraint: (θ, θ') = expand y + shift s φ/2 and y = pick (θ, θ')."""

    expand: FloatArray
    pick: FloatArray
    shift: FloatArray


def unconstrained(size: int) -> Reduction:
    """Every coordinate its own."""
    return Reduction(np.eye(size), np.eye(size), np.zeros(size))


def with_wave(reduction: Reduction, states: int) -> Reduction:
    """A reduction of a system with `states` of a wave more, which nothing constrains."""
    expand, pick = (
        np.block([[matrix, np.zeros((matrix.shape[0], states))], [np.zeros((states, matrix.shape[1])), np.eye(states)]])
        for matrix in (reduction.expand, reduction.pick)
    )
    return Reduction(expand, pick, np.concatenate([reduction.shift, np.zeros(states)]))


def constrained(lash: FloatArray) -> Reduction:
    """Without the angle of one inertia at the lash, which q = s φ/2 and q' = 0 give.

    It is the last of those that turn as q does, not through the gear ratio: q' is then zero to the last bit.
    """
    n = lash.size
    ends = np.flatnonzero(lash)
    plain = ends[np.abs(lash[ends]) == 1.0]
    pivot = int(plain[-1] if plain.size else ends[-1])
    basis: FloatArray = np.eye(n)
    basis[pivot] = -lash / lash[pivot]
    basis = np.delete(basis, pivot, axis=1)
    pick = np.delete(np.eye(n), pivot, axis=0)
    shift = np.zeros(2 * n)
    shift[pivot] = 1.0 / lash[pivot]
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
