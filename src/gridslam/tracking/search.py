"""Correlative search around the odometry prediction for sparse scans."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import final

import numpy as np

from gridslam.geometry.single_pose import Pose, as_pose, is_within
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import NO_INFORMATION, GaussNewton, known_inlier_ratio
from gridslam.parameters import bounded, parameters
from gridslam.tracking.odometry_calibration import MIN_SEGMENTS
from gridslam.tracking.prediction import MAX_INTERVAL_S, PoseEstimate, Prediction, unmatched_variances
from gridslam.tracking.state import Control, TrackerState
from gridslam.types import BeamEnds, FloatArray

_GATES = ((2.0, 0.1), (5.0, 0.1), (12.0, 0.3))
"""Standard deviations of the odometry within which is searched, one gate after the other, and by so much more of the
beams a place must agree than the best one within the gates before."""

_LEAST_INLIER_RATIO = 0.4
"""Inlier ratio above which gains count where scans come seldom, but from near each other, and so see much of the same:
a place within the widest gate must be certain."""

_CERTAIN_INLIER_RATIO = 0.7
"""Inlier ratio above which a place is accepted without further search."""

_WINDOW = BranchAndBound(window_m=3.0, window_rad=1.2, min_score=0.3)
"""How the gates are searched."""

_GLOBAL_WINDOW = BranchAndBound(window_m=1.0, window_rad=2.2, min_score=0.5)
"""How is searched where nothing certain was found within the gates: a turn was not counted at all. The position is
within the widest gate; a half turn is left out, as corridors and rooms look alike after one."""

_GLOBAL_INLIER_RATIO = 0.8
_GLOBAL_INLIER_GAIN = 0.3
"""Minimum inlier ratio of such a place, and its minimum gain over any previous one."""

_MAX_AMBIGUITY = 0.85
"""A place must be the only one: no other within the same gate has this part of its score."""

_MIN_SIGMA_M = 0.05
"""Minimum standard deviation of the position, which is the one learned once it is: where the odometry has been right to
centimetres, a place half a metre off is another one that looks alike."""

_BASIN_M = 0.1
_BASIN_RAD = 0.05
"""Basin of convergence of the particles' scan matching."""

_CALIBRATED_INFORMATION = 0.02
"""Calibrated odometry constrains weak directions better than the scan, see `GaussNewton.min_information`."""

_LOCAL_CELLS = 2**12
"""Side of the part of a local map that is searched, where it is larger: 205 m in cells of 5 cm."""


def local_pyramid(state: TrackerState) -> Pyramid:
    """Pyramid of the local map in use, built once for all searches until a scan is inserted."""
    if state.pyramid is None:
        state.pyramid = Pyramid.of(state.maps, state.matched_map, most_cells=_LOCAL_CELLS)
    return state.pyramid


