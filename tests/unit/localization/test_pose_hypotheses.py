"""Places that look like the one that is told: followed, refuted, and never forgotten without a reason."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.localization.belief import NO_HYPOTHESES, HypothesisTracker, PoseEstimate, PoseHypotheses
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.floor_plan import box, join
from gridslam.types import OccupancyGrid

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


FIXED = HypothesisTracker(jitter_m=0.0, jitter_rad=0.0)


def followed(hypotheses: PoseHypotheses, agree, steps: int):
    rng = np.random.default_rng(0)
    for _ in range(steps):
        hypotheses = FIXED(hypotheses, STILL, ALONE, CLOUD, EVEN, agree, rng)
    return hypotheses


def test_each_cluster_becomes_a_rival_but_that_which_is_told():
    rng = np.random.default_rng(1)
    poses = np.concatenate([place + 0.05 * rng.standard_normal((100, 3)) for place in (HERE, THERE, [4.0, 8.0, -1.0])])
    weights = np.repeat([0.005, 0.004, 0.001], 100)
    told = PoseEstimate(HERE, np.eye(3), 0.5)
    agree = agreeing((HERE, 0.8), (THERE, 0.8), (np.array([4.0, 8.0, -1.0]), 0.8))
    hypotheses = HypothesisTracker()(NO_HYPOTHESES, STILL, told, poses, weights, agree, rng)
    np.testing.assert_allclose(hypotheses.poses, [THERE, [4.0, 8.0, -1.0]], atol=0.3)
    np.testing.assert_array_equal(hypotheses.log_odds, 0)
    assert hypotheses.odds == pytest.approx(2)
    assert len(HypothesisTracker(max_hypotheses=1)(NO_HYPOTHESES, STILL, told, poses, weights, agree, rng).poses) == 1
    assert len(HypothesisTracker(min_mass=0.2)(NO_HYPOTHESES, STILL, told, poses, weights, agree, rng).poses) == 1


def test_what_looks_the_same_stays_and_what_looks_otherwise_goes():
    rival = PoseHypotheses(THERE[None], np.zeros(1))
    within = followed(rival, agreeing((HERE, 0.80), (THERE, 0.76)), 500)
    np.testing.assert_array_equal(within.log_odds, 0)  # by less than the map's own errors, 500 times
    once = followed(rival, agreeing((HERE, 0.8), (THERE, 0.4)), 1)
    assert once.log_odds[0] == pytest.approx(-FIXED.log_odds_per_scan * (0.4 - FIXED.margin))
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
