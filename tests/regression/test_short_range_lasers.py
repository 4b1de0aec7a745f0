"""Lasers that see a few metres: along directions that scans leave weak the odometry determines the motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.config import Configuration
from gridslam.evaluation import relative_errors_by_distance
from gridslam.geometry.se2 import between
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import Trajectory
from simulated import map_drive


def test_a_laser_of_short_range_is_better_than_its_odometry():
    """Of the same world in which the final trajectory errs by 0.8 of the odometry where that has no weight."""
    lidar = LidarConfig(beams=240, field_of_view_rad=math.radians(240), range_max_m=4.0, sigma_range_m=0.02)
    rng = np.random.default_rng(201)
    log = simulate(make_world("random", rng), RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(201))
    _, full = map_drive(log.measurements, Configuration(), 0)
    odometry = np.array([reading.pose for reading, _ in log.measurements])
    odometry_m, final_m = (
        relative_errors_by_distance(
            Trajectory(log.truth.stamps_ns, between(poses[0], poses)), log.truth, 1.0
        ).trans_rmse_m
        for poses in (odometry, full.poses)
    )
    assert odometry_m == pytest.approx(0.022, abs=0.001)
    assert final_m < 0.76 * odometry_m
