"""Measures of a study's runs: what is measured of a driveline as channels, and the measures of one run."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.channels import CLOSING, CONTACT_TORQUE, LARGEST, OF_LASH, PEAK_TO_PEAK, Channels, tabulate
from clunk.core.measures import Run, make_room, measure
from clunk.core.regimes import System
from clunk.core.sequence import find_primaries
from clunk.core.tables import FORCE, HOLDING, OF_FRICTION, FlowOf, flows_of, half_gap_of
from clunk.simulation.driveline import Driveline, build
from clunk.simulation.load import run_load
from clunk.simulation.trajectory import Trajectory
from clunk.study.measures import OF_IMPACTS as NAMES
from clunk.study.measures import Measure, Part, parts_of
from clunk.study.study import Study

FloatArray = npt.NDArray[np.float64]


class Measures(NamedTuple):
    """What was measured of a run.

    totals : by name, the roots of the summed squares of the values of a lash's impacts, and the config's measures
    of_impacts : by name, (P,) float64, impulse [N m s], peak torque [N m] and energy [J] of its primary impacts
    """

    totals: dict[str, float]
    of_impacts: dict[str, FloatArray]


def channels_of(study: Study, system: System, *, of_impacts: bool | None = None) -> Channels:
    """The channels of a study's measures.

    of_impacts : whether primary impacts are measured too; by default if the config says so
    """
    line, measures, parts = Driveline.from_study(study), study.measures, parts_of(study)
    n, lashes = system.inertias, len(line.lashes)
    _, size, driven = system.inputs.shape
    flows = flows_of(lashes, [shaft for _, shaft in line.staged], len(line.frictions))
    rows = np.zeros((len(flows), OF_LASH * lashes + len(measures), size + driven))
    for flow, active in enumerate(flows):
        for lash, row in enumerate(line.lashes):
            of_lash = rows[flow, OF_LASH * lash :]
            if active.closed[lash]:
                of_lash[CONTACT_TORQUE] = torque_across(line, system, flow, lash)
            of_lash[CLOSING, n : 2 * n] = row
        for row, each, part in zip(rows[flow, OF_LASH * lashes :], measures, parts, strict=True):
            row[:] = _row(each, part, active, line, system, flow, rows[flow])
    lengths, begins, steps, rates, series = tabulate(system, rows)
    pressed = 0.0 if system.impulsive else 1.0
    return Channels(
        lengths,
        begins,
        steps,
        rates,
        series,
        of_impacts=int(bool(study.impacts.quantities) if of_impacts is None else of_impacts),
        reductions=np.array([{"peak-to-peak": PEAK_TO_PEAK}.get(each.reduce, LARGEST) for each in measures], np.int64),
        contact_stiffness=pressed * line.contact_stiffnesses,
        contact_damping=pressed * line.contact_dampings,
        mobility=np.sum(line.lashes**2 / line.inertia, axis=1),
    )


def torque_across(line: Driveline, system: System, flow: int, lash: int) -> FloatArray:
    """The torque across a lash, closed in a flow, by state and inputs, signed like q."""
    if system.impulsive:
        force = lash * system.functionals_per_lash + FORCE
        return np.concatenate([system.functionals[flow, force], system.feedthrough[flow, force]])
    n, row, stiffness = system.inertias, np.zeros(sum(system.inputs.shape[1:])), line.contact_stiffnesses[lash]
    row[:n], row[n : 2 * n] = stiffness * line.lashes[lash], line.contact_dampings[lash] * line.lashes[lash]
    row[system.rates.shape[1] + half_gap_of(lash)] = -stiffness
    return row


def _row(
    measure: Measure, part: Part, active: FlowOf, line: Driveline, system: System, flow: int, channels: FloatArray
) -> FloatArray:
    """What a measure is of, by state and inputs in a flow whose first channels are those of the lashes."""
    n, size, k = system.inertias, system.rates.shape[1], part.number
    if measure.quantity == "acceleration":
        return np.concatenate([system.rates[flow, n + k], system.inputs[flow, n + k]])
    if measure.quantity == "contact torque":
        torque: FloatArray = channels[OF_LASH * k + CONTACT_TORQUE]
        return torque
    row, twist = np.zeros(channels.shape[1]), line.lashes[k] if part.element == "lash" else line.shafts[k]
    if measure.quantity == "twist":
        row[:n] = twist
        return row
    stage = line.in_stages(active.stages)
    row[:n], row[n : 2 * n] = stage.shaft_stiffness[k] * twist, stage.shaft_damping[k] * twist
    staged = [shaft for shaft, _ in line.staged]
    if k in staged:
        row[size + half_gap_of(len(line.lashes)) + staged.index(k)] = 1.0  # behind the half gaps
    torque, holding = (
        shape[-1] - OF_FRICTION * len(active.stuck) for shape in (row.shape, system.functionals.shape[:2])
    )
    for (friction, shares), sticks in zip(line.frictions, active.stuck, strict=True):
        share = shares[k] * np.sign(twist @ friction.twist)
        if sticks:
            at = flow, holding + HOLDING
            row += share * np.concatenate([system.functionals[at], system.feedthrough[at]])
        else:
            row[torque] += share
        torque, holding = torque + OF_FRICTION, holding + OF_FRICTION
    return row


def measured(trajectory: Trajectory) -> Measures:
    """Measures of one run: of the primary impacts of its lash, and those of its config."""
    study, system, phases = trajectory.study, build(trajectory.study, waves=True), trajectory.phases
    channels = channels_of(study, system, of_impacts=True)
    before, load = run_load(study)
    lashes = len(study.lashes)
    primaries, impacts = np.zeros((lashes, phases.size), np.int64), np.zeros(lashes, np.int64)
    for lash, (side, sticking_time) in enumerate(zip(trajectory.initial_sides, system.sticking_time, strict=True)):
        impacts[lash] = find_primaries(phases, phases.size, lash, side, float(sticking_time), primaries[lash])
    run = Run(load, before, phases, trajectory.phase_states, phases.size, primaries, impacts)
    totals, of_impacts = np.zeros((lashes, len(NAMES) + len(study.measures))), np.zeros((impacts.sum(), len(NAMES)))
    measure(system, channels, run, make_room(system, channels), totals, of_impacts)
    names, part = (*NAMES, *(each.name for each in study.measures)), np.cumsum(impacts)[:-1]
    of_lash = np.split(of_impacts, part)[trajectory.lash]
    return Measures(
        dict(zip(names, totals[trajectory.lash].tolist(), strict=True)), dict(zip(NAMES, of_lash.T, strict=True))
    )
