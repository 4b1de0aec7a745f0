"""The greatest memory that this process has held."""

from __future__ import annotations

import sys
from pathlib import Path


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
