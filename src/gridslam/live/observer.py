"""The filter's side: a pipeline observer that takes snapshots at a bounded rate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar, final

from gridslam.live.control import Control
from gridslam.live.history import History
from gridslam.live.history_recorder import HistoryRecorder
from gridslam.live.monitor import FilterMonitor, LocalizationMonitor, StateView
from gridslam.localization import LocalizationReport
from gridslam.pipeline import Stopwatch
from gridslam.types import LaserScan, Odometry, StepReport

VIEWED_PERIOD_S = 0.1
"""Time between snapshots with viewers, s."""
UNVIEWED_PERIOD_S = 1.0
"""Time between snapshots without viewers, s."""

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
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
        The past until then, at least.
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
    control : Control
        Delays the scans that pass through `pace`.
    monitor : FilterMonitor
        Monitor of the filter.
    history : HistoryRecorder, optional
        Records the past that viewers may go back to.

    Attributes
    ----------
    period_s : float, s
        Least time between two snapshots; set by the server's thread.
    progress : callable
        Returns how much of the source is read, in [0, 1]; NaN where that is unknown.
    """

    def __init__(
        self,
        post: Callable[[Snapshot], None],
        control: Control,
        monitor: FilterMonitor,
        history: HistoryRecorder | None = None,
    ) -> None:
        """Start before the first scan."""
        is_localization = isinstance(monitor, LocalizationMonitor)
        self.history = history or HistoryRecorder(is_localization=is_localization)
        self.period_s = UNVIEWED_PERIOD_S
        self.progress: Callable[[], float] = lambda: math.nan
        self._post = post
        self._control = control
        self._monitor = monitor
        self._due = 0.0
        self._busy = False
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session."""
        self._scans = 0
        self._is_new = False
        self._scan: LaserScan | None = None
        self._latest: tuple[Any, Any] | None = None  # report and state
        self._monitor.reset()
        self.history.reset()

    def pace(self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None) -> Iterator[_Measured]:
        """Yield measurements at the pace that the viewers set; the stopwatch does not count the waiting time."""
        watch = stopwatch or Stopwatch()
        for measurement in source:
            watch.lap("read")
            if self._control.wait(measurement[1].stamp_ns, self.take_pending_snapshot):
                watch.resume()
            self._note_scan(measurement[1])
            yield measurement
        deadline = time.perf_counter() + _FINAL_SNAPSHOT_S
        while self._busy and time.perf_counter() < deadline:
            time.sleep(0.001)
        self._take_snapshot(time.perf_counter())

    def follow(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """Yield the measurements of a source without delay."""
        for measurement in source:
            self._note_scan(measurement[1])
            yield measurement

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record one scan, and take a snapshot if it is due."""
        self._scans += 1
        self._latest = (report, state)
        self._is_new = True
        self.history(report, state, seconds)
        self._monitor.record(report)
        if report.skipped is None:
            self._control.on_key_scan()
        if not self._busy and (now := time.perf_counter()) >= self._due:
            self._take_snapshot(now)

    def take_pending_snapshot(self) -> None:
        """Take a snapshot of pending changes while no scan arrives; call from the filter's thread."""
        if not self._busy and self._is_new:
            self._take_snapshot(time.perf_counter())

    def _note_scan(self, scan: LaserScan) -> None:
        self._scan = scan
        self.history.note_scan(scan)

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
        history = self.history.history
        keys = len(history.stamps_ns)
        self._post(Snapshot(report, view, self._scan, self._scans, keys, history, self.progress(), now))
