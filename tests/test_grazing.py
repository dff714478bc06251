"""Grazing: at the load ratio σr* where the teeth just reach the opposite flank, SS turns into DS, and nothing else.

Above it they arrive with a speed that grows as (σr - σr*)^½: what is left of their kinetic energy is linear in σr, as
for a ball that is thrown just over a wall.
"""

from functools import cache
from typing import get_args

import numpy as np
import pytest

from clunk.api import run_points
from clunk.core.sequence import OPPOSITE
from clunk.study.config import study_from_text
from clunk.study.models import Solver

METHODS = get_args(Solver.model_fields["method"].annotation)
BACKLASHES = [3.0, 6.0, 10.0]
BRACKET = {3.0: (1.9, 2.1), 6.0: (2.4, 2.6), 10.0: (3.1, 3.3)}  # around σr*
END_TIME = 0.4  # s; the first impact is within it, whichever flank it is on


def first_impacts(method, ratios, backlash):
    """The flanks of the first primary impacts at some load ratios, and the speeds just before them."""
    study = study_from_text(
        f'[driveline]\npreset = "boere-2008"\n[lash]\nbacklash_deg = {backlash}\n'
        f'[solver]\nmethod = "{method}"\nend_time = {END_TIME}\n'
    )
    runs = run_points(study, {"load.ratio": ratios}, workers=1)
    first = runs.first_impact[:-1]
    return runs.impact_flank[first], runs.impact_closing_speed[first]


@cache
def threshold(method, backlash):
    """The smallest σr that crosses, by bisection down to neighbouring numbers."""
    low, high = BRACKET[backlash]
    assert (first_impacts(method, [low, high], backlash)[0] == OPPOSITE).tolist() == [False, True]
    while low < (middle := 0.5 * (low + high)) < high:
        ratios = np.sort([*np.linspace(low, high, 17), middle])
        k = int(np.argmax(first_impacts(method, ratios, backlash)[0] == OPPOSITE))
        low, high = ratios[k - 1], ratios[k]
    return high


@pytest.mark.parametrize("backlash", BACKLASHES)
@pytest.mark.parametrize("method", METHODS)
class TestGrazing:
    def test_the_speed_of_a_grazing_impact_grows_as_the_root_of_the_excess(self, method, backlash):
        excess = np.logspace(-8, -4, 9)
        at = threshold(method, backlash) * (1.0 + excess)
        _, speeds = first_impacts(method, at, backlash)
        exponent, _ = np.polyfit(np.log(excess), np.log(speeds), 1)
        assert exponent == pytest.approx(0.50, abs=0.02)
