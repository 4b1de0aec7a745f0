"""What FastSLAM 2.0 does not draw: where a group of landmarks lies that was first seen from a pose known badly."""

from __future__ import annotations

import numpy as np

from gridslam.geometry.se2 import compose
from gridslam.models.landmark import NO_OBSERVATIONS, LandmarkObservations, RelativePosition
from gridslam.models.motion import GaussianIncrement
from gridslam.particles.policies import NeverResample
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.local_frame import FastSlam2WithLocalFrames
from gridslam.slam.landmarks.particles import smooth_trajectory

SENSOR = RelativePosition(sigma_x_m=0.1, sigma_y_m=0.1)
STILL = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))
AWAY, BACK = np.array([4.0, 0.0, 0.0]), np.array([-4.0, 0.0, 0.0])
BLIND = GaussianIncrement.from_std(AWAY, np.array([0.5, 0.3, 0.0]))


def along(filters: list, steps: list) -> list:
    """States of FastSLAM 2.0 (with its generator) and of EKF SLAM after the same steps."""
    (slam, particles), ekf = filters
    rng, state, other = np.random.default_rng(0), slam.init(particles), ekf.init()
    for motion, seen in steps:
        state, report = slam.step(state, motion, seen, rng)
        other, expected = ekf.step(other, motion, seen)
    return [state, report, other, expected]


def test_a_raft_is_corrected_as_ekf_slam_corrects_the_landmarks_on_it():
    """The spell alone is uncertain, and all is linear: a particle has what EKF SLAM has, covariances too."""
    slam, ekf = FastSlam2WithLocalFrames(LandmarkFilters(SENSOR)), EkfSlam(SENSOR)
    steps = [
        (STILL, LandmarkObservations.of([[1.0, 1.0]], [1])),
        (BLIND, LandmarkObservations.of([[2.0, 0.5], [1.0, -1.0]], [3, 4])),
        (GaussianIncrement.from_std(BACK, np.zeros(3)), LandmarkObservations.of([[1.4, 0.8]], [1])),
    ]
    state, report, other, expected = along([(slam, 3), ekf], steps[:2])
    assert state.in_local_frame.all()
    assert state.landmark_in_local_frame[:, [state.column(3), state.column(4)]].all()
    assert not state.landmark_in_local_frame[:, state.column(1)].any()
    assert len(np.unique(state.poses, axis=0)) == 1  # nothing was drawn
    np.testing.assert_allclose(report.covariance, expected.covariance, atol=1e-12)
    state, report, other, expected = along([(slam, 3), ekf], steps)
    np.testing.assert_allclose(report.pose, expected.pose, atol=1e-9)
    np.testing.assert_allclose(report.covariance, expected.covariance, atol=1e-9)
    ours, theirs = slam.landmark_map(state), ekf.landmark_map(other)
    assert ours.names.tolist() == theirs.names.tolist() == [1, 3, 4]
    np.testing.assert_allclose(ours.positions[1:], theirs.positions[1:], atol=1e-9)
    np.testing.assert_allclose(ours.covariances[1:], theirs.covariances[1:], atol=1e-9)
    # The robot's way on the raft moves with it: what it saw there it saw from there.
    way = smooth_trajectory(state, state.best, [motion for motion, _ in steps])
    np.testing.assert_allclose(way[2, :2] + [2.0, 0.5], ours.positions[1], atol=1e-9)
    np.testing.assert_allclose(way[3], report.pose, atol=1e-12)


def test_many_particles_with_a_raft_find_what_the_kalman_filter_finds_where_all_is_linear():
    """There and back twice, with noise at every step: pose and landmarks, adrift or not, are EKF SLAM's."""
    slam, ekf = FastSlam2WithLocalFrames(LandmarkFilters(SENSOR), when_to_resample=NeverResample()), EkfSlam(SENSOR)
    noise, rng = np.array([0.05, 0.05, 0.0]), np.random.default_rng(3)
    true, pose, steps = {1: [1.0, 1.0], 2: [0.0, -1.0], 3: [6.0, 0.5], 4: [5.0, -1.0]}, np.zeros(2), []
    for increment, names in ([STILL.increment, (1, 2)], [AWAY, (3, 4)], [AWAY * 0, (3,)], [BACK, (1,)], [AWAY, (4,)]):
        std = np.array([0.5, 0.3, 0.0]) if increment.any() else noise * bool(steps)
        pose = pose + increment[:2] + std[:2] * rng.standard_normal(2)
        seen = [true[name] - pose + rng.normal(0, 0.1, 2) for name in names]
        steps.append((GaussianIncrement.from_std(increment, std), LandmarkObservations.of(seen, names)))
    state, report, other, expected = along([(slam, 20_000), ekf], steps)
    assert state.local_frame_covariances.any()
    ours, theirs = slam.landmark_map(state), ekf.landmark_map(other)
    # Means err by 0.4 m / sqrt(N_eff) = 0.01 m at most, five times that; variances by sqrt(2 / N_eff) = 3 %, and what
    # one sighting from the raft tells of landmarks across is counted less than it tells.
    assert report.n_eff > 1500
    np.testing.assert_allclose(ours.positions, theirs.positions, atol=0.05)
    np.testing.assert_allclose(report.covariance, expected.covariance, atol=0.2 * theirs.covariances.max())
    np.testing.assert_allclose(ours.covariances, theirs.covariances, atol=0.2 * theirs.covariances.max())


def test_what_was_not_drawn_is_told_from_both_ends():
    """Two equal motions without a sighting between poses that are drawn: half of the second's error is the first's."""
    slam, rng = FastSlam2WithLocalFrames(LandmarkFilters(SENSOR)), np.random.default_rng(4)
    wide = GaussianIncrement.from_std(np.array([1.0, 0.0, 0.0]), np.array([0.3, 0.3, 0.0]))
    motions = [STILL, wide, wide, wide]
    state, _ = slam.step(slam.init(1), STILL, LandmarkObservations.of([[5.0, 0.0]], [1]), rng)
    for motion, seen in (
        (wide, NO_OBSERVATIONS),
        (wide, LandmarkObservations.of([[2.4, 0.6]], [1])),
        (wide, NO_OBSERVATIONS),
    ):
        state, _ = slam.step(state, motion, seen, rng)
    way, told = smooth_trajectory(state, 0, motions), state.ancestry.trajectory(0)[:, :3]
    np.testing.assert_allclose(way[[0, 1, 3]], told[[0, 1, 3]])
    np.testing.assert_allclose(way[2], told[3] / 2, atol=1e-12)
    np.testing.assert_allclose(way[4], compose(told[3], [1.0, 0.0, 0.0]), atol=1e-12)
