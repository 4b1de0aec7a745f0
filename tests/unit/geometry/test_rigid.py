"""SE(3): worked values and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry import rigid
from gridslam.scan import ScanGeometry
from support import se3

HALF = math.sqrt(0.5)


def test_a_quarter_turn_about_each_axis() -> None:
    # About x: y goes to z. About y: z goes to x. About z: x goes to y.
    for axis, (start, end) in enumerate([(1, 2), (2, 0), (0, 1)]):
        xyzw = [0.0, 0.0, 0.0, HALF]
        xyzw[axis] = HALF
        turned = se3.from_quaternion([1, 2, 3], xyzw)
        np.testing.assert_allclose(turned[:3, :3] @ np.eye(3)[start], np.eye(3)[end], atol=1e-15)
        assert turned[:3, 3].tolist() == [1, 2, 3]


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
        lambda: rigid.from_quaternion((0, bad, 0), (0, 0, 0, 1)),
        lambda: rigid.from_quaternion((0, 0, 0), (0, 0, bad, 1)),
        lambda: ScanGeometry.planar([0.0], [0, 0, bad]),
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
    with pytest.raises(ArgumentError, match="matrix"):
        rigid.from_matrix(matrix)


def test_a_vertical_x_axis_has_no_yaw() -> None:
    with pytest.raises(ArgumentError, match="not vertical"):
        se3.to_planar(se3.from_quaternion([0, 0, 0], [0, HALF, 0, HALF]))
