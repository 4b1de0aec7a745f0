"""Marginal covariances: against dense inversion, closed forms and the errors made."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, between_jacobians
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.linear import BlockSystem, linearize
from gridslam.slam.pose_graph.marginals import Marginals, marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from support.random_graphs import random_graph


def dense_covariance(graph):
    """Joint covariance (N, N, 3, 3) of all poses, by inverting the information matrix of all but pose 0."""
    n = len(graph.poses)
    system = BlockSystem(graph.edges, n, 3)
    system.factorize(system.assemble(linearize(graph, graph.poses, graph.errors()))[0])
    upper = system._matrix.toarray()
    joint = np.zeros((n, 3, n, 3))
    joint[1:, :, 1:] = np.linalg.inv(np.triu(upper) + np.triu(upper, 1).T).reshape(n - 1, 3, n - 1, 3)
    return joint.transpose(0, 2, 1, 3)


@pytest.mark.parametrize(("poses", "closures"), [(2, 0), (3, 1), (40, 5), (120, 150)])
def test_they_are_the_blocks_of_the_dense_inverse(poses, closures):
    """To rounding: information spans 1 to 1e7, so either inverse keeps nine digits or so."""
    for seed in range(3):
        graph = random_graph(np.random.default_rng(seed), poses, closures).graph
        joint = dense_covariance(graph)
        scale = np.abs(joint).max()
        own = joint[np.arange(poses), np.arange(poses)]
        np.testing.assert_allclose(marginal_covariances(graph), own, rtol=0, atol=1e-7 * scale)
        with_last = Marginals(graph).covariances_with(poses - 1)
        np.testing.assert_allclose(with_last, joint[:, poses - 1], rtol=0, atol=1e-7 * scale)


def test_relative_covariances_are_those_of_the_joint_distribution():
    graph = random_graph(np.random.default_rng(1), 40, 10).graph
    joint, marginals = dense_covariance(graph), Marginals(graph)
    for few in (np.array([3, 0, 39]), np.arange(40)):  # by columns, and by the selected inverse
        found = marginals.relative_covariances(7, few)
        for place, other in enumerate(few.tolist()):
            j = np.concatenate(between_jacobians(graph.poses[7], graph.poses[other]), axis=1)
            both = np.block([[joint[7, 7], joint[7, other]], [joint[other, 7], joint[other, other]]])
            np.testing.assert_allclose(found[place], j @ both @ j.T, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(marginals.relative_covariances(7, 7), 0, atol=1e-12)
    np.testing.assert_allclose(
        marginals.relative_covariances(7, 3), marginals.relative_covariances(7, [3])[0], atol=1e-12
    )


def test_a_straight_chain_in_closed_form():
    """After n steps of length d: x by the steps alone, y by the headings before as well, sum of ((n - i) d)^2."""
    n, d, sx, sy, st = 20, 0.5, 0.1, 0.2, 0.03
    poses = np.column_stack((d * np.arange(n + 1), np.zeros((n + 1, 2))))
    edges = np.column_stack((np.arange(n), np.arange(1, n + 1)))
    information = np.tile(np.diag([sx**-2, sy**-2, st**-2]), (n, 1, 1))
    graph = PoseGraph.of(poses, edges, np.tile([d, 0.0, 0.0], (n, 1)), information)
    ahead = d * np.arange(n)[::-1]
    expected = np.diag([n * sx**2, n * sy**2 + st**2 * (ahead**2).sum(), n * st**2])
    expected[1, 2] = expected[2, 1] = st**2 * ahead.sum()
    np.testing.assert_allclose(marginal_covariances(graph)[-1], expected, rtol=1e-9, atol=1e-12)


def test_errors_are_as_great_as_they_say():
    """Over 100 graphs e' C^-1 e of the last pose has mean 3 and variance 6: four deviations of the mean are 0.98."""
    squares, relative = [], []
    for seed in range(100):
        known = random_graph(np.random.default_rng(seed), 30, 10, noise=0.3)
        solved = GraphSlam().solve(known.graph).graph
        marginals = Marginals(solved)
        error = solved.poses[-1] - known.truth[-1]
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        squares.append(error @ np.linalg.solve(marginals.covariances[-1], error))
        seen = between(solved.poses[10], solved.poses[20]) - between(known.truth[10], known.truth[20])
        seen[2] = (seen[2] + np.pi) % (2 * np.pi) - np.pi
        relative.append(seen @ np.linalg.solve(marginals.relative_covariances(10, 20), seen))
    assert abs(np.mean(squares) - 3) < 0.98
    assert abs(np.mean(relative) - 3) < 0.98


def test_innovations_are_what_chi2_grows_by():
    """A measurement near what is predicted is followed at the cost told, to the curvature of the errors."""
    rng = np.random.default_rng(0)
    solved = GraphSlam(tolerance=1e-12).solve(random_graph(rng, 40, 10).graph).graph
    edges = np.array([[3, 17], [30, 5], [0, 39]])
    z = between(solved.poses[edges[:, 0]], solved.poses[edges[:, 1]]) + rng.normal(0, 0.01, (3, 3))
    information = np.tile(np.diag([1e4, 4e4, 9e4]), (3, 1, 1))
    told = Marginals(solved).squared_innovations(edges, z, information)
    for k in range(3):
        parts = (solved.edges, edges[k : k + 1]), (solved.measurements, z[k : k + 1])
        more = PoseGraph.of(
            solved.poses, *map(np.concatenate, parts), np.concatenate((solved.information, information[k : k + 1]))
        )
        grown = GraphSlam(first_guess="given", tolerance=1e-12).solve(more).chi2_after - solved.chi2()
        assert told[k] == pytest.approx(grown, rel=0.02)
