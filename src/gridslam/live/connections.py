"""Connections of the page's server: their number, and the memory and time of each."""

from __future__ import annotations

import asyncio
import itertools
import sys
from collections.abc import Collection
from typing import Any, final

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

_MOST_CONNECTIONS = 400
_STALL_S = 30.0
_MOST_BYTES_AT_ONCE = 1 << 14  # that are read of a connection before it is the next one's turn
_MOST_FRAGMENTS = 16  # of a message; browsers send one
_NO_HANDSHAKE = (
    b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\nContent-Length: 16\r\nConnection: close\r\n\r\n"
    b"not a websocket\n"
)


def find_max_connections() -> int:
    """Return how many connections are kept: at most half of the files that this process may open."""
    if sys.platform == "win32":
        return _MOST_CONNECTIONS
    import resource  # not on Windows

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return _MOST_CONNECTIONS if limit == resource.RLIM_INFINITY else max(8, min(_MOST_CONNECTIONS, limit // 2))


async def drop_stalled(connections: Collection[Any]) -> None:
    """Periodically end connections whose peer receives none of its pending data."""
    waiting: dict[Any, tuple[int, int]] = {}
    while True:
        await asyncio.sleep(_STALL_S)
        before, waiting = waiting, {one: (one.drained, one.transport.get_write_buffer_size()) for one in connections}
        for connection, (drained, size) in waiting.items():
            drained_before, size_before = before.get(connection, (-1, 0))
            if drained == drained_before and 0 < size_before <= size:
                connection.transport.abort()


class _Drained:
    """Counts how often all that waited was taken."""

    drained = 0

    def resume_writing(self) -> None:
        """Resume when no data are pending."""
        self.drained += 1
        super().resume_writing()  # type: ignore[misc]


@final
class LimitedConnection(_Drained, H11Protocol):
    """A connection; when there are too many, one without a request gives way, or the oldest that is no viewer's."""

    most = find_max_connections()
    _numbers = itertools.count()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept the connection, and make room for it."""
        super().connection_made(transport)
        transport.max_size = _MOST_BYTES_AT_ONCE  # type: ignore[attr-defined]
        transport.set_write_buffer_limits(0)
        self.number = next(self._numbers)
        if len(self.connections) <= self.most:
            return
        staying = [other for other in self.connections if not other.transport.is_closing()]
        if len(staying) > self.most:
            others = [other for other in staying if isinstance(other, LimitedConnection) and other is not self]
            min(others, key=lambda other: (other.is_busy, other.number), default=self).transport.abort()

    @property
    def is_busy(self) -> bool:
        """Whether a request is being answered."""
        return self.cycle is not None and not self.cycle.response_complete


@final
class LimitedSocket(_Drained, WebSocketsSansIOProtocol):
    """A viewer's socket, which a visitor who sends and never reads cannot make grow."""

    def data_received(self, data: bytes) -> None:
        """Receive data; refuse a request that is not of a socket, which always comes as a whole."""
        super().data_received(data)
        if not self.handshake_initiated:
            self.transport.write(_NO_HANDSHAKE)
            self.transport.close()

    def handle_ping(self) -> None:
        """Answer a ping, unless something that was sent before still waits."""
        if self.writable.is_set():
            super().handle_ping()
        else:
            self.conn.data_to_send()

    def handle_cont(self, event: Any) -> None:  # noqa: ANN401
        """Take a fragment of a message."""
        if len(self.frames) < _MOST_FRAGMENTS:
            super().handle_cont(event)
        else:
            self.transport.abort()
