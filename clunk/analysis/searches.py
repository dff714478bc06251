"""Searches side by side: the points that all of them wait for are run in one batch."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, TypeVar

import numpy as np

from clunk.analysis.pointruns import Runs
from clunk.study.arrays import Floats

TOUCHES_OF_A_RUN = 50  # for so many more touches a run counts as one more run

_Result = TypeVar("_Result")
Run = Callable[[Floats], Runs]  # of points (n, 2), on each axis from 0 to 1
Search = Generator[Floats, Runs, _Result]  # yields points to run, is sent their runs, and returns its result


def side_by_side(run: Run, *searches: Search[Any]) -> list[Any]:
    """Do searches and return their results, in order. What they wait for is run together, until all are over."""
    waiting: dict[int, Floats] = {}
    results: list[Any] = [None] * len(searches)

    def go_on(number: int, runs: Runs | None) -> None:
        try:
            waiting[number] = searches[number].send(runs)  # type: ignore[arg-type]  # None begins a generator
        except StopIteration as end:
            waiting.pop(number, None)
            results[number] = end.value

    for number in range(len(searches)):
        go_on(number, None)
    while waiting:
        ends = np.cumsum([len(places) for places in waiting.values()])
        parts = np.split(run(np.concatenate([*waiting.values()])), ends[:-1])
        for number, part in zip([*waiting], parts, strict=True):
            go_on(number, part)
    return results
