"""Calibration of a log's odometry by EKF SLAM, for filters that take its errors for independent noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gridslam.models.landmark import LandmarkStep
from gridslam.models.systematic_errors import correct_increment
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.types import MotionModel


def calibrate_odometry(steps: Sequence[LandmarkStep], slam: EkfSlam, motion: MotionModel) -> list[LandmarkStep]:
    """Return the steps with their increments corrected by the systematic errors that EKF SLAM estimates.

    FastSLAM samples paths, and a systematic error b of the odometry is the same along a whole path. A particle that
    estimated it given the path sampled so far could not revise that path, and particles that differ in b would be lost
    by resampling. EKF SLAM keeps b jointly with pose and map, p(x_t, b, m | z_1:t, u_1:t), so that observations of
    landmarks seen before correct it; its mean after the last step, given all observations, corrects all increments:

        [dx, dy, dtheta] -> [(1 + b_odo) dx, (1 + b_odo) dy, dtheta + b_m dx + b_rad dtheta].

    What is left is nearly independent noise, as in the motion model. The observations were used to find b, five
    numbers; that they are used again makes the filter surer by no more than b's own variance.

    Parameters
    ----------
    steps : sequence of LandmarkStep
        Of a whole log, with correspondences.
    slam : EkfSlam
        With the prior of the errors.
    motion : MotionModel
        For increments without covariance.

    References
    ----------
    A. Martinelli, R. Siegwart, Estimating the odometry error of a mobile robot during navigation, ECMR 2003.
    """
    state = slam.init()
    for step in steps:
        state, _ = slam.step(state, step.motion(motion), step.observations)
    return [replace(step, increment=correct_increment(step.increment, state.errors)) for step in steps]
