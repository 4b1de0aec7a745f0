"""EKF localization: the Kalman filter where all is linear, its Jacobians, and whose sightings it believes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from checks import differences
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.localization.ekf import EkfLocalization, KnownLandmarks
from gridslam.models.association import AMBIGUOUS, NEW, KnownCorrespondence, MaximumLikelihood
from gridslam.models.landmark import NO_OBSERVATIONS, DepthBearing, LandmarkObservations, RangeBearing, RelativePosition
from gridslam.models.motion import GaussianIncrement, VelocityMotion
from support.landmark_world import INCREMENT, MOTION, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
RING = KnownLandmarks.of(np.arange(100, 112), ring(12))
STILL = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))
SOME = np.array([[0.04, 0.01, 0.005], [0.01, 0.09, -0.01], [0.005, -0.01, 0.02]])


def test_it_is_the_kalman_filter_where_all_is_linear():
    """A robot that cannot turn, and sees positions: textbook equations over [x, y], sighting by sighting."""
    rng, R, Q = np.random.default_rng(0), np.diag([0.04, 0.01]), np.diag([0.09, 0.25])
    motion = GaussianIncrement.from_std(np.array([0.5, 0.1, 0.0]), np.array([0.2, 0.1, 0.0]))
    places = np.array([[3.0, 1.0], [2.0, -2.0]])
    ekf = EkfLocalization(KnownLandmarks.of([7, 8], places), RelativePosition(sigma_x_m=0.3, sigma_y_m=0.5))
    mean, P, likelihood = np.array([0.2, -0.1]), np.diag([0.3, 0.2]), 0.0
    belief, told = ekf.init([*mean, 0.0], np.diag([0.3, 0.2, 0.0])), 0.0
    for k in range(12):
        seen = [[0, 1], [1], [0], []][k % 4]
        z = rng.normal(places[seen] - mean, 0.5)
        belief, report = ekf.step(belief, motion, LandmarkObservations.of(z.reshape(-1, 2), np.array(seen, int) + 7))
        told += report.log_likelihood
        mean, P = mean + np.array([0.5, 0.1]), P + R
        for j, value in zip(seen, z, strict=True):
            H, e = -np.eye(2), value - (places[j] - mean)
            S = H @ P @ H.T + Q
            likelihood += -0.5 * (e @ np.linalg.solve(S, e) + math.log(np.linalg.det(2 * np.pi * S)))
            K = P @ H.T @ np.linalg.inv(S)
            mean, P = mean + K @ e, (np.eye(2) - K @ H) @ P
    np.testing.assert_allclose(belief.pose, [*mean, 0.0], atol=1e-12)
    np.testing.assert_allclose(belief.covariance[:2, :2], P, atol=1e-12)
    assert told == pytest.approx(likelihood)


@given(st.floats(-3, 3), st.floats(-1, 1), st.floats(-2, 2))
def test_the_prediction_has_the_jacobian_of_the_motion(theta, v, omega):
    """Without noise P becomes G P G', G being the derivative of the mean successor by the pose before."""
    motion = VelocityMotion(*[0.0] * 6)(np.array([v, omega, 0.5]))
    pose = np.array([1.0, -2.0, theta])

    def successor(at):
        (after,), _ = motion.moments(at[None])
        return np.array([after[0], after[1], pose[2] + wrap(after[2] - pose[2])])

    G = differences(successor, pose)
    ekf = EkfLocalization(RING, SENSOR)
    belief, _ = ekf.step(ekf.init(pose, SOME), motion, NO_OBSERVATIONS)
    np.testing.assert_allclose(belief.covariance, G @ SOME @ G.T, atol=1e-8)
    np.testing.assert_allclose(belief.pose[:2], successor(pose)[:2], atol=1e-12)


@settings(deadline=None)
@given(
    st.sampled_from([SENSOR, DepthBearing(), RelativePosition()]), st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1)
)
def test_the_correction_has_the_jacobian_of_the_sensor(sensor, theta, x, y):
    """One sighting: K = P H' (H P H' + Q)^-1 with H from finite differences of what is predicted."""
    pose = np.array([x, y, theta])
    ekf = EkfLocalization(RING, sensor)
    expected = sensor.linearize(pose, RING.positions[3])[0]
    error = np.array([0.05, 0.01])
    z = LandmarkObservations.of([expected + error], [103])
    H = differences(lambda at: sensor.residual(sensor.linearize(at, RING.positions[3])[0], expected), pose)
    K = SOME @ H.T @ np.linalg.inv(H @ SOME @ H.T + sensor.noise(z)[0])
    belief, _ = ekf.step(ekf.init(pose, SOME), STILL, z)
    np.testing.assert_allclose(belief.covariance, (np.eye(3) - K @ H) @ SOME, atol=1e-8)
    moved = belief.pose - pose
    moved[2] = wrap(moved[2])
    np.testing.assert_allclose(moved, K @ error, atol=1e-8)


