"""Several lashes: both methods beside the independent reference, and known special cases."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.reference import Lash, Plant

import clunk
from clunk.core.events import LOCK, TOUCH
from clunk.core.status import Status
from clunk.simulation.system import build
from clunk.simulation.trajectory import simulate
from clunk.study.errors import ClunkError

END_TIME = 0.3  # s
GEARBOX = Lash((2, 3), 0.05, 2600.0, 0.6)
AXLE = Lash((3, 4), 0.02, 2600.0, 0.6)
CHAIN = Plant(
    inertias=(0.024, 0.002, 0.003, 0.002),
    shafts=((1, 2, 31.3, 0.08), (4, "ground", 31.3, 0.1), (1, "ground", 0.0, 0.1)),
    lash=(),
    other_lashes=(GEARBOX, AXLE),
    acceleration_of=3,
)


def study_of(plant, method="exact", step=2e-5):
    return reference.study_of(plant, method, step, END_TIME)


def replaced(lash, **values):
    return lash._replace(**values)


def forked(order, restitution=None):
    """Two equal branches at one hub, each with a lash; `order` numbers the branches."""
    lashes = (Lash((1, branch), 0.05, 2600.0, 0.6, restitution=restitution) for branch in order)
    return Plant(
        inertias=(0.024, 0.002, 0.002),
        shafts=((1, "ground", 0.0, 0.1), (2, "ground", 31.3, 0.1), (3, "ground", 31.3, 0.1)),
        lash=(),
        other_lashes=tuple(lashes),
        acceleration_of=1,
    )


def merged(restitution=None):
    """The branches of `forked` as one of twice their size."""
    return Plant(
        inertias=(0.024, 0.004),
        shafts=((1, "ground", 0.0, 0.1), (2, "ground", 62.6, 0.2)),
        lash=(),
        other_lashes=(Lash((1, 2), 0.05, 5200.0, 1.2, restitution=restitution),),
        acceleration_of=1,
    )


@pytest.mark.parametrize("restitution", [None, 0.5])
@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_equal_branches_strike_together(method, restitution):
    """One after the other at one time, and as one lash of twice the stiffness between the hub and both.

    Rigid flanks rebound by the speeds that all have before the impacts, and come to rest and lock together.
    """
    joined = merged(restitution)
    run, plain = simulate(study_of(forked((2, 3), restitution), method)), simulate(study_of(joined, method))
    assert len(run.events) == 2 * len(plain.events) - 1
    assert run.events["time"][1::2] == pytest.approx(plain.events["time"][1:], abs=1e-11)
    assert run.events["time"][2::2] == pytest.approx(plain.events["time"][1:], abs=1e-11)
    for lash in run.lashes:
        assert lash.label == plain.label
        assert lash.impact_severity == pytest.approx(plain.impact_severity, rel=1e-8, nan_ok=True)
        assert lash.approach_velocity == pytest.approx(plain.approach_velocity, rel=1e-9)
    if method == "exact":  # neither is near another label, as the one is not
        assert np.abs([*run.margins, *plain.margins]).min() > 0.1
    mirrored = simulate(study_of(forked((3, 2), restitution), method))
    assert [lash.label for lash in mirrored.lashes] == [lash.label for lash in run.lashes]
    assert mirrored.events["time"] == pytest.approx(run.events["time"], abs=1e-12)


@pytest.mark.parametrize("restitution", [None, 0.5])
def test_equal_branches_share_impulse_and_energy_of_their_impacts(restitution):
    measured = [
        study.model_copy(update={"impacts": study.impacts.model_copy(update={"quantities": ("impulse", "energy")})})
        for study in (study_of(forked((2, 3), restitution), "exact"), study_of(merged(restitution), "exact"))
    ]
    shared, whole = (clunk.run_points(study, {"solver.end_time": [study.solver.end_time]}) for study in measured)
    for name in ("impulse", "energy"):
        assert shared.arrays[name][0] == pytest.approx(np.full(2, whole.arrays[name][0] / 2.0), rel=1e-9)


def test_no_run_has_more_events_than_allowed_where_several_lashes_touch_and_lock_at_once():
    study = study_of(forked((2, 3), 0.5), "exact")
    needed = len(simulate(study).events) - 1  # without the load step
    for most in range(1, needed):
        few = study.model_copy(update={"solver": study.solver.model_copy(update={"max_events": most})})
        runs = clunk.run_points(few, {"solver.end_time": [study.solver.end_time]})
        assert (runs.status == Status.EVENT_BUFFER_FULL).all(), most


def test_two_lashes_in_series_of_which_one_has_no_gap():
    """A gapless lash passes from flank to flank without ever being open: it is a spring, which the tests above know."""
    gapless = Lash((3, 4), 0.0, 500.0, 0.0)
    run = simulate(study_of(replace(CHAIN, other_lashes=(GEARBOX, gapless))))
    spring = replace(CHAIN, other_lashes=(GEARBOX,), shafts=(*CHAIN.shafts, (3, 4, 500.0, 0.0)))
    plain = simulate(study_of(spring))
    of_first = run.events[(run.events["lash"] == 0)]
    assert of_first["time"] == pytest.approx(plain.events["time"][1:], abs=1e-9)
    assert run.lashes[0].label == plain.label
    assert run.lashes[0].impact_severity == pytest.approx(plain.impact_severity, rel=1e-7)


def test_every_lash_presses_its_own_flank_before_the_load_step():
    """A reversing gear between them turns the second one's torque; in a loop they share it, or one carries nothing."""
    turned = replace(CHAIN, other_lashes=(replaced(GEARBOX, ratio=-1.0), AXLE))
    assert simulate(study_of(CHAIN)).initial_sides.tolist() == [-1, -1]
    assert simulate(study_of(turned)).initial_sides.tolist() == [-1, 1]
    parallel = replace(CHAIN, shafts=(*CHAIN.shafts, (3, 4, 31.3, 0.0)), other_lashes=(GEARBOX, AXLE))
    torques = build(study_of(parallel)).contact_torque[0]
    assert torques[0, 0] == pytest.approx(1.0, rel=1e-9)  # in series
    assert 0.0 < torques[1, 0] < 1.0
    slack = replace(parallel, other_lashes=(GEARBOX, replaced(AXLE, backlash=1.0)))
    with pytest.raises(ClunkError, match="No initial flank: a lash carries no torque"):
        simulate(study_of(slack))
    idle = replace(
        CHAIN, inertias=(*CHAIN.inertias, 0.01), other_lashes=(GEARBOX, AXLE, Lash((4, 5), 0.02, 2600.0, 0.6))
    )
    with pytest.raises(ClunkError, match=r"No initial flank: lash \d carries no torque"):
        simulate(study_of(idle))


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_impacts_of_rigid_flanks_pass_through_those_that_they_press(method):
    """The gearbox strikes while the axle is closed: rigid, the axle takes part in it, and parts if it is pulled."""
    rigid = replace(CHAIN, other_lashes=(replaced(GEARBOX, restitution=0.5), replaced(AXLE, restitution=0.5)))
    run, system = simulate(study_of(rigid, method)), build(study_of(rigid))
    through = 0
    for k, event in enumerate(run.events):
        if k == 0 or run.kind_name(k) != "touch":
            continue
        after = system.lashes[:, 4:] @ run.states[k, 4:8]
        held = system.contacts["closed"][event["regime"]]
        assert after[event["lash"]] in (0.0, pytest.approx(-0.5 * event["speed"], rel=1e-9, abs=1e-12))
        assert np.abs(after[held > 0]).max(initial=0.0) < 1e-12
        through += held.any()
    assert through > 2


