"""Gear ratios on shafts and lashes: a geared driveline moves as the same one reflected by hand does."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference

from clunk.core.events import KIND_NAMES, LOCK
from clunk.simulation.driveline import Driveline
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.small_gap import one_mode_thresholds, rigid_contact_thresholds
from clunk.simulation.system import build
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.study import replace_values

CONTACTS = {
    "separation by gap": {"separation": "gap"},
    "separation by force": {"separation": "force"},
    "restitution": {"restitution": 0.5},
    "plastic restitution": {"restitution": 0.0},
}
METHODS = ("rk4", "exact")
PLAIN = np.ones(4)
BINARY = np.array([1.0, 0.5, -4.0, 0.25])  # no scaling rounds, but LAPACK may sum in another order; the lash reverses
DECIMAL = np.array([1.3, 4.81, -0.37, 0.12])


def lever(plant, turns):
    """The twist of the geared lash over that of the plant's own."""
    return _lever_and_ratio(plant.lash, turns)[0]


def geared(plant, turns, method="rk4"):
    """The study of a plant with gears put into it, such that its motion stays what it is.

    Inertia k then turns by `turns[k]` times its angle before, has its inertia over that squared and its torque over
    that; a joint, whose twist is θa - i θb with i = turns[a]/turns[b], has the stiffness and damping over turns[a]²,
    and a gap |turns[a]| times as wide. The reverse is how an engineer reflects a driveline by hand.
    """
    ratios, shafts = {}, []
    for number, (one, other, stiffness, damping) in enumerate(plant.shafts, 1):
        length, ratio = _lever_and_ratio((one, other), turns)
        ratios[f"driveline.shafts[{number}].ratio"] = ratio
        shafts.append((one, other, stiffness / length**2, damping / length**2))
    length, ratios["lash.ratio"] = _lever_and_ratio(plant.lash, turns)
    torque = 1.0 / float(turns[plant.loaded - 1])
    driveline = replace(
        plant,
        inertias=tuple(float(j) for j in np.array(plant.inertias) / np.square(turns)),
        shafts=tuple(shafts),
        contact_stiffness=plant.contact_stiffness / length**2,
        contact_damping=plant.contact_damping / length**2,
        backlash=plant.backlash * abs(length),
        before=plant.before * torque,
        after=plant.after * torque,
    )
    return replace_values(reference.study_of(driveline, method, end_time=1.0), ratios)


def _lever_and_ratio(ends, turns):
    one, other = ends
    length = float(turns[(other if one == "ground" else one) - 1])
    return length, 1.0 if "ground" in ends else length / float(turns[other - 1])


