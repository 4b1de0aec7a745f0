"""Proposals: new poses, and the weights that make up for where they were drawn."""

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import rotate_covariances
from gridslam.mapping import OccupancyGridMapping
from gridslam.models import CauchyEndPoint, DiffusionMotion, GaussianIncrement
from gridslam.models.motion import add_noise
from gridslam.slam import ImprovedProposal, MotionModelProposal, ScanMatchedProposal
from gridslam.slam.grid_fastslam.motion_of_particles import MotionOfAll, SearchingMotion
from gridslam.types import LaserScan, ScanGeometry
from support.oblong import PLACES, map_room, scan_at

GEOMETRY = ScanGeometry(np.deg2rad(np.arange(0, 360, 2) - 179.0))


@pytest.fixture(scope="module")
def room():
    """The room, mapped from four places, once for each of ten particles."""
    return map_room(10, (*PLACES, (1.0, 0.2, 1.0)), GEOMETRY)


BEFORE = np.tile([0.0, 0.0, 0.0], (10, 1))
INCREMENT = np.array([0.4, 0.1, 0.2])
WIDE = DiffusionMotion(sigma_xy_m=0.08, sigma_theta_rad=0.03)(INCREMENT)
BEAMS = scan_at(INCREMENT, GEOMETRY)


def cost(maps, pose, guess, prior, sigma_m, cauchy_m=0.1):
    """What the match minimizes: Cauchy's robust squares of the beams' distances, and the way from the guess."""
    distances = maps.distances(np.zeros(1, np.int32), pose[None], BEAMS.ends)[0].astype(np.float64)
    away = pose - guess
    robust = cauchy_m**2 * np.log1p((distances / cauchy_m) ** 2).sum()
    return robust + sigma_m**2 * away @ prior @ away


def test_peaks_are_local_optima(room):
    """Nowhere 1 cm or 6 mrad around a peak is the posterior higher; from the draw to the peak it has risen."""
    peak = ScanMatchedProposal()
    proposed = peak(room, BEFORE, WIDE, CauchyEndPoint()(BEAMS), BEAMS, np.random.default_rng(1))
    drawn = WIDE(BEFORE, np.random.default_rng(1))
    prior = np.linalg.inv(WIDE.moments(BEFORE)[1][0])
    nudges = np.concatenate([np.diag([0.01, 0.01, 0.006]), -np.diag([0.01, 0.01, 0.006])])
    assert np.abs(drawn - INCREMENT).max() > 0.05
    for guess, pose in zip(drawn, proposed.poses, strict=True):
        here = cost(room, pose, guess, prior, peak.beam_sigma_m)
        assert here < cost(room, guess, guess, prior, peak.beam_sigma_m)
        assert all(here < cost(room, pose + nudge, guess, prior, peak.beam_sigma_m) for nudge in nudges)
    np.testing.assert_allclose(proposed.poses, np.tile(INCREMENT, (10, 1)), atol=0.02)


class LinearMaps:
    """All that a proposal asks of maps; a scan measures the pose itself, z = x + noise of covariance R."""

    resolution_m, reach_cells = 0.05, 10.5

    def __init__(self, count, measured, noise, beam_sigma_m):
        self.count, self.measured, self.scale = count, measured, beam_sigma_m**2
        self.precision = np.linalg.inv(noise)

    def __len__(self):
        return self.count

    def match(self, rows, guesses, priors, ends, *settings):
        """The minimum of (x - z)' H (x - z) + (x - g)' P (x - g) with H / sigma^2 the measurement's precision."""
        information = np.tile(self.scale * self.precision, (len(rows), 1, 1))
        right = (information @ self.measured)[..., None] + priors @ guesses[..., None]
        return np.linalg.solve(information + priors, right)[..., 0], information, np.ones(len(rows))

    def weigh(self, maps, rows, poses):
        return log_normal(self.measured, poses, np.linalg.inv(self.precision))


