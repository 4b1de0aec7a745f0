"""How uncertain tracked motion is."""

from __future__ import annotations

from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.types import FloatArray

__all__ = ["DriftModel", "compute_moments", "propagate_covariances"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class DriftModel:
    """Uncertainty of a tracked increment: a random walk, plus extra variance where the tracker rejected its scan match.

    Parameters
    ----------
    standstill_sigma_m, standstill_sigma_rad : float
        Standard deviation of an increment without motion.
    sigma_m_per_sqrt_m, sigma_rad_per_sqrt_rad : float
        Standard deviation of the position after a metre, of the heading after a radian.
    sigma_m_per_sqrt_rad, sigma_rad_per_sqrt_m : float
        Standard deviation of the position after a radian, of the heading after a metre.
    rejected_match_sigmas : float
        Multiple of the odometry's standard deviations that is added where the tracker rejected its match and used the
        odometry, which may suffer from slip or latency.
    """

    standstill_sigma_m: float = Field(default=0.002, gt=0)
    standstill_sigma_rad: float = Field(default=0.0005, gt=0)
    sigma_m_per_sqrt_m: float = Field(default=0.025, ge=0)
    sigma_rad_per_sqrt_rad: float = Field(default=0.004, ge=0)
    sigma_m_per_sqrt_rad: float = Field(default=0.02, ge=0)
    sigma_rad_per_sqrt_m: float = Field(default=0.002, ge=0)

    rejected_match_sigmas: float = Field(default=1.5, ge=0)

    def variances(self, moved_m: float, turned_rad: float) -> tuple[float, float]:
        """Variances (m^2, rad^2) of an increment."""
        return (
            self.standstill_sigma_m**2
            + self.sigma_m_per_sqrt_m**2 * moved_m
            + self.sigma_m_per_sqrt_rad**2 * turned_rad,
            self.standstill_sigma_rad**2
            + self.sigma_rad_per_sqrt_rad**2 * turned_rad
            + self.sigma_rad_per_sqrt_m**2 * moved_m,
        )


def compute_moments(poses: FloatArray, variances: FloatArray) -> FloatArray:
    """Variances of position and heading (K, 2) of steps to poses (K, 3), and the heading's with where it happened.

    Their sums along a path (7,) are what `propagate_covariances` needs to know of it.
    """
    position, heading = variances.T
    x, y, _ = poses.T
    return np.stack(
        [position, heading, heading * x, heading * y, heading * x * x, heading * x * y, heading * y * y], axis=1
    )


def propagate_covariances(poses: FloatArray, moments: FloatArray) -> FloatArray:
    """Covariances (K, 3, 3) of poses (3,) or (K, 3) at the ends of paths whose moments sum to (K, 7).

    A heading error of variance q at p_j moves a later pose p across the line between them: (p - p_j)^2 q. Summed over
    the path this needs only the moments of q about the origin.
    """
    p, q, qx, qy, qxx, qxy, qyy = moments.T
    x, y, _ = poses.T
    xx = p + q * y * y - 2 * qy * y + qyy
    yy = p + q * x * x - 2 * qx * x + qxx
    xy = qx * y + qy * x - q * x * y - qxy
    xt = qy - q * y
    yt = q * x - qx
    return np.stack([xx, xy, xt, xy, yy, yt, xt, yt, q], axis=1).reshape(-1, 3, 3)
