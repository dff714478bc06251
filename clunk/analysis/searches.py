"""Searches that run points side by side: what all of them wait for is run in one batch."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Any

import numpy as np

from clunk.analysis.brackets import Floats
from clunk.analysis.pointruns import Runs
from clunk.sweeping.signals import Threads, deferred_signals

Run = Callable[[Floats], Runs]  # of points (n, 2), on each axis from 0 to 1
_Requests = SimpleQueue[
    tuple[int, Floats, "Future[Runs] | None"]
]  # of a search, by number; at its end without a future


def side_by_side(run: Run, *searches: Callable[[Run], Any]) -> list[Any]:
    """Do searches at the same time, each in a thread of its own, and return their results.

    A search gets a function in the place of `run`, which waits until all searches that are not over have called theirs.
    This thread then runs all points together, in the order of the searches. What it raises, they raise.
    """
    requests: _Requests = SimpleQueue()

    def search(number: int) -> Any:
        def run_later(places: Floats) -> Runs:
            answer: Future[Runs] = Future()
            requests.put((number, places, answer))
            return answer.result()

        try:
            return searches[number](run_later)
        finally:
            requests.put((number, np.zeros((0, 2)), None))

    with Threads(len(searches)) as threads:
        results = [threads.submit(search, number) for number in range(len(searches))]
        _answer(run, requests, len(searches))
    return [result.result() for result in results]


def _answer(run: Run, requests: _Requests, searches: int) -> None:
    """Run what so many searches wait for, until all are over."""
    waiting: dict[int, tuple[Floats, Future[Runs]]] = {}
    failure: BaseException | None = None
    while searches:
        try:
            with deferred_signals():
                number, places, answer = requests.get()
                if answer is None:
                    searches -= 1
                else:
                    waiting[number] = places, answer
            if failure is None and waiting and len(waiting) == searches:
                numbers = sorted(waiting)
                every = [waiting[number][0] for number in numbers]
                parts = np.split(run(np.concatenate(every)), np.cumsum([len(places) for places in every])[:-1])
                with deferred_signals():
                    for number, part in zip(numbers, parts, strict=True):
                        waiting.pop(number)[1].set_result(part)
        except BaseException as error:  # an interrupt, too, ends the searches first
            failure = error
        if failure is not None:
            with deferred_signals():
                while waiting:
                    waiting.popitem()[1][1].set_exception(failure)
    if failure is not None:
        raise failure
