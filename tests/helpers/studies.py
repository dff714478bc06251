"""Random studies as a config may describe them: rigs on a bench, cars and trucks, the same for the same seed.

A driveline is a chain from the loaded end to the far one, with leaves on it: 3 to 8 inertias, one to three lashes among
the joints of the chain. Its numbers are drawn as the first inertia sees them, and put behind gears then: inertia k
turns by `turns[k]` times the first one's angle, so that its inertia is over that squared, and a joint of a and b has
the ratio turns[a]/turns[b] and its stiffness and damping over turns[a]² (as in `test_ratio`).
"""

from typing import NamedTuple

import numpy as np
import tomli_w

from clunk.study.config import study_from_text

STEPS_A_PERIOD = 60  # of rk4, of the fastest oscillation that there can be: late by (2π/60)⁴/120 = 1e-6 of a period


class Kind(NamedTuple):
    """Ranges that a sort of driveline is drawn from, as the loaded inertia sees them."""

    first: tuple  # kg m²
    middle: tuple  # kg m²
    last: tuple  # kg m²
    stiffness: tuple  # N m/rad
    before: tuple  # N m
    after: tuple  # N m
    gap_deg: tuple  # degrees
    ratios: tuple
    end_time: float  # s


KINDS = {
    "rig": Kind((0.01, 0.04), (0.002, 0.01), (0.002, 0.02), (10.0, 100.0), (-8.0, -2.0), (-1.5, 1.5), (0.5, 12.0),
                (1.0, 1.0, 1.0, -1.0, 2.5, 0.4, -0.7), 1.0),
    "car": Kind((0.15, 0.35), (0.004, 0.03), (0.8, 3.0), (200.0, 2e3), (20.0, 160.0), (-40.0, 10.0), (0.3, 8.0),
                (1.0, 1.0, 1.95, 3.9, -3.4, 0.9), 1.0),
    "truck": Kind((1.0, 2.5), (0.03, 0.3), (4.0, 40.0), (1e3, 2e4), (100.0, 1200.0), (-200.0, 50.0), (0.2, 4.0),
                  (1.0, 1.0, 6.5, 3.7, -4.5, 0.78), 1.5),
}  # fmt: skip
PROFILES = ("step", "ramp", "smooth", "lag", "pulse", "sine", "table", "steps")


def study_text(seed: int) -> str:
    """The config of a random study, as TOML: two axes of 4 and 3 values."""
    rng = np.random.default_rng([seed, 30])
    name = str(rng.choice(list(KINDS)))
    kind = KINDS[name]
    driveline, lashes, fastest = _driveline(rng, kind, held=name == "rig" and rng.random() < 0.7)
    before = _drawn(rng, kind.before)
    load = {"on": 1} | _load(rng, kind, before)
    for shaft in driveline["shafts"]:
        rubs, lever = shaft.pop("rubs"), shaft.pop("lever")
        if rubs:
            shaft["friction"] = _rounded(abs(before * lever) * rng.uniform(0.01, 0.1))
    config = {
        "title": f"Random study {seed}: a {name}",
        "driveline": driveline,
        "lash": lashes[0] if len(lashes) == 1 else lashes,
        "load": load,
        "solver": {
            "method": "exact",
            "step": _rounded(min(2e-4, 2.0 * np.pi / fastest / STEPS_A_PERIOD)),
            "end_time": kind.end_time,
        },
    }
    config["sweep"] = {"axes": _axes(rng, config)}
    return tomli_w.dumps(config)


def random_study(seed, *overrides):
    """The study of `study_text`, with keys set as by ``--set``."""
    return study_from_text(study_text(seed), f"seed {seed}", overrides)


