"""Laws of SE(2) and of angles on the circle.

Positions reach 1e3 m and rounding is 2^-53 of the greatest term; a chain of three operations loses a few units of
1e3 * 2^-52 = 2e-13 m, so 1e-11 m and, for angles of a few turns, 1e-13 rad leave a factor of ten or more.
"""

from __future__ import annotations

import math

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from gridslam.geometry import se2
from gridslam.geometry.angles import wrap
from support.relative_covariances import between_jacobians

METRES = 1e-11
RADIANS = 1e-13

metres = st.floats(-1e3, 1e3)
radians = st.floats(-math.pi, math.pi)
poses = st.tuples(metres, metres, radians).map(np.array)
short_twists = st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-3.1, 3.1)).map(np.array)
small_poses = st.tuples(st.floats(-10, 10), st.floats(-10, 10), radians).map(np.array)
half_circle_poses = st.tuples(st.floats(-10, 10), st.floats(-10, 10), st.floats(-1, 1))

IDENTITY = np.zeros(3)


def assert_same_pose(got: np.ndarray, want: np.ndarray, factor: float = 1.0) -> None:
    np.testing.assert_allclose(got[..., :2], want[..., :2], rtol=0, atol=METRES * factor)
    np.testing.assert_allclose(wrap(got[..., 2] - want[..., 2]), 0, atol=RADIANS * factor)
    assert np.all((got[..., 2] >= -math.pi) & (got[..., 2] < math.pi))


@given(st.floats(-1e6, 1e6))
@example(math.pi)
@example(-math.pi)
@example(math.nextafter(math.pi, 0))
@example(math.nextafter(-math.pi, -4))
@example(3 * math.pi)
@example(-1e-17)
@example(-5e-324)
@example(-0.0)
def test_wrap_stays_in_the_half_open_interval_and_is_idempotent(angle: float) -> None:
    once = wrap(angle)
    assert -math.pi <= once < math.pi
    assert wrap(once) == once
    if -math.pi <= angle < math.pi:
        assert math.copysign(1, once) == math.copysign(1, angle)
        assert once == angle
    # IEEE remainder is exact too, but its interval is closed: the two may differ at the ends only.
    remainder = math.remainder(angle, 2 * math.pi)
    assert once == (-math.pi if remainder == math.pi else remainder)
    array = wrap(np.array([angle, angle]))
    assert array.tobytes() == np.array([once, once]).tobytes()


@given(poses, poses, poses)
def test_composition_is_associative(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> None:
    assert_same_pose(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))


@given(poses)
def test_identity_and_inverse(a: np.ndarray) -> None:
    assert_same_pose(se2.compose(a, IDENTITY), a)
    assert_same_pose(se2.compose(IDENTITY, a), a)
    assert_same_pose(se2.compose(a, se2.inverse(a)), IDENTITY)
    assert_same_pose(se2.compose(se2.inverse(a), a), IDENTITY)


@given(poses, poses)
def test_between_is_inverse_then_compose(a: np.ndarray, b: np.ndarray) -> None:
    assert_same_pose(se2.between(a, b), se2.compose(se2.inverse(a), b))
    assert_same_pose(se2.compose(a, se2.between(a, b)), b)


@given(poses, poses, st.tuples(metres, metres))
def test_points_follow_composition(a: np.ndarray, b: np.ndarray, point: tuple[float, float]) -> None:
    there = se2.transform_points(a, se2.transform_points(b, point))
    np.testing.assert_allclose(se2.transform_points(se2.compose(a, b), point), there, rtol=0, atol=METRES)


@given(poses)
@example(np.array([1.0, 2.0, math.nextafter(math.pi, 0)]))
@example(np.array([1.0, 2.0, -math.pi]))
@example(np.array([1e3, -1e3, 1e-9]))
@example(np.array([1e3, -1e3, 5e-324]))
def test_exp_undoes_log(pose: np.ndarray) -> None:
    assert_same_pose(se2.exp(se2.log(pose)), pose)


@given(st.tuples(metres, metres, st.floats(-math.pi, math.pi, exclude_max=True)).map(np.array))
@example(np.array([1.0, 2.0, math.nextafter(math.pi, 0)]))
@example(np.array([1e3, 1e3, 1e-160]))
def test_log_undoes_exp(xi: np.ndarray) -> None:
    assert_same_pose(se2.log(se2.exp(xi)), xi)


@given(short_twists, st.floats(-1, 1), st.floats(-1, 1))
def test_motions_along_one_twist_add_up(xi: np.ndarray, first: float, second: float) -> None:
    assert_same_pose(se2.compose(se2.exp(first * xi), se2.exp(second * xi)), se2.exp((first + second) * xi))


@given(small_poses, short_twists)
def test_adjoint_moves_a_twist_across(pose: np.ndarray, xi: np.ndarray) -> None:
    left = se2.compose(se2.exp(se2.adjoint(pose) @ xi), pose)
    assert_same_pose(se2.compose(pose, se2.exp(xi)), left)


def central_differences(function, at: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """Error: step^2 / 6 times a third derivative (<= ~20) is 3e-10; rounding 20 * 2^-52 / step is 5e-10."""
    columns = []
    for k in range(3):
        shift = np.zeros(3)
        shift[k] = step
        difference = function(at + shift) - function(at - shift)
        difference[2] = wrap(difference[2])
        columns.append(difference / (2 * step))
    return np.stack(columns, axis=-1)


@given(small_poses, small_poses)
def test_jacobians_of_the_group_operations(a: np.ndarray, b: np.ndarray) -> None:
    by_a, by_b = se2.compose_jacobians(a, b)
    np.testing.assert_allclose(by_a, central_differences(lambda p: se2.compose(p, b), a), atol=1e-8)
    np.testing.assert_allclose(by_b, central_differences(lambda p: se2.compose(a, p), b), atol=1e-8)
    by_a, by_b = between_jacobians(a, b)
    np.testing.assert_allclose(by_a, central_differences(lambda p: se2.between(p, b), a), atol=1e-8)
    np.testing.assert_allclose(by_b, central_differences(lambda p: se2.between(a, p), b), atol=1e-8)


@given(st.lists(st.tuples(poses, poses), min_size=1, max_size=5))
def test_a_batch_is_its_single_poses(pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    a, b = (np.array(side) for side in zip(*pairs, strict=True))
    for function in (se2.compose, se2.between):
        assert_same_pose(function(a, b), np.array([function(p, q) for p, q in pairs]))
        assert_same_pose(function(a[:, None], b), np.array([[function(p, q) for q in b] for p in a]))
    for function in (se2.inverse, se2.exp, se2.log):
        assert_same_pose(function(a), np.array([function(p) for p in a]))
    each = zip(*(se2.compose_jacobians(p, q) for p, q in pairs), strict=True)
    for of_all, of_each in zip(se2.compose_jacobians(a, b), each, strict=True):
        np.testing.assert_allclose(of_all, of_each, rtol=1e-12, atol=METRES)
