"""Laws of physics that hold whatever the driveline: symmetry, scaling, energy, and the limits of the map."""

from typing import get_args

import numpy as np
import pytest
from helpers import reference

from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.models import Solver
from clunk.study.parameters import nominal_value
from clunk.study.study import replace_values

POINTS = [(2.0, 6.0), (5.0, 6.0), (10.0, 10.0), (7.0, 0.0), (-2.5, 3.0)]


def at(study, ratio, backlash, **values):
    return replace_values(study, {"load.ratio": ratio, "lash.backlash_deg": backlash, **values})


def with_contact(study, **changes):
    contact = study.lash.contact.model_copy(update=changes)
    return study.model_copy(update={"lash": study.lash.model_copy(update={"contact": contact})})


def by_method(study, method):
    return study.model_copy(update={"solver": study.solver.model_copy(update={"method": method})})


def agree(found, expected, method, within=1e-11):
    """By rk4 to the last bit, since a power of two or a sign is exact in every sum; by another method to rounding."""
    found, expected = np.asarray(found), np.asarray(expected)
    if method == "rk4":
        return np.array_equal(found, expected, equal_nan=True)
    scale = np.max(np.abs(expected), initial=0.0, where=np.isfinite(expected))
    return found.shape == expected.shape and np.allclose(
        found, expected, rtol=within, atol=within * scale, equal_nan=True
    )


def mirrored(study):
    """-T for T."""
    return {"load.static_torque": -study.load.static_torque}


def doubled(study):
    """Twice the torque in twice the gap; all else is piecewise linear."""
    return {"load.static_torque": 2.0 * study.load.static_torque, "lash.backlash_deg": 2.0 * study.lash.backlash_deg}


def slowed(study):
    """J → 4 J, c → 2 c, t → 2 t leaves J θ'' + c θ' + k θ = T as it is."""
    slower = {f"driveline.inertias[{k}]": 4.0 * inertia for k, inertia in enumerate(study.driveline.inertias, 1)}
    for k, shaft in enumerate(study.driveline.shafts, 1):
        slower[f"driveline.shafts[{k}].damping"] = 2.0 * shaft.damping
    slower["lash.contact.damping"] = 2.0 * study.lash.contact.damping
    keys = ("solver.step", "solver.end_time", "impacts.sticking_time")
    return slower | {key: 2.0 * nominal_value(study, key) for key in keys}


# the change of a study, and what it multiplies angles and times by
LAWS = {"mirrored": (mirrored, -1.0, 1.0), "doubled": (doubled, 2.0, 1.0), "slowed": (slowed, 1.0, 2.0)}
CONTACTS = [{"separation": "gap"}, {"separation": "force"}, {"model": "restitution"}]


@pytest.mark.parametrize("method", get_args(Solver.model_fields["method"].annotation))
@pytest.mark.parametrize(("ratio", "backlash"), POINTS)
@pytest.mark.parametrize("contact", CONTACTS, ids=str)
@pytest.mark.parametrize("law", LAWS)
def test_a_motion_scales_with_its_driveline_and_its_load(nominal, law, ratio, backlash, contact, method):
    """And a mirrored load swaps the flanks.

    Chatter divides the gap's rounding by ever shorter flights, and where flanks graze it decides when they part; a
    stiff contact turns 1e-11 of the speeds into more than that of the accelerations of a weak impact.
    """
    changed, angle, time = LAWS[law]
    study = by_method(with_contact(at(nominal, ratio, backlash, **{"impacts.sticking_time": 0.004}), **contact), method)
    one, other = simulate(study), simulate(replace_values(study, changed(study)))
    n, speed = len(study.driveline.inertias), angle / time
    assert other.initial_side == np.sign(angle) * one.initial_side
    assert np.array_equal(other.events["kind"], one.events["kind"])
    assert np.array_equal(other.events["side"], np.sign(angle) * one.events["side"])
    assert agree(other.events["time"], time * one.events["time"], method)
    assert agree(other.events["speed"], speed * one.events["speed"], method)
    assert agree(other.states[:, :n], angle * one.states[:, :n], method)
    assert agree(other.states[:, n:], speed * one.states[:, n:], method)
    assert other.label == one.label
    assert agree(other.impact_severity, abs(speed / time) * one.impact_severity, method, within=1e-10)
    assert agree(other.severity, abs(speed / time) * one.severity, method, within=1e-10)
    assert agree(other.approach_velocity, abs(speed) * one.approach_velocity, method)
    assert agree(other.margin, one.margin, method, within=1e-9)


def test_the_motion_dies_out_in_static_contact_under_the_torque_after_the_step(nominal):
    """12 s after it, the slowest mode (ζω = 2.45 1/s) has fallen to 2e-13."""
    _, rest = reference.boere(0.0, 6.0).preload()
    history = sample(simulate(nominal), step=0.1, until=12.1)
    assert history.angle[-1] == pytest.approx(rest[:4], abs=1e-11)
    assert history.velocity[-1] == pytest.approx(0.0, abs=1e-11)
