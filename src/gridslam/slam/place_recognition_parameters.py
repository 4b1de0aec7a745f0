"""What it takes to believe that a key scan shows an old place, and how key scans are matched to submaps."""

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
from gridslam.slam import place_checks as checks
from gridslam.slam.constraints import Constraint, ConstraintSource, recompute_information, transform_match
from gridslam.slam.loop_closure_state import LoopClosureState, RejectionReason
from gridslam.slam.submap_index import anchor_of
from gridslam.slam.submaps import ROW
from gridslam.types import FloatArray

__all__ = ["PlaceRecognitionParameters"]


@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceRecognitionParameters:
    """What `PlaceRecognition` goes by.

    Parameters
    ----------
    recent_submaps : int
        Submaps this recent are no old place.
    max_distance_m : float, m
        Two key scans this close see enough in common to be matched.
    min_overlap : float
        Share of the points that must lie in what the old map knows: where it knows nothing, nothing can agree.
    inlier_ratio : float
        Share of those that must agree with the old map.
    certain_sigma_m : float, m
        Where the position relative to a submap is this certain (standard deviation), its scans are tied without search.
    tracked_key_scans : int
        Key scans for which the robot is followed from one that was tied in all directions.
    tracked_max_correction_m : float, m
        A match farther from where the robot was followed to is not believed, since it contradicts the motion from tie
        to tie: what it fits has moved, or it slid along a wall.
    filter_max_correction_m : float, m
        Where the filter has the robot farther than this from where it was tracked to, its belief is not taken over: a
        map that repeats itself may have drawn it there.
    search_interval : int
        Key scans between two searches.
    query_key_scans : int
        Key scans whose points are searched together.
    ambiguity_ratio : float
        A second place with this share of the best one's agreement makes it ambiguous.
    ambiguity_window_m, ambiguity_window_rad : float
        Not only within the drift: where the map repeats itself this near, the next room may be one never seen.
    max_through_walls_ratio : float
        Share of the beams that may pass through what the old map knows as walls: doors and furniture move.
    min_confirmations : int
        Searches in a row that must agree.
    consistency_m, consistency_rad : float
        How far they may differ.
    min_information : float
        Least eigenvalue of the position's information, per agreeing beam: along a corridor whose doors are shut nothing
        is recognized.
    beam_sigma_m : float, m
        Standard deviation of what one beam says about a tie, beams being correlated and walls a cell thick.
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
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate=2.5, floor=0.45)
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
        """Whether enough of points (B, 2), seen from a pose, lie in what the map knows, and agree with it."""
        ratio = checks.compute_inlier_ratio(maps, pose, points, self.min_overlap, self.matcher.cauchy_m)
        return ratio >= self.inlier_ratio

    def is_within_gate(self, covariance: FloatArray, missed: FloatArray) -> bool:
        """Whether the drift explains what a match differs by (3,)."""
        return checks.is_within_gate(covariance, missed, self.search.gate)
