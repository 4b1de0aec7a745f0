"""FastSLAM 2.0 that learns how the odometry errs: what these errors explain is never drawn."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import compose
from gridslam.models.association import MaximumLikelihood
from gridslam.models.landmark import LandmarkObservations, RangeBearing, RelativePosition
from gridslam.models.motion import DiffusionMotion, GaussianIncrement
from gridslam.models.systematic_errors import SystematicErrors
from gridslam.particles.policies import NeverResample
from gridslam.slam.landmarks.calibrated import BiasProposal, FastSlam2WithCalibration
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.particles import smooth_trajectory
from support.landmark_world import INCREMENT, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.01, sigma_bearing_rad=0.002)
FILTERS = LandmarkFilters(SENSOR)
BIAS = SystematicErrors(sigma_per_m=0.001, sigma_per_rad=0.002, memory_m=1e12)
PER_M, PER_RAD = 0.001, -0.002
TOO_LITTLE = PER_M * INCREMENT[0] + PER_RAD * INCREMENT[2]  # rad a step
NO_NOISE = DiffusionMotion(sigma_xy_m=0, sigma_theta_rad=0, floor_xy_m=0, floor_theta_rad=0)


def test_one_particle_whose_odometry_has_no_noise_is_ekf_slam():
    """Nothing is drawn: pose and all landmarks lean on the odometry's errors alone, and a loop straightens them all."""
    steps, _ = drive(ring(12), 160, np.random.default_rng(0), SENSOR, NO_NOISE)
    slam, ekf = FastSlam2WithCalibration(FILTERS, bias=BIAS), EkfSlam(SENSOR, bias=BIAS)
    rng, state, other = np.random.default_rng(1), slam.init(1), ekf.init()
    told = GaussianIncrement.from_std(INCREMENT - [0, 0, TOO_LITTLE], np.zeros(3))
    for step in steps:
        state, report = slam.step(state, told, step.observations, rng)
        other, expected = ekf.step(other, told, step.observations)
        # The two linearize about means that are a part of a deviation apart: what bends within that, a thousandth.
        sigma = np.sqrt(np.trace(expected.covariance[:2, :2]))
        assert np.hypot(*(report.pose - expected.pose)[:2]) < 0.03 * sigma + 1e-12
        # EKF SLAM linearizes at first estimates, FastSLAM at the newest: as much again.
        np.testing.assert_allclose(report.covariance, expected.covariance, rtol=1e-2, atol=0.01 * sigma**2 + 1e-15)
    ours, theirs = slam.landmark_map(state), ekf.landmark_map(other)
    assert ours.names.tolist() == theirs.names.tolist()
    deviations = np.sqrt(np.trace(theirs.covariances, axis1=1, axis2=2))
    assert (np.hypot(*(ours.positions - theirs.positions).T) < 0.03 * deviations).all()
    np.testing.assert_allclose(ours.covariances, theirs.covariances, atol=0.01 * theirs.covariances.max())
    way = smooth_trajectory(state, 0, [told] * len(steps), BIAS)
    corrected = told.increment + np.array([0, 0, state.state_means[0, 3:] @ INCREMENT[[0, 2]]])
    expected = [np.zeros(3)]
    for _ in steps:
        expected.append(compose(expected[-1], corrected))
    # Of what is learned some mrad are linear in the end, and 8 m away bend by less than 0.1 mm.
    np.testing.assert_allclose(way[:, :2], np.array(expected)[:, :2], atol=1e-4)
    np.testing.assert_allclose(way[-1], state.poses[0], atol=1e-12)


