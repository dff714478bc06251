"""Drivelines that nothing holds to ground: the steady motion before the load step, and the run that follows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import reference
from helpers.reference import CONTACTS, study_of
from helpers.starts import started

from clunk.api import run_points
from clunk.core.status import Status
from clunk.simulation.driveline import Driveline
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.small_gap import SmallGap
from clunk.simulation.system import build, preload, prepare
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import replace_values

METHODS = ("rk4", "exact")
CONFIGS = Path(__file__).parents[1] / "configs"
PAIR = reference.Plant(
    inertias=(0.2, 0.6), shafts=(), lash=(1, 2), before=-8.0, after=-2.0, acceleration_of=1, backlash=0.05
)
# engine, gearbox, wheels and vehicle, as the report's driveline is sized; branched, since the wheels are two
CAR = reference.Plant(
    inertias=(0.02, 0.002, 0.01, 0.012, 2.0),
    shafts=((2, 3, 25.0, 0.04), (2, 4, 30.0, 0.05), (3, 5, 60.0, 0.1), (4, 5, 60.0, 0.1), (5, "ground", 0.0, 0.3)),
    ratios=(2.5, 2.5, 1.0, 1.0, 1.0),
    lash=(1, 2),
    lash_ratio=1.6,
    contact_stiffness=600.0,
    contact_damping=0.3,
    backlash=0.05,
    before=6.0,
    after=-3.0,
    acceleration_of=2,
)
COASTING = replace(CAR, shafts=CAR.shafts[:-1], ratios=CAR.ratios[:-1])
FAST = replace(CAR, shafts=(*CAR.shafts[:-1], (5, "ground", 0.0, 1e-3)))  # thousands of rad/s


# A truck's crawler gear: the engine turns at 10 to 2,600 rad/s, by the drag at the vehicle
TRUCK = reference.Plant(
    inertias=(1.2, 0.03, 0.05, 0.03, 0.6, 8.0, 8.0, 4500.0),
    shafts=(
        (1, 2, 2291.8, 50.0), (4, 5, 6.4e5, 50.0), (3, 4, 1.2e4, 250.0), (5, 6, 2.5e4, 550.0), (5, 7, 2.5e4, 550.0),
        (6, 8, 1e5, 2300.0), (7, 8, 1e5, 2300.0), (8, "ground", 0.0, 200.0),
    ),
    ratios=(1.0, 3.7, *(1.0,) * 6),
    lash=(2, 3),
    lash_ratio=6.5,
    contact_stiffness=0.045**2 * 3e8,
    contact_damping=0.045**2 * 5e3,
    backlash=1e-4 / 0.045,
    before=450.0,
    after=-80.0,
    acceleration_of=2,
    profile=reference.ramp(0.25),
)  # fmt: skip


def steady(plant):
    """Side of the initial flank, angles and speeds."""
    system = build(study_of(plant))
    rest = preload(system, np.array([plant.before, plant.backlash / 2]))
    assert rest.status == Status.OK
    return int(system.contacts["side"][rest.regime, 0]), *np.split(rest.x, 2)


@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
class TestSteadyMotion:
    def test_without_drag_the_flank_carries_what_accelerates_the_other_inertia(self, contact):
        plant = replace(PAIR, **contact)
        side, angle, speed = steady(plant)
        torque = -8.0 * 0.6 / 0.8
        indentation = 0.0 if plant.restitution is not None else torque / plant.contact_stiffness
        assert side == -1
        assert np.all(speed == 0.0)
        assert angle[0] - angle[1] == pytest.approx(-0.025 + indentation, rel=1e-13)
        assert plant.inertias @ angle == pytest.approx(0.0, abs=1e-16)
        assert build(study_of(plant)).contact_torque[0, 0, 0] * -8.0 == pytest.approx(torque, rel=1e-14)

    def test_with_drag_the_speed_is_that_at_which_it_takes_the_load(self, contact):
        """Both inertias drag: the flank carries the second one's share."""
        plant = replace(PAIR, shafts=((2, "ground", 0.0, 0.3), ("ground", 1, 0.0, 0.1)), **contact)
        side, _, speed = steady(plant)
        assert side == -1
        assert speed == pytest.approx([-20.0, -20.0], rel=1e-14)
        assert build(study_of(plant)).contact_torque[0, 0, 0] * -8.0 == pytest.approx(-6.0, rel=1e-14)

    def test_a_damper_whose_ratio_does_not_fit_the_motion_resists_it(self, contact):
        """A gear pump between the two: its twist is θ1 - 3 θ2, and each turn by 1 slips by 2."""
        plant = replace(PAIR, shafts=((1, 2, 0.0, 0.5), (1, 2, 0.0, 9.0)), ratios=(3.0, 1.0), **contact)
        assert steady(plant)[2] == pytest.approx([-4.0, -4.0], rel=1e-14)


