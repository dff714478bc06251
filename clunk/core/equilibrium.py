"""Steady motion in contact, before the load step: angles and contact torques, each linear in what drives them.

Numbers of drivelines have their usual shape for one, and an axis more in front for each of a batch.
"""

import numpy as np

from clunk.core.arrays import FloatArray

_ROUNDING = 1e-11  # of a torque: a load that does not reach the lash, or a gap that does not load it, leaves as much


def steady_motion(
    stiffness: FloatArray,
    torques: FloatArray,
    lashes: FloatArray,
    gaps: FloatArray,
    momentum: FloatArray,
    compliance: FloatArray | float,
) -> tuple[FloatArray, FloatArray]:
    """Angles θ in steady motion with all lashes closed, and the torque τ across each lash, signed like q.

    K θ + lashesᵀ τ = torques and lashes θ - compliance τ = gaps, for both at once: flanks that are stiff beside the
    shafts are indented by little more than the rounding of angles, which would not tell their torque.

    Parameters
    ----------
    stiffness : (n, n) float64  [N m/rad]
    torques : (n, m) float64
        On the inertias, by each of m inputs, less what drag and inertia take of it.
    lashes : (L, n) float64
        q = row · θ.
    gaps : (L, m) float64
        s φ/2 of each lash, by each of the inputs.
    momentum : (n, 0 or 1) float64
        Of the rigid-body motion: of the angles that differ by it, those are taken that have none of it in sum.
    compliance : (L,) float64, or one for all  [rad/(N m)]
        Of each contact; 0 locks q.

    Returns
    -------
    angles : (n, m) float64
    across : (L, m) float64
    """
    *batch, n, driven = torques.shape
    scale = _largest(stiffness)
    ties = np.concatenate([scale * lashes, scale / _largest(momentum) * momentum.mT], axis=-2)
    size = n + ties.shape[-2]
    matrix = np.zeros((*batch, size, size))
    matrix[..., :n, :n], matrix[..., n:, :n], matrix[..., :n, n:] = stiffness, ties, ties.mT
    of_lashes = np.arange(n, n + lashes.shape[-2])
    matrix[..., of_lashes, of_lashes] = -(scale[..., 0] ** 2) * compliance
    right = np.zeros((*batch, size, driven))
    right[..., :n, :], right[..., of_lashes, :] = torques, scale * gaps
    solution = np.linalg.solve(matrix, right)
    solution += np.linalg.solve(matrix, right - matrix @ solution)  # what rounding left
    across = scale * solution[..., of_lashes, :]
    across[abs(across) <= _ROUNDING * np.where(gaps.any(axis=0), scale, 1.0)] = 0.0
    return solution[..., :n, :], across


def _largest(matrices: FloatArray) -> FloatArray:
    """(…, 1, 1) the largest entry of each matrix; 1 where all are zero."""
    largest = abs(matrices).max(axis=(-2, -1), initial=0.0, keepdims=True)
    return np.where(largest > 0.0, largest, 1.0)
