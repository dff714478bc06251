"""Events that make boundaries: what differs between the events of two runs on either side of a curve, 1e-9 apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from clunk.analysis.brackets import Floats
from clunk.analysis.network import Path
from clunk.analysis.pointruns import PointRuns
from clunk.core import tile
from clunk.core.events import EVENT, STAGE, TOUCH
from clunk.core.runs import Log, Start
from clunk.core.status import Status
from clunk.core.tables import HALF_GAP
from clunk.results.boundaries import (
    END_TIME,
    INITIAL_FLANK,
    OPPOSITE_FLANK,
    STICKING_ENDS,
    STICKING_TIME,
    UNKNOWN,
)
from clunk.simulation.phases import preload

Events = npt.NDArray[np.void]  # EVENT
Crossing = tuple[Floats, Floats]  # the points on either side, (axes,) each in the axes' units

_AT_END = 1e-6  # of the end time
_SAME_TIME = 1e-6  # likewise: runs 1e-9 apart are alike until an event that only one of them has


def split_by_event(
    runs: PointRuns, path: Path, crossing: Callable[[int], Crossing | None]
) -> Iterator[tuple[Path, Floats, int]]:
    """Yield the parts of a curve with one event each: the curve, the part's vertices and its event.

    The event is decided at the curve's first, middle and last crossing; between two that differ, where it changes.

    crossing : ends of the bracket of a node, None for a triple point
    """
    numbers = [k for k, node in enumerate(path.nodes) if node >= 0]
    known: dict[int, int] = {}

    def event_at(k: int) -> int:
        if k not in known:
            ends = crossing(path.nodes[numbers[k]])
            assert ends is not None
            known[k] = event_between(runs, *ends)
        return known[k]

    last = len(numbers) - 1
    begin, marks = 0, sorted({0, last // 2, last})
    for pair in pairwise(marks):
        low, high = pair
        while high - low > 1 and event_at(low) != event_at(high):
            middle = (low + high) // 2
            low, high = (middle, high) if event_at(middle) == event_at(low) else (low, middle)
        if event_at(low) != event_at(high):
            stop = path.at[numbers[high]]
            yield path, path.vertices[begin : stop + 1], event_at(low)
            begin = stop
    yield path, path.vertices[begin:], event_at(last)


def event_between(runs: PointRuns, one: Floats, other: Floats) -> int:
    """What makes the labels of two points differ: the first event that only one of the runs has.

    A touch is a grazing of its flank, another one is where a contact that held ended. With the same events, a contact
    has held for the sticking time in one run only.
    """
    sides, events = zip(*(_events_at(runs, point) for point in (one, other)), strict=True)
    if sides[0] == 0 or sides[0] != sides[1]:
        return UNKNOWN
    count = min(map(len, events))
    first, second = (each[:count] for each in events)
    apart = np.abs(first["time"] - second["time"]) > _SAME_TIME * runs.study.solver.end_time
    differing = np.flatnonzero(apart | (first["kind"] != second["kind"]) | (first["side"] != second["side"]))
    at = int(differing[0]) if differing.size else count
    candidates = [each[at] for each in events if len(each) > at]
    if not candidates:
        return STICKING_TIME
    event = min(candidates, key=lambda each: each["time"])
    if event["time"] > (1.0 - _AT_END) * runs.study.solver.end_time:
        return END_TIME
    if event["kind"] != TOUCH:
        return STICKING_ENDS
    return INITIAL_FLANK if event["side"] == sides[0] else OPPOSITE_FLANK


def _events_at(runs: PointRuns, point: Floats) -> tuple[int, Events]:
    """The initial side, 0 where the run fails, and the events of a run at a point."""
    grid = runs.grid(point[None])
    values = grid.design.at(np.zeros(1, np.int64))
    cases = grid.cases(values, 1)
    ((structural, _),) = grid.groups(np.zeros(1, np.int64))
    system, tables = grid.systems.prepared(structural)
    rest = preload(system, cases.before[0])
    capacity = runs.study.solver.max_events + 1
    log = Log(np.zeros(capacity, EVENT), np.zeros((capacity, system.lash.size)))
    if system.status != Status.OK or rest.status != Status.OK:
        return 0, log.events[:0]
    start = Start(rest.x, rest.regime, cases.before[0, HALF_GAP], cases.loads, 0)
    outcome = tile.run(system, tables, start, log, np.zeros(1, np.uint8))
    events = log.events[: outcome.written]
    return rest.side if outcome.status == Status.OK else 0, events[events["kind"] != STAGE]