@pytest.mark.parametrize("plant", [CAR, COASTING, FAST], ids=["dragged", "coasting", "fast"])
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
def test_however_far_it_rolls_events_are_those_of_the_reference_and_come_to_an_end(contact, plant):
    """The reference keeps the rolling angle apart; 16,000 rad, rounded, are 4e-12 rad of the gap.

    The drag of the speed before the load step presses the other flank than the torque that stays, which is larger.
    """
    plant = replace(plant, before=0.5, after=-3.0, **contact)
    run = simulate(study_of(plant, end_time=2.0))
    events, _ = reference.run(plant, 2.0)
    assert [(run.kind_name(k), event["side"]) for k, event in enumerate(run.events)] == [e[1:3] for e in events]
    assert run.events["time"] == pytest.approx([event.time for event in events], abs=2e-10)
    assert run.complete
    assert len(reference.run(plant, 6.0)[0]) == len(events)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
def test_however_fast_it_rolls_twists_and_events_are_the_same(contact, method):
    """The drag is at the engine, where the load can add what it takes; elsewhere it would change the twists.

    In the second of the run it rolls by so many times the amplitude of its twists.
    """
    turns, drag, half_gap = np.array([4.0, 2.5, 1.0, 1.0, 1.0]), 0.05, COASTING.backlash / 2
    plant = replace(COASTING, shafts=(*COASTING.shafts, (1, "ground", 0.0, drag)), ratios=CAR.ratios, **contact)
    rest = preload(build(study_of(replace(COASTING, **contact))), np.array([6.0, half_gap])).x

    def rolling_at(speed):
        driven = replace(plant, after=-3.0 + drag * 4.0 * speed)
        run = started(study_of(driven, method), rest + np.kron([0.0, speed], turns))
        history = sample(run, step=1e-3)
        return run, history.twist[np.searchsorted(history.after_step, np.arange(1000) * 1e-3)]

    slow, twist = rolling_at(0.0)
    assert slow.touches > 2
    for times in (10.0, 100.0, 1000.0):
        fast, its_twist = rolling_at(float(times * np.abs(twist).max()))
        assert fast.label == slow.label
        assert np.array_equal(fast.events[["kind", "side"]], slow.events[["kind", "side"]])
        assert fast.events["time"] == pytest.approx(slow.events["time"], abs=1e-9)
        assert its_twist == pytest.approx(twist, abs=1e-9)


@pytest.mark.parametrize(("drag", "duration"), [(2.0, 0.3), (20.0, 0.3), (200.0, 0.24170693200478488), (600.0, 0.2)])
def test_a_truck_that_rolls_fast_touches_at_the_times_that_rk4_finds(drag, duration):
    """At up to 100,000 rad/s of the engine. RK4's 1e-5 s, 120 steps a period of the mesh, leave errors of 2e-8 s."""
    plant = replace(TRUCK, shafts=(*TRUCK.shafts[:-1], (8, "ground", 0.0, drag)), profile=reference.ramp(duration))
    exact, stepped = (simulate(study_of(plant, method, step=1e-5, end_time=5.0)) for method in METHODS[::-1])
    assert exact.touches > 10
    assert np.array_equal(exact.events["kind"], stepped.events["kind"])
    assert exact.events["time"] == pytest.approx(stepped.events["time"], abs=5e-7)
    assert balance(exact).relative_residual < 1e-8


@pytest.mark.parametrize("drag", [0.2, 2.0, 20.0])
def test_a_truck_that_rolls_fast_has_the_events_of_the_reference(drag):
    """At up to 1.3 million rad/s of the engine, rounded to 1e-10: that is some 1e-11 s of flanks, here ten times so."""
    plant = replace(TRUCK, shafts=(*TRUCK.shafts[:-1], (8, "ground", 0.0, drag)), profile=reference.ramp(0.3))
    run, (events, _) = simulate(study_of(plant, end_time=2.0)), reference.run(plant, 2.0)
    assert [run.kind_name(k) for k in range(len(run.events))] == [event.kind for event in events]
    assert run.events["time"] == pytest.approx([event.time for event in events], abs=1e-10)


