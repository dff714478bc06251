"""Every method against the stored table of 400 runs, computed to 30 digits without clunk's kernels.

rk4 at h = 1e-4 s is late by T_c (ωh)⁴/120 = 2e-8 s a contact period, and chatter magnifies that ten or twenty-fold an
episode (see test_oracle): 3.3e-6 s at most over the table. `exact` keeps the gap to rounding, some 1e-16 rad; at a
touch of 2e-4 rad/s, the slowest, that is 3e-13 s.
"""

import typing

import events_table
import numpy as np
import pytest

from clunk import simulate
from clunk.study.models import Solver
from clunk.study.study import replace_values

TIME_ERROR = {"rk4": 5e-6, "exact": 1e-12}  # s
SEVERITY_ERROR = {"rk4": 2e-4, "exact": 1e-9}  # of Q_i: half a period of the contact mode at rk4's 2e-5 a radian
METHODS = typing.get_args(Solver.model_fields["method"].annotation)


@pytest.fixture(scope="module")
def table():
    return events_table.read()


def run(table, cell, method, step=1e-4):
    values = {"load.ratio": float(table.ratio[cell]), "lash.backlash_deg": float(table.backlash_deg[cell])}
    return simulate(replace_values(events_table.study(method), values | {"solver.step": step}))


def test_the_table_is_that_of_the_runs_it_is_compared_with(table):
    ratio, backlash_deg = events_table.grid()
    np.testing.assert_array_equal(table.ratio, ratio)
    np.testing.assert_array_equal(table.backlash_deg, backlash_deg)
    for axis, values in zip(
        events_table.study().sweep.axes, (events_table.RATIOS, events_table.BACKLASHES_DEG), strict=True
    ):
        np.testing.assert_array_equal(axis.grid, values)


@pytest.mark.parametrize("method", METHODS)
def test_every_event_and_severity_of_all_runs_is_that_of_the_table(table, method):
    for cell in range(table.ratio.size):
        found, own = run(table, cell, method), table.of(cell)
        events = found.events[1:]
        np.testing.assert_array_equal(events["kind"], table.kind[own])
        np.testing.assert_array_equal(events["side"], table.side[own])
        late = events["time"] - table.time[own] - table.remainder[own]
        assert np.all(np.abs(late) <= TIME_ERROR[method]), cell
        assert found.label == table.label[cell]
        np.testing.assert_array_equal(found.primaries - 1, np.flatnonzero(table.primary[own]))
        np.testing.assert_allclose(found.impact_severity, table.severity_of(cell), rtol=SEVERITY_ERROR[method])
