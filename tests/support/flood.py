"""Visitors who ask too much of a page: `python flood.py KIND PORT` goes on until it is killed, and counts on stdout."""

from __future__ import annotations

import asyncio
import itertools
import json
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress

import websockets

PORT = 0
COUNT = itertools.count()


async def again(visit: Callable[[], Awaitable[None]], pause_s: float = 0.05) -> None:
    """Visit again and again, whatever happens."""
    while True:
        with suppress(OSError, EOFError, asyncio.TimeoutError, websockets.WebSocketException):
            await visit()
        await asyncio.sleep(pause_s)


async def idle() -> None:
    """Connect, and say nothing."""
    reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
    next(COUNT)
    await reader.read()
    writer.close()


async def viewer() -> None:
    """Look on as the page does."""
    async with websockets.connect(f"ws://127.0.0.1:{PORT}/socket", max_size=None) as socket:
        async for _ in socket:
            next(COUNT)
            await socket.send(json.dumps({"do": "ack"}))


async def slow_archive() -> None:
    """Ask for the map, and read a byte in a second."""
    reader, writer = await asyncio.open_connection("127.0.0.1", PORT, limit=1)
    writer.write(b"GET /map.zip HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
    while await reader.read(1):
        next(COUNT)
        await asyncio.sleep(1)


KINDS = {
    "1,100 idle connections": [(idle, 1100)],
    "200 viewers": [(viewer, 200)],
    "slow readers": [(slow_archive, 100)],
}


async def main(kind: str) -> None:
    visits = [again(visit) for visit, number in KINDS[kind] for _ in range(number)]
    tasks = [asyncio.create_task(visit) for visit in visits]
    while tasks:
        await asyncio.sleep(1)
        print(next(COUNT), flush=True)


if __name__ == "__main__":
    PORT = int(sys.argv[2])
    asyncio.run(main(sys.argv[1]))
