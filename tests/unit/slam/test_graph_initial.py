"""First guesses from the measurements alone."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.slam.pose_graph.graph_slam import GraphSlam
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


def test_headings_beyond_any_rounding_of_whole_turns():
    """A loop of which the headings err by more than half a turn in all, spread over it: 60 steps of 0.06 rad."""
    headings = 2 * np.pi * np.arange(60) / 60
    truth = np.column_stack((np.sin(headings), -np.cos(headings), headings))
    edges = np.column_stack((np.arange(60), np.roll(np.arange(60), -1)))
    z = between(truth[edges[:, 0]], truth[edges[:, 1]])
    z[:-1, 2] += 0.06
    graph = PoseGraph.of(np.zeros((60, 3)), edges, z, np.tile(np.eye(3), (60, 1, 1)))
    from_truth = GraphSlam(first_guess="given").solve(graph.with_poses(between(truth[0], truth)))
    computed = GraphSlam(first_guess="computed").solve(graph)
    assert computed.chi2_after <= from_truth.chi2_after * (1 + 1e-6)
