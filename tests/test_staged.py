"""Staged shafts: piecewise linear torques, beside the independent reference and known special cases."""

import numpy as np
import pytest
from helpers.agreement import exact
from helpers.reference import Plant

from clunk.api import sweep
from clunk.core.events import STAGE
from clunk.simulation.driveline import Driveline
from clunk.simulation.system import steady_stages
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError

STAGES = ["driveline.shafts[1].stiffness=[31.3, 10.0, 31.3]", "driveline.shafts[1].breakpoints_deg=[-4.0, 2.0]"]
TRUCK = """
driveline.inertias = [1.2, 0.15, 0.05, 0.4, 16.0, 4500.0]
driveline.shafts = [
    { between = [1, 2], stiffness = [2292.0, 9000.0], breakpoints_deg = [12.0], damping = 1.0 },
    { between = [3, 4], stiffness = 12000.0, damping = 3.0 },
    { between = [4, 5], stiffness = 50000.0, damping = 60.0, ratio = 3.7 },
    { between = [5, 6], stiffness = 80000.0, damping = 600.0 },
    { between = [6, "ground"], damping = 30.0 },
]
lash = { between = [2, 3], ratio = 6.5, gap_mm = 0.1, radius = 0.045, contact = { stiffness = 2e8, damping = 2e3 } }
load = { profile = "ramp", duration = 0.004, initial_torque = 485.0, final_torque = -80.0 }
"""
EXACT, RK4 = ['solver.method="exact"'], ['solver.method="rk4"', "solver.step=2e-5"]


def nominal(*overrides):
    return load_study("configs/nominal.toml", [*overrides])


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_a_clutch_damper_swings_on_its_stages_by_hand(method):
    """From a deflection of 0.3 rad on 50 N m/rad beyond 0.1 rad, on 20 below, none behind: arcs of circles."""
    plant = Plant(
        inertias=(0.01,),
        shafts=((1, "ground", (20.0, 50.0), 0.0, (0.1,)),),
        lash=(1, "ground"),
        backlash=6.0,
        acceleration_of=1,
        before=0.0,
        after=0.0,
    )
    run = exact(plant, np.array([0.3, 0.0]), 0.12, method, step=2e-5)
    stiff, soft = np.sqrt(50.0 / 0.01), np.sqrt(20.0 / 0.01)
    centre = 0.1 - 20.0 * 0.1 / 50.0  # where the stiff stage's torque would be zero
    first = np.arccos((0.1 - centre) / (0.3 - centre)) / stiff
    speed = (0.3 - centre) * stiff * np.sin(stiff * first)
    back = 2.0 * (np.pi - np.arctan2(speed / soft, 0.1)) / soft
    changes = run.phases["kind"] == STAGE
    # rk4 is late by (71 rad/s h)⁴/120 = 3e-14 of what has passed
    assert run.phases["time"][changes] == pytest.approx([first, first + back], abs=1e-12)
    assert run.phase_states[changes, 1] == pytest.approx([-speed, speed], rel=1e-10)


KNEE = float(np.rad2deg(-1.0 / 31.3))  # of shaft 1 under the load's last 1 N m
RESTING = {
    "under its last load": [f"driveline.shafts[1].breakpoints_deg=[{KNEE!r}]", "load.ratio=5.0"],
    "under no load": ["driveline.shafts[1].breakpoints_deg=[0.0]", "load={initial_torque=-5.0, final_torque=0.0}"],
    "under both loads": [f"driveline.shafts[1].breakpoints_deg=[{KNEE!r}]", "load.ratio=0.0"],
}


@pytest.mark.parametrize("where", RESTING)
@pytest.mark.parametrize("method", [EXACT, RK4], ids=["exact", "rk4"])
def test_a_twist_that_comes_to_rest_at_a_breakpoint_rests(method, where):
    """It changes stage as long as it swings, no more often than its fastest mode of 20 Hz; then nothing can follow."""
    stages = ["driveline.shafts[1].stiffness=[10.0, 31.3]", "driveline.shafts[1].damping=0.8"]
    run = simulate(nominal(*method, *stages, *RESTING[where], "solver.end_time=20.0"))
    changes = run.phases["time"][run.phases["kind"] == STAGE]
    assert (changes.size > 0) == (where != "under both loads")
    assert np.all(np.diff(changes) > 0.02)
    assert run.complete or where == "under no load"  # where the lash stays open, and what is behind it may drift


