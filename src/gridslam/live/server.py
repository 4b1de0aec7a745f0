"""The web server of the page: the application, and the thread in which it and the page's content live."""

from __future__ import annotations

import asyncio
import errno
import json
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, final

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.live.options import LiveOptions
from gridslam.live.protocol import encode

_PERIOD_S = 0.1  # least time between two messages to a viewer
_BYTES_PER_S = 1e6  # maximum rate for a viewer; a large message is followed by a longer pause
_HEARTBEAT_S = 3.0  # maximum time between messages to a viewer, so that it does not time out
_BAD_COMMAND = 4400  # close codes of the socket
_FOREIGN = 4401
_NOT_UNDERSTOOD = (ArgumentError, KeyError, TypeError, ValueError, OverflowError, RecursionError)
_HERE = Path(__file__).parent / "static"
_HEADERS = {
    "content-security-policy": "default-src 'self'; connect-src 'self' ws: wss:; img-src 'self' blob: data:; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}
_STOP_WITHIN_S = 5.0
_MOST_CONNECTIONS = 100


class Viewer(Protocol):
    """A viewer; used by the server's thread only."""

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command; raises ArgumentError, KeyError, TypeError or ValueError if it is invalid."""

    def close(self) -> None:
        """Remove the viewer."""


class PageContent(Protocol):
    """Content of the page."""

    def add_viewer(self) -> Viewer:
        """Add a viewer; called in the server's thread."""
        ...


@final
class PageServer:
    """Serves the page while its context is entered.

    Parameters
    ----------
    content : PageContent
        Content of the page; its viewers are used by this server's thread.
    options : LiveOptions
        Address of the page.

    Raises
    ------
    ConfigurationError
        On entering: the port is in use, or the address is not one of this machine.
    """

    def __init__(self, content: PageContent, options: LiveOptions) -> None:
        """Create the server without listening."""
        self._options = options
        names = ["127.0.0.1", "localhost", "::1", "[::1]", options.host] if options.is_local else ["*"]
        config = uvicorn.Config(
            _make_application(content, names),
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
            headers=[*_HEADERS.items()],
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
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
        assert self._socket is not None, "the page is not served"
        name, port = self._socket.getsockname()[:2]
        if name in ("0.0.0.0", "::"):
            name = socket.gethostname()
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/"

    def _open_socket(self) -> socket.socket:
        host = self._options.host
        port = self._options.port
        try:
            family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
            return socket.create_server((host, port), family=family)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                problem = f"port {port} of {host} is taken; --live-port 0 takes one that is free"
            else:
                problem = f"cannot listen at {host}, port {port}: {error.strerror or error}"
            raise ConfigurationError(problem) from None

    def _serve(self) -> None:
        async def serve() -> None:
            asyncio.get_running_loop().set_exception_handler(_ignore_connections)
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


def _make_application(content: PageContent, names: list[str]) -> Starlette:
    """Return the page of a content, for requests to a host of these names, against DNS rebinding."""

    async def answer(websocket: WebSocket) -> None:
        await websocket.accept()
        origin = websocket.headers.get("origin")
        if origin is not None and origin.partition("://")[2] != websocket.headers.get("host"):
            await websocket.close(_FOREIGN, "this page is another one's")
        else:
            await _serve_viewer(websocket, content.add_viewer())

    return Starlette(
        routes=[WebSocketRoute("/socket", answer), Mount("/", StaticFiles(directory=_HERE, html=True))],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=names, www_redirect=False)],
    )


async def _serve_viewer(websocket: WebSocket, viewer: Viewer) -> None:
    """Send messages to a viewer and execute its commands until it disconnects or is not understood."""
    tasks = [asyncio.create_task(work(websocket, viewer)) for work in (_receive, _send)]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        await done.pop()
    except _NOT_UNDERSTOOD as error:
        reason = f"not understood: {error}".encode()[:100].decode(errors="ignore")  # a close frame holds little
        with suppress(WebSocketDisconnect, RuntimeError):
            await websocket.close(_BAD_COMMAND, reason)
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        viewer.close()


async def _receive(websocket: WebSocket, viewer: Viewer) -> None:
    """Execute commands, without end."""
    while True:
        viewer.command(json.loads(await websocket.receive_text()))
        await asyncio.sleep(0)  # the others' turn


async def _send(websocket: WebSocket, viewer: Viewer) -> None:
    """Send the data that the viewer lacks, or an empty heartbeat, without end."""
    clock = asyncio.get_running_loop().time
    sent_s = clock()
    while True:
        message = viewer.next_message()
        if message is None and clock() - sent_s > _HEARTBEAT_S:
            message = encode({}, {})
        if message is not None:
            await websocket.send_bytes(message)
            sent_s = clock()
        await asyncio.sleep(max(_PERIOD_S, len(message or b"") / _BYTES_PER_S))
