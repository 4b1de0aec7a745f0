"""A short simulated drive, and how the tests of the trunk play measurements into a filter."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import Trajectory

SCANS = 120


@pytest.fixture(scope="session")
def drive() -> SimulatedLog:
    """The first 24 s (some 12 m) of a drive through an office with poor odometry; the truth starts at the origin.

    Aligned, the odometry alone strays from the truth by 0.68 m.
    """
    rng = np.random.default_rng(5)
    poor = OdometryNoise(distance_scale=1.03, turn_scale=0.93, bias_rad_per_m=0.01)
    whole = simulate(make_world("demo", rng), RobotConfig(), poor, LidarConfig(beams=120), rng)
    stamps = whole.truth.stamps_ns[:SCANS]
    truth = Trajectory(stamps, between(whole.truth.poses[0], whole.truth.poses[:SCANS]))
    odometry = Trajectory(stamps, whole.odometry.poses[:SCANS])
    return SimulatedLog(whole.measurements[:SCANS], truth, odometry, whole.walls)


@pytest.fixture(scope="session")
def play() -> Callable:
    """Play measurements into a filter: the state after the last one, and all reports."""

    def played(slam, measurements, *, particles=5, seed=0, state=None, rng=None):
        rng = rng or np.random.default_rng(seed)
        reports = []
        for odometry, scan in measurements:
            if state is None:
                state, report = slam.init(odometry, scan, particles)
            else:
                state, report = slam.step(state, odometry, scan, rng)
            reports.append(report)
        return state, reports

    return played


@pytest.fixture(scope="session")
def contents() -> Callable:
    """All bytes of a state, by name."""

    def of(state):
        return {name: (str(a.dtype), a.shape, a.tobytes()) for name, a in state.to_arrays().items()}

    return of
