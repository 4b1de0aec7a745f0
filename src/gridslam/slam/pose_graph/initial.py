"""A first guess of all poses from the measurements alone: chordal relaxation of the headings, then the positions."""

from __future__ import annotations

import numpy as np

from gridslam.slam.pose_graph.linear import BlockSystem, MatrixBlocks, linearize, require_connected
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray

__all__ = ["initial_guess"]

_REFINEMENTS = 5
"""Iterations for the headings: each costs one solution with the existing factorization, and few are enough."""


def initial_guess(graph: PoseGraph) -> FloatArray:
    """Poses (N, 3) near the least chi2, from the measurements and pose 0 alone.

    Headings come first, as unit vectors r: r_j = R(z) r_i is linear, so without the constraint |r| = 1 the weighted
    least squares is one linear system (chordal relaxation; Martinec and Pajdla 2007, Carlone et al. 2015). Anchored at
    pose 0 it shrinks vectors the more the farther they are, so it is solved again with the unit vectors as right side:
    inverse iteration towards the least eigenvector, all of whose vectors are of like length (Singer 2011). Then chi2 is
    quadratic in the positions: a second linear system of the same pattern.

    Raises
    ------
    ArgumentError
        The measurements do not join all poses.
    """
    require_connected(graph.edges, len(graph.poses))
    if len(graph.poses) == 1:
        return graph.poses.copy()
    system = BlockSystem(graph.edges, len(graph.poses), 2)
    poses = np.zeros_like(graph.poses)
    poses[0] = graph.poses[0]
    poses[1:, 2] = _headings(graph, system)[1:]
    first, cross, second, *gradients = linearize(graph, poses, graph.errors(poses))
    of_positions = MatrixBlocks(*(b[:, :2, :2] for b in (first, cross, second)), *(g[:, :2] for g in gradients))
    matrix, gradient = system.assemble(of_positions)
    system.factorize(matrix)
    poses[:, :2] += system.solve(-gradient)
    return poses


def _headings(graph: PoseGraph, system: BlockSystem) -> FloatArray:
    """Headings (N,) by chordal relaxation."""
    first, second = graph.edges.T
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = graph.information.transpose(1, 2, 0)
    weight = tt - (xx * yt * yt - 2 * xy * xt * yt + yy * xt * xt) / (xx * yy - xy * xy)  # 1 / variance of the heading
    c, s = weight * np.cos(graph.measurements[:, 2]), weight * np.sin(graph.measurements[:, 2])
    own = weight[:, None, None] * np.eye(2)
    cross = -np.stack((c, s, -s, c), axis=1).reshape(-1, 2, 2)  # -weight R(z)'
    unit = np.zeros((len(graph.poses), 2, 1))
    unit[0, :, 0] = np.cos(graph.poses[0, 2]), np.sin(graph.poses[0, 2])
    anchored = np.matmul(cross, unit[second]), np.matmul(cross.transpose(0, 2, 1), unit[first])
    matrix, gradient = system.assemble(MatrixBlocks(own, cross, own, anchored[0][:, :, 0], anchored[1][:, :, 0]))
    system.factorize(matrix)
    vectors = system.solve(-gradient)
    for _ in range(_REFINEMENTS):
        lengths = np.hypot(vectors[1:, 0], vectors[1:, 1])
        vectors = system.solve((vectors[1:] / np.maximum(lengths, 1e-300)[:, None]).ravel())
    return np.asarray(np.arctan2(vectors[:, 1], vectors[:, 0]))
