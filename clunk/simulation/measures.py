"""Measures of a study's runs: what is measured of a driveline as channels, and the measures of one run."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.channels import LARGEST, PEAK_TO_PEAK, Channels, tabulate
from clunk.core.measures import Run, make_room, measure
from clunk.core.regimes import System
from clunk.core.sequence import find_primaries
from clunk.core.tables import FORCE, HALF_GAP, INPUTS, flows_of
from clunk.simulation.driveline import Driveline, build
from clunk.simulation.load import run_load
from clunk.simulation.trajectory import Trajectory
from clunk.study.measures import OF_IMPACTS as NAMES
from clunk.study.measures import Measure, Part, parts_of
from clunk.study.study import Study

FloatArray = npt.NDArray[np.float64]


class Measures(NamedTuple):
    """What was measured of a run.

    totals : by name, the roots of the summed squares of the impacts' values, and the config's measures
    of_impacts : by name, (P,) float64, impulse [N m s], peak torque [N m] and energy [J] of each primary impact
    """

    totals: dict[str, float]
    of_impacts: dict[str, FloatArray]


def channels_of(study: Study, system: System, *, of_impacts: bool | None = None) -> Channels:
    """The channels of a study's measures.

    of_impacts : whether primary impacts are measured too; by default if the config says so
    """
    line, measures = Driveline.from_study(study), study.measures
    parts = parts_of(study)
    active = flows_of(1, [shaft for _, shaft in line.staged])
    flows, size, driven = system.inputs.shape
    n = system.inertias
    rows = np.zeros((flows, 2 + len(measures), size + driven))
    for flow in range(flows):
        stage = line.in_stages(active[flow].stages)
        if active[flow].closed[0]:
            rows[flow, 0] = _contact_torque(line, system, flow)
        rows[flow, 1, n : 2 * n] = line.lash
        for row, each, part in zip(rows[flow, 2:], measures, parts, strict=True):
            row[:] = _row(each, part, stage, line, system, flow, rows[flow, 0])
    lengths, begins, steps, rates, series = tabulate(system, rows)
    impulsive = bool(system.impulsive)
    return Channels(
        lengths,
        begins,
        steps,
        rates,
        series,
        of_impacts=int(bool(study.impacts.quantities) if of_impacts is None else of_impacts),
        reductions=np.array([{"peak-to-peak": PEAK_TO_PEAK}.get(each.reduce, LARGEST) for each in measures], np.int64),
        contact_stiffness=0.0 if impulsive else line.contact_stiffness,
        contact_damping=0.0 if impulsive else line.contact_damping,
        mobility=float(np.sum(line.lash**2 / line.inertia)),
    )


def _contact_torque(line: Driveline, system: System, flow: int) -> FloatArray:
    """The contact torque of a closed flow by state and inputs, signed like q."""
    if system.impulsive:
        return np.concatenate([system.functionals[flow, FORCE], system.feedthrough[flow, FORCE]])
    n, row = system.inertias, np.zeros(sum(system.inputs.shape[1:]))
    row[:n], row[n : 2 * n] = line.contact_stiffness * line.lash, line.contact_damping * line.lash
    row[system.rates.shape[1] + HALF_GAP] = -line.contact_stiffness
    return row


def _row(
    measure: Measure, part: Part, stage: Driveline, line: Driveline, system: System, flow: int, contact: FloatArray
) -> FloatArray:
    """What a measure is of, by state and inputs in a flow."""
    n, size, k = system.inertias, system.rates.shape[1], part.number
    if measure.quantity == "acceleration":
        return np.concatenate([system.rates[flow, n + k], system.inputs[flow, n + k]])
    if measure.quantity == "contact torque":
        return contact
    row, twist = np.zeros(contact.size), line.lash if part.element == "lash" else line.shafts[k]
    if measure.quantity == "twist":
        row[:n] = twist
        return row
    row[:n], row[n : 2 * n] = stage.shaft_stiffness[k] * twist, stage.shaft_damping[k] * twist
    staged = [shaft for shaft, _ in line.staged]
    if k in staged:
        row[size + INPUTS + staged.index(k)] = 1.0
    return row


def measured(trajectory: Trajectory) -> Measures:
    """Measures of one run: of its primary impacts, and those of its config."""
    study, system, phases = trajectory.study, build(trajectory.study, waves=True), trajectory.phases
    channels = channels_of(study, system, of_impacts=True)
    before, load = run_load(study)
    primaries = np.zeros(phases.size, np.int64)
    impacts = find_primaries(phases, phases.size, 0, trajectory.initial_side, float(system.sticking_time[0]), primaries)
    run = Run(load, float(before[HALF_GAP]), phases, trajectory.phase_states, phases.size, primaries, impacts)
    totals, of_impacts = np.zeros(len(NAMES) + len(study.measures)), np.zeros((impacts, len(NAMES)))
    measure(system, channels, run, make_room(system, channels), totals, of_impacts)
    names = (*NAMES, *(each.name for each in study.measures))
    return Measures(dict(zip(names, totals.tolist(), strict=True)), dict(zip(NAMES, of_impacts.T, strict=True)))
