"""EKF SLAM: the Kalman filter where all is linear, what it does with landmarks, and what it refuses."""

import checks
import numpy as np
import pytest

from gridslam.errors import ArgumentError, ConsumedStateError
from gridslam.evaluation import align
from gridslam.geometry.se2 import compose
from gridslam.models.association import AMBIGUOUS, KnownCorrespondence, LandmarkExistence, MaximumLikelihood
from gridslam.models.landmark import NO_OBSERVATIONS, LandmarkObservations, LandmarkStep, RangeBearing, RelativePosition
from gridslam.models.motion import DiffusionMotion, GaussianIncrement
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.graph_slam import LandmarkGraphSlam
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import CauchyEstimator
from support.landmark_world import INCREMENT, MOTION, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
ALL_AROUND = LandmarkExistence(
    detection=0.9, false_alarm=0.01, log_odds_confirmed=9.0, range_min_m=0.1, range_max_m=4.5, half_angle_rad=3.14
)
EXACT = GaussianIncrement.from_std(INCREMENT, np.zeros(3))

ERRORS = slice(3, 8)
"""Where the systematic errors are in the state."""


def run(slam, steps, motion=MOTION, known=True):
    state, reports = slam.init(), []
    for step in steps:
        observations = step.observations if known else step.observations.drop_correspondences()
        state, report = slam.step(state, motion(step.increment) if callable(motion) else motion, observations)
        reports.append(report)
    return state, reports


def mean_and_covariance(sensor, steps):
    """What EKF SLAM estimates at the end, pose and landmarks in the order of first observation."""
    slam = EkfSlam(sensor)
    state = slam.init()
    for step in steps:
        motion = GaussianIncrement.with_covariance(step.increment, step.noise)
        state, _ = slam.step(state, motion, LandmarkObservations.of(step.z, step.names))
    assert state.observations.tolist() == [
        sum(name in step.names for step in steps) for name in dict.fromkeys(n for step in steps for n in step.names)
    ]
    estimated = np.delete(np.arange(len(state.mean)), ERRORS)  # the systematic errors are 0
    return state.mean[estimated], state.covariance[np.ix_(estimated, estimated)]


def test_it_is_the_kalman_filter_where_all_is_linear():
    """A robot that cannot turn, and sees positions: textbook equations over [x, y, m_1, m_2], in turn."""
    checks.slam_is_the_kalman_filter(mean_and_covariance)


def test_errors_are_as_large_as_covariances_state():
    checks.ring_is_mapped(mean_and_covariance)


def test_covariances_stay_covariances_and_a_landmark_never_gets_less_certain():
    rng = np.random.default_rng(1)
    steps, truth = drive(ring(12), 150, rng)
    slam, before = EkfSlam(SENSOR), np.full(12, np.inf)
    state = slam.init()
    for step in steps:
        state, _ = slam.step(state, MOTION(step.increment), step.observations)
        assert np.linalg.eigvalsh(state.covariance)[0] > -1e-12
        np.testing.assert_allclose(state.covariance, state.covariance.T, atol=1e-14)
        now = np.linalg.det(state.position_covariances)
        assert (now <= before[: len(now)] * (1 + 1e-9)).all()  # to first order, landmarks stand still
        before[: len(now)] = now
    assert sorted(state.names.tolist()) == list(range(100, 112))
    found = slam.landmark_map(state)
    errors = found.positions - ring(12)[found.names - 100]
    # 24 numbers, squared and scaled by their variances: below 1 + 5 sqrt(2 / 24) on average, correlated as they are.
    scaled = np.einsum("mi,mij,mj->m", errors, np.linalg.inv(found.covariances), errors) / 2
    assert scaled.mean() < 1 + 5 * np.sqrt(2 / 24)
    assert np.hypot(*(state.pose - truth[-1])[:2]) < 5 * np.sqrt(np.trace(state.pose_covariance[:2, :2]))


def test_what_is_found_is_what_would_have_been_told_where_landmarks_are_far_apart():
    steps, _ = drive(ring(12), 150, np.random.default_rng(2))
    told, reports = run(EkfSlam(SENSOR), steps)
    found, others = run(EkfSlam(SENSOR, MaximumLikelihood(), ALL_AROUND), steps, known=False)
    assert len(found.names) == 12
    assert found.names.tolist() == list(range(12))
    name = dict(zip(told.names.tolist(), found.names.tolist(), strict=True))
    for report, other in zip(reports, others, strict=True):
        believed = other.landmarks != AMBIGUOUS
        assert [name[k] for k in report.landmarks[believed].tolist()] == other.landmarks[believed].tolist()
    share = np.mean(np.concatenate([other.landmarks for other in others]) == AMBIGUOUS)
    assert share < 0.03  # 1 % of true sightings lie beyond the gate
    assert np.abs(found.mean - told.mean).max() < 0.2


def test_the_pose_learns_nothing_from_a_provisional_landmark_but_the_landmark_does():
    slam = EkfSlam(SENSOR, MaximumLikelihood(), ALL_AROUND)
    seen = LandmarkObservations.of([[3.0, 0.3]])
    state, report = slam.step(slam.init(), MOTION(INCREMENT), seen)
    assert report.landmarks.tolist() == [0]
    alone, _ = slam.step(slam.init(), MOTION(INCREMENT), NO_OBSERVATIONS)
    alone, _ = slam.step(alone, MOTION(INCREMENT), NO_OBSERVATIONS)
    state, report = slam.step(state, MOTION(INCREMENT), LandmarkObservations.of([[2.8, 0.28]]))
    assert report.landmarks.tolist() == [0]
    np.testing.assert_array_equal(state.pose, alone.pose)
    np.testing.assert_allclose(state.pose_covariance, alone.pose_covariance, atol=1e-15)
    assert len(slam.landmark_map(state)) == 0
    known = np.delete(np.arange(len(state.mean)), ERRORS)
    assert np.linalg.eigvalsh(state.covariance[np.ix_(known, known)])[0] > 0
    for _ in range(3):
        z = SENSOR.linearize(state.pose, state.positions[0])[0]
        before = state.pose_covariance.copy()
        state, _ = slam.step(state, GaussianIncrement.from_std(np.zeros(3), np.zeros(3)), LandmarkObservations.of([z]))
    assert len(slam.landmark_map(state)) == 1
    assert np.trace(state.pose_covariance) < np.trace(before)  # the fifth sighting is of a confirmed landmark


