"""The independent reference with several lashes, staged shafts and friction: closed forms and others' numbers."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers import general, reference
from helpers.randomplants import element_plant
from helpers.reference import Lash, Plant, Shaft, pulse, ramp, run, sine, table

FREE = Plant(lash=(), acceleration_of=1, before=0.0, after=0.0)  # no lash


def seen(events):
    return [(event.element, event.kind, event.side) for event in events[1:]]


def times_of(events):
    return np.array([event.time for event in events])


# Friction


def oscillator(friction):
    """An inertia of 1 kg m2 on a spring of 1 N m/rad to ground, on a surface that rubs."""
    return replace(FREE, inertias=(1.0,), shafts=(Shaft(1, "ground", 1.0, 0.0, friction=friction),))


def test_a_rubbing_oscillator_is_that_of_siconos():
    """θ = 12, θ' = 6, friction 1; circles about -1 and 1 in turn (siconos-tutorials, FrictionOscillator)."""
    events, final = run(oscillator(1.0), 30.0, np.array([12.0, 6.0]))
    radius, phase = np.hypot(13.0, 6.0), np.arctan2(6.0, 13.0)
    assert seen(events) == [*(("shaft 1", "slip", (-1) ** k) for k in range(1, 8)), ("shaft 1", "stick", 0)]
    assert times_of(events[1:]) == pytest.approx(phase + np.pi * np.arange(8), abs=1e-11)
    turns = [event.state[0] for event in events[1:]]
    lost = 2.0 * np.arange(8)  # F/k on either side of each half period
    assert turns == pytest.approx((radius - 1.0 - lost) * (-1.0) ** np.arange(8), abs=1e-11)
    assert (turns[0], events[1].time) == pytest.approx((13.31782106, 0.43240778), abs=6e-9)
    assert (final[0], events[-1].time) == pytest.approx((0.68217894, 22.423556), abs=5e-7)
    assert final[1] == 0.0


def clutch_and_brake(brake):
    """J3, J2 and J1 of the Modelica Standard Library's Mechanics.Rotational.Examples.Friction."""
    shafts = (
        Shaft(1, 2, 0.0, 0.0, friction=80.0),
        Shaft(2, 3, 160.0, 1.0),
        Shaft(3, "ground", 0.0, 0.0, friction=brake),
    )
    return replace(FREE, inertias=(1.0, 0.05, 1.0), shafts=shafts)


def test_a_clutch_and_a_brake_are_those_of_modelica():
    """Its stored reference results are good to some 1e-5, the times where little happens to a few of that."""
    swung = replace(clutch_and_brake(0.0), profile=sine(200.0, 50.0 / np.pi))
    events, state = run(swung, 0.5, np.array([0.0, 0.0, 0.0, 100.0, 90.0, 90.0]))
    later, final = run(clutch_and_brake(800.0), 2.5, state)
    assert seen(events) == [("shaft 1", "stick", 0), ("shaft 1", "slip", 1), ("shaft 1", "stick", 0)]
    assert times_of(events[1:]) == pytest.approx([0.0067797090, 0.0593400564, 0.1092894952], abs=2e-6)
    assert events[1].time == pytest.approx(0.0067797089, abs=1e-10)  # closed form
    assert seen(later) == [("shaft 1", "slip", 1), ("shaft 3", "stick", 0), ("shaft 1", "stick", 0)]
    assert 0.5 + times_of(later[1:]) == pytest.approx([0.5342486454, 0.6406138053, 1.6636397837], abs=2e-5)
    assert final[3] == pytest.approx(2.289891, abs=3e-5)


def test_what_sticks_holds_up_to_its_friction():
    """A ramp of 10 N m/s against 2 N m; and a load that jumps beyond it."""
    held = replace(oscillator(2.0), after=10.0, profile=ramp(1.0))
    events, _ = run(held, 0.5)
    assert seen(events) == [("shaft 1", "slip", 1)]
    assert events[1].time == pytest.approx(0.2, abs=1e-13)
    events, _ = run(replace(held, after=1.9), 5.0)
    assert not seen(events)
    events, final = run(replace(held, profile=pulse(0.1)), 5.0)
    assert seen(events)[0] == ("shaft 1", "slip", 1)
    assert events[1].time == 0.0
    assert seen(events)[-1] == ("shaft 1", "stick", 0)
    assert final[1] == 0.0


def two_bearings(torques, frictions, between):
    """Two inertias of 1 kg m2 that rub on ground and on each other, the first loaded."""
    one, other = frictions
    shafts = (
        Shaft(1, "ground", 0.0, 0.0, friction=one),
        Shaft(2, "ground", 0.0, 0.0, friction=other),
        Shaft(1, 2, 0.0, 0.0, friction=between),
    )
    return replace(FREE, inertias=(1.0, 1.0), shafts=shafts, profile=reference.table(*torques))


