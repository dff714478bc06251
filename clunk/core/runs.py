"""The beginning of a run, its buffers, the pieces of its load, and its outcome: the same for both methods."""

from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, Records
from clunk.core.jit import inlined_part, part
from clunk.core.regimes import System, roll
from clunk.core.sequence import take_event
from clunk.core.sums import copy
from clunk.core.tables import TORQUE, TORQUE_RATE

# Columns of a load's pieces: from BEGIN [s after the load step] until the next piece begins, the torque is
# T = LEVEL + SLOPE (t - BEGIN) + w1(t), where w' = S w from w(BEGIN) = (WAVE, WAVE_PARTNER); the last goes on for ever,
# and has no slope. A piece that ends where it begins is skipped.
BEGIN, LEVEL, SLOPE, WAVE, WAVE_PARTNER, PIECE = range(6)  # PIECE: how many these are


class Start(NamedTuple):
    """The beginning of a run, at the load step; N states, P pieces."""

    x: FloatArray  # (N,)  [rad, rad/s]
    regime: int  # the regime at x
    before: FloatArray  # (INPUTS + L - 1,)  d before the load step  [N m, rad, N m/s, rad]
    loads: FloatArray  # (loads, P, PIECE)  [s, N m, N m/s]
    load: int  # the row of `loads` that holds the run's load


class Log(NamedTuple):
    """Buffers for a run's events, of which event 0 is the load step, and for extremes and states at each; L lashes."""

    events: Records  # (capacity,) EVENT
    # (capacity, L, 2)  largest and smallest acceleration of the window that the last primary impact opened, up to the
    # end of the phase that follows; before the first primary impact inf and -inf, which no acceleration exceeds
    extremes: FloatArray  # [rad/s2]
    courses: Records  # (L,) sequence.COURSE
    states: FloatArray  # (capacity, N)  [rad, rad/s]; or (0, N), where states are not kept


class Moment(NamedTuple):
    """State, inputs and tolerances of a run at an event, which may change its state and inputs."""

    system: System
    time: float  # s after the load step
    x: FloatArray  # (N,)  [rad, rad/s]
    inputs: FloatArray  # (I,)  d; the twists at which frictions begin to stick are written there
    # share of the terms of a rate, acceleration or torque below which it counts as zero, see `rubbing.tolerance_after`
    within: float
    # s; times the terms of an acceleration it gives a rate above the method's rounding of rates, see `rubbing.OF_MODES`
    rounded: float


class Entry(NamedTuple):
    """Entry into the regime that follows an event."""

    written: int  # events so far
    regime: int
    zero_guard: int  # the regime's guard that is zero on entry, or -1
    zero_order: int  # how many of that guard's derivatives are zero on entry, the guard itself included


class Outcome(NamedTuple):
    """End of a run: its status, and its number of events."""

    status: int  # see clunk.core.status
    written: int  # events written, the load step included
    quality: int  # QUALITY_COMPLETE where it was proved that nothing follows; exact: QUALITY_GRAZING too
    end: float  # s after the load step


@inlined_part
def end_of_piece(system: System, load: FloatArray, piece: int) -> float:
    """End of a piece of a load, or of the run if that is sooner  [s]."""
    end = system.end_time[0]
    return min(end, load[piece + 1, BEGIN]) if piece + 1 < load.shape[0] else end


@inlined_part
def set_torque(system: System, load: FloatArray, piece: int, time: float, inputs: FloatArray) -> None:
    """Set the torque and its rate of change, in the inputs d of a run, to those of a piece at a time."""
    row = load[piece]
    slope = row[SLOPE] * system.ramps
    inputs[TORQUE], inputs[TORQUE_RATE] = row[LEVEL] + slope * (time - row[BEGIN]), slope


@inlined_part
def go_on(system: System, load: FloatArray, piece: int, time: float, x: FloatArray, inputs: FloatArray) -> int:
    """Set wave, torque and its rate of change to those of the piece that holds from a time on; return that piece."""
    before, size = piece, 2 * system.inertias
    while piece + 1 < load.shape[0] and load[piece + 1, BEGIN] <= time:
        piece += 1
    if piece != before and x.size > size:
        x[size], x[size + 1] = load[piece, WAVE], load[piece, WAVE_PARTNER]
        if not system.ramps:
            x[size + 1] += load[piece, SLOPE]
    set_torque(system, load, piece, time, inputs)
    return piece


@inlined_part
def record(at: Moment, log: Log, k: int, speed: float, kind: int, regime: int, lash: int, side: int) -> None:
    """Write event `k` and the state at the event, and update its lash's COURSE, which decides whether it is primary.

    The extremes beside the event are not written here: the phase that it opens is still to come.
    """
    event = log.events[k]
    event.time = at.time
    event.speed = speed
    event.kind = kind
    event.regime = regime
    event.lash = lash
    event.side = side
    event.primary = lash >= 0 and take_event(log.courses[lash], event, at.system.sticking_time[lash])
    if log.states.shape[0] > k:
        copy(at.x, log.states[k])


@part
def begin_windows(log: Log, k: int) -> None:
    """Set the extremes beside event `k` to those at the beginning of the phase that the event opens."""
    event = log.events[k]
    for lash in range(log.courses.size):
        window = log.extremes[k, lash]
        if k == 0:
            window[0], window[1] = np.inf, -np.inf
        elif event.primary and event.lash == lash:  # its window begins empty: any acceleration widens it
            window[0], window[1] = -np.inf, np.inf
        else:
            copy(log.extremes[k - 1, lash], window)


@part
def roll_states(system: System, angle: float, log: Log, first: int, written: int) -> None:
    """Turn the kept states at events `first` to `written - 1` by the angle that the run has rolled by  [rad]."""
    for k in range(first, min(written, log.states.shape[0])):
        roll(system, angle, log.states[k])
