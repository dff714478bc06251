"""Random drivelines: chains, trees and loops of 1 to 8 inertias, geared, held or free, under any load.

Inertias of 0.0025 to 0.04 kg m² and shafts of 8 to 120 N m/rad turn at some 15 to 200 rad/s; contacts are 10 to 100
times as stiff as a shaft. A third of a second is then several swings of the softest mode and many of the contact's.
"""

from dataclasses import replace

import numpy as np

from helpers import reference
from helpers.reference import Lash, Plant, Shaft


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
    """A driveline of 1 to 8 inertias with so many lashes, staged shafts and frictions; the same for the same seed.

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

    n, before = int(rng.integers(max(1, lashes), 9)), float(rng.choice([-8.0, -4.0, -2.0, 2.0, 4.0, 8.0]))
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
    damping = rng.choice([0.0, 0.05, 0.5, 4.0])
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
    ratios = rng.choice([1.0, 1.0, 1.0, -1.0, 2.5, 0.4, -0.7, 3.7], (2, 20)).tolist()
    return Plant(
        inertias=tuple(octaves(0.01) for _ in range(n)),
        shafts=tuple(shafts),
        ratios=tuple(ratios[0][: len(shafts)]),
        lash=(),
        other_lashes=tuple(
            Lash(
                ends,
                float(rng.choice([0.001, 0.01, 0.05, 0.2])),
                stiffness := round(30.0 * rng.uniform(10.0, 100.0), 3),
                round(float(rng.choice([0.0, 0.04, 0.4, 1.4])) * float(np.sqrt(stiffness * 0.005)), 6),
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
    name = str(rng.choice(["step", "ramp", "smooth", "lag", "pulse", "sine", "table"]))
    if name == "step":
        return reference.step()
    if name == "sine":
        return reference.sine(round(rng.uniform(1.0, 6.0), 3), round(rng.uniform(1.0, 30.0), 3))
    if name == "table":
        torques = [before, *rng.uniform(-8.0, 8.0, 4).round(3).tolist()]
        return reference.table((0.0, length, length, 2.0 * length, 4.0 * length), torques)
    return getattr(reference, name)(length)


def state_in_the_gaps(plant, seed):
    """A random state with all lashes open, from which a run may start: (2n,)."""
    rng = np.random.default_rng(seed)
    angles, speeds = rng.uniform(-0.1, 0.1, plant.n), rng.uniform(-3.0, 3.0, plant.n)
    rows = np.array([element.row for element in plant.elements if isinstance(element.behaviour, Lash)])
    inside = [rng.uniform(-0.4, 0.4) * lash.backlash for lash in plant.lashes]
    return np.concatenate([angles + np.linalg.pinv(rows) @ (inside - rows @ angles), speeds])