def _driveline(rng, kind, held):
    """Tables of a driveline and of its lashes, and the fastest rate that there can be in it  [rad/s]."""
    n = int(rng.integers(3, 9))
    chain = int(rng.integers(3, n + 1))
    count = int(rng.choice([1, 1, 1, 2, 2, 3]))
    loose = {int(k) for k in rng.choice(np.arange(1, chain), min(count, chain - 1), replace=False)}
    first, middle, last = (_drawn(rng, span) for span in kind[:3])
    inertias = np.array([first, *(middle * 2.0 ** rng.uniform(-1.0, 1.0, n - 1))])
    inertias[chain - 1] = last
    joints = [(k - 1, k) for k in range(1, chain)] + [(int(rng.integers(0, chain)), k) for k in range(chain, n)]
    turns = np.ones(n)
    for a, b in joints:
        turns[b] = turns[a] / float(rng.choice(kind.ratios))
    contact = {"model": "restitution", "restitution": _rounded(rng.uniform(0.0, 0.8))} if rng.random() < 0.3 else {}
    staged, rubbing = rng.random() < 0.4, rng.random() < 0.35
    shafts, lashes, matrices = [], [], np.zeros((2, n, n))  # stiffness and damping, lashes closed
    for a, b in joints:
        stiffness = _drawn(rng, kind.stiffness)
        lever, smaller = turns[a], min(inertias[a], inertias[b])
        ends = {"between": [a + 1, b + 1]}
        if turns[a] != turns[b]:
            ends["ratio"] = float(turns[a] / turns[b])
        if b in loose and b < chain:
            stiffness *= rng.uniform(10.0, 50.0)
            damping = 2.0 * float(rng.choice([0.0, 0.03, 0.1, 0.4])) * np.sqrt(stiffness * smaller)
            lashes.append(ends | _lash(rng, kind, contact, (stiffness, damping), lever))
            if contact:
                continue
        else:
            damping = 2.0 * rng.uniform(0.005, 0.08) * np.sqrt(stiffness * smaller)
            element = {"stiffness": _rounded(stiffness / lever**2), "damping": _rounded(damping / lever**2)}
            first_element = not any("breakpoints_deg" in shaft or shaft["rubs"] for shaft in shafts)
            if staged and (first_element or rng.random() < 0.2):
                element |= _stages(rng, stiffness / lever**2, 3.0 * abs(lever))
            rubs = rubbing and bool(first_element or "breakpoints_deg" in element or rng.random() < 0.2)
            shafts.append(ends | element | {"rubs": rubs, "lever": 1.0 / lever})
        matrices += np.multiply.outer([stiffness, damping], np.outer(*2 * [np.eye(n)[a] - np.eye(n)[b]]))
    far, ground = chain - 1, turns[chain - 1]
    if held:
        stiffness = _drawn(rng, kind.stiffness)
        damping = 2.0 * rng.uniform(0.01, 0.05) * np.sqrt(stiffness * inertias[far])
        matrices[:, far, far] += stiffness, damping
        held_by = {"stiffness": _rounded(stiffness / ground**2), "damping": _rounded(damping / ground**2)}
        rubs = rubbing and bool(rng.random() < 0.5)
        shafts.append({"between": [far + 1, "ground"]} | held_by | {"rubs": rubs, "lever": 1.0 / ground})
    elif rng.random() < 0.5:  # drag, with which the driveline rolls at a hundred times its twists' rates
        drag = abs(kind.before[0]) / 10.0 ** rng.uniform(1.0, 3.0) / ground**2
        shafts.append({"between": [far + 1, "ground"], "damping": _rounded(drag), "rubs": False, "lever": 1.0})
    if len(lashes) > 1:
        lashes = [{"name": f"play {chr(97 + k)}"} | lash for k, lash in enumerate(lashes)]
    tables = {"inertias": [_rounded(size) for size in inertias / turns**2], "shafts": shafts}
    rates = np.block([[np.zeros((n, n)), np.eye(n)], [*(-matrix / inertias[:, None] for matrix in matrices)]])
    return tables, lashes, max(1.0, np.abs(np.linalg.eigvals(rates)).max())


def _lash(rng, kind, contact, flank, lever):
    """A lash's table but for its ends; stiffness and damping of its flanks as the first inertia sees them."""
    radius = _rounded(rng.uniform(0.02, 0.1))
    table = {"backlash_deg": _rounded(_drawn(rng, kind.gap_deg) * abs(lever)), "radius": radius}
    if contact:
        return table | {"contact": contact}
    size = (lever * radius) ** 2
    flanks = {"stiffness": _rounded(flank[0] / size), "damping": _rounded(flank[1] / size)}
    return table | {"contact": flanks | {"separation": str(rng.choice(["gap", "force"]))}}


