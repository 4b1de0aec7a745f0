"""The web server of the page: the application, and the threads in which it and the page's content live."""

from __future__ import annotations

import asyncio
import errno
import os
import re
import secrets
import socket
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol, final

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.routing import BaseRoute, Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket

from gridslam.errors import OutputError
from gridslam.live.access import is_authorized, is_foreign
from gridslam.live.edits import EditsFile, make_edit_route
from gridslam.live.options import LiveOptions
from gridslam.live.viewing import Viewer, ViewerLine, serve_viewer

_BAD_TOKEN = 4401  # close codes of the socket
_TOO_MANY = 4429
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[\w.-]*)(?::\d{1,5})?", re.ASCII)
_HERE = Path(__file__).parent / "static"
_HEADERS = {
    "content-security-policy": "default-src 'self'; connect-src 'self' ws: wss:; img-src 'self' blob: data:; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}
_TOKEN = "GRIDSLAM_LIVE_TOKEN"
"""Environment variable with a token that remains valid after a restart."""
_STOP_WITHIN_S = 5.0
_MOST_VIEWERS = 20
_MOST_CONNECTIONS = 100


class PageContent(Protocol):
    """Content of the page; used by one thread of the server only, which is not the one that answers requests."""

    def add_viewer(self, notify: Callable[[], None]) -> Viewer:
        """Add a viewer; `notify` is called whenever there may be something new."""
        ...


@final
class PageServer:
    """Serves the page while its context is entered.

    Parameters
    ----------
    content : PageContent
        Content of the page; from now on only this server's thread for it may use it, see `call`.
    options : LiveOptions
        Address of the page.
    edits : EditsFile, optional
        Edits of the map, that pages may change.

    Raises
    ------
    OutputError
        On entering: the port is in use, or the address is not one of this machine.
    """

    def __init__(self, content: PageContent, options: LiveOptions, edits: EditsFile | None = None) -> None:
        """Create the server without listening."""
        self._content_thread = ThreadPoolExecutor(1, "gridslam-live-content")
        self._options = options
        self._token = None if options.is_local else os.environ.get(_TOKEN) or secrets.token_urlsafe(12)
        routes = [] if edits is None else [make_edit_route(edits, self._token)]
        config = uvicorn.Config(
            _make_application(content, options.host, self._token, self._content_thread, routes),
            http="h11",
            ws="websockets-sansio",
            limit_concurrency=_MOST_CONNECTIONS,
            loop="none",
            log_config=None,
            log_level="critical",
            access_log=False,
            lifespan="off",
            ws_per_message_deflate=False,
            ws_max_size=2**16,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._running = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="gridslam-live", daemon=True)
        self._socket: socket.socket | None = None

    def __enter__(self) -> PageServer:
        """Listen and serve."""
        self._socket = self._open_socket()
        self._thread.start()
        self._running.wait()
        return self

    def __exit__(self, *_: object) -> None:
        """Close all connections."""
        self._server.should_exit = True
        self._thread.join(_STOP_WITHIN_S)
        self._content_thread.shutdown(wait=False, cancel_futures=True)

    @property
    def url(self) -> str:
        """Address of the page."""
        if self._socket is None:
            raise OutputError("the page is not served")
        name, port = self._socket.getsockname()[:2]
        if name in ("0.0.0.0", "::"):
            name = socket.gethostname()
        address = f"[{name}]" if ":" in name else name
        return f"http://{address}:{port}/" + ("" if self._token is None else f"?token={self._token}")

    def call(self, function: Callable[..., None], *arguments: object) -> bool:
        """Schedule a call in the content's thread; thread-safe. Returns False if the server has stopped."""
        if self._loop is None or self._loop.is_closed():
            return False
        try:
            self._content_thread.submit(function, *arguments).add_done_callback(_raise_again)
        except RuntimeError:
            return False
        return True

    def _open_socket(self) -> socket.socket:
        host = self._options.host
        port = self._options.port
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            return socket.create_server((host, port), family=family)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise OutputError(f"port {port} of {host} is taken; --live-port 0 takes one that is free") from None
            raise OutputError(f"cannot listen at {host}, port {port}: {error.strerror or error}") from None

    def _serve(self) -> None:
        async def serve() -> None:
            self._loop = asyncio.get_running_loop()
            self._loop.set_exception_handler(_ignore_connections)
            self._running.set()
            await self._server.serve([self._socket] if self._socket else None)

        try:
            asyncio.run(serve())
        finally:
            self._running.set()


def _ignore_connections(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report failures, except of connections."""
    if not isinstance(context.get("exception"), OSError):
        loop.default_exception_handler(context)


def _raise_again(call: Future[None]) -> None:
    """Raise failures of the content's thread, so that they are reported."""
    if not call.cancelled():
        call.result()


def _make_application(
    content: PageContent, host: str, token: str | None, thread: ThreadPoolExecutor, files: Sequence[BaseRoute]
) -> ASGIApp:
    """Return the page of a show, for everyone who has the token; without one for requests to this very host alone."""
    joining = asyncio.Lock()
    viewers = asyncio.BoundedSemaphore(_MOST_VIEWERS)

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        if is_foreign(websocket) or not is_authorized(websocket, token):
            await websocket.close(_BAD_TOKEN, "this page needs the address with its token")
        elif viewers.locked():
            await websocket.close(_TOO_MANY, "too many look at this page")
        else:
            async with viewers:
                await serve_viewer(ViewerLine(websocket, content.add_viewer, thread, joining))

    routes = [
        WebSocketRoute("/socket", socket),
        *files,
        Mount("/", StaticFiles(directory=_HERE, html=True)),
    ]
    names = None if token is not None else {"127.0.0.1", "localhost", "::1", host}
    return _guard(Starlette(routes=routes), names)


def _guard(app: ASGIApp, names: set[str] | None) -> ASGIApp:
    """Reject requests without a host or for another one, against DNS rebinding, and add security headers."""

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] += [(name.encode(), value.encode()) for name, value in _HEADERS.items()]
            await send(message)

        if scope["type"] in ("http", "websocket"):
            host = _HOST.fullmatch(HTTPConnection(scope).headers.get("host", ""))
            if host is None:
                await PlainTextResponse("the header Host holds no name", 400)(scope, receive, send)
                return
            if names is not None and host[1].strip("[]").lower() not in names:
                await PlainTextResponse("not served under this name", 421)(scope, receive, send)
                return
        await app(scope, receive, with_headers)

    return guarded
