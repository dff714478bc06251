"""Coulomb friction: known answers, beside the independent reference, and known special cases."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.agreement import exact
from helpers.reference import Plant, Shaft, sine, step, table

from clunk.core.events import STAGE
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import replace_values

METHODS = {"exact": ['solver.method="exact"'], "rk4": ['solver.method="rk4"', "solver.step=1e-4"]}
# With a lash of its own at inertia 1, which never closes, so that there is one.
OPEN_LASH = Plant(lash=(1, "ground"), backlash=np.pi / 2, before=0.0, after=0.0, acceleration_of=1)


def nominal(*overrides):
    return load_study("configs/nominal.toml", [*overrides])


def changes(run):
    """Times of all changes that a friction made, and the states then."""
    is_change = run.phases["kind"] == STAGE
    return run.phases["time"][is_change], run.phase_states[is_change]


@pytest.mark.parametrize("method", METHODS)
def test_an_oscillator_is_that_of_siconos(method):
    """1 kg m2 on 1 N m/rad, friction 1, from 12 rad and 6 rad/s: circles about -1 and 1 in turn, each half period
    shorter by 2 F/k (siconos-tutorials, FrictionOscillator); its first turn and its rest are stored too."""
    rubbing = Shaft(2, "ground", 1.0, 0.0, (), 1.0)
    plant = replace(OPEN_LASH, inertias=(1.0, 1.0), shafts=(rubbing, (1, "ground", 1.0, 0.0)))
    run = exact(plant, [0.0, 12.0, 0.0, 6.0], 30.0, method, step=1e-3)
    times, states = changes(run)
    radius, phase = np.hypot(13.0, 6.0), np.arctan2(6.0, 13.0)
    rounding = 1e-11 if method == "exact" else 1e-9  # of rk4: h⁴ t/120 with h = 1e-3, and nothing else
    assert times == pytest.approx(phase + np.pi * np.arange(8), abs=rounding)
    turns = (radius - 1.0 - 2.0 * np.arange(8)) * (-1.0) ** np.arange(8)
    assert states[:, 1] == pytest.approx(turns, abs=10.0 * rounding)
    assert (states[0, 1], times[0]) == pytest.approx((13.31782106, 0.43240778), abs=6e-9)
    assert (abs(states[-1, 1]), times[-1]) == pytest.approx((0.68217894, 22.423556), abs=5e-7)
    assert run.complete  # it sticks where its spring pulls with less than F
    energy = balance(run)
    way = np.abs(np.diff(np.concatenate([[12.0], states[:, 1]]))).sum()
    assert energy.rubbed == pytest.approx(way, rel=1e-8)  # F = 1 N m
    assert energy.relative_residual < 1e-8


@pytest.mark.parametrize("method", METHODS)
def test_a_clutch_and_a_brake_are_those_of_modelica(method):
    """Modelica Standard Library, Mechanics.Rotational.Examples.Friction; its stored results are good to some 1e-5."""

    def driveline(brake, profile):
        clutch = Shaft(2, 3, 0.0, 0.0, (), 80.0), Shaft(3, 4, 160.0, 1.0), Shaft(4, "ground", 0.0, 0.0, (), brake)
        shafts = *clutch, Shaft(1, "ground", 1.0, 0.0)
        return replace(OPEN_LASH, inertias=(1.0, 1.0, 0.05, 1.0), shafts=shafts, loaded=2, profile=profile)

    swung = exact(driveline(0.0, sine(200.0, 50.0 / np.pi)), [0.0] * 5 + [100.0, 90.0, 90.0], 0.5, method)
    times, _ = changes(swung)
    assert times == pytest.approx([0.0067797090, 0.0593400564, 0.1092894952], abs=2e-6)
    if method == "exact":
        assert times[0] == pytest.approx(0.0067797089, abs=1e-10)  # closed form
    history = sample(swung, step=0.5, until=0.6)
    state = np.concatenate([history.angle[-1], history.velocity[-1]])
    assert history.after_step[-1] == 0.5
    later = exact(driveline(800.0, step()), state, 2.5, method)
    times, _ = changes(later)
    assert 0.5 + times == pytest.approx([0.5342486454, 0.6406138053, 1.6636397837], abs=2e-5)
    final = sample(later, step=2.5, until=2.6).velocity[-1]
    assert final[1] == pytest.approx(2.289891, abs=3e-5)
    assert final[3] == pytest.approx(0.0, abs=1e-9)  # the brake holds


@pytest.mark.parametrize("method", METHODS)
class TestFriction:
    def test_of_no_torque_it_is_none(self, method):
        without = simulate(nominal(*METHODS[method]))
        run = simulate(nominal(*METHODS[method], "driveline.shafts[3].friction=0.0"))
        assert run.events.tobytes() == without.events.tobytes()

    def test_bearings_side_by_side_share_it(self, method):
        """0.2 N m in one bearing, or in two: the same run; and their energies are as their torques."""
        one = simulate(nominal(*METHODS[method], "driveline.shafts[4].friction=0.2"))
        shafts = [shaft.model_dump(exclude_none=True) for shaft in one.study.driveline.shafts]
        halves = [shafts[0], shafts[1], shafts[2], shafts[3] | {"friction": 0.15}]
        halves.append({"between": (1, "ground"), "stiffness": 0.0, "damping": 0.0, "friction": 0.05})
        both = simulate(replace_values(one.study, {}).model_copy(update={"driveline": with_shafts(one.study, halves)}))
        assert both.events["time"] == pytest.approx(one.events["time"], abs=1e-12)
        rubbed = balance(both).rubbed_in_shafts
        assert rubbed[3] == pytest.approx(3.0 * rubbed[4], rel=1e-12)
        assert sum(rubbed) == pytest.approx(balance(one).rubbed, rel=1e-9)


def with_shafts(study, shafts):
    return type(study.driveline).model_validate(
        study.driveline.model_dump(exclude_none=True) | {"shafts": tuple(shafts)}
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("backlash", [0.0, 3.0, 6.0, 20.0])
def test_a_load_that_changes_by_a_friction_parts_nothing(method, backlash):
    """At rest 1 N m is carried. Down by 0.9 N m of it, the bearings' 0.1 N m would be reached in the limit of time."""
    bearings = [f"driveline.shafts[{number}].friction=0.1" for number in (3, 4)]
    run = simulate(nominal(*METHODS[method], *bearings, f"lash.backlash_deg={backlash}", "load.ratio=0.1"))
    assert run.label == "NI"


