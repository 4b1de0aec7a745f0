"""The pose that is reported: the best particle's motion, corrected by all its matches and not by the last one alone.

A match to the cells of a map errs by some 7 mm, differently at each key scan. The tracked motion between key scans
errs by a third of that, but its errors add up. A Kalman filter weighs both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, final

import numpy as np

from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import compose, compose_jacobians
from gridslam.geometry.single_pose import Pose
from gridslam.types import FloatArray, MotionSampler

_MATCH = np.diag(np.square([0.08, 0.08, 0.03]))
"""Covariance (m^2, rad^2) of a match beside that of the motion model, whose standard deviations are five times what a
tracked motion errs by, so that particles find what they are to follow. Only the ratio of both counts."""
_MOST_SQUARED = 0.5
"""Normalized square of what a match misses the prediction by, above which the particle's pose is taken as it is: a loop
was closed, or another particle is the best."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class SmoothedPose:
    """Pose (3,) and the covariance (3, 3) by which the next match is weighed, map frame."""

    pose: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3] = field(default_factory=lambda: np.zeros((3, 3)))

    def follow(self, increment: Pose, motion: MotionSampler, matched: FloatArray) -> SmoothedPose:
        """Predict the next pose by the tracked increment, as uncertain as the motion, and correct it by a match (3,).

        References
        ----------
        Probabilistic Robotics, Table 3.3 (`Extended_Kalman_filter`).
        """
        predicted = compose(self.pose, increment)
        _, (noise,) = motion.moments(self.pose[None])
        by_pose, _ = compose_jacobians(self.pose, increment)
        covariance = by_pose @ self.covariance @ by_pose.T + noise
        missed = wrap_headings(matched - predicted)
        weighed = np.linalg.solve(covariance + _MATCH, np.column_stack([missed, covariance]))
        if missed @ weighed[:, 0] > _MOST_SQUARED:
            return SmoothedPose(matched, _MATCH)
        pose = wrap_headings(predicted + covariance @ weighed[:, 0])
        return SmoothedPose(pose, covariance - covariance @ weighed[:, 1:])
