"""Runs from any state at the load step, where a study's own begin in steady motion in contact."""

from dataclasses import replace

import numpy as np

from clunk.core.tables import SLIPS_BACKWARD, SLIPS_FORWARD, STICKS, half_gap_of
from clunk.core.tile import Cases
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import run_load
from clunk.simulation.system import prepare
from clunk.simulation.trajectory import run_of, simulate


def started(study, state=None):
    """The run of a study from a state (θ, θ'), (2n,); in the gap, the nearer flank is the initial one."""
    if state is None:
        return simulate(study)
    system, (before, pieces), n = prepare(study, Driveline.from_study(study))[0], run_load(study), len(state) // 2
    x, inputs = np.zeros(system.rates.shape[1]), np.ones(system.weights.shape[1])
    x[: 2 * n], inputs[: before.size] = state, before
    regime = np.array([regime_of(system, x, inputs)])
    run = run_of(study, Cases(before[None], pieces[None], np.zeros(1, np.int64), x[None], regime))
    return replace(run, initial_sides=np.where(system.lashes[:, n : 2 * n] @ state[:n] >= 0.0, 1, -1))


def regime_of(system, x, inputs):
    """The regime of a state: of each lash the first flank whose overlap and guards are not negative, else it is open.

    In the restitution model all are open; flanks that rest on each other lock by a touch at rest.
    """
    strides, outputs, lashes = system.regime_strides, system.functionals @ x, len(system.lashes)
    n = system.inertias

    def fits(regime, of_element):
        """Whether those guards of a regime that are of an element are not negative."""
        row = system.regimes[regime]
        guards = system.guards[regime, : row["guards"]]
        values = guards["sign"] * outputs[row["flow"], guards["functional"]]
        return np.all((values + system.offsets[regime, : row["guards"]] @ inputs >= 0.0) | ~of_element(guards))

    stages = range(0, len(system.steady_motion) * strides[lashes], strides[lashes])
    regime = next(k for k in stages if fits(k, lambda guards: (guards["lash"] < 0) & (guards["successor"] >= 0)))
    rates, rounding = system.frictions @ x, 1e-11 * np.abs(x[n : 2 * n]).max()
    slips = np.select([rates > rounding, rates < -rounding], [SLIPS_FORWARD, SLIPS_BACKWARD], STICKS)
    regime += strides[strides.size - 1 - rates.size : -1] @ slips
    for lash in range(0 if system.impulsive else lashes):
        gap = system.lashes[lash, n : 2 * n] @ x[:n]
        closed = regime + strides[lash] * np.arange(1, strides[lash + 1] // strides[lash])
        overlapping = closed[system.contacts["side"][closed, lash] * gap >= inputs[half_gap_of(lash)]]
        fitting = [k for k in overlapping if fits(k, lambda guards, lash=lash: guards["lash"] == lash)]
        regime = min(fitting, default=regime)
    return regime
