"""Time histories: the motion between the events of a run, sampled for figures and for other programs.

Every phase starts from the state that the run recorded at its event and follows the exact flow from there: no step of
the run is integrated again, and no event is searched for again.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from clunk.core.events import STAGE, TOUCH
from clunk.core.regimes import System, driveline_at
from clunk.core.tables import TORQUE
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import run_load
from clunk.simulation.measures import torque_across
from clunk.simulation.stretches import Regime, apply, integrals, regime_under, states, stretches
from clunk.simulation.system import build, steady_driveline
from clunk.simulation.trajectory import Trajectory
from clunk.study.arrays import Bools, Flanks, Floats, Integers, Positions
from clunk.study.errors import ClunkError
from clunk.study.study import Study

_DRAWN = 100_000  # samples: a picture would not show more
LARGEST = 10_000_000  # samples, at most: about 1.3 GB for the nominal driveline

_NEAR = 1e-6  # of a step: a sample this near to an event would only repeat the event's rows, and is left out
_FAINT = 0.125  # share of its first swing to which the slowest oscillation has decayed where a picture may end


class Touches(NamedTuple):
    """The E touches of one lash within a history, in order."""

    row: Positions  # (E,) rows of the history
    side: Integers  # (E,) sign of q at the flank
    primary: Bools  # (E,)


class Impact(NamedTuple):
    """A primary impact and the accelerations until the next one, or until the run's end."""

    number: int  # from 1
    severity: float  # Q_i, rad/s2; NaN where it is not defined
    begin: float  # s, on the history's time axis
    end: float  # s, on the same axis; inf for the last impact
    largest: float  # rad/s2, of the accelerations; NaN for rigid flanks
    smallest: float  # rad/s2; NaN for rigid flanks


@dataclass(frozen=True, eq=False)
class History:
    """A run at M samples: at multiples of an output step from the load step, at both ends, and at every event.

    An event has two rows of the same time, its left and its right limit, since accelerations jump there, and in the
    restitution model velocities, too; `event` marks the row of the right limit. Kinks of the load and changes of stage
    have two rows as well, without a mark. Of several events at one time, only the first has a row of its left limit.
    """

    name: str  # for legends
    trajectory: Trajectory
    time: Floats  # (M,)  s, the load step at the config's load.step_time
    after_step: Floats  # (M,)  s, the load step at 0
    angle: Floats  # (M, n)  rad, θ; includes the rolling angle of a driveline that rolls
    velocity: Floats  # (M, n)  rad/s, θ'
    acceleration: Floats  # (M, n)  rad/s2, θ''; without the impulses of the restitution model
    torque: Floats  # (M,)  N m, the load
    backlash_coordinates: Floats  # (M, L)  m, x_b = r q of each lash
    contacts: Flanks  # (M, L)  the flank of each lash that is in contact: -1 initial, +1 opposite, 0 none
    contact_torques: Floats  # (M, L)  N m, across each lash, signed like q; without the impulses of restitution
    event: Integers  # (M,)  index in the trajectory's events of the one whose right limit the row is; -1 for no event

    @property
    def study(self) -> Study:
        """The study of the run."""
        return self.trajectory.study

    @property
    def lashes(self) -> tuple["History", ...]:
        """One history for each lash, whose backlash, contact, touches and impacts are those of that lash."""
        return tuple(replace(self, trajectory=each) for each in self.trajectory.lashes)

    @property
    def backlash_coordinate(self) -> Floats:
        """(M,) x_b = r q  [m]."""
        return self.backlash_coordinates[:, self.trajectory.lash]

    @property
    def contact_torque(self) -> Floats:
        """(M,) torque across the lash, signed like q  [N m]."""
        return self.contact_torques[:, self.trajectory.lash]

    @property
    def half_gap(self) -> float:
        """Largest backlash coordinate of the open gap, r φ/2  [m]."""
        lash = self.study.lashes[self.trajectory.lash]
        return float(lash.radius * np.deg2rad(lash.backlash_deg) / 2)

    @property
    def watched(self) -> int:
        """The inertia whose acceleration gives the severity, counted from 1."""
        return self.study.watched[self.trajectory.lash]

    @cached_property
    def twist(self) -> Floats:
        """(M, n) angles less their rigid-body part  [rad]; θ itself if springs hold the driveline.

        The rigid-body part is the projection of θ on the rigid-body motion, weighted by inertia.
        """
        driveline = Driveline.from_study(self.study)
        shape = driveline.rigid_motion.shape
        if not shape.size:
            return self.angle
        momentum = driveline.inertia[:, None] * shape
        rolled = self.angle @ momentum / np.sum(momentum * shape, axis=0)
        return self.angle - rolled @ shape.T

    @cached_property
    def touches(self) -> Touches:
        """The touches of the lash within the history."""
        events = self.trajectory.events
        row = np.flatnonzero(self.event >= 0)
        happened = events[self.event[row]]
        row = row[(happened["kind"] == TOUCH) & (happened["lash"] == self.trajectory.lash)]
        k = self.event[row]
        return Touches(row, events["side"][k], np.isin(k, self.trajectory.primaries))

    @cached_property
    def impacts(self) -> tuple[Impact, ...]:
        """The primary impacts, in order."""
        run, step_time = self.trajectory, self.study.load.step_time
        events, extremes = run.events, run.extremes[:, run.lash]
        limits = [*run.primaries.tolist(), events.size]
        return tuple(
            Impact(
                number=number,
                severity=run.impact_severity[number - 1],
                begin=step_time + events["time"][k],
                end=step_time + events["time"][following] if following < events.size else np.inf,
                largest=extremes[k:following, 0].max(),
                smallest=extremes[k:following, 1].min(),
            )
            for number, (k, following) in enumerate(pairwise(limits), 1)
        )


