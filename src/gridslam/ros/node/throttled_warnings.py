"""Throttled warnings: each problem is logged at most once per second."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import final

from gridslam.ros.node.messages import Level

__all__ = ["ThrottledWarnings"]


@final
class ThrottledWarnings:
    """Counts problems by kind, and reports each kind at most once in `every_s` seconds.

    Parameters
    ----------
    log : callable
        Reports to the user.
    every_s : float, s
        Least time between two messages of one kind.
    clock : callable
        Monotonic time, s.

    Attributes
    ----------
    counts : Counter of str
        Number of problems of each kind.
    """

    def __init__(
        self, log: Callable[[Level, str], None], every_s: float = 1.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._log, self._every_s, self._clock = log, every_s, clock
        self._due: dict[str, float] = {}
        self._suppressed: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._last = "", 0.0

    def __call__(self, kind: str, problem: str) -> None:
        """Count one more problem of a kind, and report it if it is due."""
        now = self._clock()
        with self._lock:
            self.counts[kind] += 1
            self._last = f"{kind}: {problem}", now
            if now < self._due.get(kind, now):
                self._suppressed[kind] += 1
                return
            self._due[kind] = now + self._every_s
            suppressed = self._suppressed.pop(kind, 0)
        self._log(Level.WARN, f"{kind}: {problem}" + (f" (and {suppressed} more before)" if suppressed else ""))

    def latest(self, within_s: float) -> str:
        """Return the last problem within this many seconds; empty if there was none."""
        with self._lock:
            problem, when = self._last
            return problem if problem and self._clock() - when <= within_s else ""
