"""Measures of a finished run: what its contact took and bore at each primary impact, and the extremes of channels.

A walk from event to event over the states that the run has recorded, by the flow of each regime, and on to the end
time where it was proved that nothing follows. Nothing is searched for but extremes, so the walk is the same whatever
method made the run. A state that lasts no time does not count.

An impact reaches from its touch to the lash's next primary impact, or the end time, as for Q_i. In that time the lash
presses on one flank only, and

    impulse      ∫ τ dt, τ the contact torque, positive where it presses; with what a touch of rigid flanks passes on
    peak torque  the largest τ; not a number where a touch is impulsive
    energy       ∫ c q'² dt, and what is left in flanks that part while they overlap less what is found again where such
                 flanks rejoin; of rigid flanks the kinetic energy that is lost at touches
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.channels import CLOSING, CONTACT_TORQUE, OF_LASH, PEAK_TO_PEAK, TERMS, Channels
from clunk.core.events import INSTANT, REJOIN, SEPARATION, TOUCH
from clunk.core.extremes import NODES, integral, integral_of_square, widened
from clunk.core.jit import compiled, part
from clunk.core.references import put, refer, reference_at, words_of
from clunk.core.regimes import Each, System, gap_input
from clunk.core.rigid import held_with
from clunk.core.runs import BEGIN, begin_wave, piece_at, set_gaps, set_torque
from clunk.core.sequence import find_primaries
from clunk.core.severity import root_of_squares
from clunk.core.status import Status
from clunk.core.switching import set_weighed
from clunk.core.tile import Cases

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_OK = int(Status.OK)

IMPULSE, PEAK_TORQUE, ENERGY = range(3)  # of an impact, and the roots of their summed squares of a run
OF_IMPACTS = 3


class Run(NamedTuple):
    """A finished run; P pieces, E events and changes of stage, n inertias, L lashes."""

    load: FloatArray  # (P, PIECE)
    before: FloatArray  # (INPUTS + L - 1 or more,)  d before the load step  [N m, rad, N m/s, rad]
    events: npt.NDArray[np.void]  # (capacity,) EVENT, E of them
    states: FloatArray  # (capacity, N)  [rad, rad/s]
    written: int  # E
    primaries: IntArray  # (L, capacity) indices of each lash's primary impacts in `events`
    impacts: IntArray  # (L,) and how many there are


class Room(NamedTuple):
    """Scratch of a walk."""

    z: FloatArray  # (Z,)  state and inputs
    moved: FloatArray  # (2, Z)
    series: FloatArray  # (TERMS,)  of a channel
    nodes: FloatArray  # (NODES,)  its values there
    inputs: FloatArray  # (I,)  d
    low: FloatArray  # (C,)  range of each channel so far
    high: FloatArray  # (C,)
    impact: IntArray  # (L,)  the last primary impact of each lash, or -1
    row: IntArray  # (L,)  and the row of its values, or -1 where they are not wanted
    primaries: IntArray  # (L, capacity)  as of `Run`
    impacts: IntArray  # (L,)
    systems: IntArray  # (D, …)  of each driveline, see `references.put`


def _make_room(system: System, channels: Channels, capacity: int) -> Room:
    size, count, lashes = channels.rates.shape[3], channels.series.shape[3], system.lashes.shape[0]
    return Room(
        z=np.zeros(size),
        moved=np.zeros((2, size)),
        series=np.zeros(TERMS),
        nodes=np.zeros(NODES),
        inputs=np.ones(system.weights.shape[1]),
        low=np.zeros(count),
        high=np.zeros(count),
        impact=np.zeros(lashes, np.int64),
        row=np.zeros(lashes, np.int64),
        primaries=np.empty((lashes, capacity), np.int64),
        impacts=np.zeros(lashes, np.int64),
        systems=np.empty((channels.rates.shape[0], words_of(system)), np.int64),
    )


def measure_runs(
    system: System,
    each: Each,
    channels: Channels,
    cases: Cases,
    cells: npt.NDArray[np.void],
    logs: npt.NDArray[np.void],
    states: FloatArray,
    totals: FloatArray,
    of_impacts: FloatArray,
) -> None:
    """Measure the runs of some cells; those that failed are not touched.

    Parameters
    ----------
    system, each, channels
        Of the drivelines of a batch, as `tile.Batch`.
    cases, cells, logs, states
        Of a tile, as `tile.Output`; in `logs` the times behind a run's events are NaN.
    totals : (cells, L, OF_IMPACTS + measures) float64
        Output, see `_measure`.
    of_impacts : (impacts, OF_IMPACTS) float64
        Output, each cell's behind those of the cell before.
    """
    room = _make_room(system, channels, logs.shape[1])
    _measure_runs(system, each, channels, cases, cells, logs, states, room, totals, of_impacts)


@compiled
def _measure_runs(
    system: System,
    each: Each,
    channels: Channels,
    cases: Cases,
    cells: npt.NDArray[np.void],
    logs: npt.NDArray[np.void],
    states: FloatArray,
    room: Room,
    totals: FloatArray,
    of_impacts: FloatArray,
) -> None:
    system, each, channels, room = refer(system), refer(each), refer(channels), refer(room)
    first, primaries, impacts = 0, room.primaries, room.impacts
    for k in range(room.systems.shape[0]):
        put(system, each, k, room.systems)
    for k in range(cells.shape[0]):
        count = 0
        for lash in range(impacts.size):
            impacts[lash] = cells[k, lash].primary_impacts
            count += impacts[lash]
        if cells[k, 0].status == _OK:
            driveline, written = cases.drivelines[k % cases.drivelines.size], 0
            while written < logs.shape[1] and not np.isnan(logs[k, written].time):
                written += 1
            of_run = reference_at(room.systems, driveline, system)
            for lash in range(impacts.size):
                side, sticking_time = int(cells[k, lash].initial_side), of_run.sticking_time[lash]
                find_primaries(logs[k], written, lash, side, sticking_time, primaries[lash])
            load = cases.loads[k % cases.loads.shape[0]]
            run = Run(load, cases.before[k], logs[k], states[k], written, primaries, impacts)
            _measure(of_run, channels, driveline, run, room, totals[k], of_impacts[first : first + count])
        first += count


@part
def _measure(
    system: System,
    channels: Channels,
    driveline: int,
    run: Run,
    room: Room,
    totals: FloatArray,
    of_impacts: FloatArray,
) -> None:
    """Measure a run of one of the drivelines.

    Parameters
    ----------
    totals : (L, OF_IMPACTS + measures) float64
        Output, for each lash: roots of the summed squares of its impacts' values, then the measures.
    of_impacts : (impacts, OF_IMPACTS) float64
        Output, if `channels.of_impacts`: impulse [N m s], peak torque [N m] and energy [J] of each, lash by lash.
    """
    size, n, piece, lashes = system.rates.shape[1], 2 * system.inertias, 0, system.lashes.shape[0]
    x, shortest = room.z[:size], INSTANT if lashes > 1 else 0.0
    set_gaps(system, run.before, room.inputs)
    begin_wave(system, run.load, 0, x)
    for c in range(room.low.size):
        room.low[c], room.high[c] = np.inf, -np.inf
    for lash in range(lashes):
        room.impact[lash], room.row[lash] = -1, -1
    for i in range(of_impacts.shape[0]):
        for j in range(OF_IMPACTS):
            of_impacts[i, j] = 0.0
    for k in range(run.written):
        event = run.events[k]
        for j in range(n):
            x[j] = run.states[k, j]
        if channels.of_impacts != 0:
            _begin_impacts(run, room, k)
            if event.lash >= 0:
                _add_event(system, channels, driveline, run, k, x, room.row, of_impacts)
        time, end = event.time, system.end_time[0]
        if k + 1 < run.written:
            end = run.events[k + 1].time
        while end - time > shortest:
            now = piece_at(run.load, piece, time)
            if now != piece:
                piece = now
                begin_wave(system, run.load, piece, x)
            until = end
            if piece + 1 < run.load.shape[0]:
                until = min(end, run.load[piece + 1, BEGIN])
            set_torque(system, run.load, piece, time, room.inputs)
            set_weighed(system, event.regime, room.inputs, room.z[size:])
            _follow(system, channels, driveline, event.regime, until - time, room, of_impacts)
            time = until
    first = 0
    for lash in range(lashes):
        last = first + run.impacts[lash]
        for j in range(OF_IMPACTS):
            totals[lash, j] = np.nan
            if channels.of_impacts != 0:
                if system.impulsive != 0 and j == PEAK_TORQUE:
                    for i in range(first, last):
                        of_impacts[i, j] = np.nan
                totals[lash, j] = root_of_squares(of_impacts[first:last, j], run.impacts[lash])
        first = last
        if system.impulsive != 0:
            totals[lash, PEAK_TORQUE] = np.nan
        for m in range(channels.reductions.size):
            low, high = room.low[OF_LASH * lashes + m], room.high[OF_LASH * lashes + m]
            is_swing = channels.reductions[m] == PEAK_TO_PEAK
            totals[lash, OF_IMPACTS + m] = high - low if is_swing else max(-low, high)


@part
def _begin_impacts(run: Run, room: Room, k: int) -> None:
    """Begin the values of a lash whose primary impact event `k` is."""
    first = 0
    for lash in range(run.impacts.size):
        following = room.impact[lash] + 1
        if following < run.impacts[lash] and run.primaries[lash, following] == k:
            room.impact[lash], room.row[lash] = following, first + following
            torque = OF_LASH * lash + CONTACT_TORQUE
            room.low[torque], room.high[torque] = 0.0, 0.0
        first += run.impacts[lash]


@part
def _add_event(
    system: System,
    channels: Channels,
    driveline: int,
    run: Run,
    k: int,
    x: FloatArray,
    row: IntArray,
    of_impacts: FloatArray,
) -> None:
    """Add to the lashes' impacts what event `k` passes on or takes at once; an impact's impulse passes through others.

    row : (L,) of each lash's impact in `of_impacts`, or -1
    """
    event = run.events[k]
    lash = event.lash
    if system.impulsive != 0:
        if event.kind == TOUCH:
            after, passed = 0.0, channels.passed[driveline, held_with(system, event.regime, lash), lash]
            for j in range(x.size):
                after += system.lashes[lash, j] * x[j]
            for other in range(row.size):
                if row[other] >= 0:
                    of_impacts[row[other], IMPULSE] += abs(passed[other]) * abs(event.speed - after)
            if row[lash] >= 0:
                of_impacts[row[lash], ENERGY] += 0.5 * passed[lash] * (event.speed**2 - after**2)
        return
    if event.kind in (SEPARATION, REJOIN) and row[lash] >= 0:
        overlap = -run.before[gap_input(lash)]
        for j in range(system.inertias):
            overlap += event.side * system.lashes[lash, system.inertias + j] * x[j]
        stored = 0.5 * channels.contact_stiffness[driveline, lash] * overlap**2
        of_impacts[row[lash], ENERGY] += stored if event.kind == SEPARATION else -stored


@part
def _follow(
    system: System, channels: Channels, driveline: int, regime: int, span: float, room: Room, of_impacts: FloatArray
) -> None:
    """Follow the flow of a regime from `room.z` over a time, within which neither regime nor piece of the load ends."""
    z, series, lashes = room.z, room.series, system.lashes.shape[0]
    flow, level, elapsed = system.regimes[regime].flow, 0, 0.0
    begins, lengths = channels.begins[driveline, flow], channels.lengths[driveline, flow]
    while elapsed < span:
        while level + 1 < begins.size and begins[level + 1] <= elapsed:
            level += 1
        length = lengths[level]
        rows, share = channels.series[driveline, flow, level], min((span - elapsed) / length, 1.0)
        for lash in range(lashes):
            contact, torque = system.contacts[regime, lash], OF_LASH * lash + CONTACT_TORQUE
            if contact.closed == 0 or room.row[lash] < 0:
                continue
            values = of_impacts[room.row[lash]]
            _expand(rows[OF_LASH * lash + CLOSING], z, series)
            damped = length * integral_of_square(series, share, room.nodes)
            values[ENERGY] += channels.contact_damping[driveline, lash] * damped
            _expand(rows[torque], z, series)
            values[IMPULSE] += contact.side * length * integral(series, share)
            room.low[torque], room.high[torque] = widened(series, share, room.low[torque], room.high[torque])
            values[PEAK_TORQUE] = room.high[torque] if contact.side > 0 else -room.low[torque]
        for c in range(OF_LASH * lashes, room.low.size):
            _expand(rows[c], z, series)
            room.low[c], room.high[c] = widened(series, share, room.low[c], room.high[c])
        if share < 1.0:
            _move_within(channels.rates[driveline, flow, level], share, room)
            break
        _multiply(channels.steps[driveline, flow, level], z, room.moved[0])
        for j in range(z.size):
            z[j] = room.moved[0, j]
        elapsed += length


@part
def _expand(columns: FloatArray, z: FloatArray, series: FloatArray) -> None:
    """Set `series` to z · columns; four sums at a time take 111 ns, one 187 ns."""
    for k in range(0, TERMS, 4):
        first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
        for j in range(z.size):
            first += z[j] * columns[j, k]
            second += z[j] * columns[j, k + 1]
            third += z[j] * columns[j, k + 2]
            fourth += z[j] * columns[j, k + 3]
        series[k], series[k + 1], series[k + 2], series[k + 3] = first, second, third, fourth


@part
def _move_within(rates: FloatArray, share: float, room: Room) -> None:
    """Move z by a share of a step, by its series."""
    term, following = room.moved[0], room.moved[1]
    for j in range(term.size):
        term[j] = room.z[j]
    for k in range(1, TERMS):
        _multiply(rates, term, following)
        for j in range(term.size):
            term[j] = following[j] * share / k
            room.z[j] += term[j]


@part
def _multiply(columns: FloatArray, vector: FloatArray, product: FloatArray) -> None:
    """Set `product` to vector · columns."""
    for i in range(product.size):
        product[i] = 0.0
    for j in range(vector.size):
        weight = vector[j]
        for i in range(product.size):
            product[i] += weight * columns[j, i]