def test_a_truck_has_modes_whatever_a_tyre_damps():
    """From hardly damped to overdamped; at 557 N m s/rad Newton's method found one mode and then its conjugate."""
    first, last = TRUCK.shafts[:5], TRUCK.shafts[6:]
    for damping in (557.0, *np.geomspace(10.0, 4e3, 40)):
        study = study_of(replace(TRUCK, shafts=(*first, (6, 8, 1e5, float(damping)), *last)))
        _, flows = prepare(study, Driveline.from_study(study))
        assert flows.modal.all(), damping


@pytest.mark.parametrize("method", METHODS)
def test_a_truck_that_slows_down_for_minutes_is_known_to_be_done(method):
    """Its slowest mode, 0.04 1/s, moves neither gap nor acceleration."""
    plant = replace(TRUCK, before=200.0)
    assert simulate(study_of(plant, method, step=1e-5, end_time=6.0)).complete


def test_a_truck_that_rolls_fast_has_few_events_also_where_a_touch_is_all_but_none():
    """Had its angles the rounding of what it rolls by, flanks that all but rest on each other would part for ever."""
    durations = 0.24170693200478488 + np.concatenate([np.linspace(-w, w, 100) for w in (1e-7, 1e-6, 1e-5)])
    runs = run_points(study_of(TRUCK, end_time=6.0), {"load.duration": durations})
    assert np.all(runs.status == Status.OK)
    assert runs.touches.max() <= runs.touches.min() + 2


@pytest.mark.parametrize("method", METHODS)
def test_two_rigid_inertias_part_and_lock_by_the_torque_on_one_of_them(method):
    """T changes sign: J2 crosses the gap at T/J1 and is held on the other side, where J2/(J1 + J2) of T presses."""
    plant = replace(PAIR, before=-8.0, after=2.0, restitution=0.0)
    run = simulate(study_of(plant, method))
    assert [run.kind_name(k) for k in range(len(run.events))] == ["load step", "separation", "touch", "lock"]
    assert run.events["time"][1:] == pytest.approx([0.0, 0.1, 0.1], abs=1e-12)  # sqrt(2 · 0.05 / (2/0.2))
    assert run.events["speed"][2] == pytest.approx(1.0, rel=1e-12)
    assert run.states[3, 2:] == pytest.approx([0.25, 0.25], rel=1e-12)
    assert balance(run).relative_residual < 1e-12


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("torques", [(-6.0, 1.0), (6.0, -1.0), (-2.0, 4.0)])
def test_two_free_inertias_part_and_meet_as_by_hand(torques, method):
    """In contact the indentation swings about J_red T / (J1 k) with ω² = k/J_red; in the gap q'' = T/J1."""
    before, after = torques
    first, second, k, gap = 0.03, 0.02, 2000.0, 0.05
    plant = reference.Plant(
        inertias=(first, second),
        shafts=(),
        lash=(1, 2),
        contact_stiffness=k,
        contact_damping=0.0,
        backlash=gap,
        before=before,
        after=after,
        acceleration_of=1,
    )
    side, reduced = np.sign(before), 1.0 / (1.0 / first + 1.0 / second)
    omega = np.sqrt(k / reduced)
    start, centre = (side * reduced * torque / (first * k) for torque in torques)
    swing = np.arccos(-centre / (start - centre))  # from the turning point `start` until the indentation is 0
    leaving, apart = -side * (start - centre) * omega * np.sin(swing), after / first
    # q runs over the whole gap: leaving t + apart t²/2 = -side gap
    until = np.roots([0.5 * apart, leaving, side * gap])
    flight = min(t.real for t in until if abs(t.imag) < 1e-12 and t.real > 0.0)
    run = simulate(study_of(plant, method, step=1e-5, end_time=0.2))
    events = run.events[1:3]
    assert run.initial_side == side
    assert [run.kind_name(k) for k in (1, 2)] == ["separation", "touch"]
    assert events["side"].tolist() == [side, -side]
    # rk4 is late by (ωh)⁴/120 = 1e-12 of what has passed
    assert events["time"] == pytest.approx([swing / omega, swing / omega + flight], abs=1e-12)
    assert events["speed"] == pytest.approx([leaving, leaving + apart * flight], rel=1e-10)


