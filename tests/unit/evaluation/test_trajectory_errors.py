import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.evaluation import (
    absolute_errors,
    align,
    interpolate,
    relative_errors_by_distance,
)
from gridslam.geometry.se2 import compose
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
