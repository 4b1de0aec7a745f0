"""Odometry noise reported by a log, as a part of the control of the particles.

The motion model spreads the particles independently of the log. If the log reports the uncertainty of its odometry,
that is added, since the two errors are independent. Odometry less certain than the velocity prediction is not used at
all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.se2 import compose_jacobians, compound_covariance
from gridslam.geometry.single_pose import Pose, as_pose, between, compose, is_known
from gridslam.models.motion import add_noise
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.tracking.prediction import MAX_INTERVAL_S, ConstantVelocity
from gridslam.types import FloatArray, MotionSampler, Odometry

__all__ = ["OdometryNoise", "is_worse_than_velocity"]

_ROUNDING = 1e-9


def is_worse_than_velocity(odometry: Odometry, seconds: float, velocity: ConstantVelocity) -> bool:
    """Whether odometry is less certain than the velocity of the last scans, in position or heading.

    `seconds` are those since the last scan.
    """
    if odometry.covariance is None:
        return False
    sigma_m, sigma_rad = velocity.sigmas(min(seconds, MAX_INTERVAL_S))
    variance_m2 = float(np.linalg.eigvalsh(odometry.covariance[:2, :2])[-1])
    return variance_m2 > sigma_m**2 or float(odometry.covariance[2, 2]) > sigma_rad**2


@final
@dataclass(frozen=True, slots=True, eq=False)
class OdometryNoise:
    """Covariance of the odometry's motion since the pose at which the interval began.

    Attributes
    ----------
    base : Pose
        That pose, in the tracker's frame: of the last scan that was matched, or of the last key scan where none is.
    reached : Pose
        Where the odometry then has the robot.
    covariance : (3, 3) float64, m^2, m rad, rad^2
        Of the motion between them, by x, y and theta in the frame of `base`.
    """

    base: Pose
    reached: Pose
    covariance: FloatArray

    @classmethod
    def from_reading(
        cls, state: GridFastSlamState, odometry: Odometry | None, *, matched: bool
    ) -> OdometryNoise | None:
        """Add the noise of a reading to that accumulated up to the last scan; None if either is unknown.

        To be called before the tracker processes the scan. `matched`: whether it matches scans; else the control is
        odometry alone, from one key scan to the next.

        """
        tracker = state.tracker
        if odometry is None or odometry.covariance is None or not is_known(tracker.odometry):
            return None
        base = tracker.matched_pose if matched else state.key_pose
        begins = tracker.matched_odometry == tracker.odometry if matched else base == tracker.pose
        before = np.zeros((3, 3)) if begins else state.odometry_covariance
        if before is None:
            return None
        moved = between(base, tracker.pose)
        reading = as_pose(odometry.pose)
        increment = between(tracker.odometry, reading)
        moves = any(increment)  # one reading may serve several scans
        covariance = compound_covariance(moved, before, increment, odometry.covariance) if moves else before
        since = between(tracker.matched_odometry, reading)
        reached = compose(tracker.matched_pose, tracker.odometry_errors.correct_increment(since) if matched else since)
        return cls(base, reached, covariance)

    def add_to(self, sampler: MotionSampler, key_pose: Pose, predicted: Pose) -> MotionSampler:
        """The motion from `key_pose` to `predicted` with this noise beside that of its `sampler`.

        As it is where the prediction is not the odometry's.
        """
        if max(map(abs, between(self.reached, predicted))) > _ROUNDING:
            return sampler
        _, by_motion = compose_jacobians(between(key_pose, self.base), between(self.base, predicted))
        return add_noise(sampler, by_motion @ self.covariance @ by_motion.T)