def assert_same_motion(trajectory, plain, plant, turns, rounding):
    """Times, labels and margins are equal; angles, speeds and severities are those of each inertia's own turns."""
    twist = lever(plant, turns)
    assert trajectory.label == plain.label
    assert np.array_equal(trajectory.events["kind"], plain.events["kind"])
    assert np.array_equal(trajectory.events["side"], np.sign(twist) * plain.events["side"])
    assert np.array_equal(trajectory.flanks, plain.flanks)
    largest = np.abs(plain.states).max(axis=0)
    assert trajectory.events["time"] == pytest.approx(plain.events["time"], abs=rounding)
    assert trajectory.events["speed"] / twist == pytest.approx(plain.events["speed"], abs=rounding * 100.0)
    assert np.all(np.abs(trajectory.states / np.tile(turns, 2) - plain.states) <= 100.0 * rounding * largest)
    severity = trajectory.impact_severity / abs(turns[plant.acceleration_of - 1])
    assert severity == pytest.approx(plain.impact_severity, rel=1e3 * rounding, nan_ok=True)
    assert trajectory.margin == pytest.approx(plain.margin, rel=1e-6, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
@pytest.mark.parametrize(("turns", "rounding"), [(BINARY, 1e-12), (DECIMAL, 1e-10)], ids=["binary", "decimal"])
def test_a_geared_driveline_moves_as_the_reflected_one(turns, rounding, contact, method):
    plant = reference.Plant(**contact)
    plain = simulate(geared(plant, PLAIN, method=method))
    trajectory = simulate(geared(plant, turns, method=method))
    assert trajectory.touches > 0
    assert_same_motion(trajectory, plain, plant, turns, rounding)
    assert balance(trajectory).relative_residual == pytest.approx(balance(plain).relative_residual, abs=1e-10)
    for term in ("work", "stored_before", "damped_in_contact", "lost_at_impacts", "dropped"):
        assert getattr(balance(trajectory), term) == pytest.approx(getattr(balance(plain), term), rel=1e-7, abs=1e-12)


TO_GROUND = reference.Plant(
    shafts=((1, 2, 31.3, 0.08), (2, 3, 31.3, 0.04), (3, 4, 31.3, 0.1), (1, "ground", 0.0, 0.1)), lash=("ground", 4)
)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
class TestLashToGround:
    @pytest.mark.parametrize("ratio", [2.5, -2.5])
    def test_with_ground_as_its_first_end_q_is_ratio_times_the_angle(self, ratio, contact, method):
        """q = -i θ: a gap i times as wide, with a contact 1/i² times as stiff, is the same one."""
        study = geared(replace(TO_GROUND, **contact), PLAIN, method=method)
        flanks = study.lash.contact
        values = {"lash.ratio": ratio, "lash.backlash_deg": study.lash.backlash_deg * abs(ratio)}
        values |= {
            "lash.contact.stiffness": flanks.stiffness / ratio**2,
            "lash.contact.damping": flanks.damping / ratio**2,
        }
        plain, trajectory = simulate(study), simulate(replace_values(study, values))
        assert trajectory.touches > 0
        assert np.array_equal(trajectory.events["side"], np.sign(ratio) * plain.events["side"])
        assert trajectory.events["time"] == pytest.approx(plain.events["time"], abs=1e-10)
        assert trajectory.events["speed"] / ratio == pytest.approx(plain.events["speed"], abs=1e-8)
        assert trajectory.states == pytest.approx(plain.states, abs=1e-8)


def test_modes_thresholds_and_the_contact_period_are_those_of_the_reflected_driveline():
    plant = reference.Plant()
    plain, study = geared(plant, PLAIN), geared(plant, DECIMAL)
    ours, theirs = Driveline.from_study(study), Driveline.from_study(plain)
    for closed in (True, False):
        assert ours.modes(closed=closed).frequency == pytest.approx(theirs.modes(closed=closed).frequency, rel=1e-9)
        assert ours.modes(closed=closed).damping_ratio == pytest.approx(
            theirs.modes(closed=closed).damping_ratio, rel=1e-9
        )
    assert ours.contact_periods[0] == pytest.approx(theirs.contact_periods[0], rel=1e-14)
    assert one_mode_thresholds(study) == pytest.approx(one_mode_thresholds(plain), rel=1e-9)
    assert rigid_contact_thresholds(study) == pytest.approx(rigid_contact_thresholds(plain), rel=1e-9)
    carried = build(study).contact_torque[0, 0, 0] * lever(plant, DECIMAL) / DECIMAL[0]
    assert carried == pytest.approx(build(plain).contact_torque[0, 0, 0], rel=1e-9)


def test_the_torque_behind_a_gear_is_ratio_times_its_opposite():
    """A shaft of ratio 3 between two inertias to ground by their own: K is [[k + k1, -3k], [-3k, 9k + k2]]."""
    plant = reference.Plant(
        inertias=(0.01, 0.09),
        shafts=((1, 2, 10.0, 0.1), ("ground", 2, 5.0, 0.2)),
        ratios=(3.0, -2.0),
        lash=(1, 2),
        lash_ratio=3.0,
        contact_stiffness=1e3,
        contact_damping=0.5,
        backlash=np.deg2rad(1.0),
        acceleration_of=1,
    )
    study = reference.study_of(plant, method="rk4")
    driveline = Driveline.from_study(study)
    assert driveline.matrices(closed=False)[1] == pytest.approx(
        np.array([[10.0, -30.0], [-30.0, 90.0 + 20.0]]), rel=1e-14
    )
    assert driveline.matrices(closed=False)[0] == pytest.approx(np.array([[0.1, -0.3], [-0.3, 0.9 + 0.8]]), rel=1e-14)
    assert driveline.contact_periods[0] == pytest.approx(
        2.0 * np.pi / np.sqrt(1e3 * (1.0 / 0.01 + 9.0 / 0.09)), rel=1e-14
    )
    history = sample(simulate(study), until=0.3)
    q = history.angle[:, 0] - 3.0 * history.angle[:, 1]
    assert history.backlash_coordinate == pytest.approx(0.1 * q, abs=1e-15)


@pytest.mark.parametrize("turns", [DECIMAL, DECIMAL[::-1].copy()], ids=["a gear down", "a gear up"])
def test_flanks_that_lock_have_no_relative_speed_to_the_last_bit(turns):
    trajectory = simulate(geared(reference.Plant(restitution=0.5), turns))
    locks = np.flatnonzero(trajectory.events["kind"] == LOCK)
    ratio = trajectory.study.lash.ratio
    assert locks.size > 0
    for k in locks:
        speed = trajectory.states[k, 4:]
        assert speed[2] - ratio * speed[3] == 0.0, KIND_NAMES[trajectory.events["kind"][k]]


CAR = """
[driveline]
inertias = [0.2, 0.02, 0.9, 120.0]
names = ["engine", "gearbox", "wheels", "vehicle"]
shafts = [
    {{between = ["gearbox", "wheels"], ratio = {reverse}12.0, stiffness = 60.0, damping = 0.05}},
    {{between = ["wheels", "vehicle"], stiffness = 2e4, damping = 30.0}},
]
[lash]
between = ["engine", "gearbox"]
backlash_deg = 3.0
radius = 0.04
contact = {{stiffness = 1e6, damping = 200.0}}
[load]
on = "engine"
initial_torque = 100.0
final_torque = 0.0
"""


@pytest.mark.parametrize("reverse", ["", "-"])
def test_the_lowest_mode_of_a_free_driveline_is_its_shuffle(reverse):
    """Engine and gearbox against wheels and vehicle, as the engine sees them: two inertias, three springs in series.

    The wheels' own motion, 0.7 % of the inertia on their side, is all that this leaves out.
    """
    driveline = Driveline.from_study(study_from_text(CAR.format(reverse=reverse)))
    stiffness = 1.0 / (1.0 / 60.0 + 144.0 / 2e4 + 1.0 / 1600.0)
    frequency = np.sqrt(stiffness * (1.0 / 0.22 + 144.0 / 120.9)) / (2.0 * np.pi)
    assert driveline.modes(closed=True).frequency[0] == pytest.approx(frequency, rel=0.007)
    shares = driveline.modes(closed=True).energy_shares
    assert shares.sum(axis=1) == pytest.approx(np.ones(len(shares)), rel=1e-14)
    assert shares[0, :2].sum() == pytest.approx((1.0 / 0.22) / (1.0 / 0.22 + 144.0 / 120.9), abs=0.02)
