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
from gridslam.slam import place_evidence as evidence
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.submaps import ROW, anchor_of
from gridslam.slam.ties import Source, Tie, seen_from, surveyed
from gridslam.types import FloatArray

__all__ = ["PlaceParameters"]


@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceParameters:
    """Parameters of `PlaceRecognition`.

    Parameters
    ----------
    gap : int
        Number of most recent submaps that are excluded.
    near_m : float, m
        Largest distance between two key scans to be matched.
    overlap : float
        Minimum ratio of points that fall into known cells of the old map.
    share : float
        Minimum inlier ratio of those points.
    known_m : float, m
        Standard deviation of the relative position below which key scans are matched without a search.
    follow : int
        Number of key scans for which the pose is tracked from the last non-degenerate constraint.
    follow_m : float, m
        Reject a match farther than this from the tracked pose: the object has moved, or the match slid along a wall.
    believed_m : float, m
        Ignore the filter's pose if it differs from the tracked pose by more than this: a repetitive map may have
        attracted it.
    every : int
        Key scans between two searches.
    query : int
        Number of key scans whose points are matched together.
    other_share : float
        Reject as ambiguous if another pose reaches this fraction of the best score.
    unlike_m, unlike_rad : float
        Margin added to the search window of the ambiguity check, since the true place may be an unmapped neighbour that
        looks alike.
    through : float
        Maximum ratio of beams that pass through walls of the old map (doors and furniture move).
    confirmations : int
        Minimum number of consistent consecutive searches.
    agree_m, agree_rad : float
        Largest difference between them.
    least_information : float
        Minimum eigenvalue of the position information per inlier beam; rejects degenerate places such as bare
        corridors.
    beam_sigma_m : float, m
        Standard deviation of one beam in a constraint, inflated for correlated beams and cell size.
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
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate=2.5, floor=0.45)
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
        """Whether overlap and inlier ratio of points (B, 2) at a pose reach their thresholds."""
        return evidence.agreement(maps, pose, points, self.overlap, self.matcher.cauchy_m) >= self.share

    def is_plausible(self, covariance: FloatArray, missed: FloatArray) -> bool:
        """Whether the innovation (3,) of a match lies within the gate."""
        return evidence.plausible(covariance, missed, self.search.gate)
