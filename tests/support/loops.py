"""A short drive around a block, and a configuration that closes its loop and corrects the past whatever the tuning."""

from __future__ import annotations

import numpy as np

from gridslam.config import Configuration, override
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate

PROVOKED = override(
    Configuration(),
    "particles=4",  # and hardly any way is short enough
    "loop_closure.places.certain_sigma_m=0.02",
    "loop_closure.recognition.certain_sigma_m=0.02",
    "loop_closure.recognition.length_m=15",
    "loop_closure.recognition.step_m=5",
    "loop_closure.recognition.min_matches=2",
    "loop_closure.disagree_sigmas=0.01",  # what is recognized is corrected
)


def loop_drive() -> SimulatedLog:
    """80 m that come back to where they began, 399 scans, some 200 of them key scans."""
    rng = np.random.default_rng(1)
    lidar, odometry = LidarConfig(rate_hz=3.0), OdometryNoise(bias_rad_per_m=0.01)
    return simulate(make_world("loop", rng), RobotConfig(v_max_m_s=1.0), odometry, lidar, rng)
