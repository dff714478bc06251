"""Staged shafts: piecewise linear torques, beside the independent reference and known special cases."""

import numpy as np
import pytest
from helpers import reference
from helpers.agreement import NUDGE, exact, kinds_of
from helpers.randomplants import nudged
from helpers.reference import Plant

from clunk.api import sweep
from clunk.core.events import STAGE
from clunk.simulation.driveline import Driveline, steady_stages
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError
from clunk.study.problems import ConfigError
from clunk.study.study import replace_values

CONTACTS = {
    "by gap": [],
    "by force": ['lash.contact.separation="force"'],
    "restitution": ['lash.contact.model="restitution"'],
}
STAGES = ["driveline.shafts[1].stiffness=[31.3, 10.0, 31.3]", "driveline.shafts[1].breakpoints_deg=[-4.0, 2.0]"]
EXACT, RK4 = ['solver.method="exact"'], ['solver.method="rk4"', "solver.step=2e-5"]
NEAR = 1e-9  # s, between two exact codes over up to a hundred events; chatter multiplies rounding


def nominal(*overrides):
    return load_study("configs/nominal.toml", [*overrides])


def staged_plant(seed):
    """A chain of 2 to 5 inertias, held at both ends, one or two of whose shafts have 2 to 4 stages."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    lash = int(rng.integers(1, n))
    pairs = [(1, "ground"), *((k, k + 1) for k in range(1, n) if k != lash), (n, "ground")]
    shafts = []
    for one, other in pairs:
        stiffness = round(30.0 * 2.0 ** rng.uniform(-2.0, 2.0), 3)
        shafts.append((one, other, stiffness, round(0.005 * float(np.sqrt(stiffness)), 6)))
    for k in rng.choice(len(shafts), size=int(rng.integers(1, 3)), replace=False):
        one, other, stiffness, damping = shafts[k]
        breakpoints = np.unique(np.round(rng.uniform(-0.25, 0.25, int(rng.integers(1, 4))), 4))
        slopes = np.round(stiffness * 2.0 ** rng.uniform(-2.0, 2.0, breakpoints.size + 1), 3)
        slopes[rng.integers(slopes.size)] *= rng.random() < 0.7  # else a stage without stiffness
        shafts[k] = (one, other, tuple(slopes.tolist()), damping, tuple(breakpoints.tolist()))
    contact = round(30.0 * rng.uniform(10.0, 100.0), 2)
    model = {"separation": "force"} if seed % 3 == 1 else {"restitution": 0.5} if seed % 3 == 2 else {}
    return Plant(
        inertias=tuple(np.round(0.01 * 2.0 ** rng.uniform(-2.0, 2.0, n), 5).tolist()),
        shafts=tuple(shafts),
        lash=(lash, lash + 1),
        contact_stiffness=contact,
        contact_damping=round(float(rng.choice([0.0, 0.02, 0.2]) * 2.0 * np.sqrt(contact * 0.005)), 6),
        backlash=float(rng.choice([0.001, 0.01, 0.05, 0.2])),
        before=float(rng.choice([-8.0, -4.0, -2.0, 2.0, 4.0, 8.0])),
        after=float(rng.choice([-1.0, 1.0, -0.2, 0.0])),
        loaded=int(rng.integers(1, n + 1)),
        acceleration_of=int(rng.integers(1, n + 1)),
        **model,
    )


def same_as_the_reference(seed):
    plant = staged_plant(seed)
    try:
        plant.preload()
    except ValueError:  # a stage without stiffness carries the load, or nothing does
        with pytest.raises(ClunkError):
            exact(plant, None, 0.5)
        return
    run = exact(plant, None, 0.5)
    events = [event for event in reference.run(plant, 0.5)[0] if event.kind != "stage"]
    times = np.array([event.time for event in events])
    if not np.allclose(times, run.events["time"][: times.size], rtol=0.0, atol=NEAR):
        nudged_events = [
            event for event in reference.run(nudged(plant, None, NUDGE)[0], 0.5)[0] if event.kind != "stage"
        ]
        apart = np.array([event.time for event in nudged_events])[: times.size] - times[: len(nudged_events)]
        times = times[: np.flatnonzero(np.abs(apart) > NEAR)[0]]  # later ones are not resolved
    count = times.size
    assert kinds_of(run)[:count] == [(event.kind, event.side) for event in events[:count]]
    assert run.events["time"][:count] == pytest.approx(times, abs=NEAR)
    assert balance(run).relative_residual < 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_events_are_those_of_the_reference(seed):
    same_as_the_reference(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", sorted({*range(12, 500)} - {152}))  # at a breakpoint beside no stiffness: refused
def test_events_are_those_of_the_reference_in_many_drivelines(seed):
    same_as_the_reference(seed)


@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
@pytest.mark.parametrize("method", [EXACT, RK4], ids=["exact", "rk4"])
class TestStages:
    def test_equal_stages_are_one(self, contact, method):
        """But for where the twist is measured from: some rounding, which 18 events multiply."""
        plain = simulate(nominal(*contact, *method))
        equal = ["driveline.shafts[1].stiffness=[31.3, 31.3]", "driveline.shafts[1].breakpoints_deg=[-1.0]"]
        run = simulate(nominal(*contact, *method, *equal))
        assert len(run.phases) > len(run.events)
        assert kinds_of(run) == kinds_of(plain)
        assert run.events["time"] == pytest.approx(plain.events["time"], abs=1e-10)
        assert run.impact_severity == pytest.approx(plain.impact_severity, rel=1e-8, nan_ok=True)

    def test_a_sweep_has_the_runs_of_simulate(self, contact, method):
        """Stages are not written in a sweep, and do not count as events."""
        axis = ["sweep.axes=[{parameter='load.ratio', values=[2.0, 5.0]}]"]
        study = nominal(*contact, *method, *STAGES, *axis)
        results = sweep(study, workers=1)
        for k, ratio in enumerate((2.0, 5.0)):
            run = simulate(replace_values(study, {"load.ratio": ratio}))
            assert results.label_map[k] == run.label
            assert results.touches[k] == run.touches
            assert results.severity[k] == pytest.approx(run.severity, rel=1e-12, nan_ok=True)
            assert results.last_event_time[k] == run.events["time"][-1]
            exactly_enough = replace_values(study, {"load.ratio": ratio}).model_copy(
                update={"solver": study.solver.model_copy(update={"max_events": max(len(run.events) - 1, 1)})}
            )
            assert simulate(exactly_enough).label == run.label

    def test_a_mirrored_driveline_is_mirrored(self, contact, method):
        """The load and the breakpoints with the other sign: the same times, the other flanks."""
        run = simulate(nominal(*contact, *method, *STAGES))
        other = ["driveline.shafts[1].breakpoints_deg=[-2.0, 4.0]", "load.static_torque=1.0"]
        mirrored = simulate(nominal(*contact, *method, *STAGES[:1], *other))
        assert mirrored.label == run.label
        assert mirrored.events["time"] == pytest.approx(run.events["time"], abs=1e-13)
        assert np.array_equal(mirrored.events["side"], -run.events["side"])


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


def test_both_methods_agree_and_energy_closes():
    """rk4's error at this step is some 1e-8 s here; its energy closes as without stages."""
    run, other = simulate(nominal(*EXACT, *STAGES)), simulate(nominal(*RK4, *STAGES))
    assert kinds_of(run) == kinds_of(other)
    assert other.events["time"] == pytest.approx(run.events["time"], abs=5e-8)
    assert balance(run).relative_residual < 1e-11
    assert balance(other).relative_residual < 1e-8


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


