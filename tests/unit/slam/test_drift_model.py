"""How uncertain tracked motion is: one step as many, and directions left open."""

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


def test_a_direction_left_open_leaves_the_heading_of_searches_as_uncertain_as_it_is_expected():
    """Two parallel walls determine the heading less than a room, whatever it is asked for."""
    moved = (0.5, 0.0, 0.1)
    corridor = UnmatchedMotion(open_covariance=np.diag([0.1, 0.0]))
    (_, closed), (position, heading) = (DriftModel().bounds(moved, it) for it in (UnmatchedMotion(), corridor))
    assert heading == pytest.approx(DriftModel().open_heading_ratio ** 2 * closed)
    assert heading == pytest.approx(DriftModel().covariance(moved, corridor)[2, 2])
    assert position > 0.1
