"""Cases of the page: what visitors send that no browser would, byte by byte, to a server of this machine.

A case holds what is sent over some connections. It passes where each of them is answered by a status below 500, or
closed, where nothing is reported, and where a visitor who asks meanwhile is answered within a second.
"""

from __future__ import annotations

import json
import logging
import re
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.errors import InputError
from gridslam.io.csv import write_csv_log
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.live.replay import Replay
from gridslam.live.server import PageServer
from support.broken_logs import OF_BYTES, damage, drive_about
from support.changes import choose

_LONGEST_STALL_S = 1.0
_PATIENCE_S = 0.15  # for an answer; most of what is malformed gets one at once
_PATHS = (
    "/", "/socket", "/app.js", "/index.html", "", "*", "//", "/.",
    "/..", "/../page.py", "/%2e%2e/page.py", "/..%2fpage.py", "/..%5cpage.py", "/%252e%252e/page.py", "/%c0%ae%c0%ae/",
    "/%00", "/app.js%00.html", "/%", "/%zz", "/%ff%fe", "/%ed%a0%80", "/socket/", "/app.js/", "/~", "/[",
    "http://127.0.0.1/", "http://[/", "http://evil.example/app.js", "///etc/passwd", "/" + "a" * 300, "/" + "a/" * 3000
)  # fmt: skip
_QUERIES = (
    "", "?", "?channel=0", "?channel=-1", "?channel=%D9%A3", "?channel=9999999999999", "?channel=1e9", "?token=x",
    "?token=%ff%00", "?" + "&" * 3000, "?a=" + "b" * 9000, "?channel=0&channel=1", "?%zz=%zz", "?[]"
)  # fmt: skip
_ORIGINS = "null", "http://[", "http://127.0.0.1", "http://", "://", "[", "\xff", "https://evil.example", "", "a" * 9000
_DIGIT = "\u0662".encode().decode("latin-1")  # an Arabic one
_VALUES = (
    "", " ", "[", "\xff\xfe", "\x80", "=?utf-8?q?=ff?=", "a" * 9000, "\x00", "\x7f", "\t", "%", "0", "-1", "1e999",
    _DIGIT, "9" * 5000, "bytes=0-", "bytes=-1", "bytes=1-0", "bytes=0-0,2-3", "bytes=" + "0-1," * 999, "bytes=a-b",
    "bytes", "bytes=" + "9" * 5000 + "-", "octets=0-1", "close", "upgrade", "keep-alive, Upgrade", "chunked",
    "gzip, chunked", "100-continue", "websocket", "h2c", "gzip;q=x", "*", 'W/"x"', "Sat, 99 Xxx 9999 99:99:99 GMT",
    "a=b; c", "13", "8", "$Version=1;\xff=\xff"
)  # fmt: skip
_NAMES = (
    "Range", "If-Range", "If-None-Match", "If-Modified-Since", "Cookie", "Origin", "Host", "Content-Length", "Expect",
    "Transfer-Encoding", "Connection", "Upgrade", "Accept-Encoding", "Content-Type", "Referer", "X", "X\xff", "X Y", "",
    "Sec-WebSocket-Key", "Sec-WebSocket-Version", "Sec-WebSocket-Extensions", "Sec-WebSocket-Protocol", "Forwarded"
)  # fmt: skip
_NUMBERS = 0, 1, -1, 3, 10**6, 2**63, 10**400, 1.5, 1e300, True, None, "0", "x", "\ud800", [], [[]], {}, {"at": 0}
_PAYLOADS = b"\xff\xfe", b"x" * 70_000, b"[" * 60_000, b"9" * 60_000, b"", b"null", b'{"do"'
_KINDS = "ack", "pause", "resume", "step", "seek", "speed", "robot", "fly", "", None, 0, [], {}
_COMMANDS = "set_pose", "locate", "reset", "save", "", None, 7, []


