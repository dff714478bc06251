"""Measures of a finished run: impulse, peak torque and energy of each primary impact, and the extremes of channels.

They are found by a walk from event to event: from each state that the run has recorded, by the flow of the regime, to
the next event, and at last to the end time, even where the run ended early because nothing could follow. The walk looks
for no events, only for extremes, so that it is the same whatever method made the run. A state that lasts no time does
not count.

An impact reaches from its touch to the lash's next primary impact, or the end time, as for Q_i. In that time the lash
presses on one flank only, and

    impulse      ∫ τ dt, τ the contact torque, positive where it presses; and the impulses of touches of rigid flanks
    peak torque  the largest τ; not a number where a touch is impulsive
    energy       ∫ c q'² dt, and the elastic energy left in flanks that part while they overlap, less what is regained
                 where such flanks rejoin; of rigid flanks the kinetic energy that is lost at touches
"""

from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray, Records, StopFlag
from clunk.core.channels import CLOSING, CONTACT_TORQUE, LEVELS, OF_LASH, TERMS, Channels
from clunk.core.events import INSTANT, REJOIN, SEPARATION, TOUCH
from clunk.core.jit import compiled, inlined_part, part
from clunk.core.references import refer, reference_at, rows_of
from clunk.core.regimes import System, closed_lashes, overlap_of, speed_of
from clunk.core.runs import end_of_piece, go_on
from clunk.core.status import OK
from clunk.core.sums import combine, copy, root_of_squares
from clunk.core.switching import set_weighed
from clunk.core.tile import Batch, Cases, Output

_SMOOTH = 1e-10  # share of the terms of a series: where its last terms are smaller over a step, it is accurate there
_PLACES = 16  # parts of a step, some 0.09 of 1/rate long, at whose ends the sign of a channel's slope is computed
_MOST_STEPS = 1 << 22  # of a run, some 10 s: a run of 1 s with a mode that decays within 1e-8 s has more
_HALVINGS = 30  # of an interval with a turn: locate it to 1e-9 of the interval, and its value to the square of that
_FROM_MIDDLE, _WEIGHTS = np.polynomial.legendre.leggauss(12)  # exact up to degree 23, and to rounding for the square
_NODES = 0.5 + 0.5 * _FROM_MIDDLE  # as shares of the interval

IMPULSE, PEAK_TORQUE, ENERGY = range(3)  # of an impact; of a run the largest peak torque, roots of summed squares else
OF_IMPACTS = 3


class Room(NamedTuple):
    """Scratch of a walk over a run, and the values of impacts."""

    z: FloatArray  # (Z,)  state and inputs
    moved: FloatArray  # (2, Z)  z after a step, or terms of a series for z
    series: FloatArray  # (C, TERMS)  of each channel
    inputs: FloatArray  # (I,)  d
    ranges: FloatArray  # (C, 2)  the least and the largest value of each channel so far
    first: IntArray  # (L + 1,)  the row of each lash's first primary impact
    row: IntArray  # (L,)  the row of each lash's last primary impact so far; `first` - 1 before there is one
    systems: IntArray  # (D, …)  of each driveline, see `references.rows_of`
    of_impacts: FloatArray  # (impacts, OF_IMPACTS)  output
    steps: IntArray  # (2,)  how many steps are left for the run, and the most of a run


def measure_runs(
    batch: Batch, cases: Cases, output: Output, totals: FloatArray, of_impacts: FloatArray, stop: StopFlag
) -> None:
    """Measure the runs of some cells, until `stop` is set; the measures of failed runs are left as they are.

    The measures of a run that takes more than `_MOST_STEPS` steps are NaN.

    Parameters
    ----------
    batch
        With channels.
    cases, output
        As of `tile.run_tile`, with states; in the logs the times behind a run's events are NaN.
    totals : (cells, L, OF_IMPACTS + measures) float64
        Output, for each lash: the root of its impacts' summed squared impulses, their largest peak torque, the root of
        their summed squared energies, then the measures.
    of_impacts : (impacts, OF_IMPACTS) float64
        Output, zeros before: impulse [N m s], peak torque [N m] and energy [J] of each of the impacts, if
        `channels.of_impacts`.
    """
    system, channels = batch.system, batch.channels
    assert channels is not None
    size, count, lashes = channels.rates.shape[-1], channels.series.shape[2], system.lash_count
    room = Room(
        z=np.zeros(size),
        moved=np.zeros((2, size)),
        series=np.zeros((count, TERMS)),
        inputs=np.ones(system.input_count),
        ranges=np.zeros((count, 2)),
        first=np.zeros(lashes + 1, np.int64),
        row=np.zeros(lashes, np.int64),
        systems=rows_of(system, batch.systems),
        of_impacts=of_impacts,
        steps=np.array([0, _MOST_STEPS]),
    )
    _measure_runs(system, channels, cases, output, room, totals, stop)
    if system.impulsive:
        totals[..., PEAK_TORQUE] = of_impacts[..., PEAK_TORQUE] = np.nan


