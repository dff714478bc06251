"""Channels of a study: the quantities that its runs measure, linear in state and inputs, tabulated for each flow."""

import numpy as np

from clunk.core.channels import CLOSING, CONTACT_TORQUE, LEVELS, OF_LASH, TERMS, Channels
from clunk.core.regimes import System
from clunk.core.tables import FORCE, HOLDING, OF_FRICTION, TORQUE, TORQUE_RATE, FlowOf, half_gap_of
from clunk.simulation.driveline import Driveline
from clunk.simulation.system import flows_of
from clunk.study.arrays import Floats
from clunk.study.models import part_of
from clunk.study.study import Study

_STEP = 1.4  # shortest step times the fastest rate |λ|: the first term left out is 1.4^20/20! = 3e-16


def channels_of(study: Study, line: Driveline, systems: System) -> Channels:
    """Channels of a study: contact torque and q' of each lash, and behind them the measures of the study.

    Parameters
    ----------
    line : Driveline
        The study's driveline, or a batch of D drivelines with other numbers.
    systems : System
        The systems of these drivelines, with an axis of D (or 1) in front, as in `clunk.core.tile.Batch`.
    """
    n, lashes = systems.inertias, line.lashes.shape[-2]
    count, _, size, driven = systems.inputs.shape
    staged = [shaft for shaft, _ in line.staged]
    flows = flows_of(line)
    rows = np.zeros((count, len(flows), OF_LASH * lashes + len(study.measures), size + driven))

    def set_shaft_torque(row: Floats, k: int, flow: int, active: FlowOf) -> None:
        """Set `row`, (D, Z), to the torque of shaft `k` in a flow by (x, u): spring, damper and friction."""
        twist, stage = line.shafts[..., k, :], line.in_stages(active.stages)
        row[:, :n] = stage.shaft_stiffness[..., k, None] * twist
        row[:, n : 2 * n] = stage.shaft_damping[..., k, None] * twist
        if k in staged:
            row[:, size + half_gap_of(lashes) + staged.index(k)] = 1.0  # the input of a staged shaft
        behind = OF_FRICTION * len(active.stuck)
        torque_at, holding = size + driven - behind, systems.functionals.shape[-2] - behind
        for (friction, shares), sticks in zip(line.frictions, active.stuck, strict=True):
            share = shares[..., k] * np.sign((twist * friction.twist).sum(axis=-1))
            if sticks:
                row += share[..., None] * _read(systems, flow, holding + HOLDING)
            else:
                row[:, torque_at] += share
            torque_at, holding = torque_at + OF_FRICTION, holding + OF_FRICTION

    for flow, active in enumerate(flows):
        for lash, twist in enumerate(np.moveaxis(line.lashes, -2, 0)):
            of_lash = rows[:, flow, OF_LASH * lash :]
            if active.closed[lash]:
                of_lash[:, CONTACT_TORQUE] = torque_across(line, systems, flow, lash)
            of_lash[:, CLOSING, n : 2 * n] = twist
        for m, measure in enumerate(study.measures, OF_LASH * lashes):
            part = part_of(measure, study)
            row, k = rows[:, flow, m], part.number
            if measure.quantity == "acceleration":
                row[:, :size], row[:, size:] = systems.rates[:, flow, n + k], systems.inputs[:, flow, n + k]
            elif measure.quantity == "contact torque":
                row[:] = rows[:, flow, OF_LASH * k + CONTACT_TORQUE]
            elif measure.quantity == "twist":
                row[:, :n] = (line.lashes if part.element == "lash" else line.shafts)[..., k, :]
            else:
                set_shaft_torque(row, k, flow, active)
    pressed = 0.0 if systems.impulsive else 1.0
    return Channels(
        *_tabulate(systems, rows),
        of_impacts=len(study.impacts.quantities),
        swings=np.array([measure.reduce == "peak-to-peak" for measure in study.measures], np.int64),
        contact_stiffness=pressed * np.atleast_2d(line.contact_stiffnesses),
        contact_damping=pressed * np.atleast_2d(line.contact_dampings),
    )


def torque_across(line: Driveline, systems: System, flow: int, lash: int) -> Floats:
    """Torque across a lash that is closed in a flow, signed like q: coefficients of state and inputs (x, u), (D, Z)."""
    if systems.impulsive:
        return _read(systems, flow, lash * systems.functionals_per_lash + FORCE)
    n, (count, _, size, driven) = systems.inertias, systems.inputs.shape
    row, twist, stiffness = np.zeros((count, size + driven)), line.lashes[..., lash, :], line.contact_stiffnesses
    row[:, :n] = stiffness[..., lash, None] * twist
    row[:, n : 2 * n] = line.contact_dampings[..., lash, None] * twist
    row[:, size + half_gap_of(lash)] = -stiffness[..., lash]
    return row


def _read(systems: System, flow: int, functional: int) -> Floats:
    """Coefficients of state and inputs (x, u) in a functional of a flow, (D, Z)."""
    return np.concatenate([systems.functionals[:, flow, functional], systems.feedthrough[:, flow, functional]], axis=-1)


def _tabulate(systems: System, channels: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Lengths, steps, rates and series of D drivelines, the first fields of `Channels`.

    Parameters
    ----------
    systems : System
        The systems of a batch of D drivelines.
    channels : (D, K, C, Z) float64
        Rows of coefficients: channel = row · z, with z = (x, u).
    """
    *flows, size, driven = systems.inputs.shape
    generators = np.zeros((*flows, size + driven, size + driven))
    generators[..., :size, :size], generators[..., :size, size:] = systems.rates, systems.inputs
    generators[..., size + TORQUE, size + TORQUE_RATE] = systems.ramps
    fastest = abs(np.linalg.eigvals(systems.rates)).max(axis=-1)
    lengths = _STEP / np.maximum(fastest, _STEP / systems.end_time)
    rates = generators * lengths[..., None, None]
    terms = [channels]
    for k in range(1, TERMS):
        terms.append(terms[-1] @ rates / k)
    step = power = np.broadcast_to(np.eye(size + driven), rates.shape)
    # exp of a sixteenth of the step, squared four times: its norm is 0.35 where that of M is four times the largest |λ|
    for k in range(1, TERMS):
        power = power @ rates / (16.0 * k)
        step = step + power
    for _ in range(4):
        step = step @ step
    steps = [step]
    for _ in range(1, LEVELS):
        steps.append(steps[-1] @ steps[-1])
    transposed = [np.ascontiguousarray(array.mT) for array in (np.stack(steps, axis=2), rates)]
    return lengths, *transposed, np.stack(terms, axis=-1)
