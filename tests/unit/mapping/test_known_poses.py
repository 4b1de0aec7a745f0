"""Poses at scans' stamps: interpolated, never extrapolated; and scans sharpened by the motion that is known."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridslam.evaluation import interpolate
from gridslam.geometry.se2 import compose, exp, inverse, transform_points
from gridslam.mapping.known_poses import KnownPoses, NoPoseReason
from gridslam.types import LaserScan, ScanGeometry, Trajectory

S = 1_000_000_000


def way(*rows) -> Trajectory:
    """Rows of stamp in s, x, y, theta."""
    table = np.array(rows, float)
    return Trajectory(np.rint(table[:, 0] * S).astype(np.int64), table[:, 1:])


def test_poses_between_are_linear_and_turn_the_shorter_way():
    known = KnownPoses(way((10, 0, 0, 3.0), (11, 2, -1, -3.0)))
    np.testing.assert_allclose(known.at(10 * S + S // 4), [0.5, -0.25, 3.0 + (2 * np.pi - 6) / 4])
    np.testing.assert_allclose(known.at(10 * S + 3 * S // 4), [1.5, -0.75, -3.0 - (2 * np.pi - 6) / 4])


@given(st.lists(st.integers(0, 3 * S), min_size=2, max_size=9, unique=True), st.integers(0, 2**32 - 1))
def test_they_are_those_that_evaluation_takes(stamps, seed):
    rng = np.random.default_rng(seed)
    trajectory = Trajectory(np.array(stamps, np.int64), rng.uniform(-3, 3, (len(stamps), 3)))
    asked = rng.integers(min(stamps), max(stamps) + 1, 5)
    known = KnownPoses(trajectory, max_gap_s=10.0)
    for stamp, expected in zip(asked.tolist(), interpolate(trajectory, asked, tolerance_ns=0)[0], strict=True):
        np.testing.assert_allclose(known.at(stamp), expected, atol=1e-12)


def test_nothing_is_extrapolated():
    known = KnownPoses(way((10, 0, 0, 0), (10.5, 1, 0, 0)))
    assert known.at(9 * S) is NoPoseReason.OUTSIDE
    assert known.at(10 * S - 1_000_001) is NoPoseReason.OUTSIDE
    assert known.at(round(10.5 * S) + 1_000_001) is NoPoseReason.OUTSIDE
    assert known.span_ns == (10 * S, round(10.5 * S))


def test_gaps_are_not_bridged():
    trajectory = way((0, 0, 0, 0), (1, 1, 0, 0), (3, 5, 0, 0))
    assert KnownPoses(trajectory).at(2 * S) is NoPoseReason.GAP
    np.testing.assert_allclose(KnownPoses(trajectory).at(S + 500_000), [1.001, 0, 0])  # 0.5 ms past a pose
    np.testing.assert_allclose(KnownPoses(trajectory, max_gap_s=2.0).at(2 * S), [3, 0, 0])


def test_a_scan_in_motion_is_sharpened():
    """A robot on an arc sees one wall point by each beam at the beam's own time: at the stamp they lie where they are.

    Between poses 2 ms apart the arc is a line but for r (omega dt)^2 / 8 < 1e-6 m.
    """
    twist, seconds = np.array([0.8, 0.0, 1.5]), np.linspace(-0.2, 0.4, 301)
    poses = compose(np.array([1.0, 2.0, 0.3]), exp(seconds[:, None] * twist))
    known = KnownPoses(Trajectory(np.rint(S + seconds * S).astype(np.int64), poses))
    times = np.linspace(0.0, 0.1, 30)
    walls = np.stack([np.linspace(3, 6, 30), np.linspace(-1, 4, 30)], axis=1)
    at = compose(np.array([1.0, 2.0, 0.3]), exp(times[:, None] * twist))
    seen = np.stack([transform_points(inverse(pose), wall) for pose, wall in zip(at, walls, strict=True)])
    geometry = ScanGeometry(np.arctan2(seen[:, 1], seen[:, 0]))
    scan = LaserScan.from_ranges(S, np.hypot(*seen.T), geometry, beam_times_s=times)
    sharp = known.deskew(scan.beams(0.05, 30.0))
    np.testing.assert_allclose(transform_points(known.at(S), sharp.ends), walls, atol=1e-5)
    assert np.abs(transform_points(known.at(S), scan.beams(0.05, 30.0).ends) - walls).max() > 0.1
