"""The independent reference and both methods, held to closed forms: one inertia on a shaft, under every load."""

from itertools import pairwise

import numpy as np
import pytest
from helpers import reference
from helpers.reference import PROFILES, Plant, lag, step
from helpers.starts import started

from clunk.simulation.history import sample

CLOSE = {"reference": 2e-12, "exact": 2e-12, "rk4": 1e-9}  # rad; rk4 is late by (55 rad/s h)⁴/120 = 8e-12 a radian
INERTIA, DAMPING, STIFFNESS = 0.01, 0.05, 30.0
POLES = np.roots([INERTIA, DAMPING, STIFFNESS])


def to_wave(rate, t):
    """(θ, θ', θ'') from rest under exp(rate t) from t = 0 on, complex: partial fractions of 1/((s - rate) P(s))."""
    amplitude = 1.0 / np.polyval([INERTIA, DAMPING, STIFFNESS], rate)
    terms = [(amplitude, rate), *((1.0 / ((2.0 * INERTIA * p + DAMPING) * (p - rate)), p) for p in POLES)]
    return (t >= 0.0) * np.array([sum(a * p**k * np.exp(p * np.abs(t)) for a, p in terms) for k in range(3)])


def to_slope(t):
    """(θ, θ', θ'') from rest under the torque t from t = 0 on: partial fractions of 1/(s² P(s))."""
    terms = [(1.0 / ((2.0 * INERTIA * p + DAMPING) * p**2), p) for p in POLES]
    straight = [t / STIFFNESS - DAMPING / STIFFNESS**2, 1.0 / STIFFNESS, 0.0]
    waves = [sum(a * p**k * np.exp(p * np.abs(t)) for a, p in terms) for k in range(3)]
    return (t >= 0.0) * np.array([line + wave.real for line, wave in zip(straight, waves, strict=True)])


def to_step(t):
    return to_wave(0.0, t).real


def by_hand(profile, before, after, t):
    """(3, T): θ, θ', θ'' of the inertia at the times t, from rest under `before`, by superposition."""
    change, d, t = after - before, profile.duration, np.atleast_1d(t)
    rest = np.array([[before / STIFFNESS], [0.0], [0.0]])
    match profile.name:
        case "step":
            moved = change * to_step(t)
        case "ramp":
            moved = change / d * (to_slope(t) - to_slope(t - d))
        case "smooth":  # 1 - cos(πt/d), and the same again from d on, which makes 2
            bumps = [to_step(u) - to_wave(1j * np.pi / d, u).real for u in (t, t - d)]
            moved = change / 2.0 * (bumps[0] + bumps[1])
        case "lag":
            moved = change * (to_step(t) - to_wave(-1.0 / profile.time_constant, t).real)
        case "pulse":
            moved = change * (to_step(t) - to_step(t - d))
        case "table":
            moved, knots = 0.0, list(zip(profile.times, profile.torques, strict=True))
            for (begin, torque), (end, following) in pairwise(knots):
                if end == begin:
                    moved = moved + (following - torque) * to_step(t - begin)
                else:
                    slope = (following - torque) / (end - begin)
                    moved = moved + slope * (to_slope(t - begin) - to_slope(t - end))
        case "sine":
            omega = 2.0 * np.pi * profile.frequency
            swing = profile.amplitude * to_wave(1j * omega, t).imag
            moved = change * to_step(t) + swing
    return rest + moved


@pytest.mark.parametrize("method", CLOSE)
@pytest.mark.parametrize("profile", [step(), lag(2e-3), *PROFILES.values()], ids=str)  # a lag of half a contact period
def test_an_inertia_on_a_shaft_moves_by_the_closed_form(profile, method):
    """In a gap that it never leaves, from rest under the torque before the load step."""
    plant = Plant(
        inertias=(INERTIA,),
        shafts=((1, "ground", STIFFNESS, DAMPING),),
        lash=(1, "ground"),
        backlash=6.0,
        acceleration_of=1,
        profile=profile,
    )
    state = np.array([plant.before / STIFFNESS, 0.0])
    if method == "reference":
        times = np.array([0.03, 0.2, 0.3, 0.47])
        moved = np.array([reference.run(plant, end_time, state)[1] for end_time in times]).T
    else:
        study = reference.study_of(plant, end_time=0.5, method=method)
        history = sample(started(study, state), step=1e-3, until=0.5)
        after = history.after_step > 0.0
        times, moved = history.after_step[after], np.vstack((history.angle[after, 0], history.velocity[after, 0]))
    scales = np.array([[1.0], [55.0]])  # of the angle and the speed
    assert np.all(
        np.abs(moved - by_hand(plant.profile, plant.before, plant.after, times)[:2]) <= CLOSE[method] * scales
    )
