"""Random drivelines of lashes, staged shafts and frictions: both methods beside the independent reference.

pytest -m slow tests/test_elements.py       hundreds of each kind
"""

from typing import NamedTuple

import pytest
from helpers import reference
from helpers.agreement import as_in_the_reference
from helpers.randomplants import clutch_plant, element_plant, state_in_the_gaps

from clunk.simulation.driveline import Driveline
from clunk.simulation.rolling import rubs
from clunk.simulation.trajectory import simulate
from clunk.study.errors import ClunkError

END_TIME = 0.3  # s
RIGID = 0.5  # coefficient of restitution


class Kind(NamedTuple):
    """Numbers of lashes, staged shafts and frictions; the coefficient of restitution, or None."""

    lashes: int
    staged: int = 0
    frictions: int = 0
    restitution: float | None = None


# How many seeds by exact and by rk4. They are few where lashes are rigid: where nothing presses on a closed one,
# rounding says whether it stays closed.
SEEDS = {
    Kind(1): (12, 6),
    Kind(1, restitution=RIGID): (12, 6),
    Kind(1, restitution=0.0): (6, 2),
    Kind(2): (8, 3),
    Kind(3): (5, 0),
    Kind(2, restitution=RIGID): (6, 3),
    Kind(3, restitution=RIGID): (6, 0),
    Kind(1, staged=1): (6, 3),
    Kind(1, staged=2): (6, 0),
    Kind(1, staged=1, restitution=RIGID): (4, 2),
    Kind(2, staged=1): (3, 0),
    Kind(1, frictions=1): (4, 2),
    Kind(1, frictions=2): (4, 2),
    Kind(1, frictions=3): (4, 0),
    Kind(1, frictions=2, restitution=RIGID): (4, 2),
    Kind(2, frictions=2, restitution=RIGID): (4, 2),
    Kind(2, staged=1, frictions=2): (3, 0),
}
CASES = [
    (kind, method, seed)
    for kind, counts in SEEDS.items()
    for method, count in zip(("exact", "rk4"), counts, strict=True)
    for seed in range(count)
]


def held_to_the_reference(plant, method, state=None):
    study = reference.study_of(plant, method=method, end_time=END_TIME)
    line = Driveline.from_study(study)
    if state is None and any(rubs(friction, line.rigid_motion) for friction, _ in line.frictions):
        with pytest.raises(ClunkError, match=r"shafts\[\d+\] slips as the driveline rolls"):
            simulate(study)
    else:
        try:
            as_in_the_reference(plant, method, END_TIME, state)
        except ClunkError as refused:  # any twist would do of a shaft without torque, in a stage without stiffness
            if "has no stiffness" not in str(refused):
                raise


@pytest.mark.parametrize(("kind", "method", "seed"), CASES, ids=str)
def test_runs_are_those_of_the_reference(kind, method, seed):
    """Some frictions are side by side, some in loops, where their torques are not unique."""
    held_to_the_reference(element_plant(seed, *kind), method)


@pytest.mark.parametrize("kind", [Kind(1), Kind(1, restitution=RIGID), Kind(2)], ids=str)
@pytest.mark.parametrize("seed", range(5))
def test_runs_that_begin_in_the_gap_are_those_of_the_reference(kind, seed):
    plant = element_plant(seed, *kind)
    held_to_the_reference(plant, "exact", state_in_the_gaps(plant, seed))


@pytest.mark.parametrize(("method", "seed"), [(method, seed) for method in ("exact", "rk4") for seed in range(6)])
def test_a_hysteretic_clutch_has_the_runs_of_the_reference(method, seed):
    """Stages and friction on one shaft: it sticks at any twist, at a breakpoint too."""
    held_to_the_reference(clutch_plant(seed), method)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 250))
def test_runs_of_many_drivelines_are_those_of_the_reference(seed):
    held_to_the_reference(element_plant(seed, 1, restitution=(None, RIGID, 0.0)[seed % 3]), "exact")
    held_to_the_reference(element_plant(seed, 1 + seed % 3, staged=seed % 2, frictions=seed % 4), "exact")
    held_to_the_reference(clutch_plant(seed), "exact")
