"""The filter's side: a pipeline observer that takes snapshots at a bounded rate."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, TypeVar, final

from gridslam.live.protocol import Float32Array
from gridslam.live.recorder import RunRecorder
from gridslam.live.scene import Frame, finite_or_none
from gridslam.live.tiles import TileReplica
from gridslam.pipeline import Stopwatch
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import LaserScan, Odometry

VIEWED_PERIOD_S = 0.1
"""Time between snapshots with viewers, s."""
UNVIEWED_PERIOD_S = 1.0
"""Time between snapshots without viewers, s."""

_RATE_SNAPSHOTS = 12
_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_MAX_WAIT_S = 0.25  # longer waits are split, so that signals are processed and the page stays fresh
_MAX_BEHIND_S = 1.0  # of a filter that is slower than the speed, which is not made up for
_FINAL_SNAPSHOT_S = 1.0  # to wait for the previous snapshot after the last scan, so that the page shows the end


@final
class Snapshot(NamedTuple):
    """State of a run after one scan; its arrays are never modified.

    Attributes
    ----------
    status : dict
        Values for the page, as JSON values.
    frame : Frame
        Path, particles and loop closures.
    scan : (K, 2) float32, m
        End points of the scan in the robot frame.
    series : (S, 5) float32
        Figures of the key scans so far, as in a scene.
    replica : TileReplica
        The map of the best particle, which follows the filter; empty for a known map.
    resolution_m : float or None, m
        Side of its cells; None for a known map.
    """

    status: dict[str, Any]
    frame: Frame
    scan: Float32Array
    series: Float32Array
    replica: TileReplica
    resolution_m: float | None


@final
class LiveObserver:
    """Takes snapshots at a bounded rate and posts them; never waits for the receiver.

    A snapshot is taken only after the previous one is released (`release`), so a slow receiver gets fewer snapshots,
    each with all changes since the previous one.

    Parameters
    ----------
    post : callable
        Called with each snapshot in the filter's thread; must not block.
    recorder : RunRecorder
        Records the run.
    speed : float or None, > 0
        Maximum factor on real time of the scans that pass through `pace`; None: as fast as possible.

    Attributes
    ----------
    speed : float or None
        As given; may be changed.
    recorder : RunRecorder
        As given; called with each scan.
    period_s : float, s
        Least time between two snapshots; set by the server's thread.
    progress : callable
        Returns how much of the source is read, in [0, 1]; NaN where that is unknown.
    """

    def __init__(self, post: Callable[[Snapshot], None], recorder: RunRecorder, speed: float | None = None) -> None:
        """Start before the first scan."""
        self.speed = speed
        self.period_s = UNVIEWED_PERIOD_S
        self.progress: Callable[[], float] = lambda: math.nan
        self._post = post
        self.recorder = recorder
        self._due = 0.0
        self._busy = False
        self._reset()

    def _reset(self) -> None:
        """Start before the first scan of a new session."""
        self._rate_window: deque[tuple[float, int, float]] = deque(maxlen=_RATE_SNAPSHOTS)
        self._is_new = False
        self._latest: tuple[Any, Any] | None = None  # report and state
        self._anchor: tuple[float, int] | None = None  # a time and the corresponding stamp

    def pace(self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None) -> Iterator[_Measured]:
        """Start a new session, and yield its measurements at the given speed at most.

        The stopwatch does not count the waiting time.
        """
        self._reset()
        return self.recorder.follow(self._delay(source, stopwatch or Stopwatch()))

    def _delay(self, source: Iterable[_Measured], watch: Stopwatch) -> Iterator[_Measured]:
        for measurement in source:
            watch.lap("read")
            if self.speed is not None:
                self._wait(measurement[1].stamp_ns, self.speed)
                watch.resume()
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
        self.recorder(report, state, seconds)
        self._latest = (report, state)
        self._is_new = True
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
        recorder = self.recorder
        frame = recorder.view(report, state)
        status = self._describe(report, now)
        resolution_m = None
        if isinstance(state, GridFastSlamState):
            resolution_m = state.maps.resolution_m
            closures = len(recorder.history.closures)
            status |= {
                "particles": len(state.poses),
                "best": state.best,
                "closures": closures,
                "bytes": state.maps.nbytes,
            }
        else:
            names = "particles", "looking", "lost_probability", "inlier_ratio"
            status |= {name: getattr(report, name) for name in names}
        series = recorder.history.series
        self._post(Snapshot(status, frame, recorder.scan_ends(), series, recorder.replica, resolution_m))

    def _describe(self, report: Any, now: float) -> dict[str, Any]:  # noqa: ANN401
        """Return the values for the page that filters of both kinds have."""
        history, scans = self.recorder.history, self.recorder.scans
        keys = len(history.stamps_ns)
        stamp_s = report.stamp_ns * 1e-9
        self._rate_window.append((now, scans, stamp_s))
        wall_s, passed, log_s = (b - a for a, b in zip(self._rate_window[0], self._rate_window[-1], strict=True))
        return {
            "scans": scans,
            "keys": keys,
            "time_s": stamp_s - 1e-9 * history.stamps_ns[0] if keys else 0.0,
            "pose": report.pose.tolist(),
            "covariance": report.covariance.tolist(),
            "lost": bool(report.lost),
            "n_eff": finite_or_none(float(history.series[-1, 1])) if keys else None,
            "progress": finite_or_none(self.progress()),
            "real_time_factor": log_s / wall_s if wall_s > 0 and passed else None,
        }
