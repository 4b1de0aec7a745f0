"""EKF SLAM's covariances tell the truth where its noise is the true one."""

from __future__ import annotations

import numpy as np
from landmark_world import MOTION, drive, ring

from gridslam.evaluation import check_consistency, nees
from gridslam.models.landmark import RangeBearing
from gridslam.slam.ekf_slam import EkfSlam

RUNS, STEPS = 100, 200
SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)


def test_nees_of_ekf_slam_lies_in_its_band():
    """Average NEES of 100 runs at each of 200 steps, once and a half around a ring of 12 landmarks.

    Each average is chi-square with 300 degrees of freedom over 100, within [2.54, 3.50] with 95 %. The averages of one
    step and the next are correlated, so the share within has a wide spread: 0.90 instead of 0.95 is asked of it. The
    mean over all steps has an expectation of 3, and a spread well below that of a single step, 0.25.
    """
    estimates, truths, covariances = [], [], []
    for seed in range(RUNS):
        steps, truth = drive(ring(12), STEPS, np.random.default_rng(seed), SENSOR)
        slam, reports = EkfSlam(SENSOR), []
        state = slam.init()
        for step in steps:
            state, report = slam.step(state, MOTION(step.increment), step.sightings)
            reports.append(report)
        truths.append(truth)
        estimates.append([report.pose for report in reports])
        covariances.append([report.covariance for report in reports])
    E, T, C = np.array(estimates), np.array(truths), np.array(covariances)
    average = np.array([nees(E[:, k].copy(), T[:, k], C[:, k]).mean() for k in range(STEPS)])
    band = check_consistency(E[:, 0], T[:, 0], C[:, 0])
    assert ((average >= band.lower) & (average <= band.upper)).mean() >= 0.9
    assert 2.5 < average.mean() < 3.5
