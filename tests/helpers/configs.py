"""Plants of the independent reference as configs."""

import numpy as np
import tomli_w

from clunk.study.config import study_from_text
from helpers.loads import PARAMETERS
from helpers.plant import Shaft


def study_of(plant, method="exact", step=1e-4, end_time=2.0):
    """The study of a plant."""
    return study_from_text(config_of(plant, step, end_time, method))


def config_of(plant, step=1e-4, end_time=2.0, method="rk4"):
    """The config, as TOML, that spells out a plant; contacts at a radius of 0.1 m."""
    ratios = plant.ratios or (1.0,) * len(plant.shafts)
    shafts = [_shaft(Shaft(*ends), ratio) for ends, ratio in zip(plant.shafts, ratios, strict=True)]
    lashes = [_lash(lash) for lash in plant.lashes]
    load = {"on": plant.loaded, "profile": plant.profile.name}
    load |= {key: getattr(plant.profile, key) for key in PARAMETERS.get(plant.profile.name, ())}
    load |= {} if plant.profile.name == "table" else {"initial_torque": plant.before, "final_torque": plant.after}
    return tomli_w.dumps(
        {
            "driveline": {"inertias": plant.inertias, "shafts": shafts},
            "lash": lashes[0] if len(lashes) == 1 else lashes,
            "load": load,
            "solver": {"method": method, "step": step, "end_time": end_time, "max_events": 4096},
            "impacts": {"acceleration_of": plant.acceleration_of},
        }
    )


def _shaft(shaft, ratio):
    table = {"between": (shaft.one, shaft.other), "stiffness": shaft.stiffness, "damping": shaft.damping}
    table |= {"breakpoints_deg": np.rad2deg(shaft.breakpoints).tolist()} if shaft.breakpoints else {}
    return table | ({"friction": shaft.friction} if shaft.friction else {}) | _ratio(ratio)


def _lash(lash):
    contact = {"stiffness": lash.stiffness / 0.01, "damping": lash.damping / 0.01, "separation": lash.separation}
    contact |= {"model": "restitution", "restitution": lash.restitution} if lash.rigid else {}
    backlash = {"between": lash.between, "backlash_deg": float(np.rad2deg(lash.backlash)), "radius": 0.1}
    return backlash | {"contact": contact} | _ratio(lash.ratio)


def _ratio(ratio):
    return {} if ratio == 1.0 else {"ratio": ratio}
