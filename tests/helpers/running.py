"""Running clunk's core on the reference's plants, without a config in between."""

from typing import NamedTuple

import numpy as np

from clunk.core import switching, tile
from clunk.core.events import EVENT, KIND_NAMES
from clunk.core.regimes import System, build_system, held
from clunk.core.rk4.propagator import Steps, build_steps
from clunk.core.runs import LEVEL, PIECE, Log, Start
from clunk.core.sequence import INITIAL, OPPOSITE, find_primaries, label
from clunk.core.severity import peak_to_peak
from clunk.core.status import QUALITY_COMPLETE, Status
from clunk.core.tables import Lash
from helpers.reference import Plant


class Prepared(NamedTuple):
    """A system and RK4's tables for it."""

    system: System
    steps: Steps


class CoreRun(NamedTuple):
    """What the core leaves behind of one run."""

    status: int
    complete: bool
    end: float
    events: np.ndarray
    states: np.ndarray
    final_state: np.ndarray
    primaries: np.ndarray
    impact_severity: np.ndarray
    severity: float

    @property
    def kinds(self):
        """Kind and side of every event."""
        return [(KIND_NAMES[event["kind"]], int(event["side"])) for event in self.events]

    @property
    def label(self):
        initial = self.events["side"][0]
        return label(INITIAL if side == initial else OPPOSITE for side in self.events["side"][self.primaries])


def prepared(plant: Plant, step: float = 1e-4, end_time: float = 2.0, sticking_time: float | None = None) -> Prepared:
    """The core's system for a plant, given the matrices that the reference uses."""
    damping, stiffness = plant.open_matrices()
    system = build_system(
        inertia=np.array(plant.inertias),
        damping=damping,
        stiffness=stiffness,
        load=plant.load,
        lashes=[
            Lash(
                plant.twist,
                plant.contact_stiffness,
                plant.contact_damping,
                plant.acceleration_of - 1,
                plant.contact_period() if sticking_time is None else sticking_time,
                plant.separation == "force",
            )
        ],
        end_time=end_time,
        rigid=held(plant.n),
    )
    return Prepared(system, build_steps(system, step))


def empty_log(capacity: int, states: int) -> Log:
    """Room for the events of a run with one lash, and the states at them."""
    return Log(np.zeros(capacity, EVENT), np.zeros((capacity, 1, 2)), np.zeros(1), np.zeros((capacity, states)))


def stepped(x: np.ndarray, regime: int, torque: float, half_gap: float) -> Start:
    """The start of a run under a constant torque from the load step on."""
    load = np.zeros((1, 1, PIECE))
    load[..., LEVEL] = torque
    return Start(x, regime, np.array([torque, half_gap, 0.0]), load, 0)


def unproved(run: Prepared) -> Prepared:
    """The same without a bound on what can follow: it runs to its end time."""
    return run._replace(steps=run.steps._replace(provable=np.zeros_like(run.steps.provable)))


def core_run(
    run: Prepared, plant: Plant, state: np.ndarray | None = None, regime: int | None = None, capacity: int = 4096
) -> CoreRun:
    """One run of the core, from preload unless a state is given."""
    system, half_gap = run.system, plant.backlash / 2
    x, inputs = np.zeros(2 * plant.n), np.array([float(plant.after), half_gap, 0.0])
    if state is None:
        status, regime = switching.preload(system, np.array([plant.before, half_gap, 0.0]), x)
        assert status == Status.OK
    else:
        x[:] = state
        regime = switching.regime_of(system, x, inputs) if regime is None else regime
    log = empty_log(capacity, x.size)
    start = stepped(x, regime, plant.after, half_gap)
    status, count, quality, end = tile.run(system, run.steps, start, log, np.zeros(1, np.uint8))
    events, states = log.events, log.states
    complete = bool(quality & QUALITY_COMPLETE)
    primaries, severity = np.zeros(capacity, np.int64), np.zeros(capacity)
    found = find_primaries(events, count, 0, int(events[0]["side"]), float(system.sticking_time[0]), primaries)
    total = peak_to_peak(log.extremes[:, 0], count, primaries, found, severity)
    return CoreRun(status, complete, end, events[:count], states[:count], x, primaries[:found], severity[:found], total)
