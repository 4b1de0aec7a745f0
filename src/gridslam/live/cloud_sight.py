"""What there is to see of a filter that localizes in a known map: the cloud of its particles."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.live.scene import NO_CLOSURES, NO_TREE, Float32Array, Rows, Tree
from gridslam.live.sight import BEST, View
from gridslam.live.tiles import TileChanges
from gridslam.localization import LocalizationReport, MonteCarloState
from gridslam.types import LaserScan, OccupancyGrid
from gridslam.viz.cloud import select_representatives

__all__ = ["CloudSight"]

_GRAIN = np.float32(64)  # to the m and rad: a cloud's poses are rounded to 1.6 cm and 0.9 degrees, to send less


@final
class CloudSight:
    """Of a filter that localizes in a known map.

    Parameters
    ----------
    known : OccupancyGrid
        The map.
    """

    def __init__(self, known: OccupancyGrid) -> None:
        """Begin before the first scan."""
        self._resolution_m = known.resolution_m
        self.begin()

    def begin(self) -> None:
        """Begin before the first scan."""
        self._way = Rows(2)

    def note(self, report: LocalizationReport, scan: LaserScan | None) -> int:
        """Record the pose of a scan, unless it is a guess."""
        if report.skipped is None:
            self._way.append(np.full((1, 2), np.nan) if report.lost else report.pose[None, :2])
        return 0

    def watch(self, channel: int, particle: int, keys: int) -> None:
        """Show nothing: there is one map."""

    def look(self, report: LocalizationReport, state: MonteCarloState) -> View:
        """See the state as it is now."""
        return _CloudView(self._resolution_m, report, state.snapshot(), self._way.all)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _CloudView:
    resolution_m: float
    report: LocalizationReport
    state: MonteCarloState
    way: Float32Array

    maps: dict[int, TileChanges] = field(default_factory=dict)
    rows: dict[int, int] = field(default_factory=lambda: {BEST: 0})

    def particles(self) -> Float32Array:
        """At most a thousand, moved on by odometry since the last update."""
        chosen, shares = select_representatives(np.exp(self.state.log_weights))
        moved = between(self.state.estimate.pose, self.report.pose)
        poses = compose(self.state.poses[chosen], moved).astype(np.float32)
        return np.column_stack([np.rint(poses * _GRAIN) / _GRAIN, shares.astype(np.float32)])

    def past(self) -> tuple[Float32Array, Tree]:
        return self.way, NO_TREE

    def closures(self) -> Float32Array:
        return NO_CLOSURES

    def facts(self) -> dict[str, Any]:
        report = self.report
        return {"particles": report.particles, "doubt": report.lost_probability, "agreement": report.inlier_ratio}
