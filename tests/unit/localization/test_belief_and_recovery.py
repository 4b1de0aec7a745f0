"""What a cloud of particles says, when a robot is taken as lost, and how poses are drawn from a scan."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import chdtri

from gridslam.geometry.angles import wrap
from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization, belief, recovery
from gridslam.localization.belief import (
    NO_HYPOTHESES,
    PoseEstimate,
    PoseHypotheses,
    estimate_pose,
    propagate_covariance,
    update_hypotheses,
)
from gridslam.localization.kld_sampling import KldSampling
from gridslam.localization.recovery import AugmentedRecovery, InlierRatioAverages, propose_poses
from gridslam.matching.beam_order import BeamOrder
from gridslam.models.endpoint import LikelihoodField
from gridslam.particles import Systematic
from gridslam.particles.kld_sampling import kld_bound
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.floor_plan import box, join
from gridslam.types import Beams, LaserScan, OccupancyGrid, ScanGeometry
from support.localization_world import drive, flat, flat_map

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


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_the_spread_is_that_of_the_cluster_or_of_all_where_it_has_less_than_half(share):
    """Weighted moments by NumPy, of the densest of three places that are far apart."""
    rng, centre = np.random.default_rng(1), np.array([3.0, -2.0, 3.1])
    poses = rng.normal(scale=[0.1, 0.2, 0.05], size=(4000, 3)) + centre
    poses[int(4000 * share) :, 0] += rng.choice([30.0, 50.0, 70.0, 90.0], 4000 - int(4000 * share))
    poses[:, 2] = wrap(poses[:, 2])
    weights = rng.exponential(size=4000)
    weights /= weights.sum()
    own = poses[:, 0] < 10
    told = estimate_pose(poses, weights)
    kept = own if share > 0.5 else np.ones(4000, np.bool_)
    away, mass = poses[kept] - told.pose, weights[kept]
    away[:, 2] = wrap(away[:, 2])
    assert told.mass == pytest.approx(weights[own].sum())
    np.testing.assert_allclose(np.average(poses[own, :2], axis=0, weights=weights[own]), told.pose[:2], atol=1e-9)
    effective = mass.sum() ** 2 / np.square(mass).sum()
    expected = (mass[:, None] * away).T @ away / mass.sum() * effective / (effective - 5)
    np.testing.assert_allclose(told.covariance, expected, rtol=1e-9, atol=1e-12)


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
    assert recovery(averages, 0.1, 0.5)[1] == pytest.approx(share, rel=0.2)  # one that sees half of it
    assert recovery(averages, 0.0, 0.0) == (averages, 0.0)  # a scan that sees nothing of the map


def test_weights_of_drawn_poses_add_up_to_the_evidence(monkeypatch):
    """Their sum is the mean of p(z | x) over the free space, whatever they were drawn with: 40 draws against a grid."""
    known, log = KnownMap(flat_map()), drive(1)
    beams = log.measurements[10].scan.beams(0.05, 30.0)
    weigh = known.condition(LikelihoodField(tempering=0.003), beams)
    exact = np.exp(weigh(known.sample_poses(400_000, np.random.default_rng(0)))).mean()
    for concentration in (0.0, 5.0):
        values = {"_CONCENTRATION": concentration, "_DRAWS": 2000, "SAMPLES_PER_M2": 200, "JITTER": (0, 0, 0)}
        for name, value in values.items():
            monkeypatch.setattr(recovery, name, value)
        sums = []
        for seed in range(40):
            _, log_weights = propose_poses(known, beams, weigh, 1.0, np.random.default_rng(seed))
            sums.append(np.exp(log_weights).sum())
        assert np.mean(sums) == pytest.approx(exact, abs=5 * np.std(sums) / math.sqrt(40))
        assert np.std(sums) < 0.3 * exact


HERE = np.array([1.0, 1.0, 0.0])
THERE = np.array([9.0, 5.0, 3.0])
ALONE = PoseEstimate(HERE, np.eye(3) * 1e-4, 1.0)
CLOUD, EVEN = HERE[None], np.ones(1)
STILL = np.zeros(3)


def agreeing(*places: tuple[np.ndarray, float]):
    """A scan that agrees so much near each of these poses and not at all elsewhere."""

    def agree(poses: np.ndarray) -> np.ndarray:
        return sum(share * (np.hypot(*(poses[:, :2] - place[:2]).T) < 1) for place, share in places)

    return agree


def followed(hypotheses: PoseHypotheses, agree, steps: int):
    rng = np.random.default_rng(0)
    for _ in range(steps):
        hypotheses = update_hypotheses(hypotheses, STILL, ALONE, CLOUD, EVEN, agree, rng)
    return hypotheses


def test_each_cluster_becomes_a_rival_but_that_which_is_told(monkeypatch):
    rng = np.random.default_rng(1)
    poses = np.concatenate([place + 0.05 * rng.standard_normal((100, 3)) for place in (HERE, THERE, [4.0, 8.0, -1.0])])
    weights = np.repeat([0.005, 0.004, 0.001], 100)
    told = PoseEstimate(HERE, np.eye(3), 0.5)
    agree = agreeing((HERE, 0.8), (THERE, 0.8), (np.array([4.0, 8.0, -1.0]), 0.8))
    hypotheses = update_hypotheses(NO_HYPOTHESES, STILL, told, poses, weights, agree, rng)
    np.testing.assert_allclose(hypotheses.poses, [THERE, [4.0, 8.0, -1.0]], atol=0.3)
    np.testing.assert_array_equal(hypotheses.log_odds, 0)
    assert hypotheses.odds == pytest.approx(2)
    for name, value in (("_MAX_HYPOTHESES", 1), ("_MIN_MASS", 0.2)):
        with monkeypatch.context() as changed:
            changed.setattr(belief, name, value)
            found = update_hypotheses(NO_HYPOTHESES, STILL, told, poses, weights, agree, rng)
        assert len(found.poses) == 1


def test_what_looks_the_same_stays_and_what_looks_otherwise_goes(monkeypatch):
    monkeypatch.setattr(belief, "JITTER", (0.0, 0.0, 0.0))
    rival = PoseHypotheses(THERE[None], np.zeros(1))
    within = followed(rival, agreeing((HERE, 0.80), (THERE, 0.76)), 500)
    np.testing.assert_array_equal(within.log_odds, 0)  # by less than the map's own errors, 500 times
    once = followed(rival, agreeing((HERE, 0.8), (THERE, 0.4)), 1)
    assert once.log_odds[0] == pytest.approx(-belief._LOG_ODDS_PER_SCAN * (0.4 - belief._MARGIN))
    assert not len(followed(rival, agreeing((HERE, 0.8), (THERE, 0.4)), 3).poses)


def symmetric_room() -> tuple[KnownMap, World]:
    """8 m x 5 m, the same after half a turn; a map of exactly these walls."""
    plan = [box(0, 0, 8, 5), box(1.0, 0.0, 2.0, 0.8), box(6.0, 4.2, 7.0, 5.0)]
    cells = np.full((110, 170), -4.0, np.float32)
    cells[4:6, 4:166] = cells[104:106, 4:166] = cells[4:106, 4:6] = cells[4:106, 164:166] = 4.0
    cells[5:21, 25:45] = cells[89:105, 125:145] = 4.0
    grid = OccupancyGrid(cells, np.ones(cells.shape, bool), 0.05, (-0.25, -0.25))
    way = [(1.5, 1.5), (6.5, 1.0), (6.5, 3.5), (1.5, 4.0), (1.5, 1.5), (6.5, 1.0), (6.5, 3.5), (1.5, 4.0)]
    return KnownMap(grid), World.of("symmetric room", join(*plan), way)


@pytest.mark.parametrize("seed", range(4))
def test_in_a_room_that_looks_the_same_after_half_a_turn_the_robot_stays_lost(seed):
    known, world = symmetric_room()
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(rate_hz=3.0), np.random.default_rng(seed))
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(seed)
    state = mcl.init()
    for (odometry, scan), truth in zip(log.measurements, log.truth.poses, strict=True):
        state, report = mcl.step(state, odometry, scan, rng)
        twin = np.array([8 - truth[0], 5 - truth[1], truth[2] + math.pi])
        assert report.lost
        for place in (truth, twin):  # 95 % of chi-square with two degrees of freedom: 6
            away = (place - report.pose)[:2]
            assert away @ np.linalg.solve(report.covariance[:2, :2], away) < 6
    assert 0.3 < report.lost_probability < 0.7  # one of two


@pytest.mark.parametrize("bins", [2, 3, 10, 100, 3000])
def test_the_bound_is_the_chi_square_quantile(bins):
    """n = chi^2_{k-1, 1-delta} / (2 eps), of which the formula is Wilson and Hilferty's approximation."""
    kld = KldSampling(error=0.02, z=2.3263478740408408)
    exact = chdtri(bins - 1, 0.01) / (2 * 0.02)
    assert kld_bound(np.array(bins), kld.error, kld.z) == pytest.approx(exact, rel=0.02 if bins < 10 else 0.004, abs=1)


