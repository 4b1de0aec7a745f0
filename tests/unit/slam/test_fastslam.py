"""FastSLAM 1.0 and 2.0: EKF mapping where the path is certain, the proposal against sampling, and the state."""

import checks
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ConsumedStateError
from gridslam.evaluation import align
from gridslam.geometry.se2 import compose, transform_points
from gridslam.models.association import NEW, LandmarkExistence, MaximumLikelihood
from gridslam.models.landmark import NO_OBSERVATIONS, LandmarkObservations, RangeBearing, RelativePosition
from gridslam.models.motion import DiffusionMotion, GaussianIncrement
from gridslam.particles.policies import AlwaysResample, NeverResample
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.fastslam1 import FastSlam1
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.slam.landmarks.particles import LandmarkParticles, PoseBelief
from gridslam.slam.landmarks.small_gaussians import draw_poses, kalman_update, log_density, mahalanobis
from support.landmark_world import INCREMENT, MOTION, dead_reckoning, drive, ring

SENSOR = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
FILTERS = LandmarkFilters(SENSOR)
ALL_AROUND = LandmarkExistence(
    detection=0.9, false_alarm=0.01, log_odds_confirmed=9.0, range_min_m=0.1, range_max_m=4.5, half_angle_rad=3.14
)
FINDING = LandmarkFilters(SENSOR, MaximumLikelihood(), ALL_AROUND)
EXACT = GaussianIncrement.from_std(INCREMENT, np.zeros(3))
STILL = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))
ALL = pytest.mark.parametrize("kind", [FastSlam1, FastSlam2])


def run(slam, steps, particles, rng, motion=MOTION, known=True):
    state, reports = slam.init(particles), []
    for step in steps:
        observations = step.observations if known else step.observations.drop_correspondences()
        state, report = slam.step(state, motion(step.increment), observations, rng)
        reports.append(report)
    return state, reports


@ALL
def test_one_particle_without_noise_is_ekf_mapping(kind):
    """The path is certain: EKF SLAM's landmarks are then independent, and each is as the particle's filter says."""
    exact = DiffusionMotion(sigma_xy_m=0, sigma_theta_rad=0, floor_xy_m=0, floor_theta_rad=0)
    steps, _ = drive(ring(12), 100, np.random.default_rng(0), motion=exact)
    rng, ekf = np.random.default_rng(1), EkfSlam(SENSOR)
    state, expected = kind(FILTERS).init(1), ekf.init()
    for step in steps:
        state, report = kind(FILTERS).step(state, exact(step.increment), step.observations, rng)
        expected, other = ekf.step(expected, exact(step.increment), step.observations)
        assert report.landmarks.tolist() == other.landmarks.tolist()
        np.testing.assert_allclose(report.pose, other.pose, atol=1e-12)
    ours, theirs = kind(FILTERS).landmark_map(state), ekf.landmark_map(expected)
    assert ours.names.tolist() == theirs.names.tolist()
    assert ours.observations.tolist() == theirs.observations.tolist()
    # EKF SLAM linearizes at first estimates, FastSLAM at the newest: a tenth of a standard deviation apart
    deviations = np.sqrt(np.trace(theirs.covariances, axis1=1, axis2=2))
    assert (np.hypot(*(ours.positions - theirs.positions).T) < 0.2 * deviations).all()
    np.testing.assert_allclose(ours.covariances, theirs.covariances, rtol=0.1, atol=1e-5)
    np.testing.assert_allclose(state.ancestry.trajectory(0)[1:, :3], dead_reckoning(100), atol=1e-9)


def test_the_proposal_of_fastslam2_is_what_sampling_finds():
    """Poses drawn from the motion model and weighed by the sightings have the proposal's mean and covariance.

    The sightings are chosen so that linearization errs little: its share of the spread is some spread / range, 1 %.
    """
    rng, count = np.random.default_rng(5), 50_000
    slam = FastSlam2(FILTERS, when_to_resample=NeverResample())
    base = slam.init(count)
    seen = SENSOR.linearize(np.zeros(3), np.array([[4.0, 1.0], [2.0, -3.0]]))[0]
    base, _ = slam.step(base, STILL, LandmarkObservations.of(seen, [1, 2]), rng)
    motion = GaussianIncrement.from_std(INCREMENT, np.array([0.06, 0.05, 0.03]))
    truth = np.array([0.24, -0.03, 0.07])
    z = LandmarkObservations.of(SENSOR.linearize(truth, np.array([[4.0, 1.0], [2.0, -3.0]]))[0], [1, 2])
    drawn, _ = slam.step(base.snapshot(), motion, z, rng)

    one = base.snapshot()
    poses = motion(one.poses, rng)
    log_likelihood = np.zeros(count)
    for k in range(2):
        predicted, _, H_m = SENSOR.linearize(poses, one.positions[:, k])
        S = H_m @ one.covariances[:, k] @ H_m.swapaxes(1, 2) + SENSOR.noise(z)[k]
        log_likelihood += log_density(*mahalanobis(SENSOR.residual(z.values[k], predicted), S))
    likelihood = np.exp(log_likelihood)
    weights = likelihood / likelihood.sum()
    mean, spread = weights @ poses, np.cov(poses.T, aweights=weights)
    sigma = np.sqrt(np.diag(spread))
    # With an effective sample of 2,500 the mean errs by 2 % of sigma and covariances by 3 %, linearization by little.
    assert 1 / np.square(weights).sum() > 2_500
    assert (np.abs(drawn.poses.mean(axis=0) - mean) < 0.1 * sigma).all()
    assert (np.abs(np.cov(drawn.poses.T) - spread) < 0.15 * np.outer(sigma, sigma)).all()


