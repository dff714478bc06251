"""A thread for the newest of many requests: older ones that wait are dropped, and one that runs is told to stop."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Superseded(Exception):  # noqa: N818  # no error: a newer request has come
    """Raised within work that a newer request has made superfluous."""


class Request:
    """A piece of work that may be superseded while it runs."""

    def __init__(self) -> None:
        self._is_superseded = threading.Event()

    @property
    def is_superseded(self) -> bool:
        """Whether a newer request has come."""
        return self._is_superseded.is_set()

    def supersede(self) -> None:
        """Tell the work to stop."""
        self._is_superseded.set()

    def go_on(self, *_: object) -> None:
        """Raise Superseded where the work is no longer wanted; takes what progress functions are called with."""
        if self.is_superseded:
            raise Superseded


Work = Callable[[Request], None]


class Newest:
    """A thread that does the newest piece of work it has been handed.

    on_error : called, in the thread, with an exception that the work raised
    """

    def __init__(self, name: str, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._changed = threading.Condition()
        self._waiting: tuple[Request, Work] | None = None
        self._running: Request | None = None
        self._is_closed = False
        threading.Thread(target=self._loop, name=f"clunk {name}", daemon=True).start()

    def submit(self, work: Work) -> None:
        """Replace what waits and supersede what runs."""
        with self._changed:
            if self._running is not None:
                self._running.supersede()
            self._waiting = Request(), work
            self._changed.notify_all()

    def wait(self, seconds: float) -> None:
        """Wait until there is nothing to do, for so long at most."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is None and self._running is None, seconds)

    def close(self) -> None:
        """Stop what runs and end the thread."""
        with self._changed:
            if self._running is not None:
                self._running.supersede()
            self._waiting, self._is_closed = None, True
            self._changed.notify_all()

    def _loop(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting is not None or self._is_closed)
                if self._waiting is None:
                    return
                (request, work), self._waiting = self._waiting, None
                self._running = request
            try:
                work(request)
            except Superseded:
                pass
            except Exception as error:
                self._on_error(error)
            finally:
                with self._changed:
                    self._running = None
                    self._changed.notify_all()
