"""Whether Monte Carlo localization knows how much it knows: covariances, and the lost flag."""

from __future__ import annotations

import numpy as np
import pytest

from global_localization import Building, GlobalRun
from gridslam.evaluation.consistency import nees
from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization
from gridslam.models.likelihood_field import LikelihoodField
from support.localization_world import RandomWalk, drive, flat_map

RUNS = 100
FIRST = np.diag([0.01, 0.01, 0.0025])


@pytest.fixture(scope="module")
def known():
    return KnownMap(flat_map())


def test_nees_with_the_simulators_true_noise(known):
    """Mean NEES of 100 runs between 0.5 and 2 times its expectation of 3.

    The noise of odometry and of a range is the simulator's own (1 cm); the map is of 5 cm cells, whose rounding the
    filter adds, and the beams are tempered, since they share it: less than by default, as this map has no other errors.
    """
    parts = MonteCarloConfiguration(sensor=LikelihoodField(sigma_hit_m=0.01, tempering=0.1))
    mcl, found = MonteCarloLocalization(known, parts, motion=RandomWalk()), []
    for seed in range(1, RUNS + 1):
        log, rng = drive(seed), np.random.default_rng(seed)
        truth = log.truth.poses[:45]
        state, reports = mcl.init_gaussian(rng.multivariate_normal(truth[0], FIRST), FIRST, rng), []
        for odometry, scan in log.measurements[:45]:
            state, report = mcl.step(state, odometry, scan, rng)
            reports.append(report)
        poses, covariances = (np.array([getattr(r, name) for r in reports]) for name in ("pose", "covariance"))
        found.append(nees(poses, truth, covariances))
    mean = np.mean(found)
    assert 0.5 * 3 < mean < 2 * 3
    # The median of chi-square with 3 degrees of freedom is 2.37: no step of the way is far above or below it.
    by_step = np.median(found, axis=0)
    assert by_step.max() < 2 * 2.37
    assert by_step.min() > 0.1 * 2.37


def test_who_is_told_to_be_found_is_there(known):
    """From nothing, 20 seeds: of all scans at which the robot is said to be found, and of all at which it is lost."""
    mcl, doubt, wrong, lost = MonteCarloLocalization(known), [], [], []
    for seed in range(20):
        log, rng, state = drive(seed % 5 + 1), np.random.default_rng(seed), mcl.init()
        for (odometry, scan), truth in zip(log.measurements[:45], log.truth.poses, strict=False):
            state, report = mcl.step(state, odometry, scan, rng)
            doubt.append(report.lost_probability)
            wrong.append(np.hypot(*(report.pose - truth)[:2]) > 1.0)
            lost.append(report.lost)
    doubt, wrong, lost = np.array(doubt), np.array(wrong), np.array(lost)
    assert (~lost).mean() > 0.7
    assert wrong[~lost].mean() < 0.02
    assert wrong[doubt < 0.05].mean() < 0.01
    assert not lost[-1]


def test_where_places_look_alike_nobody_is_told_to_be_found_where_it_is_not():
    """In these buildings the particles end up in one of several equal places; before there were rivals, in a wrong one.

    They were then told to be found at three scans in four, wrongly at all of these but for the equal rooms.
    """
    runs = [Building.of(name, seed).localize_globally(0, 20.0) for name, seed in (("equal_rooms", 0), ("symmetric", 1))]
    for run in runs:
        assert run.wrong.mean() > 0.2
        assert run.false < 0.05
    both = GlobalRun.joined(runs)
    assert both.doubt[both.wrong].min() > 0.2
