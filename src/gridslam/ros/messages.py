"""What the node says, whatever carries it; what it hears are the messages of `gridslam.io.ros_messages`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gridslam.io.ros_messages import ScanMessage, StampedTransform
from gridslam.types import FloatArray

__all__ = [
    "CloudMessage", "Diagnostics", "GridMessage", "Level", "Outputs", "PoseMessage", "ScanMessage", "StampedTransform",
]  # fmt: skip


class Level(IntEnum):
    """How bad it is; the values are those of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


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

    def fill(self, sent: Any) -> None:  # noqa: ANN401
        """Write it into a geometry_msgs/PoseWithCovariance, whatever made that."""
        x, y, theta = self.pose.tolist()
        position, turn = sent.pose.position, sent.pose.orientation
        position.x, position.y, turn.z, turn.w = x, y, math.sin(0.5 * theta), math.cos(0.5 * theta)
        full = np.zeros((6, 6))
        full[np.ix_((0, 1, 5), (0, 1, 5))] = self.covariance
        sent.covariance = full.ravel().tolist()


class CloudMessage(NamedTuple):
    """Poses (N, 3) of the particles in `frame`."""

    stamp_ns: int
    frame: str
    poses: FloatArray

    def data(self) -> bytes:
        """The poses as geometry_msgs/Pose lie in bytes, little-endian: x, y, z in m, and the quaternion x, y, z, w."""
        rows = np.zeros((len(self.poses), 7), "<f8")
        rows[:, :2], half = self.poses[:, :2], 0.5 * self.poses[:, 2]
        rows[:, 5], rows[:, 6] = np.sin(half), np.cos(half)
        return rows.tobytes()


class Diagnostics(NamedTuple):
    """How the node does: one sentence, and values by name."""

    level: Level
    summary: str
    values: Mapping[str, str]


class Outputs(Protocol):
    """A transport, as the core sees it; called from several threads, each method from one at a time.

    What `now_ns` gives is the transport's clock, which may be that of a simulation.
    """

    def now_ns(self) -> int:
        """Time now, ns."""

    def map(self, message: GridMessage) -> None:
        """Publish the map, for late joiners, too."""

    def transform(self, message: StampedTransform) -> None:
        """Publish where the odometry frame lies in the map."""

    def pose(self, message: PoseMessage) -> None:
        """Publish where the robot is."""

    def entropy(self, nats: float) -> None:
        """Publish the entropy of the particles' weights."""

    def particles(self, message: CloudMessage) -> None:
        """Publish where the particles are."""

    def diagnostics(self, message: Diagnostics) -> None:
        """Publish how the node does."""

    def log(self, level: Level, text: str) -> None:
        """Tell people."""
