"""Steady motion in contact, before the load step: angles and contact torque, per unit of load and gap."""

import numpy as np
import numpy.typing as npt

from clunk.core.reductions import constrained

FloatArray = npt.NDArray[np.float64]


def preload(
    stiffness: FloatArray, load: FloatArray, lashes: FloatArray, momentum: FloatArray, contact: FloatArray | None
) -> FloatArray:
    """Angles in steady motion with all lashes closed, per unit of the load and of each s φ/2: (n, 1 + L).

    load : (n,) float64
        Less what drag and inertia take of it.
    lashes : (L, n) float64
        q = row · θ.
    momentum : (n, 0 or 1) float64
        Of the rigid-body motion: of the angles that differ by it, those are taken that have none of it in sum.
    contact : (L,) float64, optional  [N m/rad]
        Stiffnesses of the contacts; without them q is locked.
    """
    if contact is None:
        n = load.size
        expand, _, shift = (part[:n] for part in constrained(lashes, [1] * len(lashes)))
        basis = expand[:, : expand.shape[1] // 2]
        forces = np.column_stack([load, -stiffness @ shift])
        kept = np.column_stack([np.zeros(momentum.shape[1]), -momentum.T @ shift])
        rest: FloatArray = basis @ _solve(basis.T @ stiffness @ basis, basis.T @ forces, basis.T @ momentum, kept)
        rest[:, 1:] += shift
        return rest
    closed = stiffness
    for lash, contact_stiffness in zip(lashes, contact, strict=True):
        closed = closed + contact_stiffness * lash[:, None] * lash
    forces = np.column_stack([load, *(contact[:, None] * lashes)])
    return _solve(closed, forces, momentum, np.zeros((momentum.shape[1], 1 + len(lashes))))


def _solve(matrix: FloatArray, forces: FloatArray, momentum: FloatArray, kept: FloatArray) -> FloatArray:
    """The angles at which a stiffness matrix balances forces and whose momenta, if there are any, are `kept`."""
    count = momentum.shape[1]
    if not count:
        return np.asarray(np.linalg.solve(matrix, forces), np.float64)
    scale = np.abs(matrix).max(initial=0.0) / np.abs(momentum).max() or 1.0
    bordered = np.block([[matrix, scale * momentum], [scale * momentum.T, np.zeros((count, count))]])
    return np.asarray(np.linalg.solve(bordered, np.vstack([forces, scale * kept]))[: len(matrix)], np.float64)


def contact_torques(
    stiffness: FloatArray, load: FloatArray, lashes: FloatArray, contact: FloatArray | None, angles: FloatArray
) -> FloatArray:
    """The torque across each lash, signed like q, per unit of the load and of each s φ/2: (L, 1 + L).

    Flanks that are stiff beside the shafts are indented by little more than the rounding of angles. So the torques of
    the indentations are put right by what balances the inertias; of lashes side by side, that tells the sum.

    load, lashes, contact : as for `preload`
    angles : (n, 1 + L) float64
    """
    count = len(lashes)
    torques = np.zeros((count, 1 + count))
    if contact is not None:
        torques[:] = contact[:, None] * (lashes @ angles - np.eye(count, 1 + count, 1))
    missing = -stiffness @ angles - lashes.T @ torques
    missing[:, 0] += load
    torques += np.linalg.pinv(lashes.T) @ missing
    # a load that does not reach the lash, or a gap that does not load it, leaves rounding only
    scale = np.full(1 + count, np.abs(stiffness).max(initial=0.0) + 1e-300)
    scale[0] = 1.0
    torques[np.abs(torques) <= 1e-11 * scale] = 0.0
    return torques
