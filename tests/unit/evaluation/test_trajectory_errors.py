import importlib.util
import math
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.evaluation import (
    Relations,
    absolute_errors,
    align,
    interpolate,
    nees,
    relation_errors,
    relative_errors_by_distance,
)
from gridslam.evaluation.maps import landmark_errors, pair_by_position
from gridslam.geometry.se2 import compose, inverse, transform_points
from gridslam.types import Trajectory

SECOND = 1_000_000_000
POSES = st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(-3.1, 3.1)).map(np.array)


def trajectory(poses, stamps=None):
    poses = np.asarray(poses, dtype=np.float64)
    return Trajectory(np.arange(len(poses)) * SECOND if stamps is None else np.asarray(stamps), poses)


def walk(seed, n=50):
    rng = np.random.default_rng(seed)
    poses = np.zeros((n, 3))
    for i in range(1, n):
        poses[i] = compose(poses[i - 1], rng.normal([0.5, 0, 0], [0.1, 0.1, 0.3]))
    return trajectory(poses)


def straight(step, n=11):
    return trajectory(np.column_stack([np.arange(n) * step, np.zeros(n), np.zeros(n)]))


def test_interpolation_takes_the_shorter_arc():
    got, exact = interpolate(trajectory([[0, 0, 3.0], [2, 4, -3.0]]), [SECOND // 4, SECOND // 2, SECOND])
    # From 3.0 to -3.0 rad across pi are 2 pi - 6 = 0.2832 rad.
    arc = 2 * math.pi - 6
    np.testing.assert_allclose(got[0], [0.5, 1.0, 3.0 + arc / 4], atol=1e-12)
    np.testing.assert_allclose(got[1], [1.0, 2.0, -math.pi], atol=1e-12)
    np.testing.assert_allclose(got[2], [2.0, 4.0, -3.0], atol=1e-12)
    assert exact.tolist() == [False, False, True]


def test_interpolation_near_a_stamp_is_exact_and_outside_raises():
    one = trajectory([[1, 2, 3]], [SECOND])
    got, exact = interpolate(one, [SECOND - 1_000_000, SECOND + 1_000_000])
    assert exact.all()
    np.testing.assert_allclose(got, [[1, 2, 3], [1, 2, 3]])
    with pytest.raises(ArgumentError, match="1 outside"):
        interpolate(one, [SECOND, SECOND + 1_000_001])
    with pytest.raises(ArgumentError, match="at least one pose"):
        interpolate(trajectory(np.zeros((0, 3))), [0])


# Points at +-1 on x, partners at +-1 on y and moved by (3, 4): a quarter turn about the origin, then the shift.
def test_alignment_by_hand():
    got = align(np.array([[1.0, 0.0], [-1.0, 0.0]]), np.array([[3.0, 5.0], [3.0, 3.0]]))
    np.testing.assert_allclose(got, [3.0, 4.0, math.pi / 2], atol=1e-15)
    np.testing.assert_allclose(align(np.ones((2, 2)), np.zeros((2, 2))), [-1.0, -1.0, 0.0])


# A straight of 0, 1, .., 10 m against one stretched by 1.1: aligned at the middle, errors 0.1 |i - 5|.
def test_absolute_error_by_hand():
    got = absolute_errors(straight(1.1), straight(1.0))
    assert got.trans_mean_m == pytest.approx(0.1 * 30 / 11)
    assert got.trans_rmse_m == pytest.approx(0.1 * math.sqrt(110 / 11))
    assert got.trans_max_m == pytest.approx(0.5)
    assert got.trans_std_m == pytest.approx(math.sqrt(got.trans_rmse_m**2 - got.trans_mean_m**2))
    assert absolute_errors(straight(1.1), straight(1.0), aligned=False).trans_max_m == pytest.approx(1.0)


def test_the_reference_is_interpolated_up_to_a_gap():
    """Where it has poses around a stamp, each a second from the next; not in a gap of two, and not beyond its ends."""
    truth = straight(1.0)
    between_them = trajectory(truth.poses + np.array([0.3, 0.0, 0.0]), truth.stamps_ns + 300_000_000)
    found = absolute_errors(between_them, truth, aligned=False)
    assert found.n == 10, "the last one lies behind the reference"
    assert found.trans_max_m < 1e-9
    left = np.arange(11) != 5
    holed = trajectory(truth.poses[left], truth.stamps_ns[left])
    assert absolute_errors(between_them, holed).n == 8
    assert absolute_errors(between_them, holed, max_gap_ns=2_000_000_000).n == 10


def test_times_without_anything_in_common_are_described():
    late = trajectory(straight(1.0).poses, straight(1.0).stamps_ns + 1_700_000_000_000_000_000)
    with pytest.raises(ArgumentError, match=r"to 1700000010\.000 s, and the reference from 0\.000"):
        absolute_errors(late, straight(1.0))
    with pytest.raises(ArgumentError, match="estimate"):
        absolute_errors(trajectory(np.zeros((1, 3)), [100 * SECOND]), straight(1.0))


@given(motion=POSES)
def test_relative_errors_do_not_depend_on_the_frame(motion):
    truth, estimate = walk(1), walk(2)
    moved = Trajectory(estimate.stamps_ns, compose(motion, estimate.poses))
    here, there = (relative_errors_by_distance(t, truth, 2.0) for t in (estimate, moved))
    assert here.trans_rmse_m == pytest.approx(there.trans_rmse_m, abs=1e-9)
    assert here.rot_rmse_deg == pytest.approx(there.rot_rmse_deg, abs=1e-7)


def test_nees_by_hand():
    # Standard deviations 0.1, 0.2, 0.05 and errors of 1, 2 and 3 of them, the heading's across the seam.
    covariance = np.diag([0.01, 0.04, 0.0025])[None]
    got = nees(np.array([[1.1, 2.4, 0.1 - math.pi]]), np.array([[1.0, 2.0, math.pi - 0.05]]), covariance)
    assert got == pytest.approx([1 + 4 + 9])
    # Correlated: P = [[2, 1], [1, 2]] has the inverse [[2, -1], [-1, 2]] / 3, so e = (1, 1) gives 2/3.
    correlated = np.array([[[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]])
    assert nees(np.array([[1.0, 1.0, 0.0]]), np.zeros((1, 3)), correlated) == pytest.approx([2 / 3])


def test_claims_that_are_no_covariance_raise():
    with pytest.raises(ArgumentError, match="positive definite"):
        nees(np.zeros((1, 3)), np.zeros((1, 3)), np.diag([1.0, 1.0, -1.0])[None])


TRUTH = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.3], [0.0, 5.0], [-3.0, 1.0]])


