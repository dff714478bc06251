"""The report's driveline by both methods against numbers computed independently, to the digits written down.

Tolerances come from RK4's truncation at h = 1e-4 s. For the contact mode, ω = 1623 1/s, the phase is late by
(ωh)⁵/120 a step, so a time by T_c (ωh)⁴/120 = 2e-8 s a contact period, and an amplitude is off by as much per radian:
2e-5 over half a period. Chatter magnifies a time by the ratio of the speeds of two touches in a row, ten or twenty-fold
over an episode.
"""

from typing import NamedTuple

import numpy as np
import pytest

from clunk.core.events import LOCK, TOUCH
from clunk.simulation.trajectory import simulate
from clunk.study.study import replace_values

TIME = 1e-6  # s
AMPLITUDE = 2e-5  # relative


@pytest.fixture(params=["rk4", "exact"])
def nominal(request, nominal):
    return nominal.model_copy(update={"solver": nominal.solver.model_copy(update={"method": request.param})})


def at(study, ratio, backlash):
    return replace_values(study, {"load.ratio": ratio, "lash.backlash_deg": backlash})


class Known(NamedTuple):
    """A run's events, the times [s], flanks and q' [rad/s] of its primary impacts, its label, and Q with its digits."""

    events: int
    times: tuple
    speeds: tuple
    flanks: tuple
    label: str
    severity: float | None = None
    digits: float = 0.0


RUNS = {  # load ratio, backlash in degrees
    (1.0, 6.0): Known(0, (), (), (), "NI", 0.0),
    (2.0, 6.0): Known(6, (0.2158974,), (-1.430961,), (-1,), "SS(1)", 1212.7, 0.1),
    (5.0, 6.0): Known(  # Figures 3.1 and 3.2
        18,
        (0.11914968, 0.26126542, 0.56499567),
        (8.624357, -6.640220, -1.360790),
        (1, -1, -1),
        "DS(1)SS(1)",
        9299.7,
        0.05,
    ),
    (10.0, 10.0): Known(  # at k34 = 4.09e5 N/m
        32,
        (0.1101488, 0.2671179, 0.4826656, 0.6388111, 0.9284417),
        (17.48973, -13.49554, 4.84184, -3.60564, -1.41822),
        (1, -1, 1, -1, -1),
        "DS(2)SS(1)",
    ),
}


@pytest.mark.parametrize("point", RUNS, ids=str)
def test_runs_are_those_that_were_computed_independently(nominal, point):
    known, at_ten = RUNS[point], point == (10.0, 10.0)
    run = simulate(replace_values(at(nominal, *point), {"lash.contact.stiffness": 4.09e5} if at_ten else {}))
    impacts = run.events[run.primaries]
    assert len(run.events) == 1 + known.events
    assert impacts["time"] == pytest.approx(known.times, abs=TIME)
    assert impacts["speed"] == pytest.approx(known.speeds, rel=5 * AMPLITUDE)
    assert tuple(run.flanks) == known.flanks
    assert run.label == known.label
    assert run.complete
    if known.severity is not None:
        assert run.severity == pytest.approx(known.severity, abs=known.digits + known.severity * AMPLITUDE)


def test_the_nominal_impacts_have_their_severities(nominal):
    run = simulate(nominal)
    assert run.letters == "O I I"
    assert run.impact_severity == pytest.approx([7316.5, 5623.3, 1154.1], abs=0.05 + 7316.5 * AMPLITUDE)


def test_the_nominal_preload_is_static_equilibrium_on_the_negative_flank(nominal):
    trajectory = simulate(nominal)
    theta, speed = trajectory.states[0, :4], trajectory.states[0, 4:]
    assert theta == pytest.approx([-0.6300, -0.4383, -0.2466, -0.1917], abs=0.0003)
    assert np.all(speed == 0.0)
    assert trajectory.initial_side == -1
    # shafts 1-2 and 2-3 and the contact in series carry all of T(0⁻) = -6 N m
    assert theta[0] - theta[1] == pytest.approx(-6.0 / 31.3, rel=1e-12)
    indentation = -(theta[2] - theta[3]) - np.deg2rad(3.0)
    assert indentation * 0.08**2 * 4.092e5 == pytest.approx(6.0, rel=1e-10)


def test_the_severest_point_of_figure_3_7(nominal):
    """σr = 10, φθ = 16°, with the peaks located between the steps: 20374; sampling at the steps loses 2 to 5 %."""
    trajectory = simulate(at(nominal, 10.0, 16.0))
    assert trajectory.label == "DS(1)SS(2)"
    assert trajectory.severity == pytest.approx(20374.3, rel=AMPLITUDE)


def test_rigid_flanks_touch_when_facts_and_figure_3_3_say(nominal):
    contact = nominal.lash.contact.model_copy(update={"model": "restitution"})
    run = simulate(nominal.model_copy(update={"lash": nominal.lash.model_copy(update={"contact": contact})}))
    touches = run.events["time"][run.events["kind"] == TOUCH]
    assert touches[:3] == pytest.approx([0.1190, 0.1285, 0.1324], abs=5e-5)  # printed to four digits
    assert run.events["time"][run.events["kind"] == LOCK][0] == pytest.approx(0.1359, abs=5e-5)
    assert run.events["time"][run.primaries] == pytest.approx([0.1190, 0.2608, 0.5633], abs=5e-5)
    assert run.label == "DS(1)SS(1)"
