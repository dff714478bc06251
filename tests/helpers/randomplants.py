"""Random drivelines with one lash, for property tests: chains, trees and loops of 1 to 8 inertias.

Inertias of 0.0025 to 0.04 kg m² and shafts of 8 to 120 N m/rad turn at some 15 to 200 rad/s; contacts are 10 to 100
times as stiff as a shaft. Half a second is then several swings of the softest mode and a hundred of the contact's.
"""

from dataclasses import replace

import numpy as np
from hypothesis import assume, reject
from hypothesis import strategies as st

from helpers import reference
from helpers.reference import Plant

END_TIME = 0.5  # s


@st.composite
def plants(draw, restitution=None):
    """A plant, and the state that it starts from: None for preload."""
    octaves = st.floats(-2.0, 2.0).map(lambda power: round(2.0**power, 3))
    to_ground = draw(st.booleans())
    n = draw(st.integers(1 if to_ground else 2, 8))
    inertias = tuple(0.01 * draw(octaves) for _ in range(n))
    # the two parts that the lash joins: a tree each, and maybe a loop
    first = n if to_ground else draw(st.integers(1, n - 1))
    parts = [list(range(1, first + 1)), list(range(first + 1, n + 1))]
    pairs = []
    for part in parts:
        chain = draw(st.booleans())
        for k in range(1, len(part)):
            pairs.append((part[k - 1 if chain else draw(st.integers(0, k - 1))], part[k]))
        if len(part) > 2 and draw(st.integers(0, 3)) == 0:
            pairs.append((part[0], part[-1]))
    # what holds them: a spring to ground at either part, or at both, or nothing
    for part in [part for part in parts if part]:
        if draw(st.integers(0, 3)) > 0:
            pairs.append((draw(st.sampled_from(part)), "ground"))
    damped = draw(st.sampled_from(["none", "one", "all", "heavy"]))
    shafts = []
    for k, (one, other) in enumerate(pairs):
        stiffness = 30.0 * draw(octaves)
        share = {"none": 0.0, "one": 0.05 * (k == 0), "all": 0.05, "heavy": 2.0}[damped]
        shafts.append((one, other, stiffness, round(float(share * np.sqrt(stiffness * 0.01)) * draw(octaves), 6)))
    if damped != "none" and draw(st.booleans()):
        shafts.append((draw(st.integers(1, n)), "ground", 0.0, 0.05 * draw(octaves)))
    contact_stiffness = 30.0 * draw(st.floats(10.0, 100.0).map(lambda factor: round(factor, 2)))
    contact_damping = draw(st.sampled_from([0.0, 0.02, 0.2, 0.7])) * 2.0 * np.sqrt(contact_stiffness * 0.005)
    after = draw(st.sampled_from([-1.0, 1.0, -0.2, 0.0]))
    plant = Plant(
        inertias=inertias,
        shafts=tuple(shafts),
        lash=(draw(st.integers(1, n)), "ground")
        if to_ground
        else (draw(st.sampled_from(parts[0])), draw(st.sampled_from(parts[1]))),
        contact_stiffness=contact_stiffness,
        contact_damping=round(float(contact_damping), 6),
        backlash=draw(st.sampled_from([0.001, 0.01, 0.05, 0.2])),
        before=draw(st.sampled_from([-8.0, -4.0, -2.0, 2.0, 4.0, 8.0])),
        after=after,
        loaded=draw(st.integers(1, n)),
        acceleration_of=draw(st.integers(1, n)),
        separation=draw(st.sampled_from(["gap", "force"])) if restitution is None else "gap",
        restitution=restitution,
    )
    held = any(shaft[2] > 0.0 and "ground" in shaft for shaft in shafts) or to_ground
    return plant, _start(draw, plant, held)


def _start(draw, plant, held=True):
    """None for most plants that have a preload, which a run then starts from, and a state in the gap for the others."""
    if held and draw(st.integers(0, 4)) > 0:
        try:
            plant.preload()
        except ValueError:  # the load does not reach the lash
            pass
        else:
            return None
    return _state_in_the_gap(draw, plant)