def test_one_bin_asks_for_nothing():
    assert kld_bound(np.array([0, 1]), 0.05, 2.33).tolist() == [0, 0]


def one_by_one(kld: KldSampling, poses: np.ndarray, weights: np.ndarray, rng: np.random.Generator) -> int:
    """The loop of Table 8.4, as the book has it."""
    ends, full, m = np.cumsum(weights), set[int](), 0
    bins = kld.bins(poses)
    while True:
        drawn = min(int(ends.searchsorted(rng.random() * ends[-1], side="right")), len(bins) - 1)
        full.add(int(bins[drawn]))
        m += 1
        if m >= kld.particles_max or (m >= kld_bound(np.array(len(full)), kld.error, kld.z) and m >= kld.particles_min):
            return m


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 3.0))
@settings(max_examples=25, deadline=None)
def test_as_many_as_the_table_draws_one_by_one(seed, width):
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(400, 3)) * [width, width, 0.3]
    weights = rng.random(400) ** 4
    kld = KldSampling(particles_min=20, particles_max=1500)
    assert kld.size(poses, weights, np.random.default_rng(seed)) == one_by_one(
        kld, poses, weights, np.random.default_rng(seed)
    )


def test_resampling_is_unbiased():
    """Of M drawn a particle comes up M w times in the mean: 400 draws of 500 or so, by a sampler of low variance."""
    rng = np.random.default_rng(3)
    poses, weights = rng.normal(size=(50, 3)), rng.random(50)
    weights /= weights.sum()
    kld = KldSampling(particles_min=100, particles_max=2000)
    shares = []
    for seed in range(400):
        parents = kld(poses, weights, Systematic(), np.random.default_rng(seed))
        shares.append(np.bincount(parents, minlength=50) / len(parents))
    # A count is floor or ceil of M w: its share has a deviation of at most 0.5 / 100, its mean over 400 of 2.5e-4.
    np.testing.assert_allclose(np.mean(shares, axis=0), weights, atol=5 * 2.5e-4)


