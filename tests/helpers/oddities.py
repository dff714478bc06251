"""Random drivelines beside those of `studies`: loops, lashes to ground and side by side, dead bands, no gap at all.

One to six inertias are joined to a tree, with up to two joints more that close loops, to each other and to ground; one
to three of all joints are lashes. Ends come in either order. Shafts may have up to four stages, some of them without
stiffness, frictions, no damping or a lot. Any inertia may be loaded. Numbers are those of a rig.
"""

import tomllib

import numpy as np
import tomli_w

from clunk.study.config import study_from_text
from helpers.studies import PROFILES

RATIOS = (1.0, 1.0, 1.0, -1.0, 2.5, -0.4)


def odd_table(seed):
    """The tables of an odd driveline under a load, the same for the same seed."""
    rng = np.random.default_rng([seed, 7])
    count = int(rng.integers(1, 7))
    inertias = [_between(rng, 0.003, 0.3) for _ in range(count)]
    joints, turns = _joints(rng, count)
    loose = min(int(rng.choice([1, 1, 2, 3])), len(joints))
    are_rigid, restitution = rng.random() < 0.35, float(rng.choice([0.0, 0.3, 0.7, 1.0]))
    before = float(rng.choice([-1, 1])) * _between(rng, 1.0, 30.0)
    shafts, lashes = [], []
    for at, (one, other, ratio) in enumerate(joints):
        joint = _ends(rng, one, other, ratio)
        lightest = inertias[one] if other is None else min(inertias[one], inertias[other])
        if at < loose:
            lashes.append(joint | _lash(rng, lightest, are_rigid, restitution))
        else:
            shafts.append(joint | _shaft(rng, lightest, abs(before)))
    if all(other is not None for _, other, _ in joints) and rng.random() < 0.5:
        shafts.append({"between": [int(rng.integers(1, count + 1)), "ground"], "damping": _between(rng, 0.01, 1.0)})
    if rng.random() < 0.5 and count > 1:
        one, other = rng.choice(count, 2, replace=False)
        drag = {"ratio": float(turns[one] / turns[other]), "damping": _between(rng, 0.01, 0.2), "stiffness": 0.0}
        shafts.append({"between": [int(one) + 1, int(other) + 1]} | drag)
    load = _load(rng, before, count)
    if len(lashes) > 1:
        lashes = [lash | {"name": f"L{k}"} for k, lash in enumerate(lashes)]
    return {
        "driveline": {"inertias": inertias, "shafts": shafts},
        "lash": lashes if len(lashes) > 1 else lashes[0],
        "load": load,
        "solver": {"method": "exact", "step": 2e-5, "end_time": 0.6},
    }


def rigid_table(seed):
    """The tables of a tree with two or three lashes of rigid flanks and light parts, which part at one time."""
    rng = np.random.default_rng([seed, 31])
    count = int(rng.integers(3, 7))
    inertias = [_between(rng, 0.003, 0.3) * float(rng.choice([1, 1, 1, 1, 1e-2, 1e-4])) for _ in range(count)]
    joints = [(int(rng.integers(max(0, k - 2), k)), k, float(rng.choice(RATIOS))) for k in range(1, count)]
    loose = min(len(joints), int(rng.choice([2, 3, 3, 3])))
    rng.shuffle(joints)
    before = float(rng.choice([-1, 1])) * _between(rng, 1.0, 30.0)
    contact = {"model": "restitution", "restitution": float(rng.choice([0.0, 0.3, 0.7]))}
    lashes, shafts = [], []
    for at, (one, other, ratio) in enumerate(joints):
        joint = _ends(rng, int(one), int(other), ratio)
        if at < loose:
            lash = {"name": f"L{at}", "backlash_deg": _between(rng, 0.1, 20.0), "radius": 0.08, "contact": contact}
            lashes.append(joint | lash)
        else:
            shaft = _shaft(rng, min(inertias[int(one)], inertias[int(other)]), abs(before))
            linear = shaft["stiffness"] if isinstance(shaft["stiffness"], float) else 50.0
            shafts.append(joint | {"stiffness": linear, "damping": shaft["damping"]})
    end, is_free = int(rng.integers(1, count + 1)), rng.random() < 0.6
    if not is_free:
        stiffness = {} if rng.random() < 0.4 else {"stiffness": _between(rng, 5, 500)}
        shafts.append({"between": [end, "ground"], **stiffness, "damping": _between(rng, 0.01, 1.0)})
    load = _load(rng, before, count)
    if is_free and load["profile"] != "table" and rng.random() < 0.3:
        load["final_torque"] = 0.0
    return {
        "driveline": {"inertias": inertias, "shafts": shafts},
        "lash": lashes,
        "load": load,
        "solver": {"method": "exact", "step": 2e-5, "end_time": 0.6},
    }


def study_of_table(table, method="exact"):
    """The study that tables describe."""
    return study_from_text(tomli_w.dumps(table | {"solver": table["solver"] | {"method": method}}))


def in_other_units(table, time, mass):
    """The tables with times and masses in other units, without the sweep: so many times the numbers."""
    table = tomllib.loads(tomli_w.dumps(table))
    table.pop("sweep", None)
    torque = mass / time**2  # and stiffness
    driveline, load, solver = table["driveline"], table["load"], table["solver"]
    _times(driveline, mass, "inertias")
    for shaft in driveline.get("shafts", []):
        _times(shaft, torque, "stiffness", "friction")
        _times(shaft, mass / time, "damping")
    for lash in _lashes_of(table):
        _times(lash["contact"], torque, "stiffness")
        _times(lash["contact"], mass / time, "damping")
    _times(load, torque, "initial_torque", "final_torque", "amplitude", "torques")
    _times(load, time, "duration", "time_constant", "durations", "times")
    _times(load, 1.0 / time, "frequency")
    _times(solver, time, "step", "end_time")
    return table