def log_normal(x, mean, covariance):
    away = x - mean
    quadratic = np.einsum("...i,ij,...j->...", away, np.linalg.inv(covariance), away)
    return -0.5 * (quadratic + np.linalg.slogdet(2 * np.pi * covariance)[1])


DRAWS = 4000
PLACE = np.array([[1.0, 2.0, 0.0]])
MOTION = GaussianIncrement.from_std(np.array([0.5, 0.1, 0.2]), np.array([0.1, 0.06, 0.04]))
PREDICTED = PLACE[0] + MOTION.mean
SPREAD = np.diag(MOTION.std**2)
NOISE = np.array([[0.009, 0.003, 0.0], [0.003, 0.006, -0.0005], [0.0, -0.0005, 0.0009]])
MEASURED = PREDICTED + np.array([0.12, -0.07, 0.03])
MARGINAL = log_normal(MEASURED, PREDICTED, SPREAD + NOISE)
"""Of a Gaussian prior and a linear measurement: N(z; mean, P + R), the density of a Kalman filter's innovation."""


@pytest.fixture
def linear():
    return LinearMaps(DRAWS, MEASURED, NOISE, ImprovedProposal().beam_sigma_m)


def test_the_improved_proposal_is_the_kalman_filter_where_all_is_linear(linear):
    """Mean and covariance within 5 standard errors of 4000 draws; the weight is exact, whatever was drawn.

    A mean's standard error is sigma / sqrt(n); a covariance's element has one of at most sqrt(2 / n) sigma_i sigma_j.
    """
    proposed = ImprovedProposal()(
        linear, np.repeat(PLACE, DRAWS, 0), MOTION, linear.weigh, BEAMS, np.random.default_rng(0)
    )
    gain = SPREAD @ np.linalg.inv(SPREAD + NOISE)
    mean, covariance = PREDICTED + gain @ (MEASURED - PREDICTED), (np.eye(3) - gain) @ SPREAD
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(proposed.poses.mean(axis=0) - mean), 5 * sigma / np.sqrt(DRAWS))
    off = np.abs(np.cov(proposed.poses.T) - covariance)
    np.testing.assert_array_less(off, 5 * np.sqrt(2 / DRAWS) * np.outer(sigma, sigma))
    # the floor under the motion's variances, 1e-8 m^2 and 1e-10 rad^2, is 3e-6 of the least of them
    np.testing.assert_allclose(proposed.log_weights, MARGINAL, atol=1e-4)


def test_plain_fastslam_weighs_the_same_on_average(linear):
    """E[p(z | x)] over the prior is the marginal likelihood; within 5 standard errors of the sample itself."""
    places = np.repeat(PLACE, DRAWS, 0)
    proposed = MotionModelProposal()(linear, places, MOTION, linear.weigh, BEAMS, np.random.default_rng(0))
    weights = np.exp(proposed.log_weights)
    assert abs(weights.mean() - np.exp(MARGINAL)) < 5 * weights.std() / np.sqrt(DRAWS)
    assert weights.std() > 0.5 * weights.mean()  # which is what the improved proposal saves


def test_headings_are_wrapped_where_they_cross_pi():
    """Predicted just below pi and measured beyond it: draws are on both sides, and weights do not see the border."""
    places = np.repeat(PLACE + np.array([0.0, 0.0, np.pi - 0.199]), DRAWS, 0)
    (mean, *_), (spread, *_) = MOTION.moments(places)
    measured = mean + np.array([0.1, 0.05, 0.04])
    linear = LinearMaps(DRAWS, measured, NOISE, ImprovedProposal().beam_sigma_m)
    proposed = ImprovedProposal()(linear, places, MOTION, linear.weigh, BEAMS, np.random.default_rng(0))
    assert mean[2] < -3.1
    assert (proposed.poses[:, 2] >= -np.pi).all()
    assert (proposed.poses[:, 2] < np.pi).all()
    assert (proposed.poses[:, 2] > 0).any()
    assert np.abs(wrap(proposed.poses[:, 2] - measured[2])).max() < 0.3
    np.testing.assert_allclose(proposed.log_weights, log_normal(measured, mean, spread + NOISE), atol=1e-4)