def page_requests(folder: Path) -> Iterator[tuple[str, Any, Any, float]]:
    """Name, the two functions and the weight of the family."""
    (folder / "page").mkdir(exist_ok=True)
    log = folder / "page" / "log.csv"
    write_csv_log(log, drive_about(30))
    result = map_log(log, configuration=Configuration(particles=3))
    result.save(folder / "page" / "out")
    (folder / "page" / "out" / "day.gridslam").write_bytes(bytes(300_000))
    yield "page: sockets", _write, partial(_visit, folder / "page" / "out", result), 2.0


def _write(to: Path, rng: np.random.Generator) -> None:
    """Write what is sent over some connections, at once and after the first answer, and to what content."""
    sent = [[part.decode("latin-1") for part in _make_socket(rng)] for _ in range(4)]
    (to / "case.json").write_text(json.dumps({"content": choose(rng, ("replay", "live")), "sent": sent}))


def _join(line: str, headers: list[tuple[str, str]]) -> bytes:
    return "\r\n".join([line, *(f"{name}: {value}" for name, value in headers), "", ""]).encode("latin-1")


def _make_socket(rng: np.random.Generator) -> tuple[bytes, bytes]:
    """Return a handshake, healthy or not, and frames."""
    healthy = {
        "Host": "127.0.0.1",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Version": "13",
    }
    headers = dict(healthy)
    what = rng.integers(8)
    if what == 0:
        headers[choose(rng, list(healthy))] = choose(rng, _VALUES)
    elif what == 1:
        del headers[choose(rng, list(healthy))]
    elif what == 2:
        headers["Origin"] = choose(rng, _ORIGINS)
    elif what == 3:
        headers[choose(rng, _NAMES)] = choose(rng, _VALUES)
    target = "/socket" + choose(rng, _QUERIES) if rng.integers(6) else choose(rng, _PATHS)
    handshake = _join(f"GET {target} HTTP/1.1", list(headers.items()))
    frames = b"".join(_make_frames(rng) for _ in range(rng.integers(1, 12)))
    return handshake, damage(frames, OF_BYTES, rng)[0] if frames and rng.integers(5) == 0 else frames


def _make_frames(rng: np.random.Generator) -> bytes:
    """Return frames of one message: a command, or what is none."""
    what = rng.integers(10)
    text = json.dumps(_make_command(rng)).encode()
    if what < 5:
        return _frame(1, text)
    if what == 5:  # more than is executed
        return b"".join(_frame(1, json.dumps({"do": "seek", "at": int(k)}).encode()) for k in range(rng.integers(300)))
    if what == 6:
        return _frame(1, text[:3], fin=False) + b"".join(
            [_frame(0, b"", fin=False) * int(choose(rng, (0, 1, 100))), _frame(0, text[3:])]
        )
    if what == 7:
        return _frame(9, bytes(int(choose(rng, (0, 125, 126, 5000))))) * int(rng.integers(1, 200))
    if what == 8:
        return _frame(int(rng.integers(16)), rng.bytes(int(rng.integers(200))), fin=bool(rng.integers(2)))
    payload = choose(rng, (*_PAYLOADS, rng.bytes(50)))
    return _frame(int(choose(rng, (1, 2, 8))), payload, masked=bool(rng.integers(5)))


def _make_command(rng: np.random.Generator) -> Any:
    if rng.integers(8) == 0:
        return choose(rng, _NUMBERS)
    command = {"do": choose(rng, _KINDS)}
    for name, values in (("at", _NUMBERS), ("factor", _NUMBERS), ("particle", _NUMBERS), ("pose", _NUMBERS)):
        if rng.integers(2):
            command[name] = choose(rng, values)
    return command | ({"command": choose(rng, _COMMANDS)} if rng.integers(2) else {})


def _frame(opcode: int, payload: bytes, *, fin: bool = True, masked: bool = True) -> bytes:
    """Return a frame; the mask is zero, which is allowed."""
    size = len(payload)
    head = bytes([opcode | 0x80 * fin])
    if size < 126:
        head += bytes([size | 0x80 * masked])
    elif size < 1 << 16:
        head += bytes([126 | 0x80 * masked]) + struct.pack(">H", size)
    else:
        head += bytes([127 | 0x80 * masked]) + struct.pack(">Q", size)
    return head + bytes(4 * masked) + payload


