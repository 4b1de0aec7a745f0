"""Acceptance thresholds of place recognition, and matching of key scans to submaps."""

from __future__ import annotations

import math

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam.loop_closure import place_checks as checks
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource, recompute_information, transform_match
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_index import anchor_of
from gridslam.slam.loop_closure.submaps import ROW
from gridslam.types import FloatArray

__all__ = ["PlaceRecognitionParameters"]


@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceRecognitionParameters:
    """Parameters of `PlaceRecognition`.

    Parameters
    ----------
    recent_submaps : int
        Number of most recent submaps that are excluded.
    max_distance_m : float, m
        Largest distance between two key scans to be matched.
    min_overlap : float
        Minimum ratio of points that fall into known cells of the old map.
    inlier_ratio : float
        Minimum inlier ratio of those points.
    certain_sigma_m : float, m
        Standard deviation of the relative position below which key scans are matched without a search.
    tracked_key_scans : int
        Number of key scans for which the pose is tracked from the last non-degenerate constraint.
    tracked_max_correction_m : float, m
        Reject a match farther than this from the tracked pose: the object has moved, or the match slid along a wall.
    filter_max_correction_m : float, m
        Ignore the filter's pose if it differs from the tracked pose by more than this: a repetitive map may have
        attracted it.
    search_interval : int
        Key scans between two searches.
    query_key_scans : int
        Number of key scans whose points are matched together.
    ambiguity_ratio : float
        Reject as ambiguous if another pose reaches this fraction of the best score.
    ambiguity_window_m, ambiguity_window_rad : float
        Margin added to the search window of the ambiguity check, since the true place may be an unmapped neighbour that
        looks alike.
    max_through_walls_ratio : float
        Maximum ratio of beams that pass through walls of the old map (doors and furniture move).
    min_confirmations : int
        Minimum number of consistent consecutive searches.
    consistency_m, consistency_rad : float
        Largest difference between them.
    min_information : float
        Minimum eigenvalue of the position information per inlier beam; rejects degenerate places such as bare
        corridors.
    beam_sigma_m : float, m
        Standard deviation of one beam in a constraint, inflated for correlated beams and cell size.
    search : BranchAndBound
        How a place is searched for.
    matcher : GaussNewton
        How a match is refined.
    """

    recent_submaps: int = Field(default=3, ge=1)
    max_distance_m: float = Field(default=4.0, gt=0)
    min_overlap: float = Field(default=0.6, gt=0, le=1)
    inlier_ratio: float = Field(default=0.67, gt=0, le=1)
    certain_sigma_m: float = Field(default=0.15, gt=0)
    tracked_key_scans: int = Field(default=12, ge=1)
    tracked_max_correction_m: float = Field(default=0.2, gt=0)
    filter_max_correction_m: float = Field(default=1.2, gt=0)
    search_interval: int = Field(default=3, ge=1)
    query_key_scans: int = Field(default=8, ge=1)
    ambiguity_ratio: float = Field(default=0.85, gt=0, le=1)
    ambiguity_window_m: float = Field(default=10.0, ge=0)
    ambiguity_window_rad: float = Field(default=0.2, ge=0)
    max_through_walls_ratio: float = Field(default=0.2, ge=0, le=1)
    min_confirmations: int = Field(default=4, ge=1)
    consistency_m: float = Field(default=0.25, gt=0)
    consistency_rad: float = Field(default=0.05, gt=0)
    min_information: float = Field(default=0.06, ge=0)
    beam_sigma_m: float = Field(default=0.3, gt=0)
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate_sigmas=2.5, min_score=0.45)
    matcher: GaussNewton = GaussNewton()

    def match(
        self, closure_state: LoopClosureState, mapper: OccupancyGridMapping, key: int, submap: int, guess: FloatArray,
        max_correction_m: float, source: ConstraintSource,
    ) -> Constraint | RejectionReason:  # fmt: skip
        """Match a key scan to a submap, within `max_correction_m` of a guess (3,) in its frame."""
        maps = closure_state.submap_cache(submap, mapper, closure_state.scans, closure_state.graph)
        return self.match_to(maps, np.zeros(3), closure_state, key, submap, guess, max_correction_m, source)

    def match_to(
        self, maps: TileMaps, anchor: FloatArray, closure_state: LoopClosureState, key: int, submap: int,
        guess: FloatArray, max_correction_m: float, source: ConstraintSource,
    ) -> Constraint | RejectionReason:  # fmt: skip
        """Match a key scan to a map in which a submap's frame is at `anchor` (3,), from a guess (3,) in that frame."""
        beams = closure_state.scans.key(key)
        begin = compose(anchor, guess)
        match = self.matcher(maps, ROW, begin[None], np.full((1, 3, 3), 1e-9) * np.eye(3), beams)
        match = recompute_information(match, maps, ROW, beams)
        pose = match.poses[0]
        moved = between(begin, pose)
        if math.hypot(moved[0], moved[1]) > max_correction_m or not self.is_inlier_match(maps, pose, beams.ends):
            return RejectionReason.LOW_INLIER_RATIO
        seen = transform_match(anchor, match)
        return Constraint.from_match(
            anchor_of(submap), key, guess, seen, self.beam_sigma_m, self.min_information, source
        )

    def is_inlier_match(self, maps: TileMaps, pose: FloatArray, points: FloatArray) -> bool:
        """Whether overlap and inlier ratio of points (B, 2) at a pose reach their thresholds."""
        ratio = checks.compute_inlier_ratio(maps, pose, points, self.min_overlap, self.matcher.cauchy_m)
        return ratio >= self.inlier_ratio

    def is_within_gate(self, covariance: FloatArray, missed: FloatArray) -> bool:
        """Whether the innovation (3,) of a match lies within the gate."""
        return checks.is_within_gate(covariance, missed, self.search.gate_sigmas)
