"""The filter's side: an observer of the pipeline that now and then takes a snapshot of what can be seen."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar, final

import numpy as np

from gridslam.io.record import RecordFlag
from gridslam.live.control import Control, RobotControl
from gridslam.live.tiles import NOWHERE, Box, TileChanges, TileWatch
from gridslam.particles.ancestry import Ancestry
from gridslam.pipeline import Stopwatch
from gridslam.slam.state import GridFastSlamState
from gridslam.types import BeamStatus, FloatArray, IntArray, LaserScan, Odometry, StepReport

__all__ = ["BEST", "CORRECTED", "SEEN_S", "UNSEEN_S", "LiveObserver", "Snapshot"]

BEST = 0
"""The channel that shows the best particle's map, whichever that is."""
SEEN_S, UNSEEN_S = 0.1, 1.0
"""Time between snapshots while somebody looks, and while nobody does, s."""
CORRECTED = 8
"""Beside the flags of a record: the past was corrected after this key scan."""

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_DIED_OUT = -1
_REMEMBERED = 256  # resamplings
_LAST_S = 1.0  # after the last scan the snapshot before is waited for, so that the page has the end


@final
@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """What can be seen of a run after one scan; arrays in it are never written to.

    Attributes
    ----------
    report : StepReport
        Of that scan.
    scan : LaserScan or None
        The scan, where it went through `LiveObserver.measured`.
    scans, keys : int
        How many scans and key scans there were.
    poses, log_weights : (N, 3), (N,) float64
        The particles at the last key scan.
    ancestry : Ancestry
        Their pasts.
    series : list of (float, float, float, int)
        Of each key scan since the last snapshot its stamp, s, effective sample size, latency, s, and flags.
    closures : list of (int, int)
        Key scans recognized since the last snapshot to show one place.
    maps : dict of int to TileChanges
        What has changed in the map of each channel.
    rows : dict of int to int
        The particle of each channel; -1 where its line has died out.
    resolution_m : float
        Side of a cell of the maps.
    bytes : int
        Memory that they take.
    share : float
        How much of the log is read, in [0, 1]; NaN where that is unknown.
    taken_s : float
        `time.perf_counter()` of the snapshot.
    """

    report: StepReport
    scan: LaserScan | None
    scans: int
    keys: int
    poses: FloatArray
    log_weights: FloatArray
    ancestry: Ancestry
    series: list[tuple[float, float, float, int]]
    closures: list[tuple[int, int]]
    maps: dict[int, TileChanges]
    rows: dict[int, int]
    resolution_m: float
    bytes: int
    share: float
    taken_s: float