@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2), turn=st.floats(-0.05, 0.05))
def test_pairs_by_place_are_found_from_a_near_guess_and_surplus_is_told(x, y, turn):
    """0.2 m and 0.05 rad move no landmark by more than 0.6 m; the nearest two are 0.3 m apart."""
    map_from_true = np.array([x, y, turn])
    positions = np.concatenate([transform_points(map_from_true, TRUTH[[3, 2, 1, 4]]), [[20.0, 20.0]]])
    ours, theirs = pair_by_position(positions, TRUTH, inverse(np.zeros(3)), reach_m=0.8)
    errors = landmark_errors(positions, TRUTH, (ours, theirs))
    assert (errors.found, errors.missing, errors.surplus) == (4, 1, 1)
    if np.hypot(x, y) + 5 * abs(turn) < 0.15:  # then each is nearest to its own
        assert dict(zip(ours.tolist(), theirs.tolist(), strict=True)) == {0: 3, 1: 2, 2: 1, 3: 4}
        assert errors.rmse_m < 1e-9


def test_errors_after_alignment():
    moved = transform_points(np.array([5.0, -2.0, 1.0]), TRUTH)
    everyone = np.arange(5), np.arange(5)
    assert landmark_errors(moved, TRUTH, everyone).max_m < 1e-12
    # A square's corners pushed outward by d are off by d each, however they are aligned.
    square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
    found = landmark_errors(1.1 * square, square, (np.arange(4), np.arange(4)))
    assert found.rmse_m == pytest.approx(0.1 * np.sqrt(2))
    assert found.max_m == pytest.approx(0.1 * np.sqrt(2))


def random_case(seed):
    """A trajectory with jittering stamps, and relations of which a third fall between its poses."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(200) * 200_000_000 + rng.integers(-150_000_000, 150_000_000, 200)
    poses = np.cumsum(rng.normal(0, [0.3, 0.3, 0.5], (200, 3)), axis=0)
    poses[:, 2] = (poses[:, 2] + math.pi) % (2 * math.pi) - math.pi
    given_times, other_times = rng.choice(stamps, (60, 2)), rng.integers(SECOND, 39 * SECOND, (60, 2))
    times = np.where(rng.random((60, 2)) < 0.67, given_times, other_times)
    truth = rng.uniform([-5, -5, -math.pi], [5, 5, math.pi], (60, 3))
    return Trajectory(stamps, poses), Relations(times[:, 0], times[:, 1], truth)


@pytest.mark.parametrize("seed", range(10))
def test_agrees_with_the_published_scorer(data_dir, seed):
    path = data_dir.parent / "tools" / "relations.py"
    spec = importlib.util.spec_from_file_location("relations_scorer", path)
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    scorer.round = lambda value, _digits: value  # what it computes, not what it prints
    trajectory, relations = random_case(seed)
    order = np.argsort(trajectory.stamps_ns, kind="stable")
    columns = np.zeros((len(relations.poses), 8))
    columns[:, 0], columns[:, 1] = relations.from_ns / SECOND, relations.to_ns / SECOND
    columns[:, 2:4], columns[:, 7] = relations.poses[:, :2], relations.poses[:, 2]
    expected = scorer.score(trajectory.stamps_ns[order] / SECOND, trajectory.poses[order], columns)
    got = asdict(relation_errors(trajectory, relations))
    assert expected.keys() == got.keys() - {"trans_rmse_m", "rot_rmse_deg"}
    assert 0.5 < got["exact"] < 0.9
    for name, value in expected.items():
        assert got[name] == pytest.approx(value, abs=1e-9), name


# From (0, 0, 0) to (1, 2, pi/2) and on to (1, 5, pi): seen from the first (1, 2, pi/2), from the second (3, 0, pi/2).
def test_numbers_by_hand():
    trajectory = Trajectory(np.arange(3) * SECOND, np.array([[0, 0, 0], [1, 2, math.pi / 2], [1, 5, -math.pi]]))
    truth = np.array([[1.3, 2.4, math.pi / 2], [3.0, -1.5, math.pi / 2 - math.radians(3)]])
    got = relation_errors(trajectory, Relations(np.array([0, 1]) * SECOND, np.array([1, 2]) * SECOND, truth))
    assert got.n == 2
    assert got.exact == 1.0
    assert [got.trans_mean_m, got.trans_std_m, got.trans_max_m] == pytest.approx([1.0, 0.5, 1.5], abs=1e-12)
    assert [got.rot_mean_deg, got.rot_std_deg, got.rot_max_deg] == pytest.approx([1.5, 1.5, 3.0], abs=1e-9)


def test_a_relation_outside_the_trajectory_raises():
    trajectory = Trajectory(np.array([0, SECOND]), np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="outside"):
        relation_errors(trajectory, Relations(np.array([0]), np.array([SECOND + 1_100_000]), np.zeros((1, 3))))
