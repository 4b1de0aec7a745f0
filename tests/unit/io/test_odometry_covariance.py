"""Which covariances of a bag's poses tell the noise of the motion from scan to scan, and which tell nothing."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose, compound_covariance, increment_covariance
from gridslam.io.bags.bag import BagLog
from gridslam.io.log import LogOptions
from support import ros_bags
from support.ros_bags import KINDS, drive

RATE = np.array([[1e-3, 2e-4, 1e-4], [2e-4, 5e-4, 5e-5], [1e-4, 5e-5, 2e-3]])
"""Noise of a second of motion, by x, y and theta in the base frame: m^2, m rad and rad^2."""


def pose(at_s):
    """Of the drive of `ros_bags`."""
    return np.array([at_s, 0.0, 0.1 * at_s])


def grown(at_s, begin_s=0.0, step_s=0.05, start=1e-4):
    """Covariance of the pose after a time, as a robot adds it up that knows its noise; some at the start."""
    where, covariance, steps = np.zeros(3), start * np.eye(3), round((at_s - begin_s) / step_s)
    for k in range(steps):
        step = between(pose(begin_s + k * step_s), pose(begin_s + (k + 1) * step_s))
        covariance = compound_covariance(where, covariance, step, step_s * RATE)
        where = compose(where, step)
    return covariance


def covariances(folder, said, kind="ros1", **options):
    return [odometry.covariance for odometry, _ in BagLog(ros_bags.write(folder, kind, said), LogOptions(**options))]


def test_what_was_compounded_can_be_undone():
    rng = np.random.default_rng(0)
    moved, increment, root = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(3, 3))
    both = compound_covariance(moved, np.eye(3), increment, root @ root.T)
    np.testing.assert_allclose(increment_covariance(moved, np.eye(3), increment, both), root @ root.T, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_covariances_that_grow_tell_the_noise_from_scan_to_scan(tmp_path, kind):
    told = covariances(tmp_path, drive(covariance=grown), kind)
    assert len(told) == 20
    assert told[:2] == [None] * 2  # nothing moved before the first, and growth is believed from the third reading on
    for k, found in enumerate(told[2:], 2):
        exact = grown(0.06 + 0.1 * k, 0.1 * k - 0.04, 1e-3, 0.0)
        # readings are 5 cm apart: half of that times the heading's variance is not seen between them
        np.testing.assert_allclose(found, exact, rtol=0.02, atol=0.025 * 2e-4)


@pytest.mark.parametrize(
    "covariance",
    [
        lambda at_s: None,
        lambda at_s: 1e-3 * np.eye(3),
        lambda at_s: np.diag([1e-3, 1e-3, 1e3]),
        lambda at_s: np.diag([1e-9, 1e-3, 1e-9]) if at_s < 1 else np.diag([1e-3, 1e-3, 1e3]),
        lambda at_s: 1e9 * np.eye(3),
        lambda at_s: np.full((3, 3), np.nan),
        lambda at_s: np.diag([at_s, at_s, np.inf]),
        lambda at_s: 1e307 * at_s * np.eye(3),
        lambda at_s: -grown(at_s),
        lambda at_s: np.diag([at_s, at_s, 0.0]),
        lambda at_s: np.diag([1e-3 * at_s, 1e-3 * at_s, 1e-3]),
        lambda at_s: grown(2.0 - at_s),
        lambda at_s: 1e5 * grown(at_s),
        lambda at_s: np.diag([1e-3, 1e-3, 1e-3]) if round(at_s * 20) % 2 else np.diag([1e-2, 1e-2, 1e-2]),
    ],
    ids=[
        "zero",
        "constant",
        "absurd heading",
        "two constants",
        "huge",
        "nan",
        "infinite",
        "large as can be",
        "negative",
        "no heading",
        "heading that does not grow",
        "falling",
        "growing by metres",
        "alternating",
    ],
)
def test_what_tells_nothing_is_absent(tmp_path, covariance):
    assert covariances(tmp_path, drive(covariance=covariance)) == [None] * 20
