"""Workspace of the exact method: the numbers of the runs under way and of their searches, the queues, and scratch.

`rows` names the positions of these numbers.
"""

import threading
from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray, Records, record_of
from clunk.core.events import EVENT
from clunk.core.exact import rows
from clunk.core.exact.flows import LONG, TERMS, Flows
from clunk.core.jit import inlined_part
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import Pool, aligned, whole
from clunk.core.lanes.vectors import WIDTH, Vector
from clunk.core.references import reference_at, rows_of
from clunk.core.regimes import System, driveline_at
from clunk.core.runs import Log
from clunk.core.sequence import COURSE

# Runs under way at a time. With many, enough of them wait for steps of one kind to take several of these on end, whose
# code then stays in the cache. With twice as many, the rig takes 1.1 times as long, and with frictions 0.95 times.
UNDER_WAY = 16 * WIDTH
GRAZING = 1e-12  # share of a guard's scale: a guard that turns back so little below zero has not turned negative
OF_SEEN = 13  # rows of lanes that a step keeps of each functional, see clunk.core.exact.step

RUN = record_of(
    tag="i8",  # by which the caller knows the run
    driveline="i8",
    status="i8",
    quality="i8",
    count="i8",  # events so far
    regime="i8",
    stages="i8",  # changes of stage so far that are not written as events
    searches="i8",  # searches of the last step that are still under way
    load="i8",  # the row of `Workspace.loads`
    piece="i8",  # of the load
    ended="i8",  # how the last step ended, see `rows.GOES_ON`
    guard="i8",  # the guard that ended the last step, if an event did
    time="f8",  # s after the load step, when the stretch began; of a run that is over, when it ended
    rolled="f8",  # rad, by which the first inertia that rolls has turned; the angles of the run are less that
)


class Queues(NamedTuple):
    """Number of the first queue of each kind.

    Steps and entries have a queue for each group of regimes, searches one for each flow and functional in it.
    """

    span: int  # runs whose next step takes a span
    short: int  # runs whose next step takes a part of the shortest span
    enter: int  # runs that enter a regime
    search: int  # searches, see `clunk.core.exact.search`
    over: int  # finished runs
    follow: int  # runs whose last step, with its searches, is done, and whose next queue is still to be chosen


class Workspace(NamedTuple):
    """The runs under way, S at most, and all that one thread needs to take steps with them.

    N states, G guards, L lashes, W lanes; D drivelines, P pieces of a load; else as in `Flows`.
    """

    system: System  # of the first driveline; the fields in `regimes.VARYING` are read from `system_of` a run
    systems: IntArray  # (D, …)  that of each driveline, see `system_at`
    flows: Flows  # of all drivelines, with an axis in front
    mixed: int  # whether runs that are taken together may have different drivelines
    pool: Pool
    queues: Queues
    numbers: FloatArray  # (S + 1, …)  of each run; the last row is scratch for unused lanes
    fields: FloatArray  # (S + 1, …)  view of `numbers`, from the first one that `rows` names on
    of_lashes: FloatArray  # (S + 1, L, …)  view of `numbers`: those of each lash
    weighed: FloatArray  # (S + 1, I)  view of `numbers`: u, the inputs times the weights of the run's regime
    searches: FloatArray  # ((S + 1) (L + G + 1), …)  of each search of each run; the last row is scratch likewise
    searches_each: int  # L + G + 1
    behind: int  # C, the position in a row where the numbers that `rows` names begin
    inputs_at: int  # the position in a row where u begins
    runs: Records  # (S + 1,) RUN
    courses: Records  # (S, L) sequence.COURSE
    loads: FloatArray  # (loads, P, PIECE)
    inputs: FloatArray  # (S, I)  d of each run as its stretch began
    state: FloatArray  # (S + 1, C)  [rad, rad/s]  of each run at the end of its stretch
    events: Records  # (S, capacity) EVENT
    extremes: FloatArray  # (S, capacity, L, 2)  [rad/s2]  see `runs.Log`
    states: FloatArray  # (S, capacity, N)  [rad, rad/s]  at the events, or (S, 0, N)
    # scratch of a step
    seen: FloatArray  # ((G + L) OF_SEEN, W)  see clunk.core.exact.step
    series: FloatArray  # (TERMS + 1, W)  the last row is always zero
    amplitudes: FloatArray  # (C/2, W)  of the items that have been taken
    moved: FloatArray  # (2C, W)
    notes: FloatArray  # (OF_A_SEARCH, W)  values of all lanes that are then read lane by lane
    shortest: FloatArray  # (K, W)  the shortest span of each flow
    drivelines: IntArray  # (W,)  of the items that have been taken, if they are mixed
    # the parts of these drivelines' tables that are read, gathered by `functionals`: a column for each lane
    lane_watch: FloatArray  # (F B WATCHED, W)
    lane_output_origins: FloatArray  # (4 F I, W)
    lane_state_origins: FloatArray  # (4 I C, W)
    lane_table: FloatArray  # (…, W)  any other table, for as long as it is used
    held: FloatArray  # (L, 2)  the torque that locks each lash where the load jumps or bends, and its rate of change


