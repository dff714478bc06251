"""Laws of physics that hold whatever the driveline: symmetry, scaling, energy, and the limits of the map."""

from typing import get_args

import numpy as np
import pytest
from helpers import reference

from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.errors import ClunkError
from clunk.study.models import Solver
from clunk.study.parameters import get_value
from clunk.study.study import replace_values

POINTS = [(2.0, 6.0), (5.0, 6.0), (10.0, 10.0), (7.0, 0.0), (-2.5, 3.0)]


def at(study, ratio, backlash, **values):
    return replace_values(study, {"load.ratio": ratio, "lash.backlash_deg": backlash, **values})


def with_contact(study, **changes):
    contact = study.lash.contact.model_copy(update=changes)
    return study.model_copy(update={"lash": study.lash.model_copy(update={"contact": contact})})


def by_force(study):
    return with_contact(study, separation="force")


def by_restitution(study):
    return with_contact(study, model="restitution")


def by_method(study, method):
    return study.model_copy(update={"solver": study.solver.model_copy(update={"method": method})})


def agree(found, expected, method, within=1e-12):
    """By rk4 to the last bit, since a power of two or a sign is exact in every sum; by another method to rounding."""
    found, expected = np.asarray(found), np.asarray(expected)
    if method == "rk4":
        return np.array_equal(found, expected, equal_nan=True)
    scale = np.max(np.abs(expected), initial=0.0, where=np.isfinite(expected))
    return found.shape == expected.shape and np.allclose(
        found, expected, rtol=within, atol=within * scale, equal_nan=True
    )


@pytest.mark.parametrize("method", get_args(Solver.model_fields["method"].annotation))
@pytest.mark.parametrize(("ratio", "backlash"), POINTS)
@pytest.mark.parametrize(
    "contact", [lambda study: study, by_force, by_restitution], ids=["gap", "force", "restitution"]
)
class TestSymmetry:
    def test_mirrored_load_swaps_flanks(self, nominal, ratio, backlash, contact, method):
        """-T for T changes the sign of every angle and of nothing else."""
        study = by_method(contact(at(nominal, ratio, backlash)), method)
        one, other = simulate(study), simulate(replace_values(study, {"load.static_torque": 1.0}))
        assert other.initial_side == -one.initial_side
        assert np.array_equal(other.events["side"], -one.events["side"])
        assert agree(other.events["time"], one.events["time"], method)
        assert np.array_equal(other.events["kind"], one.events["kind"])
        assert agree(other.states, -one.states, method)
        assert other.label == one.label
        assert agree(other.impact_severity, one.impact_severity, method)
        assert agree(other.margin, one.margin, method)

    def test_twice_the_torque_in_twice_the_gap_is_twice_the_motion(self, nominal, ratio, backlash, contact, method):
        """Piecewise linear: equal times, twice the speeds."""
        study = by_method(contact(at(nominal, ratio, backlash)), method)
        one = simulate(study)
        other = simulate(at(study, ratio, 2.0 * backlash, **{"load.static_torque": -2.0}))
        assert np.array_equal(other.events["kind"], one.events["kind"])
        assert agree(other.events["time"], one.events["time"], method)
        assert agree(other.events["speed"], 2.0 * one.events["speed"], method)
        assert agree(other.states, 2.0 * one.states, method)
        assert other.label == one.label
        assert agree(other.impact_severity, 2.0 * one.impact_severity, method)
        assert agree(other.severity, 2.0 * one.severity, method)
        assert agree(other.approach_velocity, 2.0 * one.approach_velocity, method)
        assert agree(other.margin, one.margin, method)

    def test_four_times_the_inertia_and_twice_the_damping_is_half_the_pace(
        self, nominal, ratio, backlash, contact, method
    ):
        """J → 4 J, c → 2 c, t → 2 t leaves J θ'' + c θ' + k θ = T as it is: equal angles, half the speeds."""
        study = by_method(contact(at(nominal, ratio, backlash)), method)
        slower = {f"driveline.inertias[{k}]": 4.0 * inertia for k, inertia in enumerate(study.driveline.inertias, 1)}
        for k, shaft in enumerate(study.driveline.shafts, 1):
            slower[f"driveline.shafts[{k}].damping"] = 2.0 * shaft.damping
        slower["lash.contact.damping"] = 2.0 * study.lash.contact.damping
        for key in ("solver.step", "solver.end_time"):
            slower[key] = 2.0 * get_value(study, key)
        one = simulate(replace_values(study, {"impacts.sticking_time": 0.004}))
        other = simulate(replace_values(study, slower | {"impacts.sticking_time": 0.008}))
        n = len(study.driveline.inertias)
        assert np.array_equal(other.events["kind"], one.events["kind"])
        assert np.array_equal(other.events["side"], one.events["side"])
        assert agree(other.events["time"], 2.0 * one.events["time"], method)
        # chatter divides the gap's rounding by ever shorter flights, and where flanks graze it decides when they part
        assert agree(other.events["speed"], one.events["speed"] / 2.0, method, within=1e-11)
        assert agree(other.states[:, :n], one.states[:, :n], method, within=1e-11)
        assert agree(other.states[:, n:], one.states[:, n:] / 2.0, method, within=1e-11)
        assert other.label == one.label
        # a stiff contact turns 1e-11 of the speeds into more than that of the accelerations of a weak impact
        assert agree(other.impact_severity, one.impact_severity / 4.0, method, within=1e-10)
        assert agree(other.approach_velocity, one.approach_velocity / 2.0, method, within=1e-11)
        assert agree(other.margin, one.margin, method, within=1e-9)