PRINTING_PRESS = """
[driveline]
names = ["motor", "main", "a", "b", "c", "drum a", "drum b"]
inertias = [0.3, 0.05, 0.01, 0.01, 0.02, 0.6, 0.5]
shafts = [
    {between = ["motor", "main"], stiffness = 3000.0, damping = 1.0},
    {between = ["a", "drum a"], stiffness = 2000.0, damping = 0.8},
    {between = ["b", "drum b"], stiffness = 2200.0, damping = 0.8},
    {between = ["drum a", "ground"], damping = 0.8},
    {between = ["drum b", "ground"], damping = 0.7},
    {between = ["c", "ground"], damping = 0.1},
]
[[lash]]
between = ["main", "a"]
ratio = 1.5
backlash_deg = 0.5
radius = 0.05
contact = {model = "restitution", restitution = 0.3}
[[lash]]
between = ["main", "b"]
ratio = -1.5
backlash_deg = 0.7
radius = 0.05
contact = {model = "restitution", restitution = 0.5}
[[lash]]
between = ["b", "c"]
ratio = -1.0
backlash_deg = 1.2
radius = 0.05
contact = {model = "restitution", restitution = 0.7}
[load]
on = "motor"
profile = "ramp"
duration = 0.25
initial_torque = 80.0
final_torque = -10.0
[solver]
step = 2e-5
end_time = 1.69
"""


