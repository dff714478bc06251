"""How near a run came to another label, by brute force: every candidate, from sampled phases of the reference.

Positive, what did not happen: the least distance to a flank at a turning point inside an open phase, as a share of the
whole gap; the least overlap of the flanks (restitution: the torque that holds) at a turning point inside a contact
phase later than the sticking time after the touch, as a share of its static value under the torque after the load step.
Negative, what did: how deep a crossing, or the end of sticking (by force: the opening), would go until it turned back,
were the guard not to act; and one less the age over the sticking time, of either sign, for every separation.
"""

from bisect import bisect_right
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from helpers import reference

MOST = 0.25
ROUNDING = 2e-14  # rad, N m: of a sum of terms of up to 1 by matrices with an exponential's rounding
BEYOND = 3.0  # s, how long a guard that does not act is followed


class Candidate(NamedTuple):
    margin: float
    what: str
    time: float


def _regime_after(plant, event):
    """The name of the regime that an event opens."""
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
    """The contact's guard in steady motion under the last torque of the load; 0 where no flank carries it."""
    resting = replace(plant, profile=reference.step(), before=plant.final, after=plant.final)
    try:
        side, state = resting.preload()
    except ValueError:
        return 0.0
    flow = reference.Flow(resting, rolling=True)
    return float(_holding(flow.regimes(0), side).row @ flow.augmented(flow.coordinates(state), 0, 0.0))


def _holding(regimes, side):
    """The guard whose zero ends a contact for good: by force, that of the overlap, which the parted regime watches."""
    parted = regimes.get(f"parted{side:+d}")
    if parted is not None:
        return next(guard for guard in parted.guards if guard.kind == "opening")
    return regimes[f"closed{side:+d}"].guards[0]


def _spans(flow, begin, length):
    """(number, beginning, length) of the pieces of the load in an interval."""
    k = max(bisect_right([piece.begin for piece in flow.pieces], begin) - 1, 0)
    while length > 0.0:
        part = min(flow.until(k) - begin, length)
        if part > 0.0:
            yield k, begin, part
        begin, length, k = flow.until(k), length - part, k + 1


def _carried(flow, name, coordinates, begin, length):
    """The coordinates after an interval in one regime."""
    for k, time, part in _spans(flow, begin, length):
        across = expm(flow.regimes(k)[name].generator * part)
        coordinates = (across @ flow.augmented(coordinates, k, time))[: coordinates.size]
    return coordinates


def _turning_points(flow, name, guard_of, coordinates, begin, length):
    """(time after `begin`, value) of a guard's minima inside an interval in one regime, each exact to rounding.

    A minimum where the load has a kink or a jump is the lower limit there; only a rigid contact's torque has such.
    """
    falling, last = False, None
    for k, time, part in _spans(flow, begin, length):
        regime, row = flow.regimes(k)[name], guard_of(flow.regimes(k)).row
        count = max(int(part / regime.cell), 1)
        cell = part / count
        across, states = expm(regime.generator * cell), flow.augmented(coordinates, k, time)[None]
        while len(states) <= count:  # twice as many each time
            states, across = np.vstack((states, states @ across.T)), across @ across
        states = states[: count + 1]
        values, slopes = states @ row, states @ (row @ regime.generator)
        if last is not None:
            rounding = 1e-12 * (np.abs(row) @ np.abs(states[0]))
            up, down = values[0] > last + rounding, values[0] < last - rounding
            if (falling or down) and (slopes[0] >= 0.0 or up):
                yield time - begin, min(last, values[0])
        for j in np.flatnonzero((slopes[:-1] < 0.0) & (slopes[1:] >= 0.0)):
            _, least = reference._extremes(regime.series(states[j], cell) @ row, 1.0)
            share = slopes[j] / (slopes[j] - slopes[j + 1])
            yield time - begin + (j + share) * cell, least
        coordinates, falling, last = states[-1][: coordinates.size], slopes[-1] < 0.0, values[-1]


def candidates(plant, events, end, sticking):
    """All of a run's, whatever their size; `sticking` is the sticking time  [s]."""
    flow = reference.Flow(plant, rolling=events[0].side != 0)
    gap, static = plant.backlash, static_contact(plant)
    by_force = plant.separation == "force" and plant.restitution is None
    began, last_side, every, stuck = -np.inf, events[0].side, [], False
    for event, following in zip(events, [*events[1:], None], strict=True):
        if event.kind in ("touch", "lock"):
            began, last_side = event.time, event.side
        name = _regime_after(plant, event)
        length = (following.time if following else end) - event.time
        scale = gap if name == "open" else static
        if not name.startswith("parted") and length > 0.0 and scale > 0.0:
            for guard_of, side in _watched(name):
                cell = min(flow.regimes(k)[name].cell for k, _, _ in _spans(flow, event.time, length))
                for after, value in _turning_points(flow, name, guard_of, event.coordinates, event.time, length):
                    if after < 2.0 * cell and abs(value) <= max(1e-12 * scale, ROUNDING):
                        continue  # the zero that a release begins with
                    if name == "open" or event.time + after > began + sticking:
                        every.append(Candidate(value / scale, f"near miss, {name}, {side:+d}", event.time + after))
        if following is None:
            break
        age = following.time - began
        crossing = following.kind == "touch" and following.side != last_side
        if following.kind == "separation":
            stuck = age > sticking
        parting = following.kind == ("opening" if by_force else "separation") and stuck
        if (crossing or parting) and scale > 0.0:

            def crossed(regimes, name=name, following=following):
                guards = regimes[name].guards
                return next(guard for guard in guards if (guard.kind, guard.side) == (following.kind, following.side))

            # where the guard turns negative: a restitution touch has already been reset in the event's state
            at = _carried(flow, name, event.coordinates, event.time, length)
            first = next(_turning_points(flow, name, crossed, at, following.time, BEYOND), None)
            deepest = -np.inf if first is None else first[1]
            every.append(Candidate(deepest / scale, f"{following.kind}, {following.side:+d}", following.time))
        if following.kind == "separation" and sticking > 0.0 and np.isfinite(age):
            every.append(Candidate(1.0 - age / sticking, "age", following.time))
    return every


def _watched(name):
    """(the guard out of a piece's regimes, its side) of the guards whose near misses count in a regime."""
    if name == "open":
        return [(lambda regimes, k=k: regimes["open"].guards[k], side) for k, side in enumerate((1, -1))]
    side = int(name[-2:])
    return [(lambda regimes: _holding(regimes, side), side)]


def margin(plant, events, end, sticking):
    """The smallest in size, at most MOST."""
    every = [Candidate(MOST, "none", 0.0), *candidates(plant, events, end, sticking)]
    return min(every, key=lambda candidate: abs(candidate.margin))
