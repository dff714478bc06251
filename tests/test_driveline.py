"""The report's driveline and other ones: matrices, modes, preload, and every event of chains with 1 to 8 inertias."""

import numpy as np
import pytest
from helpers import reference

import clunk
from clunk.simulation.driveline import Driveline
from clunk.simulation.energy import balance
from clunk.simulation.small_gap import one_mode_thresholds, rigid_contact_thresholds
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text


def test_the_matrices_are_those_of_equation_2_6(nominal):
    """J, C and K of the open chain, and the load on J1; c34 does not belong in them: there is no contact in the gap."""
    driveline = Driveline.from_study(nominal)
    d1, c12, c23, d4, k12, k23, k4 = 0.1, 0.08, 0.04, 0.1, 31.3, 31.3, 31.3
    damping = [[d1 + c12, -c12, 0, 0], [-c12, c12 + c23, -c23, 0], [0, -c23, c23, 0], [0, 0, 0, d4]]
    stiffness = [[k12, -k12, 0, 0], [-k12, k12 + k23, -k23, 0], [0, -k23, k23, 0], [0, 0, 0, k4]]
    assert np.array_equal(driveline.inertia, [0.024, 0.002, 0.002, 0.002])
    assert driveline.matrices(closed=False)[0] == pytest.approx(np.array(damping), abs=1e-17)
    assert driveline.matrices(closed=False)[1] == pytest.approx(np.array(stiffness), abs=1e-14)
    assert np.array_equal(driveline.lashes[0], [0, 0, 1, -1])
    assert np.array_equal(driveline.load, [1, 0, 0, 0])
    assert driveline.rigid_motion.shape.size == 0


def test_the_natural_frequencies_are_those_of_the_report(nominal):
    """3.2, 16.2, 30.8 and 258.3 Hz; 10 to 20 % damping. The further digits were computed independently."""
    modes = Driveline.from_study(nominal).modes(closed=True)
    assert modes.frequency[:3] == pytest.approx([3.220, 16.203, 30.786], abs=6e-4)
    assert modes.frequency[3] == pytest.approx(258.31, abs=6e-3)
    assert modes.damping_ratio == pytest.approx([0.121, 0.146, 0.175, 0.196], abs=6e-4)
    assert modes.overdamped.size == 0


def test_the_inertias_as_printed_do_not_have_them(as_printed):
    modes = Driveline.from_study(as_printed).modes(closed=True)
    assert modes.frequency == pytest.approx([2.53, 6.11, 10.4, 81.7], rel=5e-3)
    assert modes.damping_ratio == pytest.approx([0.089, 0.064, 0.071, 0.062], abs=6e-4)


def test_the_open_chain_can_drift(nominal):
    """Two chains: 4 on its shaft to ground, f = sqrt(31.3/0.002)/2π; and 1, 2, 3 held by nothing but a damper."""
    modes = Driveline.from_study(nominal).modes(closed=False)
    assert modes.frequency.size == 3
    assert np.min(np.abs(modes.frequency - np.sqrt(31.3 / 0.002) / (2.0 * np.pi))) < 1e-9
    assert modes.overdamped[0] == pytest.approx(0.0, abs=1e-9)
    assert modes.overdamped[1] > 1.0


def test_slow_modes_are_found_beside_a_part_that_all_but_weighs_nothing(nominal):
    """Inertia 3 is between a shaft and the lash: whatever little it weighs, the rest swings as it does without it."""
    light = clunk.replace_values(nominal, {"driveline.inertias[3]": 1e-10})
    lighter = clunk.replace_values(light, {"driveline.inertias[3]": 1e-12})
    for closed in (True, False):
        modes, others = (Driveline.from_study(study).modes(closed=closed) for study in (light, lighter))
        assert others.frequency == pytest.approx(modes.frequency, rel=1e-6)
        # LAPACK's rounding of the slowest is that of the fastest decay, 6e11 1/s
        assert others.overdamped[:-1] == pytest.approx(modes.overdamped[:-1], rel=1e-5, abs=1e-4)


def test_a_part_that_all_but_weighs_nothing_changes_nothing(nominal):
    """Its springs are 1e16 times as stiff for it as the softest mode is for the rest."""
    by_modes = nominal.but(solver=nominal.solver.but(method="exact"))
    runs = [simulate(clunk.replace_values(by_modes, {"driveline.inertias[3]": each})) for each in (1e-9, 1e-12)]
    assert len(runs[0].events) > 5
    assert runs[1].events["time"] == pytest.approx(runs[0].events["time"], abs=1e-8)
    assert runs[1].approach_velocity == pytest.approx(runs[0].approach_velocity, rel=1e-6)
    # the rounding of the fastest rate, 6e11 1/s, is 1e-4 1/s, and the run lasts 1 s; what it lost of the others was all
    assert balance(runs[1]).relative_residual < 1e-5


def test_an_inertia_between_rigid_flanks_has_no_modes_where_they_hold_it():
    lash = '{between = [1, "ground"], backlash_deg = 60.0, radius = 0.1, contact = {model = "restitution"}}'
    ball = f"driveline = {{inertias = [0.5], shafts = []}}\nlash = {lash}\nload = {{static_torque = 5.0, ratio = -2.0}}"
    assert Driveline.from_study(study_from_text(ball)).modes(closed=True).frequency.size == 0


def test_the_thresholds_are_those_of_table_3_1(nominal):
    """1.46, 3.13, 6.69 and 14.32 in the report; with the first mode's damping ratio, one more digit each."""
    assert one_mode_thresholds(nominal) == pytest.approx([1.463, 3.129, 6.693, 14.317], abs=6e-4)


def test_the_thresholds_of_a_rigid_contact_are_the_exact_ones(nominal):
    assert rigid_contact_thresholds(nominal) == pytest.approx([1.432, 3.072, 6.606, 14.207], abs=6e-4)


def test_the_contact_period_is_that_of_the_two_inertias_at_the_lash(nominal):
    """3.88 ms, which is 1/f4 but for the shafts."""
    driveline = Driveline.from_study(nominal)
    assert driveline.contact_periods[0] == pytest.approx(3.88e-3, abs=5e-6)
    assert driveline.contact_periods[0] == pytest.approx(2 * np.pi * np.sqrt(0.001 / 2618.88), rel=1e-12)
    assert driveline.contact_periods[0] == pytest.approx(1.0 / driveline.modes(closed=True).frequency[-1], rel=0.01)


def single(between=(1, "ground")):
    """The study of an inertia with nothing but a lash to ground."""
    plant = reference.Plant((0.002,), (), between, 1e3, 0.5, np.deg2rad(1.0), acceleration_of=1)
    return reference.study_of(plant, method="rk4")


class TestLashToGround:
    @pytest.mark.parametrize(("between", "sign"), [((1, "ground"), 1), (("ground", 1), -1)])
    def test_the_order_of_its_ends_is_the_sign_of_q(self, between, sign):
        """The same motion; only which side of the gap is called positive differs."""
        driveline = Driveline.from_study(single(between))
        assert np.array_equal(driveline.lashes[0], [sign])
        trajectory = simulate(single(between))
        assert trajectory.initial_side == -sign
        assert trajectory.states[0, 0] == pytest.approx(-np.deg2rad(0.5) - 6.0 / 1e3, rel=1e-12)
        assert np.array_equal(trajectory.states, simulate(single()).states)
        assert trajectory.label == simulate(single()).label
