"""Limits of the page's server: connections, computing time and files, so that no visitor holds a run up."""

from __future__ import annotations

import asyncio
import itertools
import selectors
import sys
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar, final

from uvicorn.protocols.http.auto import AutoHTTPProtocol

__all__ = ["FileCache", "LimitedConnection", "PacedSelector", "find_max_connections"]

_MOST_CONNECTIONS = 400
_LONGEST_SLEEP_S = 0.5


def find_max_connections() -> int:
    """Return how many connections are kept: at most half of the files that this process may open."""
    if sys.platform == "win32":
        return _MOST_CONNECTIONS
    import resource  # not on Windows

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return _MOST_CONNECTIONS if limit == resource.RLIM_INFINITY else max(8, min(_MOST_CONNECTIONS, limit // 2))


_Connection: Any = AutoHTTPProtocol


@final
class LimitedConnection(_Connection):  # type: ignore[misc]
    """A connection; when there are too many, one without a request gives way, or the oldest that is no viewer's."""

    most = find_max_connections()
    _numbers = itertools.count()

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Accept the connection, and make room for it."""
        super().connection_made(transport)
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
class PacedSelector(selectors.DefaultSelector):
    """Selector of an event loop that takes a share of one processor's time at most; who asks for more has to wait.

    Parameters
    ----------
    share : float, (0, 1]
        Share of the time, on average.
    burst_s : float, s
        Time that may be taken at once after a rest.
    """

    def __init__(self, share: float, burst_s: float = 0.5) -> None:
        super().__init__()
        self.share = share
        self._burst_s = burst_s
        self._credit_s = burst_s
        self._looked_s = time.monotonic()
        self._spent_s: float | None = None

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for events, and before that until the time that was spent is paid for."""
        self._account()
        if self._credit_s < 0:
            time.sleep(min(-self._credit_s / self.share, _LONGEST_SLEEP_S))
        return super().select(timeout)

    def _account(self) -> None:
        now_s = time.monotonic()
        spent_s = time.thread_time()
        before_s = spent_s if self._spent_s is None else self._spent_s
        earned_s = self.share * (now_s - self._looked_s)
        self._credit_s = min(self._burst_s, self._credit_s + earned_s) - (spent_s - before_s)
        self._looked_s = now_s
        self._spent_s = spent_s


_Source = TypeVar("_Source")


@final
class FileCache(Generic[_Source]):
    """Makes files for visitors one at a time, in a thread; each is given to all who ask until it has been paid for.

    Parameters
    ----------
    find_source : callable
        Returns what the file of a channel is made of; None if there is nothing.
    make_file : callable
        Makes the file's content; called in another thread.
    share : float, (0, 1]
        Share of the time in which files are made.
    """

    def __init__(
        self,
        find_source: Callable[[int], _Source | None],
        make_file: Callable[[_Source], bytes],
        share: float,
    ) -> None:
        self._find_source = find_source
        self._make_file = make_file
        self._rest = 1 / share - 1
        self._lock = asyncio.Lock()
        self._due_s = 0.0
        self._channel = -1
        self._content: bytes | None = None

    async def find(self, channel: int) -> bytes | None:
        """Return the file of a channel; None if there is none."""
        async with self._lock:
            wait_s = self._due_s - time.monotonic()
            if wait_s > 0:
                if channel == self._channel:
                    return self._content
                await asyncio.sleep(wait_s)
            start_s = time.monotonic()
            source = self._find_source(channel)
            content = None if source is None else await asyncio.to_thread(self._make_file, source)
            end_s = time.monotonic()
            self._due_s = end_s + self._rest * (end_s - start_s)
            self._channel = channel
            self._content = content
            return content
