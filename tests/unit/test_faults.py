"""Faults of simulated logs; the sizes of most are those that the tests of the doctor find again."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from support.faults import FAULTS, with_fault

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