def test_by_rk4_locked_lashes_stay_where_they_are_until_another_one_parts():
    """They are locked for 80,000 steps, each of which rounds; that would make a touch of no speed, and a label."""
    study = clunk.study_from_text(PRINTING_PRESS)
    rk4, by_modes = (simulate(study.but(solver=study.solver.but(method=method))) for method in ("rk4", "exact"))
    assert [lash.label for lash in rk4.lashes] == [lash.label for lash in by_modes.lashes]
    assert rk4.touches == by_modes.touches
    assert rk4.events["time"] == pytest.approx(by_modes.events["time"], abs=1e-7)  # both torques turn slowly
    assert TOUCH not in rk4.events["kind"]


def test_rigid_lashes_that_share_a_torque_are_refused():
    ring = replace(
        CHAIN, other_lashes=tuple(Lash(ends, 0.05, 1.0, restitution=0.5) for ends in ((2, 3), (3, 4), (2, 4)))
    )
    with pytest.raises(ClunkError, match="in a ring"):
        simulate(study_of(ring))


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_without_a_gap_flanks_that_a_jump_of_the_load_parts_change_sides_once(method):
    """As with a gap so small that it takes a microsecond: they do not part again before their torque turns."""
    plant = Plant(
        inertias=(0.003, 0.02),
        shafts=((1, "ground", 31.3, 0.05), (2, "ground", 31.3, 0.05)),
        lash=(),
        other_lashes=(Lash((1, 2), 0.0, 1.0, restitution=0.5),),
        before=6.0,
        after=-6.0,
        acceleration_of=1,
    )
    none = simulate(study_of(plant, method))
    small = simulate(study_of(replace(plant, other_lashes=(plant.other_lashes[0]._replace(backlash=1e-11),)), method))
    assert none.label == small.label
    locks = [run.events["time"][run.events["kind"] == LOCK] for run in (none, small)]
    assert locks[0] == pytest.approx(locks[1], abs=1e-4)  # s: a gap of 1e-11 rad is crossed in less


LOOSE = """
driveline = { inertias = [0.3, 0.6, 0.001], shafts = [] }
lash = [
    { between = [1, 2], backlash_deg = 60.0, radius = 0.05, contact = { stiffness = 1e6, damping = 5367.0 } },
    { between = [2, 3], backlash_deg = 0.2, radius = 0.05, contact = { stiffness = 1e8, damping = 63190.0 } },
]
load = { profile = "step", on = 1, initial_torque = 10.0, final_torque = -20.0 }
solver = { method = "exact", step = 1e-5, end_time = 0.5 }
"""


def test_overdamped_flanks_that_nothing_presses_stay_together():
    """Their overlap decays to zero without crossing it: of what is left, rounding made 10^5 touches."""
    study = clunk.study_from_text(LOOSE)
    run, stepped = clunk.simulate(study), clunk.simulate(study.but(solver=study.solver.but(method="rk4")))
    kinds = [list(zip(each.events["kind"], each.events["lash"], strict=True)) for each in (run, stepped)]
    assert kinds[0] == kinds[1]
    assert run.events["time"] == pytest.approx(stepped.events["time"], abs=1e-5)  # a step of RK4


UNLOADED = """
driveline.inertias = [1.76, 0.03701, 0.5707, 0.5573, 0.4344, 97.09]
driveline.shafts = [
    { between = [2, 3], stiffness = [5073.0, 990.5, 5073.0], breakpoints_deg = [-0.429, 1.102], damping = 1.175 },
    { between = [3, 4], stiffness = 97840.0, damping = 27.28, friction = 68.37 },
]
lash = [
    { between = [1, 2], backlash_deg = 1.1864333333333332, radius = 0.03669 },
    { between = [4, 5], ratio = 0.78, backlash_deg = 1.0, radius = 0.08544 },
    { between = [5, 6], ratio = 0.78, backlash_deg = 0.3669, radius = 0.062 },
]
load = { profile = "lag", on = 1, initial_torque = 262.6, final_torque = -79.26, time_constant = 0.0128 }
solver = { method = "exact", step = 1e-5, end_time = 0.46 }
"""
OF_UNLOADED = [
    *(f"lash[{k}].contact={{model='restitution', restitution=0.1324}}" for k in (1, 2, 3)),
    "driveline.shafts[1].friction=11.94",
    "driveline.shafts[1].ratio=3.7000000000000006",  # with other last digits, other flanks part
]


def test_locked_flanks_whose_torque_decays_to_nothing_stay_locked():
    """Between open lashes nothing drives them: by RK4 they parted, by the rounding that was left of their torque."""
    study = clunk.study_from_text(UNLOADED, overrides=OF_UNLOADED)
    run, stepped = clunk.simulate(study), clunk.simulate(study.but(solver=study.solver.but(method="rk4")))
    kinds = [list(zip(each.events["kind"], each.events["lash"], strict=True)) for each in (run, stepped)]
    assert kinds[0] == kinds[1]
