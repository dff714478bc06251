"""The independent reference with several lashes, staged shafts and Coulomb friction: closed forms and others' numbers."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import reference
from helpers.reference import Lash, Plant, Shaft, pulse, ramp, run, sine
from scipy.optimize import brentq

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
    assert seen(events) == [*(("shaft 1", "slip", (-1) ** k) for k in range(1, 7)), ("shaft 1", "stick", 0)]
    assert times_of(events[1:]) == pytest.approx(phase + np.pi * np.arange(7), abs=1e-11)
    turns = [abs(event.state[0]) for event in events[1:]]
    assert turns == pytest.approx(radius - 1.0 - 2.0 * np.arange(7), abs=1e-11)  # 2 F/k less each half period
    assert (turns[0], events[1].time) == pytest.approx((13.31782106, 0.43240778), abs=6e-9)
    assert (final[0], events[-1].time) == pytest.approx((0.68217894, 22.423556), abs=5e-7)
    assert final[1] == 0.0


def clutch_and_brake(brake):
    """J3, J2 and J1 of the Modelica Standard Library's Mechanics.Rotational.Examples.Friction."""
    shafts = (Shaft(1, 2, 0.0, 0.0, friction=80.0), Shaft(2, 3, 160.0, 1.0), Shaft(3, "ground", 0.0, 0.0, friction=brake))
    return replace(FREE, inertias=(1.0, 0.05, 1.0), shafts=shafts)


def test_a_clutch_and_a_brake_are_those_of_modelica():
    """Its stored reference results are good to some 1e-5: the speeds are, and times where they change fast."""
    swung = replace(clutch_and_brake(0.0), profile=sine(200.0, 50.0 / np.pi))
    events, state = run(swung, 0.5, np.array([0.0, 0.0, 0.0, 100.0, 90.0, 90.0]))
    later, final = run(clutch_and_brake(800.0), 2.5, state)
    assert seen(events) == [("shaft 1", "stick", 0), ("shaft 1", "slip", 1), ("shaft 1", "stick", 0)]
    assert times_of(events[1:]) == pytest.approx([0.0067797090, 0.0593400564, 0.1092894952], abs=2e-6)
    assert events[1].time == pytest.approx(0.0067797089, abs=1e-10)  # closed form
    assert seen(later) == [("shaft 1", "slip", 1), ("shaft 3", "stick", 0), ("shaft 1", "stick", 0)]
    assert 0.5 + times_of(later[1:]) == pytest.approx([0.5342486454, 0.6406138053, 1.6636397837], abs=2e-5)
    assert final[3] == pytest.approx(2.289891, abs=1e-5)
