"""False closures are found out, true ones are kept, odometry is never doubted."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity, scale_information
from support.random_graphs import random_graph

ROBUST = GraphSlam(robust=GraduatedNonConvexity(probability=0.99999))  # of 400 true closures below none is expected out


@pytest.mark.parametrize("seed", range(20))
def test_false_closures_are_found_out(seed):
    known = random_graph(np.random.default_rng(seed), poses=60, closures=20, false=2 + seed % 5)
    solution = ROBUST.solve(known.graph)
    assert solution.weights.tolist() == (~known.false).astype(float).tolist()
    without = GraphSlam().solve(scale_information(known.graph, (~known.false).astype(float)))
    assert solution.chi2_after == pytest.approx(without.chi2_after, rel=1e-6)
    np.testing.assert_allclose(between(without.poses, solution.poses), 0, atol=1e-4)


def test_without_false_ones_it_is_least_squares():
    graph = random_graph(np.random.default_rng(0)).graph
    assert (ROBUST.solve(graph).weights == 1).all()
    np.testing.assert_allclose(ROBUST.solve(graph).poses, GraphSlam().solve(graph).poses, atol=1e-4)


def test_what_is_trusted_is_never_doubted():
    """Odometry that errs grossly bends the graph, however many closures speak against it."""
    known = random_graph(np.random.default_rng(2))
    z = known.graph.measurements.copy()
    z[5, 0] += 3.0
    graph = known.graph
    bent = PoseGraph.of(graph.poses, graph.edges, z, graph.information, graph.trusted)
    assert (ROBUST.solve(bent).weights[graph.trusted] == 1).all()


def test_the_bound_is_the_quantile_of_chi2():
    """Tables of the distribution with three degrees of freedom."""
    assert GraduatedNonConvexity(probability=0.95).bound == pytest.approx(7.815, abs=5e-4)
    assert GraduatedNonConvexity(probability=0.999).bound == pytest.approx(16.266, abs=5e-4)


def test_scaling_leaves_out_what_weighs_nothing_while_all_is_joined():
    graph = random_graph(np.random.default_rng(4)).graph
    weights = np.where(graph.trusted, 1.0, 0.0)
    assert len(scale_information(graph, weights).edges) == graph.trusted.sum()
    half = scale_information(graph, 0.5 * np.ones(len(graph.edges)))
    assert (half.information == 0.5 * graph.information).all()
    assert len(scale_information(graph, 1.0 - weights).edges) == len(graph.edges)
