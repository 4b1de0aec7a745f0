"""Where was a scan taken that does not fit where the odometry has it? A search as wide as the odometry errs."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import transform_points
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import GaussNewton, undetermined
from gridslam.slam.tracker_state import PoseEstimate, Prediction, TrackerState, is_within
from gridslam.types import BeamEnds, FloatArray

__all__ = ["OdometrySearch"]

_NO_PRIOR = np.full((1, 3, 3), 1e-9) * np.eye(3)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class OdometrySearch:
    """Correlative search around the odometry's prediction, for logs whose scans are far apart.

    Velocities tell where a scan was taken only while scans come often. When one comes every half metre, or twice a
    second, the odometry is all there is, however bad, and between two scans it errs by more than a descent can follow.
    The window grows until a place is found: nearer ones are preferred, as the odometry is more often right than wrong.

    Parameters
    ----------
    sparse_period_s : float, s
        Scans come seldom where the mean time between them is longer.
    sparse_step : float, m + rad
        So they do where the robot moves and turns by more between two of them: stamps may be no measurements.
    blind_period_s, blind_step : float, s, m + rad
        Where so much time passed between two scans, and so much was driven by the odometry, the laser was blind.
    gate_sigmas : tuple of float
        Standard deviations of the odometry within which is searched, one after the other.
    certain_inlier_ratio : float
        Share of the beams from which on a place is taken without looking farther.
    inlier_gains : tuple of float
        By so much more of the beams a place must agree than the best one within the gates before.
    min_overlap : float
        Share of the beams that must end in what the local map knows; those that do not say nothing. Where scans are
        far apart, much of each is new.
    window : BranchAndBound
        How is searched; its `gate` is not used.
    global_window : BranchAndBound
        How is searched where nothing certain was found within the gates: a turn was not counted at all.
    global_inlier_ratio, global_inlier_gain : float
        Share of the beams that must agree with a place found so, and how many more than with any before.
    ambiguity_ratio : float
        A place must be the only one: no other within the same gate has this part of its share.
    basin_m, basin_rad : float
        So far from the prediction the descents of the particles still reach the right peak.
    matcher, calibrated_matcher : GaussNewton
        How a place is refined, and how where the scan leaves a direction open, which is the odometry's to tell.
    """

    sparse_period_s: float = Field(default=0.3, gt=0)
    sparse_step: float = Field(default=0.4, gt=0)
    blind_period_s: float = Field(default=1.0, gt=0)
    blind_step: float = Field(default=1.0, gt=0)
    gate_sigmas: tuple[float, ...] = (2.0, 5.0, 12.0)
    inlier_gains: tuple[float, ...] = (0.1, 0.1, 0.3)
    certain_inlier_ratio: float = Field(default=0.7, gt=0, le=1)
    min_overlap: float = Field(default=0.4, gt=0, le=1)
    window: BranchAndBound = BranchAndBound(window_m=3.0, window_rad=1.2, floor=0.3)
    global_window: BranchAndBound = BranchAndBound(window_m=1.0, window_rad=math.pi, floor=0.5)
    global_inlier_ratio: float = Field(default=0.8, gt=0, le=1)
    global_inlier_gain: float = Field(default=0.3, ge=0, le=1)
    ambiguity_ratio: float = Field(default=0.85, gt=0, le=1)
    basin_m: float = Field(default=0.1, ge=0)
    basin_rad: float = Field(default=0.05, ge=0)
    matcher: GaussNewton = GaussNewton()
    calibrated_matcher: GaussNewton = GaussNewton(min_information=0.05)

    def is_far_from_last(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether the last scan was taken so long ago, or so far away, that velocities tell nothing."""
        driven = predicted.moved_m + predicted.turned_rad > self.blind_step and predicted.seconds >= self.blind_period_s
        return self._is_sparse(state) or driven

    def had_blind_gap(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether scans come often, but none came while the robot drove on: it may be anywhere that looks alike."""
        return not self._is_sparse(state) and self.is_far_from_last(state, predicted)

    def _is_sparse(self, state: TrackerState) -> bool:
        return state.period_s > self.sparse_period_s or state.mean_step > self.sparse_step

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
        sigma_m, sigma_rad = max(predicted.sigma_m, error_m), max(predicted.sigma_rad, error_rad)
        for gate, gain in zip(self.gate_sigmas, self.inlier_gains, strict=True):
            covariance = np.square(gate / self.window.gate * np.diag([sigma_m, sigma_m, sigma_rad]))
            place = self.window.search(pyramid, predicted.pose, covariance, beams.ends)
            if place is None or place.other_share > self.ambiguity_ratio * place.share:
                continue
            found = self._refine(state, place.pose, predicted, beams)
            best = found if found.inlier_ratio > best.inlier_ratio + gain else best
            if best.inlier_ratio >= self.certain_inlier_ratio:
                return best
        place = self.global_window.search(pyramid, predicted.pose, None, beams.ends)
        if place is None or place.other_share > self.ambiguity_ratio * place.share:
            return best
        found = self._refine(state, place.pose, predicted, beams)
        needed = max(self.global_inlier_ratio, best.inlier_ratio + self.global_inlier_gain)
        return found if found.inlier_ratio >= needed else best

    def _refine(self, state: TrackerState, pose: FloatArray, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Match from a place that was found; its share is that of the beams that end in what the map knows."""
        maps, row, least = state.maps, state.row, self.calibrated_matcher.min_information
        match = self.matcher(maps, row, pose[None], _NO_PRIOR, beams)
        weak = undetermined(match.information[0], float(match.score[0]), least)
        if weak is not None:
            along = match.poses[0].copy()
            along[:2] -= weak * float(weak @ (along - predicted.pose)[:2])
            match = self.calibrated_matcher(maps, row, along[None], _NO_PRIOR, beams)
        at = match.poses[0]
        known = maps.known(state.matched_map, transform_points(at, beams.ends))
        away = maps.distances(row, at[None], beams.ends)[0, known]
        agreeing = float(np.sum(1 / (1 + np.square(away / self.matcher.cauchy_m))))
        inlier_ratio = agreeing / max(len(away), self.min_overlap * len(beams))
        return PoseEstimate(at, predicted, matched=True, lost=False, inlier_ratio=inlier_ratio, determined=weak is None)
