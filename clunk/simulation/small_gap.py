"""The response of a driveline as its backlash vanishes (report §3.1, Figure 3.5)."""

from typing import NamedTuple

import numpy as np

from clunk.core.regimes import alone
from clunk.core.status import Status
from clunk.core.tables import TORQUE
from clunk.simulation.driveline import Driveline, build, explained
from clunk.simulation.load import run_inputs
from clunk.simulation.measures import torque_across
from clunk.simulation.phases import preload, regimes_of, states
from clunk.study.arrays import Floats
from clunk.study.errors import ClunkError
from clunk.study.study import Study


class SmallGap(NamedTuple):
    """The torque across a lash without a gap, on the plot's time axis, signed like q = lash · θ."""

    time: Floats  # s
    torque: Floats  # N m
    start: float  # N m, before the load step
    end: float  # N m, in steady motion after it
    decay: float  # 1/s, ζ1 ω1
    frequency: float  # Hz, of the lowest mode
    damping_ratio: float  # ζ1
    step_time: float  # s

    @property
    def ratio(self) -> float:
        """σr = (F before - F after) / F after."""
        return (self.start - self.end) / self.end if self.end != 0.0 else np.inf

    @property
    def periods(self) -> float:
        """n_c = ln(σr) / (2π ζ1); not a number where the envelope never crosses zero."""
        return float(np.log(self.ratio) / (2.0 * np.pi * self.damping_ratio)) if self.ratio > 0.0 else np.nan

    @property
    def characteristic_time(self) -> float:
        """t_c after the load step, where σr exp(-ζ1 ω1 t) = 1  [s]."""
        return float(np.log(self.ratio) / self.decay) if self.ratio > 0.0 else np.nan

    @classmethod
    def of(cls, study: Study) -> "SmallGap":
        """The response of a study's driveline to its load. Raises ClunkError where there is none:
        without steady motion or oscillation, or with a load that does not reach the lash."""
        driveline, system = Driveline.from_study(study), build(study)
        if len(study.lashes) > 1:
            raise ClunkError("There is no one response to draw: several lashes do not change sides together.")
        if driveline.staged or driveline.frictions:
            raise ClunkError("There is no one response to draw: shafts with stages or friction are not linear.")
        modes = driveline.modes(closed=True)
        if system.status != Status.OK:
            raise ClunkError(f"There is no response to draw: {explained(study, Status(system.status))}.")
        if modes.frequency.size == 0 or modes.damping_ratio[0] <= 0.0:
            raise ClunkError("There is no decay to draw: the driveline has no damped oscillation in contact.")
        before, after = (np.where(np.arange(inputs.size) == TORQUE, inputs, 0.0) for inputs in run_inputs(study))
        rest = preload(system, before)
        if rest.sides[0] == 0:
            raise ClunkError("There is no response to draw: the lash carries no torque before the load step.")
        frequency, damping_ratio = float(modes.frequency[0]), float(modes.damping_ratio[0])
        decay = 2.0 * np.pi * frequency * damping_ratio
        start, end = (float(system.contact_torque[0, 0, TORQUE] * inputs[TORQUE]) for inputs in (before, after))
        crossing = np.log(abs((start - end) / end)) / decay if end != 0.0 and start != end else 0.0
        duration = max(1.35 * crossing, 3.0 / frequency)
        step = min(1.0 / (200.0 * frequency), study.solver.step * max(1.0, duration / study.solver.step / 20_000))
        time = step * np.arange(int(duration / step) + 1)
        # without a gap no flank has an offset, and which one is closed does not matter
        state = states(regimes_of(system, after)[rest.regime], rest.x, 0.0, step, time.size)
        across = torque_across(driveline, system, alone(system), system.regimes[rest.regime]["flow"], 0)[0]
        torque = state @ across[: state.shape[1]] + across[state.shape[1] + TORQUE] * after[TORQUE]
        time += study.load.step_time
        return cls(np.asarray(time), torque, start, end, decay, frequency, damping_ratio, study.load.step_time)
