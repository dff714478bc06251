"""Events that make boundaries: what differs between the events of two runs on either side of a curve, 1e-9 apart."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from clunk.analysis.network import Path
from clunk.analysis.pointruns import Events, PointRuns
from clunk.core.events import STAGE, TOUCH
from clunk.core.status import Status
from clunk.results.boundaries import (
    END_TIME,
    INITIAL_FLANK,
    OPPOSITE_FLANK,
    STICKING_ENDS,
    STICKING_TIME,
    UNKNOWN,
)
from clunk.study.arrays import Codes, Floats, Records

_MOST_CURVES = 500  # whose events are looked for, the largest ones
_AT_END = 1e-6  # of the end time
_SAME_TIME = 1e-6  # likewise: runs 1e-9 apart are alike until an event that only one of them has


def split_by_event(
    runs: PointRuns, paths: Sequence[Path], crossings: Callable[[Codes], tuple[Floats, Floats]]
) -> Iterator[tuple[Path, Floats, int]]:
    """Yield the parts of curves with one event each: the curve, the part's vertices and its event.

    The event is decided at each curve's first, middle and last crossing; between two that differ, where it changes.
    It is unknown of all but the largest curves, where there are more than `_MOST_CURVES`.

    crossings : the points on either side of nodes, (n, axes) each in the axes' units
    """
    known: dict[int, int] = {}
    sizes = np.array([np.ptp(path.vertices, axis=0).max() for path in paths])
    asked = np.sort(np.argsort(-sizes, kind="stable")[:_MOST_CURVES]).tolist()
    numbers = [[k for k, node in enumerate(path.nodes) if node >= 0] for path in paths]

    def learn(places: list[tuple[int, int]]) -> None:
        new = np.array(sorted({node_at(*place) for place in places} - known.keys()), np.int64)
        known.update(zip(new.tolist(), events_between(runs, *crossings(new)).tolist(), strict=True))

    def node_at(path: int, number: int) -> int:
        return paths[path].nodes[numbers[path][number]]

    def event_at(path: int, number: int) -> int:
        return known[node_at(path, number)]

    marks = {k: sorted({0, (len(numbers[k]) - 1) // 2, len(numbers[k]) - 1}) for k in asked}
    learn([(k, mark) for k, each in marks.items() for mark in each])
    spans = [(k, low, high) for k, each in marks.items() for low, high in pairwise(each)]
    changes = [span for span in spans if event_at(*span[:2]) != event_at(span[0], span[2])]
    while any(high - low > 1 for _, low, high in changes):
        learn([(k, (low + high) // 2) for k, low, high in changes])
        for n, (k, low, high) in enumerate(changes):
            if high - low > 1:
                middle = (low + high) // 2
                is_like_low = event_at(k, middle) == event_at(k, low)
                changes[n] = (k, middle, high) if is_like_low else (k, low, middle)
    for k, path in enumerate(paths):
        begin = 0
        for _, low, high in (change for change in changes if change[0] == k):
            stop = path.at[numbers[k][high]]
            yield path, path.vertices[begin : stop + 1], event_at(k, low)
            begin = stop
        yield path, path.vertices[begin:], event_at(k, len(numbers[k]) - 1) if k in marks else UNKNOWN


def events_between(runs: PointRuns, one: Floats, other: Floats) -> Codes:
    """First event that only one run of each pair of points has, which makes their labels differ: (n,) of `EVENTS`.

    A touch is a grazing of its flank, another event is where a contact that held ended. With the same events, a contact
    has held for the sticking time in one run only.

    one, other : the points, (n, axes)
    """
    parts = [_differences(*part, runs.study.solver.end_time, runs.lash) for part in runs.pairs(one, other)]
    return np.concatenate([np.zeros(0, np.int64), *parts])


def _differences(records: Records, logs: Events, end_time: float, lash: int) -> Codes:
    """First event of a lash that only one of two runs has, from their CELL (n, 2) and EVENT (n, 2, events)."""
    sides = np.where(records["status"] == Status.OK, records["initial_side"], 0)
    # neither a change of a shaft's stage nor an event of another lash makes a label
    times = np.where((logs["kind"] == STAGE) | ((logs["lash"] >= 0) & (logs["lash"] != lash)), np.nan, logs["time"])
    order = np.argsort(np.isnan(times), axis=2, kind="stable")
    logs, times = np.take_along_axis(logs, order, 2), np.take_along_axis(times, order, 2)
    is_event = ~np.isnan(times)
    differ = np.abs(times[:, 0] - times[:, 1]) > _SAME_TIME * end_time
    for name in ("kind", "side"):
        differ |= logs[name][:, 0] != logs[name][:, 1]
    differ |= ~is_event.all(axis=1)  # behind the last event of one
    first = np.argmax(differ, axis=1)
    times = np.where(is_event, times, np.inf)[np.arange(len(logs)), :, first]
    events = logs[np.arange(len(logs)), np.argmin(times, axis=1), first]
    return np.select(
        [
            (sides[:, 0] == 0) | (sides[:, 0] != sides[:, 1]),
            ~differ.any(axis=1) | ~np.isfinite(times).any(axis=1),
            times.min(axis=1) > (1.0 - _AT_END) * end_time,
            events["kind"] != TOUCH,
            events["side"] == sides[:, 0],
        ],
        [UNKNOWN, STICKING_TIME, END_TIME, STICKING_ENDS, INITIAL_FLANK],
        OPPOSITE_FLANK,
    )
