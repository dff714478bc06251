"""Runs that are under way, and what each of them waits for.

A run takes its next step together with others that wait for the same, as many as there are lanes: from the array of all
runs' numbers theirs are gathered, and turned, so that a row of lanes holds one number of each of them.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.exact import rows
from clunk.core.exact.flows import TERMS, Flows
from clunk.core.jit import compiled, unowned_inlined
from clunk.core.lanes import queues, vectors
from clunk.core.lanes.vectors import ROW, WIDTH, Vector
from clunk.core.regimes import CLOSED_FLOW, CLOSED_POSITIVE, GAP, System

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

ABREAST = 16 * WIDTH  # runs under way: many wait for the same, and its code is at hand for several steps on end
NOTES = 12
GOES_ON, NEARS, AT_END, SETTLED, LOST = -1, -2, -3, -4, -5  # how a step ends, if not by a guard

RUN = np.dtype(
    [
        ("tag", np.int64),  # the caller's
        ("status", np.int64),
        ("quality", np.int64),
        ("count", np.int64),  # events so far
        ("regime", np.int64),
        ("last_side", np.int64),
        ("from_sticking", np.int64),
        ("pending", np.int64),  # bits of what is to be looked for
        ("ended", np.int64),  # the guard that ended the phase, or GOES_ON, NEARS, AT_END, SETTLED, LOST
        ("measured", np.int64),  # whether its depth is known, or known to be no concern of the margin
        ("time", np.float64),  # s, when the phase began; after the end, when the run did
        ("began", np.float64),  # s, of the last contact
        ("fastest", np.float64),  # rad/s, of the touches so far
    ],
    align=True,
)
_GUARD = np.dtype(
    [
        ("functional", np.int64),
        ("sided", np.int64),  # whether the sign is to be multiplied with the side
        ("sign", np.float64),
        ("offset", np.float64),  # by φ/2
        ("of_gap", np.float64),  # its scale, by φ/2 and by what is at rest; 0: it makes no margin
        ("of_rest", np.float64),
    ],
    align=True,
)
_KIND = np.dtype(
    [
        ("flow", np.int64),
        ("guards", np.int64),  # how many end it
        ("watched", np.int64),  # and how many make a margin
        ("two", np.int64),  # whether these are two functionals
    ],
    align=True,
)


class Pool(NamedTuple):
    """Runs under way, S at most, with the work space of a thread; N states, C coordinates, W lanes."""

    numbers: FloatArray  # (S + 1, …)  of each run; the last is nobody's
    asked: FloatArray  # ((S + 1) TASKS, …)  of what each looks for
    state: FloatArray  # (S + 1, C)  [rad, rad/s]  of each at the end of its phase
    runs: npt.NDArray[np.void]  # (S + 1,) RUN
    events: npt.NDArray[np.void]  # (S, capacity) EVENT
    states: FloatArray  # (S, capacity, N), or (S, 0, N)
    waiting: IntArray  # (queues.FOLLOW + 1, S + 1)  by what they wait for: runs, or rows of `asked`
    length: IntArray  # (queues.FOLLOW + 1,)  how many
    kinds: npt.NDArray[np.void]  # (queues.KINDS,) _KIND
    guards: npt.NDArray[np.void]  # (queues.KINDS, 2) _GUARD
    work: FloatArray  # (…, W)  the runs that take a step
    series: FloatArray  # (TERMS, W)
    moved: FloatArray  # (3C, W)
    left: FloatArray  # (C, W)
    notes: FloatArray  # (NOTES, W)  for what is done for a lane alone
    who: IntArray  # (W,)  the runs, or rows of `asked`, that take a step
    places: IntArray  # (W,)  where their numbers begin
    others: IntArray  # (W,)  the same of something else
    here: FloatArray  # (3,)
    single: FloatArray  # (2, TERMS)  a series alone, and its zeros
    ladder: FloatArray  # (TERMS, TERMS)


@compiled
def make_pool(system: System, flows: Flows, events: npt.NDArray[np.void], states: FloatArray) -> Pool:
    """Room for as many runs as there are rows of events, none of which has begun.

    Parameters
    ----------
    events : (S, capacity) EVENT
    states : (S, capacity or 0, N) float64
    """
    slots, size = events.shape[0], flows.basis.shape[1]
    kinds, guards = _kinds(system)
    return Pool(
        numbers=_aligned(slots + 1, _whole(fields(size) + rows.OF_A_RUN)),
        asked=_aligned((slots + 1) * rows.TASKS, _whole(fields(size) + rows.OF_A_SEARCH)),
        state=_aligned(slots + 1, size),
        runs=np.zeros(slots + 1, RUN),
        events=events,
        states=states,
        waiting=np.zeros((queues.FOLLOW + 1, slots + 1), np.int64),
        length=np.zeros(queues.FOLLOW + 1, np.int64),
        kinds=kinds,
        guards=guards,
        work=_aligned(_whole(fields(size) + rows.OF_A_RUN), WIDTH),
        series=_aligned(TERMS, WIDTH),
        moved=_aligned(3 * size, WIDTH),
        left=_aligned(size, WIDTH),
        notes=_aligned(NOTES, WIDTH),
        who=np.zeros(WIDTH, np.int64),
        places=np.zeros(WIDTH, np.int64),
        others=np.zeros(WIDTH, np.int64),
        here=np.zeros(3),
        single=np.zeros((2, TERMS)),
        ladder=np.zeros((TERMS, TERMS)),
    )


@compiled
def _kinds(system: System) -> tuple[npt.NDArray[np.void], npt.NDArray[np.void]]:
    """The kinds of regimes and their guards, as `Pool` has them."""
    kinds, guards = np.zeros(queues.KINDS, _KIND), np.zeros((queues.KINDS, 2), _GUARD)
    by_force = separates_by_force(system)
    for kind in range(queues.KINDS):
        regime = max(2 * kind - 1, 0)  # of those that are alike, the one on the positive side
        own = system.regimes[regime]
        kinds[kind].flow, kinds[kind].guards, kinds[kind].watched = own.flow, own.guards, own.guards
        for k in range(2):
            row, guard = system.guards[regime, min(k, own.guards - 1)], guards[kind, k]  # a single one stands for two
            guard.functional, guard.sign, guard.offset, guard.sided = (
                row.functional,
                row.sign,
                row.offset,
                own.side != 0,
            )
            guard.of_gap, guard.of_rest = (0.0, 1.0) if own.flow == CLOSED_FLOW else (2.0, 0.0)
        if by_force and own.side != 0:
            # the flanks may press less than nothing on each other; a miss is near where they all but cease to overlap
            force, overlap = (0, 1) if own.flow == CLOSED_FLOW else (1, 0)
            if own.flow == CLOSED_FLOW:
                guards[kind, 1].functional, guards[kind, 1].sign, guards[kind, 1].offset = GAP, 1.0, -1.0
            guards[kind, force].of_gap, guards[kind, force].of_rest = 0.0, 0.0
            guards[kind, overlap].of_gap, guards[kind, overlap].of_rest = 0.0, 1.0
            kinds[kind].watched = 2
        kinds[kind].two = guards[kind, 0].functional != guards[kind, 1].functional
    return kinds, guards


@unowned_inlined
def separates_by_force(system: System) -> bool:
    """Whether a contact ends where its force does, and not where the flanks cease to overlap."""
    return bool(system.impulsive == 0 and system.guards[CLOSED_POSITIVE, 0].functional != GAP)


@unowned_inlined
def fields(size: int) -> int:
    """Where the numbers behind coordinates and amplitudes begin."""
    return size * 3 // 2


@compiled
def _whole(count: int) -> int:
    """So many numbers, filled up to what `gather` takes at a time."""
    return -(-count // ROW) * ROW


@compiled
def _aligned(count: int, columns: int) -> FloatArray:
    """Zeros that begin where a register's worth of memory does."""
    flat = np.zeros(count * columns + ROW)
    first = -(flat.ctypes.data >> 3) & (ROW - 1)
    return flat[first : first + count * columns].reshape(count, columns)


