"""The transform buffer: known chains, what it refuses to tell and in which words, and what it notices."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError, GridslamError
from gridslam.geometry import rigid
from gridslam.transforms import Coverage, MissingTransform, TransformBuffer
from support import se3

S = 1_000_000_000
UPSIDE_DOWN = se3.from_quaternion([0.1, 0.02, 0.3], [1, 0, 0, 0])


def pose(x=0.0, y=0.0, theta=0.0):
    return se3.from_planar([x, y, theta])


def add(buffer, parent, child, stamp_ns, parent_from_child, static=False):
    motion = rigid.from_matrix(parent_from_child)
    buffer.add_quaternion(parent, child, stamp_ns, motion[:3], motion[3:], static)


def robot(keep_s=10.0):
    """A robot that drives 1 m/s and turns 0.1 rad/s, with a laser upside down; odometry at 0, 1, .. 5 s."""
    buffer = TransformBuffer(keep_s)
    for second in range(6):
        add(buffer, "odom", "base_footprint", second * S, pose(second, 0, 0.1 * second))
    add(buffer, "base_footprint", "base_link", 0, se3.from_quaternion([0, 0, 0.05], [0, 0, 0, 1]), static=True)
    add(buffer, "base_link", "laser", 0, UPSIDE_DOWN, static=True)
    return buffer


def missing(buffer, *question):
    with pytest.raises(MissingTransform) as caught:
        buffer.lookup(*question)
    return caught.value


def test_a_chain_of_static_and_moving_links():
    buffer = robot()
    odom_from_base = pose(2.5, 0, 0.25)
    np.testing.assert_allclose(buffer.lookup("odom", "base_footprint", 2_500_000_000), odom_from_base, atol=1e-15)
    lifted = se3.from_quaternion([0, 0, 0.05], [0, 0, 0, 1]) @ UPSIDE_DOWN
    got = buffer.lookup("odom", "laser", 2_500_000_000)
    np.testing.assert_allclose(got, odom_from_base @ lifted, atol=1e-15)
    back = buffer.lookup("laser", "odom", 2_500_000_000)
    np.testing.assert_allclose(back, np.linalg.inv(odom_from_base @ lifted), atol=1e-15)
    np.testing.assert_allclose(buffer.planar("odom", "laser", 2_500_000_000), se3.to_planar(got), atol=1e-15)


def test_nothing_is_extrapolated_and_the_link_is_named():
    buffer = robot()
    late = missing(buffer, "odom", "laser", 5 * S + 1)
    assert late.coverage is Coverage.NOT_YET
    assert "of the chain odom <- base_footprint <- base_link <- laser the link odom <- base_footprint" in str(late)
    early = missing(buffer, "/laser", "odom", -250_000_000)
    assert early.coverage is Coverage.TOO_EARLY
    assert str(early) == (
        "no transform from 'odom' to 'laser' at -0.250 s: of the chain laser <- base_link <- base_footprint <- odom "
        "the link odom <- base_footprint is known only from 0.000 s, 0.25 s after"
    )
    assert "is known only until 5.000 s, 1.5 s before" in str(missing(buffer, "odom", "laser", 6_500_000_000))
    for stamp_ns in (0, 5 * S):
        assert buffer.planar("odom", "base_link", stamp_ns)[0] == stamp_ns / S
    assert isinstance(late, GridslamError)


@given(st.permutations(range(8)))
def test_the_order_of_arrival_does_not_matter_within_the_time_kept(order):
    buffer = TransformBuffer()
    for k in order:
        add(buffer, "odom", "base", k * S, pose(k * k))
    got = [buffer.planar("odom", "base", k * S // 2)[0] for k in range(15)]
    assert got == [(k // 2) ** 2 if k % 2 == 0 else ((k // 2) ** 2 + (k // 2 + 1) ** 2) / 2 for k in range(15)]


def test_a_log_played_twice_begins_anew():
    buffer = TransformBuffer(keep_s=5.0)
    for x in (0, 100):
        for second in range(20):
            add(buffer, "odom", "base", second * S, pose(x + second))
            if second:
                assert buffer.planar("odom", "base", second * S)[0] == x + second
    assert len(buffer) == 6


def test_links_that_no_tree_can_hold_are_refused():
    buffer = robot()
    before = len(buffer)
    for parent, child, named in (
        ("odom", "/odom", "'odom' in 'odom'"),
        ("odom", "odom", "'odom' in 'odom'"),
        ("", "base_link", "'base_link' in ''"),
        ("odom", "/", "'' in 'odom'"),
    ):
        with pytest.raises(ArgumentError, match=f"child: expected two frames, each with a name, got {named}"):
            add(buffer, parent, child, 0, pose())
    assert len(buffer) == before
    assert "the frames are 'odom', 'base_footprint', 'base_link', 'laser'" in str(missing(buffer, "odom", "x", 0))


def test_a_frame_handed_to_another_parent():
    # Until 5 s the box stands in the world, from 7 s on it lies on the robot, 1 m behind it.
    buffer = TransformBuffer(keep_s=4.0)
    for second in range(20):
        add(buffer, "world", "robot", second * S, pose(second))
        if second <= 5:
            add(buffer, "world", "box", second * S, pose(6))
        if second >= 7:
            add(buffer, "robot", "box", second * S, pose(-1))
        if second == 5:
            assert buffer.planar("world", "box", 4 * S)[0] == 6
        if second in (7, 9):  # the world may speak yet
            assert missing(buffer, "world", "box", 7 * S).coverage is Coverage.NOT_YET
    assert ("robot", "/box") in buffer
    assert ("world", "box") not in buffer
    assert buffer.planar("world", "box", 18 * S)[0] == 17
    assert "the link world <- robot is known" in str(missing(buffer, "world", "box", 20 * S))


def test_no_order_of_links_and_questions_leaves_the_named_errors():
    rng = np.random.default_rng(5)
    frames = ["a", "b", "c", "d", "/a", ""]
    buffer = TransformBuffer(keep_s=1.0)
    known = 0
    for _ in range(3000):
        parent, child, target, source = rng.choice(frames, 4).tolist()
        stamp_ns = int(rng.integers(0, 20)) * S // 4
        with suppress(ArgumentError):
            add(buffer, parent, child, stamp_ns, pose(*rng.normal(size=3)), static=bool(rng.random() < 0.01))
        if rng.random() < 0.05:
            buffer = TransformBuffer(keep_s=1.0)
        try:
            matrix = buffer.lookup(target, source, stamp_ns)
        except MissingTransform as error:
            coverage = error.coverage
        else:
            coverage = Coverage.KNOWN
        if coverage is not Coverage.KNOWN:
            assert missing(buffer, source, target, stamp_ns).coverage is coverage
        else:
            known += 1
            np.testing.assert_allclose(matrix @ buffer.lookup(source, target, stamp_ns), np.eye(4), atol=1e-9)
        assert len(buffer) <= 12 * 5  # 12 links between 4 frames, 5 quarter seconds each
    assert known > 300


@pytest.mark.parametrize("keep_s", [0.0, -1.0, math.inf, math.nan])
def test_the_time_kept_is_finite(keep_s):
    with pytest.raises(ArgumentError, match="keep_s"):
        TransformBuffer(keep_s)


def test_values_that_are_no_transform_are_refused():
    buffer = TransformBuffer()
    with pytest.raises(ArgumentError, match="xyzw"):
        buffer.add_quaternion("odom", "base", 0, (0, 0, 0), (0, 0, 0, 0))
    with pytest.raises(ArgumentError, match="translation"):
        buffer.add_quaternion("odom", "base", 0, (0, math.nan, 0), (0, 0, 0, 1))
    assert len(buffer) == 0
