"""The web application: the page, the stream of messages to each viewer, and the map as files."""

from __future__ import annotations

import asyncio
import io
import json
import secrets
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from gridslam.errors import ArgumentError
from gridslam.io.maps import write_map
from gridslam.live.protocol import encode
from gridslam.types import OccupancyGrid

__all__ = ["BYTES_PER_S", "PERIOD_S", "PageContent", "Viewer", "make_application"]

PERIOD_S = 0.1
"""Least time between two messages to a viewer, s."""
BYTES_PER_S = 1e6
"""Maximum rate for a viewer; a large message is followed by a longer pause."""

_HEARTBEAT_S = 3.0  # maximum time between messages to a viewer, so that it does not time out
_MAX_UNACKNOWLEDGED = 2  # messages that a viewer has not confirmed: a slow line gets fewer messages, not later ones
_BAD_TOKEN, _BAD_COMMAND = 4401, 4400  # close codes of the socket
_HERE = Path(__file__).parent / "static"
_HEADERS = {
    "content-security-policy": "default-src 'self'; connect-src 'self' ws: wss:; img-src 'self' blob: data:; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-cache",
}


class Viewer(Protocol):
    """A viewer; used by the server's thread only."""

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command; raises ArgumentError, KeyError, TypeError or ValueError if it is invalid."""

    def close(self) -> None:
        """Remove the viewer."""


class PageContent(Protocol):
    """Content of the page; used by the server's thread only."""

    def add_viewer(self, notify: Callable[[], None]) -> Viewer:
        """Add a viewer; `notify` is called whenever there may be something new."""

    def channel_map(self, channel: int) -> OccupancyGrid | None:
        """Return the map of a channel; None if there is none."""


def make_application(content: PageContent, host: str, token: str | None) -> ASGIApp:
    """The page of a show, for everyone who has the token; without one for requests to this very host alone."""

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        origin = websocket.headers.get("origin")
        foreign = origin is not None and urlsplit(origin).netloc != websocket.headers.get("host")
        if foreign or not _is_authorized(websocket, token):
            await websocket.close(_BAD_TOKEN, "this page needs the address with its token")
            return
        await _serve_viewer(websocket, content)

    async def map_files(request: Request) -> Response:
        if not _is_authorized(request, token):
            return PlainTextResponse("this needs the token of the page", 403)
        channel = request.query_params.get("channel", "0")
        grid = content.channel_map(int(channel) if channel.isdecimal() else 0)
        if grid is None:
            return PlainTextResponse("there is no map", 404)
        archive = await asyncio.to_thread(_zip_map, grid)
        return Response(archive, media_type="application/zip")

    routes = [
        WebSocketRoute("/socket", socket),
        Route("/map.zip", map_files),
        Mount("/", StaticFiles(directory=_HERE, html=True)),
    ]
    names = None if token is not None else {"127.0.0.1", "localhost", "::1", host}
    return _guard(Starlette(routes=routes), names)


def _is_authorized(connection: HTTPConnection, token: str | None) -> bool:
    given = connection.query_params.get("token", "")
    return token is None or secrets.compare_digest(given.encode(), token.encode())


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


async def _serve_viewer(websocket: WebSocket, content: PageContent) -> None:
    """Send messages to one viewer and execute its commands until it disconnects."""
    notify, window = asyncio.Event(), asyncio.BoundedSemaphore(_MAX_UNACKNOWLEDGED)
    viewer = content.add_viewer(notify.set)
    sender = asyncio.create_task(_send_all(websocket, viewer, notify, window))
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


async def _send_all(websocket: WebSocket, viewer: Viewer, notify: asyncio.Event, window: asyncio.Semaphore) -> None:
    clock = asyncio.get_running_loop().time
    while True:
        await window.acquire()
        message = await _next_message(viewer, notify)
        due = clock() + max(PERIOD_S, len(message) / BYTES_PER_S)
        await websocket.send_bytes(message)
        await asyncio.sleep(due - clock())


async def _next_message(viewer: Viewer, notify: asyncio.Event) -> bytes:
    """The data that the viewer lacks, or an empty heartbeat."""
    clock = asyncio.get_running_loop().time
    due = clock() + _HEARTBEAT_S
    notify.clear()
    while (message := viewer.next_message()) is None:
        try:
            await asyncio.wait_for(notify.wait(), due - clock())
        except asyncio.TimeoutError:
            return encode({}, {})
        notify.clear()
    return message


def _zip_map(grid: OccupancyGrid) -> bytes:
    """Return a ZIP archive with map.yaml and map.pgm for ROS's map_server."""
    archive = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
        write_map(Path(folder) / "map.yaml", grid)
        for name in ("map.yaml", "map.pgm"):
            files.write(Path(folder) / name, name)
    return archive.getvalue()
