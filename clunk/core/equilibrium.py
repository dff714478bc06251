"""Steady motion in contact, before the load step: angles and contact torque, per unit of load and gap.

Numbers of drivelines have their usual shape for one, and an axis more in front for each of a batch.
"""

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
        n = load.shape[-1]
        expand, _, shift = (part[..., :n, :] for part in constrained(lashes, [1] * lashes.shape[-2]))
        basis = expand[..., : expand.shape[-1] // 2]
        across = np.swapaxes(basis, -1, -2)
        forces = _beside(load, -stiffness @ shift)
        momenta = -np.swapaxes(momentum, -1, -2) @ shift
        kept = _beside(np.zeros(momenta.shape[:-1]), momenta)
        rest: FloatArray = basis @ _solve(across @ stiffness @ basis, across @ forces, across @ momentum, kept)
        rest[..., 1:] += shift
        return rest
    closed = stiffness
    for k, lash in enumerate(np.moveaxis(lashes, -2, 0)):
        closed = closed + contact[..., k, None, None] * lash[..., :, None] * lash[..., None, :]
    forces = _beside(load, np.swapaxes(contact[..., None] * lashes, -1, -2))
    return _solve(closed, forces, momentum, np.zeros((*forces.shape[:-2], momentum.shape[-1], 1 + lashes.shape[-2])))


def _beside(column: FloatArray, columns: FloatArray) -> FloatArray:
    """A column in front of others."""
    return np.concatenate([np.broadcast_to(column, columns.shape[:-1])[..., None], columns], axis=-1)


def _solve(matrix: FloatArray, forces: FloatArray, momentum: FloatArray, kept: FloatArray) -> FloatArray:
    """The angles at which a stiffness matrix balances forces and whose momenta, if there are any, are `kept`."""
    n, count = momentum.shape[-2:]
    if not count:
        return np.asarray(np.linalg.solve(matrix, forces), np.float64)
    scale = _largest(matrix) / _largest(momentum)
    scale = np.where(scale > 0.0, scale, 1.0)[..., None, None]
    bordered = np.zeros((*matrix.shape[:-2], n + count, n + count))
    bordered[..., :n, :n], bordered[..., :n, n:] = matrix, scale * momentum
    bordered[..., n:, :n] = scale * np.swapaxes(momentum, -1, -2)
    right = np.concatenate([forces, scale * kept], axis=-2)
    return np.asarray(np.linalg.solve(bordered, right)[..., :n, :], np.float64)


def _largest(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.abs(matrices).max(axis=(-2, -1), initial=0.0))


def contact_torques(
    stiffness: FloatArray, load: FloatArray, lashes: FloatArray, contact: FloatArray | None, angles: FloatArray
) -> FloatArray:
    """The torque across each lash, signed like q, per unit of the load and of each s φ/2: (L, 1 + L).

    Flanks that are stiff beside the shafts are indented by little more than the rounding of angles. So the torques of
    the indentations are put right by what balances the inertias; of lashes side by side, that tells the sum.

    load, lashes, contact : as for `preload`
    angles : (n, 1 + L) float64
    """
    count, across = lashes.shape[-2], np.swapaxes(lashes, -1, -2)
    torques = np.zeros((*angles.shape[:-2], count, 1 + count))
    if contact is not None:
        torques[:] = contact[..., None] * (lashes @ angles - np.eye(count, 1 + count, 1))
    missing = -stiffness @ angles - across @ torques
    missing[..., 0] += load
    torques += np.linalg.pinv(across) @ missing
    # a load that does not reach the lash, or a gap that does not load it, leaves rounding only
    scale = np.ones((*angles.shape[:-2], 1, 1 + count))
    scale[..., 1:] = _largest(stiffness)[..., None, None] + 1e-300
    torques[np.abs(torques) <= 1e-11 * scale] = 0.0
    return torques