def _visit(out: Path, result: Any, where: Path) -> None:
    """Send all that there is to a page while another visitor asks for it again and again."""
    case = json.loads((where / "case.json").read_text())
    with ExitStack() as stack:
        reports = stack.enter_context(_reports())
        page = stack.enter_context(_serve(case["content"], out, result))
        port = int(page.url.rstrip("/").rpartition(":")[2])
        waits = stack.enter_context(_watch(port))
        parts = [[part.encode("latin-1") for part in sent] for sent in case["sent"]]
        answers = [*stack.enter_context(ThreadPoolExecutor()).map(lambda sent: _send(port, *sent), parts)]
    assert not reports, reports[0]
    assert max(waits) < _LONGEST_STALL_S, f"another visitor waited for {max(waits):.1f} s"
    statuses = [int(status) for answer in answers for status in re.findall(rb"HTTP/1\.1 (\d{3}) ", answer)]
    assert max(statuses, default=0) < 500, f"status {max(statuses)}"
    if not any(status < 400 for status in statuses):
        raise InputError(where, f"refused: {statuses}")


def _serve(content: str, out: Path, result: Any) -> PageServer | LivePage:
    if content == "replay":
        return PageServer(Replay(out), LiveOptions(port=0))
    page = LivePage("drive", LiveOptions(port=0))
    page._run.finish(result.map, result.graph.poses, np.zeros((0, 4)))
    return page


@contextmanager
def _reports() -> Iterator[list[str]]:
    """Give what is logged, and what fails in any thread."""
    found: list[str] = []
    handler = logging.Handler(logging.WARNING)

    def note(record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        if error is not None and not isinstance(error, UnicodeDecodeError):  # of a message, which the server refuses
            found.append(f"{record.name}: {record.getMessage()} {error!r}")

    handler.emit = note  # type: ignore[method-assign]
    logging.getLogger().addHandler(handler)
    sys.unraisablehook = lambda failed: found.append(f"unraisable {failed.exc_value!r}")
    threading.excepthook = lambda failed: found.append(f"in a thread: {failed.exc_value!r}")
    configured = logging.Logger.setLevel
    logging.Logger.setLevel = lambda self, level: None  # type: ignore[method-assign] uvicorn is to be silent
    try:
        yield found
    finally:
        logging.Logger.setLevel = configured  # type: ignore[method-assign]


@contextmanager
def _watch(port: int) -> Iterator[list[float]]:
    """Ask for the page again and again; gives how long each answer took, s."""
    waits: list[float] = []
    ended = threading.Event()

    def ask() -> None:
        while not ended.is_set():
            start = time.monotonic()
            request = _join("GET / HTTP/1.1", [("Host", "127.0.0.1"), ("Connection", "close")])
            answer = _send(port, request, patience_s=5.0)
            assert answer.startswith(b"HTTP/1.1 200 "), f"another visitor got {answer[:60]!r}"
            waits.append(time.monotonic() - start)
            ended.wait(0.02)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield waits
    finally:
        ended.set()
        thread.join()


def _send(port: int, first: bytes, rest: bytes = b"", *, patience_s: float = _PATIENCE_S) -> bytes:
    """Return what comes back until the connection is closed, or nothing comes for a while."""
    answer = b""
    with socket.create_connection(("127.0.0.1", port), timeout=5.0) as line, suppress(OSError):
        line.settimeout(patience_s)
        until = time.monotonic() + 3 * patience_s  # the heartbeats of a socket never end
        for sent in filter(None, (first, rest)):
            threading.Thread(target=_write_all, args=(line, sent), daemon=True).start()
            while time.monotonic() < until and (part := line.recv(1 << 16)):
                answer += part
                if sent is first and rest:
                    break
    return answer


def _write_all(line: socket.socket, sent: bytes) -> None:
    with suppress(OSError):
        line.sendall(sent)
