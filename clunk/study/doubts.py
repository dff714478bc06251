"""Numbers of a sound config that cannot be meant, mostly because they are in another unit."""

import math
from collections.abc import Collection, Iterator

import numpy as np

from clunk.study.document import dotted
from clunk.study.loads import PROFILES, Load, uses
from clunk.study.models import Config
from clunk.study.problems import listing, shorten

LARGEST_RADIUS = 10.0  # m; the gears of mills and radio telescopes have some meters
DEEPEST = 6.28  # rad, a whole turn, of flanks pressed together by the load: of gears it is some 1e-3
LEAST_CHANGE = 0.05  # of the change of a load, that a run should see


def doubts(config: Config, given: Collection[str]) -> Iterator[str]:
    """Sentences on what is odd in a config; given : keys of its load that a user has given, by name."""
    swept = {axis.parameter for axis in (config.sweep.axes if config.sweep is not None else ())}
    for place, lash in zip(config.lash_places, config.lashes, strict=True):
        radius = dotted((*place, "radius"))
        if lash.radius > LARGEST_RADIUS:
            yield f"{radius} = {lash.radius:g} m; it is in meters, and {lash.radius / 1e3:g} if that was in mm"
        stiffness, torque = lash.contact.stiffness, _largest_torque(config.load)
        key = dotted((*place, "contact", "stiffness"))
        if lash.contact.model == "restitution" or stiffness is None or {key, radius} & swept:
            continue
        if (overlap := torque / (lash.radius**2 * stiffness)) > DEEPEST:
            yield (
                f"{key} = {stiffness:g} N/m at a radius of {lash.radius:g} m: {torque:g} N m press the flanks "
                f"{overlap:,.3g} rad into each other; gears have 1e7 to 1e9 N/m"
            )
    load = config.load
    for key in sorted(given):
        users = [shorten(name) for name in PROFILES if uses(name, key)]
        is_default = getattr(load, key) == Load.model_fields[key].default  # as of a resolved config
        if users and not uses(load.profile, key) and not is_default:
            others = listing(users, "or")
            yield f"load.{key} is given, but a load of profile {shorten(load.profile)} has none; {others} would use it"
    times = {"load.duration", "load.time_constant", "load.times", "solver.end_time"}
    if not times & {key.partition("[")[0] for key in swept}:
        share = _share_of_change(load, config.solver.end_time)
        if share < LEAST_CHANGE:
            yield (
                f"only {100.0 * share:.2g} % of the change of the load come before solver.end_time = "
                f"{config.solver.end_time:g} s; times are in seconds"
            )


def _largest_torque(load: Load) -> float:
    """The larger of the torques before and after, or the largest of a table  [N m]."""
    if load.profile == "table":
        return abs(load.scale) * max(map(abs, load.torques or (0.0,)))
    if load.ratio is not None and load.static_torque is not None:
        return abs(load.static_torque) * max(1.0, abs(1.0 + load.ratio))
    return max(abs(load.initial_torque or 0.0), abs(load.final_torque or 0.0))


def _share_of_change(load: Load, end_time: float) -> float:
    """The share of a load's change from its first torque that comes before the end; 1 where that cannot be said."""
    if load.profile in ("ramp", "smooth") and load.duration:
        return min(1.0, end_time / load.duration)
    if load.profile == "lag" and load.time_constant:
        return -math.expm1(-end_time / load.time_constant)
    if load.profile != "table" or not load.torques or not load.times:
        return 1.0
    changes = [abs(torque - load.torques[0]) for torque in load.torques]
    within = [change for time, change in zip(load.times, changes, strict=True) if time <= end_time]
    within.append(float(np.interp(end_time, load.times, changes)))
    return max(within) / max(changes) if any(changes) else 1.0
