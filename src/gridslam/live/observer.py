"""The filter's side: a pipeline observer that takes snapshots at a bounded rate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar, final

from gridslam.live.history import History
from gridslam.live.monitor import FilterMonitor, StateView
from gridslam.localization import LocalizationReport
from gridslam.pipeline import Stopwatch
from gridslam.types import LaserScan, Odometry, StepReport

VIEWED_PERIOD_S = 0.1
"""Time between snapshots with viewers, s."""
UNVIEWED_PERIOD_S = 1.0
"""Time between snapshots without viewers, s."""

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_MAX_WAIT_S = 0.25  # longer waits are split, so that signals are processed and the page stays fresh
_MAX_BEHIND_S = 1.0  # of a filter that is slower than the speed, which is not made up for
_FINAL_SNAPSHOT_S = 1.0  # to wait for the previous snapshot after the last scan, so that the page shows the end


@final
@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """State of a run after one scan; its arrays are never modified.

    Attributes
    ----------
    report : StepReport or LocalizationReport
        Report on that scan.
    view : StateView
        View of the filter's state after it.
    scan : LaserScan or None
        The scan, if it passed through `LiveObserver.pace`.
    scans, keys : int
        Number of scans and key scans.
    history : History
        The key scans until then, at least.
    progress : float
        Ratio of the log that is read, in [0, 1]; NaN if unknown.
    taken_s : float
        `time.perf_counter()` of the snapshot.
    """

    report: StepReport | LocalizationReport
    view: StateView
    scan: LaserScan | None
    scans: int
    keys: int
    history: History
    progress: float
    taken_s: float


@final
class LiveObserver:
    """Takes snapshots at a bounded rate and posts them; never waits for the receiver.

    A snapshot is taken only after the previous one is released (`release`), so a slow receiver gets fewer snapshots,
    each with all changes since the previous one.

    Parameters
    ----------
    post : callable
        Called with each snapshot in the filter's thread; must not block.
    monitor : FilterMonitor
        Monitor of the filter.
    speed : float or None, > 0
        Maximum factor on real time of the scans that pass through `pace`; None: as fast as possible.

    Attributes
    ----------
    speed : float or None
        As given; may be changed.
    period_s : float, s
        Least time between two snapshots; set by the server's thread.
    progress : callable
        Returns how much of the source is read, in [0, 1]; NaN where that is unknown.
    """

    def __init__(self, post: Callable[[Snapshot], None], monitor: FilterMonitor, speed: float | None = None) -> None:
        """Start before the first scan."""
        self.speed = speed
        self.period_s = UNVIEWED_PERIOD_S
        self.progress: Callable[[], float] = lambda: math.nan
        self._post = post
        self._monitor = monitor
        self._due = 0.0
        self._busy = False
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session."""
        self._history = History()
        self._scans = 0
        self._is_new = False
        self._scan: LaserScan | None = None
        self._latest: tuple[Any, Any] | None = None  # report and state
        self._anchor: tuple[float, int] | None = None  # a time and the corresponding stamp
        self._monitor.reset()

    def pace(self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None) -> Iterator[_Measured]:
        """Yield measurements at the given speed at most; the stopwatch does not count the waiting time."""
        watch = stopwatch or Stopwatch()
        for measurement in source:
            watch.lap("read")
            if self.speed is not None:
                self._wait(measurement[1].stamp_ns, self.speed)
                watch.resume()
            self._scan = measurement[1]
            yield measurement
        deadline = time.perf_counter() + _FINAL_SNAPSHOT_S
        while self._busy and time.perf_counter() < deadline:
            time.sleep(0.001)
        self._take_snapshot(time.perf_counter())

    def _wait(self, stamp_ns: int, speed: float) -> None:
        """Wait until the scan of this stamp is due."""
        now = time.perf_counter()
        begin, first_ns = self._anchor or (now, stamp_ns)
        due = begin + (stamp_ns - first_ns) * 1e-9 / speed
        if self._anchor is None or stamp_ns < first_ns or now - due > _MAX_BEHIND_S:
            self._anchor = now, stamp_ns
            return
        while (left := due - time.perf_counter()) > 0:
            self.take_pending_snapshot()
            time.sleep(min(left, _MAX_WAIT_S))

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record one scan, and take a snapshot if it is due."""
        self._scans += 1
        self._latest = (report, state)
        self._is_new = True
        self._monitor.record(report)
        if report.skipped is None:
            self._history.note_report(report, self._scans, seconds)
        if not self._busy and (now := time.perf_counter()) >= self._due:
            self._take_snapshot(now)

    def take_pending_snapshot(self) -> None:
        """Take a snapshot of pending changes while no scan arrives; call from the filter's thread."""
        if not self._busy and self._is_new:
            self._take_snapshot(time.perf_counter())

    def release(self) -> None:
        """Permit the next snapshot, after the last one was applied; thread-safe."""
        self._busy = False

    def _take_snapshot(self, now: float) -> None:
        if self._latest is None or self._busy:
            return
        self._due = max(self._due + self.period_s, now)
        self._busy = True
        self._is_new = False
        report, state = self._latest
        view = self._monitor.view(report, state)
        keys = len(self._history.stamps_ns)
        self._post(Snapshot(report, view, self._scan, self._scans, keys, self._history, self.progress(), now))