@pytest.mark.parametrize("memory_m", [1e6, 10.0])
def test_many_particles_find_what_ekf_slam_finds(memory_m):
    """Out and back by an odometry with noise that turns too little; headings are small, so that all is nearly linear.

    An error that is learned at the return moves what was mapped before, and leaves the particles their share of it.
    """
    sensor = RelativePosition(sigma_x_m=0.1, sigma_y_m=0.1)
    bias = SystematicErrors(sigma_per_m=0.02, sigma_per_rad=0.0, memory_m=memory_m)
    slam = FastSlam2WithCalibration(LandmarkFilters(sensor), when_to_resample=NeverResample(), bias=bias)
    ekf, rng, seen = EkfSlam(sensor, bias=bias), np.random.default_rng(2), np.random.default_rng(3)
    true, pose = {1: [2.0, 1.0], 2: [6.0, -1.0], 3: [9.0, 1.0]}, np.zeros(3)
    state, other = slam.init(20_000), ekf.init()
    for way, names in [(0.0, [1]), (2.0, [2]), (2.0, [2, 3]), (2.0, [3]), (-2.0, [2]), (-4.0, [1])]:
        pose = compose(pose, [way, 0.0, 0.03 * way + seen.normal(0, 0.02)])
        z = [sensor.linearize(pose, np.array(true[name]))[0] + seen.normal(0, 0.1, 2) for name in names]
        told = GaussianIncrement.from_std(np.array([way, 0.0, 0.0]), np.array([0.02, 0.02, 0.02]))
        state, report = slam.step(state, told, LandmarkObservations.of(z, names), rng)
        other, expected = ekf.step(other, told, LandmarkObservations.of(z, names))
    found, theirs = slam.landmark_map(state), ekf.landmark_map(other)
    # Means err by sigma / sqrt(N_eff) <= 0.03 sigma, five times that; variances by sqrt(2 / N_eff) = 5 %, and as much
    # by what a heading of 0.15 rad bends.
    assert report.n_eff > 1000
    deviations = np.sqrt(np.diagonal(theirs.covariances, axis1=1, axis2=2))
    assert (np.abs(found.positions - theirs.positions) < 0.15 * deviations).all()
    np.testing.assert_allclose(found.covariances, theirs.covariances, atol=0.2 * theirs.covariances.max())
    np.testing.assert_allclose(report.covariance, expected.covariance, atol=0.2 * expected.covariance.max())
    weights = np.exp(state.log_weights)
    sigma = np.sqrt(other.covariance[3, 3])
    assert weights @ state.state_means[:, 3] == pytest.approx(other.mean[3], abs=0.15 * sigma)
    assert (
        weights @ state.state_covariances[:, 3, 3] < sigma**2
    )  # who knows the noise that was drawn knows the rest better


def test_what_is_drawn_tells_nothing_of_the_errors_and_the_rest_of_the_pose_follows_them():
    rng, count = np.random.default_rng(4), 50_000
    root = rng.normal(size=(5, 5)) * [0.1, 0.2, 0.1, 0.3, 0.1]
    C, mean = root @ root.T, np.array([1.0, 2.0, 0.5, 0.01, -0.02])
    state = FastSlam2WithCalibration(FILTERS, bias=BIAS).init(count)
    proposal = BiasProposal(np.tile(mean, (count, 1)), np.tile(C, (count, 1, 1)), state, BIAS)
    proposal.sample(rng)
    known, (left, *others) = proposal.mean, proposal.covariance
    by_bias = C[:3, 3:] @ np.linalg.inv(C[3:, 3:])
    own = C[:3, :3] - by_bias @ C[3:, :3]
    np.testing.assert_array_equal(known[:, 3:], np.tile(mean[3:], (count, 1)))
    np.testing.assert_allclose(left[:, 3:], C[:, 3:], atol=1e-12)
    np.testing.assert_allclose(left[:3, :3], by_bias @ C[3:, :3], atol=1e-12)
    np.testing.assert_array_equal(others[-1], left)
    drawn = known[:, :3] - mean[:3]
    # Five times the sampling error sqrt(2 / count) of the variances.
    np.testing.assert_allclose(drawn.T @ drawn / count, own, atol=5 * np.sqrt(2 / count) * own.max())


def test_correspondences_are_sought_as_far_as_the_errors_reach():
    """The bound by which landmarks are left out never leaves out what the whole Gaussian would take."""
    steps, _ = drive(ring(12), 40, np.random.default_rng(5), SENSOR)
    slam, rng = FastSlam2WithCalibration(LandmarkFilters(SENSOR, MaximumLikelihood()), bias=BIAS), _seed()
    state = slam.init(10)
    for step in steps:
        told = DiffusionMotion(sigma_xy_m=0.02, sigma_theta_rad=0.01)(step.increment)
        state, _ = slam.step(state, told, step.observations.drop_correspondences(), rng)
    belief = BiasProposal(state.state_means.copy(), state.state_covariances.copy(), state, BIAS)
    rows, columns = np.nonzero(state.exists)
    seen = np.trace(belief.covariance_seen_from(rows, columns)[:, :2, :2], axis1=1, axis2=2)
    assert (seen <= np.trace(belief.bound_covariance()[rows, :2, :2], axis1=1, axis2=2)).all()
    assert seen.max() > 0


def _seed() -> np.random.Generator:
    return np.random.default_rng(6)
