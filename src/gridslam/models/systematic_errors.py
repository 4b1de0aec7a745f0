"""Systematic errors of odometry and of a landmark sensor, estimated with the pose."""

from __future__ import annotations

import math
from typing import Final, final

import numpy as np

from gridslam.geometry.se2 import between, compose, lever_arm_jacobian
from gridslam.models.landmark import LandmarkModel
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, MotionSampler

ERROR_NAMES: Final = "turn_per_m", "turn_per_rad", "odometry_scale", "mounting_m", "range_scale"
"""The systematic errors: three of the odometry, then the mounting and the scale of the sensor."""

ERRORS: Final = len(ERROR_NAMES)


@final
@parameters(frozen=True)
class SystematicErrors:
    """Errors b that have a memory: how odometry turns too little and drives too short, and the scale of ranges.

    What a motion model calls noise has no memory, so its share of the heading grows with the square root of the way; a
    wheel that is larger than the other, or a steering that is off its middle, turns the robot in proportion to it. The
    increment [dx, dy, dtheta] of the odometry is taken for [(1 + b_odo) dx, (1 + b_odo) dy, dtheta + b_m dx + b_rad
    dtheta], and a landmark at range r is measured at (1 + b_range) r. Each b is a first-order Gauss-Markov process of
    the path length: without observations it keeps its prior variance. An error of standard deviation 0 stays 0.

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

    def covariance(self) -> FloatArray:
        """Return the prior covariance (5, 5) of the errors."""
        of_odometry = [self.sigma_per_m, self.sigma_per_rad, self.sigma_odometry_scale]
        return np.diag(np.square([*of_odometry, self.sigma_mounting_m, self.sigma_range_scale]))

    def predict(self, motion: MotionSampler, known: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Move a pose together with the errors.

        Parameters
        ----------
        motion : MotionSampler
            The motion model, conditioned on the odometry.
        known : (8,) float64
            Pose [x m, y m, theta rad], and the estimated errors.

        Returns
        -------
        moved, F, Q : (8,), (8, 8), (8, 8) float64
            The same after the motion, its derivatives by `known`, and the covariance of the noise.
        """
        (reported,), (noise,) = motion.moments(known[None, :3])
        dx, dy, _ = increment = between(known[:3], reported)
        by_errors = _by_errors(increment)
        kept = math.exp(-math.hypot(dx, dy) / self.memory_m)
        moved = np.concatenate([compose(known[:3], correct_increment(increment, known[3:])), kept * known[3:]])
        c, s = math.cos(known[2]), math.sin(known[2])
        F = np.eye(3 + ERRORS)
        F[:3, :3] = lever_arm_jacobian(known, moved)
        F[:3, 3:] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ by_errors
        F[3:, 3:] *= kept
        Q = np.zeros_like(F)
        Q[:3, :3] = noise
        Q[3:, 3:] = (1 - kept**2) * self.covariance()
        return moved, F, Q


NO_ERRORS = SystematicErrors(sigma_per_m=0, sigma_per_rad=0)
"""No systematic errors: noise is all that is wrong."""


def correct_increment(increment: FloatArray, errors: FloatArray) -> FloatArray:
    """Return an increment (3,) of the odometry without its systematic errors (5,)."""
    return np.asarray(increment + _by_errors(increment) @ errors)


def _by_errors(increment: FloatArray) -> FloatArray:
    """Return the derivatives (3, 5) of a corrected increment by the errors."""
    dx, dy, turn = increment
    return np.array([[0, 0, dx, 0, 0], [0, 0, dy, 0, 0], [dx, turn, 0, 0, 0]])


def linearize(sensor: LandmarkModel, known: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Predict the observations h (M, 2) of landmarks (M, 2), and their derivatives H (M, 2, 8) by pose and errors.

    A sensor at s, the mounting ahead of the robot's center, measures the landmark m as if it were at
    s + (1 + scale) (m - s).
    """
    ahead = np.array([math.cos(known[2]), math.sin(known[2])])
    left = np.array([-ahead[1], ahead[0]])
    mounted, scale = known[6], 1.0 + known[7]
    at = _sensor_pose(known)
    relative = landmarks - at[:2]
    predicted, H_x, H_m = sensor.linearize(at, at[:2] + scale * relative)
    H = np.zeros((len(landmarks), 2, 3 + ERRORS))
    H[..., :2] = -scale * H_m  # only where the landmark is relative to the sensor makes a difference
    H[..., 2] = H_x[..., 2] - mounted * scale * (H_m @ left)
    H[..., 6] = -scale * (H_m @ ahead)
    H[..., 7] = np.einsum("mij,mj->mi", H_m, relative)
    return predicted, H


def locate(sensor: LandmarkModel, known: FloatArray, measured: FloatArray) -> FloatArray:
    """Return where the landmarks (..., 2) are that are measured so: the inverse of `linearize`."""
    at = _sensor_pose(known)
    return np.asarray(at[:2] + (sensor.locate(at, measured) - at[:2]) / (1.0 + known[7]))


def _sensor_pose(known: FloatArray) -> FloatArray:
    """Pose (3,) of the sensor, which is mounted ahead of the robot's center."""
    x, y, theta = known[:3]
    return np.array([x + known[6] * math.cos(theta), y + known[6] * math.sin(theta), theta])
