"""Many runs: one tile of a sweep, on one thread, without the interpreter lock."""

from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core import rk4, switching
from clunk.core.events import EVENT, TOUCH
from clunk.core.jit import compiled
from clunk.core.regimes import System
from clunk.core.sequence import INITIAL, OPPOSITE, find_primaries
from clunk.core.severity import approach_velocity, peak_to_peak
from clunk.core.status import INTERRUPTED, QUALITY_COMPLETE, Status

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NO_INITIAL_FLANK = int(Status.NO_INITIAL_FLANK)

LONGEST_PATTERN = 62

CELL = np.dtype(
    [
        ("pattern", np.uint64),  # the primaries' flanks as bits behind a leading 1 (opposite: 1), 0 for more than 62
        ("severity", np.float64),  # Q, rad/s2
        ("approach_velocity", np.float64),  # V, rad/s
        ("last_event_time", np.float64),  # s after the load step, NaN without events
        ("primary_impacts", np.int32),
        ("touches", np.int32),
        ("status", np.uint8),
        ("quality", np.uint8),
        ("initial_side", np.int8),
    ],
    align=True,
)

IMPACT = np.dtype(
    [
        ("time", np.float64),  # s after the load step
        ("closing_speed", np.float64),  # |q'| just before touch, rad/s
        ("severity", np.float64),  # Q_i, rad/s2
        ("flank", np.int8),  # +1 opposite, -1 initial
    ],
    align=True,
)


@compiled
def select(systems: Any, k: int) -> System:
    """System `k` of a stack, whose fields have a leading dimension."""
    return System(
        systems.rates[k],
        systems.inputs[k],
        systems.functionals[k],
        systems.feedthrough[k],
        systems.lash[k],
        systems.transfer[k],
        systems.transfer_input[k],
        systems.block[k],
        systems.block_input[k],
        systems.observe[k],
        systems.observe_input[k],
        systems.flow[k],
        systems.side[k],
        systems.guards[k],
        systems.guard_functional[k],
        systems.guard_sign[k],
        systems.guard_offset[k],
        systems.successor[k],
        systems.event_kind[k],
        systems.zero_guard[k],
        systems.zero_order[k],
        systems.impulsive[k],
        systems.impulse[k],
        systems.restitution[k],
        systems.locking_speed[k],
        systems.preload[k],
        systems.contact_torque[k],
        systems.provable[k],
        systems.mode_rows[k],
        systems.mode_reach[k],
        systems.rest_state[k],
        systems.rest_functional[k],
        systems.step[k],
        systems.end_time[k],
        systems.sticking_time[k],
        systems.status[k],
    )


@compiled
def run_tile(
    systems: System,
    system_of: npt.NDArray[np.int64],
    torque_before: FloatArray,
    torque_after: FloatArray,
    half_gap: FloatArray,
    first: int,
    max_events: int,
    cells: npt.NDArray[np.void],
    impacts: npt.NDArray[np.void],
    stop: npt.NDArray[np.uint8],
) -> tuple[int, int]:
    """Run the cells from `first` on, until all are done, `impacts` may not hold the next one's, or `stop` is set.

    Parameters
    ----------
    systems : System
        A stack.
    system_of : (cells,) int64
        Each cell's system.
    torque_before, torque_after : (cells,) float64  [N m]
    half_gap : (cells,) float64  [rad]
    cells : (cells,) CELL
        Output.
    impacts : (capacity,) IMPACT
        Output: the primary impacts, each cell's behind those of the cell before it.

    Returns
    -------
    done, written : int
        The first cell that was not run, and how many impacts were written.
    """
    size = systems.rates.shape[2]
    x = np.empty(size)
    events = np.empty(max_events + 1, EVENT)
    states = np.empty((0, size))
    primaries = np.empty(max_events + 1, np.int64)
    severity, speeds = np.empty(max_events + 1), np.empty(max_events + 1)
    written = 0
    for k in range(first, cells.size):
        if stop[0] != 0 or written + max_events > impacts.size:
            return k, written
        cell = cells[k]
        cell.pattern = 0
        cell.severity = np.nan
        cell.approach_velocity = np.nan
        cell.last_event_time = np.nan
        cell.primary_impacts = 0
        cell.touches = 0
        cell.quality = 0
        cell.initial_side = 0
        system = select(systems, system_of[k])
        cell.status = system.status
        if system.status != _OK:
            continue
        side = switching.preload(system, torque_before[k], half_gap[k], x)
        if side == 0:
            cell.status = _NO_INITIAL_FLANK
            continue
        cell.initial_side = side
        status, count, complete, _ = rk4.run(
            system, x, switching.closed_on(side), torque_after[k], half_gap[k], events, states, stop
        )
        if status == INTERRUPTED:
            return k, written
        cell.status = status
        if status != _OK:
            continue
        if complete:
            cell.quality = QUALITY_COMPLETE
        found = find_primaries(events, count, system.sticking_time, primaries)
        cell.severity = peak_to_peak(events, count, primaries, found, severity)
        if system.impulsive != 0:  # the acceleration of an impulsive touch is not a number
            cell.severity, severity[:found] = np.nan, np.nan
        cell.pattern = np.uint64(1) if found <= LONGEST_PATTERN else np.uint64(0)
        cell.approach_velocity = approach_velocity(events, primaries, found, speeds)
        for i in range(found):
            event = events[primaries[i]]
            impact = impacts[written]
            impact.time = event.time
            impact.closing_speed = speeds[i]
            impact.severity = severity[i]
            impact.flank = INITIAL if event.side == side else OPPOSITE
            if found <= LONGEST_PATTERN:
                cell.pattern = np.uint64(2) * cell.pattern + np.uint64(impact.flank == OPPOSITE)
            written += 1
        cell.primary_impacts = found
        for i in range(1, count):
            if events[i].kind == TOUCH:
                cell.touches += 1
        if count > 1:
            cell.last_event_time = events[count - 1].time
    return cells.size, written