def _state_in_the_gap(draw, plant):
    angles, n = st.floats(-1.0, 1.0).map(lambda value: round(value, 4)), plant.n
    state = np.array([0.1 * draw(angles) for _ in range(n)] + [3.0 * draw(angles) for _ in range(n)])
    inside = 0.4 * plant.backlash * draw(angles)
    state[:n] += plant.twist * (inside - plant.twist @ state[:n]) / (plant.twist @ plant.twist)
    return state


@st.composite
def profiles(draw):
    """A load profile whose changes last from a fraction of a contact period to longer than a run."""
    durations = st.floats(-3.0, -0.2).map(lambda power: round(10.0**power, 5))
    name = draw(st.sampled_from(["step", "ramp", "smooth", "lag", "pulse", "table", "table", "sine"]))
    if name == "step":
        return reference.step()
    if name == "table":
        waits = st.one_of(durations, durations, durations, st.just(0.0))
        times, torques = [0.0], [draw(st.sampled_from([-8.0, -4.0, 4.0, 8.0]))]
        for wait in draw(st.lists(waits, max_size=8)):
            third = wait == 0.0 and times[-2:-1] == times[-1:]  # three equal times are an error
            times.append(times[-1] + (0.01 if third else wait))
            torques.append(round(draw(st.floats(-8.0, 8.0)), 3))
        return reference.table(times, torques)
    if name == "sine":
        frequency = round(draw(st.floats(0.5, 40.0)), 3)
        return reference.sine(round(draw(st.floats(0.2, 5.0)), 3), frequency, draw(st.sampled_from([0.0, 1.0, -2.0])))
    return getattr(reference, name)(draw(durations))


@st.composite
def general_plants(draw, restitution=None):
    """A plant with gear ratios and a load profile, often free to roll, and its state: None for steady motion."""
    plant, _ = draw(plants(restitution))
    if "ground" not in plant.lash and draw(st.integers(0, 2)) > 0:
        plant = _let_go(draw, plant)
    plant = replace(_with_gears(draw, plant), profile=draw(profiles()))
    return plant, _start(draw, plant)


@st.composite
def rolling_plants(draw, restitution=None):
    """A plant with gear ratios that nothing holds to ground, and None: it starts from steady motion."""
    plant, _ = draw(plants(restitution).filter(lambda drawn: "ground" not in drawn[0].lash))
    plant = _with_gears(draw, _let_go(draw, plant))
    assume(plant.rigid_motion.size)  # ratios along a loop may not fit each other
    try:
        plant.preload()
    except ValueError:  # the load does not reach the lash
        reject()
    return plant, None


def _let_go(draw, plant):
    """The plant without springs to ground, or with bearings in their place."""
    bearing = draw(st.sampled_from([0.0, 0.0, 0.02]))
    return replace(
        plant,
        shafts=tuple((*ends, 0.0, bearing) if "ground" in ends else (*ends, k, c) for *ends, k, c in plant.shafts),
    )


def _with_gears(draw, plant):
    ratios = st.sampled_from([1.0, 1.0, 1.0, -1.0, 2.5, 0.4, -0.7, 3.7])
    return replace(plant, ratios=tuple(draw(ratios) for _ in plant.shafts), lash_ratio=draw(ratios))


def nudged(plant, state, share):
    """The same, a little off, in everything that a run starts from."""
    if state is None:
        first, *others = plant.profile.torques or (0.0,)
        profile = replace(plant.profile, torques=(first * (1.0 + share), *others)[: len(plant.profile.torques)])
        backlash = plant.backlash * (1.0 - 0.3 * share)
        return replace(plant, before=plant.before * (1.0 + share), backlash=backlash, profile=profile), None
    signs = np.where(np.arange(state.size) % 2, 1.0, -1.0)
    return plant, state * (1.0 + share * signs)
