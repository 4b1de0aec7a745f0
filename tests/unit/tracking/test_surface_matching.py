"""Matching to the surfaces of the newest scans: exacter than cells, and only where surfaces say so."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.geometry.se2 import between, compose
from gridslam.tracking.odometry_calibration import OdometryCalibration, OdometryErrorModel
from gridslam.tracking.recent_scans import RecentScans
from gridslam.types import StoredScan

BEARINGS = np.linspace(-3.1, 3.1, 240)


def scan_from(pose, seed, half=(4.0, 3.0)):
    """Beams in a room about the origin, noise 1 cm; half its size (2,)."""
    ways = np.column_stack([np.cos(BEARINGS + pose[2]), np.sin(BEARINGS + pose[2])])
    corner = np.array(half)
    reach = np.where(ways > 0, (corner - pose[:2]) / ways, (-corner - pose[:2]) / ways).min(axis=1)
    reach += 0.01 * np.random.default_rng(seed).normal(size=len(reach))
    reach = np.minimum(reach, 12.0)
    return StoredScan(reach[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)]), np.zeros(2))


def remember(poses, half=(4.0, 3.0), most=8):
    recent = RecentScans()
    for seed, pose in enumerate(poses):
        recent = recent.insert(scan_from(np.array(pose), seed, half), pose, most)
    return recent


POSES = [(0.2 * k, 0.05 * k, 0.06 * k) for k in range(10)]
TRUE = (2.0, 0.5, 0.6)


def test_a_match_is_exact_to_millimetres_and_hundredths_of_a_degree():
    recent = remember(POSES)
    own = scan_from(np.array(TRUE), 99).ends
    errors = []
    for seed in range(20):
        off = np.random.default_rng(seed).normal(0, [0.02, 0.02, 0.01])
        found = recent.match(own, tuple((np.array(TRUE) + off).tolist()))
        errors.append(between(np.array(TRUE), np.array(found)))
    rms = np.sqrt(np.square(errors).mean(axis=0))
    assert (rms < [0.004, 0.004, 0.0015]).all()  # of guesses that are off by 0.02, 0.02, 0.01


def test_what_has_few_points_or_would_move_far_stays():
    recent = remember(POSES)
    own = scan_from(np.array(TRUE), 99).ends
    guess = (2.02, 0.48, 0.6)
    assert recent.match(own, guess) != guess
    assert RecentScans().match(own, guess) == guess
    assert RecentScans(recent.scans[-1:]).match(np.ascontiguousarray(own[::20]), guess) == guess
    far = (2.12, 0.5, 0.6)
    assert recent.match(own, far) == pytest.approx(far, abs=1e-3)
    assert recent.match(np.empty((0, 2)), guess) == guess


LEARN = OdometryCalibration()
PERIOD_M = 0.05

# Where the wheels turn about, 0.1 m from the base, appears as q; a heading biased by metre and by radian as b and g.
FACTORS = np.array([0.95, 0.02, -0.03, 0.1, 0.93, 0.04])


def drive(steps, rng):
    """Increments (N, 3) of a robot that drives ahead and turns as it likes."""
    ahead = PERIOD_M * (1 + 0.3 * np.sin(np.arange(steps) / 50))
    turns = 0.06 * np.sin(np.arange(steps) / 23) + 0.02 * rng.standard_normal(steps)
    return np.column_stack([ahead, np.zeros(steps), turns])


def true_of(told, factors):
    """What the robot did, of what the odometry tells (N, 3)."""
    x, y, theta = told.T
    a, c, p, q, g, b = factors
    return np.column_stack([a * x - c * y + p * theta, c * x + a * y + q * theta, g * theta + b * x])


def walk(increments):
    poses = [np.zeros(3)]
    for increment in increments:
        poses.append(compose(poses[-1], increment))
    return np.array(poses)


def taught(true, told, *, determined=True, errors=None):
    """What is learned along a drive of increments (N, 3), of which every scan is matched exactly."""
    errors = errors or OdometryErrorModel()
    for pose, odometry in zip(walk(true), walk(told), strict=True):
        LEARN.learn(errors, pose, odometry, True, determined)
    return errors


@settings(max_examples=15, deadline=None)
@given(
    st.tuples(*(st.floats(low, high) for low, high in [(0.85, 1.15), (-0.1, 0.1), (-0.2, 0.2), (-0.2, 0.2)])),
    st.tuples(st.floats(0.93, 1.07), st.floats(-0.05, 0.05)),
)
def test_systematic_errors_are_found(position, heading):
    """To what the prior of half a squared metre and radian leaves of them after 100 m, and the stretches' curvature.

    The worst corner of these ranges is 0.0375 off.
    """
    factors, told = np.array([*position, *heading]), drive(2000, np.random.default_rng(0))
    errors = taught(true_of(told, factors), told)
    np.testing.assert_allclose(errors.factors, factors, atol=0.038)
    increment = np.array([0.05, 0.0, 0.05])
    np.testing.assert_allclose(errors.correct_increment(increment), true_of(increment[None], factors)[0], atol=0.003)


def test_slips_are_not_learned():
    """In each twentieth stretch the wheels spin for half a metre: 5 % of the way, and none of the scale."""
    told = drive(4000, np.random.default_rng(3))
    true = true_of(told, FACTORS)
    slips = np.arange(len(told)) % 200 < 10
    true[slips] = 0
    errors = taught(true, told)
    np.testing.assert_allclose(errors.factors, FACTORS, atol=0.03)
    assert errors.factors[0] > 0.94
    assert errors.trusted


def test_what_changes_is_learned_anew():
    """From the floor onto a carpet, on which the wheels go 6 % farther."""
    told, rng = drive(4000, np.random.default_rng(4)), np.random.default_rng(5)
    noise = 0.002 * rng.standard_normal(told.shape)
    errors = taught(told + noise, told)
    assert errors.factors[0] == pytest.approx(1, abs=0.01)
    LEARN.learn(errors, np.zeros(3), np.zeros(3), False, True)
    taught(told * [0.94, 1, 1] + noise, told, errors=errors)
    assert errors.factors[0] == pytest.approx(0.94, abs=0.012)


@pytest.mark.parametrize("times", [(0, 0, 0), (1, 1, -1), (-1, -1, 1)], ids=["frozen", "reflected", "backward"])
def test_odometry_that_helps_nothing_is_not_trusted_until_it_does(times):
    true = drive(1000, np.random.default_rng(8))
    errors = OdometryErrorModel()
    poses, odometry = walk(true), walk(true * times)
    for pose, told in zip(poses[:200], odometry[:200], strict=True):  # 10 m
        LEARN.learn(errors, pose, told, True, True)
    assert not errors.trusted
    taught(true, true, errors=errors)
    assert errors.trusted
    assert np.abs(errors.factors - [1, 0, 0, 0, 1, 0]).max() < 0.02


def test_the_variance_along_an_open_way_is_that_of_its_pieces():
    """Of a random walk and of the scale, whose error is common to all pieces; in proportion to what is left over."""
    errors = OdometryErrorModel(
        variances=np.array([0.01**2, 1.0]), position=np.diag([7.5, 0, 0, 0])[:, [0, 1, 2, 3, 3]]
    )
    pieces = [0.3, 1.2, 0.5]
    begins = np.cumsum([0.0, *pieces[:-1]])
    whole = errors.variance_along(0.0, sum(pieces))
    assert sum(map(errors.variance_along, begins, pieces)) == pytest.approx(whole)
    assert whole == pytest.approx(0.01**2 * (2.0 / 0.5 + 2.0**2 / 8.0))