def _stages(rng, stiffness, widest):
    """Stages and breakpoints of a shaft: two or three, the soft ones where it is least twisted."""
    soft = stiffness * rng.uniform(0.1, 0.6)
    breakpoint_deg = _rounded(rng.uniform(0.2, 1.0) * widest)
    if rng.random() < 0.5:
        return {"stiffness": [_rounded(soft), _rounded(stiffness)], "breakpoints_deg": [breakpoint_deg]}
    below = -_rounded(breakpoint_deg * rng.uniform(0.3, 1.0))
    stages = [_rounded(each) for each in (stiffness, soft, stiffness)]
    return {"stiffness": stages, "breakpoints_deg": [below, breakpoint_deg]}


def _load(rng, kind, before):
    """The load's table: every profile with the same chance."""
    profile = str(rng.choice(PROFILES))
    length, after = _rounded(10.0 ** rng.uniform(-2.0, -0.3)), _drawn(rng, kind.after)
    if profile == "table":
        times = [0.0, *np.cumsum(rng.uniform(0.01, 0.15, 3)).round(4).tolist()]
        if rng.random() < 0.4:
            times[1] = 0.0  # a jump at the load step
        torques = [before, *(_rounded(before * share) for share in rng.uniform(-0.6, 0.6, 2)), after]
        return {"profile": profile, "times": times, "torques": torques}
    load = {"profile": profile, "initial_torque": before, "final_torque": after}
    if profile == "lag":
        load["time_constant"] = _rounded(length / 3.0)
    elif profile == "sine":
        load |= {"amplitude": _rounded(abs(before) * rng.uniform(0.1, 1.0)), "frequency": _rounded(0.3 / length)}
    elif profile == "steps":
        load |= {"durations": [length, _rounded(length / 2.0)], "levels": [_rounded(rng.uniform(0.2, 1.5)), 0.3]}
    elif profile != "step":
        load["duration"] = length
    return load


def _axes(rng, config):
    """Two axes: one of the load or the gap, as maps have them, and one of any number at all."""
    lashes = config["lash"] if isinstance(config["lash"], list) else [config["lash"]]
    of_lash = [f"lash[{k + 1}]" for k in range(len(lashes))] if len(lashes) > 1 else ["lash"]
    load = {f"load.{key}": config["load"].get(key) for key in ("initial_torque", "duration", "time_constant")}
    load |= {f"load.{key}": config["load"].get(key) for key in ("frequency", "amplitude")}
    usual = {key: value for key, value in load.items() if value}
    usual |= {f"{key}.backlash_deg": lash["backlash_deg"] for key, lash in zip(of_lash, lashes, strict=True)}
    others = {f"driveline.inertias[{k + 1}]": each for k, each in enumerate(config["driveline"]["inertias"])}
    for key, lash in zip(of_lash, lashes, strict=True):
        others |= {f"{key}.contact.{name}": value for name, value in lash["contact"].items() if value}
        others |= {f"{key}.ratio": lash["ratio"]} if "ratio" in lash else {}
    others = {key: value for key, value in others.items() if not isinstance(value, str)}
    for k, shaft in enumerate(config["driveline"]["shafts"], 1):
        for name in ("stiffness", "damping", "friction"):
            value = shaft.get(name)
            if isinstance(value, list):
                others[f"driveline.shafts[{k}].{name}[2]"] = value[1]
            elif value:
                others[f"driveline.shafts[{k}].{name}"] = value
    first = str(rng.choice(list(usual)))
    second = str(rng.choice([key for key in (usual | others) if key != first]))
    axes = []
    for key, count, span in ((first, 4, 0.8), (second, 3, 0.3)):
        value = (usual | others)[key]
        ends = sorted((_rounded(value * (1.0 - span)), _rounded(value * (1.0 + span))))
        ends = [min(end, 1.0) for end in ends] if key.endswith("restitution") else ends
        axes.append({"parameter": key, "start": ends[0], "stop": ends[1], "count": count})
    return axes


def _drawn(rng, span):
    """A number between two, with equal chances in each octave where both are positive."""
    low, high = span
    return _rounded(low * (high / low) ** rng.random() if low * high > 0.0 else rng.uniform(low, high))


def _rounded(value):
    return float(f"{value:.4g}")
