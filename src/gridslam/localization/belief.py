"""Pose estimate from particles: mean and covariance of the densest cluster and its probability mass."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.types import FloatArray, IntArray

__all__ = [
    "CLUSTER_RADIUS_M",
    "CLUSTER_RADIUS_RAD",
    "PoseEstimate",
    "cluster_bins",
    "estimate_pose",
    "is_in_cluster",
    "propagate_covariance",
]

CLUSTER_RADIUS_M, CLUSTER_RADIUS_RAD = 1.0, 0.5
"""Poses within this distance of the estimate belong to its cluster."""

_FEW = 10.0  # effective particles, below which their spread is that of chance
_SHIFTS = 3  # towards the mean of what is near; the first centre is off by less than half a bin


class PoseEstimate(NamedTuple):
    """Pose estimate from the particles.

    Attributes
    ----------
    pose : (3,) float64
        Mean of the densest cluster.
    covariance : (3, 3) float64
        About the pose: of the cluster where most particles are in it, of all particles otherwise.
    mass : float, [0, 1]
        Weight of the cluster: the belief's probability that the robot is within 1 m and 0.5 rad of the pose.
    """

    pose: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3]
    mass: float


def estimate_pose(poses: FloatArray, weights: FloatArray) -> PoseEstimate:
    """Find the densest cluster of poses (N, 3) with weights (N,) that sum to 1: mean shift from the heaviest bin."""
    x, y, theta = poses.T.copy()
    names = cluster_bins(x, y, theta)
    near = names == np.bincount(names, weights).argmax()
    centre = poses[np.flatnonzero(near)[weights[near].argmax()]]
    for _ in range(_SHIFTS):
        away = _relative_coordinates(x, y, theta, centre)
        shares = np.where(near, weights, 0.0)
        centre = centre + away @ shares / shares.sum()
        centre[2] = wrap(float(centre[2]))
        away = _relative_coordinates(x, y, theta, centre)
        near = _is_in_cluster(away)
    mass = float(weights[near].sum())
    covariance = _second_moment(away[:, near], weights[near]) if mass > 0.5 else _second_moment(away, weights)
    return PoseEstimate(centre, covariance, min(mass, 1.0))


def cluster_bins(x: FloatArray, y: FloatArray, theta: FloatArray) -> IntArray:
    """Number (N,) of the bin that each pose is in; bins are as wide as a cluster."""
    column, row, turn = (
        np.floor((values - values.min()) * (0.5 / width)).astype(np.int64)
        for values, width in ((x, CLUSTER_RADIUS_M), (y, CLUSTER_RADIUS_M), (theta, CLUSTER_RADIUS_RAD))
    )
    return np.asarray((column * (row.max() + 1) + row) * (turn.max() + 1) + turn)


def is_in_cluster(poses: FloatArray, centre: FloatArray) -> NDArray[np.bool_]:
    """Which of poses (N, 3) are as near to a centre (3,) as belongs to one cluster."""
    x, y, theta = poses.T.copy()
    return _is_in_cluster(_relative_coordinates(x, y, theta, centre))


def _is_in_cluster(away: FloatArray) -> NDArray[np.bool_]:
    """Which of coordinates (3, N), as seen from a centre, belong to its cluster."""
    return np.asarray((away[0] ** 2 + away[1] ** 2 < CLUSTER_RADIUS_M**2) & (np.abs(away[2]) < CLUSTER_RADIUS_RAD))


def _second_moment(away: FloatArray, weights: FloatArray) -> FloatArray:
    """Mean of away away' over (3, N), widened so that its inverse, which judges errors, has no bias of few particles.

    The inverse of the covariance of n samples of a Gaussian in three dimensions is n / (n - 5) times too large on
    average. Too few effective particles do not determine the spread: then all have equal weights.

    Source: K. Mardia, J. Kent and J. Bibby, Multivariate Analysis (1979), Section 3.4 (the inverse Wishart's mean).
    """
    shares = weights / weights.sum()
    effective = 1 / float(shares @ shares)
    if effective < _FEW:
        shares, effective = np.full(len(weights), 1 / len(weights)), max(float(len(weights)), _FEW)
    return np.asarray((shares * away) @ away.T * (effective / (effective - 5)))


def _relative_coordinates(x: FloatArray, y: FloatArray, theta: FloatArray, centre: FloatArray) -> FloatArray:
    """Coordinates (3, N) as seen from a centre (3,)."""
    turn = theta - centre[2]  # of two angles in [-pi, pi): at most one turn too far
    turn[turn >= math.pi] -= math.tau
    turn[turn < -math.pi] += math.tau
    return np.array([x - centre[0], y - centre[1], turn])


def propagate_covariance(covariance: FloatArray, way: FloatArray, noise: FloatArray) -> FloatArray:
    """Covariance (3, 3) after a way (2,) in the world frame whose own is `noise`: a doubtful heading bends it."""
    jacobian = np.array([[1.0, 0.0, -way[1]], [0.0, 1.0, way[0]], [0.0, 0.0, 1.0]])
    return np.asarray(jacobian @ covariance @ jacobian.T + noise)
