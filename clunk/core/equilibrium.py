"""Steady motion in contact, before the load step: angles and contact torques, as linear functions of the inputs.

Arrays have the shape given here for one driveline, and one more axis in front for a batch.
"""

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.batches import UnlikeError

# A torque across a lash below this share of the load, or of a gap times the largest stiffness, counts as zero: rounding
# leaves as much of a load that does not reach the lash, or of a gap that does not load it.
_ROUNDING = 1e-11


def steady_motion(
    stiffness: FloatArray,
    torques: FloatArray,
    lashes: FloatArray,
    gaps: FloatArray,
    momentum: FloatArray,
    compliance: FloatArray | float,
) -> tuple[FloatArray, FloatArray]:
    """Angles θ in steady motion with all lashes closed, and the torque τ across each lash, signed like q.

    Solves K θ + lashesᵀ τ = torques and lashes θ - compliance τ = gaps for θ and τ together: flanks much stiffer than
    the shafts are indented by little more than the rounding of angles, from which τ could not be found.

    Parameters
    ----------
    stiffness : (n, n) float64  [N m/rad]
    torques : (n, m) float64
        On the inertias per unit of each of m inputs, less the torques of drag and inertia in the steady motion.
    lashes : (L, n) float64
        q = row · θ.
    gaps : (L, m) float64
        s φ/2 of each lash per unit of each input.
    momentum : (n, 0 or 1) float64
        Of each inertia in the rigid-body motion, if there is one. It makes the angles unique: momentumᵀ θ = 0.
    compliance : (L,) float64, or one for all  [rad/(N m)]
        Of each contact; 0 locks q.

    Returns
    -------
    angles : (n, m) float64
        θ per unit of each input.
    across : (L, m) float64
        τ per unit of each input.

    Raises
    ------
    UnlikeError
        Where a driveline of a batch is held by no more than rounding. When it is alone, its angles are NaN, and its
        torques are 1, so that `switching.preload` answers NO_EQUILIBRIUM, and not NO_INITIAL_FLANK.
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
    try:
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:  # as by gear ratios along a loop that all but fit
        if batch and len(matrix) > 1:
            raise UnlikeError(np.array_split(np.arange(len(matrix)), 2)) from None
        return np.full((*batch, n, driven), np.nan), np.ones((*batch, *gaps.shape))
    solution += np.linalg.solve(matrix, right - matrix @ solution)  # iterative refinement, one step
    across = scale * solution[..., of_lashes, :]
    across[abs(across) <= _ROUNDING * np.where(gaps.any(axis=0), scale, 1.0)] = 0.0
    return solution[..., :n, :], across


def _largest(matrices: FloatArray) -> FloatArray:
    """(…, 1, 1) the largest entry of each matrix; 1 where all are zero."""
    largest = abs(matrices).max(axis=(-2, -1), initial=0.0, keepdims=True)
    return np.where(largest > 0.0, largest, 1.0)
