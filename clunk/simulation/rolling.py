"""Rigid-body motion of a driveline: the speeds at which its parts turn without twisting a spring or a closed lash.

The motion is found by following the joints and their gear ratios, which is exact but for the rounding of the ratios.
The rank of the stiffness matrix would need a tolerance that tells the softest spring from no spring.

Twists and speeds have a further axis in front for drivelines of a batch that differ in gear ratios.
"""

from collections.abc import Sequence

import numpy as np

from clunk.core.batches import alike
from clunk.core.reductions import product
from clunk.core.regimes import RigidMotion
from clunk.core.tables import Friction
from clunk.study.arrays import Floats
from clunk.study.errors import listing

# A twist that counts as rounding, relative to the terms that the joint's two ends add to it: a config gives gear ratios
# with a limited number of digits.
_FITS = 1e-9


def rigid_motions(joints: Floats) -> Floats:
    """Motions that twist none of the given joints, one for each part of the driveline that is free to turn by itself.

    joints : (m, n) float64, twist = row · θ

    Returns (n, k) float64, the relative speeds of the inertias in each of the k motions. A part has no motion where it
    is held to ground, or where its gear ratios around a loop contradict each other.
    """
    motions, left = [], set(range(joints.shape[-1]))
    while left:
        speeds = speeds_along(joints, min(left))
        left -= set(np.flatnonzero(alike(speeds != 0.0)).tolist())
        if not alike(_twists(joints, speeds).any(axis=-1), 0):
            motions.append(speeds)
    return np.stack(motions, axis=-2).mT if motions else np.zeros((joints.shape[-1], 0))


def speeds_along(joints: Floats, start: int) -> Floats:
    """Speeds, (n,), of the inertias that joints connect to inertia `start`, which turns at 1; zero for all others."""
    speeds, turns = np.zeros((*joints.shape[:-2], joints.shape[-1])), {start}
    speeds[..., start] = 1.0
    ends = [np.flatnonzero(row).tolist() for row in alike(joints != 0.0, 2)]
    pairs = [(k, *between) for k, between in enumerate(ends) if len(between) == 2]
    for _ in pairs:
        for k, one, other in pairs:
            if (one in turns) != (other in turns):
                known, next_one = (one, other) if one in turns else (other, one)
                speeds[..., next_one] = -speeds[..., known] * joints[..., k, known] / joints[..., k, next_one]
                turns.add(next_one)
    return speeds


def rigid_motion_of(inertia: Floats, springs: Floats, dampers: Floats, load: Floats) -> RigidMotion:
    """Rigid-body motion, and its constant speed under a load of 1 N m, or its acceleration where no damper resists it.

    Speeds and accelerations are zero unless there is exactly one such motion.

    Parameters
    ----------
    inertia : (n,) float64, or (D, n) of a batch of drivelines  [kg m2]
    springs : (m, n) float64
        Twists of the joints with stiffness, and of all lashes, taken as closed.
    dampers : (S, n) float64, or (D, S, n) of a batch
        Twists of the dampers, times the square root of their damping; those of a damper are zero in all drivelines or
        in none.
    load : (n,) float64
        1 at the loaded inertia.
    """
    shape = rigid_motions(springs)
    speeds = accelerations = np.zeros(inertia.shape)
    if shape.shape[-1] != 1:
        return RigidMotion(shape, speeds, accelerations, False)
    slips = _twists(dampers, shape[..., 0])
    is_dragged, moved = bool(alike(slips.any(axis=-1), 0)), shape[..., 0] * (shape[..., 0] @ load)[..., None]
    if is_dragged:
        speeds = moved / np.sum(slips**2, axis=-1, keepdims=True)
    else:
        accelerations = moved / np.sum(inertia * shape[..., 0] ** 2, axis=-1, keepdims=True)
    return RigidMotion(shape, speeds, accelerations, is_dragged)


def rubs(friction: Friction, rigid: RigidMotion) -> bool:
    """Whether a friction would slip in steady motion, as a rigid-body motion twists its shaft."""
    return bool(alike(product(friction.twist[..., None, :], rigid.shape, _FITS).any(axis=(-2, -1)), 0))


def separate_part(rigid: RigidMotion, load: Floats, names: Sequence[str]) -> str:
    """Phrase of an error on two rigid-body motions or more: names a part that no stiffness joins to the load."""
    part = next(speeds for speeds in rigid.shape.T if not speeds @ load)
    free = [name for name, speed in zip(names, part, strict=True) if speed != 0.0]
    return (
        f"no steady motion before the load step: no stiffness joins {listing(free)} to "
        f"{names[int(load.argmax())]} or to ground, not even with the lash closed; give a shaft between them a "
        "stiffness"
    )


def _twists(joints: Floats, speeds: Floats) -> Floats:
    """Rates of twist of joints at these speeds; what is only rounding is set to zero."""
    return product(joints, speeds[..., None], _FITS)[..., 0]
