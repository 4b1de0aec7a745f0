"""Limits of visitors' computing time and files, so that none of them delays a run."""

from __future__ import annotations

import asyncio
import selectors
import threading
import time
from collections.abc import Awaitable, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, TypeVar, final

_LONGEST_SLEEP_S = 0.5

_Source = TypeVar("_Source")
_Result = TypeVar("_Result")


@final
class Pace:
    """A share of one processor's time that some threads take together; who asks for more has to wait.

    Parameters
    ----------
    share : float, (0, 1]
        Share of the time, on average.
    burst_s : float, s
        Time that may be taken at once after a rest.
    """

    def __init__(self, share: float, burst_s: float = 0.5) -> None:
        self.share = share
        self._burst_s = burst_s
        self._credit_s = burst_s
        self._looked_s = time.monotonic()
        self._spent_s: dict[int, float] = {}  # by each thread
        self._lock = threading.Lock()

    def keep(self) -> None:
        """Wait until the time that was spent is paid for; called by each of the threads again and again."""
        spent_s = time.thread_time()
        thread = threading.get_ident()
        with self._lock:
            now_s = time.monotonic()
            earned_s = self.share * (now_s - self._looked_s)
            self._credit_s = min(self._burst_s, self._credit_s + earned_s) - (
                spent_s - self._spent_s.get(thread, spent_s)
            )
            self._looked_s = now_s
            self._spent_s[thread] = spent_s
            owed_s = -self._credit_s
        if owed_s > 0:
            time.sleep(min(owed_s / self.share, _LONGEST_SLEEP_S))


@final
class PacedSelector(selectors.DefaultSelector):
    """Selector of an event loop that keeps a pace."""

    def __init__(self, pace: Pace) -> None:
        super().__init__()
        self._pace = pace

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for events, and before that as long as the pace demands."""
        self._pace.keep()
        return super().select(timeout)


@final
class PacedThread:
    """A thread that makes calls one after the other, in the order in which they came, and keeps a pace."""

    def __init__(self, name: str, pace: Pace) -> None:
        self._executor = ThreadPoolExecutor(1, name)
        self._pace = pace

    def submit(self, function: Callable[..., _Result], *arguments: object) -> Future[_Result]:
        """Schedule a call; thread-safe. Raises RuntimeError after `stop`."""
        return self._executor.submit(self._call, function, *arguments)

    async def call(self, function: Callable[..., _Result], *arguments: object) -> _Result:
        """Schedule a call, and return its result."""
        return await asyncio.wrap_future(self.submit(function, *arguments))

    def stop(self) -> None:
        """Make no further call."""
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _call(self, function: Callable[..., _Result], *arguments: object) -> _Result:
        self._pace.keep()
        return function(*arguments)


@final
class FileCache(Generic[_Source]):
    """Makes files for visitors one at a time, in a thread; each is given to all who ask until it has been paid for.

    Parameters
    ----------
    find_source : coroutine function
        Returns what the file of a channel is made of; None if there is nothing.
    make_file : callable
        Makes the file's content; called in another thread.
    share : float, (0, 1]
        Share of the time in which files are made.
    """

    def __init__(
        self,
        find_source: Callable[[int], Awaitable[_Source | None]],
        make_file: Callable[[_Source], bytes],
        share: float,
    ) -> None:
        self._find_source = find_source
        self._make_file = make_file
        self._rest = 1 / share - 1
        self._lock = asyncio.Lock()
        self._due_s = 0.0
        self._makings: dict[int, asyncio.Task[bytes | None]] = {}  # by channel
        self._last: tuple[int, bytes | None] | None = None  # a channel, and its file

    async def find(self, channel: int) -> bytes | None:
        """Return the file of a channel; None if there is none."""
        if self._last is not None and self._last[0] == channel and time.monotonic() < self._due_s:
            return self._last[1]
        if channel not in self._makings:
            self._makings[channel] = asyncio.create_task(self._make(channel))
        return await asyncio.shield(self._makings[channel])  # others may wait for it, too

    async def _make(self, channel: int) -> bytes | None:
        try:
            async with self._lock:
                await asyncio.sleep(self._due_s - time.monotonic())
                start_s = time.monotonic()
                source = await self._find_source(channel)
                content = None if source is None else await asyncio.to_thread(self._make_file, source)
                end_s = time.monotonic()
                self._due_s = end_s + self._rest * (end_s - start_s)
                self._last = channel, content
                return content
        finally:
            del self._makings[channel]