def test_weights_of_fastslam2_are_the_likelihood_of_all_sightings_under_the_motion():
    """Two particles with different maps: their ratio of weights is that of two Gaussians over both sightings."""
    slam, rng = FastSlam2(FILTERS, when_to_resample=NeverResample()), np.random.default_rng(6)
    state, _ = slam.step(slam.init(2), STILL, LandmarkObservations.of([[4.0, 0.3], [3.0, -0.8]], [1, 2]), rng)
    state.positions[1] += 0.05
    motion = GaussianIncrement.from_std(INCREMENT, np.array([0.03, 0.03, 0.02]))
    z = LandmarkObservations.of([[3.9, 0.24], [2.9, -0.9]], [1, 2])
    (centre, _), (cov, _) = motion.moments(np.zeros((2, 3)))
    logs = []
    for particle in range(2):
        H, Q, residual = np.zeros((4, 3)), np.zeros((4, 4)), np.zeros(4)
        for k in range(2):
            h, H_x, H_m = SENSOR.linearize(centre, state.positions[particle, k])
            rows = slice(2 * k, 2 * k + 2)
            H[rows], residual[rows] = H_x, SENSOR.residual(z.values[k], h)
            Q[rows, rows] = H_m @ state.covariances[particle, k] @ H_m.T + SENSOR.noise(z)[k]
        L = H @ cov @ H.T + Q
        logs.append(-0.5 * (residual @ np.linalg.solve(L, residual) + np.linalg.slogdet(L)[1]))
    state, _ = slam.step(state, motion, z, rng)
    # The second sighting is linearized about the mean that the first has corrected, by a centimetre: a few percent.
    assert state.log_weights[0] - state.log_weights[1] == pytest.approx(logs[0] - logs[1], abs=0.1)


@ALL
def test_many_particles_find_what_the_kalman_filter_finds_where_all_is_linear(kind):
    """A robot that cannot turn and sees positions: the posterior is EKF SLAM's, exactly."""

    def particles(sensor, steps, count, rng):
        slam = kind(LandmarkFilters(sensor), when_to_resample=NeverResample())
        state = slam.init(count)
        for step in steps:
            motion = GaussianIncrement.with_covariance(step.increment, step.noise)
            state, _ = slam.step(state, motion, LandmarkObservations.of(step.z, step.names), rng)
        count = len(steps[0].names)
        return np.exp(state.log_weights), state.poses, state.positions[:, :count], state.covariances[:, :count]

    checks.particles_find_the_kalman_filter(particles)


@ALL
def test_it_maps_a_ring_with_known_and_unknown_correspondences(kind):
    steps, truth = drive(ring(12), 140, np.random.default_rng(9))
    for filters, known in ((FILTERS, True), (FINDING, False)):
        slam = kind(filters)
        state, reports = run(slam, steps, 50, np.random.default_rng(10), known=known)
        found = slam.landmark_map(state)
        assert len(found) == 12
        true_from_map = align(
            state.ancestry.trajectory(state.best)[1:, :2], truth[:, :2]
        )  # the first steps turn it all
        nearest = np.hypot(*(transform_points(true_from_map, found.positions)[:, None] - ring(12)).transpose(2, 0, 1))
        assert sorted(nearest.argmin(axis=1).tolist()) == list(range(12))
        # Once around with 1.5 % of heading noise a step leaves 0.1 to 0.2 m; neighbours are 3 m apart.
        assert nearest.min(axis=1).max() < 0.5
        assert np.hypot(*(compose(true_from_map, reports[-1].pose) - truth[-1])[:2]) < 0.5
        assert any(report.parents is not None for report in reports)


@given(seed=st.integers(0, 1000), count=st.integers(1, 12))
def test_resampling_keeps_what_is_drawn_and_copies_are_apart(seed, count):
    rng = np.random.default_rng(seed)
    state = LandmarkParticles.at(count, [0, 0, 0])
    state.new_columns(np.arange(count), 7)
    state.poses[:, 0] = state.positions[:, 0, 0] = state.observations[:, 0] = np.arange(count)
    drawn = np.sort(rng.integers(0, count, count))
    parents = state.resample(drawn)
    assert np.sort(parents).tolist() == drawn.tolist()
    stays = np.isin(np.arange(count), drawn)
    assert parents[stays].tolist() == np.flatnonzero(stays).tolist()
    for kept in (state.poses[:, 0], state.positions[:, 0, 0], state.observations[:, 0]):
        assert kept.tolist() == parents.tolist()
    state.positions[0] = -1.0
    assert (state.positions[1:, 0, 0] >= 0).all()


