"""Rigid-body motion of a driveline: the speeds at which its parts turn without twisting a spring or a closed lash.

It is found along the joints and their gear ratios, exactly but for the rounding of the ratios, where the rank of the
stiffness matrix would need a tolerance between the softest spring and nothing.
"""

from collections.abc import Sequence

import numpy as np

from clunk.core.regimes import RigidMotion
from clunk.study.arrays import Floats
from clunk.study.problems import listing

_FITS = 1e-9  # a twist, relative to what the joint's ends add to it, that is rounding: ratios have some digits each


def rigid_motions(joints: Floats) -> Floats:
    """Motions that twist none of some joints, one of each part of the driveline that is free to turn by itself.

    joints : (m, n) float64, twist = row · θ

    Returns (n, k) float64, the speeds in each of the k motions; none for a part that is held to ground, or whose gear
    ratios along a loop do not fit each other.
    """
    motions, left = [], set(range(joints.shape[1]))
    while left:
        speeds = speeds_along(joints, min(left))
        left -= set(np.flatnonzero(speeds).tolist())
        if not _twists(joints, speeds).any():
            motions.append(speeds)
    return np.array(motions).reshape(len(motions), joints.shape[1]).T


def speeds_along(joints: Floats, start: int) -> Floats:
    """Speeds of the inertias that joints connect to one, where that turns by 1; zero of all others: (n,)."""
    speeds = np.zeros(joints.shape[1])
    speeds[start] = 1.0
    pairs = [(row, *np.flatnonzero(row).tolist()) for row in joints if np.count_nonzero(row) == 2]
    for _ in pairs:
        for row, one, other in pairs:
            if speeds[one] != 0.0 and speeds[other] == 0.0:
                speeds[other] = -speeds[one] * row[one] / row[other]
            elif speeds[other] != 0.0 and speeds[one] == 0.0:
                speeds[one] = -speeds[other] * row[other] / row[one]
    return speeds


def steady_motion(inertia: Floats, springs: Floats, dampers: Floats, load: Floats) -> RigidMotion:
    """The rigid-body motion, and what a load of 1 N m keeps up of it: a speed where dampers resist, else acceleration.

    Parameters
    ----------
    inertia : (n,) float64, or (D, n) of a batch of drivelines  [kg m2]
    springs : (m, n) float64
        Twists of the joints with stiffness, the closed lash among them.
    dampers : (S, n) float64, or (D, S, n), of which all or none of a damper are zero
        Twists of the dampers, times the root of their damping.
    load : (n,) float64
        1 at the loaded inertia.
    """
    shape = rigid_motions(springs)
    speeds = accelerations = np.zeros(inertia.shape)
    slips = _twists(dampers, shape[:, 0]) if shape.shape[1] == 1 else np.zeros(0)
    if slips.any():
        speeds = shape[:, 0] * (shape[:, 0] @ load) / (slips[..., None, :] @ slips[..., None])[..., 0]
    elif shape.shape[1] == 1:
        accelerations = shape[:, 0] * (shape[:, 0] @ load) / (inertia[..., None, :] @ shape**2)[..., 0]
    return RigidMotion(shape, speeds, accelerations, bool(slips.any()))


def separate_part(rigid: RigidMotion, load: Floats, names: Sequence[str]) -> str:
    """Phrase on a driveline with two rigid-body motions or more, which names a part that nothing joins to the load."""
    part = next(speeds for speeds in rigid.shape.T if not speeds @ load)
    free = [name for name, speed in zip(names, part, strict=True) if speed != 0.0]
    return (
        f"no steady motion before the load step: no stiffness joins {listing(free)} to "
        f"{names[int(np.argmax(load))]} or to ground, not even with the lash closed; give a shaft between them a "
        "stiffness"
    )


def _twists(joints: Floats, speeds: Floats) -> Floats:
    """Rates of twist of joints at these speeds, without rounding."""
    twists = joints @ speeds
    twists[np.abs(twists) <= _FITS * (np.abs(joints) @ np.abs(speeds))] = 0.0
    return np.asarray(twists)
