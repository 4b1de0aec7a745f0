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


def test_a_message_in_many_pieces_ends_the_line(page):
    with connected(page, HANDSHAKE) as line:
        assert line.recv(12) == b"HTTP/1.1 101"
        line.sendall(frame(1, b"{", is_last=False) + frame(0, b"", is_last=False) * 100)
        wait_until(lambda: not kept(page))
