"""Runs of many cells: one tile of a sweep, on one thread, without the interpreter lock."""

from typing import Any, NamedTuple

import numpy as np

from clunk.core import switching
from clunk.core.arrays import FloatArray, IntArray, Positions, Records, StopFlag, record_of
from clunk.core.channels import Channels
from clunk.core.events import EVENT, STAGE, TOUCH
from clunk.core.exact import run as exact
from clunk.core.exact.flows import Flows
from clunk.core.exact.workspace import UNDER_WAY, Workspace, log_of, system_at, system_of, workspace_of
from clunk.core.jit import compiled, part
from clunk.core.references import refer
from clunk.core.regimes import System, driveline_at
from clunk.core.rk4 import run as rk4
from clunk.core.rk4.propagator import Steps
from clunk.core.rk4.step import Room, make_room
from clunk.core.runs import Log, Outcome, Start
from clunk.core.sequence import COURSE, INITIAL, OPPOSITE
from clunk.core.status import EVENT_BUFFER_FULL, INTERRUPTED, OK, QUALITY_UNDECIDED
from clunk.core.sums import copy

LONGEST_PATTERN = 62
EVENTS = 2048  # events of a run for which there is room at first
MORE = 64  # times as much room, with which a run is repeated that has more events than fit
_EVENT_MEMORY = 2_000_000  # events of all runs under way: room of 112 MB, and 32 MB for each lash, if all happen

CELL = record_of(
    # flanks of the primary impacts as bits behind a leading 1 (opposite: 1); 0 for more than 62, or for a failed run
    pattern="u8",
    severity="f8",  # Q, rad/s2
    approach_velocity="f8",  # V, rad/s
    last_event_time="f8",  # s after the load step, NaN without events
    margin="f8",  # see clunk.core.exact.margins; NaN by rk4, which computes none
    primary_impacts="i4",
    touches="i4",
    status="u1",
    quality="u1",
    initial_side="i1",
)

IMPACT = record_of(
    time="f8",  # s after the load step
    closing_speed="f8",  # |q'| just before touch, rad/s
    severity="f8",  # Q_i, rad/s2
    flank="i1",  # +1 opposite, -1 initial
)


class Cases(NamedTuple):
    """Inputs of cells; there is one load, and one driveline, for each cell or for all cells."""

    before: FloatArray  # (cells, INPUTS + L - 1)  d before the load step  [N m, rad, N m/s, rad]
    loads: FloatArray  # (cells or 1, P, PIECE)  pieces of the load after the load step
    drivelines: IntArray  # (cells or 1,)  positions of the cells' drivelines in a batch
    # only of runs that do not begin in steady motion in contact; their margins have no meaning
    states: FloatArray = np.zeros((0, 0))  # (cells or 0, N)  at the load step  [rad, rad/s]
    regimes: IntArray = np.zeros(0, np.int64)  # (cells or 0,)  regime at the load step

    def at(self, index: Positions | slice) -> "Cases":
        """Inputs of the cells at some positions, without `states` and `regimes`: their runs begin in steady motion."""
        others: Any = (each if len(each) == 1 else each[index] for each in (self.loads, self.drivelines))
        return Cases(self.before[index], *others)


class Output(NamedTuple):
    """Buffers for the results of cells with L lashes, and for their primary impacts.

    The impacts are in the order of cells, and within a cell lash by lash. Status and quality are those of a cell, the
    same in all of its lashes.
    """

    cells: Records  # (cells, L) CELL, zeros
    impacts: Records  # (capacity,) IMPACT
    logs: Records  # (cells, capacity) EVENT, left as it was behind a run's events; or (0, 0), to keep no events
    # (cells, capacity, N)  [rad, rad/s]  at the events, which then include changes of stage; or (0, 0, 0)
    states: FloatArray
    extremes: FloatArray = np.zeros((0, 0, 0, 2))  # (cells or 0, capacity, L, 2)  see `runs.Log`
    ends: FloatArray = np.zeros(0)  # (cells or 0,)  s after the load step


class Batch(NamedTuple):
    """Drivelines that differ in `regimes.VARYING` only: for rk4 one, else any number D of them.

    All have the same `modal` and `steady` in their `Flows` (`simulation.batches` sees to that).
    """

    systems: System  # with an axis of D in front of what varies
    tables: Steps | Flows  # Steps of one driveline, for rk4; or Flows with an axis of D in front
    channels: Channels | None = None  # the channels of measures, if anything is measured

    @property
    def system(self) -> System:
        """The system of the first driveline."""
        return driveline_at(self.systems, 0)

    def at(self, drivelines: Positions | list[int]) -> "Batch":
        """The batch of some of the drivelines."""
        tables = self.tables
        if isinstance(tables, Flows):
            tables = Flows._make(table[drivelines] for table in tables)
        return Batch(driveline_at(self.systems, drivelines), tables, self.channels and self.channels.at(drivelines))


