"""Server of the explorer's page, for this machine alone, at an address that only its user knows.

The server listens on the loopback interface, and every path begins with a secret token. A page of another origin can
neither read its answers nor connect to it. The answers' headers forbid the browser to load anything from elsewhere.
"""

import asyncio
import os
import secrets
import socket
import threading
import webbrowser
from html import escape
from weakref import WeakSet

from clunk.explorer.subject import Subject
from clunk.results.files import reason
from clunk.results.maps import AnyMap
from clunk.study.errors import ClunkError
from clunk.sweeping.progress import in_notebook

try:
    from bokeh.application import Application
    from bokeh.application.handlers.function import FunctionHandler
    from bokeh.document import Document
    from bokeh.server.server import BaseServer
    from bokeh.server.tornado import BokehTornado
    from tornado.httpserver import HTTPServer
    from tornado.httputil import HTTPHeaders
    from tornado.ioloop import IOLoop
    from tornado.web import OutputTransform

    from clunk.explorer.workbench import Workbench
except ModuleNotFoundError as error:
    needs = f"The explorer needs Bokeh, which is not installed (no {error.name})"
    raise ClunkError(f"{needs}: pip install 'clunk[explore]'") from error

HOST = "127.0.0.1"
_HEADERS = {
    # Bokeh's scripts compile functions from the texts of callbacks ('unsafe-eval') and make styles in the page
    "Content-Security-Policy": "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; object-src 'none'; "
    "base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class _Headers(OutputTransform):
    """Transform of every answer that adds `_HEADERS` and removes the headers that open an answer to other origins."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        for name in [name for name in headers if name.startswith("Access-Control")]:
            del headers[name]  # Bokeh sets them so that pages of any origin may read one of its scripts
        headers.update(_HEADERS)
        return status_code, headers, chunk


class Explorer:
    """A running explorer: its server in a thread; a notebook shows its page in a frame.

    url : address of the page, token included
    port : of this machine, on which the server listens

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> explorer = clunk.explore(results, browser=False)
    >>> explorer.url.startswith("http://127.0.0.1:")
    True
    >>> explorer.stop()
    """

    url: str

    def __init__(self, subject: Subject, port: int) -> None:
        try:
            self._socket = socket.create_server((HOST, port))
        except OSError as error:
            raise ClunkError(f"Port {port} of this machine cannot be used: {reason(error)}.") from error
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        self._token = secrets.token_urlsafe(16)
        self.url = f"http://{HOST}:{self.port}/{self._token}/"
        self._subject = subject
        self._workbenches = WeakSet[Workbench]()
        self._has_started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        self._has_started.wait()

    async def _serve(self) -> None:
        self._loop, self._is_stopped = asyncio.get_running_loop(), asyncio.Event()
        pages = BokehTornado(
            {"/": Application(FunctionHandler(self._open))},
            prefix=self._token,
            extra_websocket_origins=[f"{HOST}:{self.port}"],
            transforms=[_Headers],
        )
        http = HTTPServer(pages)
        http.add_socket(self._socket)
        server = BaseServer(IOLoop.current(), pages, http)
        server.start()
        self._has_started.set()
        await self._is_stopped.wait()
        server.stop()
        for workbench in self._workbenches:
            workbench.close()
        await asyncio.sleep(0.1)
        await http.close_all_connections()

    def _open(self, document: Document) -> None:
        document.title = f"clunk: {self._subject.title}"
        arguments = document.session_context.request.arguments.items()
        link = {name: values[-1].decode("utf-8", "replace") for name, values in arguments}
        workbench = Workbench(document, self._subject, link)
        self._workbenches.add(workbench)
        document.on_session_destroyed(lambda _: workbench.close())

    def open_browser(self) -> None:
        """Open the page in the user's browser."""
        webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait until the explorer is stopped; Ctrl-C ends the wait with KeyboardInterrupt."""
        while self._thread.is_alive():
            self._thread.join(0.5)  # on Windows, Ctrl-C would not interrupt a join without a limit

    def stop(self) -> None:
        """End the server and its thread; open pages then say that the explorer has ended."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._is_stopped.set)
            self._thread.join()

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.url)}" width="100%" height="760" style="border: none"></iframe>'


def explore(
    results: AnyMap, *, name: str | os.PathLike[str] = "map", port: int = 0, browser: bool | None = None
) -> Explorer:
    """Serve a page that shows a map, and the motion in the cell under the pointer.

    The page is for this machine alone. In a notebook, an explorer in the last line of a cell is shown below the cell.
    A script has to wait with `Explorer.wait`, since the explorer ends when the script does.

    Parameters
    ----------
    results : Results or ToleranceMap
    name : str
        The names of files saved on the page begin with it.
    port : int
        Port of this machine to listen on; 0 for any that is free.
    browser : bool, optional
        Whether to open the page in the browser; by default everywhere but in a notebook.

    Raises
    ------
    ClunkError
        Where the port is in use, or the results have no config to run.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> explorer = clunk.explore(results, browser=False)
    >>> explorer.stop()
    """
    explorer = Explorer(Subject(results, name), port)
    if browser or (browser is None and not in_notebook()):
        explorer.open_browser()
    return explorer
