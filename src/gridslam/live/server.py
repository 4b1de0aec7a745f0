"""The web server, with its own thread and event loop."""

from __future__ import annotations

import asyncio
import errno
import os
import secrets
import socket
import threading
from collections.abc import Callable
from typing import final

import uvicorn

from gridslam.errors import OutputError
from gridslam.live.application import PageContent, make_application
from gridslam.live.options import LiveOptions

__all__ = ["PageServer"]

_TOKEN = "GRIDSLAM_LIVE_TOKEN"
"""Environment variable with a token that remains valid after a restart."""
_STOP_WITHIN_S = 5.0


@final
class PageServer:
    """Serves the page while its context is entered.

    Parameters
    ----------
    content : PageContent
        Content of the page; from now on only this server's thread may use it, see `call`.
    options : LiveOptions
        Address of the page.

    Raises
    ------
    OutputError
        On entering: the port is in use, or the address is not one of this machine.
    """

    def __init__(self, content: PageContent, options: LiveOptions) -> None:
        """Create the server without listening."""
        self._options = options
        self._token = None if options.is_local else os.environ.get(_TOKEN) or secrets.token_urlsafe(12)
        config = uvicorn.Config(
            make_application(content, options.host, self._token), log_config=None, log_level="critical",
            access_log=False, lifespan="off", ws_per_message_deflate=False, ws_max_size=2**16,
            timeout_graceful_shutdown=1,
        )  # fmt: skip
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
        host, port = self._options.host, self._options.port
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
            self._running.set()
            await self._server.serve([self._socket] if self._socket else None)

        try:
            asyncio.run(serve())
        finally:
            self._running.set()
