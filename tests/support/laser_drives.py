"""Drives seen by a perfect laser, without scans, and simulated logs that are worth checking by motion."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable

import numpy as np

from gridslam.doctor.laser_motion import LaserMotion, LaserMotionEstimator
from gridslam.geometry.se2 import compose, exp
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

RATE_HZ = 10.0
EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FAIR = OdometryNoise(1.0, 1.0, 0.0)


def laser_motion(measurements: Iterable[Measurement]) -> LaserMotion:
    """The motion of the only laser of a log."""
    estimator = LaserMotionEstimator()
    for measurement in measurements:
        estimator.add(measurement)
    return estimator.motion


def path(times: np.ndarray) -> np.ndarray:
    """Poses (K, 3) of a robot that speeds up and down, and turns left more than right; smooth, so exact at any time."""
    fine = np.arange(-2.0, times[-1] + 1.01, 0.01)
    speed = 0.4 + 0.2 * np.sin(0.7 * fine)
    turn = 0.5 * np.sin(1.1 * fine) + 0.4 * np.sin(0.37 * fine) + 0.1
    heading = np.concatenate([[0.0], np.cumsum(0.01 * 0.5 * (turn[1:] + turn[:-1]))])
    vx, vy = speed * np.cos(heading), speed * np.sin(heading)
    x, y = (np.concatenate([[0.0], np.cumsum(0.005 * (v[1:] + v[:-1]))]) for v in (vx, vy))
    return np.stack([np.interp(times, fine, values) for values in (x, y, heading)], axis=1)


def told(poses: np.ndarray, scale: float, turn_scale: float, drift: float) -> np.ndarray:
    """Odometry (K, 3) of a robot at poses (K, 3), with headings that are not wrapped."""
    metres = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turns = np.diff(poses[:, 2])
    x, y, turn = exp(np.stack([scale * metres, np.zeros(len(turns)), turn_scale * turns + drift * metres], axis=1)).T
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    c, s = np.cos(heading[:-1]), np.sin(heading[:-1])
    way = np.cumsum([c * x - s * y, s * x + c * y], axis=1)
    return np.column_stack([np.insert(way, 0, 0.0, axis=1).T, heading])


def perfect(
    seconds: float = 120.0,
    *,
    scale=1.0,
    turn_scale=1.0,
    drift=0.0,
    skew_s=0.0,
    reflected=False,
    mounting=(0.1, 0.05, 0.2),
    declared_yaw=0.2,
    noise=(0.0, 0.0),
    rng=None,
) -> LaserMotion:
    """The motion of a laser whose every pose is right but for noise (m, rad), and odometry with errors."""
    times = np.arange(0, seconds, 1 / RATE_HZ)
    fine = np.arange(-1.0, seconds + 1.0, 0.01)
    odometry = told(path(fine), scale, turn_scale, drift)
    laser = compose(path(times), mounting)
    if rng is not None:
        laser = laser + rng.standard_normal(laser.shape) * [noise[0], noise[0], noise[1]]
    if reflected:
        laser = laser * [1, -1, -1]
    at = np.stack([np.interp(times + skew_s, fine, column) for column in odometry.T], axis=1)
    stamps = np.round(1e9 * times).astype(np.int64)
    covariance = np.diag([max(noise[0], 1e-3) ** 2, max(noise[0], 1e-3) ** 2, max(noise[1], 1e-3) ** 2])
    count = len(times)
    return LaserMotion(
        "laser",
        stamps,
        laser,
        np.tile(covariance, (count, 1, 1)),
        np.ones(count),
        np.zeros(count, np.int64),
        at,
        stamps,
        np.array([mounting[0], mounting[1], declared_yaw]),
        False,
    )


@functools.cache
def log(
    world: str = "rooms",
    scans: int = 450,
    seed: int = 0,
    noise: OdometryNoise = FAIR,
    beams: int = 180,
    view_rad: float = math.pi,
    rate_hz: float = 5.0,
    scan_time_s: float = 0.0,
) -> tuple[tuple[Measurement, ...], np.ndarray]:
    """Measurements and true poses of a simulated drive."""
    rng = np.random.default_rng(seed)
    lidar = LidarConfig(beams=beams, field_of_view_rad=view_rad, rate_hz=rate_hz, scan_time_s=scan_time_s)
    made = simulate(make_world(world, rng), RobotConfig(), noise, lidar, rng)
    return made.measurements[:scans], made.truth.poses[:scans]
