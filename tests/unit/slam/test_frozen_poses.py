"""Poses of a graph that are held: they stay to the last bit, and the others are what they are given these."""

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between, compose
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.linear import initial_guess
from gridslam.slam.pose_graph.marginals import Marginals
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import CauchyEstimator, GraduatedNonConvexity

HELD = 7
SOLVERS = (
    GraphSlam(),
    GraphSlam(first_guess="given"),
    GraphSlam(first_guess="computed"),
    GraphSlam(robust=GraduatedNonConvexity()),
    GraphSlam(first_guess="given", robust=CauchyEstimator()),
)


@pytest.fixture
def graph():
    """A walk of 20 poses that comes by its first 7 again, with noise of the increments and between the walks."""
    rng = np.random.default_rng(3)
    truth = [np.array([0.3, -0.0, 0.5])]
    for _ in range(19):
        truth.append(compose(truth[-1], np.array([0.5, 0.0, 0.25])))
    truth = np.array(truth)
    edges = [(k, k + 1) for k in range(19)] + [(1, 18), (17, 2), (4, 13), (6, 11)]
    pairs = np.array(edges)
    noise = rng.normal(0, 1, (len(edges), 3)) * [0.02, 0.02, 0.01]
    measurements = compose(between(truth[pairs[:, 0]], truth[pairs[:, 1]]), noise)
    information = np.tile(np.diag([2500.0, 2500.0, 1e4]), (len(edges), 1, 1))
    off = truth + rng.normal(0, 0.03, truth.shape)
    off[0] = truth[0]  # a negative zero in it, which a sum with zero would lose
    return PoseGraph.of(off, edges, measurements, information, held=HELD)


@pytest.mark.parametrize("solver", SOLVERS, ids=repr)
def test_held_poses_stay_to_the_last_bit_and_the_others_do_not(graph, solver):
    solution = solver.solve(graph)
    assert solution.poses[:HELD].tobytes() == graph.poses[:HELD].tobytes()
    assert (np.abs(solution.poses - graph.poses)[HELD:, :2].max(axis=1) > 1e-4).all()
    assert solution.chi2_after < solution.chi2_before
    np.testing.assert_array_equal(initial_guess(graph)[:HELD], graph.poses[:HELD])


def test_held_is_what_very_certain_is(graph):
    """Poses that are held are those of a graph in which they are known to a micrometre from the first one."""
    sure = [(0, k) for k in range(1, HELD)]
    at = graph.poses
    certain = PoseGraph.of(
        at,
        np.concatenate([graph.edges, sure]),
        np.concatenate([graph.measurements, between(at[0], at[1:HELD])]),
        np.concatenate([graph.information, np.tile(1e12 * np.eye(3), (len(sure), 1, 1))]),
    )
    held = GraphSlam().solve(graph)
    free = GraphSlam(tolerance=1e-12).solve(certain)
    np.testing.assert_allclose(held.poses, free.poses, atol=1e-6)
    np.testing.assert_allclose(
        Marginals(held.graph).covariances[HELD:], Marginals(free.graph).covariances[HELD:], atol=1e-8
    )
    few = np.array([HELD, 12, 19])
    np.testing.assert_allclose(
        Marginals(held.graph).relative_covariances(2, few),
        Marginals(free.graph).relative_covariances(2, few),
        atol=1e-8,
    )


def test_one_pose_between_two_that_are_held_is_their_weighted_mean():
    poses = np.array([[0.0, 0, 0], [2.0, 0, 0], [0.9, 0.4, 0.1]])
    precise = np.diag([300.0, 300.0, 1e6])
    graph = PoseGraph.of(
        poses, [(0, 2), (1, 2)], [[1.0, 0, 0], [-0.8, 0, 0]], [precise, np.diag([100.0, 100.0, 1e6])], held=2
    )
    solution = GraphSlam().solve(graph)
    np.testing.assert_allclose(solution.poses[2], [(300 * 1.0 + 100 * 1.2) / 400, 0, 0], atol=1e-9)
    marginals = Marginals(solution.graph)
    np.testing.assert_allclose(marginals.covariances[2], np.diag([1 / 400, 1 / 400, 1 / 2e6]), atol=1e-6)
    assert not marginals.covariances[:2].any()


@pytest.mark.parametrize("held", [0, 21])
def test_at_least_one_pose_is_held_and_no_more_than_there_are(graph, held):
    with pytest.raises(ArgumentError, match="held: expected 1 to 20 poses"):
        PoseGraph.of(graph.poses, graph.edges, graph.measurements, graph.information, held=held)
