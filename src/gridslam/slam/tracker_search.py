"""Where was a scan taken that does not fit where the odometry has it? A search as wide as the odometry errs."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import transform_points
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import GaussNewton, degenerate_direction
from gridslam.slam.tracker_state import Found, Prediction, TrackerState, is_within
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
    seldom_s : float, s
        Scans come seldom where the mean time between them is longer.
    seldom_way : float, m + rad
        So they do where the robot moves and turns by more between two of them: stamps may be no measurements.
    gap_s, gap_way : float, s, m + rad
        Where so much time passed between two scans, and so much was driven by the odometry, the laser was blind.
    gates : tuple of float
        Standard deviations of the odometry within which is searched, one after the other.
    certain_share : float
        Share of the beams from which on a place is taken without looking farther.
    gains : tuple of float
        By so much more of the beams a place must agree than the best one within the gates before.
    overlap : float
        Share of the beams that must end in what the local map knows; those that do not say nothing. Where scans are
        far apart, much of each is new.
    window : BranchAndBound
        How is searched; its `gate` is not used.
    anywhere : BranchAndBound
        How is searched where nothing certain was found within the gates: a turn was not counted at all.
    anywhere_share, anywhere_gain : float
        Share of the beams that must agree with a place found so, and how many more than with any before.
    unique : float
        A place must be the only one: no other within the same gate has this part of its share.
    follow_m, follow_rad : float
        So far from the prediction the descents of the particles still reach the right peak.
    matcher, steady_matcher : GaussNewton
        How a place is refined, and how where the scan leaves a direction open, which is the odometry's to tell.
    """

    seldom_s: float = Field(default=0.3, gt=0)
    seldom_way: float = Field(default=0.4, gt=0)
    gap_s: float = Field(default=1.0, gt=0)
    gap_way: float = Field(default=1.0, gt=0)
    gates: tuple[float, ...] = (2.0, 5.0, 12.0)
    gains: tuple[float, ...] = (0.1, 0.1, 0.3)
    certain_share: float = Field(default=0.7, gt=0, le=1)
    overlap: float = Field(default=0.4, gt=0, le=1)
    window: BranchAndBound = BranchAndBound(window_m=3.0, window_rad=1.2, min_score=0.3)
    anywhere: BranchAndBound = BranchAndBound(window_m=1.0, window_rad=math.pi, min_score=0.5)
    anywhere_share: float = Field(default=0.8, gt=0, le=1)
    anywhere_gain: float = Field(default=0.3, ge=0, le=1)
    unique: float = Field(default=0.85, gt=0, le=1)
    follow_m: float = Field(default=0.1, ge=0)
    follow_rad: float = Field(default=0.05, ge=0)
    matcher: GaussNewton = GaussNewton()
    steady_matcher: GaussNewton = GaussNewton(min_information=0.05)

    def is_far(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether the last scan was taken so long ago, or so far away, that velocities tell nothing."""
        driven = predicted.moved_m + predicted.turned_rad > self.gap_way and predicted.seconds >= self.gap_s
        return self._comes_seldom(state) or driven

    def was_blind(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether scans come often, but none came while the robot drove on: it may be anywhere that looks alike."""
        return not self._comes_seldom(state) and self.is_far(state, predicted)

    def _comes_seldom(self, state: TrackerState) -> bool:
        return state.period_s > self.seldom_s or state.stride > self.seldom_way

    def control(self, state: TrackerState, found: Found) -> tuple[FloatArray, FloatArray | None]:
        """Where the particles look for a scan (3,) by the odometry, and the variances (2,) of that beside their noise.

        It must not come from the scan that weighs them, so it is the prediction. Where that errs by more than a
        particle's descent can follow, it is where the scan was found: a descent from there ends at the same peak.
        """
        predicted = found.predicted
        if not self.is_far(state, predicted):
            return predicted.pose, None
        if found.poor:
            return predicted.pose, np.square([predicted.sigma_m, predicted.sigma_rad])
        follows = is_within(found.pose, predicted.pose, self.follow_m, self.follow_rad)
        return (predicted.pose if follows else found.pose), None

    def __call__(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> Found:
        """Search the local map for a scan around where the odometry predicts it."""
        pyramid, best = Pyramid.of(state.maps, state.active), Found(predicted.pose, predicted, matched=True, poor=True)
        learned_m, learned_rad = np.sqrt(state.learned.variances).tolist()
        sigma_m, sigma_rad = max(predicted.sigma_m, learned_m), max(predicted.sigma_rad, learned_rad)
        for gate, gain in zip(self.gates, self.gains, strict=True):
            covariance = np.square(gate / self.window.gate_sigmas * np.diag([sigma_m, sigma_m, sigma_rad]))
            place = self.window.search(pyramid, predicted.pose, covariance, beams.ends)
            if place is None or place.runner_up_score > self.unique * place.score:
                continue
            found = self._refined(state, place.pose, predicted, beams)
            best = found if found.share > best.share + gain else best
            if best.share >= self.certain_share:
                return best
        place = self.anywhere.search(pyramid, predicted.pose, None, beams.ends)
        if place is None or place.runner_up_score > self.unique * place.score:
            return best
        found = self._refined(state, place.pose, predicted, beams)
        return found if found.share >= max(self.anywhere_share, best.share + self.anywhere_gain) else best

    def _refined(self, state: TrackerState, pose: FloatArray, predicted: Prediction, beams: BeamEnds) -> Found:
        """Match from a place that was found; its share is that of the beams that end in what the map knows."""
        maps, row, least = state.maps, state.row, self.steady_matcher.min_information
        match = self.matcher(maps, row, pose[None], _NO_PRIOR, beams)
        weak = degenerate_direction(match.information[0], float(match.score[0]), least)
        if weak is not None:
            along = match.poses[0].copy()
            along[:2] -= weak * float(weak @ (along - predicted.pose)[:2])
            match = self.steady_matcher(maps, row, along[None], _NO_PRIOR, beams)
        at = match.poses[0]
        known = maps.is_known(state.active, transform_points(at, beams.ends))
        away = maps.distances(row, at[None], beams.ends)[0, known]
        agreeing = float(np.sum(1 / (1 + np.square(away / self.matcher.cauchy_m))))
        share = agreeing / max(len(away), self.overlap * len(beams))
        return Found(at, predicted, matched=True, poor=False, share=share, determined=weak is None)
