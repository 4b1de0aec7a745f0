"""Calibration of the odometry: a drive around a ring whose odometry turns too little, with the truth."""

from dataclasses import replace

import numpy as np

from gridslam.evaluation import align
from gridslam.geometry.se2 import transform_points
from gridslam.models.landmark import RangeBearing
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.slam.landmarks.calibration import calibrate_odometry
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.filters import LandmarkFilters
from support.landmark_world import INCREMENT, MOTION, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
BIAS = SystematicErrors(sigma_per_m=0.06, sigma_per_rad=0.0, memory_m=1e9)
PER_M = 0.1


def test_fastslam_by_a_calibrated_odometry_is_as_good_as_by_one_without_systematic_errors():
    """Two drives once around; the error per metre is found within three standard deviations, 0.004 rad/m each."""
    errors = {"exact": [], "told": [], "calibrated": []}
    for seed in range(2):
        exact, truth = drive(ring(12), 160, np.random.default_rng(seed), SENSOR)
        told = [replace(step, increment=step.increment - [0, 0, PER_M * INCREMENT[0]]) for step in exact]
        calibrated = calibrate_odometry(told, EkfSlam(SENSOR, bias=BIAS), MOTION)
        left = np.array([a.increment - b.increment for a, b in zip(exact, calibrated, strict=True)])
        assert abs(left[:, 2].mean() / INCREMENT[0]) < 0.2 * PER_M
        for name, steps in (("exact", exact), ("told", told), ("calibrated", calibrated)):
            errors[name].append(_landmark_error(steps, truth, seed))
    exact, told, calibrated = (np.mean(errors[name]) for name in ("exact", "told", "calibrated"))
    assert calibrated < 1.3 * exact
    assert told > 2 * calibrated


def _landmark_error(steps, truth, seed):
    slam, rng = FastSlam2(LandmarkFilters(SENSOR)), np.random.default_rng(seed)
    state = slam.init(20)
    for step in steps:
        state, _ = slam.step(state, step.motion(MOTION), step.observations, rng)
    path = state.ancestry.trajectory(state.best)[1:, :2]
    found = slam.landmark_map(state)
    turned = transform_points(align(path, truth[:, :2]), found.positions)
    return np.sqrt(np.square(np.hypot(*(turned - ring(12)[found.names - 100]).T)).mean())
