"""The messages of a run: each with its level, its times and how often it came."""

from __future__ import annotations

import re
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, final

_NUMBER: Final = re.compile(r"\d+")
_MOST = 256
_NAMES: Final = ("info", "warning", "error")


class Level(IntEnum):
    """Severity, with the values of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@final
class Messages:
    """Messages of a run, kept for the page and passed to its log.

    Messages are the same if they differ only in their numbers: the newest wording is kept, and how often it came. Of
    more than 256 different ones the oldest of the least level is forgotten.

    Of the problems of one kind at most one in `every_s` is logged.

    Parameters
    ----------
    log : callable
        Reports to the user.
    every_s : float, s
        Least time between two problems of one kind in the log.
    clock : callable
        Monotonic time, s.
    now_s : callable
        Time since 1970, s.

    Attributes
    ----------
    counts : Counter of str
        Number of problems of each kind.
    """

    def __init__(
        self,
        log: Callable[[Level, str], None],
        every_s: float = 10.0,
        clock: Callable[[], float] = time.monotonic,
        now_s: Callable[[], float] = time.time,
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._log = log
        self._every_s = every_s
        self._clock = clock
        self._now_s = now_s
        self._due_s = defaultdict[str, float](float)  # of a kind
        self._kept: dict[str, _Message] = {}  # in the order of their last occurrence
        self._suppressed: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._problem: _Message | None = None

    def report(self, level: Level, text: str, *, is_state: bool = False) -> None:
        """Keep a message, and log it each time that it comes; a state of the run lasts until the next one."""
        with self._lock:
            self._keep(level, text, self._clock()).is_state |= is_state
        self._log(level, text)

    def __call__(self, kind: str, problem: str) -> None:
        """Count one more problem of a kind, keep it as a warning, and log it if it is due."""
        now = self._clock()
        text = f"{kind}: {problem}"
        with self._lock:
            self.counts[kind] += 1
            self._problem = self._keep(Level.WARN, text, now)
            if now < self._due_s[kind]:
                self._suppressed[kind] += 1
                return
            self._due_s[kind] = now + self._every_s
            suppressed = self._suppressed.pop(kind, 0)
        self._log(Level.WARN, text + (f" (and {suppressed} more before)" if suppressed else ""))

    def latest_problem(self, within_s: float) -> str:
        """Return the last problem within this many seconds; empty if there was none."""
        with self._lock:
            problem = self._problem
            return problem.text if problem is not None and self._clock() - problem.seen_s <= within_s else ""

    def to_list(self) -> list[dict[str, Any]]:
        """Return the messages as JSON values, the newest first.

        Each has `level` ("info", "warning" or "error"), `text`, `count`, `first_s` and `last_s` (since 1970, s), and
        `state`: whether it is a state in which the run was from then on.
        """
        with self._lock:
            return [message.to_dict() for message in reversed(self._kept.values())]

    def _keep(self, level: Level, text: str, now: float) -> _Message:
        """Keep a message, counted with those before, and return it."""
        name = _NUMBER.sub("#", text)
        kept = self._kept.pop(name, None)
        if kept is None:
            kept = _Message(level, text, self._now_s())
        kept.level, kept.text, kept.last_s, kept.seen_s = level, text, self._now_s(), now
        kept.count += 1
        self._kept[name] = kept
        if len(self._kept) > _MOST:
            least = min(message.level for message in self._kept.values())
            del self._kept[next(name for name, message in self._kept.items() if message.level == least)]
        return kept


@dataclass(slots=True)
class _Message:
    """A message, its first and last time since 1970, s, and its last time by the monotonic clock."""

    level: Level
    text: str
    first_s: float
    last_s: float = 0.0
    seen_s: float = 0.0
    count: int = 0
    is_state: bool = False

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "level": _NAMES[self.level],
            "text": self.text,
            "count": self.count,
            "first_s": round(self.first_s, 3),
            "last_s": round(self.last_s, 3),
            "state": self.is_state,
        }