def test_what_sticks_holds_up_to_its_friction():
    """A torque that goes from -1 N m to -10 N m at 10 N m/s, of which a bearing takes 2 N m before it slips."""
    ramp = ["load.profile='ramp'", "load.duration=0.9", "load.static_torque=-10.0", "load.ratio=-0.9"]
    held = ["driveline.shafts[4].friction=2.0", "solver.end_time=0.3"]
    times, _ = changes(simulate(nominal(*METHODS["exact"], *ramp, *held)))
    assert times[0] == pytest.approx(0.2, abs=1e-9)  # it holds a billionth more, 2e-9 N m


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("frictions", [(1.0, 2.0), (2.0, 1.0)])
def test_three_that_hold_two_inertias_give_way_where_that_is_easiest(frictions, method):
    """Two inertias rub on ground, and on each other with 1.5 N m; the first is turned by 10 N m/s.

    It gives way alone beyond F1 + 1.5, and both together beyond F1 + F2.
    """
    one, other = frictions
    rubbing = (Shaft(1, "ground", 0.0, 0.0, (), one), Shaft(2, "ground", 0.0, 0.0, (), other))
    shafts = *rubbing, Shaft(1, 2, 0.0, 0.0, (), 1.5)
    plant = replace(OPEN_LASH, inertias=(1.0, 1.0), shafts=shafts, profile=table((0.0, 1.0), (0.0, 10.0)))
    times, _ = changes(exact(plant, np.zeros(4), 0.4, method))
    gives_way = times[times > 0.0][0]  # at 0 all of them stick
    assert gives_way == pytest.approx(min(one + 1.5, one + other) / 10.0, abs=1e-9)


TIED_IN_A_LOOP = """
driveline.inertias = [0.06079, 2.52e-05, 0.02075, 0.007515]
driveline.shafts = [
    { between = [1, 4], ratio = 0.4, stiffness = 791.4, damping = 0.0, friction = 0.03836 },
    { between = [1, 3], stiffness = 0.0, damping = 0.0, friction = 9.827 },
    { between = [1, 2], stiffness = 0.0, damping = 0.0, friction = 2.957 },
    { between = [3, 4], ratio = 0.4, stiffness = 0.0, damping = 0.0, friction = 0.7963 },
    { between = [2, "ground"], damping = 0.08631 },
    { between = [3, "ground"], damping = 0.1644 },
    { between = [4, "ground"], damping = 6.61 },
]
lash = [
    { between = [1, 2], backlash_deg = 0.323, radius = 0.1822, contact = { stiffness = 4202000.0, damping = 2.259 } },
    { between = [2, 3], backlash_deg = 0.1302, radius = 0.1556, contact = { stiffness = 67420.0, damping = 0.0 } },
]
load = { on = 1, profile = "sine", initial_torque = 9.059, final_torque = -0.4529, amplitude = 12.1, frequency = 26.98 }
solver = { method = "exact", end_time = 0.1119 }
"""


def test_of_a_loop_of_frictions_two_at_their_limits_give_way_together():
    """As long as two of them hold, the third does not move, whatever it is at: the one at its limit was taken for it by
    turns, without end, in three of these runs by rounding."""
    for amplitude in np.linspace(3.63, 24.2, 101):
        run = simulate(study_from_text(TIED_IN_A_LOOP, overrides=[f"load.amplitude={amplitude}"]))
        assert len(changes(run)[0]) < 30


