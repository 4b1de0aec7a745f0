"""The columns of a CSV of scans, and how a laser's mounting stands in them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from gridslam.types import FloatArray

__all__ = [
    "COLUMNS", "LASER", "ODOMETRY", "REQUIRED", "angles_of_rotation", "rotation_of_angles",
]  # fmt: skip

ODOMETRY = "odom_x_m", "odom_y_m", "odom_theta_rad"
"""Columns of the odometry; all three are empty where a scan has none."""

LASER = "laser_x_m", "laser_y_m", "laser_z_m", "laser_roll_rad", "laser_pitch_rad", "laser_yaw_rad"
"""Columns of the mounting: the laser seen from the base; empty is 0."""

REQUIRED = "stamp_s", "angle_min_rad", "angle_increment_rad", "ranges_m"
"""Columns without which there is no scan."""

COLUMNS = (
    "stamp_s", "sensor", "frame", *ODOMETRY, "odom_stamp_s", *LASER, "angle_min_rad", "angle_increment_rad",
    "time_increment_s", "range_min_m", "range_max_m", "ranges_m",
)  # fmt: skip
"""All columns, as they are written; they are read in any order."""


def rotation_of_angles(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation (3, 3) about the fixed axes x, y, z, one after the other, by angles in rad."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    return np.array([
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ])  # fmt: skip


def angles_of_rotation(rotation: ArrayLike) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad of a rotation (3, 3); roll is 0 where the pitch is a right angle."""
    r = np.asarray(rotation, dtype=np.float64).tolist()
    level = math.hypot(r[0][0], r[1][0])
    pitch = math.atan2(-r[2][0], level)
    if level < 1e-9:
        return 0.0, pitch, math.atan2(-r[0][1], r[1][1])
    return math.atan2(r[2][1], r[2][2]), pitch, math.atan2(r[1][0], r[0][0])
