"""Faults of simulated logs; the sizes of most are those that the tests of the doctor find again."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import LaserScan, ScanGeometry
from support.faults import FAULTS, tilted_laser, with_fault

EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def log() -> SimulatedLog:
    """Exact odometry, a laser askew and off-centre that sees 10 m: 3 scans a second."""
    rng = np.random.default_rng(0)
    lidar = LidarConfig(beams=90, range_max_m=10.0, x_m=0.2, heading_rad=0.5, rate_hz=3.0)
    return simulate(make_world("rooms", rng), RobotConfig(), EXACT, lidar, rng)


def faulty(log: SimulatedLog, name: str, size: float | None = None, seed: int = 0) -> list[Measurement]:
    return list(with_fault(log.measurements, name, np.random.default_rng(seed), size))


def stamps(measurements) -> np.ndarray:
    return np.array([scan.stamp_ns for _, scan in measurements])


def odometry(measurements) -> np.ndarray:
    return np.array([reading.pose for reading, _ in measurements])


def test_all_faults_are_streams_that_one_seed_repeats(log):
    for name in FAULTS:
        first, again = (faulty(log, name, seed=3) for _ in range(2))
        assert [m.scan.ranges.tobytes() for m in first] == [m.scan.ranges.tobytes() for m in again]
        assert odometry(first).tobytes() == odometry(again).tobytes()
        assert (stamps(first) == stamps(again)).all()
        endless = iter(with_fault(iter(log.measurements), name, np.random.default_rng(0)))
        assert isinstance(next(endless), Measurement)


def test_stamps_go_backward_or_repeat(log):
    count = len(log) - 1
    for name, size, step_s, share in (("backward_stamps", 0.05, -0.05, 0.02), ("duplicate_stamps", 0.1, 0.0, 0.1)):
        steps = np.diff(stamps(faulty(log, name, size)))
        wrong = steps <= 0
        assert (steps[wrong] == round(step_s * 1e9)).all()
        assert wrong.mean() == pytest.approx(share, abs=5 * math.sqrt(share / count))  # a binomial share
        assert wrong.any()


def room_scan(bearings: np.ndarray) -> LaserScan:
    """From the middle of a room 4 m x 4 m."""
    return LaserScan.from_ranges(
        0, 2.0 / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings))), ScanGeometry(bearings), range_max_m=9.0
    )


def test_a_tilted_laser_sees_the_floor_before_it_and_the_ceiling_behind():
    scan = room_scan(np.linspace(-math.pi, math.pi, 721))
    (_, tilted) = next(tilted_laser([Measurement(None, scan)], 0.2))
    # Ahead the floor, 0.3 m down; aside the wall; behind the wall again, reached 0.4 m up, below the ceiling.
    assert tilted.ranges[[360, 540, 0]] == pytest.approx([0.3 / math.sin(0.2), 2.0, 2.0 / math.cos(0.2)], rel=1e-6)
    assert tilted.geometry is scan.geometry
    (_, steep) = next(tilted_laser([Measurement(None, scan)], 1.4))
    assert steep.ranges[0] == pytest.approx(2.2 / math.sin(1.4), rel=1e-6)