def energy(plant, state):
    """Kinetic and shaft energy, and the potential of the constant torque  [J]; (events,) for rows of states."""
    _, stiffness = plant.open_matrices()
    theta, speed = state[:, : plant.n], state[:, plant.n :]
    kinetic = 0.5 * speed**2 @ np.array(plant.inertias)
    elastic = 0.5 * np.einsum("ek,kj,ej->e", theta, stiffness, theta)
    return kinetic + elastic - plant.after * theta @ plant.load


def test_no_released_torque_no_motion(nominal):
    """σr = 0: the load step is none."""
    trajectory = simulate(at(nominal, 0.0, 6.0))
    assert trajectory.label == "NI"
    assert len(trajectory.events) == 1
    assert trajectory.severity == 0.0
    assert trajectory.approach_velocity == 0.0
    assert trajectory.complete


def test_no_torque_before_the_load_step_no_initial_flank(nominal):
    """σr = -1: T(0⁻) = 0, and nothing says where in the gap the driveline rests."""
    with pytest.raises(ClunkError, match="initial flank"):
        simulate(at(nominal, -1.0, 6.0))


@pytest.mark.parametrize("ratio", [-1.5, -2.0, -3.0])
def test_a_load_that_changes_sign_ends_on_the_other_flank(nominal, ratio):
    """σr < -1: the preload is on the positive flank, the final load rests on the negative one; the crossing stays."""
    trajectory = simulate(at(nominal, ratio, 6.0))
    assert trajectory.initial_side == 1
    assert trajectory.label.endswith("CR(1)")
    assert trajectory.events["side"][-1] == -1
    assert trajectory.complete


def test_the_motion_dies_out_in_static_contact_under_the_torque_after_the_step(nominal):
    """12 s after it, the slowest mode (ζω = 2.45 1/s) has fallen to 2e-13."""
    _, rest = reference.boere(0.0, 6.0).preload()
    history = sample(simulate(nominal), step=0.1, until=12.1)
    assert history.angle[-1] == pytest.approx(rest[:4], abs=1e-11)
    assert history.velocity[-1] == pytest.approx(0.0, abs=1e-11)


class TestVanishingBacklash:
    """φθ = 0: the flanks change without a gap, and an impact is a change of sign of the contact torque."""

    RIGID = (1.432, 3.072, 6.606, 14.207)  # of the 3 degrees of freedom with the lash locked, computed independently

    def threshold(self, study, count, low, high):
        """The load ratio from which on there are `count` double-sided impacts, to 1e-5."""
        while high - low > 1e-5:
            middle = 0.5 * (low + high)
            if len(simulate(at(study, middle, 0.0)).primaries) >= 2 * count:
                high = middle
            else:
                low = middle
        assert simulate(at(study, high, 0.0)).label == f"DS({count})"
        return high

    @pytest.mark.parametrize("count", [1, 2, 3, 4])
    def test_a_stiff_contact_has_the_thresholds_of_a_rigid_one(self, nominal, count):
        """The nominal contact moves them by less than 1e-3; one 25 times as stiff by a 25th of that."""
        rigid = self.RIGID[count - 1]
        assert self.threshold(nominal, count, 0.9 * rigid, 1.1 * rigid) == pytest.approx(rigid, rel=1e-3)
        stiffer = {"lash.contact.stiffness": 25 * 4.092e5, "lash.contact.damping": 5 * 94.0, "solver.step": 2e-5}
        study = replace_values(nominal, stiffer)
        assert self.threshold(study, count, 0.9 * rigid, 1.1 * rigid) == pytest.approx(rigid, abs=1e-3)


class TestStickingTime:
    def test_no_episode_of_the_nominal_run_is_near_it(self, nominal):
        """Rebounds last at most 0.85 T_c, sticking at least 1.2 T_c: the label does not hang on the rule."""
        period = reference.boere(5.0, 6.0).contact_period()
        labels = {
            simulate(at(nominal, 5.0, 6.0, **{"impacts.sticking_time": share * period})).label
            for share in (0.86, 1.0, 1.19)
        }
        assert labels == {"DS(1)SS(1)"}

    def test_it_decides_what_is_primary(self, nominal):
        """Far below a rebound it makes every touch primary; beyond the run, none on the same flank."""
        every = simulate(at(nominal, 5.0, 6.0, **{"impacts.sticking_time": 1e-9}))
        assert len(every.primaries) == every.touches == 9
        none = simulate(at(nominal, 5.0, 6.0, **{"impacts.sticking_time": 10.0}))
        assert none.label == "DS(1)"
        assert np.array_equal(none.events["time"], every.events["time"])
