"""Online calibration of the odometry: systematic errors, noise, and whether it is useful."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between
from gridslam.types import FloatArray

__all__ = ["OdometryCalibration", "OdometryErrorModel"]

_EXACT = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0])


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
    begin_pose, begin_odometry : (3,) float64
        Begin of the present stretch, in the tracker's frame and in the odometry's; NaN where there is none.
    determined : bool
        Whether no scan of the current segment was degenerate.
    """

    factors: Annotated[FloatArray, 6] = field(default_factory=_EXACT.copy)
    position: Annotated[FloatArray, 4, 5] = field(default_factory=lambda: np.zeros((4, 5)))
    heading: Annotated[FloatArray, 2, 3] = field(default_factory=lambda: np.zeros((2, 3)))
    variances: Annotated[FloatArray, 2] = field(default_factory=lambda: np.array([0.03**2, 0.05**2]))
    segments: float = 0.0
    sums: Annotated[FloatArray, 4] = field(default_factory=lambda: np.zeros(4))
    trusted: bool = True
    begin_pose: Annotated[FloatArray, 3] = field(default_factory=lambda: np.full(3, np.nan))
    begin_odometry: Annotated[FloatArray, 3] = field(default_factory=lambda: np.full(3, np.nan))
    determined: bool = True

    def correct_increment(self, increment: FloatArray) -> FloatArray:
        """The increment (3,) of the odometry without its systematic errors."""
        x, y, theta = increment.tolist()
        a, c, p, q, g, b = self.factors.tolist()
        turn = math.remainder(g * theta + b * x, math.tau)
        return np.array([a * x - c * y + p * theta, c * x + a * y + q * theta, turn])

    def snapshot(self) -> OdometryErrorModel:
        """Keep a copy for later."""
        return replace(self)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class OdometryCalibration:
    """Estimates the odometry model from the tracked motion, segment by segment.

    The six factors of `OdometryErrorModel` are the least squares solution over past stretches, of which older ones
    count less. Stretches over which the wheels slipped are far off and count little (Cauchy weights); those along which
    the scans did not determine the position teach the heading alone, as the tracker has the rest from the odometry
    itself.

    Parameters
    ----------
    segment_m, segment_rad : float
        A stretch ends after either; the tracker's own error over it is a centimetre.
    forgetting_segments : float
        Number of stretches after which one counts a third (1/e).
    prior : float
        Weight of the odometry's being exact, in squared metres and radians moved.
    min_segments : float
        Number of segments after which the errors of the odometry count as known,
    converged_sigma_m : float, m
        ... if it keeps to them as closely as this over a stretch.
    max_unexplained_ratio : float
        Odometry that leaves so much of the motion unexplained, or of the turning, is not used; it is used again once it
        leaves half of that.
    """

    segment_m: float = Field(default=0.5, gt=0)
    segment_rad: float = Field(default=0.5, gt=0)
    forgetting_segments: float = Field(default=200.0, ge=1)
    prior: float = Field(default=0.5, gt=0)
    min_segments: float = Field(default=20, ge=0)
    converged_sigma_m: float = Field(default=0.05, gt=0)
    max_unexplained_ratio: float = Field(default=0.6, gt=0)

    def is_known(self, errors: OdometryErrorModel) -> bool:
        """Whether the estimate has converged and the odometry is consistent with it."""
        return errors.segments >= self.min_segments and errors.variances[0] < self.converged_sigma_m**2

    def learn(
        self,
        errors: OdometryErrorModel,
        pose: FloatArray,
        odometry: FloatArray,
        is_good_match: bool,
        determined: bool,
    ) -> None:
        """Process a scan that was matched.

        Parameters
        ----------
        errors : OdometryErrorModel
            Updated at the end of a stretch.
        pose, odometry : (3,) float64
            Of the scan, in the tracker's frame and in the odometry's; NaN where there is no odometry.
        is_good_match : bool
            Whether the match was good; else a new stretch begins.
        determined : bool
            Whether the scan is not degenerate.
        """
        errors.determined &= determined
        known = is_good_match and not math.isnan(odometry[0] + errors.begin_odometry[0])
        if known and not (self._is_long(pose - errors.begin_pose) or self._is_long(odometry - errors.begin_odometry)):
            return
        if known:
            moved, measured = between(errors.begin_pose, pose), between(errors.begin_odometry, odometry)
            self._update_trust(errors, moved, measured)
            if errors.trusted:
                self._fit(errors, moved, measured)
        errors.begin_pose, errors.begin_odometry, errors.determined = pose, odometry, True

    def _is_long(self, difference: FloatArray) -> bool:
        x, y, turn = difference.tolist()
        return math.hypot(x, y) >= self.segment_m or abs(math.remainder(turn, math.tau)) >= self.segment_rad

    def _update_trust(self, errors: OdometryErrorModel, moved: FloatArray, measured: FloatArray) -> None:
        """Whether the odometry, as corrected, explains the motion."""
        (x, y, turn), (dx, dy, dtheta) = moved.tolist(), between(errors.correct_increment(measured), moved).tolist()
        new = [math.hypot(dx, dy), math.hypot(x, y), abs(dtheta), abs(turn)]
        errors.sums = 0.95 * errors.sums + np.array(new)
        left_m, moved_m, left_rad, turned = errors.sums.tolist()
        limit = self.max_unexplained_ratio if errors.trusted else 0.5 * self.max_unexplained_ratio
        # 2 m and 1 rad count as explained beside: a stretch or two do not decide
        errors.trusted = left_m < limit * (moved_m + 2) and left_rad < limit * (turned + 1)

    def _fit(self, errors: OdometryErrorModel, moved: FloatArray, measured: FloatArray) -> None:
        """Recursive least squares with forgetting, by Geman-McClure weights of what the present factors leave."""
        (x, y, theta), (mx, my, turned) = measured.tolist(), moved.tolist()
        residual = between(errors.correct_increment(measured), moved)
        squares = np.array([0.5 * (residual[0] ** 2 + residual[1] ** 2), residual[2] ** 2])
        weights = 1 / np.square(1 + squares / (4 * errors.variances))
        keep = 1 - 1 / self.forgetting_segments
        if errors.determined:
            rows = np.array([[x, -y, theta, 0.0, mx], [y, x, 0.0, theta, my]])
            errors.position = keep * errors.position + weights[0] * rows[:, :4].T @ rows
        row = np.array([[theta, x, theta + math.remainder(turned - theta, math.tau)]])
        errors.heading = keep * errors.heading + weights[1] * row[:, :2].T @ row
        solved = self._solve(errors.position, _EXACT[:4]), self._solve(errors.heading, _EXACT[4:])
        errors.factors = np.concatenate(solved)
        errors.segments = keep * errors.segments + 1
        change = np.minimum(squares, 9 * errors.variances) - errors.variances
        errors.variances = errors.variances + change * [errors.determined, True] / (errors.segments + 10)

    def _solve(self, equations: FloatArray, exact: FloatArray) -> FloatArray:
        matrix = equations[:, :-1] + self.prior * np.eye(len(exact))
        return np.asarray(np.linalg.solve(matrix, equations[:, -1] + self.prior * exact), np.float64)
