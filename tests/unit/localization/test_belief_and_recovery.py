"""What a cloud of particles says, when a robot is taken as lost, and how poses are drawn from a scan."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.localization import KnownMap
from gridslam.localization.belief import estimate_pose, propagate_covariance
from gridslam.localization.recovery import AugmentedRecovery, InlierRatioAverages, MeasurementProposal
from gridslam.models.endpoint import LikelihoodField
from support.localization_world import drive, flat_map

TRUE = np.array([[0.01, 0.003, 0.0], [0.003, 0.02, 0.001], [0.0, 0.001, 0.004]])


def cloud(rng: np.random.Generator, mean: np.ndarray, count: int = 4000) -> np.ndarray:
    poses = rng.multivariate_normal(mean, TRUE, count)
    poses[:, 2] = wrap(poses[:, 2])
    return poses


@pytest.mark.parametrize("theta", [0.3, math.pi - 0.02, -math.pi])
def test_one_cluster(theta):
    mean = np.array([3.0, -2.0, theta])
    poses = cloud(np.random.default_rng(0), mean)
    told = estimate_pose(poses, np.full(4000, 1 / 4000))
    away = told.pose - mean
    away[2] = wrap(away[2])
    # Mean of 4000: its deviation is 0.14 m / 63.
    np.testing.assert_allclose(away, 0, atol=5 * 0.15 / 63)
    # An entry of a sample's covariance has a deviation of at most sqrt(2 / 4000) of the greatest variance.
    np.testing.assert_allclose(told.covariance, TRUE, atol=5 * math.sqrt(2 / 4000) * 0.02)
    assert told.mass == pytest.approx(1.0)


def test_the_information_of_few_particles_is_unbiased():
    """What judges an error is the inverse of the covariance; that of 40 particles is right on average."""
    rng, found = np.random.default_rng(3), []
    for _ in range(1500):
        poses = rng.multivariate_normal([0, 0, 0], 0.1 * TRUE, 40)
        found.append(np.linalg.inv(estimate_pose(poses, np.full(40, 1 / 40)).covariance))
    # A diagonal entry from 40 has a deviation of about sqrt(2 / 35) of itself; its mean over 1500 of 0.6 %.
    np.testing.assert_allclose(np.diag(np.mean(found, axis=0)), np.diag(np.linalg.inv(0.1 * TRUE)), rtol=5 * 0.006)


def test_moved_covariance_by_finite_differences():
    way = np.array([0.7, -0.4])
    heading = 0.3

    def end(pose: np.ndarray) -> np.ndarray:
        turn = pose[2] - heading
        c, s = math.cos(turn), math.sin(turn)
        return pose + np.array([c * way[0] - s * way[1], s * way[0] + c * way[1], 0.0])

    start, step = np.array([0.0, 0.0, heading]), 1e-6
    jacobian = np.column_stack([(end(start + step * e) - end(start - step * e)) / (2 * step) for e in np.eye(3)])
    expected = jacobian @ TRUE @ jacobian.T + 0.1 * np.eye(3)
    np.testing.assert_allclose(propagate_covariance(TRUE, way, 0.1 * np.eye(3)), expected, atol=1e-9)


def test_averages_are_those_of_the_table():
    recovery = AugmentedRecovery(alpha_slow=0.01, alpha_fast=0.2, expected=0.6)
    averages = recovery.begin()
    slow = fast = 0.6
    for inlier_ratio in (0.9, 0.8, 0.1, 0.1, 0.1):
        averages, share = recovery(averages, inlier_ratio)
        slow, fast = slow + 0.01 * (inlier_ratio - slow), fast + 0.2 * (inlier_ratio - fast)
        assert averages == pytest.approx(InlierRatioAverages(slow, fast))
        assert share == pytest.approx(max(0, 1 - fast / slow))
    assert share > 0.3
    assert recovery(averages, 0.1, 0.5)[1] == pytest.approx(0.5 * share, rel=0.2)
    assert recovery(averages, 0.0, 0.0) == (averages, 0.0)  # a scan that sees nothing of the map


def test_weights_of_drawn_poses_add_up_to_the_evidence():
    """Their sum is the mean of p(z | x) over the free space, whatever they were drawn with: 40 draws against a grid."""
    known, log = KnownMap(flat_map()), drive(1)
    beams = log.measurements[10].scan.beams(0.05, 30.0)
    weigh = known.condition(LikelihoodField(tempering=0.003), beams)
    exact = np.exp(weigh(known.sample_poses(400_000, np.random.default_rng(0)))).mean()
    for concentration in (0.0, 5.0):
        proposal = MeasurementProposal(
            concentration=concentration, draws=2000, samples_per_m2=200, jitter_m=0, jitter_rad=0
        )
        sums = []
        for seed in range(40):
            _, log_weights = proposal(known, beams, weigh, 1.0, np.random.default_rng(seed))
            sums.append(np.exp(log_weights).sum())
        assert np.mean(sums) == pytest.approx(exact, abs=5 * np.std(sums) / math.sqrt(40))
        assert np.std(sums) < 0.3 * exact
