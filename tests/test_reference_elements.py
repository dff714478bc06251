"""The independent reference with several lashes, staged shafts and friction: closed forms and others' numbers."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.reference import Plant, Shaft, pulse, ramp, run, sine, table

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

STAGED = Plant(
    inertias=(0.024, 0.002, 0.002, 0.002),
    shafts=(Shaft(1, 2, (10.0, 60.0), 0.08, (-0.15,)), (2, 3, 31.3, 0.04), (4, "ground", 31.3, 0.1)),
)


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
