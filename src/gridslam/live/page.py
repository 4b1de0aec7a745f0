"""A run of the filter, shown in the browser while it goes on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar, final

from gridslam.live.control import Control, RobotControl
from gridslam.live.localization_monitor import LocalizationMonitor
from gridslam.live.mapping_monitor import MappingMonitor
from gridslam.live.monitor import FilterMonitor
from gridslam.live.observer import LiveObserver, Snapshot
from gridslam.live.options import LiveOptions
from gridslam.live.run import LiveRun
from gridslam.live.server import PageServer
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, LaserScan, OccupancyGrid, Odometry

__all__ = ["LivePage"]

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_RECONNECT_S = 3.0


@final
class LivePage:
    """Serves the page of one run while its context is entered.

    Give `observer` to `gridslam.pipeline.run` (or to what drives a localization), and `pace(source)` as its source, or
    `follow_session(source)` where that is a robot. The filter's result is the same with and without.

    Parameters
    ----------
    title : str
        What is mapped, or in which map the robot is.
    options : LiveOptions
        Where the page is served.
    range_max_m : float, m
        The filter's, beyond which beams are not used.
    known : OccupancyGrid, optional
        The map, where that is known: the filter is one that localizes then.
    robot : RobotControl, optional
        What a pause comes to, where a robot drives, which cannot be held back as a log can.

    Attributes
    ----------
    control : Control or RobotControl
        Pause, step and speed.
    observer : LiveObserver
        To be called with each report.
    """

    def __init__(
        self,
        title: str,
        options: LiveOptions | None = None,
        *,
        range_max_m: float = math.inf,
        known: OccupancyGrid | None = None,
        robot: RobotControl | None = None,
    ) -> None:
        """Serve nothing yet."""
        options = options or LiveOptions()
        self.control = robot or Control(options.speed)
        self._run = LiveRun(title, self.control, range_max_m, known)
        self._server = PageServer(self._run, options)
        self._last_stage = "last word" if known is None else "writing"
        monitor: FilterMonitor[Any, Any] = MappingMonitor(range_max_m) if known is None else LocalizationMonitor(known)
        self.observer = LiveObserver(self._post, self.control, monitor)
        self._run.observer = self.observer

    def __enter__(self) -> LivePage:
        """Serve; raises OutputError where the port is taken."""
        self._server.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the page."""
        self.control.end()
        self._server.__exit__()

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return self._server.url

    @property
    def viewers(self) -> int:
        """How many are looking."""
        return self._run.viewers

    def set_progress(self, progress: Callable[[], float]) -> None:
        """Let the page tell how much of the source is read: what `progress` returns, in [0, 1]."""
        self.observer.progress = progress

    def pace(self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None) -> Iterator[_Measured]:
        """The measurements of a source, each when the viewers want it; waiting counts for no stage of the stopwatch."""
        yield from self.observer.pace(source, stopwatch)
        self._server.call(self._run.set_stage, self._last_stage)

    def follow_session(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """The measurements of a robot's session as they come; the page forgets what was before."""
        self._server.call(self._run.reset)
        self.observer.reset()
        return self.observer.follow(source)

    def show_message(self, message: str) -> None:
        """Bring the page up to date while no scan comes, in the filter's thread; words are shown, unless empty."""
        self.observer.take_pending_snapshot()
        self._server.call(self._run.show_message, message)

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the last word: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        self._server.call(self._run.finish, grid, poses, closures)

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Return once someone looks, or after some seconds; whether someone does."""
        until = time.perf_counter() + timeout_s
        while not self.viewers and time.perf_counter() < until:
            time.sleep(0.05)
        return bool(self.viewers)

    def serve_until_left(self) -> None:
        """Say that all is done and written, and stay as long as someone looks.

        A lost connection has some seconds to come back.
        """
        self._server.call(self._run.set_stage, "done")
        alone_since = -math.inf if not self.viewers else time.perf_counter()
        while time.perf_counter() - alone_since < _RECONNECT_S:
            time.sleep(0.1)
            if self.viewers:
                alone_since = time.perf_counter()

    def _post(self, snapshot: Snapshot) -> None:
        if not self._server.call(self._apply, snapshot):
            self.observer.period_s = math.inf  # nobody will look any more

    def _apply(self, snapshot: Snapshot) -> None:
        try:
            self._run.apply(snapshot)
        finally:
            self.observer.release()
