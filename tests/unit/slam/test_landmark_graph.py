"""Landmarks as a pose graph: the same least squares as written out by hand, and what drives make of it."""

import numpy as np
import pytest

from gridslam.evaluation import align
from gridslam.geometry.se2 import compose
from gridslam.models.landmark import LandmarkObservations, LandmarkStep, RangeBearing, RelativePosition
from gridslam.models.motion import DiffusionMotion
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import CauchyEstimator
from support.landmark_world import MOTION, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)


def least_squares(steps, poses, landmarks):
    """chi2 of poses (T, 3) and landmarks by name, from the motion model and positions seen, written out."""
    from scipy.optimize import least_squares as solve

    names = sorted(landmarks)

    def residuals(x):
        at, where = x[: 3 * len(steps)].reshape(-1, 3), x[3 * len(steps) :].reshape(-1, 2)
        found, before = [], np.zeros(3)
        for step, pose in zip(steps, at, strict=True):
            root = np.linalg.inv(np.linalg.cholesky(step.covariance))
            c, s = np.cos(before[2]), np.sin(before[2])
            dx, dy, turn = pose - before
            found += list(root @ (np.array([c * dx + s * dy, c * dy - s * dx, turn]) - step.increment))
            c, s = np.cos(pose[2]), np.sin(pose[2])
            for name, z in zip(step.observations.landmarks.tolist(), step.observations.values, strict=True):
                dx, dy = where[names.index(name)] - pose[:2]
                found += list((np.array([c * dx + s * dy, c * dy - s * dx]) - z) / 0.6)
            before = pose
        return np.array(found)

    start = np.concatenate([poses.ravel(), *(landmarks[name] for name in names)])
    best = solve(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return 2 * best.cost, best.x[: 3 * len(steps)].reshape(-1, 3), best.x[3 * len(steps) :].reshape(-1, 2)


def test_it_is_the_least_squares_of_increments_and_positions():
    rng, landmarks = np.random.default_rng(0), {7: [3.0, 1.0], 2: [2.0, -2.0], 9: [5.0, 0.5]}
    covariance = np.diag([0.04, 0.02, 0.003])
    steps, pose = [], np.zeros(3)
    for t in range(6):
        increment = np.array([0.5, 0.0, 0.3])
        pose = compose(pose, increment + rng.normal(0, 0.1, 3))
        names = sorted(landmarks)[t % 2 :]
        z = RelativePosition().linearize(pose, np.array([landmarks[k] for k in names]))[0] + rng.normal(
            0, 0.6, (len(names), 2)
        )
        steps.append(LandmarkStep(t, increment, covariance, LandmarkObservations.of(z, names)))
    solved = LandmarkGraphSlam(RelativePosition(0.6, 0.6), growth=2).solve(steps, DiffusionMotion())
    chi2, poses, where = least_squares(
        steps, solved.poses, dict(zip(solved.landmarks.names.tolist(), solved.landmarks.positions, strict=True))
    )
    # The graph's covariance of an increment is of the frame in which it is measured to end, to first order the same.
    assert solved.solution.chi2_after == pytest.approx(chi2, rel=1e-6)
    np.testing.assert_allclose(solved.poses, poses, atol=1e-5)
    order = np.argsort(solved.landmarks.names)
    np.testing.assert_allclose(solved.landmarks.positions[order], where, atol=1e-5)
    assert solved.degrees_of_freedom == 2 * (sum(len(step.observations) for step in steps) - 3)
    assert solved.landmarks.observations.sum() == sum(len(step.observations) for step in steps)


def test_covariances_are_those_of_the_kalman_filter_where_all_is_linear():
    """A robot that hardly turns, and sees positions: the last pose and the landmarks are EKF SLAM's."""
    rng, steps = np.random.default_rng(1), []
    for t in range(8):
        z = np.array([[6.0, 1.0], [3.0, -2.0]]) - [0.5 * t, 0] + rng.normal(0, 0.05, (2, 2))
        steps.append(
            LandmarkStep(t, np.array([0.5, 0, 0]), np.diag([0.02, 0.01, 1e-10]), LandmarkObservations.of(z, [3, 5]))
        )
    sensor, motion = RelativePosition(0.6, 0.6), DiffusionMotion()
    ekf, state = EkfSlam(sensor), EkfSlam(sensor).init()
    for step in steps:
        state, _ = ekf.step(state, step.motion(motion), step.observations)
    solved = LandmarkGraphSlam(sensor).solve(steps, motion)
    np.testing.assert_allclose(solved.poses[-1], state.pose, atol=1e-6)
    np.testing.assert_allclose(solved.landmarks.positions, state.positions, atol=1e-6)
    np.testing.assert_allclose(solved.landmarks.covariances, state.position_covariances, atol=1e-6)
    np.testing.assert_allclose(solved.covariances[-1], state.pose_covariance, atol=1e-6)


def test_misread_landmarks_are_left_out_by_robust_estimation():
    landmarks = ring(12)
    steps, truth = drive(landmarks, 150, np.random.default_rng(5), SENSOR)
    for t in (100, 120):  # what is seen first is taken for a landmark at the other side
        step = steps[t]
        wrong = step.observations.landmarks.copy()
        wrong[0] = 100 + (wrong[0] - 100 + 6) % 12
        steps[t] = LandmarkStep(
            step.stamp_ns, step.increment, None, LandmarkObservations.of(step.observations.values, wrong)
        )
    robust = GraphSlam(first_guess="given", robust=CauchyEstimator())
    errors = []
    for solver in (robust, GraphSlam(first_guess="given")):
        solved = LandmarkGraphSlam(SENSOR, solver).solve(steps, MOTION)
        aligned = compose(align(solved.poses[:, :2], truth[:, :2]), solved.poses)
        errors.append(np.hypot(*(aligned - truth)[:, :2].T).max())
    assert errors[0] < 0.3 < errors[1]
