"""A single run of a study: its events, primary impacts and severity."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from clunk.core import switching, tile
from clunk.core.events import EVENT, KIND_NAMES, STAGE, TOUCH
from clunk.core.exact.margins import MOST
from clunk.core.sequence import INITIAL, OPPOSITE, label
from clunk.core.status import QUALITY_COMPLETE, Status
from clunk.core.sums import root_of_squares
from clunk.simulation.batches import of_system, prepare_one
from clunk.simulation.load import cases_of
from clunk.simulation.system import explained
from clunk.study.arrays import Floats, Integers, Records
from clunk.study.errors import ClunkError
from clunk.study.records import Rows, as_text, capital
from clunk.study.study import Study, takes_study

_LAST = 1000  # latest events of a run that has too many: those that repeat are among them


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run of one load step: its events, primary impacts and severity.

    It has n inertias, L lashes, E events with the load step, H phases, and P primary impacts of a lash.

    study : Study
    initial_sides : (L,) int64, sign of q = θi - ratio θj of each lash on its initial flank
    events : (E,) clunk.core.events.EVENT, times in s after the load step
    states : (E, 2n) float64, θ and θ' at each event  [rad, rad/s]
    extremes : (E, L, 2) float64, largest and smallest acceleration that each lash watches, from its last primary impact
        to the event after the row's; infinite before the first primary impact, NaN for rigid flanks  [rad/s2]
    phases : (H,) clunk.core.events.EVENT, the events and the changes of stage between them
    phase_states : (H, 2n) float64, θ and θ' at the beginning of each phase  [rad, rad/s]
    primaries_of : indices in `events` of the primary impacts of each lash, (P,) int64
    severities_of : Q_i of the primary impacts of each lash  [rad/s2], (P,) float64
    margins : (L,) float64, how near each lash came to another label (see clunk.core.exact.margins); NaN by rk4
    complete : bool, whether it is proved that no event follows the end of the run
    end : float, where the run stopped  [s after the load step]
    lash : int, index from 0 of the lash whose label, severity, impacts and margin the properties give
    """

    study: Study
    initial_sides: Integers
    events: Records
    states: Floats
    extremes: Floats
    phases: Records
    phase_states: Floats
    primaries_of: tuple[Integers, ...]
    severities_of: tuple[Floats, ...]
    margins: Floats
    complete: bool
    end: float
    lash: int = 0

    @property
    def lashes(self) -> tuple["Trajectory", ...]:
        """One trajectory for each lash, whose label, severity, impacts and margin are those of that lash."""
        return tuple(replace(self, lash=k) for k in range(len(self.primaries_of)))

    @property
    def initial_side(self) -> int:
        """Sign of q on the initial flank."""
        return int(self.initial_sides[self.lash])

    @property
    def primaries(self) -> Integers:
        """(P,) indices of the primary impacts in `events`."""
        return self.primaries_of[self.lash]

    @property
    def impact_severity(self) -> Floats:
        """(P,) Q_i  [rad/s2]."""
        return self.severities_of[self.lash]

    @property
    def margin(self) -> float:
        """Margin: how near the run came to another label; NaN by rk4, which computes no margins."""
        return float(self.margins[self.lash])

    @cached_property
    def flanks(self) -> Integers:
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
        return int(np.count_nonzero((self.events["kind"] == TOUCH) & (self.events["lash"] == self.lash)))

    @property
    def severity(self) -> float:
        """Q = sqrt(sum Q_i²)  [rad/s2] (report Eq. 3.3); not defined for the restitution model (NaN)."""
        if self.study.has_rigid_flanks:
            return float("nan")
        return root_of_squares(self.impact_severity)

    @property
    def approach_velocity(self) -> float:
        """V = sqrt(sum v_i²), v_i the relative velocity just before primary impact i  [rad/s]."""
        return root_of_squares(self.events["speed"][self.primaries])

    def kind_name(self, k: int) -> str:
        """The name of event `k`: load step, touch, separation, rejoin, opening or lock."""
        return KIND_NAMES[self.events["kind"][k]]

    def flank_name(self, k: int) -> str:
        """The flank of event `k` at the lash that it concerns: initial, opposite or none."""
        side, lash = self.events["side"][k], self.events["lash"][k]
        return "none" if side == 0 else ("initial" if side == self.initial_sides[max(lash, 0)] else "opposite")

    @property
    def ending(self) -> str:
        """The reason why the run stopped."""
        return "nothing can follow" if self.complete else "the end time; more may follow"

    def lash_name(self, k: int) -> str:
        """The name of the lash that event `k` concerns; empty at the load step."""
        lash = self.events["lash"][k]
        return self.study.lash_names[lash] if lash >= 0 else ""

    def summary(self) -> Rows:
        """Summary of the run for people: (name, value) pairs; of several lashes, one line for each lash."""
        touches = sum(each.touches for each in self.lashes)
        events = ("events", f"{len(self.events) - 1}, {touches} of them touches")
        return [events, *(self.outcome() if len(self.lashes) == 1 else map(_line, self.lashes))]

    def outcome(self) -> Rows:
        """The lash's impacts, label and severity for people: (name, value) pairs."""
        rows = [
            ("primary impacts", self.letters or "none"),
            ("label", self.label),
            ("severity Q", _severity(self.severity, " rad/s²")),
            ("approach velocity V", f"{self.approach_velocity:.5f} rad/s"),
        ]
        if not np.isnan(self.margin):
            rows.append(("margin", f"{MOST:g} or more" if self.margin >= MOST else f"{self.margin:+.3g}"))
        return rows

    def event_table(self) -> list[tuple[str, ...]]:
        """Rows of text: headings, then the events after the load step; of several lashes, a column names the lash."""
        several, severities = len(self.lashes) > 1, np.full(len(self.events), "", object)
        for each in self.lashes:
            severities[each.primaries] = [_severity(severity) for severity in each.impact_severity]
        rows = [("time [s]", "event", *["lash"] * several, "flank", "q' [rad/s]", "Qi [rad/s²]")]
        for k, row in enumerate(self.events[1:], 1):
            names = self.kind_name(k), *[self.lash_name(k)] * several, self.flank_name(k)
            rows.append((f"{row['time']:.7f}", *names, f"{row['speed']:+.6f}", severities[k]))
        return rows

    def __repr__(self) -> str:
        ended = ("ended", f"{self.end:.4g} s after the load step: {self.ending}")
        return as_text(f"clunk.Trajectory of {self.study.title!r}", [*self.summary(), ended])