def sample(
    trajectory: Trajectory,
    step: float | None = None,
    until: float | None = None,
    name: str | None = None,
) -> History:
    """Sample the motion of a run at evenly spaced times and at its events, from time 0 of the study on.

    Parameters
    ----------
    trajectory : Trajectory
    step : float, optional  [s]
        Time between samples; by default the solver's step, or longer where that makes more than 100,000 samples.
    until : float, optional  [s]
        End of the history, on the axis of `History.time` and after the load step; by default the study's end time. A
        complete run, of which it is proved that nothing follows, may be sampled beyond the end of its computation; the
        history of another run ends there at the latest.
    name : str, optional
        The name for legends; by default the study's title.

    Raises
    ------
    ClunkError
        Where `until` is not after the load step, `step` is not positive, or there are more than 10,000,000 samples.
    """
    study, system = trajectory.study, build(trajectory.study)
    inputs_before, load = run_load(study)
    step_time = study.load.step_time
    until = step_time + study.solver.end_time if until is None else until
    until = until if trajectory.complete else min(until, step_time + trajectory.end)
    step = max(study.solver.step, until / _DRAWN) if step is None else step
    if not (until > step_time and step > 0.0):
        raise ClunkError(
            f"A run cannot be sampled until {until:g} s by steps of {step:g} s: until must be more than the time of "
            f"the load step, {step_time:g} s, and step greater than 0."
        )
    begin, end = -step_time, until - step_time
    count = (end - begin) / step + 2.0 * trajectory.events.size
    if count > LARGEST:
        raise ClunkError(
            f"A step of {step:g} s until {until:g} s makes {count:.3g} samples, and {LARGEST:,} is the limit; choose a "
            "larger step or a shorter time."
        )

    line = Driveline.from_study(study)
    gains = line.rigid_motion.accelerations * inputs_before[TORQUE] + 0.0  # no -0.0
    phases = [_before_load_step(trajectory, system, inputs_before, gains, begin, step)]
    for k in range(trajectory.phases["time"].searchsorted(end, side="right")):
        phases += _after_event(trajectory, system, inputs_before, load, k, end, step)
    columns = zip(*((phase.time, phase.state, *phase.observed(line, system)) for phase in phases), strict=True)
    after_step, state, acceleration, torque, contacts, contact_torques = (np.concatenate(column) for column in columns)
    lengths, n = [phase.time.size for phase in phases], system.inertias
    acceleration[: lengths[0]] = gains  # constant in steady motion; computed from the state it has rounding
    event = np.full(after_step.size, -1)
    event[np.cumsum([0, *lengths[:-1]])] = [phase.event for phase in phases]
    angle, velocity = state[:, :n], state[:, n : 2 * n]
    radii = np.array([lash.radius for lash in study.lashes])
    return History(
        name=study.title if name is None else name,
        trajectory=trajectory,
        time=step_time + after_step,
        after_step=after_step,
        angle=angle,
        velocity=velocity,
        acceleration=acceleration,
        torque=torque,
        backlash_coordinates=radii * apply(system.lashes[:, n : 2 * n], angle),
        contacts=(-trajectory.initial_sides * contacts).astype(np.int8),
        contact_torques=contact_torques,
        event=event,
    )


def shown_until(trajectory: Trajectory) -> float:
    """End of a picture of the run, on the axis of `History.time`  [s].

    A picture lasts one and a half times as long as the events, and until the slowest oscillation in contact has decayed
    to `_FAINT` of its first swing; its end is rounded up to 0.1 s. It ends at the study's end time at the latest, and
    there, too, if the run has neither events nor an oscillation in contact.
    """
    study = trajectory.study
    modes = steady_driveline(study).modes(closed=True)
    rate = np.min(2.0 * np.pi * modes.frequency * modes.damping_ratio, initial=np.inf)
    fading = -np.log(_FAINT) / rate if rate > 0.0 else study.solver.end_time
    span = min(max(1.5 * trajectory.events["time"][-1], fading), study.solver.end_time)
    rounded, begin = np.ceil(10.0 * (study.load.step_time + span) - 1e-9) / 10.0, study.load.step_time
    return min(rounded if rounded > begin else np.inf, begin + study.solver.end_time)