@compiled
def _measure_runs(
    system: System,
    channels: Channels,
    cases: Cases,
    output: Output,
    room: Room,
    totals: FloatArray,
    stop: StopFlag,
) -> None:
    system, channels, room = refer(system), refer(channels), refer(room)
    cases, output, first, lashes = refer(cases), refer(output), room.first, system.lash_count
    for k in range(output.cells.shape[0]):
        first[0] = first[lashes]
        for lash in range(lashes):
            first[lash + 1] = first[lash] + output.cells[k, lash].primary_impacts
        if output.cells[k, 0].status != OK or stop[0]:
            continue
        driveline = cases.drivelines[k % cases.drivelines.size]
        system = reference_at(room.systems, driveline, system)
        size, piece = system.rates.shape[1], -1
        x, load = room.z[:size], cases.loads[k % cases.loads.shape[0]]
        shortest = INSTANT if system.element_count > 1 else 0.0
        events, written = output.logs[k], 0
        while written < events.size and not np.isnan(events[written].time):
            written += 1
        copy(cases.before[k], room.inputs)
        room.steps[0] = room.steps[1]
        room.ranges[:, 0], room.ranges[:, 1] = np.inf, -np.inf
        for lash in range(lashes):
            room.row[lash] = first[lash] - 1
        for e in range(written):
            event = events[e]
            copy(output.states[k, e, : 2 * system.inertias], x)
            if channels.of_impacts and event.lash >= 0:
                _add_event(system, channels, driveline, events[:written], output.states[k], e, room)
            time, end = event.time, system.end_time[0]
            if e + 1 < written:
                end = events[e + 1].time
            while end - time > shortest:
                piece = go_on(system, load, piece, time, x, room.inputs)
                until = min(end, end_of_piece(system, load, piece))
                set_weighed(system, event.regime, room.inputs, room.z[size:])
                _follow(system, channels, driveline, event.regime, until - time, room)
                time = until
        if room.steps[0] == 0:
            room.ranges[:], room.of_impacts[first[0] : first[lashes]] = np.nan, np.nan
        for lash in range(lashes):
            begin, last = first[lash], first[lash + 1]
            for j in range(OF_IMPACTS):
                totals[k, lash, j] = root_of_squares(room.of_impacts[begin:last, j])
            largest = 0.0
            for peak in room.of_impacts[begin:last, PEAK_TORQUE]:
                largest = np.maximum(largest, peak)
            totals[k, lash, PEAK_TORQUE] = largest
            for m in range(channels.swings.size):
                low, high = room.ranges[OF_LASH * lashes + m, 0], room.ranges[OF_LASH * lashes + m, 1]
                totals[k, lash, OF_IMPACTS + m] = high - low if channels.swings[m] else max(-low, high)


@part
def _add_event(
    system: System,
    channels: Channels,
    driveline: int,
    events: Records,
    states: FloatArray,
    e: int,
    room: Room,
) -> None:
    """Begin the values of a new impact where event e is primary, and add the impulse and energy of the event itself.

    An impulse also passes through other lashes that are closed. Successive touches with one state are one impact of
    several lashes, added at the last of these touches.
    """
    event, row, first, x = events[e], room.row, room.first, room.z
    lash = event.lash
    torque = OF_LASH * lash + CONTACT_TORQUE
    if event.primary:
        row[lash] += 1
        room.ranges[torque] = 0.0
    if system.impulsive:
        if event.kind != TOUCH or (e + 1 < events.size and _are_one_impact(events, states, e)):
            return
        begin, together = e, closed_lashes(system, event.regime, -1) | 1 << lash
        while _are_one_impact(events, states, begin - 1):
            begin -= 1
            together |= 1 << events[begin].lash
        for other in range(row.size):
            if not together >> other & 1 or row[other] < first[other]:
                continue
            impulse, speeds, side = 0.0, 0.0, system.contacts[event.regime, other].side
            for k in range(begin, e + 1):
                struck, before = events[k].lash, events[k].speed
                after = speed_of(system, struck, x[: system.lashes.shape[1]])
                impulse += system.passed[together & ~(1 << struck), struck, other] * (before - after)
                if struck == other:
                    speeds, side = speeds + before + after, events[k].side
            room.of_impacts[row[other], IMPULSE] += side * impulse  # through a lash that is locked it may pull
            room.of_impacts[row[other], ENERGY] += 0.5 * impulse * speeds
        return
    if event.kind in (SEPARATION, REJOIN) and row[lash] >= first[lash]:
        overlap = overlap_of(system, lash, event.side, x, room.inputs)
        stored = 0.5 * channels.contact_stiffness[driveline, lash] * overlap**2
        room.of_impacts[row[lash], ENERGY] += stored if event.kind == SEPARATION else -stored


@inlined_part
def _are_one_impact(events: Records, states: FloatArray, e: int) -> bool:
    """Whether event e and the next one are touches with one state."""
    same = events[e].kind == TOUCH and events[e + 1].kind == TOUCH
    for j in range(states.shape[1]):
        same = same and states[e, j] == states[e + 1, j]
    return same


