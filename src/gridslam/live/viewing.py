"""The stream of messages to one viewer of the page, and of commands from it."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Coroutine, Hashable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from typing import Any, Protocol, final

from starlette.websockets import WebSocket, WebSocketDisconnect

from gridslam.errors import ArgumentError
from gridslam.live.protocol import encode

_PERIOD_S = 0.1  # least time between two messages to a viewer
_BYTES_PER_S = 1e6  # maximum rate for a viewer; a large message is followed by a longer pause
_COMMAND_PERIOD_S = 0.05  # least time between two commands of a kind
_HEARTBEAT_S = 3.0  # maximum time between messages to a viewer, so that it does not time out
_SILENCE_S = 30.0  # without a confirmation of what was sent: whoever looked on is gone
_MAX_UNACKNOWLEDGED = 2  # messages that a viewer has not confirmed: a slow line gets fewer messages, not later ones
_MOST_KINDS = 16  # of commands that wait
_BAD_COMMAND = 4400  # close codes of the socket
_SILENT = 4408
_NOT_UNDERSTOOD = (ArgumentError, KeyError, TypeError, ValueError, OverflowError, RecursionError)


class Viewer(Protocol):
    """A viewer; used by the thread of the page's content only."""

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command; raises ArgumentError, KeyError, TypeError or ValueError if it is invalid."""

    def close(self) -> None:
        """Remove the viewer, and end its pause and speed."""


async def serve_viewer(line: ViewerLine) -> None:
    """Send messages to a viewer and execute its commands until it disconnects, goes silent or is not understood."""
    tasks = [asyncio.create_task(work()) for work in (line.receive, line.execute, line.send)]
    code, reason = 0, ""
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        await done.pop()
    except _NOT_UNDERSTOOD as error:
        code, reason = _BAD_COMMAND, f"not understood: {error}"
    except TimeoutError:
        code, reason = _SILENT, "nothing was heard of this page"
    except (WebSocketDisconnect, RuntimeError):
        pass
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        line.close()
    if code:
        with suppress(WebSocketDisconnect, RuntimeError):
            await line.websocket.close(
                code, reason.encode()[:100].decode(errors="ignore")
            )  # a close frame holds little


@final
class ViewerLine:
    """Messages between the server and one viewer.

    Of the commands of each kind that come before the last ones are done the newest is executed, and the others never
    are: who asks for a hundred moments of the past in a second wants to see the last of them.

    Parameters
    ----------
    websocket : WebSocket
        Its connection.
    add_viewer : callable
        Adds the viewer to the page's content, in that one's thread.
    thread : ThreadPoolExecutor
        The thread of the page's content.
    joining : asyncio.Lock
        Shared by all lines: whoever comes is sent everything, one after the other, while those who are there go on.
    """

    def __init__(
        self,
        websocket: WebSocket,
        add_viewer: Callable[[Callable[[], None]], Viewer],
        thread: ThreadPoolExecutor,
        joining: asyncio.Lock,
    ) -> None:
        self.websocket = websocket
        self._add_viewer = add_viewer
        self._thread = thread
        self._joining = joining
        self._loop = asyncio.get_running_loop()
        self._added: Future[Viewer] | None = None
        self._has_joined = asyncio.Event()
        self._changed = asyncio.Event()
        self._window = asyncio.BoundedSemaphore(_MAX_UNACKNOWLEDGED)
        self._commands: dict[Hashable, Mapping[str, Any]] = {}  # of each kind the newest
        self._asked = asyncio.Event()

    def close(self) -> None:
        """Remove the viewer."""
        if self._added is not None:
            with suppress(RuntimeError):  # the server has stopped
                self._thread.submit(_remove, self._added)

    async def receive(self) -> None:
        """Take confirmations and commands, without end."""
        while True:
            command = json.loads(await self.websocket.receive_text())
            if command["do"] == "ack":
                self._window.release()
            else:
                kind = command["do"], command.get("command")
                self._commands.pop(kind, None)
                self._commands[kind] = command
                if len(self._commands) > _MOST_KINDS:
                    raise ArgumentError("do", f"at most {_MOST_KINDS} kinds of commands at once", "more")
                self._asked.set()
            await asyncio.sleep(0)  # the others' turn

    async def execute(self) -> None:
        """Execute commands, without end."""
        await self._has_joined.wait()
        while True:
            await self._asked.wait()
            self._asked.clear()
            commands, self._commands = self._commands, {}
            await asyncio.wrap_future(self._thread.submit(self._execute, commands.values()))
            self._changed.set()
            await asyncio.sleep(_COMMAND_PERIOD_S)

    def _execute(self, commands: Iterable[Mapping[str, Any]]) -> None:
        for command in commands:
            self._viewer.command(command)

    @property
    def _viewer(self) -> Viewer:
        assert self._added is not None
        return self._added.result()

    def _notify(self) -> None:
        """Check for new data; called in the content's thread."""
        with suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._changed.set)

    async def _join(self) -> bytes:
        """Add the viewer, and return its first message."""
        async with self._joining:
            self._added = self._thread.submit(self._add_viewer, self._notify)
            await asyncio.wrap_future(self._added)
            self._has_joined.set()
            message = await asyncio.wrap_future(self._thread.submit(self._viewer.next_message))
        return await self._next_message() if message is None else message

    async def send(self) -> None:
        """Send messages, without end; raises TimeoutError when none is confirmed any more."""
        clock = asyncio.get_running_loop().time
        while True:
            if not await _comes_within(_SILENCE_S, self._window.acquire()):
                raise TimeoutError
            message = await (self._next_message() if self._has_joined.is_set() else self._join())
            due = clock() + max(_PERIOD_S, len(message) / _BYTES_PER_S)
            await self.websocket.send_bytes(message)
            await asyncio.sleep(due - clock())

    async def _next_message(self) -> bytes:
        """Return the data that the viewer lacks, or an empty heartbeat."""
        clock = asyncio.get_running_loop().time
        due = clock() + _HEARTBEAT_S
        while True:
            self._changed.clear()
            message = await asyncio.wrap_future(self._thread.submit(self._viewer.next_message))
            if message is not None:
                return message
            if not await _comes_within(due - clock(), self._changed.wait()):
                return encode({}, {})


def _remove(added: Future[Viewer]) -> None:
    """Remove a viewer, if it was added; called in the content's thread."""
    if not added.cancelled() and added.exception() is None:
        added.result().close()


async def _comes_within(timeout_s: float, event: Coroutine[None, None, object]) -> bool:
    """Return whether something happens in time; `asyncio.wait_for` may swallow a cancellation before Python 3.12."""
    task = asyncio.ensure_future(event)
    try:
        return bool((await asyncio.wait({task}, timeout=timeout_s))[0])
    finally:
        task.cancel()
