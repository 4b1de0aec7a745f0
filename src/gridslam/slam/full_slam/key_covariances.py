"""Covariances of the key scans of a solved graph, a frozen part of it included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gridslam.slam.full_slam.full_trajectory import drift_covariances
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray


def key_covariances(graph: PoseGraph) -> FloatArray:
    """Covariances (T, 3, 3) of key scans, given that the first pose is exact, of a part that is held, too.

    What is held does not follow what is measured later, so it is as uncertain as what was measured within it leaves it.
    The others are as uncertain as they are given that part, and share its error: that of the held pose to which a
    constraint of the key scan nearest in time leads, carried along rigidly. That is the covariance of an estimate that
    considers parameters without estimating them, but for what the held poses about a place differ by among each other.

    Parameters
    ----------
    graph : PoseGraph
        Solved; its first T - 1 measurements are the increments.

    References
    ----------
    Schmidt, Application of state-space methods to navigation problems (1966).
    """
    held = graph.held
    if held == 1:
        has_loops = len(graph.edges) >= len(graph.poses)
        return marginal_covariances(graph) if has_loops else drift_covariances(graph)
    own = graph.edges.max(axis=1) < held
    of_held = key_covariances(replace(graph.select(own), poses=graph.poses[:held], held=1))
    covariances = of_held
    if held < len(graph.poses):
        nearest = _nearest_held(graph)
        free = graph.poses[held:, :2]
        x, y = (free - graph.poses[nearest, :2]).T
        carried = np.tile(np.eye(3), (len(free), 1, 1))
        carried[:, 0, 2] = -y
        carried[:, 1, 2] = x
        shared = carried @ of_held[nearest] @ carried.transpose(0, 2, 1)
        covariances = np.concatenate([of_held, marginal_covariances(graph)[held:] + shared])
    return covariances


def _nearest_held(graph: PoseGraph) -> IntArray:
    """For each pose that is not held (N - held,) the held one that a constraint joins with the nearest in time."""
    low, high = np.sort(graph.edges, axis=1).T
    is_crossing = (low < graph.held) & (high >= graph.held)
    by_constraint = is_crossing & (high - low > 1)  # and not by the increment from one drive to the next
    is_crossing = by_constraint if by_constraint.any() else is_crossing
    order = np.flatnonzero(is_crossing)[np.argsort(high[is_crossing], kind="stable")]
    free = np.arange(graph.held, len(graph.poses))
    return np.asarray(low[order[np.abs(free[:, None] - high[order]).argmin(axis=1)]])
