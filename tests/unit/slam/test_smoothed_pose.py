"""The pose that is reported errs by less than the matches it follows, does not drift from them, and jumps with them."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.models import DiffusionMotion, GaussianIncrement
from gridslam.slam.grid_fastslam.smoothed_pose import SmoothedPose

INCREMENT = np.array([0.5, 0.0, 0.1])


def simulate(rng, tracked_sigmas, matched_sigmas, steps=4000):
    """Return true, matched and reported poses (T, 3) of a robot in a circle, with noise of tracking and of matches."""
    motion = DiffusionMotion()
    true, reported = np.zeros(3), SmoothedPose(np.zeros(3))
    rows = []
    for _ in range(steps):
        true = compose(true, INCREMENT)
        control = INCREMENT + tracked_sigmas * rng.standard_normal(3)
        matched = true + matched_sigmas * rng.standard_normal(3)
        reported = reported.follow(control, motion(control), matched)
        rows.append((true, matched, reported.pose))
    return np.array(rows).transpose(1, 0, 2)


def test_steps_err_by_half_of_what_those_of_matches_do_and_nothing_adds_up():
    """With the noise of simulated buildings: 3 mm and 1 mrad of tracking, 7 mm and 2 mrad of matches a key scan."""
    true, matched, reported = simulate(
        np.random.default_rng(0), np.array([0.003, 0.003, 0.001]), np.array([0.007, 0.007, 0.002])
    )
    of_matches, of_reports = (
        np.sqrt(np.square(between(poses[:-1], poses[1:]) - between(true[:-1], true[1:])).mean(axis=0))
        for poses in (matched, reported)
    )
    assert (of_reports < 0.55 * of_matches).all()
    away = np.sqrt(np.square(reported - true)[:, :2].sum(axis=1).mean())
    assert away < 0.01  # 4000 tracked steps would be off by metres


def test_gain_is_that_of_the_steady_state():
    """Along a line, without noise of the heading: K of the scalar Riccati equation, by hand."""
    q, r = 0.01**2, 0.08**2
    prior = (q + np.sqrt(q * q + 4 * q * r)) / 2
    ahead = np.array([0.5, 0.0, 0.0])
    motion = GaussianIncrement.from_std(ahead, np.array([0.01, 0.01, 0.0]))
    reported = SmoothedPose(np.zeros(3))
    for step in range(200):
        reported = reported.follow(ahead, motion, np.array([0.5 * (step + 1), 0.0, 0.0]))
    missed = reported.follow(ahead, motion, np.array([0.5 * 201 + 0.01, 0.0, 0.0]))
    assert missed.pose[0] - 0.5 * 201 == pytest.approx(0.01 * prior / (prior + r), rel=1e-6)


@pytest.mark.parametrize("away", [[0.3, 0.0, 0.0], [0.0, -0.3, 0.0], [0.0, 0.0, 0.1]])
def test_where_a_loop_closes_the_matched_pose_is_reported_at_once(away):
    reported = SmoothedPose(np.zeros(3)).follow(INCREMENT, DiffusionMotion()(INCREMENT), INCREMENT)
    matched = compose(compose(reported.pose, INCREMENT), np.array(away))
    after = reported.follow(INCREMENT, DiffusionMotion()(INCREMENT), matched)
    np.testing.assert_array_equal(after.pose, matched)


@pytest.mark.parametrize("side", [1, -1])
def test_headings_wrap(side):
    """Half of what the match misses is corrected, from 1 mrad before the back to 4 mrad beyond it."""
    before = SmoothedPose(np.array([0.0, 0.0, side * (np.pi - 0.001)]), np.diag(np.square([0.08, 0.08, 0.03])))
    after = before.follow(
        np.zeros(3), GaussianIncrement.from_std(np.zeros(3), np.zeros(3)), np.array([0, 0, side * (0.009 - np.pi)])
    )
    assert after.pose[2] == pytest.approx(side * (0.004 - np.pi), abs=1e-9)


def test_a_miss_to_the_side_tells_of_the_heading():
    """Of a robot that has driven half a metre by a heading that is uncertain."""
    before = SmoothedPose(np.zeros(3), np.diag([0.0, 0.0, 0.02**2]))
    ahead = np.array([0.5, 0.0, 0.0])
    after = before.follow(ahead, GaussianIncrement.from_std(ahead, np.zeros(3)), np.array([0.5, 0.01, 0.0]))
    assert after.pose[2] > 1e-5
    assert after.pose[1] == pytest.approx(0.5 * after.pose[2], rel=1e-9)
