"""Time histories: the motion between the events of a run, sampled for figures and for other programs.

A run leaves its events behind and the state at each. Between two of them the motion is linear with a constant input,
x' = A x + B u, so that z = (x, 1) moves by a matrix exponential: z(t) = exp(M t) z(0) with M = [[A, B u], [0, 0]].
Every phase starts from the state at its event; nothing is integrated again and no event is searched again.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from clunk.core import switching
from clunk.core.events import TOUCH
from clunk.core.regimes import CLOSED_FLOW, System
from clunk.core.status import Status
from clunk.simulation import driveline
from clunk.simulation.load import load_step
from clunk.simulation.trajectory import Trajectory
from clunk.study.errors import ClunkError

FloatArray = npt.NDArray[np.float64]

LARGEST = 10_000_000  # samples; of the nominal driveline about 1.3 GB
INITIAL, NONE, OPPOSITE = -1, 0, 1  # of `contact`, as of impact_flank in a results file

_NEAR = 1e-6  # of a step: a sample this near to an event would only repeat it
_FAINT = 0.125  # of the first swing: what is left of the slowest oscillation where a picture may end


class HistoryError(ClunkError):
    """A history that cannot be sampled or written as asked; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False)
class History:
    """A run at M samples: multiples of an output step from the load step, both ends, and every event.

    An event has two rows of the same time, its limits from before and from after, since accelerations jump there, and
    in the restitution model velocities; `event` tells the second. Of events at one time, only the first has a row
    before.

    time : (M,) float64  [s], the load step at the config's load.step_time
    after_step : (M,) float64  [s], the load step at 0
    angle : (M, n) float64  [rad], θ
    velocity : (M, n) float64  [rad/s], θ'
    acceleration : (M, n) float64  [rad/s2], θ''; without the impulses of the restitution model
    torque : (M,) float64  [N m], the load
    backlash_coordinate : (M,) float64  [m], x_b = r (θi - θj)
    contact : (M,) int8, the flank that presses: -1 initial, +1 opposite, 0 none
    event : (M,) int64, the row's index in the trajectory's events, -1 where there is none
    """

    time: FloatArray
    after_step: FloatArray
    angle: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray
    backlash_coordinate: FloatArray
    contact: npt.NDArray[np.int8]
    event: npt.NDArray[np.int64]


def sample(
    trajectory: Trajectory, step: float | None = None, until: float | None = None, before: float | None = None
) -> History:
    """The motion of a run at evenly spaced times and at its events.

    Parameters
    ----------
    trajectory : Trajectory
    step : float, optional  [s]
        Between samples; by default the solver's step.
    until : float, optional  [s]
        On the axis of `History.time`; by default the run's end time. A run of which it is proved that nothing follows
        may be sampled for longer than it was computed.
    before : float, optional  [s]
        How much of the equilibrium before the load step to show; by default all from time 0. A run from an initial
        state has none.

    Raises
    ------
    HistoryError
    """
    study = trajectory.study
    system = driveline.build(study)
    load, half_gap = load_step(study.load), float(np.deg2rad(study.lash.backlash_deg) / 2)
    equilibrium = _from_equilibrium(trajectory, system, float(load.before), half_gap)

    step = study.solver.step if step is None else step
    until = study.load.step_time + study.solver.end_time if until is None else until
    if before is None:
        before = study.load.step_time if equilibrium else 0.0
    begin, end = _span(trajectory, step, until, before, equilibrium)

    phases = Phases(system, float(load.after), half_gap, step)
    # of each phase: (m,), (m, 2n), its regime and its first row's event
    times: list[FloatArray] = []
    states: list[FloatArray] = []
    regimes: list[int] = []
    marks: list[int] = []
    if equilibrium:
        last = min(end, 0.0)
        first = [begin] if begin < last else []
        times.append(np.concatenate((first, _grid(begin, last, step) * step, [last])))
        states.append(np.broadcast_to(trajectory.states[0] + 0.0, (times[-1].size, system.lash.size)))  # no -0.0
        regimes.append(switching.closed_on(trajectory.initial_side))
        marks.append(-1)
    rows_before = times[0].size if times else 0

    for k in range(int(np.searchsorted(trajectory.events["time"], end, side="right"))):
        time, state_in_phase = phases.after_event(trajectory, k, end)
        times.append(time)
        states.append(state_in_phase)
        regimes.append(int(trajectory.events["regime"][k]))
        marks.append(k)

    lengths = [part.size for part in times]
    after_step, state = np.concatenate(times), np.concatenate(states)
    regime_of = np.repeat(np.array(regimes), lengths)
    event = np.full(after_step.size, -1)
    event[np.cumsum([0, *lengths[:-1]])] = marks
    torque = np.where(np.arange(after_step.size) < rows_before, load.before, load.after)
    acceleration = phases.accelerations(state, regime_of)
    acceleration[:rows_before] = 0.0  # at rest by definition; the product leaves rounding
    n = system.lash.size // 2
    closed = system.regimes["flow"][regime_of] == CLOSED_FLOW
    return History(
        time=study.load.step_time + after_step,
        after_step=after_step,
        angle=state[:, :n],
        velocity=state[:, n:],
        acceleration=acceleration,
        torque=torque,
        backlash_coordinate=study.lash.radius * _apply(system.lash[None, n:], state[:, :n])[:, 0],
        contact=np.where(closed, -system.regimes["side"][regime_of] * trajectory.initial_side, NONE).astype(np.int8),
        event=event,
    )


