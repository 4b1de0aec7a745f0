"""SE(3): worked values and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry import rigid, se3

HALF = math.sqrt(0.5)


def test_a_quarter_turn_about_each_axis() -> None:
    # About x: y goes to z. About y: z goes to x. About z: x goes to y.
    for axis, (start, end) in enumerate([(1, 2), (2, 0), (0, 1)]):
        xyzw = [0.0, 0.0, 0.0, HALF]
        xyzw[axis] = HALF
        turned = se3.from_quaternion([1, 2, 3], xyzw)
        np.testing.assert_allclose(turned[:3, :3] @ np.eye(3)[start], np.eye(3)[end], atol=1e-15)
        assert turned[:3, 3].tolist() == [1, 2, 3]


def test_upside_down() -> None:
    # Half a turn about x: still looking ahead, z down, and what was left is right.
    laser = se3.from_quaternion([0.1, 0.2, 0.3], [1, 0, 0, 0])
    assert se3.to_planar(laser).tolist() == [0.1, 0.2, 0]
    assert se3.tilt_rad(laser) == math.pi
    np.testing.assert_array_equal(laser[:3, :3], np.diag([1, -1, -1]))
    # Half a turn about y: looking back.
    assert se3.to_planar(se3.from_quaternion([0, 0, 0], [0, 1, 0, 0])).tolist() == [0, 0, -math.pi]


def test_a_tilted_laser() -> None:
    tilt = math.radians(10)
    pitched = se3.from_quaternion([0, 0, 1], [0, math.sin(tilt / 2), 0, math.cos(tilt / 2)])
    assert se3.tilt_rad(pitched) == pytest.approx(tilt, abs=1e-15)
    assert se3.to_planar(pitched).tolist() == [0, 0, 0]


def test_halfway() -> None:
    # Turns of 0 and a quarter: an eighth; 170 and -170 degrees: through 180, not through 0.
    for a, b, fraction, want in (
        ([0, 0, 0], [2, 4, math.pi / 2], 0.5, [1, 2, math.pi / 4]),
        ([0, 0, math.radians(170)], [0, 0, math.radians(-170)], 0.25, [0, 0, math.radians(175)]),
    ):
        begin, end = (rigid.from_matrix(se3.from_planar(pose)) for pose in (a, b))
        got = rigid.to_matrix(rigid.interpolate(begin, end, fraction))
        np.testing.assert_allclose(got, se3.from_planar(want), atol=1e-15)


def test_quaternions_of_single_precision_are_brought_to_norm_1() -> None:
    xyzw = np.array([0.1, 0.2, 0.3, math.sqrt(0.86)])
    want = se3.from_quaternion([0, 0, 0], xyzw)
    np.testing.assert_allclose(se3.from_quaternion([0, 0, 0], xyzw.astype(np.float32)), want, atol=1e-7)
    np.testing.assert_allclose(se3.from_quaternion([0, 0, 0], 1.004 * xyzw), want, atol=1e-15)


@pytest.mark.parametrize("xyzw", [[0, 0, 0, 0], [0, 0, 0, 1.01], [0, 0, 0, 0.99], [1, 1, 1, 1]])
def test_a_quaternion_that_is_no_rotation_is_refused(xyzw: list[float]) -> None:
    with pytest.raises(ArgumentError, match="xyzw: expected a quaternion of norm 1"):
        se3.from_quaternion([0, 0, 0], xyzw)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_values_that_are_not_finite_are_refused(bad: float) -> None:
    matrix = np.eye(4)
    matrix[0, 3] = bad
    calls = [
        lambda: se3.from_quaternion([0, bad, 0], [0, 0, 0, 1]),
        lambda: se3.from_quaternion([0, 0, 0], [0, 0, bad, 1]),
        lambda: rigid.from_quaternion((0, bad, 0), (0, 0, 0, 1)),
        lambda: rigid.from_quaternion((0, 0, 0), (0, 0, bad, 1)),
        lambda: se3.from_planar([0, 0, bad]),
        lambda: rigid.from_matrix(matrix),
    ]
    for call in calls:
        with pytest.raises(ArgumentError):
            call()


def not_rigid() -> list[np.ndarray]:
    mirror, stretched, sheared, projective = np.eye(4), np.eye(4), np.eye(4), np.eye(4)
    mirror[2, 2] = -1
    stretched[2, 2] = 1.001
    sheared[0, 1] = 0.001
    projective[3, 0] = 0.001
    return [mirror, stretched, sheared, projective, np.eye(3), np.eye(4)[None], np.zeros((4, 4))]


@pytest.mark.parametrize("matrix", not_rigid())
def test_what_is_not_rigid_is_refused(matrix: np.ndarray) -> None:
    for call in (rigid.from_matrix, se3.to_planar, se3.tilt_rad, se3.to_quaternion):
        with pytest.raises(ArgumentError, match="matrix"):
            call(matrix)


def test_a_vertical_x_axis_has_no_yaw() -> None:
    with pytest.raises(ArgumentError, match="not vertical"):
        se3.to_planar(se3.from_quaternion([0, 0, 0], [0, HALF, 0, HALF]))


@pytest.mark.parametrize("bad", [np.zeros(2), np.zeros((3, 1)), 1.0])
def test_wrong_shapes_are_refused(bad: object) -> None:
    for call in (se3.from_planar, lambda v: se3.from_quaternion(v, [0, 0, 0, 1])):
        with pytest.raises(ArgumentError, match="3 finite numbers"):
            call(bad)
