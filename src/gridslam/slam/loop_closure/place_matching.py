"""Matching of key scans to submaps, with the thresholds of acceptance; revisits that need no search."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.angles import wrap, wrap_headings
from gridslam.geometry.se2 import between, compose
from gridslam.geometry.single_pose import as_pose, is_within
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import NO_PRIOR, GaussNewton, cauchy_weights
from gridslam.parameters import bounded, parameters
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource, transform_match
from gridslam.slam.loop_closure.key_graph import (
    KEY_SCANS_PER_SUBMAP,
    KeyGraph,
    anchor_of,
    position_sigmas,
    submap_of,
)
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submaps import ROW
from gridslam.types import FloatArray

_RECENT_SUBMAPS = 3
"""Number of most recent submaps that are excluded: they are still tracked, and a match adds nothing."""
_MIN_OVERLAP = 0.6
"""Minimum ratio of points that fall into known cells of the old map: fewer are mostly beside it."""
_MATCH_COVARIANCE = np.diag([0.05, 0.05, 0.02]) ** 2
"""Variances of the difference of two matches of one scan (m^2, m^2, rad^2)."""
_TRACKED_MAX_TURN_RAD = 0.05
"""Largest change of heading: tracking knows it better, and larger ones come from moved objects."""
_TRACKED_KEY_SCANS = 12
"""Number of key scans for which the pose is tracked from the last non-degenerate constraint."""
_REVISIT_M = 1.0
_REVISIT_RAD = 0.5
"""Tracked revisits are farther apart than one of these: those between would measure the same."""
_TRACKED_MAX_CORRECTION_M = 0.2
"""Reject a match farther than this from the tracked pose: the object has moved, or the match slid along a wall."""
_GATE_SIGMAS = 2.5
"""Standard deviations of the drift that a match may need."""
_MIN_INFORMATION = 0.06
"""Minimum eigenvalue of the position information per inlier beam; rejects degenerate places such as bare corridors."""
_BEAM_SIGMA_M = 0.3
"""Standard deviation of one beam in a constraint, inflated for correlated beams and cell size."""
_MATCHER = GaussNewton()
"""How a match is refined."""


@parameters(frozen=True)
class PlaceMatching:
    """Matches key scans to submaps, and judges the matches.

    Parameters
    ----------
    max_distance_m : float, m
        Largest distance between two key scans to be matched.
    inlier_ratio : float
        Minimum inlier ratio of the points that fall into known cells of the old map.
    certain_sigma_m : float, m
        Standard deviation of the relative position below which key scans are matched as tracked.
    filter_max_correction_m : float, m
        Ignore the filter's pose if it differs from the tracked pose by more than this: a repetitive map may have
        attracted it.
    """

    max_distance_m: float = bounded(4.0, ge=1e-6, le=1e6)
    inlier_ratio: float = bounded(0.67, ge=1e-6, le=1)
    certain_sigma_m: float = bounded(0.15, ge=1e-6, le=100)
    filter_max_correction_m: float = bounded(1.2, ge=1e-6, le=1e6)

    def match(
        self,
        closure_state: LoopClosureState,
        maps: TileMaps,
        key: int,
        submap: int,
        guess: FloatArray,
        max_correction_m: float,
        source: ConstraintSource,
        anchor: FloatArray | None = None,
    ) -> Constraint | None:
        """Match a key scan to a submap, within `max_correction_m` of a guess (3,) in its frame; None if it misfits.

        That frame is at `anchor` (3,) in `maps`, by default at the origin.
        """
        beams = closure_state.scans.key(key)
        begin = guess if anchor is None else compose(anchor, guess)
        match = _MATCHER(maps, ROW, begin[None], NO_PRIOR[None], beams)
        pose = match.poses[0]
        moved = between(begin, pose)
        if math.hypot(moved[0], moved[1]) > max_correction_m or not self.is_inlier_match(maps, pose, beams.ends):
            return None
        seen = match if anchor is None else transform_match(anchor, match)
        return Constraint.from_match(anchor_of(submap), key, guess, seen, _BEAM_SIGMA_M, _MIN_INFORMATION, source)

    def is_inlier_match(self, maps: TileMaps, pose: FloatArray, points: FloatArray) -> bool:
        """Whether overlap and inlier ratio of points (B, 2) at a pose (3,) reach their thresholds.

        An end that falls behind a wall's nearest cells, which no beam has seen, is known all the same.
        """
        away = maps.distances(ROW, pose[None], points)[0]
        known = maps.is_known(0, points, pose) | (away < _MATCHER.cauchy_m)
        if known.mean() < _MIN_OVERLAP:
            return False
        return float(cauchy_weights(away[known], _MATCHER.cauchy_m).mean()) >= self.inlier_ratio

    def match_tracked_revisit(self, closure_state: LoopClosureState, mapper: OccupancyGridMapping) -> None:
        """Match the newest key scan to an old submap at its tracked or filtered pose; add the constraint if it fits.

        No search is needed: the relative pose is known from tracking, or proposed by the filter.
        """
        graph = closure_state.graph
        newest = len(graph) - 1
        oldest = submap_of(newest) - _RECENT_SUBMAPS
        if oldest < 0 or len(closure_state.scans.key(newest)) < _MATCHER.min_beams:
            return
        last = _find_last_certain(graph)
        if last is not None and _is_revisit_near(graph, last):
            return
        tracked = None if last is None else self._predict_from_constraint(graph, last, oldest)
        prediction = tracked or self._predict_from_filter(closure_state, oldest)
        if prediction is None:
            return
        submap, guess = prediction
        max_correction_m = 3 * self.certain_sigma_m if tracked is None else _TRACKED_MAX_CORRECTION_M
        maps = closure_state.submap(submap, mapper)
        constraint = self.match(closure_state, maps, newest, submap, guess, max_correction_m, ConstraintSource.TRACKED)
        if constraint is None or abs(wrap(constraint.measurement[2] - guess[2])) > _TRACKED_MAX_TURN_RAD:
            return
        if tracked is None:
            anchor = anchor_of(submap)
            (expected,), covariances = graph.locate(newest, np.array([anchor]))
            predicted, matched = compose(graph.poses[anchor], np.stack([expected, constraint.measurement]))
            innovation = wrap_headings(matched - predicted)
            is_far = math.hypot(innovation[0], innovation[1]) > self.filter_max_correction_m
            if is_far or squared_sigmas(covariances[0], innovation) >= _GATE_SIGMAS**2:
                return
            sigma_m = float(position_sigmas(covariances)[0])
            if sigma_m > self.certain_sigma_m:
                if not constraint.determined and sigma_m > 2 * self.certain_sigma_m:
                    return
                constraint = constraint._replace(source=ConstraintSource.PROXIMITY)
        graph.add(constraint)

    def _predict_from_constraint(self, graph: KeyGraph, last: Constraint, oldest: int) -> tuple[int, FloatArray] | None:
        """The submap reached by tracking from a constraint, and the pose of the robot in its frame."""
        newest = len(graph) - 1
        seen = compose(last.measurement, between(graph.tracked[last.to], graph.tracked[newest]))
        submap = submap_of(last.from_)
        near = [b for b in (submap - 1, submap, submap + 1) if 0 <= b <= oldest]
        poses = [between(graph.relative_pose(last.from_, anchor_of(b)), seen) for b in near]
        away = [math.hypot(pose[0], pose[1]) for pose in poses]
        if not away:
            return None
        best = int(np.argmin(away))
        return (near[best], poses[best]) if away[best] < self.max_distance_m else None

    def _predict_from_filter(self, closure_state: LoopClosureState, oldest: int) -> tuple[int, FloatArray] | None:
        """The old submap nearest to the filter's pose, and that pose in its frame."""
        anchors = np.array(closure_state.online_poses[anchor_of(0) : anchor_of(oldest) + 1 : KEY_SCANS_PER_SUBMAP])
        here = closure_state.online_poses[-1]
        away = np.hypot(*(anchors[:, :2] - here[:2]).T)
        submap = int(away.argmin())
        return (submap, between(anchors[submap], here)) if away[submap] < self.max_distance_m else None


def _find_last_certain(graph: KeyGraph) -> Constraint | None:
    """The last constraint from which the newest key scan is tracked, if that is not too long ago."""
    newest = reversed(graph.constraints[-_TRACKED_KEY_SCANS:])
    last = next((constraint for constraint in newest if constraint.is_certain), None)
    return None if last is None or len(graph) - 1 - last.to > _TRACKED_KEY_SCANS else last


def _is_revisit_near(graph: KeyGraph, last: Constraint) -> bool:
    """Whether the last constraint is a tracked revisit, of a key scan near the newest one."""
    before, now = as_pose(graph.tracked[last.to]), as_pose(graph.tracked[-1])
    return last.source is ConstraintSource.TRACKED and is_within(before, now, _REVISIT_M, _REVISIT_RAD)


def squared_sigmas(covariance: FloatArray, innovation: FloatArray) -> float:
    """Squared Mahalanobis distance of the innovation (3,) of a match, given the covariance (3, 3) of the drift."""
    return float(innovation @ np.linalg.solve(covariance + _MATCH_COVARIANCE, innovation))
