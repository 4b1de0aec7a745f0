"""The normal equations: Jacobians against finite differences, sparse systems against dense ones."""

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.slam.pose_graph.linear import BlockSystem, MatrixBlocks, find_parts, linearize, require_connected
from support.random_graphs import random_graph


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
