"""Random drivelines for property tests: chains, trees and loops of 1 to 8 inertias.

Inertias of 0.0025 to 0.04 kg m² and shafts of 8 to 120 N m/rad turn at some 15 to 200 rad/s; contacts are 10 to 100
times as stiff as a shaft. Half a second is then several swings of the softest mode and a hundred of the contact's.
"""

from dataclasses import replace

import numpy as np
from hypothesis import assume, reject
from hypothesis import strategies as st

from helpers import reference
from helpers.reference import Lash, Plant, Shaft

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
    """The same, a little off, in everything that a run starts from; a load taken off becomes a pull."""
    if state is None:
        first, *others = plant.profile.torques or (0.0,)
        profile = replace(plant.profile, torques=(first * (1.0 + share), *others)[: len(plant.profile.torques)])
        backlash = plant.backlash * (1.0 - 0.3 * share)
        before, after = plant.before * (1.0 + share), plant.after - plant.before * share
        return replace(plant, before=before, after=after, backlash=backlash, profile=profile), None
    signs = np.where(np.arange(state.size) % 2, 1.0, -1.0)
    return plant, state * (1.0 + share * signs)


def clutch_plant(seed):
    """An engine, a clutch with stages and friction on one shaft, a gear with play, a vehicle that rolls or is held.

    Every third has stages that meet at twist 0; every third, if held, begins with the torque of a breakpoint.
    """
    rng = np.random.default_rng(seed)
    slopes = np.round(rng.uniform(100.0, 3000.0, int(rng.integers(2, 4))), 1)
    breakpoints = np.array([0.0, 0.1] if seed % 3 == 0 else [0.06, 0.15])[: slopes.size - 1]
    held, before = rng.random() < 0.4, float(np.round(rng.choice([-1.0, 1.0]) * rng.uniform(50.0, 600.0), 1))
    if held and seed % 3 == 1:
        before = float(slopes[0] * breakpoints[0])
    friction = float(np.round(rng.uniform(1.0, 30.0), 2))
    shafts = (
        Shaft(1, 2, tuple(slopes.tolist()), 0.5, tuple(breakpoints.tolist()), friction),
        Shaft(3, 4, 1e4, 3.0, friction=float(rng.choice([0.0, 2.0]))),
        Shaft(4, "ground", 2e4 if held else 0.0, float(np.round(rng.uniform(1.0, 30.0), 2))),
    )
    return Plant(
        inertias=tuple(np.round([rng.uniform(0.2, 1.5), 0.05, 0.05, rng.choice([2.0, 100.0])], 4).tolist()),
        shafts=shafts,
        ratios=(1.0, float(rng.choice([1.0, 3.5])), 1.0),
        lash=(2, 3),
        lash_ratio=float(rng.choice([1.0, 6.5, -2.0])),
        contact_stiffness=4e4,
        contact_damping=float(rng.choice([0.0, 2.0])),
        backlash=float(rng.choice([0.002, 0.02])),
        before=before,
        after=-0.1 * before,
        acceleration_of=2,
        **({"separation": "force"}, {"restitution": 0.5}, {})[int(rng.integers(3))],
    )


def element_plant(seed, lashes=0, staged=0, frictions=0, restitution=None):
    """A driveline of 2 to 6 inertias with so many lashes, staged shafts and frictions; the same for the same seed.

    It has a steady motion before its load step, from which a run starts.
    """
    rng = np.random.default_rng(seed)
    for _ in range(10000):
        plant = _driveline(rng, lashes, staged, frictions, restitution)
        if plant is not None:
            try:
                plant.steady_motion(plant.before)
            except ValueError:  # the load does not reach a lash
                continue
            return plant
    raise ValueError("no driveline of this kind is steady")


def _driveline(rng, lashes, staged, frictions, restitution):
    """A plant, whether it has a steady motion or not, or None if it has too few joints."""

    def octaves(size):
        return round(size * 2.0 ** rng.uniform(-2.0, 2.0), 6)

    n, before = int(rng.integers(max(2, lashes), 7)), float(rng.choice([-8.0, -4.0, 4.0, 8.0]))
    chain = rng.random() < 0.5
    pairs = [(int(k - 1 if chain else rng.integers(1, k)), k) for k in range(2, n + 1)]
    if rng.random() < 0.6:
        pairs.append((int(rng.integers(1, n + 1)), "ground"))
    pairs = [pairs[k] for k in rng.permutation(len(pairs))]
    pairs, loose = pairs[lashes:], pairs[:lashes]
    if n > 2 and rng.random() < 0.2:  # a loop
        pairs.append((1, n))
    if len(loose) < lashes or len(pairs) < staged:
        return None
    damping = rng.choice([0.0, 0.05, 0.5])
    shafts = [Shaft(*ends, octaves(30.0), round(float(damping) * octaves(0.5), 6)) for ends in pairs]
    for k in range(staged):
        breakpoints = np.unique(rng.uniform(-0.1, 0.1, rng.integers(1, 4)).round(4))
        stiffnesses = [octaves(30.0) for _ in range(len(breakpoints) + 1)]
        if staged == 1 and rng.random() < 0.3:
            stiffnesses[rng.integers(len(stiffnesses))] = 0.0
        shafts[k] = shafts[k]._replace(stiffness=tuple(stiffnesses), breakpoints=tuple(breakpoints.tolist()))
    shafts += [Shaft(k, "ground", 0.0, octaves(0.02)) for k in range(1, n + 1) if rng.random() < 0.3]
    shafts += [Shaft(int(rng.integers(1, n + 1)), "ground", 0.0, 0.0) for _ in range(frictions)]
    for k in rng.permutation(len(shafts))[:frictions]:
        shafts[k] = shafts[k]._replace(friction=round(abs(before) * rng.uniform(0.02, 0.6), 4))
    shafts = [shaft for shaft in shafts if shaft.stiffness or shaft.damping or shaft.friction]
    ratios = rng.choice([1.0, 1.0, 1.0, -1.0, 2.5, 0.4], (2, 12)).tolist()
    return Plant(
        inertias=tuple(octaves(0.01) for _ in range(n)),
        shafts=tuple(shafts),
        ratios=tuple(ratios[0][: len(shafts)]),
        lash=(),
        other_lashes=tuple(
            Lash(
                ends,
                float(rng.choice([0.001, 0.01, 0.05, 0.1])),
                stiffness := round(30.0 * rng.uniform(10.0, 100.0), 3),
                round(float(rng.choice([0.0, 0.04, 0.4])) * float(np.sqrt(stiffness * 0.005)), 6),
                str(rng.choice(["gap", "force"])),
                ratio,
                restitution,
            )
            for ends, ratio in zip(loose, ratios[1], strict=False)
        ),
        before=before,
        after=float(rng.choice([-1.0, 1.0, 0.2])),
        loaded=int(rng.integers(1, n + 1)),
        acceleration_of=1,
        profile=_profile(rng, before),
    )


def _profile(rng, before):
    length = round(10.0 ** rng.uniform(-2.5, -0.7), 5)
    match rng.integers(0, 5):
        case 0:
            return reference.step()
        case 1:
            return reference.ramp(length)
        case 2:
            return reference.pulse(length)
        case 3:
            return reference.sine(round(rng.uniform(1.0, 6.0), 3), round(rng.uniform(1.0, 30.0), 3))
    torques = [before, *rng.uniform(-8.0, 8.0, 4).round(3).tolist()]
    return reference.table((0.0, length, length, 2.0 * length, 4.0 * length), torques)
