"""Many runs: one tile of a sweep, on one thread, without the interpreter lock."""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import overload

from clunk.core import exact, rk4, switching
from clunk.core.events import EVENT, TOUCH
from clunk.core.flows import Flows
from clunk.core.jit import compiled
from clunk.core.regimes import System
from clunk.core.sequence import INITIAL, OPPOSITE, find_primaries
from clunk.core.severity import approach_velocity, peak_to_peak
from clunk.core.status import INTERRUPTED, QUALITY_UNDECIDED, Status
from clunk.core.steps import Steps

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
        ("margin", np.float64),  # see clunk.core.exact; NaN where the method knows none
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


def run(
    system: System,
    tables: Steps | Flows,
    x: FloatArray,
    regime: int,
    torque: float,
    half_gap: float,
    events: npt.NDArray[np.void],
    states: FloatArray,
    stop: npt.NDArray[np.uint8],
) -> tuple[int, int, int, float, float]:
    """Run one load step by the method that the tables are for: see `rk4.run` and `exact.run`."""
    method: Any = exact.run if isinstance(tables, Flows) else rk4.run
    found: tuple[int, int, int, float, float] = method(
        system, tables, x, regime, torque, half_gap, events, states, stop
    )
    return found


def _workspace(tables: Steps | Flows) -> Any:
    """What `_run_in` needs beside the tables, for all cells of a tile."""


@overload(_workspace)
def _compiled_workspace(tables: Any) -> Any:
    def of_exact(tables: Any) -> Any:
        return exact.workspace(tables)

    def of_rk4(tables: Any) -> Any:
        return 0

    return of_exact if tables.instance_class is Flows else of_rk4


def _run_in(*space_and_arguments: Any) -> Any:
    """`run`, within a kernel."""


@overload(_run_in)
def _compiled_run(
    space: Any, system: Any, tables: Any, x: Any, regime: Any, torque: Any, half_gap: Any, events: Any, states: Any,
    stop: Any
) -> Any:  # fmt: skip
    def by_exact(
        space: Any, system: Any, tables: Any, x: Any, regime: Any, torque: Any, half_gap: Any, events: Any, states: Any,
        stop: Any
    ) -> Any:  # fmt: skip
        return exact.run_in(space, system, tables, x, regime, torque, half_gap, events, states, stop)

    def by_rk4(
        space: Any, system: Any, tables: Any, x: Any, regime: Any, torque: Any, half_gap: Any, events: Any, states: Any,
        stop: Any
    ) -> Any:  # fmt: skip
        return rk4.run(system, tables, x, regime, torque, half_gap, events, states, stop)

    return by_exact if tables.instance_class is Flows else by_rk4


@compiled
def run_tile(
    system: System,
    tables: Steps | Flows,
    undecided: float,
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
    system, tables
        As `run` takes them.
    undecided : float
        Cells whose |margin| is below it are flagged.
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
    size = system.lash.size
    x, space = np.empty(size), _workspace(tables)
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
        cell.margin = np.nan
        cell.primary_impacts = 0
        cell.touches = 0
        cell.quality = 0
        cell.initial_side = 0
        cell.status = system.status
        if system.status != _OK:
            continue
        side = switching.preload(system, torque_before[k], half_gap[k], x)
        if side == 0:
            cell.status = _NO_INITIAL_FLANK
            continue
        cell.initial_side = side
        status, count, quality, margin, _ = _run_in(
            space, system, tables, x, switching.closed_on(side), torque_after[k], half_gap[k], events, states, stop
        )
        if status == INTERRUPTED:
            return k, written
        cell.status = status
        if status != _OK:
            continue
        cell.margin = margin
        if abs(margin) < undecided:
            quality |= QUALITY_UNDECIDED
        cell.quality = quality
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
