"""First guesses from the measurements alone."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between
from gridslam.slam.pose_graph.linear import initial_guess
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from support.random_graphs import random_graph


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_it_is_the_truth(seed):
    known = random_graph(np.random.default_rng(seed), noise=0.0)
    lost = np.concatenate((known.truth[:1], np.full((len(known.truth) - 1, 3), 1e3)))
    found = initial_guess(known.graph.with_poses(lost))
    np.testing.assert_allclose(between(known.truth, found), 0, atol=1e-9)
    assert (found[0] == known.truth[0]).all()


def test_one_pose_and_poses_apart():
    alone = PoseGraph.of([[1.0, 2.0, 3.0]], np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 3, 3)))
    assert initial_guess(alone).tolist() == [[1.0, 2.0, 3.0]]
    with pytest.raises(ArgumentError, match="2 parts"):
        initial_guess(PoseGraph.of(np.zeros((3, 3)), [[0, 1]], np.zeros((1, 3)), [np.eye(3)]))