def shown_until(trajectory: Trajectory) -> float:
    """When a picture of the run may end, on the axis of `History.time`  [s].

    Half as long again as its events last and not before its slowest oscillation in contact has died down, rounded up to
    0.1 s; but at the run's end time at the latest.
    """
    study = trajectory.study
    modes = driveline.Driveline.from_study(study).modes(closed=True)
    rate = float(np.min(2.0 * np.pi * modes.frequency * modes.damping_ratio, initial=np.inf))
    fading = -np.log(_FAINT) / rate if rate > 0.0 else study.solver.end_time
    span = min(max(1.5 * float(trajectory.events["time"][-1]), fading), study.solver.end_time)
    rounded = float(np.ceil(10.0 * (study.load.step_time + span) - 1e-9) / 10.0)
    return min(rounded, study.load.step_time + study.solver.end_time)


# --- Sampling --------------------------------------------------------------------------------------------------------


class Phases:
    """The flow of each regime under the load after the step, by powers of one step's matrix exponential."""

    def __init__(self, system: System, torque: float, half_gap: float, step: float) -> None:
        self._system = system
        self._step = step
        self._n = system.lash.size // 2
        size = system.lash.size
        self._augmented = np.zeros((system.regimes.size, size + 1, size + 1))
        for regime, row in enumerate(system.regimes):
            self._augmented[regime, :size, :size] = system.rates[row["flow"]]
            self._augmented[regime, :size, size] = system.inputs[row["flow"]] @ [torque, row["side"] * half_gap]
        self._powers: dict[int, list[FloatArray]] = {}

    def after_event(self, trajectory: Trajectory, k: int, end: float) -> tuple[FloatArray, FloatArray]:
        """(m,) times and (m, 2n) states from event `k`, its right limit, to the left limit of the next, or to `end`."""
        starts = trajectory.events["time"]
        start, stop = float(starts[k]), float(starts[k + 1]) if k + 1 < starts.size else np.inf
        regime, x = int(trajectory.events["regime"][k]), trajectory.states[k]
        within = _grid(start, min(stop, end), self._step)
        times, states = [np.array([start]), within * self._step], [x[None]]
        if within.size:
            states.append(self.flow(regime, x, within[0] * self._step - start, within.size))
        if start < stop <= end:
            times.append(np.array([stop]))
            states.append(_state_before(trajectory, self._system, k + 1)[None])
        elif start < end < stop:
            times.append(np.array([end]))
            states.append(self.flow(regime, x, end - start, 1))
        return np.concatenate(times), np.concatenate(states)

    def flow(self, regime: int, x: FloatArray, offset: float, count: int) -> FloatArray:
        """(count, 2n) the states at offset, offset + step, … after the state `x`  [rad, rad/s]."""
        augmented = self._augmented[regime]
        z = np.empty((count, x.size + 1))
        z[0] = expm(offset * augmented) @ np.append(x, 1.0)
        filled, doubling = 1, 0
        while filled < count:  # 2^k rows and the 2^k-th power of a step give the next 2^k rows
            more = min(filled, count - filled)
            z[filled : filled + more] = _apply(self._power(regime, doubling), z[:more])
            filled, doubling = filled + more, doubling + 1
        return z[:, :-1]

    def accelerations(self, state: FloatArray, regime_of: npt.NDArray[np.int64]) -> FloatArray:
        """(M, n) θ'' of states in their regimes  [rad/s2]."""
        acceleration = np.empty((state.shape[0], self._n))
        for regime in range(self._augmented.shape[0]):
            rows = regime_of == regime
            lower = self._augmented[regime, self._n : 2 * self._n]
            acceleration[rows] = _apply(lower[:, :-1], state[rows]) + lower[:, -1]
        return acceleration

    def _power(self, regime: int, doubling: int) -> FloatArray:
        """exp(2^doubling · step · M)."""
        powers = self._powers.setdefault(regime, [])
        if not powers:
            powers.append(np.asarray(expm(self._step * self._augmented[regime])))
        while len(powers) <= doubling:
            powers.append(powers[-1] @ powers[-1])
        return powers[doubling]


