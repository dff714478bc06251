"""Gears put into a driveline without any, such that its motion stays what it is.

Inertia k then turns by `turns[k]` times its angle before, has its inertia over that squared and its torque over that; a
joint, whose twist is θa - i θb with i = turns[a]/turns[b], has the stiffness and damping over turns[a]², and a gap
|turns[a]| times as wide. The reverse is how an engineer reflects a driveline by hand.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from clunk.study.study import Study, replace_values
from helpers import reference
from helpers.reference import Plant


def lever(plant: Plant, turns: Sequence[float]) -> float:
    """The twist of the geared lash over that of the plant's own."""
    one, other = plant.lash
    return float(turns[(other if one == "ground" else one) - 1])


def geared(
    plant: Plant, turns: Sequence[float], step: float = 1e-4, end_time: float = 1.0, method: str = "rk4"
) -> Study:
    """The study of a plant with gears."""
    ratios, shafts = {}, []
    for number, (one, other, stiffness, damping) in enumerate(plant.shafts, 1):
        length, ratio = _lever_and_ratio((one, other), turns)
        ratios[f"driveline.shafts[{number}].ratio"] = ratio
        shafts.append((one, other, stiffness / length**2, damping / length**2))
    length, ratios["lash.ratio"] = _lever_and_ratio(plant.lash, turns)
    torque = 1.0 / float(turns[plant.loaded - 1])
    driveline = replace(
        plant,
        inertias=tuple(float(j) for j in np.array(plant.inertias) / np.square(turns)),
        shafts=tuple(shafts),
        contact_stiffness=plant.contact_stiffness / length**2,
        contact_damping=plant.contact_damping / length**2,
        backlash=plant.backlash * abs(length),
        before=plant.before * torque,
        after=plant.after * torque,
    )
    return replace_values(reference.study_of(driveline, method, step, end_time), ratios)


def _lever_and_ratio(ends, turns):
    one, other = ends
    length = float(turns[(other if one == "ground" else one) - 1])
    return length, 1.0 if "ground" in ends else length / float(turns[other - 1])
