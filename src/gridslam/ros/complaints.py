"""Throttled warnings: each problem is logged at most once per second."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import final

from gridslam.ros.messages import Level

__all__ = ["Complaints"]


@final
class Complaints:
    """Counts problems by kind, and reports each kind at most once in `every_s` seconds.

    Parameters
    ----------
    say : callable
        Reports to the user.
    every_s : float, s
        Between two sentences of one kind.
    clock : callable
        Time in s, ascending.

    Attributes
    ----------
    counts : Counter of str
        How often each kind happened.
    """

    def __init__(
        self, say: Callable[[Level, str], None], every_s: float = 1.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._say, self._every_s, self._clock = say, every_s, clock
        self._due: dict[str, float] = {}
        self._untold: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._last = "", 0.0

    def __call__(self, kind: str, problem: str) -> None:
        """Count one more problem of a kind, and report it if it is due."""
        now = self._clock()
        with self._lock:
            self.counts[kind] += 1
            self._last = f"{kind}: {problem}", now
            if now < self._due.get(kind, now):
                self._untold[kind] += 1
                return
            self._due[kind] = now + self._every_s
            more = self._untold.pop(kind, 0)
        self._say(Level.WARN, f"{kind}: {problem}" + (f" (and {more} times more before)" if more else ""))

    def latest(self, within_s: float) -> str:
        """The last problem, if there was one within the last seconds; else empty."""
        with self._lock:
            problem, when = self._last
            return problem if problem and self._clock() - when <= within_s else ""
