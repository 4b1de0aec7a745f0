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
from gridslam.slam import place_evidence as evidence
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.submaps import ROW, anchor_of
from gridslam.slam.ties import Source, Tie, seen_from, surveyed
from gridslam.types import FloatArray

__all__ = ["PlaceParameters"]


@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceParameters:
    """What `PlaceRecognition` goes by.

    Parameters
    ----------
    gap : int
        Submaps this recent are no old place.
    near_m : float, m
        Two key scans this close see enough in common to be matched.
    overlap : float
        Share of the points that must lie in what the old map knows: where it knows nothing, nothing can agree.
    share : float
        Share of those that must agree with the old map.
    known_m : float, m
        Where the position relative to a submap is this certain (standard deviation), its scans are tied without search.
    follow : int
        Key scans for which the robot is followed from one that was tied in all directions.
    follow_m : float, m
        A match farther from where the robot was followed to is not believed, since it contradicts the motion from tie
        to tie: what it fits has moved, or it slid along a wall.
    believed_m : float, m
        Where the filter has the robot farther than this from where it was tracked to, its belief is not taken over: a
        map that repeats itself may have drawn it there.
    every : int
        Key scans between two searches.
    query : int
        Key scans whose points are searched together.
    other_share : float
        A second place with this share of the best one's agreement makes it ambiguous.
    unlike_m, unlike_rad : float
        Not only within the drift: where the map repeats itself this near, the next room may be one never seen.
    through : float
        Share of the beams that may pass through what the old map knows as walls: doors and furniture move.
    confirmations : int
        Searches in a row that must agree.
    agree_m, agree_rad : float
        How far they may differ.
    least_information : float
        Least eigenvalue of the position's information, per agreeing beam: along a corridor whose doors are shut nothing
        is recognized.
    beam_sigma_m : float, m
        Standard deviation of what one beam says about a tie, beams being correlated and walls a cell thick.
    search : BranchAndBound
        How a place is searched for.
    matcher : GaussNewton
        How a match is refined.
    """

    gap: int = Field(default=3, ge=1)
    near_m: float = Field(default=4.0, gt=0)
    overlap: float = Field(default=0.6, gt=0, le=1)
    share: float = Field(default=0.67, gt=0, le=1)
    known_m: float = Field(default=0.15, gt=0)
    follow: int = Field(default=12, ge=1)
    follow_m: float = Field(default=0.2, gt=0)
    believed_m: float = Field(default=1.2, gt=0)
    every: int = Field(default=3, ge=1)
    query: int = Field(default=8, ge=1)
    other_share: float = Field(default=0.85, gt=0, le=1)
    unlike_m: float = Field(default=10.0, ge=0)
    unlike_rad: float = Field(default=0.2, ge=0)
    through: float = Field(default=0.2, ge=0, le=1)
    confirmations: int = Field(default=4, ge=1)
    agree_m: float = Field(default=0.25, gt=0)
    agree_rad: float = Field(default=0.05, gt=0)
    least_information: float = Field(default=0.06, ge=0)
    beam_sigma_m: float = Field(default=0.3, gt=0)
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate_sigmas=2.5, min_score=0.45)
    matcher: GaussNewton = GaussNewton()

    def match(
        self, memory: Memory, mapper: OccupancyGridMapping, key: int, block: int, guess: FloatArray, most_m: float,
        source: Source,
    ) -> Tie | Rejection:  # fmt: skip
        """Match a key scan to a submap, within `most_m` of a guess (3,) in its frame."""
        maps = memory.submaps(block, mapper, memory.scans, memory.graph)
        return self.match_to(maps, np.zeros(3), memory, key, block, guess, most_m, source)

    def match_to(
        self, maps: TileMaps, anchor: FloatArray, memory: Memory, key: int, block: int, guess: FloatArray,
        most_m: float, source: Source,
    ) -> Tie | Rejection:  # fmt: skip
        """Match a key scan to a map in which a submap's frame is at `anchor` (3,), from a guess (3,) in that frame."""
        beams = memory.scans.key(key)
        begin = compose(anchor, guess)
        match = self.matcher(maps, ROW, begin[None], np.full((1, 3, 3), 1e-9) * np.eye(3), beams)
        match = surveyed(match, maps, ROW, beams)
        pose = match.poses[0]
        moved = between(begin, pose)
        if math.hypot(moved[0], moved[1]) > most_m or not self.agrees(maps, pose, beams.ends):
            return Rejection.POOR
        seen = seen_from(anchor, match)
        return Tie.of(anchor_of(block), key, guess, seen, self.beam_sigma_m, self.least_information, source)

    def agrees(self, maps: TileMaps, pose: FloatArray, points: FloatArray) -> bool:
        """Whether enough of points (B, 2), seen from a pose, lie in what the map knows, and agree with it."""
        return evidence.agreement(maps, pose, points, self.overlap, self.matcher.cauchy_m) >= self.share

    def is_plausible(self, covariance: FloatArray, missed: FloatArray) -> bool:
        """Whether the drift explains what a match differs by (3,)."""
        return evidence.plausible(covariance, missed, self.search.gate_sigmas)
