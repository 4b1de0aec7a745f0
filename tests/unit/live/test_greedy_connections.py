"""Visitors who send and never read, or send what no browser does, take little memory, and do not stay."""

from __future__ import annotations

import socket
import time
from contextlib import contextmanager

import pytest

from gridslam.live import connections
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage

HANDSHAKE = (
    b"GET /socket HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


@pytest.fixture
def page():
    with LivePage("test", LiveOptions(port=0)) as served:
        yield served


@contextmanager
def connected(page, sent):
    with socket.socket() as line:
        line.settimeout(10)
        line.connect(("127.0.0.1", int(page.url.rstrip("/").rpartition(":")[2])))
        line.sendall(sent)
        yield line


def kept(page):
    return page._server._server.server_state.connections


def frame(opcode, payload, is_last=True):
    """Masked by zeros."""
    return bytes([opcode | 0x80 * is_last, 0x80 | len(payload)]) + bytes(4) + payload


def wait_until(condition, at_most_s=10.0):
    until = time.monotonic() + at_most_s
    while not condition():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.01)


def test_who_never_reads_is_dropped_and_who_reads_slowly_is_not(monkeypatch, tmp_path):
    monkeypatch.setattr(connections, "_STALL_S", 0.6)
    (tmp_path / "day.gridslam").write_bytes(bytes(60_000_000))
    with LivePage("test", LiveOptions(port=0)) as page:
        page.offer_session(tmp_path / "day.gridslam")
        request = b"GET /session.gridslam HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        with connected(page, request), connected(page, request) as slow:
            wait_until(lambda: len(kept(page)) == 2)
            until = time.monotonic() + 2.5
            while time.monotonic() < until:
                slow.recv(1 << 14)
                time.sleep(0.002)
            assert len(kept(page)) == 1


def test_answers_to_pings_do_not_pile_up(page):
    with connected(page, HANDSHAKE) as line:
        assert line.recv(12) == b"HTTP/1.1 101"
        for _ in range(1000):
            line.sendall(frame(9, bytes(125)) * 100)  # 13 MB, of which the system keeps some
        time.sleep(0.2)
        (connection,) = kept(page)
        assert connection.transport.get_write_buffer_size() < 1 << 20


def test_a_message_in_many_pieces_ends_the_line(page):
    with connected(page, HANDSHAKE) as line:
        assert line.recv(12) == b"HTTP/1.1 101"
        line.sendall(frame(1, b"{", is_last=False) + frame(0, b"", is_last=False) * 100)
        wait_until(lambda: not kept(page))


def test_little_is_taken_of_a_connection_before_it_is_the_turn_of_others(page, monkeypatch):
    """256 KB of small frames, as many as there were, took the loop for seconds."""
    sizes = []
    receive = connections.LimitedSocket.data_received
    monkeypatch.setattr(
        connections.LimitedSocket, "data_received", lambda self, data: sizes.append(len(data)) or receive(self, data)
    )
    with connected(page, HANDSHAKE) as line:
        assert line.recv(12) == b"HTTP/1.1 101"
        line.sendall(frame(10, b"") * 50_000)
        wait_until(lambda: sum(sizes) >= 300_000)
    assert max(sizes) <= 1 << 14
