"""Deferral of signals while a lock is held that an exception would leave locked.

Python runs the handler of a signal between any two steps of the main thread. A handler that raises, as that of SIGINT
does, can interrupt `concurrent.futures` where it has locked something and not yet noted that it has to unlock it; its
threads then wait for ever, and so does who waits for them.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

_DEFERRED = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def deferred_signals() -> Iterator[None]:
    """Context that defers the handlers of SIGINT and SIGTERM to its end."""
    handlers: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # the only one that runs handlers, and that may set them
        handlers = {number: handler for number in _DEFERRED if callable(handler := signal.getsignal(number))}
    arrived: list[int] = []
    try:
        for number in handlers:
            signal.signal(number, lambda number, _frame: arrived.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in arrived[:1]:
            handlers[number](number, None)


class Threads(ThreadPoolExecutor):
    """Thread pool in which a signal leaves no lock held."""

    def submit(self, *arguments: Any, **options: Any) -> Future[Any]:
        """Submit a task as `ThreadPoolExecutor` does; a signal waits until the task is in the queue."""
        with deferred_signals():
            return super().submit(*arguments, **options)
