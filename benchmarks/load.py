"""A robot that drives as long and scans as often as asked, and what a node did meanwhile."""

from __future__ import annotations

import itertools
import math
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np

from gridslam.ros.node.messages import Level, PoseMessage, ScanMessage, StampedTransform
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate_stream
from gridslam.types import FloatArray

__all__ = [
    "LATENCY",
    "MOUNTING",
    "START_S",
    "Load",
    "NoOutputs",
    "drive",
    "odometry_message",
    "resident_mb",
    "scan_message",
]

LATENCY: Final = "scan in to transform out"
MOUNTING: Final = StampedTransform(0, "base_link", "laser", (0.1, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0))
START_S: Final = 1.0
"""By which the first scan comes after the node, and the end after the last one."""


def drive(seconds: float, rate_hz: float, beams: int) -> Iterator[tuple[StampedTransform, ScanMessage]]:
    """Odometry and scan, as drivers would send them; stamps from 0 on."""
    rng = np.random.default_rng(0)
    there = make_world("demo", rng)
    rounds = math.ceil(seconds / 360.0)
    way = np.concatenate([there.route, *([there.route[-2::-1], there.route[1:]] * rounds)])
    lidar = LidarConfig(beams=beams, field_of_view_rad=math.radians(270), range_max_m=30.0, rate_hz=rate_hz, x_m=0.1)
    robot = RobotConfig(v_max_m_s=1.0)
    stream = simulate_stream(replace(there, route=way), robot, OdometryNoise(), lidar, rng)
    for one in itertools.islice(stream.measurements, round(seconds * rate_hz)):
        assert one.odometry is not None
        stamp_ns = one.scan.stamp_ns
        scan = scan_message(stamp_ns, one.scan.geometry.bearings, one.scan.ranges)
        yield odometry_message(stamp_ns, one.odometry.pose), scan


def odometry_message(stamp_ns: int, pose: FloatArray) -> StampedTransform:
    """The transform of a pose (3,) of the odometry."""
    x, y, theta = pose.tolist()
    rotation = (0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
    return StampedTransform(stamp_ns, "odom", "base_link", (x, y, 0.0, *rotation))


def scan_message(stamp_ns: int, bearings: FloatArray, ranges: FloatArray) -> ScanMessage:
    """The message of ranges (B,) at evenly spaced bearings (B,)."""
    step = float(bearings[-1] - bearings[0]) / (len(bearings) - 1)
    return ScanMessage(stamp_ns, "laser", float(bearings[0]), step, 0.0, 0.02, 30.0, ranges.astype(np.float32))


class NoOutputs:
    """Outputs of a node that keep its log and nothing else."""

    def __init__(self) -> None:
        self.log_lines: list[str] = []
        self.topics: tuple[str, ...] = ()

    def now_ns(self) -> int:
        return time.time_ns()

    def map(self, message: object) -> None:
        pass

    def transform(self, message: object) -> None:
        pass

    def pose(self, message: PoseMessage) -> None:
        pass

    def particles(self, message: object) -> None:
        pass

    def map_update(self, message: object) -> None:
        pass

    def updated_pose(self, message: object) -> None:
        pass

    def diagnostics(self, message: object) -> None:
        pass

    def entropy(self, nats: float) -> None:
        pass

    def log(self, level: Level, text: str) -> None:
        self.log_lines.append(text)


@final
@dataclass(frozen=True)
class Load:
    """What a node did under load.

    Attributes
    ----------
    parts_s : dict of str to (N,) float64, s
        Of each scan that was mapped: from its coming to its transform, and what of this went where.
    sent, dropped, refused, corrections : int
        Scans; and how often the past was corrected.
    cpu_s : float, s
        Of the node, all its threads.
    memory_mb : list of float
        Resident, once a second.
    """

    parts_s: dict[str, FloatArray]
    sent: int
    dropped: int
    refused: int
    corrections: int
    cpu_s: float
    memory_mb: list[float]


def resident_mb(process: int | str = "self") -> float:
    """Resident memory of a process, by Linux."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6
