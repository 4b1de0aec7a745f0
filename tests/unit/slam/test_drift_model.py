"""How uncertain tracked motion is: one step as many, and directions left open."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.slam.loop_closure.drift_model import DriftModel, compute_moments, compute_step_moments
from gridslam.tracking.state import UnmatchedMotion


@pytest.mark.parametrize("seed", range(5))
def test_moments_of_one_step_are_those_of_many(seed):
    rng = np.random.default_rng(seed)
    pose = tuple(rng.uniform(-3, 3, 3).tolist())
    root = rng.normal(size=(2, 2))
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = root @ root.T
    covariance[2, 2] = rng.uniform(0.1, 1)
    many = compute_moments(np.array([pose]), covariance[None])[0]
    np.testing.assert_allclose(compute_step_moments(pose, covariance), many, rtol=0, atol=1e-14 * np.abs(many).max())


@pytest.mark.parametrize("heading", [-2.0, 0.7])
def test_what_a_match_left_open_is_turned_into_the_frame_of_the_increment(heading):
    along = np.array([0.6, 0.8])
    unmatched = UnmatchedMotion(open_covariance=0.3 * np.outer(along, along))
    closed = DriftModel().covariance((0.5, 0.0, 0.1))
    left_open = DriftModel().covariance((0.5, 0.0, 0.1), unmatched, heading)[:2, :2] - closed[:2, :2]
    turned = np.array([[math.cos(heading), math.sin(heading)], [-math.sin(heading), math.cos(heading)]]) @ along
    np.testing.assert_allclose(left_open, 0.3 * np.outer(turned, turned), atol=1e-15)


def test_a_direction_left_open_leaves_the_heading_of_searches_as_uncertain_as_it_is_expected():
    """Two parallel walls determine the heading less than a room, whatever it is asked for."""
    moved = (0.5, 0.0, 0.1)
    corridor = UnmatchedMotion(open_covariance=np.diag([0.1, 0.0]))
    (_, closed), (position, heading) = (DriftModel().bounds(moved, it) for it in (UnmatchedMotion(), corridor))
    assert heading == pytest.approx(DriftModel().open_heading_ratio ** 2 * closed)
    assert heading == pytest.approx(DriftModel().covariance(moved, corridor)[2, 2])
    assert position > 0.1
