"""Builds the step reports: covariances, degenerate directions and the lost flag."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from gridslam.geometry.se2 import rotate_covariances
from gridslam.geometry.single_pose import Pose, as_pose, compose
from gridslam.matching.gauss_newton import degenerate_direction
from gridslam.parameters import bounded, parameters
from gridslam.particles.resampling import compute_spread
from gridslam.slam.grid_fastslam.state import Estimate, GridFastSlamState
from gridslam.slam.loop_closure.drift_model import DriftModel, propagate_covariances, scale_covariances
from gridslam.tracking.state import UnmatchedMotion
from gridslam.types import BeamEnds, FloatArray, IntArray, LaserScan, Match, MotionSampler, SkipReason, StepReport

_MIN_INFORMATION = 1e-2 * np.eye(3)
"""Information (1/m^2, 1/rad^2) assumed at least: nothing is less certain than 10 m and 10 rad."""
_SIGMA_M = 0.05
"""Standard deviation of one beam, inflated for correlated beams."""
DRIFT = DriftModel(
    standstill_sigma_rad=0.0001,
    sigma_m_per_sqrt_m=0.016,
    sigma_rad_per_sqrt_rad=0.001,
    sigma_m_per_sqrt_rad=0.013,
    sigma_rad_per_sqrt_m=0.0005,
    open_heading_ratio=6.0,
)
"""How uncertain the motion is once its scans are matched to the particles' maps, which show more than the tracker's
local ones, and smoothed: with half as much again the average NEES of simulated buildings was 0.2 to 0.8 in place of 3.
"""
_SCALE_SIGMA = 0.002
"""Standard deviation of the scale of the whole map, which no measurement of a run shows: the odometry's scale, the
laser's and the rounding of walls to cells. On simulated drives 0.1 to 0.3 %."""
_FIRST_SIGMA_RAD = 0.003
"""Standard deviation of the heading that the first increment has beside, as the map of one scan is matched."""


@final
@parameters(frozen=True)
class ReportBuilder:
    """Estimates how reliable the filter's pose is, and builds its reports; reads the state and never writes to it.

    The covariance of a pose, given all that was measured so far, is the spread of the particles about the best one,
    plus what its match leaves open, plus what its map has drifted by since the start: along the most certain known way,
    which a loop closure may shorten; an upper bound of what all ways together leave.

    Parameters
    ----------
    lost_below : float
        Inlier ratio with the map of the best particle below which the robot is lost. Entering a room for the first time
        leaves about a third.
    """

    lost_below: float = bounded(0.15, ge=0, le=1)

    @staticmethod
    def first_scan(state: GridFastSlamState, scan: LaserScan, n_eff: float) -> StepReport:
        """Report of the scan that the filter begins with: a key scan that weighs nothing."""
        return StepReport(
            scan.stamp_ns,
            state.poses[state.best],
            state.covariance,
            np.zeros(3),
            best=state.best,
            n_eff=n_eff,
            poses=state.poses,
            log_weights=state.log_weights,
        )

    def between_key_scans(
        self, state: GridFastSlamState, scan: LaserScan, key_from_base: Pose, reason: SkipReason
    ) -> StepReport:
        """Report of a scan that did not step the particles: the pose of the key scan, moved on by the tracker."""
        best = state.best
        pose = np.array(compose(as_pose(state.reported.pose), key_from_base))
        at_key = state.defer_covariance()  # all as they are now: the filter goes on before somebody asks
        unmatched, heading = state.tracker.unmatched, state.tracker.pose[2]
        drift, first_pose = state.drift, state.ancestry.first_pose

        def covariance() -> FloatArray:
            moved = DRIFT.covariance(key_from_base, unmatched, heading)
            return at_key() + rotate_covariances(moved, pose[2]) + self._drift_at(pose, drift, first_pose)

        return StepReport(
            scan.stamp_ns,
            pose,
            covariance,
            np.array(key_from_base),
            lost=state.lost,
            skipped=reason,
            best=best,
        )

    @staticmethod
    def key_scan(
        state: GridFastSlamState,
        scan: LaserScan,
        key_from_base: Pose,
        estimate: Estimate,
        n_eff: float,
        parents: IntArray | None,
    ) -> StepReport:
        """Report of a key scan: the estimate from before resampling, and the best particle after it."""
        return StepReport(
            scan.stamp_ns,
            estimate.reported.pose,
            estimate.covariance,
            np.array(key_from_base),
            degenerate_direction=estimate.degenerate_direction,
            lost=estimate.lost,
            best=state.best,
            n_eff=n_eff,
            poses=estimate.poses,
            log_weights=estimate.log_weights,
            parents=parents,
        )

    def estimate(
        self, state: GridFastSlamState, motion: MotionSampler, increment: Pose, match: Match, beams: BeamEnds
    ) -> Estimate:
        """Estimate the pose from the weighed particles and the `match` of `beams` at them, after an increment."""
        best = state.best
        reported = state.reported.follow(increment, motion, state.best_pose)
        poses, log_weights = state.poses, state.log_weights
        information = match.information[best]
        score = float(match.score[best])

        def covariance() -> FloatArray:
            open_ = np.linalg.inv(information / _SIGMA_M**2 + _MIN_INFORMATION)
            return compute_spread(poses, log_weights, best) + np.asarray(open_, np.float64)

        # the second key scan is not judged: a first scan that saw nothing leaves an empty map
        lost = score < self.lost_below * len(beams) and state.ancestry.steps > 2
        direction = degenerate_direction(information, score)
        drift = self._drift_covariance(state, increment, lost, direction is not None)
        return Estimate(reported, covariance, drift, direction, lost, poses, log_weights)

    def _drift_covariance(
        self, state: GridFastSlamState, increment: Pose, lost: bool, is_degenerate: bool
    ) -> FloatArray:
        """Where the match to the best particle's map is good, it does not matter what the tracker did not match."""
        unmatched: UnmatchedMotion | None = state.unmatched
        if not lost:
            unmatched = UnmatchedMotion(open_covariance=state.unmatched.open_covariance) if is_degenerate else None
        first = state.ancestry.steps == 2
        drift = DRIFT.covariance(increment, unmatched, state.key_pose[2])
        drift[2, 2] += first * _FIRST_SIGMA_RAD**2
        return drift

    def add_drift(self, state: GridFastSlamState, report: StepReport) -> StepReport:
        """Add the drift up to this key scan to the covariance of its report, after a loop closure has shortened it."""
        drift, first_pose = state.drift, state.ancestry.first_pose

        def covariance() -> FloatArray:
            return report.covariance + self._drift_at(report.pose, drift, first_pose)

        return replace(report, computed_covariance=covariance)

    def _drift_at(self, pose: FloatArray, moments: FloatArray, first_pose: FloatArray) -> FloatArray:
        """Covariance (3, 3) of the drift of a pose (3,) since the first one, and of the error of the scale."""
        of_scale = scale_covariances(_SCALE_SIGMA, (pose - first_pose)[None, :2])
        return np.asarray((propagate_covariances(pose[None], moments[None]) + of_scale)[0])
