"""The mode of a driveline that is the shuffle, told by its shape."""

import numpy as np

from clunk.simulation.driveline import Driveline
from clunk.simulation.rigid import speeds_along
from clunk.study.arrays import Bools


def shuffle_mode(driveline: Driveline) -> int | None:
    """Number from 0 of the shuffle among the oscillating modes of the closed driveline; None where there is none.

    It is the lowest mode of a rigid-like shape: reflected through the gears to the loaded inertia, all that springs and
    the closed lash join to it turns in phase, if a spring holds that to ground; if none does, it turns in two parts
    without a node inside either, the engine's against the vehicle's.
    """
    rows = [*driveline.shafts[driveline.shaft_stiffness > 0.0], *driveline.lashes]
    turns = speeds_along(np.array(rows), int(np.argmax(driveline.load)))
    joined, is_held = np.flatnonzero(turns), False
    joints, forward = np.zeros((turns.size, turns.size), bool), np.zeros(turns.size, bool)
    for ends in map(np.flatnonzero, rows):
        joints[ends[0], ends[-1]] = True
        is_held |= ends.size == 1 and turns[ends[0]] != 0.0
    for number, shape in enumerate(driveline.modes(closed=True).shapes):
        reflected = shape[joined] / turns[joined]
        largest = reflected[np.argmax(driveline.inertia[joined] * np.abs(shape[joined]) ** 2)]
        forward[joined] = (reflected * largest.conjugate()).real > 0.0
        in_phase = joints & (forward[:, None] == forward)
        if largest != 0.0 and _parts(in_phase[np.ix_(joined, joined)]) == (1 if is_held else 2):
            return number
    return None


def _parts(joints: Bools) -> int:
    """Number of parts that joints between n inertias, (n, n), leave apart. scipy's takes long to import."""
    reached = joints | joints.T | np.eye(len(joints), dtype=bool)
    for _ in range(len(joints).bit_length()):  # each time over twice as many joints
        reached = reached @ reached
    return len(np.unique(reached, axis=0))
