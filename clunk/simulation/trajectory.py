"""A single run of a study: its events, primary impacts and severity."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from clunk.core import switching, tile
from clunk.core.events import EVENT, KIND_NAMES, STAGE, TOUCH
from clunk.core.exact.run import MOST
from clunk.core.regimes import System
from clunk.core.runs import Log, Start
from clunk.core.sequence import INITIAL, OPPOSITE, find_primaries, label
from clunk.core.severity import peak_to_peak, root_of_squares
from clunk.core.status import QUALITY_COMPLETE, Status
from clunk.core.tables import HALF_GAP, INPUTS
from clunk.simulation import driveline
from clunk.simulation.load import run_load, torque_at, wave_rates
from clunk.simulation.phases import preload
from clunk.study.errors import ClunkError
from clunk.study.study import Study
from clunk.study.summaries import Rows, as_html, as_text, html_table

FloatArray = npt.NDArray[np.float64]

EVENT_COLUMNS = ("time [s]", "event", "flank", "q' [rad/s]", "impact", "Qi [rad/s²]")
_SHOWN_EVENTS = 40  # in a notebook


class SimulationError(ClunkError):
    """A run that cannot start or did not finish; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run of one load step: its events, primary impacts and severity; n inertias, E events (the load step included).

    study : Study
    initial_side : int, sign of q = θi - ratio θj on the initial flank
    events : (E,) clunk.core.events.EVENT, times in s after the load step
    states : (E, 2n) float64, θ and θ' at each event  [rad, rad/s]
    phases : (P,) clunk.core.events.EVENT, the events and the changes of stage between them
    phase_states : (P, 2n) float64, θ and θ' at each of these
    primaries : (P,) int64, indices of the primary impacts in `events`
    impact_severity : (P,) float64, Q_i  [rad/s2]
    complete : bool, whether it was proved that nothing follows
    margin : float, how near the run came to another label (see clunk.core.exact.run); NaN where the method knows none
    end : float, where the run stopped  [s after the load step]
    """

    study: Study
    initial_side: int
    events: npt.NDArray[np.void]
    states: FloatArray
    phases: npt.NDArray[np.void]
    phase_states: FloatArray
    primaries: npt.NDArray[np.int64]
    impact_severity: FloatArray
    complete: bool
    margin: float
    end: float

    @cached_property
    def flanks(self) -> npt.NDArray[np.int64]:
        """(P,) int64, +1 for a primary impact on the opposite flank, -1 on the initial one."""
        return np.where(self.events["side"][self.primaries] == self.initial_side, INITIAL, OPPOSITE)

    @property
    def label(self) -> str:
        """The label of the sequence, for example DS(1)SS(1)."""
        return label(self.flanks)

    @property
    def letters(self) -> str:
        """The primary impacts as letters, O opposite and I initial, for example O I I."""
        return " ".join("O" if flank == OPPOSITE else "I" for flank in self.flanks)

    @property
    def touches(self) -> int:
        """Number of times the gap closed, chatter included."""
        return int(np.count_nonzero(self.events["kind"] == TOUCH))

    @property
    def severity(self) -> float:
        """Q = sqrt(sum Q_i²)  [rad/s2] (report Eq. 3.3); not defined for the restitution model (NaN)."""
        if self.study.lashes[0].contact.model == "restitution":
            return float("nan")
        return root_of_squares(self.impact_severity, self.impact_severity.size)

    @property
    def approach_velocity(self) -> float:
        """V = sqrt(sum v_i²), v_i the relative velocity just before primary impact i  [rad/s]."""
        return root_of_squares(self.events["speed"][self.primaries], self.primaries.size)

    @property
    def load(self) -> FloatArray:
        """(E,) torque of the load at the events  [N m]."""
        load = self.study.load
        return torque_at(run_load(self.study)[1], wave_rates(load), self.events["time"])

    def kind_name(self, k: int) -> str:
        """The name of event `k`: load step, touch, separation, rejoin, opening or lock."""
        return KIND_NAMES[self.events["kind"][k]]

    def flank_name(self, k: int) -> str:
        """The flank of event `k`."""
        side = self.events["side"][k]
        return "none" if side == 0 else ("initial" if side == self.initial_side else "opposite")

    @property
    def ending(self) -> str:
        """The reason why the run stopped."""
        return "nothing can follow" if self.complete else "the end time; more may follow"

    def summary(self) -> Rows:
        """The run in a few lines for people: (name, value) pairs."""
        rows = [
            ("events", f"{len(self.events) - 1}, {self.touches} of them touches"),
            ("primary impacts", self.letters or "none"),
            ("label", self.label),
            ("severity Q", _severity(self.severity, " rad/s²")),
            ("approach velocity V", f"{self.approach_velocity:.5f} rad/s"),
        ]
        if not np.isnan(self.margin):
            rows.append(("margin", f"{MOST:g} or more" if self.margin >= MOST else f"{self.margin:+.3g}"))
        return rows

    def event_table(self) -> list[tuple[str, ...]]:
        """The events after the load step as texts, by `EVENT_COLUMNS`."""
        ranks = {int(k): rank for rank, k in enumerate(self.primaries)}
        rows: list[tuple[str, ...]] = []
        for k, event in enumerate(self.events[1:], 1):
            impact = "primary" if k in ranks else "secondary" if event["kind"] == TOUCH else ""
            severity = _severity(self.impact_severity[ranks[k]]) if k in ranks else ""
            texts = f"{event['time']:.7f}", self.kind_name(k), self.flank_name(k), f"{event['speed']:+.6f}"
            rows.append((*texts, impact, severity))
        return rows

    def __repr__(self) -> str:
        ended = ("ended", f"{self.end:.4g} s after the load step: {self.ending}")
        return as_text(f"clunk.Trajectory of {self.study.title!r}", [*self.summary(), ended])

    def _repr_html_(self) -> str:
        events = self.event_table()
        shown = events[:_SHOWN_EVENTS]
        if len(events) > len(shown):
            shown.append((f"… {len(events) - len(shown)} more", *[""] * (len(EVENT_COLUMNS) - 1)))
        shown.append((f"{self.end:.7f}", f"end: {self.ending}", *[""] * (len(EVENT_COLUMNS) - 2)))
        return as_html(self.study.title, html_table(self.summary()), html_table(shown, EVENT_COLUMNS))


def simulate(study: Study, *, initial_state: npt.ArrayLike | None = None) -> Trajectory:
    """Run one load step.

    Parameters
    ----------
    study : Study
        Its axes, if any, are ignored.
    initial_state : (2n,) array of float, optional  [rad, rad/s]
        θ and θ' at the load step, instead of steady motion in contact under the torque before. The initial flank is
        then the one that this state touches; in the gap, the nearer one.

    Returns
    -------
    Trajectory

    Raises
    ------
    SimulationError
        Where there is no steady motion or no initial flank, or the run fails.

    Examples
    --------
    >>> import clunk
    >>> run = clunk.simulate(clunk.load_study("configs/nominal.toml"))
    >>> run
    <clunk.Trajectory of 'Nominal tip-out: σr = 5, φθ = 6°'>
      events               18, 9 of them touches
      primary impacts      O I I
      label                DS(1)SS(1)
      severity Q           9299.7 rad/s²
      approach velocity V  10.96922 rad/s
      ended                0.6818 s after the load step: nothing can follow
    >>> run.events["time"][run.primaries].round(4)  # s after the load step
    array([0.1191, 0.2613, 0.565 ])
    """
    system, tables = driveline.prepare(study)
    before, pieces = run_load(study)
    if initial_state is None:
        side, start = _preloaded(study, system, before, pieces)
    else:
        state = np.asarray(initial_state, dtype=np.float64)
        side, start = _started_at(study, system, before[HALF_GAP], pieces, state)
    capacity = study.solver.max_events + 1
    if system.regimes.size > system.lash_states:
        capacity *= switching.MOST_STAGES
    log = Log(np.zeros(capacity, EVENT), np.zeros((capacity, system.lash.size)))
    outcome = tile.run(system, tables, start, log, np.zeros(1, np.uint8))
    if outcome.status != Status.OK:
        raise SimulationError(_sentence(study, Status(outcome.status)))
    phases, states = log.events[: outcome.written].copy(), log.states[: outcome.written, : 2 * system.inertias].copy()
    is_event = phases["kind"] != STAGE
    events = _without_stages(phases, is_event)
    if len(events) > study.solver.max_events + 1:
        raise SimulationError(_sentence(study, Status.EVENT_BUFFER_FULL))
    primaries, severity = np.zeros(capacity, np.int64), np.zeros(capacity)
    impacts = find_primaries(events, len(events), system.sticking_time, primaries)
    peak_to_peak(events, len(events), primaries, impacts, severity)
    if system.impulsive:  # the acceleration of an impulsive touch is not a number
        severity[:impacts] = np.nan
    return Trajectory(
        study=study,
        initial_side=side,
        events=events,
        states=states[is_event],
        phases=phases,
        phase_states=states,
        primaries=primaries[:impacts].copy(),
        impact_severity=severity[:impacts].copy(),
        complete=bool(outcome.quality & QUALITY_COMPLETE),
        margin=float(outcome.margin),
        end=float(outcome.end),
    )


def _without_stages(phases: npt.NDArray[np.void], is_event: npt.NDArray[np.bool_]) -> npt.NDArray[np.void]:
    """The events alone, each with the extremes of the acceleration until the next one."""
    events, begins = phases[is_event].copy(), np.flatnonzero(is_event)
    events["max_acceleration"] = np.maximum.reduceat(phases["max_acceleration"], begins)
    events["min_acceleration"] = np.minimum.reduceat(phases["min_acceleration"], begins)
    return events


def _preloaded(study: Study, system: System, before: FloatArray, pieces: FloatArray) -> tuple[int, Start]:
    """The initial side and the start of a run from steady motion in contact."""
    if system.status != Status.OK:
        raise SimulationError(_sentence(study, Status(system.status)))
    rest = preload(system, before)
    if rest.status != Status.OK:
        raise SimulationError(_sentence(study, rest.status))
    return rest.side, Start(rest.x, rest.regime, before[HALF_GAP], pieces[None], 0)


def _started_at(
    study: Study, system: System, half_gap: float, pieces: FloatArray, state: FloatArray
) -> tuple[int, Start]:
    """The initial side and the start of a run from a state (θ, θ')."""
    size = 2 * system.inertias
    if system.status == Status.UNSTABLE_STEP:
        raise SimulationError(_sentence(study, Status.UNSTABLE_STEP))
    if state.shape != (size,) or not np.all(np.isfinite(state)):
        raise SimulationError(f"The initial state must be {size} finite numbers, θ in rad and then θ' in rad/s.")
    gap = float(state[: system.inertias] @ system.lash[system.inertias : size])
    if system.impulsive and abs(gap) > half_gap * (1.0 + 1e-12):
        raise SimulationError("The initial state overlaps a flank, which the restitution model does not allow.")
    x, inputs = np.zeros(system.lash.size), np.zeros(system.weights.shape[1])
    x[:size], inputs[HALF_GAP], inputs[INPUTS:] = state, half_gap, 1.0
    return 1 if gap >= 0.0 else -1, Start(x, switching.regime_of(system, x, inputs), half_gap, pieces[None], 0)


def _sentence(study: Study, status: Status) -> str:
    text = driveline.explained(study, status)
    return text[0].upper() + text[1:] + "."


def _severity(value: float, unit: str = "") -> str:
    return "undefined" if np.isnan(value) else f"{value:.1f}{unit}"
