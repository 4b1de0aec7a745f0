"""Covariances of all poses of a run, from those of its key scans."""

from __future__ import annotations

import math

import numpy as np

from gridslam.slam.full_slam.full_trajectory import path_fractions
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

__all__ = ["drift_covariances", "scan_covariances"]


def drift_covariances(graph: PoseGraph) -> FloatArray:
    """Covariances (T, 3, 3) of poses that only increments join, one from each pose to the next.

    A heading error of variance q at p_j moves a later pose p across the line between them: (p - p_j)^2 q. Summed over
    the path this needs only the moments of q about the origin, so all poses are computed at once.

    Parameters
    ----------
    graph : PoseGraph
        The first T - 1 measurements are the increments; their information is diagonal, the same in x and in y.
    """
    x, y, _ = graph.poses.T
    position, heading = np.concatenate([np.zeros((1, 2)), _variances(graph)]).T
    moments = position, heading, heading * x, heading * y, heading * x * x, heading * x * y, heading * y * y
    p, q, qx, qy, qxx, qxy, qyy = np.cumsum(moments, axis=1)
    xx, yy = p + q * y * y - 2 * qy * y + qyy, p + q * x * x - 2 * qx * x + qxx
    xy, xt, yt = qx * y + qy * x - q * x * y - qxy, qy - q * y, q * x - qx
    return np.stack([xx, xy, xt, xy, yy, yt, xt, yt, q], axis=1).reshape(-1, 3, 3)


def scan_covariances(
    graph: PoseGraph, key_covariances: FloatArray, keys: IntArray, key_from_base: FloatArray, drift: DriftModel
) -> FloatArray:
    """Covariances (N, 3, 3) of all scans; an upper bound where they are not key scans.

    Between two key scans tracking is a Brownian bridge over the share s of the way, of variance s (1 - s) times the
    increment's; what both ends err by is interpolated, which is no less than what any correlation of them leaves.
    After the last key scan tracking drifts.

    Parameters
    ----------
    graph : PoseGraph
        The T key scans; its first T - 1 measurements are the increments.
    key_covariances : (T, 3, 3) float64
        Covariances of the key scans.
    keys, key_from_base : (N,) int64, (N, 3) float64
        As for `full_trajectory`.
    drift : DriftModel
        How uncertain tracking is.
    """
    fraction = path_fractions(keys, key_from_base)[:, None, None]
    bridge = np.zeros_like(key_covariances)
    bridge[:-1, [0, 1, 2], [0, 1, 2]] = _variances(graph)[:, [0, 0, 1]]
    nearer, farther = key_covariances[keys], key_covariances[np.minimum(keys + 1, len(key_covariances) - 1)]
    found: FloatArray = nearer + fraction * (farther - nearer) + fraction * (1 - fraction) * bridge[keys]
    last = int(np.searchsorted(keys, len(key_covariances) - 1))
    found[last:] = key_covariances[-1]
    for scan in range(last + 1, len(keys)):
        dx, dy, turn = key_from_base[scan].tolist()
        position, heading = drift.variances(math.hypot(dx, dy), abs(turn))
        found[scan] += np.diag([position, position, heading])
    return found


def _variances(graph: PoseGraph) -> FloatArray:
    """Variances (T - 1, 2) of the increments' position and heading."""
    return 1 / graph.information[: len(graph.poses) - 1][:, [0, 2], [0, 2]]