@pytest.mark.parametrize("frictions", [(1.0, 2.0), (2.0, 1.0)])
def test_three_that_hold_two_inertias_give_way_as_one_where_that_is_easiest(frictions):
    """Between them 1.5: the first gives way alone beyond F1 + 1.5, both together beyond F1 + F2."""
    one, other = frictions
    (_, *events), _ = run(two_bearings(((0.0, 1.0), (0.0, 10.0)), frictions, 1.5), 0.4, np.zeros(4))
    first = min(one + 1.5, one + other)
    assert events[0].time == pytest.approx(first / 10.0, abs=1e-13)
    assert {event.element for event in events if event.time == events[0].time} == (
        {"shaft 1", "shaft 3"} if other > 1.5 else {"shaft 1", "shaft 2"}
    )


def test_which_of_two_equal_ones_gives_way_does_not_matter():
    """Two in parallel are one of both; two alike in a row part at the same instant."""
    load = ((0.0, 0.5, 0.6, 1.5), (0.0, 10.0, 0.0, 0.0))
    shafts = (Shaft(1, "ground", 5.0, 0.1, friction=1.0),) * 2
    twice = replace(FREE, inertias=(1.0,), shafts=shafts, profile=table(*load))
    once = replace(twice, shafts=(Shaft(1, "ground", 10.0, 0.2, friction=2.0),))
    (one, final), (other, expected) = (run(plant, 3.0) for plant in (twice, once))
    assert len(other) == 4
    assert [event[1:] for event in seen(one)[::2]] == [event[1:] for event in seen(other)]
    assert times_of(one[1::2]) == pytest.approx(times_of(other[1:]), abs=1e-13)
    assert final == pytest.approx(expected, abs=1e-12)


# Staged shafts


def test_a_clutch_damper_swings_on_its_stages_by_hand():
    """From a deflection of 0.3 rad on 50 N m/rad beyond 0.1 rad, on 20 below, none behind: arcs of circles."""
    shafts = (Shaft(1, "ground", (20.0, 50.0), 0.0, (0.1,)),)
    events, final = run(replace(FREE, inertias=(0.01,), shafts=shafts), 0.12, np.array([0.3, 0.0]))
    stiff, soft = np.sqrt(50.0 / 0.01), np.sqrt(20.0 / 0.01)
    centre = 0.1 - 20.0 * 0.1 / 50.0  # where the stiff stage's torque would be zero
    first = np.arccos((0.1 - centre) / (0.3 - centre)) / stiff
    speed = (0.3 - centre) * stiff * np.sin(stiff * first)
    back = 2.0 * (np.pi - np.arctan2(speed / soft, 0.1)) / soft
    assert seen(events) == [("shaft 1", "stage", 1), ("shaft 1", "stage", 2)]
    assert times_of(events)[1:] == pytest.approx([first, first + back], abs=1e-13)
    swing = (0.1 - centre - 1j * speed / stiff) * np.exp(1j * stiff * (0.12 - first - back))
    assert final[0] == pytest.approx(centre + swing.real, abs=1e-12)


NOMINAL = reference.boere(5.0, 6.0)
REPORT = NOMINAL.shafts


def without(events, *kinds):
    return [event for event in events if event.kind not in kinds]


def agree(one, other, rounding=1e-12):
    """The same events in the same order at the same times  [s]."""
    assert seen(one) == seen(other)
    assert times_of(one) == pytest.approx(times_of(other), abs=rounding)


def test_stages_of_one_stiffness_are_a_plain_spring():
    """Chatter magnifies rounding; 0.3 s of it."""
    staged = replace(NOMINAL, shafts=(Shaft(1, 2, (31.3,) * 3, 0.08, (-0.16, 0.02)), *REPORT[1:]))
    one, other = run(staged, 0.3)[0], run(NOMINAL, 0.3)[0]
    assert [event.kind for event in one].count("stage") > 2
    agree(without(one, "stage"), other)


def test_friction_of_almost_nothing_is_almost_none():
    rubbing = replace(NOMINAL, shafts=tuple(Shaft(*shaft, friction=1e-6) for shaft in REPORT))
    agree(without(run(rubbing, 0.3)[0], "slip", "stick"), run(NOMINAL, 0.3)[0], rounding=1e-6)
    none = replace(NOMINAL, shafts=tuple(Shaft(*shaft, friction=0.0) for shaft in REPORT))
    assert none.elements[1:] == NOMINAL.elements[1:] == ()


