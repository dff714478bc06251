"""A thread for the newest of many requests: older ones that wait are dropped, and one that runs is told to stop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait


class Superseded(Exception):  # noqa: N818  # no error: a newer request has come
    """Raised within work that a newer request has made superfluous."""


class Request:
    """A piece of work that may be superseded while it runs."""

    def __init__(self) -> None:
        self._is_superseded = threading.Event()
        self.supersede = self._is_superseded.set

    def go_on(self, *_: object) -> None:
        """Raise Superseded where the work is no longer wanted; takes what progress functions are called with."""
        if self._is_superseded.is_set():
            raise Superseded


class Newest:
    """A thread that does the newest piece of work it has been handed.

    on_error : called, in the thread, with an exception that the work raised
    """

    def __init__(self, name: str, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"clunk {name}")
        self._newest = Request()
        self._submitted: Future[None] | None = None

    def submit(self, work: Callable[[Request], None]) -> None:
        """Do this work, and none that was submitted before."""
        self._newest.supersede()
        self._newest = request = Request()
        self._submitted = self._worker.submit(self._attempt, work, request)

    def wait(self, seconds: float) -> None:
        """Wait until the newest work is done, for so long at most."""
        if self._submitted is not None:
            wait([self._submitted], seconds)

    def close(self) -> None:
        """Stop what runs and end the thread."""
        self._newest.supersede()
        self._worker.shutdown(wait=False)

    def _attempt(self, work: Callable[[Request], None], request: Request) -> None:
        try:
            request.go_on()
            work(request)
        except Superseded:
            pass
        except Exception as error:
            self._on_error(error)