@ALL
def test_the_same_seed_gives_the_same_bytes_also_from_a_snapshot(kind):
    steps, _ = drive(ring(8), 60, np.random.default_rng(14))
    slam = kind(FILTERS, when_to_resample=AlwaysResample())
    one, _ = run(slam, steps, 10, np.random.default_rng(3))
    rng, state = np.random.default_rng(3), slam.init(10)
    for k, step in enumerate(steps):
        if k == 30:
            kept, again = state.snapshot(), np.random.default_rng()
            again.bit_generator.state = rng.bit_generator.state
        state, _ = slam.step(state, MOTION(step.increment), step.observations, rng)
    for step in steps[30:]:
        kept, _ = slam.step(kept, MOTION(step.increment), step.observations, again)
    for other in (state, kept):
        np.testing.assert_array_equal(one.positions, other.positions)
        np.testing.assert_array_equal(one.ancestry.trajectory(0), other.ancestry.trajectory(0))
    with pytest.raises(ConsumedStateError):
        slam.step(LandmarkParticles.take(kept) and kept, EXACT, NO_OBSERVATIONS, rng)


def test_correspondences_are_drawn_by_their_likelihood_and_weighed_by_its_sum():
    """Two landmarks, one nearer: the share of particles that take it is its share of p(z), known in closed form."""
    sensor = RelativePosition(sigma_x_m=0.2, sigma_y_m=0.2)
    slam = FastSlam1(LandmarkFilters(sensor, MaximumLikelihood()), when_to_resample=NeverResample())
    rng, count = np.random.default_rng(16), 4000
    state, _ = slam.step(slam.init(count), STILL, LandmarkObservations.of([[3.0, 0.6], [3.0, -0.6]]), rng)
    seen, nothing = LandmarkObservations.of([[3.0, 0.1]]), np.full((count, 1), NEW)
    belief = PoseBelief(state.poses, state.pose_covariances)
    columns, log_p, _ = slam.landmarks.correspond(state, seen, 0, belief, nothing, rng)
    near, far = np.exp(-0.5 * np.array([0.5, 0.7]) ** 2 / 0.08) / (2 * np.pi * 0.08)  # S = 0.04 + 0.04 m^2
    new = np.exp(-0.5 * 25) / (2 * np.pi * 0.04)
    # A share p of 4,000 has a standard deviation of sqrt(p (1 - p) / 4000) < 0.008; five of them.
    assert np.mean(state.positions[np.arange(count), columns, 1] > 0) == pytest.approx(near / (near + far), abs=0.04)
    np.testing.assert_allclose(log_p, np.log(near + far + new), rtol=1e-9)


def _covariances(rng, count):
    root = rng.normal(size=(count, 3, 3))
    return root @ root.swapaxes(1, 2)


def test_update_is_that_of_the_information_filter():
    """Inverse covariances add up, P^-1 + H' Q^-1 H, and the mean is that of both: another way to the same numbers."""
    rng, rows = np.random.default_rng(3), np.array([5, 0, 7])
    P, means, H = _covariances(rng, 9), rng.normal(size=(9, 3)), rng.normal(size=(3, 2, 3))
    Q, residuals = _covariances(rng, 3)[:, :2, :2], rng.normal(size=(3, 2))
    after, moved = P.copy(), means.copy()
    kalman_update(moved, after, rows, H, H @ P[rows] @ H.swapaxes(1, 2) + Q, residuals)
    both = np.linalg.inv(P[rows]) + H.swapaxes(1, 2) @ np.linalg.solve(Q, H)
    shifts = np.linalg.solve(both, H.swapaxes(1, 2) @ np.linalg.solve(Q, residuals[..., None]))[..., 0]
    np.testing.assert_allclose(after[rows], np.linalg.inv(both), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(moved[rows], means[rows] + shifts, rtol=1e-6, atol=1e-8)
    untouched = np.setdiff1d(np.arange(9), rows)
    np.testing.assert_array_equal(after[untouched], P[untouched])


def test_what_has_no_variance_is_drawn_as_it_is():
    C, means = _covariances(np.random.default_rng(0), 50) * 0.01, np.random.default_rng(1).normal(size=(50, 3)) * 0.5
    C[::2, 1], C[::2, :, 1] = 0.0, 0.0
    drawn = draw_poses(means, C, np.random.default_rng(2))
    numbers = np.random.default_rng(2).standard_normal((50, 3))
    np.testing.assert_array_equal(drawn[::2, 1], means[::2, 1])
    np.testing.assert_allclose(
        drawn[1::2], means[1::2] + (np.linalg.cholesky(C[1::2]) @ numbers[1::2, :, None])[..., 0], atol=1e-9
    )