def test_what_creeps_to_rest_comes_to_rest():
    """The last of the change is 1e-10 of it. Three frictions give way and hold in turns, with rates and torques beyond
    theirs that are ever smaller shares of what they consist of, until these are as small as rounding."""
    rubbing = [f"driveline.shafts[{k + 1}].friction={most}" for k, most in enumerate((1.680545, 0.059849, 2.045346))]
    masses = [f"driveline.inertias[{k}]={mass}" for k, mass in ((1, 0.03695853), (3, 0.01044784))]
    load = ["load.profile='lag'", "load.time_constant=0.22340648", "solver.end_time=8.0"]
    braked = ["driveline.shafts[3].damping=3.9", "driveline.shafts[2].ratio=-1.0", "lash.contact.damping=997.35"]
    run = simulate(nominal(*METHODS["exact"], *rubbing, *masses, *load, *braked))
    assert run.label == "NI"
    assert len(changes(run)[0]) < 200
    assert balance(run).relative_residual < 1e-9


CREEPING = """
driveline.inertias = [0.0887, 0.007244, 0.4422]
driveline.shafts = [
    { between = [2, 1], ratio = 0.5882352941176471, stiffness = 47.78, damping = 0.4136, friction = 0.01289 },
    { between = [3, "ground"], stiffness = 23.29, damping = 6.418 },
    { between = [2, 3], ratio = -0.5882352941176471, stiffness = 0.0, damping = 0.0, friction = 0.002106 },
]
lash.between = [3, 1]
lash.ratio = -1.0
lash.backlash_deg = 0.6887
lash.radius = 0.07196
lash.contact = { model = "restitution", restitution = 0.5687 }
load = { on = 2, profile = "lag", initial_torque = -0.2036, final_torque = 0.1387025, time_constant = 0.3141 }
solver.end_time = 11.35
"""


@pytest.mark.parametrize("step", [4.875e-4, 6e-5, 1.5e-5])
def test_what_slips_no_faster_than_rounding_sticks(step):
    """By rk4: after 9 s the torque changes by less than 1e-12 of itself a second, and two frictions hold one twist."""
    run = simulate(study_from_text(CREEPING, overrides=['solver.method="rk4"', f"solver.step={step}"]))
    assert run.label == "CR(1)"
    assert len(changes(run)[0]) < 100  # some 50; else 2,000 and more


@pytest.mark.parametrize("stiffness", [5e6, 1e7])
def test_beside_a_stiff_shaft_that_sticks_a_free_part_stays_free(stiffness):
    """In the open gap nothing holds inertias 1 to 3: the rounding of a spring that is held must not do so either."""
    shaft = f"driveline.shafts[2].stiffness={stiffness}", "driveline.shafts[2].friction=0.008"
    run = simulate(nominal(*METHODS["exact"], *shaft, "solver.end_time=0.3"))
    assert run.label == "DS(1)"
    assert balance(run).relative_residual < 1e-8  # of some 1e4 swings of that shaft, each rounded


@pytest.mark.parametrize("drag", [0.01, 0.0])
@pytest.mark.parametrize("method", METHODS)
def test_a_friction_that_slips_before_the_load_step_is_refused(method, drag):
    """The car rolls, at constant speed or faster and faster; a bearing that rubs would have to carry nothing there."""
    study = load_study("configs/car_tip_out.toml", [f"solver.method='{method}'"])
    shafts = [shaft.model_dump(exclude_none=True) for shaft in study.driveline.shafts]
    shafts.append({"between": (1, "ground"), "stiffness": 0.0, "damping": drag, "friction": 1.0})
    with pytest.raises(ClunkError, match=rf"shafts\[{len(shafts)}\] slips .* give it .*damping"):
        simulate(study.model_copy(update={"driveline": with_shafts(study, shafts)}))


def driven_by(motors, method):
    """A gear with backlash that equal motors drive, each with friction in its bearing; together they are one motor."""
    numbers, share = range(2, motors + 2), 1.0 / motors
    shafts = [
        *(f"{{ between = [1, {motor}], stiffness = {10000.0 * share}, damping = 0.0 }}" for motor in numbers),
        *(f"{{ between = [{motor}, 'ground'], friction = {share} }}" for motor in numbers),
    ]
    return study_from_text(f"""
        driveline.inertias = {[0.001, *(0.002 * share for _ in numbers)]}
        driveline.shafts = [{", ".join(shafts)}]
        lash.between = [1, "ground"]
        lash.backlash_deg = 0.3
        lash.radius = 0.02
        lash.contact = {{ stiffness = 5e7, damping = 2e3 }}
        load = {{ on = 1, initial_torque = 10.0, final_torque = 2.0 }}
        solver = {{ method = "{method}", step = 1e-5, end_time = 0.3 }}
        """)


@pytest.mark.parametrize("method", METHODS)
def test_equal_motors_are_as_one(method):
    """Their frictions break loose together, by rounding 1e-13 s apart. The second one, with a torque not quite at its
    limit then, was let go and held in turns, without end."""
    one, two, three = (simulate(driven_by(motors, method)) for motors in (1, 2, 3))
    for run in (two, three):
        assert (run.label, run.touches) == (one.label, one.touches) == ("SS(1)", 2)
        assert run.severity == pytest.approx(one.severity, rel=1e-7)
        assert run.approach_velocity == pytest.approx(one.approach_velocity, rel=1e-7)
