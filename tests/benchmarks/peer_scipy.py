"""The 400 runs by SciPy's solve_ivp, restarted at every terminal event."""

import events_table
import numpy as np
from scipy.integrate import solve_ivp

from clunk.core.runs import LEVEL
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import run_load

TOUCH, SEPARATION = 1, 2
MOST_EVENTS = 400  # a run that has more has gone astray


def make(**options):
    """A function of cell numbers that gives each one's events: (E, 2) float64, time [s] and kind times side.

    options : of solve_ivp. With `first_step=1e-6` the first step after an event, where a guard is zero to rounding,
    cannot leave and re-enter the contact unseen; without it that happens.
    """
    study = events_table.study()
    driveline = Driveline.from_study(study)
    inertia, lash, n = driveline.inertia, driveline.lashes[0], driveline.inertia.size
    i, j = (int(np.flatnonzero(lash == sign)[0]) for sign in (1.0, -1.0))
    half_gaps, angles_at_rest, sides = events_table.preload(study, driveline)

    def rates(closed):
        damping, stiffness = driveline.matrices(closed=closed)
        return np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / inertia[:, None], -damping / inertia[:, None]]])

    opened, closed = rates(False), rates(True)
    drive = np.concatenate([np.zeros(n), driveline.load * run_load(study)[1][-1, LEVEL] / inertia])
    push = np.concatenate([np.zeros(n), driveline.contact_stiffnesses[0] * lash / inertia])

    def run(cell):
        half_gap, side, time = half_gaps[cell], int(sides[cell]), 0.0
        x = np.concatenate([angles_at_rest[:, cell], np.zeros(n)])

        def upper(_, x):
            return x[i] - x[j] - half_gap

        def lower(_, x):
            return x[i] - x[j] + half_gap

        upper.terminal = lower.terminal = True
        found = []
        while len(found) < MOST_EVENTS:
            if side:
                upper.direction, lower.direction = -1.0, 1.0
                events, matrix, constant = [upper if side > 0 else lower], closed, drive + side * half_gap * push
            else:
                upper.direction, lower.direction = 1.0, -1.0
                events, matrix, constant = [upper, lower], opened, drive
            flow = solve_ivp(
                lambda _, x, matrix=matrix, constant=constant: matrix @ x + constant,
                (time, events_table.END_TIME),
                x,
                events=events,
                **options,
            )
            if flow.status != 1:
                break
            time, x = float(flow.t[-1]), flow.y[:, -1]
            if side:
                found.append((time, SEPARATION * side))
                side = 0
            else:
                side = 1 if flow.t_events[0].size else -1
                found.append((time, TOUCH * side))
        return np.array(found, dtype=np.float64).reshape(-1, 2)

    return lambda cells: [run(cell) for cell in cells]
