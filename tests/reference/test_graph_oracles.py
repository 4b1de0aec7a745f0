"""GraphSLAM against g2o and GTSAM on random graphs, with and without false closures."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity, scale_information
from support.random_graphs import random_graph

SEEDS = range(8)


def by_g2o(g2o, graph, iterations=100):
    """Poses (N, 3) and their chi2 by g2o's Gauss-Newton over Eigen.

    g2o evaluates the errors at the start of an iteration, so after the last update its chi2 is still that of the poses
    before: they are evaluated once more. Undamped steps around false closures may need some 40 iterations.
    """
    optimizer = g2o.SparseOptimizer()
    solver = g2o.BlockSolverSE2(g2o.LinearSolverEigenSE2())
    optimizer.set_algorithm(g2o.OptimizationAlgorithmGaussNewton(solver))
    for place, pose in enumerate(graph.poses):
        vertex = g2o.VertexSE2()
        vertex.set_id(place)
        vertex.set_estimate(g2o.SE2(*pose))
        vertex.set_fixed(place == 0)
        optimizer.add_vertex(vertex)
    for (first, second), z, information in zip(
        graph.edges.tolist(), graph.measurements, graph.information, strict=True
    ):
        edge = g2o.EdgeSE2()
        edge.set_vertex(0, optimizer.vertex(first))
        edge.set_vertex(1, optimizer.vertex(second))
        edge.set_measurement(g2o.SE2(*z))
        edge.set_information(information)
        optimizer.add_edge(edge)
    optimizer.initialize_optimization()
    optimizer.optimize(iterations)
    optimizer.compute_active_errors()
    poses = np.array([optimizer.vertex(place).estimate().to_vector() for place in range(len(graph.poses))])
    return poses, optimizer.chi2()


def to_gtsam(gtsam, graph):
    """Factors and values; pose 0 is held by a prior a million times tighter than any measurement."""
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for place, pose in enumerate(graph.poses):
        values.insert(place, gtsam.Pose2(*pose))
    for (first, second), z, information in zip(
        graph.edges.tolist(), graph.measurements, graph.information, strict=True
    ):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(gtsam.BetweenFactorPose2(first, second, gtsam.Pose2(*z), noise))
    held = gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    factors.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*graph.poses[0]), held))
    return factors, values


def from_gtsam(values):
    return np.array([[(p := values.atPose2(k)).x(), p.y(), p.theta()] for k in range(values.size())])


@pytest.mark.parametrize("seed", SEEDS)
def test_g2o_evaluates_the_same_chi2_far_from_the_minimum(seed):
    g2o = pytest.importorskip("g2opy")
    graph = random_graph(np.random.default_rng(seed), false=2).graph
    poses, chi2 = by_g2o(g2o, graph, iterations=1)
    assert graph.chi2(poses) == pytest.approx(chi2, rel=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("false", [0, 2])
def test_g2o_finds_the_same_minimum(seed, false):
    """Both begin at our first guess: with false closures plain least squares has other minima besides."""
    g2o = pytest.importorskip("g2opy")
    graph = random_graph(np.random.default_rng(seed), false=false).graph
    ours = GraphSlam(tolerance=1e-10).solve(graph)
    poses, chi2 = by_g2o(g2o, graph.with_poses(GraphSlam(max_iterations=3).solve(graph).poses))
    assert ours.chi2_after <= chi2 * (1 + 1e-9)
    assert graph.chi2(poses) == pytest.approx(chi2, rel=1e-12)
    if not false:
        assert ours.chi2_after == pytest.approx(chi2, rel=1e-9)
        np.testing.assert_allclose(between(poses, ours.poses), 0, atol=1e-5)


@pytest.mark.parametrize("seed", SEEDS)
def test_gtsam_tells_the_same_covariances(seed):
    """GTSAM's are of the moving frame: turned to the map frame by the pose's heading."""
    gtsam = pytest.importorskip("gtsam")
    graph = GraphSlam().solve(random_graph(np.random.default_rng(seed)).graph).graph
    factors, values = to_gtsam(gtsam, graph)
    theirs, ours = gtsam.Marginals(factors, values), marginal_covariances(graph)
    for place in range(1, len(graph.poses)):
        turn = np.eye(3)
        turn[:2, :2] = gtsam.Rot2(graph.poses[place, 2]).matrix()
        expected = turn @ theirs.marginalCovariance(place) @ turn.T
        np.testing.assert_allclose(ours[place], expected, rtol=0, atol=0.03 * np.abs(expected).max())


@pytest.mark.parametrize("seed", SEEDS)
def test_gtsams_graduated_non_convexity_rejects_the_same(seed):
    """Where GTSAM's finds all false closures, too, the solutions agree; else ours is the better one."""
    gtsam = pytest.importorskip("gtsam")
    known = random_graph(np.random.default_rng(seed), poses=40, closures=20, false=3)
    graph = known.graph
    factors, values = to_gtsam(gtsam, graph)
    parameters = gtsam.GncLMParams()
    parameters.setLossType(gtsam.GncLossType.TLS)
    parameters.setKnownInliers([*np.flatnonzero(graph.trusted).tolist(), len(graph.edges)])
    optimizer = gtsam.GncLMOptimizer(factors, values, parameters)
    optimizer.setInlierCostThresholdsAtProbability(0.99999)
    found, theirs = from_gtsam(optimizer.optimize()), np.asarray(optimizer.getWeights())[:-1]
    ours = GraphSlam(robust=GraduatedNonConvexity(probability=0.99999)).solve(graph)
    assert (ours.weights[known.false] == 0).all()
    if (theirs > 0.5).tolist() == (ours.weights > 0.5).tolist():
        kept = scale_information(graph, ours.weights)
        assert ours.chi2_after == pytest.approx(kept.chi2(found), rel=0.02)
    else:
        assert (ours.weights == ~known.false).all()
