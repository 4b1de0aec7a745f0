"""How much a file may grow to when it is read: one rule for every reader.

What is compressed may unpack to `LARGEST_RATIO` times its size, or to `ALWAYS_ALLOWED_BYTES` where that is more. What a
reader holds in memory at once is bounded beside that, by `limit_memory`, and is refused before it is allocated.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import final

from gridslam.errors import ArgumentError, InputError

LARGEST_RATIO = 100
"""Logs of scans shrink by a factor of 3 to 20, and one of a single scan, repeated under other stamps, by 50 to 60."""

ALWAYS_ALLOWED_BYTES = 1 << 25
"""32 MiB: a small file may consist of a single scan, repeated."""

DEFAULT_MEMORY_BYTES = 10**9

_max_memory = ContextVar("max_memory", default=DEFAULT_MEMORY_BYTES)


def max_memory_bytes() -> int:
    """Return the limit of the memory that a reader uses for one file."""
    return _max_memory.get()


@contextmanager
def limit_memory(size: int) -> Iterator[None]:
    """Let readers hold at most `size` bytes of a file in memory, within the context.

    Raises ArgumentError where `size` is below a megabyte.
    """
    if size < 10**6:
        raise ArgumentError("size", "at least 1,000,000 bytes", size)
    token = _max_memory.set(size)
    try:
        yield
    finally:
        _max_memory.reset(token)


def require_memory(path: str | Path, what: str, size: int) -> None:
    """Raise InputError, before allocation, where a part of a file needs more memory than allowed."""
    if size > (most := max_memory_bytes()):
        problem = f"{what} takes {describe_bytes(size)} of memory, more than the {describe_bytes(most)} of --max-memory"
        raise InputError(path, problem)


@final
class UnpackingLimit:
    """Remaining bytes that a file may unpack to, over one pass through it.

    Parameters
    ----------
    packed_bytes : int
        Size of the file.

    Attributes
    ----------
    total : int
        Bytes that it may unpack to.
    left : int
        What is left of them; negative once there were more.
    """

    def __init__(self, packed_bytes: int) -> None:
        self.total = self.left = max(LARGEST_RATIO * packed_bytes, ALWAYS_ALLOWED_BYTES)
        self._packed = packed_bytes

    @property
    def at_once(self) -> int:
        """Bytes that may be unpacked to memory at once; the excess is found by asking for one more."""
        return max(min(self.left, max_memory_bytes()), 0)

    @property
    def problem(self) -> str:
        """Message for a file that unpacks to more."""
        packed = f"{describe_bytes(self._packed)} unpack to more than"
        if self.at_once < self.left:
            return f"{packed} the {describe_bytes(max_memory_bytes())} of --max-memory"
        return f"{packed} {describe_bytes(self.total)}, which no healthy log does (if it is one, unpack it first)"

    def take(self, size: int) -> bool:
        """Count bytes that were unpacked; return whether they were allowed."""
        self.left -= size
        return self.left >= 0


def describe_bytes(size: int) -> str:
    """Return a size with its unit, such as 1.5 GB."""
    for unit, factor in (("GB", 10**9), ("MB", 10**6), ("KB", 10**3)):
        if size >= factor:
            return f"{size / factor:.3g} {unit}"
    return f"{size} bytes"
