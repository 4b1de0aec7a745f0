"""EKF SLAM's covariances tell the truth where its noise is the true one."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from gridslam.evaluation import nees
from gridslam.models.landmark import RangeBearing
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from support.landmark_world import MOTION, drive, ring

RUNS, STEPS = 40, 100
SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)


def test_nees_of_ekf_slam_lies_in_its_band():
    """Average NEES of 40 runs at each of 100 steps, three quarters around a ring of 12 landmarks.

    Each average is chi-square with 120 degrees of freedom over 40, within [2.29, 3.81] with 95 %. The averages of one
    step and the next are correlated, so the share within has a wide spread: 0.90 instead of 0.95 is asked of it. The
    mean over all steps has an expectation of 3, and a spread well below that of a single step, 0.39.
    """
    average, band = _average_nees()
    assert ((average >= band[0]) & (average <= band[1])).mean() >= 0.9
    assert 2.5 < average.mean() < 3.5


def _average_nees() -> tuple[np.ndarray, list[float]]:
    """Of many runs at each step, and its 95 % band.

    Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
    """
    estimates, truths, covariances = [], [], []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        steps, truth = drive(ring(12), STEPS, rng, SENSOR)
        slam, reports = EkfSlam(SENSOR), []
        state = slam.init()
        for step in steps:
            state, report = slam.step(state, MOTION(step.increment), step.observations)
            reports.append(report)
        truths.append(truth)
        estimates.append([report.pose for report in reports])
        covariances.append([report.covariance for report in reports])
    E, T, C = np.array(estimates), np.array(truths), np.array(covariances)
    average = np.array([nees(E[:, k].copy(), T[:, k], C[:, k]).mean() for k in range(STEPS)])
    return average, [float(chdtri(3 * RUNS, share)) / RUNS for share in (0.975, 0.025)]
