"""The greatest memory that this process has held, and how the C library keeps it low."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from pathlib import Path

_M_MMAP_THRESHOLD = -3  # of mallopt(3)
_LARGE_BLOCK_BYTES = 1 << 20


def find_peak_memory_bytes() -> int:
    """Return the greatest memory that this process has held, in bytes; 0 on Windows.

    `getrusage` may report the memory of the parent process, so /proc is read first.
    """
    if sys.platform == "win32":
        return 0
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    except (OSError, StopIteration, ValueError):
        import resource  # where there is no /proc

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else 1024 * peak


def return_large_blocks() -> None:
    """Let the C library give blocks of 1 MB and more back to the system as soon as they are freed, where it can.

    Of itself glibc gives back those alone that are larger than all freed before: after one unpacked block of a log the
    maps and all else up to 4 MB share one heap, of which 10 MB lie idle between what is in use.
    """
    if sys.platform == "linux":
        with suppress(AttributeError):  # another C library
            ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK_BYTES)


def return_freed_memory() -> None:
    """Return free memory between used blocks to the system, where the C library can; takes milliseconds."""
    if sys.platform == "linux":
        with suppress(AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