def capacity_of(events: int, lashes: int) -> int:
    """Capacity of a log for the load step, a number of events, and one switch more, as `switching.may_switch` needs."""
    return events + 3 + 3 * lashes


def run_tile(
    batch: Batch,
    undecided: float,
    cases: Cases,
    first: int,
    max_events: int,
    output: Output,
    stop: StopFlag,
) -> tuple[int, int]:
    """Run cells from `first` on, until all are done, `impacts` may lack room for the next cell's, or `stop` is set.

    Parameters
    ----------
    undecided : float
        Cells whose |margin| is below it are flagged.

    Returns
    -------
    done, written : int
        The first cell that was not run, and how many impacts were written.
    """
    systems, tables = batch.systems, batch.tables
    size, lashes, left = systems.lashes.shape[-1], systems.lash_count, len(output.cells) - first
    capacity, states = (output.logs.shape[1],) * 2 if output.states.size else (capacity_of(max_events, lashes), 0)
    x = np.empty(size)
    if not isinstance(tables, Flows):
        system = batch.system
        log = Log(
            np.empty(capacity, EVENT),
            np.empty((capacity, lashes, 2)),
            np.empty(lashes, COURSE),
            np.empty((states, size)),
        )
        room = make_room(system, tables)
        return by_rk4(system, tables, undecided, cases, first, max_events, output, log, room, x, stop)
    slots = min(UNDER_WAY, max(left, 1), max(_EVENT_MEMORY // capacity, 1))
    space = workspace_of(systems, tables, cases.loads, slots, capacity, states)
    free = np.arange(slots)
    begins, impacts = np.full(left, -1), output.impacts
    done = by_exact(space, undecided, cases, first, max_events, output, x, free, begins, stop)
    # runs end in any order: put their impacts in the order of the cells
    counts = output.cells["primary_impacts"][first:done].sum(axis=1, dtype=np.int64)
    behind = np.cumsum(counts)
    written = counts.sum()
    impacts[:written] = impacts[np.arange(written) + np.repeat(begins[: done - first] - behind + counts, counts)]
    return done, written


@compiled
def by_rk4(
    system: System,
    steps: Steps,
    undecided: float,
    cases: Cases,
    first: int,
    max_events: int,
    output: Output,
    log: Log,
    room: Room,
    x: FloatArray,
    stop: StopFlag,
) -> tuple[int, int]:
    """`run_tile` by RK4: one run after the other."""
    system, steps, cases, output = refer(system), refer(steps), refer(cases), refer(output)
    log, room, cells, written = refer(log), refer(room), output.cells, 0
    for k in range(first, cells.shape[0]):
        if stop[0] or written + max_events > output.impacts.size:
            return k, written
        start = _begin(system, cases, k, cells[k], x)
        if cells[k, 0].status != OK:
            continue
        outcome = rk4.run(system, steps, start, log, room, stop)
        if outcome.status == INTERRUPTED:
            return k, written
        written += _finish(system, undecided, outcome, log, max_events, output, k, written)
    return cells.shape[0], written


@compiled
def by_exact(
    space: Workspace,
    undecided: float,
    cases: Cases,
    first: int,
    max_events: int,
    output: Output,
    x: FloatArray,
    free: IntArray,
    begins: IntArray,
    stop: StopFlag,
) -> int:
    """`run_tile` by the exact method: many runs at a time. Returns the first cell that was not run.

    Parameters
    ----------
    x : (N,) float64
        Scratch, for a state.
    free : (S,) int64
        Scratch, for the slots of the workspace in which there is no run: at first all of them.
    begins : (cells - first,) int64
        Output, where the impacts of each cell from `first` on begin; -1 until the cell is done.
    """
    space, cases, output = refer(space), refer(cases), refer(output)
    cells, pool, over = output.cells, space.pool, space.queues.over
    slots = spare = free.size
    admitted, oldest, written, full = first, first, 0, False
    while True:
        while spare > 0 and admitted < cells.shape[0] and not full:
            driveline = cases.drivelines[admitted % cases.drivelines.size]
            start = _begin(system_at(space, driveline), cases, admitted, cells[admitted], x)
            if cells[admitted, 0].status == OK:
                spare -= 1
                slot = free[spare]
                space.runs[slot].tag = admitted
                exact.begin(space, slot, driveline, start)
            else:
                begins[admitted - first] = written
            admitted += 1
        while oldest < admitted and begins[oldest - first] >= 0:
            oldest += 1
        if spare == slots or stop[0]:
            break
        exact.advance(space, stop)
        for n in range(pool.length[over]):
            slot = pool.waiting[over, n]
            row = space.runs[slot]
            k = row.tag
            free[spare] = slot
            spare += 1
            log = log_of(space, slot)
            outcome = Outcome(row.status, row.count, row.quality, row.time)
            primaries = _finish(system_of(space, slot), undecided, outcome, log, max_events, output, k, written)
            # Room for impacts stays free for the oldest cell, so that every call finishes one cell at least. Cells
            # behind a cell that is not done are run again by the next call.
            if written + primaries + max_events * (k != oldest) > output.impacts.size:
                full = True
                continue
            begins[k - first] = written
            written += primaries
        pool.length[over] = 0
    return oldest


@part
def _begin(system: System, cases: Cases, k: int, cells: Records, x: FloatArray) -> Start:
    """Set `x` to cell k's state at the load step, and the cell's status, OK if it can run; return the run's Start."""
    status, regime = system.status, 0
    if cases.regimes.size > 0:
        status, regime = OK, cases.regimes[k]
        copy(cases.states[k], x)
    elif status == OK:
        status, regime = switching.preload(system, cases.before[k], x)
    for lash in range(system.lash_count):
        cell = cells[lash]
        cell.severity = cell.approach_velocity = cell.last_event_time = cell.margin = np.nan
        cell.touches = 0
        cell.initial_side = system.contacts[regime, lash].side if status == OK else 0
        cell.status = status
    return Start(x, regime, cases.before[k], cases.loads, k % cases.loads.shape[0])


@part
def _finish(
    system: System,
    undecided: float,
    outcome: Outcome,
    log: Log,
    max_events: int,
    output: Output,
    k: int,
    first: int,
) -> int:
    """Write the results of a run to cell k, and its primary impacts from `first` on; return how many they are.

    Impacts for which there is no room are counted, but not written. The log is copied to those of the output's logs,
    states and extremes that have rows.

    Q_i = max θ'' - min θ'' and Q = sqrt(sum Q_i²) are report Eqs 3.2 and 3.3; V = sqrt(sum v_i²), v_i = |q'| just
    before the touch. The window of a primary impact reaches from its touch, right limit included, to the next primary
    impact or the end of the run, gap phases included, with the one-sided limits at every event.
    """
    for i in range(outcome.written if output.logs.size > 0 else 0):
        output.logs[k, i] = log.events[i]
        if output.states.size > 0:
            copy(log.states[i], output.states[k, i])
        for lash in range(output.extremes.shape[2]):
            copy(log.extremes[i, lash], output.extremes[k, i, lash])
    if output.ends.size > 0:
        output.ends[k] = outcome.end
    cells, impacts, nearest, total, happened = output.cells[k], output.impacts, np.inf, 0, 0
    for i in range(1, outcome.written):
        happened += log.events[i].kind != STAGE
    status = EVENT_BUFFER_FULL if outcome.status == OK and happened > max_events else outcome.status
    for lash in range(system.lash_count):
        cells[lash].status = status
        nearest = min(nearest, abs(log.courses[lash].least))
    if status != OK:
        return 0
    none = np.nan if system.impulsive else 0.0  # an impulsive touch has no finite acceleration
    for lash in range(system.lash_count):
        cell, events, severities, speeds = cells[lash], log.events, none, 0.0  # sums of squares
        cell.margin = log.courses[lash].least
        cell.quality = outcome.quality | QUALITY_UNDECIDED * (nearest < undecided)
        side, primaries, pattern = cell.initial_side, 0, np.uint64(1)
        for i in range(1, outcome.written):
            event = events[i]
            if event.lash != lash:
                continue
            cell.last_event_time = event.time
            cell.touches += event.kind == TOUCH
            if not event.primary:
                continue
            end = i + 1
            while end < outcome.written and not (events[end].lash == lash and events[end].primary):
                end += 1
            pattern = np.uint64(2) * pattern + np.uint64(event.side != side)
            severity = log.extremes[end - 1, lash, 0] - log.extremes[end - 1, lash, 1] + none
            severities, speeds = severities + severity**2, speeds + event.speed**2
            if first + total < impacts.size:
                impact = impacts[first + total]
                impact.time = event.time
                impact.closing_speed = abs(event.speed)
                impact.severity = severity
                impact.flank = INITIAL if event.side == side else OPPOSITE
            primaries, total = primaries + 1, total + 1
        cell.pattern = pattern if primaries <= LONGEST_PATTERN else np.uint64(0)
        cell.primary_impacts = primaries
        cell.severity = np.sqrt(severities)
        cell.approach_velocity = np.sqrt(speeds)
    return total