@final
class LiveObserver:
    """Takes snapshots at a bounded rate and hands them over; never waits for who takes them.

    A snapshot is taken only once the one before is done with (`done`), so a slow reader gets fewer of them, each of
    which brings all that has changed since.

    Parameters
    ----------
    post : callable
        Gets each snapshot, on the filter's thread, and returns at once.
    control : Control or RobotControl
        Holds back the scans that come through `measured`.
    range_max_m : float, m
        Beams of this range or more write nothing; infinite if it is not known.

    Attributes
    ----------
    period_s : float, s
        Least time between two snapshots; set by whoever knows whether somebody looks.
    share : callable
        Tells how much of the source is read, in [0, 1]; NaN where that is unknown.
    """

    def __init__(
        self,
        post: Callable[[Snapshot], None],
        control: Control | RobotControl,
        *,
        range_max_m: float = math.inf,
    ) -> None:
        """Begin before the first scan."""
        self.period_s = UNSEEN_S
        self.share: Callable[[], float] = lambda: math.nan
        self._post, self._control, self._range_max_m = post, control, range_max_m
        self._due, self._busy = 0.0, False
        self.begin()

    def begin(self) -> None:
        """Begin before the first scan, with other maps than those looked at until now."""
        self._scans = self._keys = 0
        self._fresh, self._everything = False, True
        self._scan: LaserScan | None = None
        self._latest: tuple[StepReport, GridFastSlamState] | None = None
        self._written: list[tuple[FloatArray, LaserScan | None]] = []
        self._series: list[tuple[float, float, float, int]] = []
        self._closures: list[tuple[int, int]] = []
        self._resamplings: deque[tuple[int, IntArray]] = deque(maxlen=_REMEMBERED)
        self._requests: deque[tuple[int, int, int]] = deque()
        self._watches = {BEST: TileWatch()}
        self._lines: dict[int, IntArray] = {}  # of each channel the particles that continue the chosen one

    def measured(
        self, source: Iterable[_Measured], stopwatch: Stopwatch | None = None
    ) -> Iterator[_Measured]:
        """The measurements of a source, each when the viewers want it; waiting counts for no stage of the stopwatch."""
        for measurement in source:
            if stopwatch is not None:
                stopwatch.lap("read")
            waited = self._control.wait(measurement[1].stamp_ns, self.look)
            if waited and stopwatch is not None:
                stopwatch.resume()
            self._scan = measurement[1]
            yield measurement
        patience = time.perf_counter() + _LAST_S
        while self._busy and time.perf_counter() < patience:
            time.sleep(0.001)
        self._take(time.perf_counter())

    def followed(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """The measurements of a source that nobody holds back."""
        for measurement in source:
            self._scan = measurement[1]
            yield measurement

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Take note of one scan, and a snapshot if it is time."""
        self._scans += 1
        self._latest, self._fresh = (report, state), True
        if report.closures:
            self._closures.extend(report.closures)
        if report.skipped is None:
            self._note(report, seconds)
        if not self._busy and (now := time.perf_counter()) >= self._due:
            self._take(now)

    def look(self) -> None:
        """Take a snapshot of what is new while no scan comes; in the filter's thread."""
        if not self._busy and (self._fresh or self._requests):
            self._take(time.perf_counter())

    def watch(self, channel: int, particle: int, keys: int) -> None:
        """Show the map of a particle, and of who continues it, as `channel`; called by any thread.

        `particle` is its index after so many key scans; -1 ends the channel.
        """
        self._requests.append((channel, particle, keys))
        self._control.wake()

    def done(self) -> None:
        """The last snapshot has been taken over; called by any thread."""
        self._busy = False

    def _note(self, report: StepReport, seconds: float) -> None:
        self._keys += 1
        flags = RecordFlag.LOST * report.lost | RecordFlag.RESAMPLED * (report.parents is not None)
        flags |= RecordFlag.UNDETERMINED * (report.undetermined is not None) | CORRECTED * report.corrected
        self._series.append((report.stamp_ns * 1e-9, report.n_eff, seconds, int(flags)))
        self._everything |= report.corrected
        if report.poses is not None:
            self._written.append((report.poses, self._scan))
        if report.parents is not None:
            self._resamplings.append((self._keys, report.parents))
            self._lines = {channel: _children(line, report.parents) for channel, line in self._lines.items()}
        self._control.reached_key_scan()

    def _take(self, now: float) -> None:
        if self._latest is None or self._busy:
            return
        self._due, self._busy, self._fresh = now + self.period_s, True, False
        report, state = self._latest
        self._serve_requests()
        rows = {channel: int(line[0]) if len(line) else _DIED_OUT for channel, line in self._lines.items()}
        rows[BEST] = state.best
        written = None if self._everything else self._box()
        self._everything = False
        maps = {
            channel: watch.look(state.maps, rows[channel], written)
            for channel, watch in self._watches.items()
            if rows[channel] != _DIED_OUT
        }
        snapshot = Snapshot(
            report, self._scan, self._scans, self._keys, state.poses, state.log_weights, state.ancestry.snapshot(),
            self._series, self._closures, maps, rows, state.maps.resolution_m,
            state.maps.nbytes, self.share(), now,
        )  # fmt: skip
        self._series, self._closures, self._written = [], [], []
        self._post(snapshot)

    def _box(self) -> Box | None:
        """Where maps were written to since the last snapshot."""
        if not self._written:
            return NOWHERE
        reach = 0.0
        for _, scan in self._written:
            if scan is None:
                return None
            hits = scan.ranges[(scan.status == BeamStatus.HIT) & (scan.ranges < self._range_max_m)]
            reach = max(reach, float(hits.max(initial=0.0)) + float(np.hypot(*scan.geometry.origin)))
        return Box.about(np.concatenate([poses for poses, _ in self._written]), reach)

    def _serve_requests(self) -> None:
        while self._requests:
            channel, row, keys = self._requests.popleft()
            if row < 0:
                self._watches.pop(channel, None)
                self._lines.pop(channel, None)
                continue
            line = np.array([row])
            for key, parents in self._resamplings:
                if key > keys:
                    line = _children(line, parents)
            self._watches[channel], self._lines[channel] = TileWatch(), line


def _children(line: IntArray, parents: IntArray) -> IntArray:
    """The particles that continue one of `line`."""
    return np.flatnonzero(np.isin(parents, line))