def _apply(matrix: FloatArray, rows: FloatArray) -> FloatArray:
    """The matrix times each row; without BLAS, whose threads wait for each other longer than this takes (0.5 ms)."""
    return np.asarray(np.einsum("kj,ij->ik", matrix, rows))


def _from_equilibrium(trajectory: Trajectory, system: System, torque: float, half_gap: float) -> bool:
    """Whether the run began at static equilibrium in contact, so that there is something before the load step."""
    if system.status == Status.NO_EQUILIBRIUM:
        return False
    x = np.empty(system.lash.size)
    side = switching.preload(system, np.array([torque, half_gap]), x)
    return side == trajectory.initial_side and np.array_equal(x, trajectory.states[0])


def _span(trajectory: Trajectory, step: float, until: float, before: float, equilibrium: bool) -> tuple[float, float]:
    """Begin and end of a history  [s after the load step]."""
    if not (np.isfinite(step) and step > 0.0):
        raise HistoryError(f"The output step must be a positive number of seconds, not {step:g}.")
    if not (np.isfinite(before) and before >= 0.0):
        raise HistoryError(f"The time before the load step must be a number of seconds >= 0, not {before:g}.")
    if before > 0.0 and not equilibrium:
        raise HistoryError("A run from an initial state has nothing before its load step to sample.")
    step_time = trajectory.study.load.step_time
    begin, end = -before, until - step_time
    if not np.isfinite(until) or end < begin:
        raise HistoryError(f"A history that starts at {step_time + begin:g} s cannot end at {until:g} s.")
    limit = max(trajectory.end, trajectory.study.solver.end_time)
    if not trajectory.complete and end > limit * (1.0 + 1e-9):
        raise HistoryError(
            f"The run ends at {step_time + limit:g} s and more may follow; to go on until {until:g} s, raise "
            "solver.end_time."
        )
    count = (end - begin) / step + 2.0 * trajectory.events.size
    if count > LARGEST:
        raise HistoryError(
            f"A step of {step:g} s from {step_time + begin:g} s to {until:g} s makes {count:.3g} samples, and "
            f"{LARGEST:,} is the limit; choose a larger step or a shorter time."
        )
    return begin, end


def _grid(start: float, stop: float, step: float) -> npt.NDArray[np.int64]:
    """The multiples of a step between two times, neither of them included."""
    first = int(np.floor(start / step + _NEAR)) + 1
    last = int(np.ceil(stop / step - _NEAR)) - 1
    return np.arange(first, last + 1)


def _state_before(trajectory: Trajectory, system: System, k: int) -> FloatArray:
    """The state just before event `k`: the recorded one, but for the impulse of a touch in the restitution model."""
    x = trajectory.states[k]
    event = trajectory.events[k]
    if not system.impulsive or event["kind"] != TOUCH:
        return np.asarray(x)
    return np.asarray(x + (event["speed"] - system.lash @ x) * system.impulse)
