"""GraphSLAM by least squares: minima, where the search begins, and what comes back."""

import checks
import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.linear import (
    BlockSystem,
    MatrixBlocks,
    find_parts,
    initial_guess,
    linearize,
    require_connected,
)
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity, scale_information
from support.random_graphs import random_graph
from support.relative_covariances import relative_covariances, squared_innovations


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


ROBUST = GraphSlam(robust=GraduatedNonConvexity(probability=0.99999))  # of 400 true closures below none is expected out


def test_false_closures_are_found_out():
    """All of 80 are; of 400 true ones one is lost."""
    lost = 0
    for seed in range(20):
        known = random_graph(np.random.default_rng(seed), poses=60, closures=20, false=2 + seed % 5)
        solution = ROBUST.solve(known.graph)
        assert not solution.weights[known.false].any()
        assert (solution.weights[known.graph.trusted] == 1).all()
        lost += np.count_nonzero(solution.weights[~known.false] == 0)
        without = GraphSlam().solve(scale_information(known.graph, solution.weights))
        assert solution.chi2_after == pytest.approx(without.chi2_after, rel=1e-6)
        np.testing.assert_allclose(between(without.poses, solution.poses), 0, atol=1e-4)
    assert lost <= 1


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


def dense_jacobian(graph, poses, step=1e-6):
    """Derivatives (3 M, 3 N) of the errors, by central differences."""
    columns = []
    for k in range(poses.size):
        moved = np.zeros(poses.size)
        moved[k] = step
        moved = moved.reshape(poses.shape)
        difference = graph.errors(poses + moved) - graph.errors(poses - moved)
        difference[:, 2] = wrap(difference[:, 2])
        columns.append(difference.ravel() / (2 * step))
    return np.stack(columns, axis=1)


def dense(system, matrix):
    """The upper triangle that `assemble` returns, as a full symmetric matrix."""
    system.factorize(matrix)
    upper = system._matrix.toarray()
    return np.triu(upper) + np.triu(upper, 1).T


@pytest.mark.parametrize("seed", range(5))
def test_normal_equations_are_those_of_finite_differences(seed):
    rng = np.random.default_rng(seed)
    graph = random_graph(rng, poses=12, closures=15, false=3).graph
    poses = graph.poses + rng.normal(0, 0.3, graph.poses.shape)
    jacobian, errors = dense_jacobian(graph, poses)[:, 3:], graph.errors(poses)
    weighted = np.concatenate(
        [j.T @ w for j, w in zip(np.split(jacobian, len(errors)), graph.information, strict=True)], 1
    )
    system = BlockSystem(graph.edges, 12, 3)
    matrix, gradient = system.assemble(linearize(graph, poses, errors))
    scale = np.abs(weighted @ jacobian).max()
    np.testing.assert_allclose(dense(system, matrix), weighted @ jacobian, rtol=0, atol=1e-8 * scale)
    np.testing.assert_allclose(gradient, weighted @ errors.ravel(), rtol=1e-6, atol=1e-8 * scale)


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_solutions_are_those_of_dense_systems(size):
    rng = np.random.default_rng(size)
    graph = random_graph(rng, poses=10, closures=12).graph
    edges = np.concatenate((graph.edges, graph.edges[:3], graph.edges[-3:, ::-1]))  # twice, and the other way
    system = BlockSystem(edges, 10, size)
    for _ in range(2):  # the second time with the pattern's factor
        full, right = np.zeros((10 * size, 10 * size)), rng.normal(size=9 * size)
        halves = rng.normal(size=(len(edges), 2 * size, 2 * size))
        squares = halves @ halves.transpose(0, 2, 1) + np.eye(2 * size)
        for (first, second), square in zip(edges.tolist(), squares, strict=True):
            at = np.r_[first * size : (first + 1) * size, second * size : (second + 1) * size]
            full[np.ix_(at, at)] += square
        own, other = slice(0, size), slice(size, None)
        none = np.zeros((len(edges), size))
        blocks = MatrixBlocks(squares[:, own, own], squares[:, own, other], squares[:, other, other], none, none)
        system.factorize(system.assemble(blocks)[0])
        found = system.solve(right)
        np.testing.assert_allclose(found[1:].ravel(), np.linalg.solve(full[size:, size:], right), rtol=1e-9, atol=1e-12)
        assert (found[0] == 0).all()