# --- Sampling --------------------------------------------------------------------------------------------------------


class _Stretch(NamedTuple):
    """Samples of the motion in a stretch: one regime under one piece of the load; m samples, N states."""

    time: Floats  # (m,)  s after the load step
    state: Floats  # (m, N)  rad, rad/s, and the load's wave
    regime: Regime
    event: int  # index of the event that the stretch begins with, or -1

    def observed(self, line: Driveline, system: System) -> tuple[Floats, Floats, Integers, Floats]:
        """Accelerations, load, sides of q in contact, and contact torques at the samples, in the units of `History`."""
        state, regime, n = self.state, self.regime, system.inertias
        contact_torques = np.zeros((len(state), regime.closed.size))
        for lash in np.flatnonzero(regime.closed).tolist():
            across = torque_across(line, driveline_at(system, None), regime.flow, lash)[0]
            by_state, by_inputs = np.split(across, [state.shape[1]])
            contact_torques[:, lash] = apply(by_state[None], state)[:, 0] + by_inputs @ regime.inputs
        acceleration = apply(regime.rates[n : 2 * n], state) + regime.forcing[n : 2 * n]
        torque = regime.inputs[TORQUE] + state[:, 2 * n :][:, :1].sum(axis=1)
        return acceleration, torque, np.tile(regime.sides * regime.closed, (len(state), 1)), contact_torques


def _before_load_step(
    trajectory: Trajectory, system: System, inputs: Floats, acceleration: Floats, begin: float, step: float
) -> _Stretch:
    """Samples of the steady motion before the load step, at a constant acceleration, (n,)  [rad/s2]."""
    time = np.concatenate(([begin] if begin < 0.0 else [], _grid(begin, 0.0, step) * step, [0.0]))
    angle, velocity = np.split(trajectory.states[0], 2)
    t, wave = time[:, None], np.zeros((time.size, system.rates.shape[1] - trajectory.states.shape[1]))
    state = np.hstack([angle + t * (velocity + t * acceleration / 2.0), velocity + t * acceleration, wave])
    return _Stretch(time, state + 0.0, regime_under(system, trajectory.events["regime"][0], inputs), -1)  # no -0.0


def _after_event(
    trajectory: Trajectory, system: System, before: Floats, load: Floats, k: int, end: float, step: float
) -> Iterator[_Stretch]:
    """Samples from the right limit of entry `k` in the run's phases to the left limit of the next, or to `end`.

    An entry whose regime lasts no time yields nothing where a change of stage follows it; the phase that follows then
    begins with its event.
    """
    phases, recorded = trajectory.phases, trajectory.phase_states
    starts, is_event, number = phases["time"], phases["kind"] != STAGE, phases["regime"][k]
    stop = starts[k + 1] if k + 1 < starts.size else np.inf
    if stop == starts[k] and not is_event[k + 1]:
        return
    first, times = k, (starts[k], min(stop, end))
    while not is_event[first] and starts[first - 1] == starts[k]:
        first -= 1
    event = is_event[:first].sum() if is_event[first] else -1
    parts = list(stretches(system, before, load, number, recorded[k], *times))
    grids = [_grid(part.begin, part.end, step) for part in parts]
    firsts = [grid[0] * step - part.begin if grid.size else 0.0 for grid, part in zip(grids, parts, strict=True)]
    travels = integrals(parts[0].regime.rates, np.array([step, *firsts]))
    of_step, _ = next(travels)
    for (begin, until, regime, x, motion, moved), grid, (travel, _) in zip(parts, grids, travels, strict=True):
        sampled, rows = [np.array([begin]), grid * step], [x[None]]
        if grid.size:
            rows.append(states(regime, x + travel @ motion, of_step, grid.size))
        if begin < until:
            last = (x + moved)[None]
            if until == stop and not (system.impulsive and phases["kind"][k + 1] == TOUCH):
                last[0, : recorded.shape[1]] = recorded[k + 1]
            sampled.append(np.array([until]))
            rows.append(last)
        yield _Stretch(np.concatenate(sampled), np.concatenate(rows), regime, event)
        event = -1


def _grid(start: float, stop: float, step: float) -> Integers:
    """Integers m for which m times the step is between two times, further than `_NEAR` of a step from either."""
    return np.arange(math.floor(start / step + _NEAR) + 1, math.ceil(stop / step - _NEAR))