@part
def _follow(system: System, channels: Channels, driveline: int, regime: int, span: float, room: Room) -> None:
    """Follow the flow of a regime from `room.z` for `span` s, in which neither regime nor piece of the load ends."""
    z, lashes = room.z, system.lash_count
    flow, elapsed = system.regimes[regime].flow, 0.0
    length, rows = channels.lengths[driveline, flow], channels.series[driveline, flow]
    while elapsed < span and room.steps[0] > 0:
        room.steps[0] -= 1
        level = LEVELS - 1
        for c in range(len(room.ranges)):
            if c // OF_LASH >= lashes or _bears(system, regime, c // OF_LASH, room):
                combine(rows[c], z, room.series[c])
                while level > 0 and not _is_smooth(room.series[c], 2.0**level):
                    level -= 1
        while level > 0 and length * 2.0**level > span - elapsed:
            level -= 1
        share = min((span - elapsed) / length, 2.0**level)
        for lash in range(lashes):
            contact, torque = system.contacts[regime, lash], OF_LASH * lash + CONTACT_TORQUE
            if not _bears(system, regime, lash, room):
                continue
            values = room.of_impacts[room.row[lash]]
            damped = length * _integral(room.series[OF_LASH * lash + CLOSING], share, 2)
            values[ENERGY] += channels.contact_damping[driveline, lash] * damped
            values[IMPULSE] += contact.side * length * _integral(room.series[torque], share, 1)
            _widen(room.series[torque], share, room.ranges[torque])
            values[PEAK_TORQUE] = room.ranges[torque, 1] if contact.side > 0 else -room.ranges[torque, 0]
        for c in range(OF_LASH * lashes, len(room.ranges)):
            _widen(room.series[c], share, room.ranges[c])
        if share < 1.0:
            _move_within(channels.rates[driveline, flow], share, room)
            break
        combine(channels.steps[driveline, flow, level], z, room.moved[0])
        copy(room.moved[0], z)
        elapsed += share * length


@part
def _bears(system: System, regime: int, lash: int, room: Room) -> bool:
    """Whether a lash is closed and has had a primary impact, so that its contact adds to that impact's values."""
    return system.contacts[regime, lash].closed != 0 and room.row[lash] >= room.first[lash]


@part
def _is_smooth(series: FloatArray, share: float) -> bool:
    """Whether a series is accurate over `share` times the shortest step, by its last term of either parity.

    One term alone would not do: every other term of an undamped motion from rest is zero.
    """
    reach, before, term, power = 0.0, 0.0, 0.0, 1.0
    for k in range(TERMS):
        before, term = term, abs(series[k]) * power
        reach, power = reach + term, power * share
    return max(before, term) <= _SMOOTH * reach


@part
def _move_within(rates: FloatArray, share: float, room: Room) -> None:
    """Move z by a share of the shortest step, by the Taylor series of the flow."""
    term, following = room.moved[0], room.moved[1]
    copy(room.z, term)
    for k in range(1, TERMS):
        combine(rates, term, following)
        for j in range(term.size):
            term[j] = following[j] * share / k
            room.z[j] += term[j]


# --- Polynomials over an interval that begins at zero, by their coefficients, lowest order first ----------------------


@part
def _value_at(series: FloatArray, at: float, order: int) -> float:
    """Value of a polynomial (`order` is 0), or its slope (1)."""
    value = 0.0
    for k in range(series.size - 1, order - 1, -1):
        value = value * at + (k if order else 1) * series[k]
    return value


@part
def _integral(series: FloatArray, length: float, power: int) -> float:
    """Integral from 0 to `length` of a polynomial (`power` is 1) or of its square (2)."""
    total = 0.0
    for n in range(_NODES.size):
        total += _WEIGHTS[n] * _value_at(series, length * _NODES[n], 0) ** power
    return 0.5 * length * total


@part
def _widen(series: FloatArray, length: float, ranges: FloatArray) -> None:
    """Widen a range, (2,), by all values of a polynomial from 0 to `length`.

    A turn is located where the slope has different signs at the ends of one of _PLACES equal parts. Two turns within
    one part are missed; the values there are nearly those at its ends.
    """
    reach, power = 0.0, 1.0
    for k in range(1, series.size):
        power *= length
        reach += abs(series[k]) * power
    low, high = ranges[0], ranges[1]
    if low <= series[0] - reach and series[0] + reach <= high:
        return
    end, slope = _value_at(series, length, 0), series[1]
    low, high = min(low, series[0], end), max(high, series[0], end)
    for n in range(_PLACES):
        first, last = n * length / _PLACES, (n + 1) * length / _PLACES
        following = _value_at(series, last, 1)
        if (slope > 0.0) != (following > 0.0):
            for _ in range(_HALVINGS):
                at = 0.5 * (first + last)
                if (_value_at(series, at, 1) > 0.0) == (slope > 0.0):
                    first = at
                else:
                    last = at
            turn = _value_at(series, first, 0)
            low, high = min(low, turn), max(high, turn)
        slope = following
    ranges[0], ranges[1] = low, high
