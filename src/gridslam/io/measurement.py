"""A measurement of a log: one laser scan and its odometry."""

from __future__ import annotations

from typing import NamedTuple

from gridslam.types import LaserScan, Odometry

FARTHEST_M = 1e9
"""No robot on Earth is farther from where its odometry began: such a number is a damaged one."""
FARTHEST_LASER_M = 100.0
"""No laser sits farther from the middle of its robot."""


class Measurement(NamedTuple):
    """One step of a log.

    Attributes
    ----------
    odometry : Odometry or None
        Pose of the robot's base in the odometry frame; None where the log has none for this scan.
    scan : LaserScan
        The scan, at its own stamp.
    """

    odometry: Odometry | None
    scan: LaserScan
