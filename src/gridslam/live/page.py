"""A run of the filter, shown in the browser while it goes on."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar, final

from gridslam.live.cloud_sight import CloudSight
from gridslam.live.control import Control, RobotControl
from gridslam.live.map_sight import MapSight
from gridslam.live.observer import LiveObserver, Snapshot
from gridslam.live.options import LiveOptions
from gridslam.live.run import LiveRun
from gridslam.live.server import PageServer
from gridslam.live.sight import Sight
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, LaserScan, OccupancyGrid, Odometry

__all__ = ["LivePage"]

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_MAY_COME_BACK_S = 3.0


@final
class LivePage:
    """Serves the page of one run while its context is entered.

    Give `observer` to `gridslam.pipeline.run` (or to what drives a localization), and `paced(source)` as its source, or
    `session(source)` where that is a robot. The filter's result is the same with and without.

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
        self._last_stage = "final refinement" if known is None else "writing"
        sight: Sight[Any, Any] = MapSight(range_max_m) if known is None else CloudSight(known)
        self.observer = LiveObserver(self._post, self.control, sight)
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

    def tell_progress(self, share: Callable[[], float]) -> None:
        """Show progress on the page: `share` returns the fraction of the source that was read, in [0, 1]."""
        self.observer.share = share

    def paced(self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None) -> Iterator[_Measured]:
        """The measurements of a source, each when the viewers want it; waiting counts for no stage of the stopwatch."""
        yield from self.observer.measured(source, stopwatch)
        self._server.call(self._run.enter, self._last_stage)

    def session(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """The measurements of a robot's session as they come; the page forgets what was before."""
        self._server.call(self._run.begin)
        self.observer.begin()
        return self.observer.followed(source)

    def say(self, words: str) -> None:
        """Bring the page up to date while no scan comes, in the filter's thread; words are shown, unless empty."""
        self.observer.look()
        self._server.call(self._run.say, words)

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        self._server.call(self._run.finish, grid, poses, closures)

    def wait_for_viewer(self, at_most_s: float) -> bool:
        """Return once someone looks, or after some seconds; whether someone does."""
        until = time.perf_counter() + at_most_s
        while not self.viewers and time.perf_counter() < until:
            time.sleep(0.05)
        return bool(self.viewers)

    def linger(self) -> None:
        """Show that all is done and written, and keep serving as long as a viewer is connected.

        A lost connection has some seconds to come back.
        """
        self._server.call(self._run.enter, "done")
        alone_since = -math.inf if not self.viewers else time.perf_counter()
        while time.perf_counter() - alone_since < _MAY_COME_BACK_S:
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
            self.observer.done()
