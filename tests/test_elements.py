"""Random drivelines of lashes, staged shafts and frictions: both methods beside the independent reference.

pytest -m slow tests/test_elements.py       hundreds of each kind
"""

from typing import NamedTuple

import pytest
from helpers import reference
from helpers.agreement import lashes_as_in_the_reference
from helpers.randomplants import clutch_plant, element_plant

from clunk.core.regimes import rubs
from clunk.simulation.driveline import Driveline
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError

END_TIME = 0.3  # s
RIGID = 0.5  # coefficient of restitution


class Kind(NamedTuple):
    """Numbers of lashes, staged shafts and frictions, the coefficient of restitution or None, and seeds by method.

    Of rigid flanks the seeds are chosen: where nothing presses on a closed lash, rounding says whether it stays closed.
    """

    lashes: int
    staged: int
    frictions: int
    restitution: float | None
    exact: tuple
    rk4: tuple = ()


KINDS = [
    Kind(2, 0, 0, None, tuple(range(8)), (0, 1, 2)),
    Kind(3, 0, 0, None, tuple(range(5))),
    Kind(2, 0, 0, RIGID, tuple(range(6)), (0, 1, 2)),
    Kind(3, 0, 0, RIGID, tuple(range(6))),
    Kind(1, 1, 0, None, tuple(range(6)), (0, 1, 2)),
    Kind(1, 2, 0, None, tuple(range(6))),
    Kind(1, 1, 0, RIGID, tuple(range(4)), (0, 1)),
    Kind(2, 1, 0, None, (0, 1, 2)),
    *(Kind(1, 0, frictions, None, tuple(range(4)), (12, 13)) for frictions in (1, 2, 3)),
    Kind(1, 0, 1, RIGID, (), (0, 2)),
    Kind(1, 0, 2, RIGID, (6, 8)),
    Kind(2, 0, 1, RIGID, (2, 3)),
    Kind(2, 0, 2, RIGID, (2, 3, 5), (1, 3)),
    Kind(2, 1, 2, None, (0, 1, 2)),
]
CASES = [
    *((kind[:4], "exact", seed) for kind in KINDS for seed in kind.exact),
    *((kind[:4], "rk4", seed) for kind in KINDS for seed in kind.rk4),
]


def as_in_the_reference(plant, method):
    study = study_from_text(reference.config_of(plant, method=method, end_time=END_TIME))
    line = Driveline.from_study(study)
    if any(rubs(friction, line.rigid_motion) for friction, _ in line.frictions):
        with pytest.raises(ClunkError, match=r"shafts\[\d+\] slips as the driveline rolls"):
            simulate(study)
    else:
        lashes_as_in_the_reference(plant, method, END_TIME)


@pytest.mark.parametrize(("kind", "method", "seed"), CASES, ids=str)
def test_events_are_those_of_the_reference(kind, method, seed):
    """Some frictions are side by side, some in loops, where their torques are not unique."""
    lashes, staged, frictions, restitution = kind
    as_in_the_reference(element_plant(seed, lashes, staged, frictions, restitution), method)


@pytest.mark.parametrize(("method", "seed"), [(method, seed) for method in ("exact", "rk4") for seed in range(6)])
def test_a_hysteretic_clutch_has_the_events_of_the_reference(method, seed):
    """Stages and friction on one shaft: it sticks at any twist, at a breakpoint too."""
    as_in_the_reference(clutch_plant(seed), method)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 250))
def test_many_drivelines_have_the_events_of_the_reference(seed):
    as_in_the_reference(element_plant(seed, 1 + seed % 3, staged=seed % 2, frictions=seed % 4), "exact")
    as_in_the_reference(clutch_plant(seed), "exact")