_latest = threading.local()  # `space`: the last workspace of one driveline that a thread had


def workspace_of(systems: System, flows: Flows, loads: FloatArray, slots: int, capacity: int, states: int) -> Workspace:
    """A workspace for `slots` runs or more, none of which has begun: the last one of this thread, if that fits.

    Parameters
    ----------
    systems : System
        Of a batch of drivelines; must outlive the workspace.
    flows : Flows
        Of all drivelines, with an axis in front.
    loads : (loads, P, PIECE) float64
    capacity : events of a run, the load step included
    states : `capacity`, or 0 if no states are kept
    """
    space: Any = getattr(_latest, "space", None)
    fits = space and space.flows is flows and len(space.runs) > slots and space.events.shape[1] == capacity
    if fits and space.states.shape[1] == states:
        space.pool.length[:] = 0  # runs of a call that was stopped still wait there
        return space._replace(loads=loads)
    system, size, most = driveline_at(systems, 0), flows.basis.shape[3], systems.guards.shape[1]
    drivelines, count, functionals = flows.watch.shape[:3]
    mixed = int(drivelines > 1)
    shortest = aligned(count)
    shortest[:] = flows.span[0, :, :1]
    # queues in order: span, short and enter, each by group; search, by flow and functional; over; follow
    groups = system.leaders.size
    over = 3 * groups + count * functionals
    lashes, driven = system.lash_count, system.input_count
    inputs_at = size + rows.shift(most, lashes)
    of_a_run, searches = inputs_at + driven, lashes + most + 1
    numbers = aligned(slots + 1, whole(of_a_run))
    space = Workspace(
        system=system,
        systems=rows_of(system, systems),
        flows=flows,
        mixed=mixed,
        pool=Pool(
            # a run may have two searches in one queue: its regime may have two guards of the same functional
            waiting=np.zeros((over + 2, 2 * slots + 1), np.int64),
            length=np.zeros(over + 2, np.int64),
            work=aligned(whole(of_a_run)),
            items=np.zeros(WIDTH, np.int64),
            places=np.zeros(WIDTH, np.int64),
        ),
        queues=Queues(0, groups, 2 * groups, 3 * groups, over, over + 1),
        numbers=numbers,
        fields=numbers[:, size:],
        of_lashes=numbers[:, size + rows.of_lash(0) : size + rows.of_lash(lashes)].reshape(slots + 1, lashes, -1),
        weighed=numbers[:, inputs_at:of_a_run],
        searches=aligned((slots + 1) * searches, whole(size + rows.OF_A_SEARCH + driven)),
        searches_each=searches,
        behind=size,
        inputs_at=inputs_at,
        runs=np.zeros(slots + 1, RUN),
        courses=np.zeros((slots, lashes), COURSE),
        loads=loads,
        inputs=np.ones((slots, driven)),
        state=aligned(slots + 1, size),
        events=np.empty((slots, capacity), EVENT),
        extremes=np.empty((slots, capacity, lashes, 2)),
        states=np.empty((slots, states, system.lashes.shape[1])),
        seen=aligned((most + lashes) * OF_SEEN),
        series=aligned(TERMS + 1),
        amplitudes=aligned(size // 2),
        moved=aligned(2 * size),
        notes=aligned(rows.OF_A_SEARCH),
        shortest=shortest,
        drivelines=np.zeros(WIDTH, np.int64),
        lane_watch=aligned(flows.watch[0, 0].size * mixed),
        lane_output_origins=aligned(flows.origin_output[0, 0].size * mixed),
        lane_state_origins=aligned(flows.origin[0, 0].size * mixed),
        lane_table=aligned(size * max(size, LONG)),
        held=np.zeros((lashes, 2)),
    )
    if not mixed:
        _latest.space = space
    return space


@inlined_part
def system_at(space: Workspace, driveline: int) -> System:
    """The system of a driveline."""
    return reference_at(space.systems, driveline, space.system)


@inlined_part
def system_of(space: Workspace, slot: int) -> System:
    """The system of a run's driveline."""
    return system_at(space, space.runs[slot].driveline)


@inlined_part
def shortest_span(space: Workspace, flow: int) -> Vector:
    """The shortest span of a flow  [s]."""
    return vectors.load(space.shortest, flow)


@inlined_part
def field(space: Workspace, name: int) -> Vector:
    """Load one number of each of the items that have been taken."""
    return vectors.load(space.pool.work, space.behind + name)


@inlined_part
def set_field(space: Workspace, name: int, values: Vector) -> None:
    """Set one number of each of the items that have been taken."""
    vectors.store(space.pool.work, space.behind + name, values)


@inlined_part
def field_of(space: Workspace, name: int, lash: int) -> Vector:
    """Load one number of a lash of each of the items that have been taken."""
    return field(space, rows.of_lash(lash) + name)


@inlined_part
def log_of(space: Workspace, slot: int) -> Log:
    """The `runs.Log` of a run."""
    return Log(space.events[slot], space.extremes[slot], space.courses[slot], space.states[slot])
