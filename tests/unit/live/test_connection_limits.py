"""What visitors can take of a run: connections, computing time and archives have limits."""

from __future__ import annotations

import asyncio
import http.client
import socket
import threading
import time

import pytest

from gridslam.live.connections import LimitedConnection
from gridslam.live.limits import Pace, PacedSelector, PacedThread
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage


@pytest.fixture
def page(monkeypatch):
    monkeypatch.setattr(LimitedConnection, "most", 10)
    with LivePage("test", LiveOptions(port=0)) as served:
        yield served


def connect(page):
    return socket.create_connection(("127.0.0.1", int(page.url.rsplit(":", 1)[1].strip("/"))), timeout=10)


def get(page, path):
    client = http.client.HTTPConnection(page.url.split("/")[2], timeout=10)
    client.request("GET", path)
    answer = client.getresponse()
    answer.read()
    client.close()
    return answer.status


def test_idle_connections_give_way(page):
    """1,100 of them ended a run by taking all files that a process may open."""
    sockets = [connect(page) for _ in range(60)]
    try:
        assert get(page, "/") == 200
        time.sleep(0.2)
        lost = 0
        for one in sockets:
            one.setblocking(False)
            try:
                lost += one.recv(1) == b""
            except BlockingIOError:
                continue
            except ConnectionError:
                lost += 1
        assert lost >= 45
        assert get(page, "/") == 200
    finally:
        for one in sockets:
            one.close()


def compute(seconds):
    until = time.thread_time() + seconds
    while time.thread_time() < until:
        pass


def assert_leaves_the_rest_of_the_time(work):
    """By the processor time of the loop and of the content's thread, 0.3 s, however busy the machine is."""
    pace = Pace(0.1, burst_s=0.05)
    thread = PacedThread("content", pace)
    loop = asyncio.SelectorEventLoop(PacedSelector(pace))
    spent = []

    def run() -> None:
        start = time.thread_time(), time.monotonic()
        loop.run_until_complete(work(thread))
        inner = thread.submit(time.thread_time).result()
        spent.extend((time.thread_time() - start[0] + inner, time.monotonic() - start[1]))

    runner = threading.Thread(target=run)
    runner.start()
    runner.join()
    loop.close()
    thread.stop()
    assert spent[0] >= 0.3
    assert spent[1] >= (spent[0] - 0.05) / 0.1 * 0.8


def test_a_loop_that_is_never_done_leaves_the_rest_of_the_time():
    async def work(thread) -> None:
        for _ in range(300):
            compute(0.001)
            await asyncio.sleep(0)

    assert_leaves_the_rest_of_the_time(work)