UNMATCHED = GaussianIncrement.from_std(INCREMENT + np.array([0.3, -0.25, 0.2]), np.array([0.27, 0.27, 0.085]))
"""Motion that no match has measured: off by more than a deviation along each axis, in heading by more than two."""


@pytest.fixture(scope="module")
def surroundings():
    """The same room, where what lies behind its walls was seen before they stood."""
    maps = OccupancyGridMapping().empty(10)
    for place in PLACES:
        seen = scan_at(np.array(place)).scan
        far = LaserScan.from_ranges(0, np.array(seen.ranges) + 1.0, seen.geometry).beams(0.05, 30.0)
        OccupancyGridMapping()(maps, np.tile(place, (10, 1)), far)
    for place in 3 * PLACES:
        OccupancyGridMapping()(maps, np.tile(place, (10, 1)), scan_at(np.array(place), GEOMETRY))
    return maps


def search(maps, motion):
    return SearchingMotion(motion, maps, CauchyEndPoint()(BEAMS), BEAMS.ends)


def test_a_search_finds_the_peak_that_a_single_draw_misses(surroundings):
    """The motion errs by more than a peak is wide; the map shows the place."""
    near = []
    for motion in (UNMATCHED, search(surroundings, UNMATCHED)):
        away = motion(BEFORE, np.random.default_rng(3)) - INCREMENT
        near.append(int((np.hypot(away[:, 0], away[:, 1]) + np.abs(wrap(away[:, 2])) < 0.3).sum()))
    assert near[0] <= 3
    assert near[1] == 10


def test_where_the_map_shows_too_little_nothing_is_searched_for(room):
    """Half of the beams end behind the walls, where nothing was seen: new walls would be laid on old ones."""
    drawn = search(room, UNMATCHED)(BEFORE, np.random.default_rng(0))
    np.testing.assert_array_equal(drawn, UNMATCHED(BEFORE, np.random.default_rng(0)))


def test_the_best_particle_keeps_to_the_mean_of_motion_that_no_match_has_measured(surroundings):
    """It is reported, and no sample; the others are searched for."""
    drawn = MotionOfAll(search(surroundings, UNMATCHED), 4, 1, (0.0, 0.0))(BEFORE, np.random.default_rng(0))
    np.testing.assert_array_equal(drawn[4], UNMATCHED.moments(BEFORE)[0][4])
    assert (np.delete(drawn, 4, axis=0) != drawn[4]).all()


@pytest.mark.parametrize(("scans", "variance"), [(1, 1.0), (2, 1.0), (3, 0.5), (20, 0.25)])
def test_scans_between_key_scans_hold_the_best_particle(scans, variance):
    """The key scan is not counted, and nineteen before it as four."""
    own = WIDE.moments(BEFORE)[1]
    held = MotionOfAll(WIDE, 4, scans, None).moments(BEFORE)[1]
    np.testing.assert_allclose(held[4], variance * own[4])
    assert (np.linalg.det(np.delete(held, 4, axis=0)) > 1e9 * np.linalg.det(own[0])).all()


def test_noise_beside_that_of_a_motion_adds_to_its_covariance():
    """In the frame of the pose before; the mean is the same."""
    turned = np.array([[1.0, 2.0, 0.7]])
    noise = np.array([[0.04, 0.01, 0.0], [0.01, 0.02, 0.002], [0.0, 0.002, 0.003]])
    mean, covariance = add_noise(WIDE, noise).moments(turned)
    np.testing.assert_allclose(mean, WIDE.moments(turned)[0], atol=1e-12)
    np.testing.assert_allclose(covariance[0], WIDE.moments(turned)[1][0] + rotate_covariances(noise, 0.7), atol=1e-12)