def test_a_loose_gear_is_pressed_by_its_drag_or_by_acceleration():
    """At constant speed it needs none of the load, and no flank carries any."""
    loose = reference.Plant(
        inertias=(0.2, 0.6, 0.01),
        shafts=((1, 2, 40.0, 0.1), (2, "ground", 0.0, 0.3)),
        lash=(2, 3),
        before=8.0,
        after=2.0,
        acceleration_of=3,
    )
    with pytest.raises(ClunkError, match=r"No initial flank: .* before the load step\."):
        simulate(study_of(loose))
    dragged = replace(loose, shafts=(*loose.shafts, (3, "ground", 0.0, 0.01)))
    assert build(study_of(dragged)).contact_torque[0, 0, 0] * 8.0 == pytest.approx(8.0 * 0.01 / 0.31, rel=1e-13)
    coasting = replace(loose, shafts=loose.shafts[:1])
    assert build(study_of(coasting)).contact_torque[0, 0, 0] * 8.0 == pytest.approx(8.0 * 0.01 / 0.81, rel=1e-13)


def test_a_driveline_in_two_parts_is_refused_by_the_name_of_one():
    """A damper joins nothing, and neither does a shaft without stiffness."""
    plant = replace(CAR, shafts=(*CAR.shafts[:2], (3, 5, 0.0, 0.1), (4, 5, 0.0, 0.1), CAR.shafts[4]))
    text = reference.config_of(plant).replace(
        "[driveline]", '[driveline]\nnames = ["engine", "gearbox", "left", "right", "vehicle"]'
    )
    assert build(study_from_text(text)).status == Status.NO_EQUILIBRIUM
    with pytest.raises(ClunkError, match=r"No steady motion .*: no stiffness joins vehicle to engine or to ground"):
        simulate(study_from_text(text))


def test_a_flywheel_on_a_slipping_clutch_turns_at_the_speed_that_its_damper_allows():
    """One motion, of the loaded flywheel against the driveline that a spring holds: it slips at T/c."""
    plant = reference.Plant(shafts=(*reference.Plant().shafts[1:], (1, 2, 0.0, 0.2)))
    _, _, speed = steady(replace(plant, shafts=tuple(s for s in plant.shafts if s != (1, "ground", 0.0, 0.1))))
    assert speed == pytest.approx([-30.0, 0.0, 0.0, 0.0], rel=1e-14)


def test_a_loop_whose_ratios_do_not_fit_has_no_rigid_motion():
    loop = replace(PAIR, shafts=((1, 2, 30.0, 0.1),), ratios=(2.0,))
    assert Driveline.from_study(study_of(loop)).rigid_motion.shape.size == 0
    fitting = replace(loop, ratios=(1.0,))
    assert Driveline.from_study(study_of(fitting)).rigid_motion.shape.size == 2


def test_the_small_gap_response_is_of_the_torque_that_the_rolling_driveline_carries():
    gap = SmallGap.of(study_of(CAR))
    assert gap.start == pytest.approx(6.0, rel=1e-12)  # all drag is behind the lash
    assert gap.end == pytest.approx(-3.0, rel=1e-12)
    assert gap.torque[0] == pytest.approx(gap.start, rel=1e-9)


def test_a_run_begins_in_the_steady_motion_and_rolls_alike_by_both_methods():
    """The angles that a driveline has rolled by are put back into the states at events, at the load step once."""
    config = CONFIGS / "car_tip_out.toml"
    exact, rk4 = (simulate(load_study(config, [f"solver.method={m}", "solver.step=1e-5"])) for m in ("exact", "rk4"))
    assert np.array_equal(exact.states[0], rk4.states[0])
    assert exact.states == pytest.approx(rk4.states, abs=2e-5)  # 4 times RK4's error at this step


@pytest.mark.parametrize(("tip", "begins"), [("out", "DS("), ("in", "CR(1)")])
def test_the_car_shuffles_at_a_few_hertz_and_clunks(tip, begins):
    run = simulate(load_study(CONFIGS / f"car_tip_{tip}.toml", ["solver.method='exact'"]))
    driveline = Driveline.from_study(run.study)
    assert 2.0 < driveline.modes(closed=True).frequency[0] < 8.0
    assert run.label.startswith(begins)
    assert run.complete


