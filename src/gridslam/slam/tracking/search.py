"""Correlative search around the odometry prediction for sparse scans."""

from __future__ import annotations

from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import transform_points
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import GaussNewton, degenerate_direction
from gridslam.models.parameters import Numbers
from gridslam.slam.tracking.state import PoseEstimate, Prediction, TrackerState, is_within
from gridslam.types import BeamEnds, FloatArray

__all__ = ["OdometrySearch"]

_NO_PRIOR = np.full((1, 3, 3), 1e-9) * np.eye(3)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class OdometrySearch:
    """Correlative search around the odometry's prediction, for logs whose scans are far apart.

    A velocity prediction is only valid while scans are frequent. With one scan every half metre, or twice a second,
    only the odometry remains, however inaccurate, and its error between two scans exceeds the basin of convergence of a
    matcher.
    The window grows until a place is found: nearer ones are preferred, as the odometry is more often right than wrong.

    Parameters
    ----------
    sparse_period_s : float, s
        Scans come seldom where the mean time between them is longer.
    sparse_step : float, m + rad
        So they do where the robot moves and turns by more between two of them: stamps may be no measurements.
    blind_period_s, blind_step : float, s, m + rad
        Time and odometry path between two scans above which there is a gap in the laser data.
    gate_sigmas : tuple of float
        Standard deviations of the odometry within which is searched, one after the other. Those of the position are the
        ones learned, once they are: where the odometry has been right to centimetres, a place half a metre off is
        another one that looks alike.
    min_segments : float
        Number of segments (see `OdometryCalibration`) after which the errors of the position are learned.
    min_sigma_m : float, m
        Minimum standard deviation of the position.
    certain_inlier_ratio : float
        Inlier ratio above which a place is accepted without further search.
    inlier_gains : tuple of float
        By so much more of the beams a place must agree than the best one within the gates before.
    min_overlap : float
        Minimum ratio of beams that end in known cells of the local map; the others are ignored. With sparse scans, much
        of each is new.
    window : BranchAndBound
        How is searched; its `gate` is not used.
    global_window : BranchAndBound
        How is searched where nothing certain was found within the gates: a turn was not counted at all. The position
        is within the widest gate; a half turn is left out, as corridors and rooms look alike after one.
    global_inlier_ratio, global_inlier_gain : float
        Minimum inlier ratio of such a place, and its minimum gain over any previous one.
    ambiguity_ratio : float
        A place must be the only one: no other within the same gate has this part of its share.
    basin_m, basin_rad : float
        Basin of convergence of the particles' scan matching.
    matcher, calibrated_matcher : GaussNewton
        Matchers that refine a place; the second one is used if the scan is degenerate and the odometry has to constrain
        it.
    """

    sparse_period_s: float = Field(default=0.3, gt=0)
    sparse_step: float = Field(default=0.4, gt=0)
    blind_period_s: float = Field(default=1.0, gt=0)
    blind_step: float = Field(default=1.0, gt=0)
    gate_sigmas: Numbers = (2.0, 5.0, 12.0)
    inlier_gains: Numbers = (0.1, 0.1, 0.3)
    certain_inlier_ratio: float = Field(default=0.7, gt=0, le=1)
    min_segments: float = Field(default=20, ge=0)
    min_sigma_m: float = Field(default=0.05, gt=0)
    min_overlap: float = Field(default=0.4, gt=0, le=1)
    window: BranchAndBound = BranchAndBound(window_m=3.0, window_rad=1.2, min_score=0.3)
    global_window: BranchAndBound = BranchAndBound(window_m=1.0, window_rad=2.2, min_score=0.5)
    global_inlier_ratio: float = Field(default=0.8, gt=0, le=1)
    global_inlier_gain: float = Field(default=0.3, ge=0, le=1)
    ambiguity_ratio: float = Field(default=0.85, gt=0, le=1)
    basin_m: float = Field(default=0.1, ge=0)
    basin_rad: float = Field(default=0.05, ge=0)
    matcher: GaussNewton = GaussNewton()
    calibrated_matcher: GaussNewton = GaussNewton(min_information=0.05)

    def is_far_from_last(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether the last scan is too old, or too far away, for a velocity prediction."""
        driven = predicted.moved_m + predicted.turned_rad > self.blind_step and predicted.seconds >= self.blind_period_s
        return self.is_sparse(state) or driven

    def had_blind_gap(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether scans come often, but none came while the robot drove on: it may be anywhere that looks alike."""
        return not self.is_sparse(state) and self.is_far_from_last(state, predicted)

    def is_sparse(self, state: TrackerState) -> bool:
        """Whether scans are far apart, in time or by the way driven between them."""
        return state.period_s > self.sparse_period_s or state.mean_step > self.sparse_step

    def _is_usual(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether the robot drove about as far as it does between two scans, so that the errors learned hold."""
        return self.is_sparse(state) and predicted.moved_m + predicted.turned_rad < 2 * max(state.mean_step, 0.5)

    def control(self, state: TrackerState, found: PoseEstimate) -> tuple[FloatArray, FloatArray | None]:
        """Where the particles look for a scan (3,) by the odometry, and the variances (2,) of that beside their noise.

        It must not come from the scan that weighs them, so it is the prediction. Where that errs by more than a
        particle's descent can follow, it is where the scan was found: a descent from there ends at the same peak.
        """
        predicted = found.prediction
        if not self.is_far_from_last(state, predicted):
            return predicted.pose, None
        if found.lost:
            return predicted.pose, np.square([predicted.sigma_m, predicted.sigma_rad])
        follows = is_within(found.pose, predicted.pose, self.basin_m, self.basin_rad)
        return (predicted.pose if follows else found.pose), None

    def __call__(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Search the local map for a scan around where the odometry predicts it."""
        pyramid = Pyramid.of(state.maps, state.matched_map)
        best = PoseEstimate(predicted.pose, predicted, matched=True, lost=True)
        error_m, error_rad = np.sqrt(state.odometry_errors.variances).tolist()
        known = state.odometry_errors.segments >= self.min_segments and self._is_usual(state, predicted)
        sigma_m = max(error_m, self.min_sigma_m if known else predicted.sigma_m)
        sigma_rad = max(error_rad, predicted.sigma_rad)
        for gate, gain in zip(self.gate_sigmas, self.inlier_gains, strict=True):
            covariance = np.square(gate / self.window.gate_sigmas * np.diag([sigma_m, sigma_m, sigma_rad]))
            place = self.window.search(pyramid, predicted.pose, covariance, beams.ends)
            if place is None or place.runner_up_score > self.ambiguity_ratio * place.score:
                continue
            found = self._refine(state, place.pose, predicted, beams)
            best = found if found.inlier_ratio > best.inlier_ratio + gain else best
            if best.inlier_ratio >= self.certain_inlier_ratio:
                return best
        reach_m = self.gate_sigmas[-1] * sigma_m if self.gate_sigmas else self.global_window.window_m
        reach = np.diag([reach_m, reach_m, self.global_window.window_rad]) / self.global_window.gate_sigmas
        place = self.global_window.search(pyramid, predicted.pose, np.square(reach), beams.ends)
        if place is None or place.runner_up_score > self.ambiguity_ratio * place.score:
            return best
        found = self._refine(state, place.pose, predicted, beams)
        needed = max(self.global_inlier_ratio, best.inlier_ratio + self.global_inlier_gain)
        return found if found.inlier_ratio >= needed else best

    def _refine(self, state: TrackerState, pose: FloatArray, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Match from a place that was found; its share is that of the beams that end in what the map knows."""
        maps, row, least = state.maps, state.row, self.calibrated_matcher.min_information
        match = self.matcher(maps, row, pose[None], _NO_PRIOR, beams)
        weak = degenerate_direction(match.information[0], float(match.score[0]), least)
        if weak is not None:
            along = match.poses[0].copy()
            along[:2] -= weak * float(weak @ (along - predicted.pose)[:2])
            match = self.calibrated_matcher(maps, row, along[None], _NO_PRIOR, beams)
        at = match.poses[0]
        known = maps.is_known(state.matched_map, transform_points(at, beams.ends))
        away = maps.distances(row, at[None], beams.ends)[0, known]
        agreeing = float(np.sum(1 / (1 + np.square(away / self.matcher.cauchy_m))))
        inlier_ratio = agreeing / max(len(away), self.min_overlap * len(beams))
        return PoseEstimate(at, predicted, matched=True, lost=False, inlier_ratio=inlier_ratio, determined=weak is None)