@takes_study
def simulate(study: Study) -> Trajectory:
    """Run one load step.

    Parameters
    ----------
    study : Study
        Its axes, if any, are ignored.

    Returns
    -------
    Trajectory

    Raises
    ------
    ClunkError
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
    return run_of(study, cases_of(study))


def run_of(study: Study, case: tile.Cases) -> Trajectory:
    """Run a study under the load and with the gaps that a case of one cell has, from its state if it has one.

    Raises ClunkError where the run fails.
    """
    batch = prepare_one(of_system(study))
    room, lashes, status = tile.EVENTS, len(study.lashes), Status.EVENT_BUFFER_FULL
    system, stop, size = batch.system, np.zeros(1, np.uint8), batch.system.rates.shape[1]
    while status == Status.EVENT_BUFFER_FULL:
        capacity = tile.capacity_of(room, lashes)
        output = tile.Output(
            cells=np.zeros((1, lashes), tile.CELL),
            impacts=np.zeros(lashes * capacity, tile.IMPACT),
            logs=np.zeros((1, capacity), EVENT),
            states=np.zeros((1, capacity, size)),
            extremes=np.zeros((1, capacity, lashes, 2)),
            ends=np.zeros(1),
        )
        output.logs["time"] = np.nan
        _, written = tile.run_tile(batch, 0.0, case._replace(states=case.states.copy()), 0, room, output, stop)
        phases, status = output.logs[0][~np.isnan(output.logs["time"][0])], Status(output.cells["status"][0, 0])
        is_event = phases["kind"] != STAGE
        stages = np.count_nonzero(~is_event)
        if len(phases) - stages > study.solver.max_events + 1 or stages > switching.MOST_STAGES:
            raise ClunkError(f"{_sentence(study, Status.EVENT_BUFFER_FULL)} {_repeating(study, phases)}")
        room = min(tile.MORE * room, study.solver.max_events + switching.MOST_STAGES + 1)
    if status != Status.OK:
        raise ClunkError(_sentence(study, status))
    states = output.states[0, : len(phases), : 2 * system.inertias].copy()
    events, begins, (high, low) = phases[is_event], np.flatnonzero(is_event), output.extremes[0, : len(phases)].T
    extremes = np.stack([np.maximum.reduceat(high, begins, 1), np.minimum.reduceat(low, begins, 1)]).T
    if study.has_rigid_flanks:
        extremes[:] = np.nan
    cells, primary = output.cells[0], events["primary"] != 0
    severities = output.impacts["severity"][:written].copy()
    return Trajectory(
        study=study,
        initial_sides=output.cells["initial_side"][0].astype(np.int64),
        events=events,
        states=states[is_event],
        extremes=extremes,
        phases=phases,
        phase_states=states,
        primaries_of=tuple(np.flatnonzero(primary & (events["lash"] == lash)) for lash in range(lashes)),
        severities_of=tuple(np.split(severities, cells["primary_impacts"].cumsum()[:-1])),
        margins=cells["margin"].copy(),
        complete=bool(cells["quality"][0] & QUALITY_COMPLETE),
        end=float(output.ends[0]),
    )


def _repeating(study: Study, phases: Records) -> str:
    """Sentence on what happens most often at the end of a run that has too many events or changes of stage."""
    last = phases[-_LAST:]
    lash, times = Counter(last["lash"].tolist()).most_common(1)[0]
    what = f"touches and separations of {study.lash_names[lash]}" if lash >= 0 else "changes of stage or of what sticks"
    begin, end = (f"{time:.9g}" for time in last["time"][[0, -1]])
    return f"Of the last {len(last):,}, from {begin} to {end} s after the load step, {times:,} are {what}."


def _sentence(study: Study, status: Status) -> str:
    return capital(explained(study, status)) + "."


def _line(run: Trajectory) -> tuple[str, str]:
    """The name of a run's lash, and its label and severity in one line."""
    label = f"{run.label} ({run.letters})" if run.letters else run.label
    hardness = f"Q {_severity(run.severity, ' rad/s²')}, V {run.approach_velocity:.5g} rad/s"
    return run.study.lash_names[run.lash], f"{label}, {hardness}"


def _severity(value: float, unit: str = "") -> str:
    return "undefined" if np.isnan(value) else f"{value:.1f}{unit}"