def run(ekf, steps, known=True):
    belief, reports = ekf.init(np.zeros(3), np.diag([0.01, 0.01, 0.01])), []
    for step in steps:
        seen = step.observations if known else step.observations.drop_correspondences()
        belief, report = ekf.step(belief, MOTION(step.increment), seen)
        reports.append(report)
    return reports


def test_what_is_found_is_what_would_have_been_told_where_landmarks_are_far_apart():
    steps, truth = drive(ring(12), 150, np.random.default_rng(2), SENSOR)
    told = run(EkfLocalization(RING, SENSOR), steps)
    found = run(EkfLocalization(RING, SENSOR, MaximumLikelihood(match_gate=100.0, new_gate=100.0)), steps, known=False)
    for ours, theirs in zip(told, found, strict=True):
        np.testing.assert_array_equal(ours.landmarks, theirs.landmarks)
        np.testing.assert_allclose(ours.pose, theirs.pose, rtol=0, atol=1e-9)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=0, atol=1e-9)
    # Two or three sightings a step of 0.1 m and 0.02 rad at 2 to 5 m: a decimetre, 5 times that is lost.
    assert np.hypot(*(np.array([report.pose for report in told]) - truth)[:, :2].T).max() < 0.5


def exact(pose, *places):
    return SENSOR.linearize(np.asarray(pose, float), RING.positions[list(places)])[0]


@pytest.mark.parametrize(
    "association", [KnownCorrespondence(gate=16.0), MaximumLikelihood(match_gate=16.0, new_gate=25.0)]
)
def test_what_does_not_fit_is_not_believed(association):
    """20 sigma off in bearing: nothing is learned, and the pose is as without it."""
    ekf, tight = EkfLocalization(RING, SENSOR, association), np.diag([1e-6, 1e-6, 1e-6])
    z = exact(np.zeros(3), 1, 4)
    z[1, 1] += 0.1
    belief, report = ekf.step(ekf.init(np.zeros(3), tight), STILL, LandmarkObservations.of(z, [101, 104]))
    alone, _ = ekf.step(ekf.init(np.zeros(3), tight), STILL, LandmarkObservations.of(z[:1], [101]))
    assert report.landmarks[0] == 101
    assert report.landmarks[1] in (AMBIGUOUS, NEW)
    np.testing.assert_array_equal(belief.pose, alone.pose)
    np.testing.assert_array_equal(belief.covariance, alone.covariance)


def test_a_landmark_is_taken_once_at_a_time():
    ekf = EkfLocalization(RING, SENSOR, MaximumLikelihood(match_gate=100.0, new_gate=100.0))
    z = exact(np.zeros(3), 1, 1) + np.array([[0.0, 0.0], [0.05, 0.0]])
    _, report = ekf.step(ekf.init(np.zeros(3), 0.01 * SOME), STILL, LandmarkObservations.of(z))
    assert report.landmarks[0] == 101
    assert report.landmarks[1] in (AMBIGUOUS, NEW)


def test_an_observation_that_two_landmarks_explain_alike_corrects_by_their_mean():
    """Half-way between both nothing is learned of the side, and their spread is noise."""
    pair = KnownLandmarks.of([1, 2], [[4.0, 0.2], [4.0, -0.2]])
    gates = MaximumLikelihood(match_gate=100.0, new_gate=100.0)
    start = EkfLocalization(pair, SENSOR).init(np.zeros(3), np.diag([0.04, 0.04, 0.0025]))
    between = LandmarkObservations.of([[4.0, 0.0]], [1])
    guessed, report = EkfLocalization(pair, SENSOR, gates).step(start, STILL, between)
    told, _ = EkfLocalization(pair, SENSOR).step(start, STILL, between)
    assert abs(guessed.pose[1]) < 1e-3
    assert abs(told.pose[1]) > 0.05
    assert report.landmarks[0] in (1, 2)
    assert np.linalg.eigvalsh(start.covariance - guessed.covariance).min() > -1e-12
    assert np.linalg.eigvalsh(guessed.covariance - told.covariance).min() > -1e-12
    assert np.trace(guessed.covariance) > np.trace(told.covariance) + 1e-3


def test_arguments():
    ekf = EkfLocalization(RING, SENSOR)
    for pose, covariance, said in (
        ([0, 0, np.nan], SOME, "finite x, y, theta"),
        ([0, 0], SOME, "shape"),
        ([0, 0, 0], -SOME, "negative eigenvalue"),
        ([0, 0, 0], [[1, 2, 0], [0, 1, 0], [0, 0, 1]], "symmetric"),
    ):
        with pytest.raises(ArgumentError, match=said):
            ekf.init(pose, covariance)
    with pytest.raises(ArgumentError, match="each landmark once"):
        KnownLandmarks.of([1, 1], np.zeros((2, 2)))
    with pytest.raises(ArgumentError, match="at least one landmark"):
        KnownLandmarks.of([], np.empty((0, 2)))
    with pytest.raises(ArgumentError, match="known correspondences"):
        ekf.step(ekf.init(np.zeros(3), SOME), MOTION(INCREMENT), LandmarkObservations.of([[1.0, 0.0]]))
