"""Monitor of a filter that localizes in a known map."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.live.monitor import BEST, StateView
from gridslam.live.scene import NO_CLOSURES, NO_TREE, AncestryTree, Float32Array, RowBuffer
from gridslam.live.tiles import TileChanges
from gridslam.localization import LocalizationReport, MonteCarloState
from gridslam.types import LaserScan, OccupancyGrid
from gridslam.viz.cloud import select_representatives

__all__ = ["LocalizationMonitor"]

_STEPS_PER_UNIT = np.float32(64)  # per m and rad: poses are rounded to 1.6 cm and 0.9 degrees, which compress better


@final
class LocalizationMonitor:
    """Monitor of a filter that localizes in a known map.

    Parameters
    ----------
    known : OccupancyGrid
        The map.
    """

    def __init__(self, known: OccupancyGrid) -> None:
        """Start before the first scan."""
        self._resolution_m = known.resolution_m
        self.reset()

    def reset(self) -> None:
        """Start before the first scan."""
        self._path = RowBuffer(2)

    def record(self, report: LocalizationReport, scan: LaserScan | None) -> int:
        """Record the pose at a scan, NaN if the robot is lost."""
        if report.skipped is None:
            self._path.append(np.full((1, 2), np.nan) if report.lost else report.pose[None, :2])
        return 0

    def show_particle(self, channel: int, particle: int, keys: int) -> None:
        """Do nothing: all particles share one map."""

    def view(self, report: LocalizationReport, state: MonteCarloState) -> StateView:
        """Return a view of the current state."""
        return _LocalizationView(self._resolution_m, report, state.snapshot(), self._path.rows)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _LocalizationView:
    resolution_m: float
    report: LocalizationReport
    state: MonteCarloState
    path: Float32Array

    maps: dict[int, TileChanges] = field(default_factory=dict)
    rows: dict[int, int] = field(default_factory=lambda: {BEST: 0})

    def particles(self) -> Float32Array:
        """Return at most a thousand particles, predicted by odometry since the last update."""
        chosen, shares = select_representatives(np.exp(self.state.log_weights))
        moved = between(self.state.estimate.pose, self.report.pose)
        poses = compose(self.state.poses[chosen], moved).astype(np.float32)
        return np.column_stack([np.rint(poses * _STEPS_PER_UNIT) / _STEPS_PER_UNIT, shares.astype(np.float32)])

    def path_and_tree(self) -> tuple[Float32Array, AncestryTree]:
        return self.path, NO_TREE

    def closures(self) -> Float32Array:
        return NO_CLOSURES

    def status(self) -> dict[str, Any]:
        report = self.report
        return {
            "particles": report.particles,
            "lost_probability": report.lost_probability,
            "inlier_ratio": report.inlier_ratio,
        }
