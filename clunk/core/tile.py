"""Many runs: one tile of a sweep, on one thread, without the interpreter lock."""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import overload

from clunk.core import switching
from clunk.core.events import EVENT, TOUCH
from clunk.core.exact import rows
from clunk.core.exact import run as exact
from clunk.core.exact.flows import Flows
from clunk.core.jit import compiled, unowned
from clunk.core.lanes import queues
from clunk.core.lanes.pool import ABREAST, fields, make_pool
from clunk.core.regimes import System
from clunk.core.rk4 import run as rk4
from clunk.core.rk4.propagator import Steps
from clunk.core.sequence import INITIAL, OPPOSITE, find_primaries
from clunk.core.severity import approach_velocity, peak_to_peak
from clunk.core.status import INTERRUPTED, QUALITY_UNDECIDED, Status

FloatArray = npt.NDArray[np.float64]

_OK = int(Status.OK)
_NO_INITIAL_FLANK = int(Status.NO_INITIAL_FLANK)

LONGEST_PATTERN = 62
_EVENT_MEMORY = 1_000_000  # events that there is room for at a time: 56 MB

CELL = np.dtype(
    [
        ("pattern", np.uint64),  # the primaries' flanks as bits behind a leading 1 (opposite: 1), 0 for more than 62
        ("severity", np.float64),  # Q, rad/s2
        ("approach_velocity", np.float64),  # V, rad/s
        ("last_event_time", np.float64),  # s after the load step, NaN without events
        ("margin", np.float64),  # see clunk.core.exact.run; NaN where the method knows none
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
    return _run_all(  # type: ignore[no-any-return]
        system, tables, undecided, torque_before, torque_after, half_gap, first, max_events, cells, impacts, stop
    )


def _run_all(*arguments: Any) -> Any:
    """`run_tile`, by the method that its tables are for."""


@overload(_run_all)
def _compiled_run_all(
    system: Any, tables: Any, undecided: Any, torque_before: Any, torque_after: Any, half_gap: Any, first: Any,
    max_events: Any, cells: Any, impacts: Any, stop: Any
) -> Any:  # fmt: skip
    method: Any = by_exact if tables.instance_class is Flows else by_rk4

    def run_all(
        system: Any, tables: Any, undecided: Any, torque_before: Any, torque_after: Any, half_gap: Any, first: Any,
        max_events: Any, cells: Any, impacts: Any, stop: Any
    ) -> Any:  # fmt: skip
        return method(
            system, tables, undecided, torque_before, torque_after, half_gap, first, max_events, cells, impacts, stop
        )

    return run_all


@compiled
def by_rk4(
    system: System,
    steps: Steps,
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
    """`run_tile` by RK4: one run after the other."""
    size = system.lash.size
    x = np.empty(size)
    events = np.empty(max_events + 1, EVENT)
    states = np.empty((0, size))
    scratch = _scratch(max_events)
    written = 0
    for k in range(first, cells.size):
        if stop[0] != 0 or written + max_events > impacts.size:
            return k, written
        if not _preloaded(system, torque_before[k], half_gap[k], cells[k], x):
            continue
        regime = switching.closed_on(cells[k].initial_side)
        status, count, quality, margin, _ = rk4.run(
            system, steps, x, regime, torque_after[k], half_gap[k], events, states, stop
        )
        if status == INTERRUPTED:
            return k, written
        found = _describe(system, undecided, status, count, quality, margin, events, cells[k], scratch)
        _copy(events, found, cells[k].initial_side, scratch, impacts, written)
        written += found
    return cells.size, written


@compiled
def by_exact(
    system: System,
    flows: Flows,
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
    """`run_tile` by the exact method: many runs at a time.

    They are over in any order; their impacts are put in that of the cells at the end.
    """
    size, waiting = system.lash.size, cells.size - first
    slots = min(ABREAST, max(waiting, 1), max(_EVENT_MEMORY // (max_events + 1), 1))
    x = np.empty(size)
    pool = make_pool(system, flows, np.empty((slots, max_events + 1), EVENT), np.empty((slots, 0, size)))
    scratch = _scratch(max_events)
    free, spare = np.arange(slots), slots
    begins, pending = np.full(waiting, -1), np.ones(waiting, np.bool_)  # where its impacts are; whether it is not over
    margin_at = fields(flows.basis.shape[1]) + rows.MARGIN
    admitted, oldest, written, full = first, first, 0, False
    while True:
        while spare > 0 and admitted < cells.size and not full:
            cell = cells[admitted]
            if _preloaded(system, torque_before[admitted], half_gap[admitted], cell, x):
                spare -= 1
                slot = free[spare]
                pool.runs[slot].tag = admitted
                regime = switching.closed_on(cell.initial_side)
                exact.begin(pool, slot, system, flows, x, regime, torque_after[admitted], half_gap[admitted])
            else:
                pending[admitted - first] = False
            admitted += 1
        while oldest < admitted and not pending[oldest - first]:
            oldest += 1
        if spare == slots or stop[0] != 0:
            break
        exact.advance(pool, system, flows, stop)
        for n in range(pool.length[queues.OVER]):
            slot = pool.waiting[queues.OVER, n]
            run = pool.runs[slot]
            k, events = run.tag, pool.events[slot]
            free[spare] = slot
            spare += 1
            margin = pool.numbers[slot, margin_at]
            found = _describe(system, undecided, run.status, run.count, run.quality, margin, events, cells[k], scratch)
            # room is kept for the oldest, so that every call is through with one cell at least
            if written + found + (0 if k == oldest else max_events) > impacts.size:
                full = True
                continue
            _copy(events, found, cells[k].initial_side, scratch, impacts, written)
            begins[k - first], pending[k - first] = written, False
            written += found
            while oldest < admitted and not pending[oldest - first]:
                oldest += 1
        pool.length[queues.OVER] = 0
    ordered, count = impacts[:written].copy(), 0
    for k in range(first, oldest):
        for i in range(cells[k].primary_impacts):
            impacts[count] = ordered[begins[k - first] + i]
            count += 1
    return oldest, count


@compiled
def _scratch(max_events: int) -> tuple[npt.NDArray[np.int64], FloatArray, FloatArray]:
    """A run's primary impacts, their severity and closing speed."""
    return np.empty(max_events + 1, np.int64), np.empty(max_events + 1), np.empty(max_events + 1)


@unowned
def _preloaded(system: System, torque: float, half_gap: float, cell: Any, x: FloatArray) -> bool:
    """Whether a cell can be run, and its state before the load step."""
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
        return False
    cell.initial_side = switching.preload(system, torque, half_gap, x)
    if cell.initial_side == 0:
        cell.status = _NO_INITIAL_FLANK
        return False
    return True


@unowned
def _describe(
    system: System,
    undecided: float,
    status: int,
    count: int,
    quality: int,
    margin: float,
    events: npt.NDArray[np.void],
    cell: Any,
    scratch: tuple[npt.NDArray[np.int64], FloatArray, FloatArray],
) -> int:
    """What a run is kept as; returns how many primary impacts it has."""
    cell.status = status
    if status != _OK:
        return 0
    primaries, severity, speeds = scratch
    cell.margin = margin
    if abs(margin) < undecided:
        quality |= QUALITY_UNDECIDED
    cell.quality = quality
    found = find_primaries(events, count, system.sticking_time, primaries)
    cell.severity = peak_to_peak(events, count, primaries, found, severity)
    if system.impulsive != 0:  # the acceleration of an impulsive touch is not a number
        cell.severity, severity[:found] = np.nan, np.nan
    cell.approach_velocity = approach_velocity(events, primaries, found, speeds)
    cell.pattern = np.uint64(1) if found <= LONGEST_PATTERN else np.uint64(0)
    for i in range(found if found <= LONGEST_PATTERN else 0):
        opposite = events[primaries[i]].side != cell.initial_side
        cell.pattern = np.uint64(2) * cell.pattern + np.uint64(opposite)
    cell.primary_impacts = found
    for i in range(1, count):
        if events[i].kind == TOUCH:
            cell.touches += 1
    if count > 1:
        cell.last_event_time = events[count - 1].time
    return int(found)


@unowned
def _copy(
    events: npt.NDArray[np.void],
    found: int,
    side: int,
    scratch: tuple[npt.NDArray[np.int64], FloatArray, FloatArray],
    impacts: npt.NDArray[np.void],
    first: int,
) -> None:
    """Write a run's primary impacts from the one at `first` on."""
    primaries, severity, speeds = scratch
    for i in range(found):
        event, impact = events[primaries[i]], impacts[first + i]
        impact.time = event.time
        impact.closing_speed = speeds[i]
        impact.severity = severity[i]
        impact.flank = INITIAL if event.side == side else OPPOSITE
