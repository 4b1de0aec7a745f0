"""Records the history of a run, in the filter's thread."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar, final

import numpy as np

from gridslam.live.ancestry_tree import NO_POINTS
from gridslam.live.history import History, Moment, PackedTiles, pack_tiles, round_scan
from gridslam.live.monitor import BEST, MappingMonitor
from gridslam.live.protocol import levels
from gridslam.live.protocol import pack_tiles as pack_levels
from gridslam.live.scene import RowBuffer
from gridslam.live.tiles import TileChanges
from gridslam.localization import LocalizationReport, MonteCarloState
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, IntArray, LaserScan, Odometry, StepReport
from gridslam.viz.cloud import select_representatives

__all__ = ["HistoryRecorder"]

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
        The moments of the current session.
    closures : (C, 2) int64
        Key scans of the loop closures so far: the older and the later one.
    recognized : int
        How many of them, from the first on, are recognized; the others are tracked.
    """

    def __init__(self, range_max_m: float = math.inf, *, is_localization: bool = False) -> None:
        """Start before the first scan."""
        self._range_max_m = range_max_m
        self._monitor = None if is_localization else MappingMonitor(range_max_m)
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a new session."""
        self.history = History()
        self.closures: IntArray = np.zeros((0, 2), np.int64)
        self.recognized = 0
        self._keys = 0
        self._scan: LaserScan | None = None
        self._path: FloatArray = np.zeros((0, 2))
        self._shown: PackedTiles = {}
        self._poses = RowBuffer(2)
        if self._monitor is not None:
            self._monitor.reset()

    def follow(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """Yield the measurements of a source, and note their scans."""
        for measurement in source:
            self._scan = measurement[1]
            yield measurement

    def note_scan(self, scan: LaserScan) -> None:
        """Note the scan that the filter gets next."""
        self._scan = scan

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record a step, if it is a key scan and due."""
        if self._monitor is not None:
            self._monitor.record(report, self._scan)
        if report.skipped is not None:
            return
        self._keys += 1
        if self._monitor is None:
            self._poses.append(np.full((1, 2), np.nan) if report.lost else report.pose[None, :2])
        if self.history.is_due(self._keys):
            self.history.add(self._make_moment(report, state))

    def _make_moment(
        self, report: StepReport | LocalizationReport, state: GridFastSlamState | MonteCarloState
    ) -> Moment:
        changed: PackedTiles = {}
        if self._monitor is not None and isinstance(report, StepReport) and isinstance(state, GridFastSlamState):
            changed = self._find_changes(self._monitor.find_changes(state, {BEST: state.best})[BEST])
            self.closures, self.recognized = self._monitor.find_closures(state)
            first, newest = state.ancestry.newest_positions(state.best, self._path)
            self._path = np.concatenate([self._path[:first], newest])
        else:
            first = len(self._path)
            newest = self._poses.rows[first:].astype(np.float64)
            self._path = np.concatenate([self._path, newest])
        chosen, ratios = select_representatives(np.exp(state.log_weights), _MOST_PARTICLES)
        cloud = np.column_stack([state.poses[chosen], ratios]).astype(np.float32)
        at, tiles = pack_tiles(changed)
        ends = NO_POINTS if self._scan is None else self._scan.beams(_CLOSEST_M, self._range_max_m).ends
        pose = np.array(report.pose)
        return Moment(
            self._keys, report.stamp_ns, pose, first, newest.astype(np.float32), at, tiles, round_scan(ends), cloud
        )

    def _find_changes(self, changes: TileChanges) -> PackedTiles:
        """Return the tiles that look different from those of the moment before."""
        packed = pack_levels(levels(changes.log_odds))
        tiles = {(row, column): one.tobytes() for (row, column), one in zip(changes.at.tolist(), packed, strict=True)}
        seen = {at: tile for at, tile in tiles.items() if self._shown.get(at) != tile}
        self._shown.update(seen)
        return seen
