"""Laws of SE(3), as matrices and as seven floats.

Positions reach 1e3 m and rounding is 2^-53 of the greatest term; the longest chain here is four products of some ten
terms each, so 1e-10 m and 1e-13 in a rotation matrix or a quaternion leave a factor of ten or more.
"""

from __future__ import annotations

import math

import numpy as np
from hypothesis import assume, example, given
from hypothesis import strategies as st

from gridslam.geometry import rigid, se2
from gridslam.geometry.angles import wrap
from support import se3

METRES = 1e-10
TURN = 1e-13

metres = st.floats(-1e3, 1e3)
radians = st.floats(-math.pi, math.pi)
translations = st.tuples(metres, metres, metres)


def axis_angle(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    return np.array([*(math.sin(angle / 2) * np.array(axis) / np.linalg.norm(axis)), math.cos(angle / 2)])


component = st.floats(-1, 1)
axes = st.tuples(component, component, component).filter(lambda axis: np.linalg.norm(axis) > 1e-3)
quaternions = st.builds(axis_angle, axes, radians)
transforms = st.builds(se3.from_quaternion, translations, quaternions)
rigids = st.builds(lambda t, q: rigid.from_quaternion(t, q.tolist()), translations, quaternions)
planar_poses = st.tuples(metres, metres, radians).map(np.array)
fractions = st.floats(0, 1)


def assert_same(got: np.ndarray, want: np.ndarray) -> None:
    np.testing.assert_allclose(got[:3, 3], want[:3, 3], rtol=0, atol=METRES)
    np.testing.assert_allclose(got[:3, :3], want[:3, :3], rtol=0, atol=TURN)
    assert got[3].tolist() == [0, 0, 0, 1]


def turn_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of the rotation from a to b, from its sine and its cosine."""
    r = a[:3, :3].T @ b[:3, :3]
    sine = np.linalg.norm([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return math.atan2(sine, np.trace(r) - 1)


@given(rigids, rigids, rigids)
def test_seven_floats_are_the_group_of_the_matrices(a, b, c):
    assert_same(rigid.to_matrix(rigid.compose(a, b)), rigid.to_matrix(a) @ rigid.to_matrix(b))
    assert_same(rigid.to_matrix(rigid.inverse(a)), np.linalg.inv(rigid.to_matrix(a)))
    left, right = rigid.compose(rigid.compose(a, b), c), rigid.compose(a, rigid.compose(b, c))
    np.testing.assert_allclose(left[:3], right[:3], rtol=0, atol=METRES)
    np.testing.assert_allclose(left[3:], right[3:], rtol=0, atol=TURN)
    assert abs(math.hypot(*left[3:]) - 1) < TURN


@given(translations, quaternions)
@example((0.0, 0.0, 0.0), np.array([1.0, 0.0, 0.0, 0.0]))
@example((0.0, 0.0, 0.0), np.array([0.0, 1.0, 0.0, 0.0]))
@example((0.0, 0.0, 0.0), np.array([0.0, 0.0, 1.0, 0.0]))
@example((0.0, 0.0, 0.0), np.array([-0.5, 0.5, -0.5, 0.5]))
def test_quaternions_come_back_up_to_their_sign(translation, xyzw):
    back, quaternion = np.split(rigid.from_matrix(se3.from_quaternion(translation, xyzw)), [3])
    assert back.tolist() == list(translation)
    np.testing.assert_allclose(quaternion * np.sign(quaternion @ xyzw), xyzw, rtol=0, atol=TURN)


@given(quaternions, axes)
def test_a_quaternion_turns_a_vector_by_its_angle_about_its_axis(xyzw, vector):
    # Rodrigues: v cos + (n x v) sin + n (n.v) (1 - cos).
    angle = 2 * math.atan2(np.linalg.norm(xyzw[:3]), xyzw[3])
    assume(np.linalg.norm(xyzw[:3]) > 1e-6)
    n, v = xyzw[:3] / np.linalg.norm(xyzw[:3]), np.array(vector)
    want = v * math.cos(angle) + np.cross(n, v) * math.sin(angle) + n * (n @ v) * (1 - math.cos(angle))
    np.testing.assert_allclose(se3.from_quaternion([0, 0, 0], xyzw)[:3, :3] @ v, want, rtol=0, atol=1e-12)


def interpolate(a: np.ndarray, b: np.ndarray, fraction: float) -> np.ndarray:
    return rigid.to_matrix(rigid.interpolate(rigid.from_matrix(a), rigid.from_matrix(b), fraction))


@given(transforms, transforms)
def test_interpolation_begins_and_ends_where_it_should(a, b):
    assert_same(interpolate(a, b, 0.0), a)
    assert_same(interpolate(a, b, 1.0), b)


@given(transforms, transforms, fractions)
def test_interpolation_is_uniform_on_the_shorter_arc(a, b, fraction):
    between = interpolate(a, b, fraction)
    np.testing.assert_allclose(between[:3, :3] @ between[:3, :3].T, np.eye(3), rtol=0, atol=1e-12)
    whole = turn_between(a, b)
    # The angle of a matrix is known to 1e-13 / sin(pi - angle); within 1e-3 of half a turn either arc may be taken.
    assume(whole < math.pi - 1e-3)
    assert abs(turn_between(a, between) - fraction * whole) < 1e-9
    assert abs(turn_between(between, b) - (1 - fraction) * whole) < 1e-9
    want = a[:3, 3] + fraction * (b[:3, 3] - a[:3, 3])
    np.testing.assert_allclose(between[:3, 3], want, rtol=0, atol=METRES)


@given(rigids, rigids, fractions)
def test_the_sign_of_a_quaternion_says_nothing(a, b, fraction):
    opposite = (*b[:3], *(-value for value in b[3:]))
    # Where they are half a turn apart rounding chooses the arc.
    assume(abs(np.dot(a[3:], b[3:])) > 1e-9)
    got = rigid.to_matrix(rigid.interpolate(a, opposite, fraction))
    assert_same(got, rigid.to_matrix(rigid.interpolate(a, b, fraction)))


@given(planar_poses, planar_poses)
def test_the_plane_is_a_subgroup(a, b):
    assert se3.to_planar(se3.from_planar(a))[:2].tolist() == a[:2].tolist()
    product = se3.to_planar(se3.from_planar(a) @ se3.from_planar(b))
    want = se2.compose(a, b)
    np.testing.assert_allclose(product[:2], want[:2], rtol=0, atol=METRES)
    assert abs(wrap(product[2] - want[2])) < TURN * 10
    assert -math.pi <= product[2] < math.pi
    assert se3.tilt_rad(se3.from_planar(a)) == 0


@given(planar_poses, st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_pitch_and_roll_leave_yaw_alone(pose, pitch, roll):
    # Yaw, then pitch, then roll: the x axis stays above the ray of the yaw for a pitch short of a right angle.
    turned = (
        se3.from_planar(pose)
        @ se3.from_quaternion([0, 0, 0], axis_angle((0, 1, 0), pitch))
        @ se3.from_quaternion([0, 0, 0], axis_angle((1, 0, 0), roll))
    )
    seen = se3.to_planar(turned)
    np.testing.assert_allclose(seen[:2], pose[:2], rtol=0, atol=METRES)
    assert abs(wrap(seen[2] - pose[2])) < 1e-11  # rounding of 1e-16 over the shortest projection, cos(1.5) = 0.07
    # The z axis' upward part is cos(pitch) cos(roll).
    assert abs(math.cos(se3.tilt_rad(turned)) - math.cos(pitch) * math.cos(roll)) < 1e-12