def in_another_order(table, seed):
    """The tables with the inertias numbered in another way and the shafts in another order, without the sweep."""
    table, rng = tomllib.loads(tomli_w.dumps(table)), np.random.default_rng([seed, 99])
    table.pop("sweep", None)
    driveline = table["driveline"]
    order = rng.permutation(len(driveline["inertias"]))
    number = {int(old) + 1: new for new, old in enumerate(order, 1)} | {"ground": "ground"}
    driveline["inertias"] = [driveline["inertias"][old] for old in order]
    for joint in (*driveline.get("shafts", []), *_lashes_of(table)):
        joint["between"] = [number[end] for end in joint["between"]]
    table["load"]["on"] = number[table["load"]["on"]]
    rng.shuffle(driveline.get("shafts", []))
    return table


def _lashes_of(table):
    return table["lash"] if isinstance(table["lash"], list) else [table["lash"]]


def _times(table, factor, *keys):
    for key in keys:
        if key in table:
            value = table[key]
            table[key] = [factor * each for each in value] if isinstance(value, list) else factor * value


def _between(rng, low, high):
    return float(f"{low * (high / low) ** rng.random():.4g}")


def _joints(rng, count):
    """(one end, the other or None for ground, ratio) of all joints, in any order; and the turns of each inertia."""
    turns, joints = [1.0], []
    for k in range(1, count):
        one, ratio = int(rng.integers(0, k)), float(rng.choice(RATIOS))
        turns.append(turns[one] / ratio)
        joints.append((one, k, ratio))
    for _ in range(int(rng.choice([0, 0, 1, 2]))):  # loops, whose ratios fit
        if count > 1:
            one, other = rng.choice(count, 2, replace=False)
            joints.append((int(one), int(other), turns[one] / turns[other]))
    if rng.random() < 0.6 or count == 1:
        joints += [(int(rng.integers(0, count)), None, 1.0) for _ in range(int(rng.choice([1, 1, 2])))]
        joints += [(0, None, 1.0)] * (count == 1)
    rng.shuffle(joints)
    return joints, turns


def _ends(rng, one, other, ratio):
    ends = [one + 1, "ground" if other is None else other + 1]
    joint = {"between": ends}
    if other is not None and ratio != 1.0:
        joint["ratio"] = ratio
    if rng.random() < 0.3:
        ends.reverse()
        joint["ratio"] = float(rng.choice(RATIOS)) if other is None else 1.0 / ratio
    return joint


def _lash(rng, lightest, are_rigid, restitution):
    radius = _between(rng, 0.02, 0.2)
    gaps = [0.0, *(_between(rng, 0.1, 5.0) for _ in range(3)), _between(rng, 5.0, 40.0)]
    lash = {"backlash_deg": float(rng.choice(gaps)), "radius": radius}
    stiffness = _between(rng, 200.0, 2e4) * max(1.0, lightest / 0.02)
    if are_rigid:
        return lash | {"contact": {"model": "restitution", "restitution": restitution}}
    damping = float(rng.choice([0.0, 0.02, 0.1, 0.5, 2.0])) * 2.0 * np.sqrt(stiffness * lightest)
    separation = str(rng.choice(["gap", "force"]))
    contact = {"stiffness": stiffness / radius**2, "damping": float(damping) / radius**2, "separation": separation}
    return lash | {"contact": contact}


def _shaft(rng, lightest, torque):
    stiffness = _between(rng, 5.0, 500.0)
    damping = float(rng.choice([0.0, 0.01, 0.05, 0.3])) * 2.0 * np.sqrt(stiffness * lightest)
    shaft = {"stiffness": stiffness, "damping": float(damping)}
    if rng.random() < 0.3:
        breakpoints = int(rng.choice([1, 2, 3]))
        slopes = [
            float(rng.choice([0.0, _between(rng, 2.0, 50.0), _between(rng, 50.0, 600.0)]))
            for _ in range(breakpoints + 1)
        ]
        twists = sorted(float(f"{twist:.4g}") for twist in rng.uniform(-8.0, 8.0, breakpoints))
        shaft |= {"stiffness": slopes, "breakpoints_deg": twists}
    if rng.random() < 0.3:
        shaft["friction"] = torque * _between(rng, 0.003, 0.2)
    return shaft


def _load(rng, before, count):
    profile = str(rng.choice(PROFILES))
    load = {"on": int(rng.integers(1, count + 1)), "profile": profile}
    after = float(rng.choice([0.0, -0.3, 0.2, 1.0, 2.0])) * before
    length = float(rng.choice([0.0, _between(rng, 0.003, 0.5)]))
    if profile == "table":
        times = [0.0, *np.cumsum(rng.choice([0.0, 0.05, 0.1], 4)).tolist()]
        while any(times.count(time) > 2 for time in times):
            times = [0.0, *sorted(rng.uniform(0.0, 0.4, 4).round(3).tolist())]
        return load | {"times": times, "torques": [before, *(rng.uniform(-1.0, 1.0, 4) * before).tolist()]}
    load |= {"initial_torque": before, "final_torque": after}
    if profile == "lag":
        load["time_constant"] = length
    elif profile == "sine":
        load |= {"amplitude": abs(before) * _between(rng, 0.1, 2.0), "frequency": _between(rng, 1.0, 40.0)}
    elif profile == "steps":
        load |= {"durations": [length, _between(rng, 0.01, 0.2)], "levels": [0.5, -0.3]}
    elif profile != "step":
        load["duration"] = length
    return load
