"""The filter's side: a pipeline observer that shows the run at a bounded rate."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, final

from gridslam.live.recorder import Measured, RunRecorder
from gridslam.live.scene import Scene, finite_or_none
from gridslam.pipeline import Stopwatch
from gridslam.slam.grid_fastslam.state import GridFastSlamState

VIEWED_PERIOD_S = 0.1
"""Time between two scenes with viewers, s."""
UNVIEWED_PERIOD_S = 1.0
"""Time between two scenes without viewers, s."""

_RATE_SCENES = 12
_MAX_WAIT_S = 0.25  # longer waits are split, so that signals are processed and the page stays fresh
_MAX_BEHIND_S = 1.0  # of a filter that is slower than the speed, which is not made up for


@final
class LiveObserver:
    """Records a run, and shows it as it is at a bounded rate.

    Parameters
    ----------
    show : callable
        Called with each scene in the filter's thread; its `run_info` has only what was not known before the first scan,
        its replica is empty for a known map. Must not block.
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
        Least time between two scenes; set by the server's thread.
    progress : callable
        Returns how much of the source is read, in [0, 1]; NaN where that is unknown.
    """

    def __init__(self, show: Callable[[Scene], None], recorder: RunRecorder, speed: float | None = None) -> None:
        """Start before the first scan."""
        self.speed = speed
        self.period_s = UNVIEWED_PERIOD_S
        self.progress: Callable[[], float] = lambda: math.nan
        self._show = show
        self.recorder = recorder
        self._due = 0.0
        self._reset()

    def _reset(self) -> None:
        """Start before the first scan of a new session."""
        self._rate_window: deque[tuple[float, int, float]] = deque(maxlen=_RATE_SCENES)
        self._latest: tuple[Any, Any] | None = None  # report and state that are not shown yet
        self._anchor: tuple[float, int] | None = None  # a time and the corresponding stamp

    def pace(self, source: Iterable[Measured], stopwatch: Stopwatch | None = None) -> Iterator[Measured]:
        """Start a new session, and yield its measurements at the given speed at most.

        The stopwatch does not count the waiting time.
        """
        self._reset()
        return self.recorder.follow(self._delay(source, stopwatch or Stopwatch()))

    def _delay(self, source: Iterable[Measured], watch: Stopwatch) -> Iterator[Measured]:
        for measurement in source:
            watch.lap("read")
            if self.speed is not None:
                self._wait(measurement[1].stamp_ns, self.speed)
                watch.resume()
            yield measurement
        self.show_pending()

    def _wait(self, stamp_ns: int, speed: float) -> None:
        """Wait until the scan of this stamp is due."""
        now = time.perf_counter()
        begin, first_ns = self._anchor or (now, stamp_ns)
        due = begin + (stamp_ns - first_ns) * 1e-9 / speed
        if self._anchor is None or stamp_ns < first_ns or now - due > _MAX_BEHIND_S:
            self._anchor = now, stamp_ns
            return
        while (left := due - time.perf_counter()) > 0:
            self.show_pending()
            time.sleep(min(left, _MAX_WAIT_S))

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record one scan, and show the run if it is due."""
        self.recorder(report, state, seconds)
        self._latest = (report, state)
        if time.perf_counter() >= self._due:
            self.show_pending()

    def show_pending(self) -> None:
        """Show the run after the last scan, unless that is shown; call from the filter's thread."""
        if self._latest is None:
            return
        now = time.perf_counter()
        self._due = max(self._due + self.period_s, now)
        report, state = self._latest
        self._latest = None
        recorder = self.recorder
        frame = recorder.view(report, state)
        status = self._describe(report, now)
        run_info = {}
        if isinstance(state, GridFastSlamState):
            run_info["resolution_m"] = state.maps.resolution_m
            closures = len(recorder.history.closures)
            status |= {"particles": len(state.poses), "closures": closures}
            status |= {"best": state.best, "bytes": state.maps.nbytes}
        else:
            names = "particles", "looking", "lost_probability", "inlier_ratio"
            status |= {name: getattr(report, name) for name in names}
        series = recorder.history.series
        self._show(Scene(run_info, status, recorder.replica, frame, series, recorder.scan_ends()))

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
