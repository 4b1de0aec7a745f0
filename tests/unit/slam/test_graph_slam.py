"""GraphSLAM by least squares: minima, where the search begins, and what comes back."""

import checks
import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between, compose
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.linear import initial_guess
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from support.random_graphs import random_graph


@pytest.mark.parametrize("seed", range(10))
def test_no_direction_lowers_chi2(seed):
    rng = np.random.default_rng(seed)
    solution = GraphSlam(tolerance=1e-12).solve(random_graph(rng).graph)
    assert solution.converged
    checks.is_a_minimum(solution.graph, solution.poses, rng)


@pytest.mark.parametrize("seed", range(5))
def test_without_noise_the_truth_is_found_exactly(seed):
    known = random_graph(np.random.default_rng(seed), noise=0.0)
    lost = np.concatenate((known.truth[:1], np.full((len(known.truth) - 1, 3), 1e3)))
    found = initial_guess(known.graph.with_poses(lost))
    np.testing.assert_allclose(between(known.truth, found), 0, atol=1e-9)
    assert (found[0] == known.truth[0]).all()
    solution = GraphSlam().solve(known.graph)
    assert solution.converged
    assert solution.chi2_after < 1e-18
    np.testing.assert_allclose(between(known.truth, solution.poses), 0, atol=1e-9)


def test_chi2_has_as_many_degrees_of_freedom_as_measurements_exceed_unknowns():
    """Sum over 100 graphs of chi2 with f = 36 each: variance 2 f, so four deviations of the sum are 339.

    The errors are curved by up to the heading's noise, 1 to 3 percent: 100 more.
    """
    solutions = [GraphSlam().solve(random_graph(np.random.default_rng(s), 20, 12).graph) for s in range(100)]
    freedom = 100 * 3 * (31 - 19)
    assert abs(sum(s.chi2_after for s in solutions) - freedom) < 4 * np.sqrt(2 * freedom) + 100
    assert all((s.weights == 1).all() for s in solutions)


def test_the_answer_moves_with_pose_0():
    graph = random_graph(np.random.default_rng(4)).graph
    moved = GraphSlam().solve(graph.with_poses(compose([3.0, -2.0, 2.5], graph.poses)))
    expected = compose([3.0, -2.0, 2.5], GraphSlam().solve(graph).poses)
    np.testing.assert_allclose(between(expected, moved.poses), 0, atol=1e-6)


def test_solved_again_costs_one_iteration_and_grown_few():
    graph = random_graph(np.random.default_rng(5), poses=200, closures=60).graph
    warm = GraphSlam(first_guess="given")
    shorter = len(graph.edges) - 1
    old = PoseGraph(
        graph.poses, *(a[:shorter] for a in (graph.edges, graph.measurements, graph.information)), graph.trusted
    )
    solved = GraphSlam().solve(PoseGraph.of(old.poses, old.edges, old.measurements, old.information))
    assert warm.solve(solved.graph).iterations == 1
    assert warm.solve(graph.with_poses(solved.poses)).iterations <= 3


def test_poses_apart_are_named_and_one_pose_is_solved():
    with pytest.raises(ArgumentError, match=r"2 parts: 1 poses cannot be reached from pose 0 \(2\)"):
        GraphSlam().solve(PoseGraph.of(np.zeros((3, 3)), [[0, 1]], np.zeros((1, 3)), [np.eye(3)]))
    alone = PoseGraph.of([[1.0, 2.0, 3.0]], np.empty((0, 2)), np.empty((0, 3)), np.empty((0, 3, 3)))
    assert GraphSlam().solve(alone).poses.tolist() == [[1.0, 2.0, 3.0]]
