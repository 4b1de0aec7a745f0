"""Ports for servers that a test starts in a process of their own."""

from __future__ import annotations

import random
import socket

_BELOW_EPHEMERAL = range(20_000, 32_000)
"""Where Linux (from 32768) and macOS and Windows (from 49152) take no port for the end of a connection: one of those
could be given away between the moment it was found free and the moment the server listens on it."""
_RANDOM = random.SystemRandom()


def free_port() -> int:
    """Return a TCP port of 127.0.0.1 on which nothing listens."""
    while True:
        port = _RANDOM.choice(_BELOW_EPHEMERAL)
        with socket.socket() as found:
            try:
                found.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