@unowned_inlined
def scale_of(pool: Pool, kind: int, g: int, half_gap: float, static: float) -> float:
    """What a guard's margin is relative to."""
    guard = pool.guards[kind, g]
    return float(half_gap * guard.of_gap + static * guard.of_rest)


@unowned_inlined
def push(pool: Pool, queue: int, who: int) -> None:
    """Let one wait."""
    length = pool.length[queue]
    pool.waiting[queue, length] = who
    pool.length[queue] = length + 1


@unowned_inlined
def push_all(pool: Pool, queue: int, bits: int) -> None:
    """Let some of those wait that take a step now."""
    pool.length[queue] = vectors.append(pool.waiting[queue], pool.length[queue], pool.who, bits)


@unowned_inlined
def take(pool: Pool, queue: int, array: FloatArray) -> int:
    """Let as many as there are lanes, or as there are, take a step: gather their numbers; return how many."""
    count, length, nobody = min(pool.length[queue], WIDTH), array.shape[1], array.shape[0] - 1
    first = pool.length[queue] - count
    pool.length[queue] = first
    for k in range(WIDTH):
        who = pool.waiting[queue, first + k] if k < count else nobody
        pool.places[k], pool.who[k] = who * length, who
    for row in range(0, length, ROW):
        vectors.gather(array, pool.places, row, pool.work, row)
    return int(count)


