"""SE(2): worked values, shapes and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.geometry import se2, single_pose
from gridslam.geometry.angles import find_wrong_beam_angles, wrap

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


METRES = st.floats(-1e4, 1e4)
POSES = st.tuples(METRES, METRES, st.floats(-math.pi, math.pi, exclude_max=True))
TWISTS = st.tuples(METRES, METRES, st.floats(-3 * math.pi, 3 * math.pi))


@given(POSES, POSES)
def test_compose_and_between_are_those_of_se2(a, b):
    assert single_pose.compose(a, b) == tuple(se2.compose(a, b).tolist())
    assert single_pose.between(a, b) == tuple(se2.between(a, b).tolist())


@given(POSES, TWISTS)
def test_exp_and_log_are_those_of_se2(pose, twist):
    assert single_pose.exp(twist) == tuple(se2.exp(twist).tolist())
    assert single_pose.log(pose) == tuple(se2.log(pose).tolist())


def test_a_pose_that_nobody_measured_stays_unknown():
    assert not single_pose.is_known(single_pose.UNKNOWN_POSE)
    assert not single_pose.is_known(single_pose.between(single_pose.UNKNOWN_POSE, (1.0, 2.0, 3.0)))
    assert single_pose.is_known(single_pose.as_pose(np.zeros(3)))


TURN = 2 * math.pi


@pytest.mark.parametrize(
    ("angle", "want"),
    [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (TURN, 0.0), (4.0, 4.0 - TURN), (7, 7 - TURN)],
)
def test_wrap_of_known_angles(angle: float, want: float) -> None:
    assert wrap(angle) == want
    assert wrap(np.array([angle]))[0] == want


@pytest.mark.parametrize("most", [np.pi, 3 * np.pi, 100.0])
def test_many_angles_are_wrapped_as_each_by_itself(most: float) -> None:
    """Bit for bit, whichever way is taken; with angles at the ends of the interval, and next to them."""
    ends = np.array([k * np.pi for k in range(-4, 5)])
    ends = np.concatenate([ends, np.nextafter(ends, -9), np.nextafter(ends, 9)])
    angles = np.concatenate([np.random.default_rng(0).uniform(-most, most, 1000), ends[np.abs(ends) < most]])
    assert wrap(angles).tolist() == [wrap(angle) for angle in angles.tolist()]


@pytest.mark.parametrize(
    ("start", "step", "beams", "end"),
    [
        (-math.pi, TURN / 360, 360, math.nan),  # nothing stated
        (-math.pi, TURN / 360, 360, math.pi),  # the beam that would follow the last one
        (-math.pi, TURN / 359, 360, math.pi),
        (-math.pi, TURN / 360, 361, math.pi),
        (0.0, TURN / 360, 360, 0.0),  # left at 0
        (math.pi / 2, TURN / 360, 360, math.pi / 2 - TURN / 360),  # a whole turn away
        (2.5, 0.01, 200, 2.5 + 1.99 - TURN),  # across the cut at pi
        (math.pi, -TURN / 720, 720, -math.pi),  # clockwise
        (-2.0, 0.0175, 230, 2.0),  # rounded to a few digits
        (0.0, 0.0, 1, 0.0),
        (0.0, 0.1, 0, 0.0),
    ],
)
def test_the_angles_of_drivers_that_are_used_are_right(start, step, beams, end):
    assert find_wrong_beam_angles(start, step, beams, end) == ""


@pytest.mark.parametrize(
    ("start", "step", "beams", "end", "problem"),
    [
        (-math.pi, math.pi / 360, 360, math.pi, "not at angle_max 3.14159"),
        (-math.pi, 4 * math.pi / 360, 360, math.pi, "not at angle_max 3.14159"),
        (-math.pi, -TURN / 360, 360, math.pi, "not at angle_max 3.14159"),  # turned the other way
        (-math.pi, TURN / 360, 360, 180.0, "look like degrees"),
        (-180.0, TURN / 360, 360, 180.0, "look like degrees"),
        (-180.0, 1.0, 360, 179.0, "more than one turn: the angles look like degrees"),
        (-180.0, 0.01, 360, math.nan, "look like degrees"),
        (0.0, 2 * TURN / 360, 360, math.nan, "more than one turn"),
        (0.0, 0.0, 360, 3.0, "all point one way"),
        (math.nan, 0.1, 360, 3.0, "expected finite angles"),
    ],
)
def test_angles_that_no_laser_has_are_described_by_their_numbers(start, step, beams, end, problem):
    assert problem in find_wrong_beam_angles(start, step, beams, end)


@pytest.mark.parametrize("factor", [2, 3])
def test_a_step_that_is_a_few_times_too_long_is_not_called_degrees(factor):
    assert find_wrong_beam_angles(0.0, factor * TURN / 360, 360, factor * TURN).endswith("more than one turn")


@pytest.mark.parametrize(("start", "step"), [(-28.5, 0.5), (-90.0, 1.0), (0.0, 0.5), (-135.0, 0.25)])
def test_degrees_of_any_field_of_view_are_called_so(start, step):
    beams = round(max(2 * abs(start), 57) / step) + 1
    assert "look like degrees" in find_wrong_beam_angles(start, step, beams, start + step * (beams - 1))
