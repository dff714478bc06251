"""The 400 runs by heyoka.py: Taylor series of adaptive order and step, eight runs in the lanes of one vector.

The contact is switched by parameters: its torque is p₀ (k q + c q') - p₁ with p₀ = 1 and p₁ = s k φ/2 on flank s, both
zero in the gap. The two guards q = ± φ/2 are terminal events whose callback logs, switches and lets the lane go on, so
that the loop over steps stays in compiled code. Tried on these runs: 4 or 16 lanes (13 and 4 % slower), without
fast_math (17 % slower), compact_mode (a third slower), one event q² = (φ/2)² for both flanks (as fast, but one run of
400 wrong at a tolerance of 1e-9); shafts as common terms instead of rows of coefficients, slp_vectorize and
force_avx512 change nothing. Events that do not end the step would have to be rewound in Python, step by step.
"""

from array import array

import events_table
import heyoka as hy
import numpy as np

from clunk.core.runs import LEVEL
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import loads_of

LANES = 8
TOUCH, SEPARATION = 1, 2


def make(tolerance: float):
    """A function of cell numbers that gives each one's events: (E, 2) float64, time [s] and kind times side."""
    study = events_table.study()
    driveline = Driveline.from_study(study)
    pieces = loads_of(study.load, 1)[1]
    torque = hy.expression(pieces[0, -1, LEVEL])
    n = driveline.inertia.size
    angles = hy.make_vars(*(f"angle_{k}" for k in range(n)))
    speeds = hy.make_vars(*(f"speed_{k}" for k in range(n)))
    in_contact, preload, half_gap = hy.par[0], hy.par[1], hy.par[2]
    i, j = (int(np.flatnonzero(driveline.lashes[0] == sign)[0]) for sign in (1.0, -1.0))
    gap, gap_speed = angles[i] - angles[j], speeds[i] - speeds[j]
    stiffness, damping = driveline.contact_stiffnesses[0], driveline.contact_dampings[0]
    contact = in_contact * (stiffness * gap + damping * gap_speed) - preload

    dampers, springs = driveline.matrices(closed=False)
    system = list(zip(angles, speeds, strict=True))
    for k, inertia in enumerate(driveline.inertia):
        terms = [-springs[k, m] / inertia * angles[m] for m in range(n) if springs[k, m]]
        terms += [-dampers[k, m] / inertia * speeds[m] for m in range(n) if dampers[k, m]]
        if driveline.load[k]:
            terms.append(torque / inertia)
        if driveline.lashes[0][k]:
            terms.append(-driveline.lashes[0][k] / inertia * contact)
        system.append((speeds[k], hy.sum(terms)))

    log = [array("d") for _ in range(LANES)]

    def on_flank(side: int):
        touch, separation = TOUCH * side, SEPARATION * side

        def callback(_, sign: int, lane: int) -> bool:
            log[lane].append(times[lane])
            if sign == side:
                log[lane].append(touch)
                parameters[0, lane] = 1.0
                parameters[1, lane] = side * stiffness * parameters[2, lane]
            else:
                log[lane].append(separation)
                parameters[0, lane] = 0.0
                parameters[1, lane] = 0.0
            return True

        return callback

    integrator = hy.taylor_adaptive_batch(
        system,
        np.zeros((2 * n, LANES)),
        pars=np.zeros((3, LANES)),
        tol=tolerance,
        compact_mode=False,
        fast_math=True,
        t_events=[
            hy.t_event_batch(gap - half_gap, callback=on_flank(1)),
            hy.t_event_batch(gap + half_gap, callback=on_flank(-1)),
        ],
    )
    state, parameters, times = integrator.state, integrator.pars, integrator.time
    half_gaps, angles_at_rest, sides = events_table.preload(study, driveline)

    def solve(cells):
        found = []
        for start in range(0, len(cells), LANES):
            batch = cells[start : start + LANES]
            if len(batch) < LANES:  # a last, shorter batch repeats its cells
                batch = np.resize(batch, LANES)
            integrator.set_time(0.0)
            integrator.reset_cooldowns()
            state[:n], state[n:] = angles_at_rest[:, batch], 0.0
            parameters[0], parameters[1] = 1.0, sides[batch] * stiffness * half_gaps[batch]
            parameters[2] = half_gaps[batch]
            for lane in log:
                del lane[:]
            integrator.propagate_until(events_table.END_TIME)
            found += [np.array(lane).reshape(-1, 2) for lane in log[: len(cells) - start]]
        return found

    return solve
