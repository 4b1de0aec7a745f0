"""Records the history of a run, in the filter's thread."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from gridslam.live.history import NO_TILES, History, Moment, RowBuffer, compress_tiles, round_scan
from gridslam.live.monitor import ClosureCollector
from gridslam.live.protocol import NO_POINTS
from gridslam.live.scene import count_common
from gridslam.live.tiles import TileChangeDetector, TileReplica
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, LaserScan, Odometry, StepReport
from gridslam.viz.cloud import select_representatives

if TYPE_CHECKING:
    from gridslam.localization import LocalizationReport, MonteCarloState

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")
_MOST_PARTICLES = 300  # of a moment
_CLOSEST_M = 0.05


@final
class HistoryRecorder:
    """An observer that records the history of a filter that maps, or of one that localizes.

    Parameters
    ----------
    range_max_m : float, m
        Beams of this range or more are not recorded; infinite if unknown.
    is_localization : bool
        Whether the filter localizes in a known map.

    Attributes
    ----------
    history : History
        The past of the current session.
    """

    def __init__(self, range_max_m: float = math.inf, *, is_localization: bool = False) -> None:
        """Start before the first scan."""
        self._range_max_m = range_max_m
        self._maps = not is_localization
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session."""
        self.history = History()
        self._scans = 0
        self._scan: LaserScan | None = None
        self._path: FloatArray = np.zeros((0, 2))
        self._poses = RowBuffer(2)
        self._detector = TileChangeDetector()
        self._replica = TileReplica()  # as it looked at the last moment
        self._collector = ClosureCollector()

    def follow(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """Start a new session, yield its measurements, and note their scans."""
        self.reset()
        for measurement in source:
            self._scan = measurement[1]
            yield measurement

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record a step, if it is a key scan and due."""
        self._scans += 1
        if self._maps and report.closures:
            self._collector.add(report.closures)
        if report.skipped is not None:
            return
        if self._maps and report.corrected:
            self._detector.forget()
        self.history.note_report(report, self._scans, seconds)
        if not self._maps:
            self._poses.append(np.full((1, 2), np.nan) if report.lost else report.pose[None, :2])
        if self.history.is_due(len(self.history.stamps_ns)):
            self.history.add(self._make_moment(report, state))

    def _make_moment(
        self, report: StepReport | LocalizationReport, state: GridFastSlamState | MonteCarloState
    ) -> Moment:
        at, tiles = _NOWHERE, NO_TILES
        if isinstance(state, GridFastSlamState):
            before = self._replica.sequence
            changes = self._detector.find_changes(state.maps, state.best)
            self._replica.apply(changes)
            at, packed, _ = self._replica.since(before, len(changes.at))
            tiles = compress_tiles(packed)
            self.history.closures, self.history.recognized = self._collector.find(state)
            whole = state.ancestry.trajectory(state.best)[:, :2]
            first = count_common(whole, self._path)
            newest, self._path = whole[first:], whole
        else:
            first = len(self._path)
            newest = self._poses.rows[first:].astype(np.float64)
            self._path = np.concatenate([self._path, newest])
        chosen, ratios = select_representatives(np.exp(state.log_weights), _MOST_PARTICLES)
        cloud = np.column_stack([state.poses[chosen], ratios]).astype(np.float32)
        ends = NO_POINTS if self._scan is None else self._scan.beams(_CLOSEST_M, self._range_max_m).ends
        pose = np.array(report.pose)
        keys, path, scan = len(self.history.stamps_ns), newest.astype(np.float32), round_scan(ends)
        return Moment(keys, report.stamp_ns, pose, first, path, at, tiles, scan, cloud)


_NOWHERE: NDArray[np.int32] = np.zeros((0, 2), np.int32)
