"""How near a run came to another label, by brute force: every candidate, from sampled phases of the reference.

Positive, what did not happen: the least distance to a flank at a turning point inside an open phase, as a share of the
whole gap; the least overlap of the flanks (restitution: the torque that holds) at a turning point inside a contact
phase later than the sticking time after the touch, as a share of its static value under the torque after the load step;
of rigid flanks that rebound, and touch again on the same side, the larger of their speed, as a share of the fastest
touch's, and of that torque.

Negative, what did: how deep a primary touch, or the end of sticking (by force: the opening), would go until it turned
back, were the guard not to act; of a lock, before a touch on the same side, the torque that holds; and one less the age
over the sticking time, of either sign, for every separation.

And the torque before the load step over the last one, to both of which what a flank carries is in proportion.
"""

from bisect import bisect_right
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from helpers import reference
from helpers.elements import OPEN, Mode

MOST = 0.25
ROUNDING = 2e-14  # rad, N m: of a sum of terms of up to 1 by matrices with an exponential's rounding
BEYOND = 3.0  # s, how long a guard that does not act is followed


class Candidate(NamedTuple):
    margin: float
    what: str
    time: float


def static_contact(plant):
    """The contact's guard in steady motion under the last torque of the load, or where that presses no flank the first.

    0 where neither does.
    """
    for torque in (plant.final, plant.before):
        resting = replace(plant, profile=reference.step(), before=torque, after=torque)
        try:
            side, state = resting.preload()
        except ValueError:
            continue
        flow = reference.Flow(resting)
        return float(_holding(flow, 0, Mode("closed", side)).row @ flow.augmented(flow.coordinates(state), 0, 0.0))
    return 0.0


def _holding(flow, k, closed):
    """The guard whose zero ends a contact for good: by force, that of the overlap, which the parted mode watches."""
    lash = flow.plant.lashes[0]
    by_force = lash.separation == "force" and not lash.rigid
    guards = flow.regime(k, (Mode("parted", closed.side) if by_force else closed,)).guards
    return next(guard for guard in guards if guard.kind in ("opening", "separation"))


def _spans(flow, begin, length):
    """(number, beginning, length) of the pieces of the load in an interval."""
    k = max(bisect_right([piece.begin for piece in flow.pieces], begin) - 1, 0)
    while length > 0.0:
        part = min(flow.until(k) - begin, length)
        if part > 0.0:
            yield k, begin, part
        begin, length, k = flow.until(k), length - part, k + 1


def _carried(flow, mode, coordinates, begin, length):
    """The coordinates after an interval in one regime."""
    for k, time, part in _spans(flow, begin, length):
        across = expm(flow.regime(k, (mode,)).generator * part)
        coordinates = (across @ flow.augmented(coordinates, k, time))[: coordinates.size]
    return coordinates


def _turning_points(flow, mode, guard_of, coordinates, begin, length):
    """(time after `begin`, value) of a guard's minima inside an interval in one regime, each exact to rounding.

    A minimum where the load has a kink or a jump is the lower limit there; only a rigid contact's torque has such.
    """
    falling, last = False, None
    for k, time, part in _spans(flow, begin, length):
        regime, row = flow.regime(k, (mode,)), guard_of(k).row
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
            _, least = reference._extremes((regime.series(states[j], cell) @ row).tolist(), 1.0)
            share = slopes[j] / (slopes[j] - slopes[j + 1])
            yield time - begin + (j + share) * cell, least
        coordinates, falling, last = states[-1][: coordinates.size], slopes[-1] < 0.0, values[-1]


def candidates(plant, events, end, sticking):
    """All of a run's, whatever their size; `sticking` is the sticking time  [s]."""
    flow = reference.Flow(plant)
    gap, static = plant.backlash, static_contact(plant)
    rigid = plant.restitution is not None
    by_force = plant.separation == "force" and not rigid
    fastest, last_touched, lock = 0.0, events[0].side, MOST
    began, last_side, stuck = -np.inf, events[0].side, False
    every = [Candidate(plant.before / plant.final, "at first", 0.0)] if plant.final else []
    for event, following in zip(events, [*events[1:], None], strict=True):
        if event.kind in ("touch", "lock"):
            began, last_side = event.time, event.side
        (mode,) = event.modes
        if event.kind == "touch" and rigid and static > 0.0:
            if event.side == last_touched:
                every.append(Candidate(lock, "lock before", event.time))
            fastest, last_touched = max(fastest, abs(event.speed)), event.side
            k = max(bisect_right([piece.begin for piece in flow.pieces], event.time) - 1, 0)
            row = _holding(flow, k, Mode("closed", event.side)).row
            torque = abs(float(row @ flow.augmented(event.coordinates, k, event.time))) / static
            slow = max(plant.restitution * abs(event.speed) / fastest, torque)
            lock = -torque if following is not None and following.kind == "lock" else slow
        length = (following.time if following else end) - event.time
        scale = gap if mode == OPEN else static
        if mode.name != "parted" and length > 0.0 and scale > 0.0:
            for guard_of, side in _watched(flow, mode):
                cell = min(flow.regime(k, (mode,)).cell for k, _, _ in _spans(flow, event.time, length))
                for after, value in _turning_points(flow, mode, guard_of, event.coordinates, event.time, length):
                    if after < 2.0 * cell and abs(value) <= max(1e-12 * scale, ROUNDING):
                        continue  # the zero that a release begins with
                    if mode == OPEN or event.time + after > began + sticking:
                        every.append(Candidate(value / scale, f"near miss, {mode.name}, {side:+d}", event.time + after))
        if following is None:
            break
        age = following.time - began
        primary = following.kind == "touch" and (following.side != last_side or stuck)
        if following.kind in ("touch", "separation"):
            stuck = following.kind == "separation" and age > sticking
        parting = following.kind == ("opening" if by_force else "separation") and stuck
        if (primary or parting) and scale > 0.0:

            def crossed(k, mode=mode, following=following):
                guards = flow.regime(k, (mode,)).guards
                return next(guard for guard in guards if (guard.kind, guard.side) == (following.kind, following.side))

            # where the guard turns negative: a restitution touch has already been reset in the event's state
            at = _carried(flow, mode, event.coordinates, event.time, length)
            first = next(_turning_points(flow, mode, crossed, at, following.time, BEYOND), None)
            deepest = -np.inf if first is None else first[1]
            every.append(Candidate(deepest / scale, f"{following.kind}, {following.side:+d}", following.time))
        if following.kind == "separation" and sticking > 0.0 and np.isfinite(age):
            every.append(Candidate(1.0 - age / sticking, "age", following.time))
    return every


def _watched(flow, mode):
    """(the guard in a piece of the load, its side) of the guards whose near misses count in a mode."""
    if mode == OPEN:
        return [(lambda k, j=j: flow.regime(k, (OPEN,)).guards[j], side) for j, side in enumerate((1, -1))]
    return [(lambda k: _holding(flow, k, mode), mode.side)]


def margin(plant, events, end, sticking):
    """The smallest in size, at most MOST."""
    every = [Candidate(MOST, "none", 0.0), *candidates(plant, events, end, sticking)]
    return min(every, key=lambda candidate: abs(candidate.margin))
