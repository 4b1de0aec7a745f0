"""The tracker of GMapping: none; the odometry is the particles' control as it is."""

from __future__ import annotations

from typing import final

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as parameters

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.tracking.state import TrackedScan, TrackerState
from gridslam.types import Beams, Odometry

__all__ = ["OdometryTracker"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class OdometryTracker:
    """Takes the odometry as it is, as GMapping does, and so needs it with every scan."""

    def init(
        self, odometry: Odometry | None, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping
    ) -> TrackerState:
        """Start at the origin of the tracker's frame; ArgumentError where there is no odometry."""
        return TrackerState.start(mapper.empty(2), _require_odometry(odometry, stamp_ns), stamp_ns, beams.scan.sensor)

    def step(self, state: TrackerState, odometry: Odometry | None, stamp_ns: int, beams: Beams) -> TrackedScan:
        """Track one scan; updates `state`; ArgumentError where there is no odometry."""
        state.odometry, state.stamp_ns = _require_odometry(odometry, stamp_ns).pose, stamp_ns
        state.pose = compose(state.matched_pose, between(state.matched_odometry, state.odometry))
        return TrackedScan(state.pose, state.pose, beams, beams)


def _require_odometry(odometry: Odometry | None, stamp_ns: int) -> Odometry:
    if odometry is None:
        expected = "a pose with every scan, as this tracker uses nothing else"
        raise ArgumentError("odometry", expected, f"none with the scan at {stamp_ns} ns")
    return odometry
