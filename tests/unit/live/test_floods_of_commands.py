"""Of the commands that come faster than they are executed the newest of each kind counts; other viewers do not wait."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from gridslam.live import connections, viewing
from gridslam.live.options import LiveOptions
from gridslam.live.protocol import encode
from gridslam.live.server import PageServer

COST_S = 0.02


class SlowContent:
    """Each command takes a while, and is noted."""

    def __init__(self):
        self.viewers, self.closed = [], 0

    def add_viewer(self, notify):
        self.viewers.append(SlowViewer(self))
        return self.viewers[-1]

    def find_channel(self, channel):
        return 0

    def channel_map(self, channel):
        return None

    trajectory = channel_map

    def open_session(self):
        return None


class SlowViewer:
    def __init__(self, content):
        self.content, self.commands, self.told = content, [], 0

    def next_message(self):
        if self.told == len(self.commands):
            return None
        self.told = len(self.commands)
        return encode({"done": self.told}, {})

    def command(self, command):
        time.sleep(COST_S)
        self.commands.append(command)

    def close(self):
        self.content.closed += 1


@pytest.fixture
def content():
    return SlowContent()


@pytest.fixture
def page(content):
    with PageServer(content, LiveOptions(port=0)) as served:
        yield served


@contextmanager
def looking(page):
    with connect(page.url.replace("http", "ws", 1) + "socket", max_size=None, compression=None) as line:
        yield line


def send(line, **command):
    line.send(json.dumps(command))


def closing_code(line):
    """Take messages until the server closes the line."""
    with pytest.raises(ConnectionClosed) as closed:
        drain(line)
    return closed.value.rcvd.code


def drain(line):
    while True:
        line.recv(5)


def wait_until(condition, at_most_s=10.0):
    until = time.monotonic() + at_most_s
    while not condition():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.005)


def test_of_3000_seeks_the_newest_wins_and_others_are_answered_meanwhile(page, content):
    """All of them would take a minute."""
    with looking(page) as line, looking(page) as other:
        wait_until(lambda: len(content.viewers) == 2)
        for at in range(3000):
            send(line, do="seek", at=at)
        start = time.monotonic()
        send(other, do="pause")
        other.recv(5)
        waited = time.monotonic() - start
        wait_until(lambda: {"do": "seek", "at": 2999} in [*content.viewers[0].commands, *content.viewers[1].commands])
        assert waited < 1.0
        assert sum(len(viewer.commands) for viewer in content.viewers) < 300


def test_no_more_look_on_than_half_of_the_connections(monkeypatch, content):
    monkeypatch.setattr(connections.LimitedConnection, "most", 4)
    with PageServer(content, LiveOptions(port=0)) as page:
        with looking(page), looking(page), looking(page) as third:
            assert closing_code(third) == 4429
            wait_until(lambda: len(content.viewers) == 2)
        wait_until(lambda: content.closed == 2)
        with looking(page) as line:
            send(line, do="seek")
            line.recv(5)


def test_who_confirms_nothing_is_gone(monkeypatch, page, content):
    monkeypatch.setattr(viewing, "_HEARTBEAT_S", 0.05)
    monkeypatch.setattr(viewing, "_SILENCE_S", 0.2)
    with looking(page) as line:
        assert closing_code(line) == 4408
    wait_until(lambda: content.closed == 1)
