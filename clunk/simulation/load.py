"""The load: an ideal torque step, T(t) = T before until the load step and T after from then on (report Eq. 2.2)."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.study.models import Load

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
    given = load.model_dump() | swept
    if given["ratio"] is not None:
        return tip_out(given["static_torque"], given["ratio"])
    return LoadStep(given["initial_torque"], given["final_torque"])
