"""A thread for the newest of many requests: older ones that wait are dropped, and one that runs is told to stop."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

GoOn = Callable[..., None]  # raises Superseded where a newer request has come; takes what progress is told


class Superseded(Exception):  # noqa: N818  # no error: a newer request has come
    """Raised within work that a newer request has made superfluous."""


class Newest:
    """A thread that does the newest piece of work it has been handed.

    on_error : called, in the thread, with an exception that the work raised
    """

    def __init__(self, name: str, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"clunk {name}")
        self._requests = 0

    def submit(self, work: Callable[[GoOn], None]) -> None:
        """Do this work, and none that was submitted before."""
        self._requests += 1
        number = self._requests

        def go_on(*_: object) -> None:
            if number != self._requests:
                raise Superseded

        def attempt() -> None:
            try:
                go_on()
                work(go_on)
            except Superseded:
                pass
            except Exception as error:
                self._on_error(error)

        self._worker.submit(attempt)

    def close(self) -> None:
        """Stop what runs and end the thread."""
        self._requests += 1
        self._worker.shutdown(wait=False)
