"""The simulated P3DX in the meeting rooms: its log, its truth, and how its map lies in the simulator's world.

The simulator (Stage) stretches what is drawn, from the first wall to the last, to the size that is said of the whole
image: 29.05 m x 29.10 m of walls to 30.1 m. Metres of the log are those of the simulator: laser and truth agree with
each other, and neither with the map, which is 3.5 % too small.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gridslam.io.log import LogOptions, open_log
from gridslam.io.maps import read_map
from gridslam.io.measurement import Measurement
from gridslam.types import OccupancyGrid, Trajectory


class MeetingRooms(NamedTuple):
    """Log, truth (a pose for each scan, in the simulator's world), and map."""

    bag: Path
    yaml: Path
    measurements: list[Measurement]
    truth: Trajectory
    grid: OccupancyGrid

    @classmethod
    def of(cls, data: Path) -> MeetingRooms:
        bag, yaml = data / "bags" / "p3dx_sim_truth.bag", data / "maps" / "meeting.yaml"
        true = list(open_log(bag, LogOptions(odometry_topic="/base_pose_ground_truth")))
        stamps = np.array([scan.stamp_ns for _, scan in true])
        poses = np.array([odometry.pose for odometry, _ in true])
        return cls(bag, yaml, list(open_log(bag)), Trajectory(stamps, poses), read_map(yaml))

    def into_map(self, points: np.ndarray) -> np.ndarray:
        """Points or poses (N, 2 or 3) of the simulator's world in the map; Stage loses the first row and column."""
        rows, columns = np.nonzero(self.grid.known & (self.grid.log_odds > 0.6))
        first, last = (np.array([columns.min(), rows.min()]) + 1, np.array([columns.max(), rows.max()]) + 1)
        side, cell = self.grid.resolution_m * len(self.grid.known), self.grid.resolution_m
        placed = points.copy()
        placed[:, :2] = (points[:, :2] / side + 0.5) * (last - first) * cell + first * cell
        return placed
