"""Searches that run points side by side: what each of them waits for is run in one batch."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from clunk.analysis.brackets import Floats
from clunk.analysis.pointruns import Runs

Run = Callable[[Floats], Runs]  # of points (n, 2), on each axis from 0 to 1


def side_by_side(run: Run, *searches: Callable[[Run], Any]) -> list[Any]:
    """Do searches at the same time, each in a thread of its own, and return their results.

    They get a function in the place of `run`. It waits until all searches that are not over yet have called it, and
    runs their points together, in the order of the searches, so that all is as if they had been done alone.
    """
    shared = _Batches(run, len(searches))

    def search(number: int) -> Any:
        try:
            return searches[number](functools.partial(shared.run, number))
        finally:
            shared.leave()

    with ThreadPoolExecutor(len(searches)) as threads:
        return [*threads.map(search, range(len(searches)))]


class _Batches:
    """Points that searches wait for, by the number of the search."""

    def __init__(self, run: Run, searches: int) -> None:
        self._run, self._searches = run, searches
        self._waiting: dict[int, tuple[Floats, Future[Runs]]] = {}
        self._turn = threading.Lock()

    def run(self, number: int, places: Floats) -> Runs:
        """Run points of a search."""
        runs: Future[Runs] = Future()
        with self._turn:
            self._waiting[number] = places, runs
            self._run_all()
        return runs.result()

    def leave(self) -> None:
        """End a search."""
        with self._turn:
            self._searches -= 1
            self._run_all()

    def _run_all(self) -> None:
        """Run all points, if no search is still to call."""
        if len(self._waiting) < self._searches or not self._waiting:
            return
        waiting = [self._waiting.pop(number) for number in sorted(self._waiting)]
        every = [places for places, _ in waiting]
        try:
            parts = np.split(self._run(np.concatenate(every)), np.cumsum([len(places) for places in every])[:-1])
        except BaseException as error:
            for _, runs in waiting:
                runs.set_exception(error)
            return
        for part, (_, runs) in zip(parts, waiting, strict=True):
            runs.set_result(part)
