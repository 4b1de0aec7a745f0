"""SE(2): worked values, shapes and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry import se2

QUARTER = math.pi / 2


def test_compose_and_between_by_hand() -> None:
    # From (1, 2) facing +y, one metre ahead and two to the left is (1 - 2, 2 + 1).
    np.testing.assert_allclose(se2.compose([1, 2, QUARTER], [1, 2, QUARTER]), [-1, 3, -math.pi], atol=1e-15)
    np.testing.assert_allclose(se2.between([1, 2, QUARTER], [-1, 3, -math.pi]), [1, 2, QUARTER], atol=1e-15)
    np.testing.assert_allclose(se2.transform_points([1, 2, QUARTER], [[1, 2], [0, 0]]), [[-1, 3], [1, 2]], atol=1e-15)


def test_exp_drives_a_quarter_circle() -> None:
    # Radius 2 m, so an arc of pi metres; it ends 2 m ahead and 2 m to the left.
    np.testing.assert_allclose(se2.exp([math.pi, 0, QUARTER]), [2, 2, QUARTER], atol=1e-15)
    np.testing.assert_allclose(se2.log([2, 2, QUARTER]), [math.pi, 0, QUARTER], atol=1e-15)
    np.testing.assert_array_equal(se2.exp([3, 4, 0]), [3, 4, 0])


@pytest.mark.parametrize("function", [se2.inverse, se2.exp, se2.log, se2.adjoint])
@pytest.mark.parametrize("bad", [np.zeros(2), np.zeros((3, 4)), 1.0])
def test_wrong_width_is_refused(function, bad: object) -> None:
    with pytest.raises(ArgumentError, match=r"shape \(..., 3\)"):
        function(bad)


@pytest.mark.parametrize("covariance", [[4, 1, 0.5, 1, 2, -0.3, 0.5, -0.3, 1], [2, 0, 0, 0, 2, 0, 0, 0, 3]])
def test_covariances_rotate_alike_by_one_angle_and_by_many(covariance) -> None:
    """As the product of matrices: by one angle, by few, by more than a hundred, and with a covariance for each."""
    own = np.reshape(np.array(covariance, float), (3, 3))
    angles = np.linspace(-3, 3, 120).reshape(8, 15)
    c, s, zero, one = np.cos(angles), np.sin(angles), np.zeros((8, 15)), np.ones((8, 15))
    rotation = np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]), (0, 1), (-2, -1))
    want = np.einsum("...ij,jk,...lk->...il", rotation, own, rotation)
    np.testing.assert_allclose(se2.rotate_covariances(own, angles), want, atol=1e-14)
    np.testing.assert_allclose(se2.rotate_covariances(own, angles[0]), want[0], atol=1e-14)
    np.testing.assert_allclose(se2.rotate_covariances(np.tile(own, (8, 15, 1, 1)), angles), want, atol=1e-14)
    np.testing.assert_allclose(se2.rotate_covariances(own, angles[1, 2]), want[1, 2], atol=1e-14)
