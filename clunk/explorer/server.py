"""The server of the page: for this machine alone, at an address that only its user knows.

It listens on the loopback interface; every path begins with a token; a page of another origin can neither read nor
connect; and what the browser gets forbids it to load anything from elsewhere.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import socket
import threading
import webbrowser
from html import escape
from typing import Any

from clunk.explorer.subject import ExplorerError, Subject
from clunk.results.files import reason
from clunk.results.regimemap import Results

try:
    from bokeh.application import Application
    from bokeh.application.handlers.function import FunctionHandler
    from bokeh.document import Document
    from bokeh.resources import Resources
    from bokeh.server.server import BaseServer
    from bokeh.server.tornado import BokehTornado
    from bokeh.server.views.static_handler import StaticHandler
    from tornado.httpserver import HTTPServer
    from tornado.httputil import HTTPHeaders
    from tornado.ioloop import IOLoop
    from tornado.web import OutputTransform

    from clunk.explorer.page import Page
except ModuleNotFoundError as error:
    needs = f"The explorer needs Bokeh, which is not installed (no {error.name})"
    raise ExplorerError(f"{needs}: pip install 'clunk[explore]'") from error

HOST = "127.0.0.1"
_HEADERS = {
    # Bokeh's own scripts make functions of the texts of callbacks, and styles within the page
    "Content-Security-Policy": "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; object-src 'none'; "
    "base-uri 'none'; form-action 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class _Headers(OutputTransform):
    """Adds headers to every answer."""

    def transform_first_chunk(
        self, status_code: int, headers: HTTPHeaders, chunk: bytes, finishing: bool
    ) -> tuple[int, HTTPHeaders, bytes]:
        for name, value in _HEADERS.items():
            headers[name] = value
        return status_code, headers, chunk


class _Pages(BokehTornado):  # type: ignore[misc]  # untyped
    """Bokeh's application, whose scripts come from this server, whatever the environment says."""

    def resources(self, absolute_url: str | bool | None = None) -> Resources:
        """Addresses of the scripts."""
        return Resources(
            mode="server",
            root_url=self._prefix + "/",
            path_versioner=StaticHandler.append_version,
            components=["bokeh", "bokeh-widgets"],  # without those for tables, WebGL and TeX
        )


class Explorer:
    """A running explorer; a notebook shows its page in a frame.

    url : address of the page, token included

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

    def __init__(self, subject: Subject, port: int = 0) -> None:
        try:
            self._socket = socket.create_server((HOST, port))
        except OSError as error:
            raise ExplorerError(f"Port {port} of this machine cannot be used: {reason(error)}.") from error
        self._socket.setblocking(False)
        self.port = self._socket.getsockname()[1]
        token = secrets.token_urlsafe(16)
        self.url = f"http://{HOST}:{self.port}/{token}/"
        self._subject, self._token = subject, token
        self._loop: IOLoop | None = None
        self._has_started = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="clunk explorer", daemon=True)
        self._thread.start()
        self._has_started.wait()

    def _serve(self) -> None:
        asyncio.set_event_loop(asyncio.new_event_loop())
        self._loop = IOLoop.current()
        pages = _Pages(
            {"/": Application(FunctionHandler(self._open))},
            prefix=self._token,
            extra_websocket_origins=[f"{HOST}:{self.port}"],
            transforms=[_Headers],
            use_index=False,
        )
        http = HTTPServer(pages)
        http.add_socket(self._socket)
        self._server = BaseServer(self._loop, pages, http)
        self._server.start()
        self._loop.add_callback(self._has_started.set)
        self._loop.start()
        self._loop.close(all_fds=True)

    def _open(self, document: Document) -> None:
        page = Page(document, self._subject)
        document.on_session_destroyed(lambda _: page.close())

    def open_browser(self) -> None:
        """Open the page in the user's browser."""
        webbrowser.open(self.url)

    def wait(self) -> None:
        """Wait until the explorer is stopped, or by Ctrl-C."""
        while self._thread.is_alive():
            self._thread.join(0.5)  # a join without a limit would not let Ctrl-C through on Windows

    def stop(self) -> None:
        """End the server; pages that are open say so."""
        if self._thread.is_alive():
            assert self._loop is not None
            self._loop.add_callback(self._end)
            self._thread.join()

    def _end(self) -> None:
        assert self._loop is not None
        self._server.stop()
        self._loop.call_later(0.1, self._loop.stop)

    def __repr__(self) -> str:
        return f"<clunk.Explorer at {self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.url)}" width="100%" height="760" style="border: none"></iframe>'


def explore(
    results: Results, *, name: str | os.PathLike[str] = "map", port: int = 0, browser: bool | None = None
) -> Explorer:
    """Serve a page on which a map is pointed at, and the motion there is seen.

    The page is for this machine alone. In a notebook, the last line of a cell shows it below the cell; a script waits
    with `Explorer.wait`, since the explorer ends with it.

    Parameters
    ----------
    results : Results
    name : str
        With which the names of saved files begin.
    port : int
        0 for any that is free.
    browser : bool, optional
        Whether to open it in the browser; by default not in a notebook.

    Raises
    ------
    ExplorerError
        Where the port is in use, or the results have no config to run.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> explorer = clunk.explore(results, browser=False)
    >>> explorer.stop()
    """
    explorer = Explorer(Subject.of(results, name), port)
    if browser or (browser is None and not _is_notebook()):
        explorer.open_browser()
    return explorer


def _is_notebook() -> bool:
    import sys

    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return "IPKernelApp" in getattr(shell, "config", {})
