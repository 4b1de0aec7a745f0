"""How uncertain tracked motion is."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from gridslam.geometry.se2 import rotate_covariances
from gridslam.geometry.single_pose import Pose
from gridslam.parameters import bounded, parameters
from gridslam.tracking.state import UnmatchedMotion
from gridslam.types import FloatArray

_STANDSTILL_SIGMA_M = 0.002
"""Standard deviation of the position of an increment without motion."""
_REJECTED_MATCH_SIGMAS = 1.5
"""Multiple of the odometry's standard deviations that is added where the tracker rejected its match and used the
odometry, which may suffer from slip or latency."""
_POSITION_RATIO = 0.4
"""Standard deviation of a position that is expected, over the one that bounds searches. On simulated drives through
seven kinds of buildings increments of half a metre are off by 5 to 8 mm in each direction, where the latter is 18."""
_FIRST_SIGMA_RAD = 0.004
"""Standard deviation of the heading that the first increment has beside, as the map of one scan is matched: its noise
and the rounding to cells turn the whole map against the first pose."""


@final
@parameters(frozen=True)
class DriftModel:
    """Uncertainty of a tracked increment: a random walk, plus extra variance where the tracker rejected its scan match.

    It bounds searches, and so its positions are generous: an unrecognized place costs more than a wider search.

    Parameters
    ----------
    standstill_sigma_rad : float
        Standard deviation of the heading of an increment without motion.
    sigma_m_per_sqrt_m, sigma_rad_per_sqrt_rad : float
        Standard deviation of the position after a metre, of the heading after a radian.
    sigma_m_per_sqrt_rad, sigma_rad_per_sqrt_m : float
        Standard deviation of the position after a radian, of the heading after a metre.
    open_heading_ratio : float
        Factor on the standard deviation of the heading where a direction is left open: two parallel walls determine it
        less than a room. On simulated drives into corridors it drifts by 8 mrad after a metre, which the report of the
        filter takes; in the graph 4 in place of 3 gave up what real logs with scans far apart had won by it.
    """

    standstill_sigma_rad: float = bounded(0.0005, ge=1e-6, le=10)
    sigma_m_per_sqrt_m: float = bounded(0.025, ge=0, le=100)
    sigma_rad_per_sqrt_rad: float = bounded(0.004, ge=0, le=10)
    sigma_m_per_sqrt_rad: float = bounded(0.02, ge=0, le=10)
    sigma_rad_per_sqrt_m: float = bounded(0.002, ge=0, le=10)

    open_heading_ratio: float = bounded(3.0, ge=1, le=1e6)

    def variances(self, moved_m: float, turned_rad: float) -> tuple[float, float]:
        """Variances (m^2, rad^2) of an increment."""
        return (
            _STANDSTILL_SIGMA_M**2 + self.sigma_m_per_sqrt_m**2 * moved_m + self.sigma_m_per_sqrt_rad**2 * turned_rad,
            self.standstill_sigma_rad**2
            + self.sigma_rad_per_sqrt_rad**2 * turned_rad
            + self.sigma_rad_per_sqrt_m**2 * moved_m,
        )

    def covariance(
        self,
        increment: Pose,
        unmatched: UnmatchedMotion | None = None,
        heading: float = 0.0,
        *,
        first: bool = False,
    ) -> FloatArray:
        """Return the expected covariance (3, 3) of an increment, in the frame in which it ends.

        `unmatched` is in a frame in which that one's heading is `heading`; `first`: it begins at the first scan.
        """
        dx, dy, turned = increment
        position, rotation = self.variances(math.hypot(dx, dy), abs(turned))
        position *= _POSITION_RATIO**2
        left_open = np.zeros((3, 3))
        if unmatched is not None:
            if unmatched.open_covariance.any():
                rotation *= self.open_heading_ratio**2
                left_open = rotate_covariances(np.pad(unmatched.open_covariance, (0, 1)), -heading)
            position += _REJECTED_MATCH_SIGMAS**2 * unmatched.position_m2
            rotation += _REJECTED_MATCH_SIGMAS**2 * unmatched.heading_rad2
        rotation += first * _FIRST_SIGMA_RAD**2
        return np.diag([position, position, rotation]) + left_open

    def bounds(self, increment: Pose, unmatched: UnmatchedMotion) -> tuple[float, float]:
        """Variances (m^2, rad^2) of an increment for searches."""
        dx, dy, turned = increment
        position, _ = self.variances(math.hypot(dx, dy), abs(turned))
        unmatched_m2 = _REJECTED_MATCH_SIGMAS**2 * unmatched.position_m2 + float(np.trace(unmatched.open_covariance))
        return position + unmatched_m2, float(self.covariance(increment, unmatched)[2, 2])


def scale_covariances(sigma: float, displacements: FloatArray) -> FloatArray:
    """Covariances (N, 3, 3) by the error of the scale, of poses displaced by (N, 2) m from the first one."""
    squares = sigma**2 * displacements[:, :, None] * displacements[:, None, :]
    return np.pad(squares, [(0, 0), (0, 1), (0, 1)])


def compute_moments(poses: FloatArray, covariances: FloatArray) -> FloatArray:
    """Moments (K, 9) of the covariances (K, 3, 3) of steps to poses (K, 3), each in the frame of its pose.

    Covariance of the position in the map frame, variance of the heading, and that one with where it happened. Their
    sums along a path are what `propagate_covariances` needs to know of it. Position and heading are uncorrelated.
    """
    in_map = rotate_covariances(covariances, poses[:, 2])
    return _make_moments(poses, in_map[:, [0, 0, 1], [0, 1, 1]], in_map[:, 2, 2])


def compute_moments_of_variances(poses: FloatArray, variances: FloatArray) -> FloatArray:
    """Moments (K, 9) as `compute_moments` has them, of variances (K, 2) of position, in all directions, and heading."""
    return _make_moments(poses, variances[:, :1] * [1.0, 0.0, 1.0], variances[:, 1])


def _make_moments(poses: FloatArray, position: FloatArray, q: FloatArray) -> FloatArray:
    x, y = poses.T[:2]
    qx, qy = q * poses.T[:2]
    return np.concatenate([position, np.array([q, qx, qy, qx * x, qx * y, qy * y]).T], axis=1)


def propagate_covariances(poses: FloatArray, moments: FloatArray) -> FloatArray:
    """Covariances (K, 3, 3) of poses (3,) or (K, 3) at the ends of paths whose moments sum to (K, 9).

    A heading error of variance q at p_j moves a later pose p across the line between them: (p - p_j)^2 q. Summed over
    the path this needs only the moments of q about the origin.
    """
    pxx, pxy, pyy, q, qx, qy, qxx, qxy, qyy = moments.T
    x, y, _ = poses.T
    xx = pxx + q * y * y - 2 * qy * y + qyy
    yy = pyy + q * x * x - 2 * qx * x + qxx
    xy = pxy + qx * y + qy * x - q * x * y - qxy
    xt = qy - q * y
    yt = q * x - qx
    return np.stack([xx, xy, xt, xy, yy, yt, xt, yt, q], axis=1).reshape(-1, 3, 3)


def position_variances(pose: FloatArray, moments: FloatArray) -> FloatArray:
    """Traces (K,), or one, of the covariances of the position that `propagate_covariances` makes at a pose (3,)."""
    xx, _, yy, q, qx, qy, qxx, _, qyy = moments.tolist() if moments.ndim == 1 else moments.T
    x, y, _ = pose.tolist()
    return np.asarray((xx + q * y * y - 2 * qy * y + qyy) + (yy + q * x * x - 2 * qx * x + qxx), np.float64)
