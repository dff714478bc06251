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
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from clunk.explorer.subject import ExplorerError, Subject
from clunk.results.files import reason
from clunk.results.tolerancemap import AnyMap
from clunk.sweeping.progress import in_notebook

try:
    from bokeh.settings import settings
    from tornado.httpserver import HTTPServer
    from tornado.httputil import HTTPHeaders
    from tornado.ioloop import IOLoop
    from tornado.routing import AnyMatches, PathMatches, Rule, RuleRouter
    from tornado.template import Template
    from tornado.web import Application, OutputTransform, RequestHandler, StaticFileHandler
except ModuleNotFoundError as error:
    needs = f"The explorer needs Bokeh, which is not installed (no {error.name})"
    raise ExplorerError(f"{needs}: pip install 'clunk[explore]'") from error

if TYPE_CHECKING:
    from bokeh.document import Document
    from bokeh.server.server import BaseServer

HOST = "127.0.0.1"
_SCRIPTS = ("bokeh", "bokeh-widgets")  # without those for tables, WebGL and TeX
_DRAWN = "drawn"  # last part of the address at which Bokeh answers
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
        for name in [name for name in headers if name.startswith("Access-Control")]:
            del headers[name]  # with which Bokeh would let pages of any origin read one of its scripts
        for name, value in _HEADERS.items():
            headers[name] = value
        return status_code, headers, chunk


class _Opening(RequestHandler):
    """The frame of the page: the browser has its scripts, of a megabyte, while the server imports what draws in it."""

    async def get(self) -> None:
        """Write the head, and once Bokeh answers the rest."""
        page = Template(files(__package__).joinpath("page.html").read_text("utf-8"))
        self.write(page.generate(title=self.settings["title"], scripts=_SCRIPTS))
        await self.flush()
        await asyncio.shield(self.settings["attached"])
        path = f"/{self.settings['token']}/{_DRAWN}"
        script = f"{path}/autoload.js?resources=none&bokeh-autoload-element=page&bokeh-app-path={path}"
        self.finish(f'<script src="{escape(script)}"></script></body></html>')


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
        self._token = secrets.token_urlsafe(16)
        self.url = f"http://{HOST}:{self.port}/{self._token}/"
        self._subject = subject
        self._has_started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="clunk explorer", daemon=True)
        self._thread.start()
        self._has_started.wait()

    async def _serve(self) -> None:
        self._loop, self._is_stopped = asyncio.get_running_loop(), asyncio.Event()
        router = RuleRouter([])
        http = HTTPServer(router)
        attached = asyncio.create_task(self._attach(router, http))
        options: dict[str, Any] = {"title": f"clunk: {self._subject.title}", "token": self._token, "attached": attached}
        static = (rf"/{self._token}/static/(.*)", StaticFileHandler, {"path": settings.bokehjs_path()})
        opening = Application([(rf"/{self._token}/", _Opening), static], transforms=[_Headers], **options)
        router.add_rules([Rule(PathMatches(rf"/{self._token}/(static/.*)?"), opening)])
        http.add_socket(self._socket)
        self._has_started.set()
        await self._is_stopped.wait()
        server = await attached
        server.stop()
        await asyncio.sleep(0.1)
        await http.close_all_connections()

    async def _attach(self, router: RuleRouter, http: HTTPServer) -> BaseServer:
        """Let Bokeh answer, once it is imported."""
        await asyncio.to_thread(_import_pages)
        from bokeh.application import Application as Pages
        from bokeh.application.handlers.function import FunctionHandler
        from bokeh.server.server import BaseServer
        from bokeh.server.tornado import BokehTornado

        pages = BokehTornado(
            {f"/{_DRAWN}": Pages(FunctionHandler(self._open))},
            prefix=self._token,
            extra_websocket_origins=[f"{HOST}:{self.port}"],
            transforms=[_Headers],
            use_index=False,
        )
        router.add_rules([Rule(AnyMatches(), pages)])
        server = BaseServer(IOLoop.current(), pages, http)
        server.start()
        return server

    def _open(self, document: Document) -> None:
        from clunk.explorer.page import Page

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
            self._loop.call_soon_threadsafe(self._is_stopped.set)
            self._thread.join()

    def __repr__(self) -> str:
        return f"<clunk.Explorer at {self.url}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.url)}" width="100%" height="760" style="border: none"></iframe>'


def explore(
    results: AnyMap, *, name: str | os.PathLike[str] = "map", port: int = 0, browser: bool | None = None
) -> Explorer:
    """Serve a page on which a map is pointed at, and the motion there is seen.

    The page is for this machine alone. In a notebook, the last line of a cell shows it below the cell; a script waits
    with `Explorer.wait`, since the explorer ends with it.

    Parameters
    ----------
    results : Results or ToleranceMap
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
    if browser or (browser is None and not in_notebook()):
        explorer.open_browser()
    return explorer


def _import_pages() -> None:
    """Import in a thread what takes a second, so that the server sends scripts meanwhile."""
    from importlib import import_module

    for module in ("bokeh.server.tornado", "clunk.explorer.page"):
        import_module(module)
