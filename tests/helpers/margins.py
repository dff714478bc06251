"""How near a run came to another label, by brute force: every candidate, from sampled phases of the reference.

Positive, what did not happen: the least distance to a flank at a turning point inside an open phase, as a share of the
whole gap; the least overlap of the flanks (restitution: the torque that holds) at a turning point inside a contact
phase later than the sticking time after the touch, as a share of its static value under the torque after the load step.
Negative, what did: how deep a crossing, or the end of sticking (by force: the opening), would go until it turned back,
were the guard not to act; and one less the age over the sticking time, of either sign, for every separation.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from helpers import reference

MOST = 0.25
ROUNDING = 2e-14  # rad, N m: of a sum of terms of up to 1 by matrices with an exponential's rounding
BEYOND = 3.0  # s, how long a guard that does not act is followed


class Candidate(NamedTuple):
    margin: float
    what: str
    time: float


def _regime_after(plant, events, k):
    """The name of the regime that event `k` opens."""
    event = events[k]
    if event.kind == "load step":
        return f"closed{event.side:+d}" if event.side else "open"
    if event.kind == "touch" and plant.restitution is not None:
        return "open"
    if event.kind in ("touch", "rejoin", "lock"):
        return f"closed{event.side:+d}"
    if event.kind == "separation" and plant.separation == "force" and plant.restitution is None:
        return f"parted{event.side:+d}"
    return "open"


def static_contact(plant):
    """The contact's guard at rest under the torque after the load step; 0 where no flank carries it."""
    try:
        side, state = replace(plant, before=plant.after).preload()
    except ValueError:
        return 0.0
    regimes = reference._regimes(plant, plant.after)
    return float(_holding(regimes, side).row @ [*state, 1.0])


def _holding(regimes, side):
    """The guard whose zero ends a contact for good: by force, that of the overlap, which the parted regime watches."""
    parted = regimes.get(f"parted{side:+d}")
    if parted is not None:
        return next(guard for guard in parted.guards if guard.kind == "opening")
    return regimes[f"closed{side:+d}"].guards[0]


def _turning_points(regime, row, z, length):
    """(time, value) of the functional's minima inside (0, length), each exact to rounding, and those of the ends."""
    count = max(int(length / regime.cell), 1)
    cell = length / count
    across = reference.expm(regime.generator * cell)
    states = [z]
    for _ in range(count):
        states.append(across @ states[-1])
    states = np.array(states)
    slopes = states @ (row @ regime.generator)
    for k in np.flatnonzero((slopes[:-1] < 0.0) & (slopes[1:] >= 0.0)):
        _, least = reference._extremes(regime.series(states[k], cell) @ row, 1.0)
        share = slopes[k] / (slopes[k] - slopes[k + 1])
        yield (k + share) * cell, least


def candidates(plant, events, end, sticking):
    """All of a run's, whatever their size; `sticking` is the sticking time  [s]."""
    regimes = reference._regimes(plant, plant.after)
    gap, static = plant.backlash, static_contact(plant)
    began, last_side, found, stuck = -np.inf, events[0].side, [], False
    by_force = any(name.startswith("parted") for name in regimes)
    for k, event in enumerate(events):
        if event.kind in ("touch", "lock"):
            began, last_side = event.time, event.side
        name = _regime_after(plant, events, k)
        regime, z = regimes[name], np.array([*event.state, 1.0])
        until = events[k + 1].time if k + 1 < len(events) else end
        scale = gap if name == "open" else static
        if not name.startswith("parted") and until > event.time and scale > 0.0:
            for guard in regime.guards if name == "open" else [_holding(regimes, int(name[-2:]))]:
                for after, value in _turning_points(regime, guard.row, z, until - event.time):
                    time = event.time + after
                    if after < 2.0 * regime.cell and abs(value) <= max(1e-12 * scale, ROUNDING):
                        continue  # the zero that a release begins with
                    if name == "open" or time > began + sticking:
                        found.append(Candidate(value / scale, f"near miss, {name}, {guard.side:+d}", time))
        if k + 1 == len(events):
            break
        following = events[k + 1]
        age = following.time - began
        crossing = following.kind == "touch" and following.side != last_side
        if following.kind == "separation":
            stuck = age > sticking
        parting = following.kind == ("opening" if by_force else "separation") and stuck
        if (crossing or parting) and scale > 0.0:
            row = next(g.row for g in regime.guards if (g.kind, g.side) == (following.kind, following.side))
            # where the guard turns negative: a restitution touch has already been reset in the event's state
            at = reference.expm(regime.generator * (until - event.time)) @ z
            first = next(_turning_points(regime, row, at, BEYOND), None)
            deepest = -np.inf if first is None else first[1]
            found.append(Candidate(deepest / scale, f"{following.kind}, {following.side:+d}", following.time))
        if following.kind == "separation" and sticking > 0.0 and np.isfinite(age):
            found.append(Candidate(1.0 - age / sticking, "age", following.time))
    return found


def margin(plant, events, end, sticking):
    """The smallest in size, at most MOST."""
    every = [Candidate(MOST, "none", 0.0), *candidates(plant, events, end, sticking)]
    return min(every, key=lambda candidate: abs(candidate.margin))
