"""Records a run in the filter's thread: its map, its key scans, and moments of it for the page and history.npz."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING, Any, TypeVar, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.live.history import History, Moment, compress_tiles, round_scan
from gridslam.live.protocol import NO_POINTS, Float32Array
from gridslam.live.scene import Frame, count_common
from gridslam.live.tiles import TileChangeDetector, TileReplica
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.types import LaserScan, Odometry, StepReport
from gridslam.viz.cloud import MOST_SHOWN, select_representatives

if TYPE_CHECKING:
    from gridslam.localization import LocalizationReport, MonteCarloState

Measured = TypeVar("Measured", bound="tuple[Odometry | None, LaserScan]")
"""A measurement, which passes as it is."""
_MOST_PARTICLES = 300  # of a moment
_CLOSEST_M = 0.05


@final
class RunRecorder:
    """An observer that records a filter that maps, or one that localizes; it never changes the filter's result.

    Parameters
    ----------
    range_max_m : float, m
        Beams of this range or more are not recorded; infinite if unknown.
    keeps_moments : bool
        Whether the history gets moments.

    Attributes
    ----------
    history : History
        The past of the current session.
    replica : TileReplica
        The map of the best particle at the last view; empty for a known map.
    scans : int
        Number of scans so far.
    """

    def __init__(self, range_max_m: float = math.inf, *, keeps_moments: bool = True) -> None:
        """Start before the first scan."""
        self._range_max_m = range_max_m
        self._keeps_moments = keeps_moments
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session."""
        self.history = History()
        self.replica = TileReplica()
        self.scans = 0
        self._scan: LaserScan | None = None
        self._positions = array("f")  # x m, y m of a localization, NaN where it was lost
        self._path = NO_POINTS  # of the last moment
        self._number = 0  # of the map's last change by then
        self._detector = TileChangeDetector()
        self._recognized = array("q")  # pairs of key scans, loop closures
        self._tracked = array("q")  # of the first `_seen` constraints
        self._seen = 0

    def follow(self, source: Iterable[Measured]) -> Iterator[Measured]:
        """Start a new session, yield its measurements, and note their scans."""
        self.reset()
        for measurement in source:
            self._scan = measurement[1]
            yield measurement

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record a step, and a moment if one is due."""
        self.scans += 1
        if isinstance(report, StepReport):
            self._recognized.extend(chain.from_iterable(report.closures))
        if report.skipped is not None:
            return
        self.history.note_report(report, self.scans, seconds)
        if not isinstance(report, StepReport):
            self._positions.extend((math.nan, math.nan) if report.lost else report.pose[:2].tolist())
        elif report.corrected:
            self._detector.forget()
        if self._keeps_moments and self.history.is_due(len(self.history.stamps_ns)):
            self._add_moment(report, state)

    def view(
        self,
        report: StepReport | LocalizationReport,
        state: GridFastSlamState | MonteCarloState,
        most_particles: int = MOST_SHOWN,
    ) -> Frame:
        """Return path, particles and loop closures as they are now, after an update of the map."""
        history = self.history
        chosen, shares = select_representatives(np.exp(state.log_weights), most_particles)
        moved = np.zeros(3)  # since the last key scan
        if isinstance(state, GridFastSlamState):
            self.replica.apply(self._detector.find_changes(state.maps, state.best))
            self._find_closures(state)
            path = state.ancestry.trajectory(state.best)[:, :2].astype(np.float32)
            if isinstance(report, StepReport) and report.skipped:
                moved = report.key_from_base
        else:
            path = np.frombuffer(self._positions.tobytes(), np.float32).reshape(-1, 2)
            moved = between(state.estimate.pose, report.pose)
        cloud = np.column_stack([compose(state.poses[chosen], moved), shares]).astype(np.float32)
        return history.make_frame(path, cloud)

    def _find_closures(self, state: GridFastSlamState) -> None:
        """Note the loop closures so far in the history: those recognized, then those tracked."""
        constraints = [] if state.closure_state is None else state.closure_state.graph.constraints
        if len(constraints) < self._seen:
            self._seen = 0
            self._tracked = array("q")
        tracked = (c for c in constraints[self._seen :] if c.source is ConstraintSource.TRACKED)
        self._tracked.extend(chain.from_iterable(constraint.pair for constraint in tracked))
        self._seen = len(constraints)
        self.history.closures = np.array(self._recognized + self._tracked, np.int64).reshape(-1, 2)
        self.history.recognized = len(self._recognized) // 2

    def scan_ends(self) -> Float32Array:
        """Return the end points (K, 2) of the last scan in the robot frame, m."""
        if self._scan is None:
            return NO_POINTS
        return self._scan.beams(_CLOSEST_M, self._range_max_m).ends.astype(np.float32)

    def _add_moment(self, report: StepReport | LocalizationReport, state: GridFastSlamState | MonteCarloState) -> None:
        history = self.history
        frame = self.view(report, state, _MOST_PARTICLES)
        at, packed, self._number = self.replica.since(self._number)
        first = count_common(frame.path, self._path)
        self._path = frame.path
        history.add(
            Moment(
                len(history.stamps_ns),
                report.stamp_ns,
                np.array(report.pose),
                first,
                frame.path[first:],
                at,
                compress_tiles(packed),
                round_scan(self.scan_ends()),
                frame.particles,
            )
        )
