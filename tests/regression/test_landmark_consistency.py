"""EKF SLAM's covariances tell the truth where its noise is the true one."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from gridslam.evaluation import nees
from gridslam.models.landmark import RangeBearing
from gridslam.models.systematic_errors import NO_ERRORS, SystematicErrors
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from support.landmark_world import INCREMENT, MOTION, drive, ring

RUNS, STEPS = 20, 100
SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
WRONG = SystematicErrors(sigma_per_m=0.06, sigma_per_rad=0.0, memory_m=1e9)


def test_nees_of_ekf_slam_lies_in_its_band():
    """Average NEES of 20 runs at each of 100 steps, three quarters around a ring of 12 landmarks.

    Each average is chi-square with 60 degrees of freedom over 20, within [2.02, 4.16] with 95 %. The averages of one
    step and the next are correlated, so the share within has a wide spread: 0.90 instead of 0.95 is asked of it. The
    mean over all steps has an expectation of 3, and a spread well below that of a single step, 0.55.
    """
    average, band = _average_nees(NO_ERRORS, NO_ERRORS)
    assert ((average >= band[0]) & (average <= band[1])).mean() >= 0.9
    assert 2.5 < average.mean() < 3.5


def test_it_stays_in_its_band_where_it_learns_how_odometry_errs_and_leaves_it_where_it_does_not():
    """The same of 15 runs where each's odometry turns too little by what is drawn from the prior.

    By 0.06 rad a metre, 1.2 rad over the 20 m, beside noise that adds up to 0.2 rad: who takes it for noise is far out.
    """
    average, band = _average_nees(WRONG, WRONG, runs=15)
    assert ((average >= band[0]) & (average <= band[1])).mean() >= 0.9
    assert 2.5 < average.mean() < 3.5
    assert _average_nees(WRONG, NO_ERRORS, runs=8)[0].mean() > 4


def _average_nees(true: SystematicErrors, sought: SystematicErrors, runs: int = RUNS) -> tuple[np.ndarray, list[float]]:
    """Of many runs at each step, and its 95 % band; the errors are drawn from one and sought by another.

    Source: Bar-Shalom, Li, Kirubarajan 2001, section 5.4.2.
    """
    estimates, truths, covariances = [], [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        steps, truth = drive(ring(12), STEPS, rng, SENSOR)
        too_little = rng.normal(0, true.sigma_per_m) * INCREMENT[0] + rng.normal(0, true.sigma_per_rad) * INCREMENT[2]
        slam, reports = EkfSlam(SENSOR, bias=sought), []
        state = slam.init()
        for step in steps:
            told = MOTION(step.increment - [0, 0, too_little])
            state, report = slam.step(state, told, step.observations)
            reports.append(report)
        truths.append(truth)
        estimates.append([report.pose for report in reports])
        covariances.append([report.covariance for report in reports])
    E, T, C = np.array(estimates), np.array(truths), np.array(covariances)
    average = np.array([nees(E[:, k].copy(), T[:, k], C[:, k]).mean() for k in range(STEPS)])
    return average, [float(chdtri(3 * runs, share)) / runs for share in (0.975, 0.025)]