@unowned_inlined
def put_back(pool: Pool, array: FloatArray, count: int, bits: int) -> None:
    """The first `count` numbers of some of those that take a step."""
    nowhere = (array.shape[0] - 1) * array.shape[1]
    for lane in range(WIDTH):
        pool.places[lane] = pool.places[lane] if (bits >> lane) & 1 else nowhere
    for row in range(0, count, ROW):
        vectors.scatter(pool.work, row, array, pool.places, row)


@unowned_inlined
def row_of(pool: Pool, row: int) -> Vector:
    """One number of each of those that take a step."""
    return vectors.load(pool.work, row)


@unowned_inlined
def gather_spans(pool: Pool, propagator: FloatArray, size: int) -> None:
    """The propagators of the spans whose numbers are in the first of the notes."""
    for lane in range(WIDTH):
        pool.others[lane] = int(max(vectors.number(pool.notes, lane), 0.0)) * 3 * size
    for row in range(0, 3 * size, ROW):
        vectors.gather(propagator, pool.others, row, pool.moved, row)


@unowned_inlined
def ask(pool: Pool, slot: int, task: int, size: int, rest: float, sign: float, shift: float) -> None:
    """Begin to look for something, for a time `rest` from where a run is, in sign times a functional plus shift.

    The functional's origin is `pool.here`.
    """
    asked, row, field = pool.asked, slot * rows.TASKS + task, fields(size)
    for k in range(field):
        asked[row, k] = pool.numbers[slot, k]
    asked[row, field + rows.REST], asked[row, field + rows.SIGN], asked[row, field + rows.SHIFT] = rest, sign, shift
    asked[row, field + rows.AT], asked[row, field + rows.AT_SLOPE] = pool.here[0], pool.here[1]
    asked[row, field + rows.AT_CURVATURE], asked[row, field + rows.COUNTS] = pool.here[2], np.inf


@unowned_inlined
def find_origin(pool: Pool, flows: Flows, flow: int, f: int, torque: float, gap_input: float, elapsed: float) -> None:
    """Value, slope and curvature of a functional's origin after a time, into `pool.here`."""
    output, here = flows.origin_output[flow], pool.here
    value = output[0, f, 0] * torque + output[0, f, 1] * gap_input
    slope = output[1, f, 0] * torque + output[1, f, 1] * gap_input
    curvature = output[2, f, 0] * torque + output[2, f, 1] * gap_input
    here[0], here[1], here[2] = (
        value + elapsed * (slope + 0.5 * elapsed * curvature),
        slope + elapsed * curvature,
        curvature,
    )
