"""The load: an ideal torque step, T(t) = T before until the load step and T after from then on (report Eq. 2.2)."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.study.models import Load
from clunk.study.study import Study

Torque = float | npt.NDArray[np.float64]


class LoadStep(NamedTuple):
    """The torque on the loaded inertia before and after the load step  [N m]; numbers, or arrays of one shape."""

    before: Torque
    after: Torque


def tip_out(static_torque: Torque, ratio: Torque) -> LoadStep:
    """An engine tip-out: the dynamic torque Td = σr Ts is released, Ts stays (report Eq. 2.4, Figure 2.2)."""
    return LoadStep(before=static_torque * (1.0 + ratio), after=static_torque)


def load_step(load: Load, **swept: Torque) -> LoadStep:
    """The load step of a config: from static torque and ratio, or from the torques before and after.

    `swept` values, under the names of the config's keys, take the place of the config's own.
    """
    values = load.model_dump() | swept
    if values["ratio"] is not None:
        return tip_out(values["static_torque"], values["ratio"])
    return LoadStep(values["initial_torque"], values["final_torque"])


def run_inputs(study: Study) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Inputs d = (T, φ/2) of a run before and after its load step  [N m, rad]."""
    half_gap = np.deg2rad(study.lash.backlash_deg) / 2
    before, after = (np.array([torque, half_gap], dtype=np.float64) for torque in load_step(study.load))
    return before, after
