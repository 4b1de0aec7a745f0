"""NumPy twins of the kernels for many particles: resampled, on marked cells or not, and their densest cluster."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


def mean_shift(
    poses: FloatArray,
    weights: FloatArray,
    first: BoolArray,
    centre: FloatArray,
    radius_m: float,
    radius_rad: float,
    shifts: int,
) -> tuple[FloatArray, float, float, float, FloatArray]:
    """Move a centre to the weighted mean of the poses near it, again and again.

    Parameters
    ----------
    poses, weights : (N, 3), (N,) float64
        Headings in [-pi, pi); weights >= 0, of a sum of 1.
    first : (N,) bool
        Which poses are near at first; later those within `radius_m` and `radius_rad`.
    centre : (3,) float64
        Where to begin.
    shifts : int
        How often.

    Returns
    -------
    centre : (3,) float64
    cluster_mass, mass, mass_of_squares : float
        Sum of the weights near the centre; sums of weights and of their squares over these poses, or over all where the
        cluster has no more than half of the weight.
    moment : (3, 3) float64
        Of the same poses: sum of w a a', with a as seen from the centre, along the map's axes.
    """
    away = _seen_from(centre, poses)
    near: BoolArray = first
    for _ in range(shifts):
        shares = np.where(near, weights, 0.0)
        centre = centre + away @ shares / shares.sum()
        centre[2] = centre[2] - math.tau * ((centre[2] >= math.pi) - float(centre[2] < -math.pi))
        away = _seen_from(centre, poses)
        near = np.asarray((away[0] ** 2 + away[1] ** 2 < radius_m**2) & (np.abs(away[2]) < radius_rad))
    mass = float(weights[near].sum())
    if mass > 0.5:
        away, weights = away[:, near], weights[near]
    return centre, mass, float(weights.sum()), float(weights @ weights), (weights * away) @ away.T


def slots_of(ends: FloatArray, points: FloatArray) -> IntArray:
    """Slots (M,) in which ascending points (M,) lie; slot k of N ends before ends[k], which ascend.

    What lies beyond the last one is in slot N.
    """
    return np.asarray(ends.searchsorted(points, side="right"), np.int64)


def are_true(mask: BoolArray, corner: FloatArray, inverse_resolution: float, poses: FloatArray) -> BoolArray:
    """Whether each of poses (N, 3) stands on a cell that is marked in `mask` (H, W): (N,); none beyond it is.

    The lower left corner of the first cell is at `corner` (2,); a NaN stands nowhere.
    """
    cells = np.floor((poses[:, :2] - corner) * inverse_resolution)
    height, width = mask.shape
    inside: BoolArray = np.asarray(((cells >= 0) & (cells < [width, height])).all(axis=1))
    column, row = np.where(inside[:, None], cells, 0).astype(np.int64).T
    marked: BoolArray = inside & mask[row, column]
    return marked


def _seen_from(centre: FloatArray, poses: FloatArray) -> FloatArray:
    """Coordinates (3, N) of poses (N, 3) from a centre (3,), along the map's axes."""
    x, y, theta = poses.T
    turn = theta - centre[2]  # of two angles in [-pi, pi): at most one turn too far
    turn[turn >= math.pi] -= math.tau
    turn[turn < -math.pi] += math.tau
    return np.array([x - centre[0], y - centre[1], turn])
