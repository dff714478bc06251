"""A thread that does the newest of many requests: older ones that wait are dropped, and a running one is stopped."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

# A function that running work calls now and then: it raises Superseded once a newer request has come. It ignores its
# arguments, so that it can be given as a progress function.
GoOn = Callable[..., None]


class Superseded(Exception):  # noqa: N818  # not an error, but a newer request
    """Raised within work that a newer request has made superfluous, to end it."""


class Newest:
    """A thread that does the newest piece of work that has been submitted to it.

    on_error : called in that thread with any exception of the work other than Superseded
    """

    def __init__(self, name: str, on_error: Callable[[Exception], None]) -> None:
        self._on_error = on_error
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"clunk {name}")
        self._requests = 0

    def submit(self, work: Callable[[GoOn], None]) -> None:
        """Queue a piece of work and supersede all earlier ones.

        Earlier work that still waits is skipped; a running piece stops at its next call of its `GoOn`.
        """
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
        """Supersede all work and end the thread, without waiting for it."""
        self._requests += 1
        self._worker.shutdown(wait=False)
