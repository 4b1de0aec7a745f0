"""Ctrl-C and SIGTERM: the run ends, and what it was about to write is taken back."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

__all__ = ["handle_signals", "stop_if_interrupted"]

_pending = False


@contextmanager
def handle_signals() -> Iterator[None]:
    """Turn the first SIGINT or SIGTERM into KeyboardInterrupt; later ones must not disturb the cleaning up."""
    global _pending
    _pending = False
    before = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    global _pending
    if not _pending:
        _pending = True
        raise KeyboardInterrupt


def stop_if_interrupted() -> None:
    """Repeat an interrupt which came while a destructor ran: Python swallows it there."""
    if _pending:
        raise KeyboardInterrupt
