"""Online calibration of the odometry: systematic errors, noise, and whether it is useful."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, final

import numpy as np

from gridslam.arguments import Limits
from gridslam.geometry.single_pose import UNKNOWN_POSE, Pose, between, is_known, is_within, motion_of
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray

MIN_SEGMENTS = 20
"""Number of segments after which the errors of the odometry count as known ..."""

_CONVERGED_SIGMA_M = 0.05
"""... if it keeps to them as closely as this over a segment."""

SEGMENT_M = 0.5
SEGMENT_RAD = 0.5
"""A segment ends after either; the tracker's own error over it is a centimetre."""

_MAX_UNEXPLAINED_RATIO = 0.6
"""Odometry that leaves so much of the motion unexplained, or of the turning, is not used; it is used again once it
leaves half of that, and so does not come and go."""

_PRIOR = 0.5
"""Weight of the odometry's being exact, in squared metres and radians moved."""

_EXACT = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
_EXACT_POSITION = _PRIOR * np.column_stack([np.eye(4), _EXACT[:4]])
_EXACT_HEADING = _PRIOR * np.column_stack([np.eye(2), _EXACT[4:]])
"""Normal equations, with the right side as the last column, of odometry that is exact."""


@final
@dataclass(slots=True, eq=False)
class OdometryErrorModel:
    """Estimated odometry model; arrays are replaced, never modified in place.

    Attributes
    ----------
    factors : (6,) float64
        True increments [x, y, theta] are [a x - c y + p theta, c x + a y + q theta, g theta + b x] of those measured,
        by a, c, p m/rad, q m/rad, g, b rad/m: a and c are the scale and a turn of the direction of motion, p and q
        give the centre of rotation in the base frame, g and b how the heading errs by radian and by metre.
    position, heading : (4, 5), (2, 3) float64
        Normal equations of a, c, p, q and of g, b: the matrix, and the right side as the last column.
    variances : (2,) float64
        Of what is left over a stretch, m^2 (each of x and y) and rad^2.
    segments : float
        Number of stretches learned from.
    sums : (4,) float64
        What was left and what was moved over the last stretches, m and rad: left, moved, left, turned.
    trusted : bool
        Whether the odometry helps.
    begin_pose, begin_odometry : Pose
        Begin of the present stretch, in the tracker's frame and in the odometry's; NaN where there is none.
    determined : bool
        Whether no scan of the current segment was degenerate.
    """

    factors: Annotated[FloatArray, 6, Limits(-1e3, 1e3)] = field(default_factory=_EXACT.copy)
    position: Annotated[FloatArray, 4, 5, Limits(-1e12, 1e12)] = field(default_factory=lambda: np.zeros((4, 5)))
    heading: Annotated[FloatArray, 2, 3, Limits(-1e12, 1e12)] = field(default_factory=lambda: np.zeros((2, 3)))
    variances: Annotated[FloatArray, 2, Limits(1e-12, 1e12)] = field(
        default_factory=lambda: np.array([0.03**2, 0.05**2])
    )
    segments: float = 0.0
    sums: Annotated[FloatArray, 4] = field(default_factory=lambda: np.zeros(4))
    trusted: bool = True
    begin_pose: Pose = UNKNOWN_POSE
    begin_odometry: Pose = UNKNOWN_POSE
    determined: bool = True

    def correct_increment(self, increment: Pose) -> Pose:
        """The increment of the odometry without its systematic errors."""
        x, y, theta = increment
        a, c, p, q, g, b = self.factors.tolist()
        turn = math.remainder(g * theta + b * x, math.tau)
        return a * x - c * y + p * theta, c * x + a * y + q * theta, turn

    def variance_along(self, way_m: float, moved_m: float) -> float:
        """Variance (m^2) that `moved_m` of corrected odometry add along its way, `way_m` after it was last checked.

        A random walk of what is left over a segment, and the error of the scale, which grows in proportion to the way.
        """
        variance = float(self.variances[0])
        scale = variance / (_PRIOR + float(self.position[0, 0]))
        return variance * moved_m / SEGMENT_M + scale * ((way_m + moved_m) ** 2 - way_m**2)

    def variances_of(self, moved_m: float, turned_rad: float) -> tuple[float, float]:
        """Return the variances (m^2, rad^2) of a motion, as a share of those of a whole segment."""
        share = min(1.0, max(moved_m / SEGMENT_M, turned_rad / SEGMENT_RAD))
        position, heading = self.variances.tolist()
        return share * position, share * heading


