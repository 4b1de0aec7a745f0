"""A robot that drives as long and scans as often as asked, and what a node did meanwhile."""

from __future__ import annotations

import itertools
import math
import resource
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, final

import numpy as np

from gridslam.io.measurement import Measurement
from gridslam.ros.node.messages import ScanMessage, StampedTransform
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate_stream
from gridslam.types import FloatArray

__all__ = ["LATENCY", "MOUNTING", "START_S", "Load", "drive", "resident_mb"]

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
        yield _odometry_of(one), _scan_of(one)


def _odometry_of(measurement: Measurement) -> StampedTransform:
    assert measurement.odometry is not None
    x, y, theta = measurement.odometry.pose.tolist()
    pose = (x, y, 0.0, 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
    return StampedTransform(measurement.scan.stamp_ns, "odom", "base_link", pose)


def _scan_of(measurement: Measurement) -> ScanMessage:
    scan = measurement.scan
    bearings = scan.geometry.bearings
    step = float(bearings[-1] - bearings[0]) / (len(bearings) - 1)
    ranges = scan.ranges.astype(np.float32)
    return ScanMessage(scan.stamp_ns, "laser", float(bearings[0]), step, 0.0, 0.02, 30.0, ranges)


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