@pytest.mark.parametrize("method", METHODS)
def test_so_little_drag_that_steady_motion_has_lost_its_digits_is_refused(method):
    """6 N m of the engine, geared down by 4, at 1e-9 N m s/rad: 1e11 rad/s of it, beside which no twist is known."""
    plant = replace(CAR, shafts=(*CAR.shafts[:-1], (5, "ground", 0.0, 1e-9)))
    first = plant.shafts[0]
    staged = reference.Shaft(*first[:2], (first[2], 2.0 * first[2]), first[3], (0.1,))  # never without stiffness
    for shafts in (plant.shafts, (staged, *plant.shafts[1:])):
        with pytest.raises(ClunkError, match="faster than 10⁷ rad/s"):
            simulate(study_of(replace(plant, shafts=shafts), method))


@pytest.mark.parametrize("method", METHODS)
def test_gear_ratios_along_a_loop_that_all_but_fit_are_refused_and_spoil_no_other_cell(method):
    """The half-shafts are a loop. Where its ratios miss by 1e-6, it holds the car once it is wound up to 1e11 rad; by
    1e-7, only rounding holds it. By 1e-2, it is wound up to 5e3 rad, beside which a twist has 11 digits."""
    study = load_study(CONFIGS / "car_tip_in.toml", [f"solver.method='{method}'"])
    key = "driveline.shafts[3].ratio"
    with pytest.raises(ClunkError, match=r"by more than 10⁶ rad per N m; .* gear ratios along a loop"):
        simulate(replace_values(study, {key: 1.000001}))
    runs = run_points(study, {key: [1.0, 0.9999999, 1.01, 1.000001]})
    assert runs.status.tolist() == [Status.OK, Status.NO_EQUILIBRIUM, Status.OK, Status.NO_EQUILIBRIUM]
    assert np.array_equal(runs.severity[[0, 2]], run_points(study, {key: [1.0, 1.01]}).severity)


GEARED = """
[driveline]
inertias = [0.035, 0.004, 0.06, 2.0, 190.0]
shafts = [
    {{ between = [3, 4], stiffness = 1.4e4, damping = 20.0 }},
    {{ between = [4, 5], stiffness = 3.0e4, damping = 300.0 }},
    {{ between = [5, "ground"], damping = 4.0 }},
]
[[lash]]
between = [1, 2]
ratio = {}
backlash_deg = 0.5
radius = 0.022
contact = {{ model = "restitution", restitution = 0.4 }}
[[lash]]
between = [2, 3]
ratio = {}
backlash_deg = 0.5
radius = 0.03
contact = {{ model = "restitution", restitution = 0.3 }}
[load]
on = 1
initial_torque = 120.0
final_torque = -40.0
"""


@pytest.mark.parametrize("ratios", [(3.2, 3.0), (3.3, 3.0), (3.25, 2.9)])
@pytest.mark.parametrize("method", METHODS)
def test_ratios_of_locked_flanks_whose_product_is_rounded_leave_nothing_that_rolling_moves(method, ratios):
    """The torques in contact do not change by rolling: once the twists are over, it is known that nothing follows."""
    run = simulate(study_from_text(GEARED.format(*ratios), overrides=[f"solver.method={method}", "solver.step=1e-5"]))
    assert run.end < 0.5  # s, where a run may last 2 s


BESIDE_A_BRAKE = """
driveline.inertias = [24.11, 0.1637, 0.2475]
driveline.shafts = [
    { between = [1, 2], stiffness = 10150.0, damping = 0.2473 },
    { between = [3, "ground"], damping = 1.03e-8 },
    { between = [1, "ground"], damping = 2.537e-7 },
    { between = [2, "ground"], damping = 1.787 },
]
lash.between = [2, 3]
lash.backlash_deg = 0.1214
lash.radius = 0.05
lash.contact = { stiffness = 9.672e7, damping = 2350.0, separation = "force" }
load = { profile = "lag", on = 2, initial_torque = -2.167, final_torque = 0.06171616, time_constant = 0.1472 }
solver = { method = "exact", step = 2e-6, end_time = 1.902 }
"""


def test_a_bearing_with_a_hundred_millionth_of_the_drag_still_brakes():
    """Without it, the part touched once on the flank that it had left: OS(1)CR(1)."""
    study = study_from_text(BESIDE_A_BRAKE)
    run, stepped = simulate(study), simulate(study.but(solver=study.solver.but(method="rk4")))
    assert str(run.label) == str(stepped.label) == "CR(1)"
    assert run.events["kind"].tolist() == stepped.events["kind"].tolist()
