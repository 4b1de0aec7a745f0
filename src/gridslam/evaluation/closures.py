"""Closures against the truth: is the place that was recognized the place where the robot was?"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.types import FloatArray

__all__ = ["FALSE_CLOSURE_M", "FALSE_CLOSURE_RAD", "closure_errors", "false_closures"]

FALSE_CLOSURE_M = 0.5
"""Farther than this from the truth a closure is false: it is ten cells, which no matcher errs by where it is right."""

FALSE_CLOSURE_RAD = math.radians(5.0)
"""Turned more than this from the truth a closure is false."""


def closure_errors(truth: ArrayLike, edges: ArrayLike, measurements: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """How far measured relative poses of pairs of scans are from the true ones.

    Parameters
    ----------
    truth : (N, 3) array_like
        True poses [m, m, rad] of the scans, in any one frame.
    edges : (M, 2) array_like of int
        For each closure its two scans, as places in `truth`: from, to.
    measurements : (M, 3) array_like
        The pose `to` seen from the pose `from`, as in a `PoseGraph`.

    Returns
    -------
    metres : (M,) float64, m
        Distance of the measured place of `to` from the true one.
    radians : (M,) float64, rad, [0, pi]
        Difference of the heading.

    Raises
    ------
    ArgumentError
        For wrong shapes, or a scan that is not in `truth`.
    """
    poses, pairs = np.asarray(truth, np.float64), np.asarray(edges, np.int64).reshape(-1, 2)
    measured = np.asarray(measurements, np.float64).reshape(-1, 3)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(pairs) != len(measured):
        got = poses.shape, pairs.shape, measured.shape
        raise ArgumentError("closures", "truth (N, 3), edges (M, 2), measurements (M, 3)", got)
    if len(pairs) and (pairs.min() < 0 or pairs.max() >= len(poses)):
        raise ArgumentError("edges", f"places in [0, {len(poses)})", [int(pairs.min()), int(pairs.max())])
    away = measured - between(poses[pairs[:, 0]], poses[pairs[:, 1]])
    return np.hypot(away[:, 0], away[:, 1]), np.abs(wrap(away[:, 2]))


def false_closures(
    truth: ArrayLike,
    edges: ArrayLike,
    measurements: ArrayLike,
    *,
    tolerance_m: float = FALSE_CLOSURE_M,
    tolerance_rad: float = FALSE_CLOSURE_RAD,
) -> NDArray[np.bool_]:
    """Which closures (M,) are false: farther from the truth than `tolerance_m`, or turned more than `tolerance_rad`.

    Arguments and errors are those of `closure_errors`.
    """
    metres, radians = closure_errors(truth, edges, measurements)
    false: NDArray[np.bool_] = (metres > tolerance_m) | (radians > tolerance_rad)
    return false
