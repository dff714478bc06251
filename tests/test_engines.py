"""Engines: work that grows while it is done, and any executor as an engine."""

import faulthandler
import gc
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from test_sweeping import equal, figure_3_4

from clunk.sweeping import engines
from clunk.sweeping.engines import Threads, run_tiles
from clunk.sweeping.sweep import Job, sweep


class OneAtATime(Executor):
    """The least that an engine may be."""

    def submit(self, function, /, *arguments):
        future = Future()
        future.set_result(function(*arguments))
        return future


@pytest.mark.parametrize("engine", [OneAtATime(), pytest.param("processes", marks=pytest.mark.slow)])
def test_any_executor_is_an_engine(engine):
    study = figure_3_4(9, step=2e-4)
    with ProcessPoolExecutor(2, get_context("spawn")) if engine == "processes" else engine as executor:
        assert equal(Job(study).run(executor), sweep(study))


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="timers are POSIX")
def test_an_interrupt_at_any_moment_leaves_no_thread_waiting(monkeypatch):
    """A lock that one leaves locked blocks a thread for ever, and closing the engine waits for that thread.

    Where nothing defers them, one of some hundred interrupts does. Here the signal is that of a timer. No garbage is
    collected: Python drops what is raised while it is.
    """

    class Nothing:
        tile_cells = few_cells = 4
        pace = (1.0,)  # s a cell: worth threads

        def ordered(self, cells):
            return cells

        def run(self, cells, stop):
            return cells

    class Interrupt(BaseException):
        pass

    def interrupt(_number, _frame):
        raise Interrupt

    def tiles_until_interrupted(seconds):
        with Threads(2) as engine:
            signal.setitimer(signal.ITIMER_REAL, seconds)
            for _ in run_tiles(Nothing(), np.arange(1_000_000), engine):
                pass

    monkeypatch.setattr(engines, "_DEFERRED", (signal.SIGALRM,))
    faulthandler.dump_traceback_later(60, exit=True)
    previous = signal.signal(signal.SIGALRM, interrupt)
    gc.disable()
    try:
        for seconds in np.random.default_rng(1).uniform(0.0005, 0.003, 300):
            with pytest.raises(Interrupt):
                tiles_until_interrupted(seconds)
    finally:
        gc.enable()
        signal.signal(signal.SIGALRM, previous)
        faulthandler.cancel_dump_traceback_later()