def test_a_provisional_landmark_is_corrected_as_the_consider_filter_says():
    """With K zero but for the landmark's rows: (I - K H) P (I - K H)' + K Q K' (Joseph's form)."""
    slam = EkfSlam(SENSOR, MaximumLikelihood(), ALL_AROUND)
    state, _ = slam.step(slam.init(), MOTION(INCREMENT), LandmarkObservations.of([[3.0, 0.3], [3.0, -0.3]]))
    z = LandmarkObservations.of([[2.85, 0.31]])
    predicted, _ = slam.step(state.snapshot(), MOTION(INCREMENT), NO_OBSERVATIONS)
    corrected, _ = slam.step(state, MOTION(INCREMENT), z)
    P, Q = predicted.covariance, SENSOR.noise(z)[0]
    h, H_x, H_m = SENSOR.linearize(predicted.pose, predicted.positions[0])
    H = np.zeros((2, len(P)))
    H[:, :3], H[:, 8:10] = H_x, H_m
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + Q)
    K[[*range(8), 10, 11]] = 0
    np.testing.assert_allclose(corrected.mean, predicted.mean + K @ (z.values[0] - h), atol=1e-12)
    kept = np.eye(len(P)) - K @ H
    expected = kept @ P @ kept.T + K @ Q @ K.T
    np.testing.assert_allclose(corrected.covariance, expected, atol=1e-14)


def test_a_provisional_landmark_that_is_not_seen_again_is_dropped_and_its_name_not_used_again():
    slam = EkfSlam(SENSOR, MaximumLikelihood(), ALL_AROUND)
    still = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))
    state, _ = slam.step(slam.init(), still, LandmarkObservations.of([[2.0, 1.0], [3.0, -1.0]]))
    for _ in range(3):
        state, _ = slam.step(state, still, LandmarkObservations.of([[2.0, 1.0]]))
    assert state.names.tolist() == [0]
    assert state.mean.shape == (10,)
    state, _ = slam.step(state, still, LandmarkObservations.of([[2.0, -2.0]]))
    assert state.names.tolist() == [0, 2]


def test_a_sighting_that_cannot_be_believed_changes_nothing():
    steps, _ = drive(ring(12), 60, np.random.default_rng(4))
    state, _ = run(EkfSlam(SENSOR), steps)
    name = int(state.names[0])
    wrong = LandmarkObservations.of([[2.0, 3.0]], [name])
    one, report = EkfSlam(SENSOR).step(state.snapshot(), EXACT, wrong)
    other, _ = EkfSlam(SENSOR).step(state.snapshot(), EXACT, NO_OBSERVATIONS)
    assert report.landmarks.tolist() == [AMBIGUOUS]
    np.testing.assert_array_equal(one.mean, other.mean)
    believing, report = EkfSlam(SENSOR, KnownCorrespondence(gate=1e9)).step(state, EXACT, wrong)
    assert report.landmarks.tolist() == [name]
    assert np.abs(believing.mean - other.mean).max() > 0.01


def test_what_is_refused():
    slam = EkfSlam(SENSOR)
    state = slam.init()
    with pytest.raises(ArgumentError, match="known correspondences"):
        slam.step(state.snapshot(), EXACT, LandmarkObservations.of([[1.0, 0.0]]))
    kept = state.snapshot()
    slam.step(state, EXACT, NO_OBSERVATIONS)
    for use in (lambda: slam.step(state, EXACT, NO_OBSERVATIONS), state.snapshot):
        with pytest.raises(ConsumedStateError):
            use()
    slam.step(kept, EXACT, NO_OBSERVATIONS)
    with pytest.raises(ArgumentError, match="pose"):
        slam.init([0.0, 1.0])
    with pytest.raises(ValueError, match="match_gate <= new_gate"):
        MaximumLikelihood(match_gate=9, new_gate=8)
    with pytest.raises(ValueError, match="false_alarm < detection"):
        LandmarkExistence(detection=0.1, false_alarm=0.2)


def test_what_is_seen_beside_a_landmark_at_the_same_time_is_another():
    """0.18 m apart and 4 standard deviations: alone it may be an outlier, but not while the landmark is seen, too."""
    slam = EkfSlam(RelativePosition(sigma_x_m=0.03, sigma_y_m=0.03), MaximumLikelihood(), ALL_AROUND)
    state, _ = slam.step(slam.init(), EXACT, LandmarkObservations.of([[3.0, 0.0]]))
    still = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))
    _, report = slam.step(state.snapshot(), still, LandmarkObservations.of([[3.0, 0.18]]))
    assert report.landmarks.tolist() == [AMBIGUOUS]
    for seen, names in (([[3.0, 0.0], [3.0, 0.18]], [0, 1]), ([[3.0, 0.18], [3.0, 0.0]], [1, 0])):
        _, report = slam.step(state.snapshot(), still, LandmarkObservations.of(seen))
        assert report.landmarks.tolist() == names


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
