"""How uncertain a way between two key scans is: the variances along it, and the covariance at its end."""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from gridslam.types import FloatArray

__all__ = ["Moments", "SubmapDistance", "compute_moments", "propagate_covariances"]

Moments = tuple[float, ...]
"""Sums of the result of `compute_moments` along a path."""


@final
class SubmapDistance(NamedTuple):
    """A submap with the relative pose of a key scan along the least uncertain path."""

    submap: int
    pose: FloatArray  # (3,)
    covariance: FloatArray  # (3, 3), map frame

    @property
    def sigma_m(self) -> float:
        """Greatest standard deviation of the position."""
        (xx, xy, _), (_, yy, _), _ = self.covariance.tolist()
        return math.sqrt(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy))


def compute_moments(poses: FloatArray, spread: FloatArray) -> FloatArray:
    """Variances of position and heading of steps, and the heading's with where it happened, (K, 7)."""
    position, heading = spread.T
    x, y = poses[:, 0], poses[:, 1]
    return np.stack(
        [position, heading, heading * x, heading * y, heading * x * x, heading * x * y, heading * y * y], axis=1
    )


def propagate_covariances(pose: FloatArray, moments: FloatArray) -> FloatArray:
    """Covariances (K, 3, 3) of a pose (3,): a heading error in q moves it across, by the distance from q."""
    position, s, sx, sy, sxx, sxy, syy = moments.T
    x, y, _ = pose.tolist()
    xx = s * y * y - 2 * sy * y + syy + position
    yy = s * x * x - 2 * sx * x + sxx + position
    xy = -(s * x * y - sx * y - sy * x + sxy)
    xt, yt = -(s * y - sy), s * x - sx
    return np.stack([xx, xy, xt, xy, yy, yt, xt, yt, s], axis=1).reshape(-1, 3, 3)
