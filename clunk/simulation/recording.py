"""A run beside its time history: touches and impacts at the history's rows, and the facts that figures state."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.events import TOUCH
from clunk.simulation.history import History
from clunk.simulation.load import LoadStep, load_step
from clunk.simulation.trajectory import Trajectory


class Touches(NamedTuple):
    """The touches within a history, in order; E of them."""

    row: npt.NDArray[np.intp]  # (E,) rows of the history
    side: npt.NDArray[np.int64]  # (E,) sign of θi - θj at the flank
    primary: npt.NDArray[np.bool_]  # (E,)
    until: npt.NDArray[np.float64]  # (E,) s after the load step, of the event that follows


class Impact(NamedTuple):
    """A primary impact and the accelerations until the next one, or until the run's end."""

    number: int  # from 1
    severity: float  # Q_i, rad/s2; NaN where it is not defined
    begin: float  # s, on the history's time axis
    end: float  # likewise; inf for the last one
    rows: slice  # of the history; empty where it was not sampled for so long
    largest: float  # rad/s2
    smallest: float


@dataclass(frozen=True, eq=False)
class Recording:
    """A named run and its time history.

    name : str, for legends
    trajectory : Trajectory
    history : History, sampled from the trajectory
    """

    name: str
    trajectory: Trajectory
    history: History

    @property
    def title(self) -> str:
        """The title of the run's study."""
        return self.trajectory.study.title

    @property
    def step_time(self) -> float:
        """Time of the load step on the history's time axis  [s]."""
        return self.trajectory.study.load.step_time

    @property
    def load(self) -> LoadStep:
        """Torque before and after the load step  [N m]."""
        return load_step(self.trajectory.study.load)

    @property
    def load_ratio(self) -> float | None:
        """σr, None where the config states torques instead."""
        return self.trajectory.study.load.ratio

    @property
    def backlash_deg(self) -> float:
        """Total backlash φθ  [degrees]."""
        return self.trajectory.study.lash.backlash_deg

    @property
    def radius(self) -> float:
        """Radius of the lash  [m]."""
        return self.trajectory.study.lash.radius

    @property
    def half_gap(self) -> float:
        """Largest backlash coordinate of the open gap, r φ/2  [m]."""
        return float(self.radius * np.deg2rad(self.backlash_deg) / 2)

    @property
    def is_restitution(self) -> bool:
        """Whether contact is an impulse, in which accelerations are not defined."""
        return self.trajectory.study.lash.contact.model == "restitution"

    @property
    def inertia_names(self) -> tuple[str, ...]:
        """Names of the inertias; empty where they have none."""
        return self.trajectory.study.driveline.names or ()

    @property
    def watched(self) -> int:
        """The inertia whose acceleration gives the severity, counted from 1."""
        return int(self.trajectory.study.impacts.acceleration_of)

    @property
    def setup(self) -> str:
        """All parameters of the run but those of its contact and its solver, as text to compare."""
        study = self.trajectory.study
        return repr((study.driveline, study.lash.model_dump(exclude={"contact"}), study.load))

    @cached_property
    def touches(self) -> Touches:
        """The touches within the history."""
        events = self.trajectory.events
        row = np.flatnonzero(self.history.event >= 0)
        row = row[events["kind"][self.history.event[row]] == TOUCH]
        k = self.history.event[row]
        primary = np.isin(k, self.trajectory.primaries)
        return Touches(row, events["side"][k], primary, events["time"][np.minimum(k + 1, events.size - 1)])

    @cached_property
    def impacts(self) -> tuple[Impact, ...]:
        """The primary impacts, in order."""
        events = self.trajectory.events
        row = np.full(events.size + 1, self.history.time.size)
        sampled = np.flatnonzero(self.history.event >= 0)
        row[self.history.event[sampled]] = sampled
        limits = [*self.trajectory.primaries.tolist(), events.size]
        return tuple(
            Impact(
                number=number,
                severity=float(self.trajectory.impact_severity[number - 1]),
                begin=float(self.step_time + events["time"][k]),
                end=float(self.step_time + events["time"][following]) if following < events.size else np.inf,
                rows=slice(int(row[k]), int(row[following])),
                largest=float(events["max_acceleration"][k:following].max()),
                smallest=float(events["min_acceleration"][k:following].min()),
            )
            for number, (k, following) in enumerate(pairwise(limits), 1)
        )
