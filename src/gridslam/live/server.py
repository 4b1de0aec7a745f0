"""The web server of the page: the application, its stream of messages to each viewer, and a thread of its own."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import secrets
import socket
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, final
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from gridslam.errors import ArgumentError, OutputError
from gridslam.live.downloads import DownloadableContent, is_authorized, make_download_routes
from gridslam.live.limits import LimitedConnection, PacedSelector
from gridslam.live.options import LiveOptions
from gridslam.live.protocol import encode

__all__ = ["PageContent", "PageServer", "Viewer"]

_PERIOD_S = 0.1  # least time between two messages to a viewer
_BYTES_PER_S = 1e6  # maximum rate for a viewer; a large message is followed by a longer pause
_HEARTBEAT_S = 3.0  # maximum time between messages to a viewer, so that it does not time out
_MAX_UNACKNOWLEDGED = 2  # messages that a viewer has not confirmed: a slow line gets fewer messages, not later ones
_BAD_TOKEN = 4401  # close codes of the socket
_BAD_COMMAND = 4400
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
_BACKLOG = 32  # connections that are accepted at once


class Viewer(Protocol):
    """A viewer; used by the server's thread only."""

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command; raises ArgumentError, KeyError, TypeError or ValueError if it is invalid."""

    def close(self) -> None:
        """Remove the viewer."""


class PageContent(DownloadableContent, Protocol):
    """Content of the page; used by the server's thread only."""

    def add_viewer(self, notify: Callable[[], None]) -> Viewer:
        """Add a viewer; `notify` is called whenever there may be something new."""
        ...


@final
class PageServer:
    """Serves the page while its context is entered.

    Parameters
    ----------
    content : PageContent
        Content of the page; from now on only this server's thread may use it, see `call`.
    options : LiveOptions
        Address of the page.
    share : float, (0, 1]
        Share of one processor's time that the server takes at most, on average: what is left is the filter's.

    Raises
    ------
    OutputError
        On entering: the port is in use, or the address is not one of this machine.
    """

    def __init__(self, content: PageContent, options: LiveOptions, share: float = 1.0) -> None:
        """Create the server without listening."""
        self._share = share
        self._options = options
        self._token = None if options.is_local else os.environ.get(_TOKEN) or secrets.token_urlsafe(12)
        config = uvicorn.Config(
            _make_application(content, options.host, self._token, share),
            http=LimitedConnection,
            backlog=_BACKLOG,
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
        """Schedule a call in the server's thread; thread-safe. Returns False if the server has stopped."""
        if self._loop is None:
            return False
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:  # its loop is closed
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
        loop = asyncio.SelectorEventLoop(PacedSelector(self._share))
        loop.set_exception_handler(_ignore_connections)

        async def serve() -> None:
            self._loop = loop
            self._running.set()
            await self._server.serve([self._socket] if self._socket else None)

        try:
            loop.run_until_complete(serve())
            loop.run_until_complete(_cancel_tasks())
            loop.run_until_complete(loop.shutdown_default_executor())
        finally:
            self._running.set()
            loop.close()


async def _cancel_tasks() -> None:
    tasks = asyncio.all_tasks() - {asyncio.current_task()}
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def _ignore_connections(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report what failed, but for connections: they come and go."""
    if not isinstance(context.get("exception"), OSError):
        loop.default_exception_handler(context)


def _make_application(content: PageContent, host: str, token: str | None, share: float) -> ASGIApp:
    """The page of a show, for everyone who has the token; without one for requests to this very host alone."""
    turn = asyncio.Lock()

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        origin = websocket.headers.get("origin")
        foreign = origin is not None and urlsplit(origin).netloc != websocket.headers.get("host")
        if foreign or not is_authorized(websocket, token):
            await websocket.close(_BAD_TOKEN, "this page needs the address with its token")
            return
        await _serve_viewer(websocket, content, turn)

    routes = [
        WebSocketRoute("/socket", socket),
        *make_download_routes(content, token, share),
        Mount("/", StaticFiles(directory=_HERE, html=True)),
    ]
    names = None if token is not None else {"127.0.0.1", "localhost", "::1", host}
    return _guard(Starlette(routes=routes), names)


def _guard(app: ASGIApp, names: set[str] | None) -> ASGIApp:
    """Reject requests for other host names, against DNS rebinding, and add security headers."""

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] += [(name.encode(), value.encode()) for name, value in _HEADERS.items()]
            await send(message)

        if names is not None and scope["type"] in ("http", "websocket"):
            host = HTTPConnection(scope).headers.get("host", "")
            if urlsplit(f"//{host}").hostname not in names:
                await PlainTextResponse("not served under this name", 421)(scope, receive, send)
                return
        await app(scope, receive, with_headers)

    return guarded


async def _serve_viewer(websocket: WebSocket, content: PageContent, turn: asyncio.Lock) -> None:
    """Send messages to one viewer and execute its commands until it disconnects; viewers take `turn` in turn."""
    notify = asyncio.Event()
    window = asyncio.BoundedSemaphore(_MAX_UNACKNOWLEDGED)
    viewer = content.add_viewer(notify.set)
    sender = asyncio.create_task(_send_all(websocket, viewer, notify, window, turn))
    try:
        while True:
            command = json.loads(await websocket.receive_text())
            if command["do"] == "ack":
                window.release()
            else:
                viewer.command(command)
                notify.set()
    except (ArgumentError, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        reason = f"not understood: {error}".encode()[:100].decode(errors="ignore")  # a close frame holds little
        await websocket.close(_BAD_COMMAND, reason)
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        viewer.close()
        sender.cancel()
        await asyncio.gather(sender, return_exceptions=True)


async def _send_all(
    websocket: WebSocket, viewer: Viewer, notify: asyncio.Event, window: asyncio.Semaphore, turn: asyncio.Lock
) -> None:
    clock = asyncio.get_running_loop().time
    while True:
        await window.acquire()
        message = await _next_message(viewer, notify, turn)
        due = clock() + max(_PERIOD_S, len(message) / _BYTES_PER_S)
        await websocket.send_bytes(message)
        await asyncio.sleep(due - clock())


async def _next_message(viewer: Viewer, notify: asyncio.Event, turn: asyncio.Lock) -> bytes:
    """The data that the viewer lacks, or an empty heartbeat."""
    clock = asyncio.get_running_loop().time
    due = clock() + _HEARTBEAT_S
    while True:
        notify.clear()
        async with turn:
            message = viewer.next_message()
            await asyncio.sleep(0)  # the others wait until the loop has passed its selector, which paces it
        if message is not None:
            return message
        try:
            await asyncio.wait_for(notify.wait(), due - clock())
        except asyncio.TimeoutError:
            return encode({}, {})