def test_histories_pass_through_the_breakpoints():
    """Between samples the speed changes by the acceleration there, also behind a change of stage: 10 µs, some 1e-4."""
    run = simulate(nominal(*EXACT, *STAGES))
    history = sample(run, step=1e-5, until=0.3)
    steps = np.diff(history.time)
    middle = (history.acceleration[1:, 0] + history.acceleration[:-1, 0]) / 2.0
    change = np.diff(history.velocity[:, 0])
    assert np.count_nonzero(history.event >= 0) == np.count_nonzero(run.events["time"] <= history.after_step[-1])
    assert change == pytest.approx(middle * steps, abs=1e-9 * np.abs(history.velocity[:, 0]).max())
    assert len(run.phases) > len(run.events)


def test_a_stage_without_stiffness_may_not_carry_the_load():
    """A branch that carries no torque is loose in a stage without stiffness; with stiffness it is not."""
    branch = """
[driveline]
inertias = [0.024, 0.002, 0.002, 0.002, 0.001]
[[driveline.shafts]]
between = [1, 2]
stiffness = 31.3
damping = 0.08
[[driveline.shafts]]
between = [2, 3]
stiffness = 31.3
damping = 0.04
[[driveline.shafts]]
between = [4, "ground"]
stiffness = 31.3
damping = 0.1
[[driveline.shafts]]
between = [2, 5]
stiffness = [20.0, 0.0, 20.0]
breakpoints_deg = [-1.0, 1.0]
damping = 0.001
[lash]
between = [3, 4]
backlash_deg = 6.0
radius = 0.08
[lash.contact]
stiffness = 4.092e5
damping = 94.0
[load]
on = 1
static_torque = -1.0
ratio = 5.0
[solver]
method = "exact"
[impacts]
acceleration_of = 3
"""
    with pytest.raises(ClunkError, match="No steady motion"):
        simulate(study_from_text(branch))
    soft = branch.replace("0.0, 20.0]", "1e-3, 20.0]")
    assert simulate(study_from_text(soft)).label == simulate(study_from_text(soft.replace("exact", "rk4"))).label


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (STAGES[:1], "there is one stiffness more than there are breakpoints_deg"),
        (STAGES[1:], "there is one stiffness more than there are breakpoints_deg"),
        ([STAGES[0], "driveline.shafts[1].breakpoints_deg=[2.0, -4.0]"], "must be in ascending order"),
        ([STAGES[0], "driveline.shafts[1].breakpoints_deg=[2.0, 2.0]"], "must be in ascending order"),
        (["driveline.shafts[1].stiffness=[1.0, -1.0, 1.0]", STAGES[1]], "0 or greater"),
        (
            [*STAGES, "sweep.axes=[{parameter='driveline.shafts[1].stiffness', start=1.0, stop=2.0, count=2}]"],
            "has 3 stages",
        ),
        (
            ["sweep.axes=[{parameter='driveline.shafts[2].stiffness[1]', start=1.0, stop=2.0, count=2}]"],
            "is one number",
        ),
        (
            [*STAGES, "sweep.axes=[{parameter='driveline.shafts[1].breakpoints_deg[1]', start=-5, stop=2, count=3}]"],
            "breakpoints must be in ascending order",
        ),
    ],
)
def test_what_cannot_be_is_refused(overrides, text):
    with pytest.raises(ConfigError) as error:
        nominal(*overrides)
    assert text in " ".join(str(error.value).split())


def test_stages_and_breakpoints_are_swept():
    """A stage as stiff as its neighbours is the plain shaft."""
    axes = "sweep.axes=[{parameter='driveline.shafts[1].stiffness[2]', values=[10.0, 31.3]}]"
    results = sweep(nominal(*EXACT, *STAGES, axes), workers=1)
    assert results.severity[1] == pytest.approx(simulate(nominal(*EXACT)).severity, rel=1e-9)
    assert results.severity[0] == pytest.approx(simulate(nominal(*EXACT, *STAGES)).severity, rel=1e-12)