# Several lashes


@pytest.mark.parametrize("separation", ["gap", "force"])
def test_a_lash_without_a_gap_in_series_is_a_spring(separation):
    """It only ever passes from one flank straight to the other; without damping none pulls."""
    behind = Plant(
        inertias=(0.024, 0.002, 0.002, 0.01),
        shafts=((1, 2, 31.3, 0.08), (4, "ground", 31.3, 0.1)),
        lash=(2, 3),
        other_lashes=(Lash((3, 4), 0.0, 500.0, 0.0, separation),),
    )
    spring = replace(behind, shafts=(*behind.shafts, (3, 4, 500.0, 0.0)), other_lashes=())
    one, other = run(behind, 0.3)[0], run(spring, 0.3)[0]
    at_once = [event for event in one if event.element == "lash 2"]
    assert {event.kind for event in at_once} >= {"separation", "touch"}
    for parted, met in pairwise(event for event in at_once if event.kind in ("separation", "touch")):
        if parted.kind == "separation":
            assert (met.kind, met.side) == ("touch", -parted.side)
            assert met.time - parted.time < 1e-13
    agree([event for event in one if event.element != "lash 2"], other)


def test_a_spring_inside_the_gap_is_that_of_the_modelica_book():
    """Its Backlash example, with J, k and d as printed: 0.5 rad to either side; no results are stored there."""
    plant = replace(
        FREE,
        inertias=(0.4, 1.0),
        shafts=((1, 2, 11.0, 0.2), (2, "ground", 5.0, 0.2)),
        other_lashes=(Lash((1, 2), 1.0, 1000.0, 0.0),),
    )
    state = np.array([0.0, 0.0, 5.0, 0.0])
    events, final = run(plant, 2.0, state)
    assert len(events) > 5
    assert final == pytest.approx(general.integrated(plant, 2.0, state, 0.01), abs=1e-8)


def test_symmetric_branches_do_the_same_at_the_same_time():
    """Rounding apart, whichever is resolved first; each has its label."""
    branch = Lash((1, 2), 0.05, 2000.0, 0.1)
    plant = Plant(
        inertias=(0.02, 0.002, 0.002),
        shafts=((2, "ground", 31.3, 0.1), (3, "ground", 31.3, 0.1)),
        lash=(),
        other_lashes=(branch, branch._replace(between=(1, 3))),
        acceleration_of=1,
    )
    events, _ = run(plant, 0.5)
    one, other = ([events[0], *(event for event in events if event.element == f"lash {number}")] for number in (1, 2))
    assert len(one) > 10
    assert [event.kind for event in one] == [event.kind for event in other]
    assert times_of(one) == pytest.approx(times_of(other), abs=1e-11)
    labels = [reference.label(events, reference.primary_impacts(events, plant.contact_period(k), k), k) for k in (1, 2)]
    assert labels[0] == labels[1] != "NI"


def test_an_impact_passes_through_flanks_that_it_presses_and_parts_those_that_it_pulls():
    """Three inertias in a row, the first two pressed together, struck by the last at 1 rad/s, e = 1/2."""
    lashes = (Lash((1, 2), 0.1, restitution=0.5), Lash((2, 3), 0.1, restitution=0.5))
    plant = replace(
        FREE, inertias=(1.0, 2.0, 3.0), shafts=((1, "ground", 0.0, 0.1),), other_lashes=lashes, before=-1.0, after=-1.0
    )
    pressed = (reference.Mode("closed", -1), reference.Mode("open"))
    speeds = {}
    for speed in (1.0, -1.0):  # of inertia 3: it pushes 2 against 1, or away
        flow = reference.Flow(plant)
        z = flow.augmented(flow.coordinates(np.array([-0.05, 0.0, 0.05 * speed, 0.0, 0.0, speed])), 0, 0.0)
        touch = reference.Guard(np.zeros(len(z)), "touch", -int(speed), None, 1)
        modes, after, _ = reference._struck(flow, pressed, z, touch, {})
        speeds[speed] = flow.state(after[:6])[3:]
        assert modes == ((pressed[0] if speed > 0.0 else reference.OPEN), reference.OPEN)
    # pushed, 1 and 2 take half of the 1.5 rad/s as one of 3 kg m2; pulled, 2 alone takes 0.6 of them
    assert speeds[1.0] == pytest.approx([0.75, 0.75, 0.25], abs=1e-14)
    assert speeds[-1.0] == pytest.approx([0.0, -0.9, -0.4], abs=1e-14)


# Random drivelines: (lashes, staged shafts, frictions)

