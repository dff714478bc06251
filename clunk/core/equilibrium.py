"""Steady motion in contact, before the load step: angles and contact torque, per unit of load and gap."""

import numpy as np
import numpy.typing as npt

from clunk.core.reductions import constrained

FloatArray = npt.NDArray[np.float64]


def preload(
    stiffness: FloatArray, load: FloatArray, lash: FloatArray, momentum: FloatArray, contact_stiffness: float | None
) -> FloatArray:
    """Angles in steady motion in contact, per unit of (T, s φ/2): (n, 2). Without a contact stiffness q is locked.

    load : (n,) float64
        Less what drag and inertia take of it.
    momentum : (n, 0 or 1) float64
        Of the rigid-body motion: of the angles that differ by it, those are taken that have none of it in sum.
    """
    if contact_stiffness is None:
        n = load.size
        expand, _, shift = (part[:n] for part in constrained(lash))
        basis = expand[:, : n - 1]
        forces = np.column_stack([load, -stiffness @ shift])
        kept = np.column_stack([np.zeros(momentum.shape[1]), -momentum.T @ shift])
        rest: FloatArray = basis @ _solve(basis.T @ stiffness @ basis, basis.T @ forces, basis.T @ momentum, kept)
        rest[:, 1] += shift
        return rest
    closed = stiffness + contact_stiffness * lash[:, None] * lash
    forces = np.column_stack([load, contact_stiffness * lash])
    return _solve(closed, forces, momentum, np.zeros((momentum.shape[1], 2)))


def _solve(matrix: FloatArray, forces: FloatArray, momentum: FloatArray, kept: FloatArray) -> FloatArray:
    """The angles at which a stiffness matrix balances forces and whose momenta, if there are any, are `kept`."""
    count = momentum.shape[1]
    if not count:
        return np.asarray(np.linalg.solve(matrix, forces), np.float64)
    scale = np.abs(matrix).max(initial=0.0) / np.abs(momentum).max() or 1.0
    bordered = np.block([[matrix, scale * momentum], [scale * momentum.T, np.zeros((count, count))]])
    return np.asarray(np.linalg.solve(bordered, np.vstack([forces, scale * kept]))[: len(matrix)], np.float64)


def contact_torque(stiffness: FloatArray, load: FloatArray, lash: FloatArray, preload: FloatArray) -> FloatArray:
    """The torque across the lash, signed like q, per unit of (T, s φ/2): what balances one of its inertias.

    load : as for `preload`
    """
    end = int(np.flatnonzero(lash)[0])
    pull = stiffness[end] @ preload
    torque: FloatArray = (np.array([load[end], 0.0]) - pull) / lash[end]
    # a load that does not reach the lash, or a gap that does not load it, leaves rounding only
    scale = np.array([1.0, np.abs(stiffness).max(initial=0.0) + 1e-300])
    torque[np.abs(torque) <= 1e-11 * scale] = 0.0
    return torque
