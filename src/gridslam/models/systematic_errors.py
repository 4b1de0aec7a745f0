"""Systematic errors of odometry and of a landmark sensor, as states of a filter or unknowns of a graph."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose, lever_arm_jacobian
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, MotionSampler


@final
@parameters(frozen=True)
class SystematicErrors:
    """Errors b that have a memory: how odometry turns too little and drives too short, and the scale of ranges.

    What a motion model calls noise has no memory, so its share of the heading grows with the square root of the way; a
    wheel that is larger than the other, or a steering that is off its middle, turns the robot in proportion to it. The
    increment [dx, dy, dtheta] of the odometry is taken for [(1 + b_odo) dx, (1 + b_odo) dy, dtheta + b_m dx + b_rad
    dtheta], and a landmark at range r is measured at (1 + b_range) r. Each b is a first-order Gauss-Markov process of
    the path length: without observations it keeps its prior variance. An error of standard deviation 0 is not sought.

    The data show the ratio of the two scales only: if all distances were larger by the same factor, nothing measured
    would differ. The prior divides the ratio between them, and the variance that it leaves is in the map's covariance.

    Parameters
    ----------
    sigma_per_m : float, rad/m, >= 0
        Standard deviation of b_m. Wheels 0.5 m apart whose diameters differ by 0.12 %, or a steering that is 0.4
        degrees off its middle on a car of 2.7 m, make 0.0025 rad/m.
    sigma_per_rad : float, rad/rad, >= 0
        Standard deviation of b_rad: 2 % of the distance between the wheels, since tyres are wide.
    sigma_odometry_scale : float, m/m, >= 0
        Standard deviation of b_odo.
    sigma_mounting_m : float, m, >= 0
        Standard deviation of how far the sensor is ahead of the center about which the robot turns.
    sigma_range_scale : float, m/m, >= 0
        Standard deviation of b_range, the error of a camera's focal length or of the assumed size of a mark.
    memory_m : float, m, > 0
        Way after which their correlation has fallen to 1/e.

    References
    ----------
    A. Martinelli, R. Siegwart, Estimating the odometry error of a mobile robot during navigation, ECMR 2003
    (the augmented filter); A. Gelb, Applied Optimal Estimation, 1974, 3.8 (the Gauss-Markov process).
    """

    sigma_per_m: float = bounded(0.0025, ge=0)
    sigma_per_rad: float = bounded(0.02, ge=0)
    sigma_odometry_scale: float = bounded(0.0, ge=0)
    sigma_mounting_m: float = bounded(0.0, ge=0)
    sigma_range_scale: float = bounded(0.0, ge=0)
    memory_m: float = bounded(3000.0, gt=0)

    def __len__(self) -> int:
        """Return how many errors B are sought."""
        return int(self._sought.sum())

    @property
    def names(self) -> list[str]:
        """Name of each of the B errors, as a result gives them."""
        names = np.array(["turn_per_m", "turn_per_rad", "odometry_scale", "mounting_m", "range_scale"])
        return [str(name) for name in names[self._sought]]

    def covariance(self) -> FloatArray:
        """Return the prior covariance (B, B) of the errors."""
        return np.diag(np.square(self._sigmas[self._sought]))

    def calibration(self, errors: FloatArray) -> FloatArray:
        """Mounting and scale (..., 2) of the sensor, as `linearize_calibrated` takes them, of errors (..., B)."""
        return np.asarray(errors @ self._of_sensor)

    def by_calibration(self, derivative: FloatArray) -> FloatArray:
        """Return derivatives (..., 2, B) by the errors, of those (..., 2, 2) by the calibration of the sensor."""
        of_sensor = self._of_sensor
        return np.asarray(derivative @ of_sensor.T) if len(of_sensor) else np.empty((*derivative.shape[:-1], 0))

    def predict(self, motion: MotionSampler, known: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Move N poses together with their errors.

        Parameters
        ----------
        motion : MotionSampler
            The motion model, conditioned on the odometry.
        known : (N, 3 + B) float64
            Poses [x m, y m, theta rad], and the estimated errors.

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
        reported, noise = motion.moments(known[:, :3])
        F = np.repeat(np.eye(size)[None], count, axis=0)
        if size == 3:
            F[:, :3, :3] = lever_arm_jacobian(known, reported)
            return reported, F, noise
        increment = between(known[0, :3], reported[0])
        kept = math.exp(-math.hypot(*increment[:2]) / self.memory_m)
        by_errors = self.by_errors(increment)
        corrected = increment + known[:, 3:] @ by_errors.T
        moved = np.concatenate([compose(known[:, :3], corrected), kept * known[:, 3:]], axis=1)
        Q = np.zeros((count, size, size))
        F[:, :3, :3] = lever_arm_jacobian(known, moved)
        c, s = np.cos(known[:, 2, None]), np.sin(known[:, 2, None])
        F[:, 0, 3:] = c * by_errors[0] - s * by_errors[1]
        F[:, 1, 3:] = s * by_errors[0] + c * by_errors[1]
        F[:, 2, 3:] = by_errors[2]
        F[:, 3:, 3:] *= kept
        moved[:, 2] = wrap(moved[:, 2])
        Q[:, :3, :3] = noise
        Q[:, 3:, 3:] = (1 - kept**2) * self.covariance()
        return moved, F, Q

    def by_errors(self, increments: FloatArray) -> FloatArray:
        """Return derivatives (..., 3, B) of increments (..., 3), [dx, dy, dtheta], by the errors."""
        derivatives = np.zeros((*increments.shape, 5))
        derivatives[..., 2, 0] = increments[..., 0]
        derivatives[..., 2, 1] = increments[..., 2]
        derivatives[..., :2, 2] = increments[..., :2]
        return derivatives[..., self._sought]

    @property
    def _sigmas(self) -> FloatArray:
        of_odometry = [self.sigma_per_m, self.sigma_per_rad, self.sigma_odometry_scale]
        return np.array([*of_odometry, self.sigma_mounting_m, self.sigma_range_scale])

    @property
    def _of_sensor(self) -> FloatArray:
        """Which of the errors are the sensor's mounting and scale, (B, 2)."""
        return np.eye(5)[self._sought, 3:]

    @property
    def _sought(self) -> NDArray[np.bool_]:
        return self._sigmas > 0


NO_ERRORS = SystematicErrors(sigma_per_m=0, sigma_per_rad=0)
"""No systematic errors: noise is all that is wrong."""
