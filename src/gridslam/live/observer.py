"""The filter's side: an observer of the pipeline that now and then takes a snapshot of what can be seen."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar, final

from gridslam.live.control import Control, RobotControl
from gridslam.live.monitor import LOST, FilterMonitor, ScanReport, StateView
from gridslam.pipeline import Stopwatch
from gridslam.types import LaserScan, Odometry

__all__ = ["UNVIEWED_PERIOD_S", "VIEWED_PERIOD_S", "LiveObserver", "Snapshot"]

VIEWED_PERIOD_S, UNVIEWED_PERIOD_S = 0.1, 1.0
"""Time between snapshots while somebody looks, and while nobody does, s."""

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_FINAL_SNAPSHOT_S = 1.0  # after the last scan the snapshot before is waited for, so that the page has the end


@final
@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What can be seen of a run after one scan; arrays in it are never written to.

    Attributes
    ----------
    report : ScanReport
        Of that scan.
    view : StateView
        Of the filter's state after it.
    scan : LaserScan or None
        The scan, where it went through `LiveObserver.pace`.
    scans, keys : int
        How many scans and key scans there were.
    series : list of (float, float, float, int, int)
        Of each key scan since the last snapshot its stamp, s, effective sample size, latency, s, flags, and the number
        of particles.
    progress : float
        How much of the log is read, in [0, 1]; NaN where that is unknown.
    taken_s : float
        `time.perf_counter()` of the snapshot.
    """

    report: ScanReport
    view: StateView
    scan: LaserScan | None
    scans: int
    keys: int
    series: list[tuple[float, float, float, int, int]]
    progress: float
    taken_s: float


@final
class LiveObserver:
    """Takes snapshots at a bounded rate and hands them over; never waits for who takes them.

    A snapshot is taken only once the one before is done with (`release`), so a slow reader gets fewer of them, each of
    which brings all that has changed since.

    Parameters
    ----------
    post : callable
        Gets each snapshot, on the filter's thread, and returns at once.
    control : Control or RobotControl
        Holds back the scans that come through `pace`.
    monitor : FilterMonitor
        What there is to see of this filter.

    Attributes
    ----------
    period_s : float, s
        Least time between two snapshots; set by whoever knows whether somebody looks.
    progress : callable
        Tells how much of the source is read, in [0, 1]; NaN where that is unknown.
    """

    def __init__(
        self, post: Callable[[Snapshot], None], control: Control | RobotControl, monitor: FilterMonitor[Any, Any]
    ) -> None:
        """Begin before the first scan."""
        self.period_s = UNVIEWED_PERIOD_S
        self.progress: Callable[[], float] = lambda: math.nan
        self._post, self._control, self._monitor = post, control, monitor
        self._due, self._busy = 0.0, False
        self.reset()

    def reset(self) -> None:
        """Begin before the first scan, with another state than that looked at until now."""
        self._scans = self._keys = 0
        self._is_new = False
        self._scan: LaserScan | None = None
        self._latest: tuple[ScanReport, Any] | None = None
        self._series: list[tuple[float, float, float, int, int]] = []
        self._requests: deque[tuple[int, int, int]] = deque()
        self._monitor.reset()

    def pace(self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None) -> Iterator[_Measured]:
        """The measurements of a source, each when the viewers want it; waiting counts for no stage of the stopwatch."""
        for measurement in source:
            if stopwatch is not None:
                stopwatch.lap("read")
            waited = self._control.wait(measurement[1].stamp_ns, self.take_pending_snapshot)
            if waited and stopwatch is not None:
                stopwatch.resume()
            self._scan = measurement[1]
            yield measurement
        deadline = time.perf_counter() + _FINAL_SNAPSHOT_S
        while self._busy and time.perf_counter() < deadline:
            time.sleep(0.001)
        self._take_snapshot(time.perf_counter())

    def follow(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """The measurements of a source that nobody holds back."""
        for measurement in source:
            self._scan = measurement[1]
            yield measurement

    def __call__(self, report: ScanReport, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Take note of one scan, and a snapshot if it is time."""
        self._scans += 1
        self._latest, self._is_new = (report, state), True
        flags = LOST * report.lost | self._monitor.record(report, self._scan)
        if report.skipped is None:
            self._keys += 1
            count = 0 if report.poses is None else len(report.poses)
            self._series.append((report.stamp_ns * 1e-9, report.n_eff, seconds, flags, count))
            self._control.on_key_scan()
        if not self._busy and (now := time.perf_counter()) >= self._due:
            self._take_snapshot(now)

    def take_pending_snapshot(self) -> None:
        """Take a snapshot of what is new while no scan comes; in the filter's thread."""
        if not self._busy and (self._is_new or self._requests):
            self._take_snapshot(time.perf_counter())

    def show_particle(self, channel: int, particle: int, keys: int) -> None:
        """Show the map of a particle, and of who continues it, as `channel`; called by any thread.

        `particle` is its index after so many key scans; -1 ends the channel.
        """
        self._requests.append((channel, particle, keys))
        self._control.wake()

    def release(self) -> None:
        """The last snapshot has been taken over; called by any thread."""
        self._busy = False

    def _take_snapshot(self, now: float) -> None:
        if self._latest is None or self._busy:
            return
        self._due, self._busy, self._is_new = max(self._due + self.period_s, now), True, False
        while self._requests:
            self._monitor.show_particle(*self._requests.popleft())
        report, state = self._latest
        view = self._monitor.view(report, state)
        series, self._series = self._series, []
        self._post(Snapshot(report, view, self._scan, self._scans, self._keys, series, self.progress(), now))