def test_damping_adds_a_share_of_the_diagonal():
    graph = random_graph(np.random.default_rng(0), poses=6, closures=4).graph
    system = BlockSystem(graph.edges, 6, 3)
    matrix, gradient = system.assemble(linearize(graph, graph.poses, graph.errors()))
    full = dense(system, matrix)
    system.factorize(matrix, damping=0.5)
    expected = np.linalg.solve(full + 0.5 * np.diag(np.diag(full)), gradient)
    np.testing.assert_allclose(system.solve(gradient)[1:].ravel(), expected, rtol=1e-9, atol=1e-12)


def test_parts_are_counted_and_who_is_apart_is_named():
    with pytest.raises(ArgumentError, match=r"3 parts: 3 poses cannot be reached from pose 0 \(2, 3, 4\)"):
        require_connected(np.array([[0, 1], [3, 2]]), 5)
    with pytest.raises(ArgumentError, match=r"12 parts: 11 poses .* \(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ...\)"):
        require_connected(np.empty((0, 2), np.int64), 12)
    require_connected(np.array([[1, 0], [2, 1]]), 3)


@pytest.mark.parametrize("edges", [0, 20, 60, 200])
@pytest.mark.parametrize("seed", range(4))
def test_parts_are_those_that_a_walk_from_pose_to_pose_finds(seed, edges):
    """And they are numbered by their first poses."""
    joined = np.random.default_rng(seed).integers(0, 100, (edges, 2))
    walked = np.full(100, -1)
    for begin in range(100):
        part = walked.max() + 1
        waiting = [begin] if walked[begin] < 0 else []
        while waiting:
            pose = waiting.pop()
            walked[pose] = part
            waiting += [b for a, b in (*joined.tolist(), *joined[:, ::-1].tolist()) if a == pose and walked[b] < 0]
    np.testing.assert_array_equal(find_parts(joined, 100), walked)


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
        error = solved.poses[-1] - known.truth[-1]
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        squares.append(error @ np.linalg.solve(marginal_covariances(solved)[-1], error))
        seen = between(solved.poses[10], solved.poses[20]) - between(known.truth[10], known.truth[20])
        seen[2] = (seen[2] + np.pi) % (2 * np.pi) - np.pi
        relative.append(seen @ np.linalg.solve(relative_covariances(solved, np.array([[10, 20]]))[0], seen))
    assert abs(np.mean(squares) - 3) < 0.98
    assert abs(np.mean(relative) - 3) < 0.98


def test_innovations_are_what_chi2_grows_by():
    """A measurement near what is predicted is followed at the cost told, to the curvature of the errors."""
    rng = np.random.default_rng(0)
    solved = GraphSlam(tolerance=1e-12).solve(random_graph(rng, 40, 10).graph).graph
    edges = np.array([[3, 17], [30, 5], [0, 39]])
    z = between(solved.poses[edges[:, 0]], solved.poses[edges[:, 1]]) + rng.normal(0, 0.01, (3, 3))
    information = np.tile(np.diag([1e4, 4e4, 9e4]), (3, 1, 1))
    told = squared_innovations(solved, edges, z, information)
    for k in range(3):
        parts = (solved.edges, edges[k : k + 1]), (solved.measurements, z[k : k + 1])
        more = PoseGraph.of(
            solved.poses, *map(np.concatenate, parts), np.concatenate((solved.information, information[k : k + 1]))
        )
        grown = GraphSlam(first_guess="given", tolerance=1e-12).solve(more).chi2_after - solved.chi2()
        assert told[k] == pytest.approx(grown, rel=0.02)