LIDAR = LidarConfig(rate_hz=5.0, scan_time_s=0.15, reports_beam_times=True)
RANGES = np.array([1.0, 2.0, 3.0])


@pytest.fixture(scope="module")
def known():
    return KnownMap(flat_map())


@pytest.fixture(scope="module")
def log():
    return simulate(flat(), RobotConfig(), OdometryNoise(), LIDAR, np.random.default_rng(3))


def test_turning_scans_are_straightened_by_the_order_that_fits():
    geometry = ScanGeometry(np.array([-0.5, 0.0, 0.5]))
    scan = LaserScan.from_ranges(0, RANGES, geometry, range_max_m=30.0)
    beams = replace(scan, beam_times_s=np.array([0.0, 0.05, 0.1])).beams(0.1, 29.0)
    ends = {order: beams.deskew(order * np.array([0, 0, 1.0])).ends for order in (1, -1)} | {0: beams.ends}

    def straightened(gains: dict[int, float], turn_rps: float) -> np.ndarray:
        def share(one: Beams) -> float:
            return 0.6 + gains[next(k for k, known in ends.items() if np.array_equal(one.ends, known))]

        twist = np.array([0, 0, turn_rps])
        return beams.deskew(BeamOrder().learn(beams, twist, share).best(0.05) * twist).ends

    for gains, order in (
        ({1: 0, 0: 0, -1: 0}, 1), ({1: 0, 0: 0.04, -1: 0.04}, 1), ({1: 0, 0: 0.1, -1: 0.2}, -1),
        ({1: 0, 0: 0.2, -1: 0.1}, 0), ({1: 0.1, 0: 0, -1: 0.14}, 1),
    ):  # fmt: skip
        np.testing.assert_array_equal(straightened(gains, 1.0), ends[order])
    slow = np.array([0, 0, 0.19])  # 0.019 rad in a scan
    np.testing.assert_array_equal(straightened({}, 0.19), beams.deskew(slow).ends)


def heading_rmse(known, log, order, margin):
    """Of the pose that is told, in rad, where the driver tells `order` times the times of beams."""
    mcl, rng = (
        MonteCarloLocalization(known, MonteCarloConfiguration(beam_order_margin=margin)),
        np.random.default_rng(0),
    )
    state, off = mcl.init_gaussian(log.truth.poses[0], np.diag([0.04, 0.04, 0.01]), rng), []
    for (odometry, scan), truth in zip(log.measurements[:150], log.truth.poses, strict=False):
        told = replace(scan, beam_times_s=order * scan.beam_times_s)
        state, report = mcl.step(state, odometry, told, rng)
        off.append(report.pose[2] - truth[2])
    return float(np.sqrt(np.mean(np.square(wrap(np.array(off))))))


def test_times_that_a_driver_tells_backward_do_not_turn_the_pose(known, log):
    """At 1 rad/s a scan of 0.15 s is bent by 0.15 rad, and by as much again where it is straightened the wrong way."""
    assert heading_rmse(known, log, -1.0, 1.0) > 0.05
    assert heading_rmse(known, log, -1.0, 0.05) < 0.02
    assert heading_rmse(known, log, 1.0, 0.05) < 1.1 * heading_rmse(known, log, 1.0, 1.0)
