"""Scans with beam times in localization: straightened, in the order by which they fit the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization
from gridslam.matching.beam_order import BeamOrder
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, simulate
from gridslam.types import Beams, LaserScan, ScanGeometry
from support.localization_world import flat, flat_map

LIDAR = LidarConfig(rate_hz=5.0, scan_time_s=0.15, reports_beam_times=True)
RANGES = np.array([1.0, 2.0, 3.0])


@pytest.fixture(scope="module")
def known():
    return KnownMap(flat_map())


@pytest.fixture(scope="module")
def log():
    return simulate(flat(), RobotConfig(), OdometryNoise(), LIDAR, np.random.default_rng(3))


def test_turning_scans_are_straightened_by_the_order_that_fits():
    geometry = ScanGeometry(np.array([-0.5, 0.0, 0.5]))
    scan = LaserScan.from_ranges(0, RANGES, geometry, range_max_m=30.0)
    beams = replace(scan, beam_times_s=np.array([0.0, 0.05, 0.1])).beams(0.1, 29.0)
    ends = {order: beams.deskew(order * np.array([0, 0, 1.0])).ends for order in (1, -1)} | {0: beams.ends}

    def straightened(gains: dict[int, float], turn_rps: float) -> np.ndarray:
        def share(one: Beams) -> float:
            return 0.6 + gains[next(k for k, known in ends.items() if np.array_equal(one.ends, known))]

        twist = np.array([0, 0, turn_rps])
        return beams.deskew(BeamOrder().learn(beams, twist, share).best(0.05) * twist).ends

    for gains, order in (
        ({1: 0, 0: 0, -1: 0}, 1), ({1: 0, 0: 0.04, -1: 0.04}, 1), ({1: 0, 0: 0.1, -1: 0.2}, -1),
        ({1: 0, 0: 0.2, -1: 0.1}, 0), ({1: 0.1, 0: 0, -1: 0.14}, 1),
    ):  # fmt: skip
        np.testing.assert_array_equal(straightened(gains, 1.0), ends[order])
    slow = np.array([0, 0, 0.19])  # 0.019 rad in a scan
    np.testing.assert_array_equal(straightened({}, 0.19), beams.deskew(slow).ends)


def heading_rmse(known, log, order, margin):
    """Of the pose that is told, in rad, where the driver tells `order` times the times of beams."""
    mcl, rng = (
        MonteCarloLocalization(known, MonteCarloConfiguration(beam_order_margin=margin)),
        np.random.default_rng(0),
    )
    state, off = mcl.init_gaussian(log.truth.poses[0], np.diag([0.04, 0.04, 0.01]), rng), []
    for (odometry, scan), truth in zip(log.measurements[:150], log.truth.poses, strict=False):
        told = replace(scan, beam_times_s=order * scan.beam_times_s)
        state, report = mcl.step(state, odometry, told, rng)
        off.append(report.pose[2] - truth[2])
    return float(np.sqrt(np.mean(np.square(wrap(np.array(off))))))


def test_times_that_a_driver_tells_backward_do_not_turn_the_pose(known, log):
    """At 1 rad/s a scan of 0.15 s is bent by 0.15 rad, and by as much again where it is straightened the wrong way."""
    assert heading_rmse(known, log, -1.0, 1.0) > 0.05
    assert heading_rmse(known, log, -1.0, 0.05) < 0.02
    assert heading_rmse(known, log, 1.0, 0.05) < 1.1 * heading_rmse(known, log, 1.0, 1.0)