def test_the_steady_twist_is_the_inverse_of_the_torque():
    """6 N m through a shaft of 10 N m/rad between -4 and 2 degrees and 31.3 beyond."""
    study = nominal(*EXACT, *STAGES)
    angles = simulate(study).states[0][:4]
    knee = np.deg2rad(-4.0)
    assert angles[0] - angles[1] == pytest.approx(knee + (-6.0 - 10.0 * knee) / 31.3, rel=1e-12)
    assert steady_stages(study) == {1: 1}
    slope, energy = Driveline.from_study(study).shaft_stiffness[0], Driveline.from_study(study).shaft_energy
    assert slope == 10.0
    theta = np.array([angles[0] - angles[1], 0.0, 0.0, 0.0])
    by_hand = 10.0 * knee**2 / 2.0 + (-6.0 + 10.0 * knee) / 2.0 * (theta[0] - knee)
    assert energy(theta)[0] == pytest.approx(by_hand, rel=1e-12)


def test_a_stage_without_stiffness_may_not_carry_the_load():
    """A branch that carries no torque is loose in a stage without stiffness; with stiffness it is not."""

    def branched(middle):
        shafts = (*Plant().shafts[:3], (2, 5, (20.0, middle, 20.0), 0.001, (-0.02, 0.02)))
        return Plant(inertias=(0.024, 0.002, 0.002, 0.002, 0.001), shafts=shafts)

    with pytest.raises(ClunkError, match="No steady motion"):
        exact(branched(0.0))
    assert exact(branched(1e-3)).label == exact(branched(1e-3), method="rk4").label


def test_stages_and_breakpoints_are_swept():
    """A stage as stiff as its neighbours is the plain shaft; a stiffness of all stages by degree is converted."""
    axes = "sweep.axes=[{parameter='driveline.shafts[1].stiffness[2]', values=[10.0, 31.3]}]"
    results = sweep(nominal(*EXACT, *STAGES, axes), workers=1)
    assert results.severity[1] == pytest.approx(simulate(nominal(*EXACT)).severity, rel=1e-9)
    assert results.severity[0] == pytest.approx(simulate(nominal(*EXACT, *STAGES)).severity, rel=1e-12)
    degrees = "driveline.shafts[1].stiffness_per_deg=[0.5, 0.25]", "driveline.shafts[1].breakpoints_deg=[1.0]"
    by_degree = nominal(*EXACT, *degrees, axes)
    assert by_degree.driveline.shafts[0].stages == pytest.approx((np.rad2deg(0.5), np.rad2deg(0.25)), rel=1e-15)


@pytest.mark.parametrize("loose", [1, 3])
def test_a_stage_without_stiffness_that_nothing_loads_changes_nothing_whichever_shaft_has_it(loose):
    other = 4 - loose
    stages = [
        f"driveline.shafts[{loose}].stiffness=[31.3, 0.0]",
        f"driveline.shafts[{loose}].breakpoints_deg=[60.0]",
        f"driveline.shafts[{other}].stiffness=[10.0, 31.3]",
        f"driveline.shafts[{other}].breakpoints_deg=[-60.0]",
    ]
    plain, staged = simulate(nominal(*EXACT)), simulate(nominal(*EXACT, *stages))
    assert staged.label == plain.label
    assert staged.events["time"] == pytest.approx(plain.events["time"], abs=1e-12)  # s, rounding


@pytest.mark.parametrize(("torque", "duration"), [(485.0, 0.004), (500.0, 0.004), (560.0, 0.01), (490.0, 0.018)])
def test_a_stage_is_left_once_in_a_steep_ramp_on_a_driveline_that_rolls(torque, duration):
    """A ramp of 10⁵ N m/s takes speeds of 10⁸ rad/s as its steady response, where the drag takes minutes to act."""
    load = [f"load.initial_torque={torque}", f"load.duration={duration}"]
    runs = [simulate(study_from_text(TRUCK, overrides=[*load, *way])) for way in (EXACT, [RK4[0], "solver.step=1e-5"])]
    assert (runs[0].phases["kind"] == STAGE).sum() == 1
    assert np.array_equal(*(run.events["kind"] for run in runs))
    assert runs[0].events["time"] == pytest.approx(runs[1].events["time"], abs=5e-7)  # of RK4, 120 steps a period