@final
@parameters(frozen=True)
class OdometrySearch:
    """Correlative search around the odometry's prediction, for logs whose scans are far apart.

    A velocity prediction is only valid while scans are frequent. With one scan every half metre, or twice a second,
    only the odometry remains, however inaccurate, and its error between two scans exceeds the basin of convergence of a
    matcher.
    The window grows until a place is found: nearer ones are preferred, as the odometry is more often right than wrong.
    After a gap in the laser data in which the robot drove on, only the first window, of two standard deviations, is
    searched where scans come often: farther away there may be places that look alike.

    Parameters
    ----------
    sparse_period_s : float, s
        Scans come seldom where the mean time between them is longer.
    sparse_step : float, m + rad
        So they do where the robot moves and turns by more between two of them: stamps may be no measurements.
    blind_step : float, m + rad
        Odometry path between two scans above which there is a gap in the laser data.
    """

    sparse_period_s: float = bounded(0.3, ge=1e-6, le=1e6)
    sparse_step: float = bounded(0.4, ge=1e-6, le=1e6)
    blind_step: float = bounded(1.0, ge=1e-6, le=1e6)

    def is_far_from_last(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether the last scan is too old, or too far away, for a velocity prediction."""
        return self._had_gap(predicted) or self.is_sparse(state)

    def had_blind_gap(self, state: TrackerState, predicted: Prediction) -> bool:
        """Whether scans come often, but none came while the robot drove on: it may be anywhere that looks alike."""
        return self._had_gap(predicted) and not self.is_sparse(state)

    def _had_gap(self, predicted: Prediction) -> bool:
        """Whether there is a gap in the laser data, in which the robot drove on."""
        return predicted.seconds >= MAX_INTERVAL_S and predicted.moved_m + predicted.turned_rad > self.blind_step

    def is_sparse(self, state: TrackerState) -> bool:
        """Whether scans are far apart, in time or by the way driven between them."""
        return state.interval_s > self.sparse_period_s or state.mean_step > self.sparse_step

    def control(self, state: TrackerState, found: PoseEstimate) -> Control:
        """Where the particles look for a scan by the odometry: where it was found by the scans just before it.

        Where scans are far apart that may be another place that looks alike, so it is the prediction, unless that errs
        by more than a particle's descent can follow: a descent from where the scan was found ends at the same peak.
        """
        predicted = found.prediction
        if not self.is_far_from_last(state, predicted):
            return Control(found.pose)
        if found.lost:
            return Control(predicted.pose, unmatched_variances(state, predicted))
        variances = predicted.sigma_m**2, predicted.sigma_rad**2
        follows = is_within(found.pose, predicted.pose, _BASIN_M, _BASIN_RAD)
        return Control(predicted.pose if follows else found.pose, common_variances=variances)

    def __call__(
        self, state: TrackerState, predicted: Prediction, beams: BeamEnds, matcher: GaussNewton
    ) -> PoseEstimate:
        """Search the local map for a scan around where the odometry predicts it; `matcher` refines each place."""
        pyramid = local_pyramid(state)
        best = PoseEstimate(predicted.pose, predicted, matched=True, lost=True)
        error_m, error_rad = np.sqrt(state.odometry_errors.variances).tolist()
        # the errors learned hold where the robot drove about as far as it does between two scans
        is_usual = predicted.moved_m + predicted.turned_rad < 2 * max(state.mean_step, 0.5)
        known = state.odometry_errors.segments >= MIN_SEGMENTS and self.is_sparse(state) and is_usual
        sigma_m = max(error_m, _MIN_SIGMA_M if known else predicted.sigma_m)
        sigma_rad = max(error_rad, predicted.sigma_rad)
        reach_m = _GATES[-1][0] * sigma_m

        def find(window: BranchAndBound, sigmas: FloatArray) -> PoseEstimate | None:
            """The only place where the prediction, of standard deviations (3,), has the scan; none beyond all gates."""
            place = window.search(pyramid, np.array(predicted.pose), np.diag(np.square(sigmas)), beams.ends)
            if place is None or place.runner_up_score > _MAX_AMBIGUITY * place.score:
                return None
            found = _refine(state, as_pose(place.pose), predicted, beams, matcher)
            return found if is_within(found.pose, predicted.pose, reach_m, math.pi) else None

        is_blind = self.had_blind_gap(state, predicted)
        least = _LEAST_INLIER_RATIO if state.mean_step < self.sparse_step else 0.0
        for gate, gain in _GATES[:1] if is_blind else _GATES:
            found = find(_WINDOW, gate / _WINDOW.gate_sigmas * np.array([sigma_m, sigma_m, sigma_rad]))
            if found is not None and found.inlier_ratio > max(best.inlier_ratio, least) + gain:
                best = found
            if best.inlier_ratio >= _CERTAIN_INLIER_RATIO:
                return best
        if is_blind:
            return best
        reach = np.array([reach_m, reach_m, _GLOBAL_WINDOW.window_rad])
        found = find(_GLOBAL_WINDOW, reach / _GLOBAL_WINDOW.gate_sigmas)
        needed = max(_GLOBAL_INLIER_RATIO, best.inlier_ratio + _GLOBAL_INLIER_GAIN)
        return found if found is not None and found.inlier_ratio >= needed else best


@cache
def calibrated(matcher: GaussNewton) -> GaussNewton:
    """The same for calibrated odometry, which then constrains weak directions."""
    return replace(matcher, min_information=max(matcher.min_information, _CALIBRATED_INFORMATION))


def _refine(
    state: TrackerState, pose: Pose, predicted: Prediction, beams: BeamEnds, matcher: GaussNewton
) -> PoseEstimate:
    """Match from a found place; its inlier ratio is that of the beams that end in known cells.

    If the scan is degenerate the odometry constrains it.
    """
    held = calibrated(matcher)
    match = matcher.match_pose(state.maps, state.matched_map, pose, NO_INFORMATION, beams)
    weak = match.degenerate_direction(held.min_information)
    if weak is not None:
        axis = np.array(weak)
        along = np.array(match.pose)
        along[:2] -= axis * float(axis @ (along - predicted.pose)[:2])
        match = held.match_pose(state.maps, state.matched_map, as_pose(along), NO_INFORMATION, beams)
    inlier_ratio = known_inlier_ratio(state.maps, state.row, np.array(match.pose), beams.ends, matcher.cauchy_m)
    return PoseEstimate(
        match.pose,
        predicted,
        matched=True,
        lost=False,
        inlier_ratio=inlier_ratio,
        determined=weak is None,
        open_direction=weak,
    )
