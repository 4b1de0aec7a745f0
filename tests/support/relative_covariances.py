"""Covariances of relative poses of a solved graph, column by column of the inverse of its information."""

from __future__ import annotations

import numpy as np

from gridslam.geometry.se2 import between, compose_jacobians, inverse
from gridslam.slam.pose_graph.linear import BlockSystem, linearize
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray


def between_jacobians(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Jacobians (..., 3, 3) of between(a, b) with respect to `a` and to `b`: as b is compose(a, between(a, b))."""
    by_b = compose_jacobians(inverse(a), b)[1]
    return -by_b @ compose_jacobians(a, between(a, b))[0], by_b


def relative_covariances(graph: PoseGraph, pairs: IntArray) -> FloatArray:
    """Covariances (K, 3, 3) of second poses seen from first ones, of pairs (K, 2), in the frame of the first."""
    free = len(graph.poses) - graph.held
    system = BlockSystem(graph.edges, len(graph.poses), 3, graph.held)
    system.factorize(system.assemble(linearize(graph, graph.poses, graph.errors()))[0])
    first, second = pairs.T
    columns = {}
    for pose in np.unique(pairs).tolist():
        units = np.eye(3 * free)[3 * (pose - graph.held) :][:3] if pose >= graph.held else np.zeros((3, 3 * free))
        columns[pose] = np.stack([system.solve(unit) for unit in units], axis=-1)
    covariance = np.array([[[columns[j][i] for j in pair] for i in pair] for pair in pairs.tolist()])
    jacobians = np.stack(between_jacobians(graph.poses[first], graph.poses[second]), axis=1)
    return np.einsum("kaij,kabjl,kbml->kim", jacobians, covariance, jacobians)


def squared_innovations(
    graph: PoseGraph, edges: IntArray, measurements: FloatArray, information: FloatArray
) -> FloatArray:
    """Squared Mahalanobis distances (K,) of measurements that are not in the graph from what it predicts."""
    predicted = between(graph.poses[edges[:, 0]], graph.poses[edges[:, 1]])
    errors = between(measurements, predicted)[:, :, None]
    _, turn = between_jacobians(measurements, predicted)
    spread = turn @ relative_covariances(graph, edges) @ turn.transpose(0, 2, 1) + np.linalg.inv(information)
    return np.asarray((errors * np.linalg.solve(spread, errors)).sum(axis=(1, 2)))
