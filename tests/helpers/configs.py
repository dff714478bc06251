"""Plants of the independent reference as configs."""

import numpy as np

from clunk.study.config import study_from_text
from helpers.loads import PARAMETERS
from helpers.plant import Shaft


def study_of(plant, method="exact", step=1e-4, end_time=2.0):
    """The study of a plant."""
    return study_from_text(config_of(plant, step, end_time, method))


def config_of(plant, step=1e-4, end_time=2.0, method="rk4"):
    """The config, as TOML, that spells out a plant; contacts at a radius of 0.1 m."""
    ratios = plant.ratios or (1.0,) * len(plant.shafts)
    shafts = "".join(_shaft(Shaft(*ends), ratio) for ends, ratio in zip(plant.shafts, ratios, strict=True))
    lashes = "".join(_lash(lash, "[lash]" if len(plant.lashes) == 1 else "[[lash]]") for lash in plant.lashes)
    torques = f"initial_torque = {plant.before!r}\nfinal_torque = {plant.after!r}\n"
    values = ((key, getattr(plant.profile, key)) for key in PARAMETERS.get(plant.profile.name, ()))
    parameters = "".join(
        f"{key} = {list(value) if isinstance(value, tuple) else repr(value)}\n" for key, value in values
    )
    return f"""
[driveline]
inertias = {list(plant.inertias)}
{shafts or "shafts = []"}
{lashes}[load]
on = {plant.loaded}
profile = "{plant.profile.name}"
{parameters}{"" if plant.profile.name == "table" else torques}[solver]
method = "{method}"
step = {step!r}
end_time = {end_time!r}
max_events = 4096
[impacts]
acceleration_of = {plant.acceleration_of}
"""


def _shaft(shaft, ratio):
    staged = f"breakpoints_deg = {np.rad2deg(shaft.breakpoints).tolist()}\n" if shaft.breakpoints else ""
    rubbing = f"friction = {shaft.friction!r}\n" if shaft.friction else ""
    return f"""[[driveline.shafts]]
between = {_ends(shaft.one, shaft.other)}
stiffness = {list(shaft.stiffness) if shaft.breakpoints else repr(shaft.stiffness)}
damping = {shaft.damping!r}
{staged}{rubbing}{_ratio(ratio)}"""


def _lash(lash, heading):
    model = f'model = "restitution"\nrestitution = {lash.restitution!r}\n' if lash.rigid else ""
    return f"""{heading}
between = {_ends(*lash.between)}
backlash_deg = {float(np.rad2deg(lash.backlash))!r}
{_ratio(lash.ratio)}radius = 0.1
[lash.contact]
stiffness = {lash.stiffness / 0.01!r}
damping = {lash.damping / 0.01!r}
separation = "{lash.separation}"
{model}"""


def _ratio(ratio):
    return "" if ratio == 1.0 else f"ratio = {ratio!r}\n"


def _ends(one, other):
    return "[" + ", ".join(f'"{end}"' if end == "ground" else str(end) for end in (one, other)) + "]"