MIXTURES = [(2, 0, 0), (3, 0, 0), (1, 2, 0), (1, 0, 2), (0, 1, 3), (2, 1, 2)]


def is_steady(plant):
    """The accelerations of the motion before the load step are the rigid body's."""
    _, state = plant.steady_motion(plant.before)
    _, expected = plant.steady_speeds(plant.before)
    calm = replace(plant, profile=reference.step(), after=plant.before)
    accelerations = general.torques(calm, 0.0, state) / np.array(plant.inertias)
    scale = 1e4 * max(np.abs(state[: plant.n]).max(), 1.0) / min(plant.inertias)
    assert accelerations == pytest.approx(expected, abs=1e-12 * scale)


def reordered(plant, seed):
    """The plant with its inertias, shafts and lashes in another order, and the names of its lashes and shafts there."""
    rng = np.random.default_rng(seed)
    places, shafts, lashes = (rng.permutation(n) for n in (plant.n, len(plant.shafts), len(plant.other_lashes)))
    number = {"ground": "ground"} | {int(old) + 1: new + 1 for new, old in enumerate(places)}
    names = {f"{what} {old + 1}": f"{what} {new + 1}" for what, order in (("shaft", shafts), ("lash", lashes))
             for new, old in enumerate(order)}  # fmt: skip
    return names, replace(
        plant,
        inertias=tuple(plant.inertias[k] for k in places),
        shafts=tuple(
            plant.shafts[k]._replace(one=number[plant.shafts[k].one], other=number[plant.shafts[k].other])
            for k in shafts
        ),
        ratios=tuple(plant.ratios[k] for k in shafts),
        other_lashes=tuple(
            plant.other_lashes[k]._replace(between=tuple(number[end] for end in plant.other_lashes[k].between))
            for k in lashes
        ),
        loaded=number[plant.loaded],
    )


def does_not_depend_on_the_order(plant, seed):
    """The events of each element, as far as chatter has not magnified rounding to 1e-9 s."""
    names, other = reordered(plant, seed)
    one, two = run(plant, 0.2)[0], run(other, 0.2)[0]
    parting = next(
        (event.time for event, again in zip(one, two, strict=False) if abs(event.time - again.time) > 1e-9), 1
    )
    for name, there in names.items():
        events, again = (
            [(event.kind, event.side) for event in events if event.element == element and event.time < parting - 1e-9]
            for events, element in ((one, name), (two, there))
        )
        assert events == again


@pytest.mark.parametrize("counts", MIXTURES, ids=str)
@pytest.mark.parametrize("seed", [1])
def test_any_order_gives_the_same_events(seed, counts):
    plant = element_plant(seed, *counts)
    assert plant == element_plant(seed, *counts)
    is_steady(plant)
    does_not_depend_on_the_order(plant, seed)


def is_the_motion_of_a_general_integrator(plant, end_time):
    """To the 1e-11 that it is told, magnified by a few impacts."""
    _, state = plant.steady_motion(plant.before)
    final = run(plant, end_time)[1]
    assert final == pytest.approx(general.integrated(plant, end_time, state, 1e-3), abs=1e-6, rel=1e-8)


def is_the_limit_of_time_stepping(plant, end_time):
    """Of first order: halving the step halves the error; where a sticking begins may leave a little more."""
    _, state = plant.steady_motion(plant.before)
    final = run(plant, end_time)[1]
    coarse, fine = (general.stepped(plant, end_time, state, step) for step in (2e-4, 1e-4))
    allowed = 3.0 * np.abs(coarse - fine).max() + 1e-3 * np.abs(final).max()
    assert np.abs(final - fine).max() <= allowed


@pytest.mark.parametrize(("seed", "counts"), [(0, (3, 0, 0)), (1, (1, 2, 0))], ids=str)
def test_lashes_and_stages_by_a_general_integrator(seed, counts):
    is_the_motion_of_a_general_integrator(element_plant(seed, *counts), 0.05)


@pytest.mark.parametrize(("seed", "counts"), [(0, (0, 0, 2)), (3, (0, 1, 3)), (0, (1, 0, 2))], ids=str)
def test_friction_by_time_stepping(seed, counts):
    is_the_limit_of_time_stepping(element_plant(seed, *counts), 0.06)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 12))
def test_many_random_drivelines(seed):
    for counts in MIXTURES:
        for restitution in (None, 0.5):
            plant = element_plant(seed, *counts, restitution=restitution)
            does_not_depend_on_the_order(plant, seed)
        plant = element_plant(seed, *counts)
        is_steady(plant)
        (is_the_limit_of_time_stepping if counts[2] else is_the_motion_of_a_general_integrator)(plant, 0.06)
