"""Grazing: at the load ratio σr* where the teeth just reach the opposite flank, SS turns into DS, and nothing else.

Above it they arrive with a speed that grows as (σr - σr*)^½: what is left of their kinetic energy is linear in σr, as
for a ball that is thrown just over a wall.

    pytest -m slow tests/test_grazing.py        the same with the exact reference, and σr* beside its
"""

from typing import get_args

import numpy as np
import pytest
from helpers import reference

from clunk.core.sequence import OPPOSITE
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.models import Solver

METHODS = [*get_args(Solver.model_fields["method"].annotation), "reference"]
BACKLASHES = [3.0, 6.0, 10.0]
BRACKET = {3.0: (1.9, 2.1), 6.0: (2.4, 2.6), 10.0: (3.1, 3.3)}  # around σr*
END_TIME = 0.4  # s; the first impact is within it, whichever flank it is on


def first_impact(method, ratio, backlash):
    """The flank of the first primary impact and the speed just before it."""
    if method == "reference":
        plant = reference.boere(ratio, backlash)
        events, _ = reference.run(plant, END_TIME)
        event = events[reference.primary_impacts(events, plant.contact_period())[0]]
        return -event.side * events[0].side, abs(event.speed)
    run = simulate(
        study_from_text(
            f'[driveline]\npreset = "boere-2008"\n[lash]\nbacklash_deg = {backlash}\n[load]\nratio = {float(ratio)!r}\n'
            f'[solver]\nmethod = "{method}"\nend_time = {END_TIME}\n'
        )
    )
    return run.flanks[0], abs(run.events["speed"][run.primaries[0]])


def threshold(method, backlash, digits=0.0):
    """The smallest σr that crosses, by bisection down to neighbouring numbers, or to a relative width."""
    low, high = BRACKET[backlash]
    assert first_impact(method, low, backlash)[0] != OPPOSITE
    assert first_impact(method, high, backlash)[0] == OPPOSITE
    while high - low > digits * high and low < (middle := 0.5 * (low + high)) < high:
        if first_impact(method, middle, backlash)[0] == OPPOSITE:
            high = middle
        else:
            low = middle
    return high


@pytest.fixture(scope="module")
def critical():
    """σr* of a method at a backlash, found once."""
    found = {}

    def of(method, backlash):
        if (method, backlash) not in found:
            # below 1e-12 the reference's own zeros are not resolved
            found[method, backlash] = threshold(method, backlash, 1e-12 if method == "reference" else 0.0)
        return found[method, backlash]

    return of


SLOWLY = [pytest.param(method, marks=pytest.mark.slow if method == "reference" else ()) for method in METHODS]


@pytest.mark.parametrize("backlash", BACKLASHES)
@pytest.mark.parametrize("method", SLOWLY)
class TestGrazing:
    def test_the_speed_of_a_grazing_impact_grows_as_the_root_of_the_excess(self, critical, method, backlash):
        excess = np.logspace(-8, -4, 9)
        at = critical(method, backlash) * (1.0 + excess)
        speeds = [speed for flank, speed in (first_impact(method, ratio, backlash) for ratio in at)]
        exponent, _ = np.polyfit(np.log(excess), np.log(speeds), 1)
        assert exponent == pytest.approx(0.50, abs=0.02)

    def test_the_label_flips_exactly_once(self, critical, method, backlash):
        at = critical(method, backlash) * (1.0 + np.linspace(-1e-9, 1e-9, 10 if method == "reference" else 100))
        crosses = [first_impact(method, ratio, backlash)[0] == OPPOSITE for ratio in at]
        assert not crosses[0]
        assert crosses[-1]
        assert np.count_nonzero(np.diff(crosses)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("backlash", BACKLASHES)
@pytest.mark.parametrize("method", METHODS[:-1])
def test_the_threshold_is_that_of_the_exact_reference(critical, method, backlash):
    """Until the first touch the motion is that of the slow modes, of which RK4 at 1e-4 s is 1e-11 off here."""
    bound = 1e-10 if method == "rk4" else 1e-11
    assert critical(method, backlash) == pytest.approx(critical("reference", backlash), rel=bound)
