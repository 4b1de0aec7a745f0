"""Covariances of motions that follow one another, to first order.

A motion is a pose (3,) seen from the one before, and its covariance (3, 3) is by its x and y in m and theta in rad.

Source: Smith, Self and Cheeseman, Estimating uncertain spatial relationships in robotics (1990).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.se2 import compose_jacobians

__all__ = ["compound_covariance", "increment_covariance"]

FloatArray = NDArray[np.float64]


def compound_covariance(
    moved: FloatArray, covariance: FloatArray, increment: FloatArray, noise: FloatArray
) -> FloatArray:
    """Covariance of a motion and an increment after it, which has a noise (3, 3) of its own."""
    by_moved, by_increment = compose_jacobians(moved, increment)
    both: FloatArray = by_moved @ covariance @ by_moved.T + by_increment @ noise @ by_increment.T
    return both


def increment_covariance(
    moved: FloatArray, covariance: FloatArray, increment: FloatArray, both: FloatArray
) -> FloatArray:
    """Undo `compound_covariance`: the noise of the increment, which need not be a valid covariance."""
    by_moved, by_increment = compose_jacobians(moved, increment)
    noise: FloatArray = by_increment.T @ (both - by_moved @ covariance @ by_moved.T) @ by_increment  # a rotation
    return 0.5 * (noise + noise.T)