@final
@parameters(frozen=True)
class OdometryCalibration:
    """Estimates the odometry model from the tracked motion, segment by segment.

    The six factors of `OdometryErrorModel` are the least squares solution over past stretches, of which older ones
    count less. Stretches over which the wheels slipped are far off and count little (Cauchy weights); those along which
    the scans did not determine the position teach the heading alone, as the tracker has the rest from the odometry
    itself.

    Parameters
    ----------
    forgetting_segments : float
        Number of segments after which one counts a third (1/e).
    """

    forgetting_segments: float = bounded(200.0, ge=1, le=1e6)

    def is_known(self, errors: OdometryErrorModel) -> bool:
        """Whether the estimate has converged and the odometry is consistent with it."""
        return errors.segments >= MIN_SEGMENTS and errors.variances[0] < _CONVERGED_SIGMA_M**2

    def learn(
        self,
        errors: OdometryErrorModel,
        pose: Pose,
        odometry: Pose,
        is_good_match: bool,
        determined: bool,
    ) -> None:
        """Process a scan that was matched.

        Parameters
        ----------
        errors : OdometryErrorModel
            Updated at the end of a stretch.
        pose, odometry : Pose
            Of the scan, in the tracker's frame and in the odometry's; NaN where there is no odometry.
        is_good_match : bool
            Whether the match was good; else a new stretch begins.
        determined : bool
            Whether the scan is not degenerate.
        """
        errors.determined &= determined
        known = is_good_match and is_known(odometry) and is_known(errors.begin_odometry)
        motions = (errors.begin_pose, pose), (errors.begin_odometry, odometry)
        if known and all(is_within(*ends, SEGMENT_M, SEGMENT_RAD) for ends in motions):
            return
        if known:
            moved = between(errors.begin_pose, pose)
            measured = between(errors.begin_odometry, odometry)
            left = between(errors.correct_increment(measured), moved)
            self._update_trust(errors, moved, left)
            if errors.trusted:
                self._fit(errors, moved, measured, left)
        errors.begin_pose = pose
        errors.begin_odometry = odometry
        errors.determined = True

    def _update_trust(self, errors: OdometryErrorModel, moved: Pose, left: Pose) -> None:
        """Decide whether the corrected odometry explains the motion; `left` is the unexplained part."""
        left_m, left_rad = motion_of(left)
        moved_m, turned = motion_of(moved)
        errors.sums = 0.95 * errors.sums + np.array([left_m, moved_m, left_rad, turned])
        left_m, moved_m, left_rad, turned = errors.sums.tolist()
        limit = _MAX_UNEXPLAINED_RATIO if errors.trusted else 0.5 * _MAX_UNEXPLAINED_RATIO
        # 2 m and 1 rad count as explained beside: a stretch or two do not decide
        errors.trusted = left_m < limit * (moved_m + 2) and left_rad < limit * (turned + 1)

    def _fit(self, errors: OdometryErrorModel, moved: Pose, measured: Pose, left: Pose) -> None:
        """Recursive least squares with forgetting and Geman-McClure weights of the present residuals."""
        x, y, theta = measured
        mx, my, turned = moved
        position_m2 = 0.5 * (left[0] ** 2 + left[1] ** 2)
        heading_rad2 = left[2] ** 2
        position_variance, heading_variance = errors.variances.tolist()
        keep = 1 - 1 / self.forgetting_segments
        if errors.determined:
            rows = np.array([[x, -y, theta, 0.0, mx], [y, x, 0.0, theta, my]])
            errors.position = keep * errors.position + _weigh(position_m2, position_variance) * rows[:, :4].T @ rows
        row = np.array([[theta, x, theta + math.remainder(turned - theta, math.tau)]])
        errors.heading = keep * errors.heading + _weigh(heading_rad2, heading_variance) * row[:, :2].T @ row
        errors.factors = np.concatenate(
            [_solve(errors.position + _EXACT_POSITION), _solve(errors.heading + _EXACT_HEADING)]
        )
        errors.segments = keep * errors.segments + 1
        count = errors.segments + 10
        if errors.determined:
            position_variance += (min(position_m2, 9 * position_variance) - position_variance) / count
        heading_variance += (min(heading_rad2, 9 * heading_variance) - heading_variance) / count
        errors.variances = np.array([position_variance, heading_variance])


def _weigh(square: float, variance: float) -> float:
    """Geman-McClure weight."""
    root = 1 + square / (4 * variance)
    return 1 / (root * root)


def _solve(equations: FloatArray) -> FloatArray:
    """Solve equations (N, N + 1) with the right side as the last column."""
    return np.asarray(np.linalg.solve(equations[:, :-1], equations[:, -1]), np.float64)
