"""Grazing: at the load ratio σr* where the teeth just reach the opposite flank, SS turns into DS, and nothing else.

Above it they arrive with a speed that grows as (σr - σr*)^½: what is left of their kinetic energy is linear in σr, as
for a ball that is thrown just over a wall.
"""

from functools import cache
from typing import get_args

import numpy as np
import pytest

from clunk.core.sequence import OPPOSITE
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.models import Solver

METHODS = get_args(Solver.model_fields["method"].annotation)
BACKLASHES = [3.0, 6.0, 10.0]
BRACKET = {3.0: (1.9, 2.1), 6.0: (2.4, 2.6), 10.0: (3.1, 3.3)}  # around σr*
END_TIME = 0.4  # s; the first impact is within it, whichever flank it is on


def first_impact(method, ratio, backlash):
    """The flank of the first primary impact and the speed just before it."""
    run = simulate(
        study_from_text(
            f'[driveline]\npreset = "boere-2008"\n[lash]\nbacklash_deg = {backlash}\n[load]\nratio = {float(ratio)!r}\n'
            f'[solver]\nmethod = "{method}"\nend_time = {END_TIME}\n'
        )
    )
    return run.flanks[0], abs(run.events["speed"][run.primaries[0]])


@cache
def threshold(method, backlash):
    """The smallest σr that crosses, by bisection down to neighbouring numbers."""
    low, high = BRACKET[backlash]
    assert first_impact(method, low, backlash)[0] != OPPOSITE
    assert first_impact(method, high, backlash)[0] == OPPOSITE
    while low < (middle := 0.5 * (low + high)) < high:
        if first_impact(method, middle, backlash)[0] == OPPOSITE:
            high = middle
        else:
            low = middle
    return high


@pytest.mark.parametrize("backlash", BACKLASHES)
@pytest.mark.parametrize("method", METHODS)
class TestGrazing:
    def test_the_speed_of_a_grazing_impact_grows_as_the_root_of_the_excess(self, method, backlash):
        excess = np.logspace(-8, -4, 9)
        at = threshold(method, backlash) * (1.0 + excess)
        speeds = [speed for flank, speed in (first_impact(method, ratio, backlash) for ratio in at)]
        exponent, _ = np.polyfit(np.log(excess), np.log(speeds), 1)
        assert exponent == pytest.approx(0.50, abs=0.02)

    def test_the_label_flips_exactly_once(self, method, backlash):
        at = threshold(method, backlash) * (1.0 + np.linspace(-1e-9, 1e-9, 100))
        crosses = [first_impact(method, ratio, backlash)[0] == OPPOSITE for ratio in at]
        assert not crosses[0]
        assert crosses[-1]
        assert np.count_nonzero(np.diff(crosses)) == 1
