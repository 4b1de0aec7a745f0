"""Warnings that are reported when they are new, and less and less often while they last."""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Final, final

from gridslam.ros.node.messages import Level

__all__ = ["ThrottledWarnings"]

_NUMBER: Final = re.compile(r"\d+")
_QUIET_S = 10.0  # after this long without it a problem is new again
_LONGEST_S = 60.0
_MAX_PROBLEMS = 256


@final
class ThrottledWarnings:
    """Counts problems by kind, and reports each kind at most once in `every_s` seconds.

    A problem that lasts is reported after `every_s`, then after twice that, four times, and so on up to a minute.
    Problems are the same if they differ only in their numbers.

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
        self._log = log
        self._every_s = every_s
        self._clock = clock
        self._due: dict[str, float] = {}  # of a kind
        self._problems: dict[str, _Problem] = {}  # in the order of their last occurrence
        self._suppressed: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._last = ("", 0.0)

    def __call__(self, kind: str, problem: str) -> None:
        """Count one more problem of a kind, and report it if it is due."""
        now = self._clock()
        with self._lock:
            self.counts[kind] += 1
            self._last = f"{kind}: {problem}", now
            same = self._find(f"{kind}: {problem}", now)
            if now < max(self._due.get(kind, now), same.due_s):
                self._suppressed[kind] += 1
                return
            self._due[kind] = now + self._every_s
            same.back_off(now)
            suppressed = self._suppressed.pop(kind, 0)
        self._log(Level.WARN, f"{kind}: {problem}" + (f" (and {suppressed} more before)" if suppressed else ""))

    def latest(self, within_s: float) -> str:
        """Return the last problem within this many seconds; empty if there was none."""
        with self._lock:
            problem, when = self._last
            return problem if problem and self._clock() - when <= within_s else ""

    def _find(self, text: str, now: float) -> _Problem:
        """Return what is known of a problem; a new one after some time without it."""
        name = _NUMBER.sub("#", text)
        found = self._problems.pop(name, None)
        if found is None or now - found.last_s > _QUIET_S:
            found = _Problem(now, self._every_s)
        found.last_s = now
        self._problems[name] = found
        if len(self._problems) > _MAX_PROBLEMS:
            del self._problems[next(iter(self._problems))]
        return found


class _Problem:
    """When a problem was last seen, and when it is due again."""

    __slots__ = ("_interval_s", "due_s", "last_s")

    def __init__(self, now: float, interval_s: float) -> None:
        self.last_s = self.due_s = now
        self._interval_s = interval_s

    def back_off(self, now: float) -> None:
        """Set the time of the next report; the one after that takes twice as long."""
        self.due_s = now + self._interval_s
        self._interval_s = min(2 * self._interval_s, _LONGEST_S)
