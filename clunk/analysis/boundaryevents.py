"""Events that make boundaries: what differs between the events of two runs on either side of a curve, 1e-9 apart."""

from __future__ import annotations

import numpy as np

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
from clunk.sweeping.runner import Runner

_AT_ONCE = 200  # pairs of runs whose events are kept at a time
_AT_END = 1e-6  # of the end time
_SAME_TIME = 1e-6  # likewise: runs 1e-9 apart are alike until an event that only one of them has


def events_between(runner: Runner, lash: int, one: Floats, other: Floats) -> Codes:
    """First event that only one run of each pair of points has, which makes their labels differ: (n,) of `EVENTS`.

    A touch is a grazing of its flank, another event is where a contact that held ended. With the same events, a contact
    has held for the sticking time in one run only.

    lash : position of the one whose labels differ
    one, other : the points, (n, keys of the runner)
    """
    events = [np.zeros(0, np.int64)]
    for begin in range(0, len(one), _AT_ONCE):
        points = np.stack([part[begin : begin + _AT_ONCE] for part in (one, other)], axis=1).reshape(-1, one.shape[1])
        records, logs = runner.grid.logged(dict(zip(runner.keys, points.T, strict=True)), len(points))
        pairs = records[:, lash].reshape(-1, 2), logs.reshape(len(points) // 2, 2, -1)
        events.append(_differences(*pairs, runner.study.solver.end_time, lash))
    return np.concatenate(events)


def _differences(records: Records, logs: Records, end_time: float, lash: int) -> Codes:
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
