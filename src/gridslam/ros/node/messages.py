"""Messages published by the node, independent of the transport; its inputs are in `gridslam.io.bags.ros_messages`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gridslam.io.bags.ros_messages import ScanMessage, StampedTransform
from gridslam.messages import Level
from gridslam.types import FloatArray

__all__ = [
    "PLANAR",
    "CloudMessage",
    "Diagnostics",
    "GridMessage",
    "Level",
    "Outputs",
    "PoseMessage",
    "ScanMessage",
    "StampedTransform",
]


PLANAR: Final = np.ix_((0, 1, 5), (0, 1, 5))
"""x, y and yaw of a covariance (6, 6) by x, y, z, roll, pitch and yaw."""


class GridMessage(NamedTuple):
    """nav_msgs/OccupancyGrid: cells (H, W) int8, -1 unknown, else 0 to 100; `origin` is the corner of [0, 0], m."""

    stamp_ns: int
    frame: str
    resolution_m: float
    origin: tuple[float, float]
    cells: NDArray[np.int8]


class PoseMessage(NamedTuple):
    """Pose (3,) of the base in `frame`, and its covariance (3, 3) by x, y in m and theta in rad."""

    stamp_ns: int
    frame: str
    pose: FloatArray
    covariance: FloatArray


class CloudMessage(NamedTuple):
    """Poses (N, 3) of the particles in `frame`, and their weights (N,), whose sum is 1."""

    stamp_ns: int
    frame: str
    poses: FloatArray
    weights: FloatArray

    def data(self) -> bytes:
        """Return the bytes of the poses as geometry_msgs/Pose, little-endian: x, y, z in m, quaternion x, y, z, w."""
        return self._rows()[:, :7].tobytes()

    def weighted_data(self) -> bytes:
        """Return the bytes of the poses as nav2_msgs/Particle: the pose, then the weight."""
        return self._rows().tobytes()

    def _rows(self) -> NDArray[np.float64]:
        rows = np.zeros((len(self.poses), 8), "<f8")
        rows[:, :2] = self.poses[:, :2]
        rows[:, 5] = np.sin(0.5 * self.poses[:, 2])
        rows[:, 6] = np.cos(0.5 * self.poses[:, 2])
        rows[:, 7] = self.weights
        return rows


class Diagnostics(NamedTuple):
    """State of the node: level, summary with the latest problem, values by name, and the name of the state."""

    level: Level
    summary: str
    values: Mapping[str, str]
    state: str = ""


class Outputs(Protocol):
    """Interface of a transport; called from several threads, but each method from one at a time.

    Attributes
    ----------
    topics : collection of str
        Those that are published.
    """

    topics: Collection[str]

    def now_ns(self) -> int:
        """Return the transport's time, which may be simulated, ns."""
        ...

    def map(self, message: GridMessage) -> None:
        """Publish the map, latched."""

    def transform(self, message: StampedTransform) -> None:
        """Publish the transform from map to odometry."""

    def pose(self, message: PoseMessage) -> None:
        """Publish the pose of the robot."""

    def updated_pose(self, message: PoseMessage) -> None:
        """Publish the pose at an update of the particles of a localization."""

    def entropy(self, nats: float) -> None:
        """Publish the entropy of the particles' weights."""

    def particles(self, message: CloudMessage) -> None:
        """Publish the poses of the particles."""

    def diagnostics(self, message: Diagnostics) -> None:
        """Publish the diagnostics."""

    def log(self, level: Level, text: str, /) -> None:
        """Report to the user."""
