"""The server: several viewers, a lost connection that comes back, a restart, and who is let in."""

import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from gridslam.config import build
from gridslam.errors import ConfigurationError
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.pipeline import run
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient

FREE = LiveOptions(port=0)


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements[:120]


@contextmanager
def viewing(url, **options):
    """A connection and what came by it so far."""
    with connect(f"{url.replace('http', 'ws', 1)}socket", max_size=None, compression=None, **options) as socket:
        yield socket, PageClient()


def receive(socket, client, timeout_s=5.0):
    client.receive(socket.recv(timeout_s))


def receive_until(socket, client, condition, timeout_s=10.0):
    until = time.monotonic() + timeout_s
    while not condition() or client.more:
        assert time.monotonic() < until, f"it did not happen; status {client.status}"
        receive(socket, client)


def drain(socket):
    while True:
        socket.recv(5)


def mapped(page, measurements, watch=None):
    """Run the filter as a page wants it."""
    slam, rng = build(PROVOKED), np.random.default_rng(3)
    return run(
        page.pace(measurements, watch), replace(slam, particles=4), rng=rng, observers=[page.observer], stopwatch=watch
    )


def test_several_viewers_get_the_whole_map_whenever_they_come(drive):
    with LivePage("loop", FREE, range_max_m=30.0) as page, viewing(page.url) as (socket, client):
        receive(socket, client)
        assert client.status["stage"] == "waiting"
        state = mapped(page, drive)
        grid = state.maps.occupancy(state.best)
        receive_until(socket, client, lambda: client.sees(grid) and client.status["stage"] == "final refinement")
        with viewing(page.url) as (other_socket, other):
            receive_until(other_socket, other, lambda: other.sees(grid))
            assert other.status["scans"] == 120
            assert page.viewers == 2
        assert client.status["particles"] == 4
        assert client.status["stage"] == "final refinement"


def test_the_page_needs_nothing_from_elsewhere():
    with LivePage("loop", FREE) as page:
        with urllib.request.urlopen(page.url, timeout=10) as answer:
            text = answer.read().decode()
            assert "default-src 'self'" in answer.headers["content-security-policy"]
        assert "//" not in text.replace("<!doctype html>", "")
        for name in ("app.js", "page.css", "icon.svg", "socket.js"):
            with urllib.request.urlopen(page.url + name, timeout=10) as answer:
                assert answer.status == 200
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(page.url + "../page.py", timeout=10)


def status_of(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=10) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def test_pages_of_other_sites_are_not_let_in():
    with LivePage("loop", FREE) as page:
        port = page.url.rstrip("/").rpartition(":")[2]
        assert status_of(page.url, Host="evil.example") == 400
        assert status_of(page.url, Host=f"localhost:{port}") == 200
        with viewing(page.url, origin="http://evil.example") as (socket, _), pytest.raises(ConnectionClosed) as closed:
            socket.recv(5)
        assert closed.value.rcvd.code == 4401
        with viewing(page.url, origin=page.url.rstrip("/")) as (socket, client):
            receive(socket, client)
        with pytest.raises(InvalidStatus), viewing(page.url, additional_headers={"Host": "evil.example"}):
            pass


@pytest.mark.parametrize(
    "host", ["[", "]", "[]", "[::1", "::1", ":x", "a@127.0.0.1", "127.0.0.1/", "\xe4", "127.0.0.1:1:1"]
)
def test_a_host_that_is_none_is_refused_by_name(host):
    """The first of them was answered by 500."""
    with LivePage("loop", FREE) as page:
        assert status_of(page.url, Host=host) == 400
        assert status_of(page.url, Host="[::1]:80") == 200
        assert status_of(page.url, Host="LocalHost") == 200


@pytest.mark.parametrize("origin", ["http://[", "null", "://", "", "http://127.0.0.1", "https://[::1"])
def test_an_origin_that_is_not_the_page_is_not_let_in(origin):
    with LivePage("loop", FREE) as page, viewing(page.url, origin=origin) as (socket, _):
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(5)
        assert closed.value.rcvd.code == 4401


def test_a_page_that_is_open_to_others_is_shown_to_whoever_comes():
    with LivePage("loop", LiveOptions(host="0.0.0.0", port=0)) as page:
        port = page.url.rstrip("/").rpartition(":")[2]
        with viewing(f"http://127.0.0.1:{port}/") as (socket, client):
            receive(socket, client)
        assert status_of(f"http://127.0.0.1:{port}/", Host="robot.local") == 200


NONSENSE = [
    "no json",
    "[1]",
    "3",
    "null",
    '{"x": 1}',
    '{"do": "fly"}',
    '{"do": "' + "\u00e9" * 200 + '"}',
    "[" * 60_000,
    b"\x00\xff",
    '{"do": "seek"}',
    '{"do": "seek", "at": "first"}',
    '{"do": "seek", "at": NaN}',
    '{"do": {}}',
    '{"do": "seek", "at": 1e999}',
]


def test_a_viewer_that_says_nonsense_is_told_so_and_the_others_stay():
    with LivePage("loop", FREE) as page, viewing(page.url) as (socket, client):
        receive(socket, client)
        for text in NONSENSE:
            with viewing(page.url) as (other, _):
                other.send(text)
                with pytest.raises(ConnectionClosed) as closed:
                    drain(other)
                assert closed.value.rcvd.code == 4400, text[:30]
        receive(socket, client)  # a heartbeat
        assert page.viewers == 1


def test_a_port_that_is_taken_is_told_with_the_remedy():
    with LivePage("one", FREE) as page:
        port = int(page.url.rstrip("/").rpartition(":")[2])
        with pytest.raises(ConfigurationError, match=rf"port {port} of .* is taken; --live-port 0 takes one"):
            LivePage("two", LiveOptions(port=port)).__enter__()


def test_an_address_of_another_machine_is_refused():
    with pytest.raises(ConfigurationError, match=r"cannot listen at 192\.0\.2\.1"):
        LivePage("one", LiveOptions(host="192.0.2.1", port=0)).__enter__()
