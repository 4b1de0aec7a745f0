"""Systematic errors of odometry, as unknowns that a filter learns beside the pose."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray, MotionSampler

__all__ = ["EXACT_ODOMETRY", "OdometryBias"]


@final
@parameters(frozen=True, config=STRICT)
class OdometryBias:
    """By how much odometry turns too little, per metre driven and per radian turned: b, which changes slowly.

    What a motion model calls noise has no memory, so its share of the heading grows with the square root of the way; a
    wheel that is larger than the other, or a steering that is off its middle, turns the robot in proportion to it. The
    increment [dx, dy, dtheta] of the odometry is taken for [dx, dy, dtheta + b_m dx + b_rad dtheta], and each b for
    a first-order Gauss-Markov process of the path length: without observations it keeps its prior variance.

    Parameters
    ----------
    sigma_per_m : float, rad/m, >= 0
        Standard deviation of b_m. Wheels 0.5 m apart whose diameters differ by 0.12 %, or a steering that is 0.4
        degrees off its middle on a car of 2.7 m, make 0.0025 rad/m. An error of standard deviation 0 is not sought.
    sigma_per_rad : float, rad/rad, >= 0
        Standard deviation of b_rad: 2 % of the distance between the wheels, since tyres are wide.
    memory_m : float, m, > 0
        Way after which their correlation has fallen to 1/e.

    Source: A. Martinelli, R. Siegwart, Estimating the odometry error of a mobile robot during navigation, ECMR 2003
    (the augmented filter); A. Gelb, Applied Optimal Estimation, 1974, 3.8 (the Gauss-Markov process).
    """

    sigma_per_m: float = Field(default=0.0025, ge=0)
    sigma_per_rad: float = Field(default=0.02, ge=0)
    memory_m: float = Field(default=3000.0, gt=0)

    def __len__(self) -> int:
        """Return how many errors B are sought."""
        return int(self._sought.sum())

    def covariance(self) -> FloatArray:
        """Return the covariance (B, B) of the errors, of which nothing is known."""
        return np.diag(np.square(self._sigmas[self._sought]))

    def predict(self, motion: MotionSampler, known: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Move N poses together with their errors.

        Parameters
        ----------
        motion : MotionSampler
            The motion model, conditioned on the odometry.
        known : (N, 3 + B) float64
            Poses [x m, y m, theta rad], and the estimated errors of the odometry.

        Returns
        -------
        moved : (N, 3 + B) float64
            The same after the motion.
        F : (N, 3 + B, 3 + B) float64
            Their derivatives by `known`.
        Q : (N, 3 + B, 3 + B) float64
            Covariances of the noise.
        """
        count, size = known.shape
        told, noise = motion.moments(known[:, :3])
        F = np.repeat(np.eye(size)[None], count, axis=0)
        F[:, 0, 2], F[:, 1, 2] = known[:, 1] - told[:, 1], told[:, 0] - known[:, 0]
        if size == 3:
            return told, F, noise
        increment = between(known[0, :3], told[0])
        by_bias = increment[[0, 2]][self._sought]
        kept = math.exp(-math.hypot(*increment[:2]) / self.memory_m)
        moved, Q = np.concatenate([told, kept * known[:, 3:]], axis=1), np.zeros((count, size, size))
        moved[:, 2] = wrap(told[:, 2] + known[:, 3:] @ by_bias)
        F[:, 2, 3:] = by_bias
        F[:, 3:, 3:] *= kept
        Q[:, :3, :3], Q[:, 3:, 3:] = noise, (1 - kept**2) * self.covariance()
        return moved, F, Q

    @property
    def _sigmas(self) -> FloatArray:
        return np.array([self.sigma_per_m, self.sigma_per_rad])

    @property
    def _sought(self) -> NDArray[np.bool_]:
        return self._sigmas > 0


EXACT_ODOMETRY = OdometryBias(sigma_per_m=0, sigma_per_rad=0)
"""Odometry without systematic errors: its noise is all that is wrong with it."""
