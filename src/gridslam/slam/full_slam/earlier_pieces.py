"""Relocalize the robot in maps of earlier drives, by its scans alone."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid, thin_points
from gridslam.slam.full_slam.component_alignment import (
    Alignment,
    ComponentAlignment,
    KnownMap,
    SearchHit,
    group_hits,
)
from gridslam.slam.full_slam.trajectory_score import TrajectoryScorer
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import FoundPiece, LoopClosureState
from gridslam.slam.loop_closure.submaps import build_map
from gridslam.types import FloatArray, IntArray

__all__ = ["EarlierPieces"]

_WINDOW_M = 50.0
"""Half the side of a square that is searched at a time; a larger map is searched square by square."""
_SEARCH = BranchAndBound(window_m=_WINDOW_M, window_rad=math.pi, gate_sigmas=2.5, min_score=0.45)
_SEARCH_INTERVAL = 3
"""Key scans from one search to the next."""
_QUERY_KEY_SCANS = 8
"""Key scans whose points are searched together."""
_SIMILAR = 0.85
"""A drive is self-similar if, in its own map, the runner-up of a quarter of its key scans reaches so much of the best
score."""

_NEAR_M = 5.0
_NEAR_RAD = 0.5
"""Half the sides of the window that is searched about a pose that was given."""

_FIRST_KEY_SCANS = 12
"""A drive is not compared before it has this many key scans, about 5 m: less of it looks alike in too many places."""

_LAST_KEY_SCANS = 90
"""Key scans, about 40 m, by which a drive is located: what was driven before may lie where the map ends."""

_MIN_OVERLAP = 0.5
"""Ratio of beams that end in what the piece knows: beams that end outside of it contradict nothing. In other buildings
the best places had 0.16 to 0.22, all but off the map; right ones 0.77 to 0.99."""

_MIN_AGREEMENT = 0.87
"""Agreement (see `TrajectoryScorer`) of those that do: on another floor of equal rooms 0.80, in right places from 0.93,
where people walk about, to 0.99."""

_VOTE_INTERVAL = 6
_MIN_VOTES = 8
_MIN_VOTE_RATIO = 0.5
_MAX_RUNNER_UP_RATIO = 1 / 3
"""Drives on one floor of equal rooms had 73 to 82 % of the votes and the runner-up 8 to 18 % of these; on other
floors that look alike at most 15 % of the votes, and the runner-up nearly as many."""

_PATIENCE = 30
"""After each multiple of this many key scans without success searches are half as frequent, down to an eighth."""


@final
class EarlierPieces:
    """Locates a drive in earlier pieces: every few key scans the newest points are searched everywhere.

    The hits of all searches are judged as those of a component behind a gap (see `ComponentAlignment`), but for the
    drift, of which nothing is known: the drive as a whole is tracked through the piece's map from each place where
    several of its searches agree, and only if one place explains it much better than any other it is found.

    What was searched is remembered by what was searched for, so that results depend on the drive alone: a state that
    was saved, or stepped again, is located at the same key scan.

    Parameters
    ----------
    pieces : sequence of MapPiece
        One or more, in frames that have nothing to do with each other.
    mapper : OccupancyGridMapping
        How their maps are drawn.
    places : PlaceMatching
        How key scans are matched, and what makes a place ambiguous.
    alignment : ComponentAlignment
        When an alignment is certain.
    scorer : TrajectoryScorer
        How hypotheses are scored.
    begin : (3,) float64, optional
        Where the drive begins in the first piece, within 5 m and half a radian; it is searched for there alone.
    """

    def __init__(
        self,
        pieces: Sequence[MapPiece],
        mapper: OccupancyGridMapping,
        places: PlaceMatching,
        alignment: ComponentAlignment,
        scorer: TrajectoryScorer,
        begin: FloatArray | None = None,
    ) -> None:
        self.pieces = list(pieces)
        self._mapper = mapper
        self._places = places
        self._alignment = alignment
        self._scorer = scorer
        self._begin = begin
        self._maps = [piece.build_map(mapper) for piece in self.pieces]
        self._pyramids = [Pyramid.of(maps, 0) for maps in self._maps]
        self._hits: dict[tuple[int, int, bytes, bytes], list[SearchHit]] = {}

    def locate(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Search for the newest key scan, and give the first piece in which the drive so far is found."""
        newest = len(closure_state.graph) - 1
        if newest + 1 < _FIRST_KEY_SCANS or not self._is_searched(newest):
            return None
        poses = np.array(closure_state.graph.poses)
        recent = np.arange(max(0, len(poses) - _LAST_KEY_SCANS), len(poses))
        for number, piece in enumerate(self.pieces if self._begin is None else self.pieces[:1]):
            found = self.align(closure_state, number, recent, [k for k in recent.tolist() if self._is_searched(k)])
            if found is not None:
                before = compose(found.poses[0], between(poses[recent[0]], poses[: recent[0]]))
                match = found._replace(poses=np.concatenate([before, found.poses]))
                return FoundPiece(number, piece, self._maps[number], match)
        return None

    def locate_by_votes(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Give the first piece in which a drive that has ended is found as a whole (see `align_by_votes`)."""
        keys = np.arange(len(closure_state.graph))
        for number, piece in enumerate(self.pieces):
            match = self.align_by_votes(closure_state, number, keys)
            if match is not None:
                return FoundPiece(number, piece, self._maps[number], match)
        return None

    def align_by_votes(self, closure_state: LoopClosureState, number: int, keys: IntArray) -> PieceMatch | None:
        """Align all key scans (K,) of a drive with a piece; None if that is not certain.

        In rooms that are all alike no part of a drive is certain, but as a whole it lies in one place alone. Each
        search votes for its two best places. The drive lies where the votes of most searches agree with how it was
        tracked, if no other place has a third as many.
        """
        searched = keys[_VOTE_INTERVAL - 1 :: _VOTE_INTERVAL].tolist()
        hits = [hit for key in searched for hit in self._search(closure_state, number, key)]
        groups = sorted(group_hits(closure_state.graph, hits), key=len, reverse=True)
        if not groups or len(groups[0]) < max(_MIN_VOTES, _MIN_VOTE_RATIO * len(searched)):
            return None
        if len(groups) > 1 and len(groups[1]) > _MAX_RUNNER_UP_RATIO * len(groups[0]):
            return None
        alignment = self._begin_alignment(closure_state, number, keys)
        best = alignment.track_component(groups[0])
        constraints = alignment.match_constraints(best)
        return PieceMatch(best.poses, constraints) if constraints else None

    def align(
        self, closure_state: LoopClosureState, number: int, keys: IntArray, searched: Sequence[int]
    ) -> PieceMatch | None:
        """Align consecutive key scans (K,) of a drive with piece `number`; None if that is not certain.

        `searched` are those of them for which the piece is searched. The match has the poses (K, 3) of these key scans.
        """
        parameters = self._alignment
        hits = [hit for key in searched for hit in self._search(closure_state, number, key)]
        agreeing = max((len(group) for group in group_hits(closure_state.graph, hits)), default=0)
        if agreeing < parameters.min_constraints:
            return None
        alignment = self._begin_alignment(closure_state, number, keys)
        best = alignment.select_hypothesis(hits)
        if best is None or best.overlap < _MIN_OVERLAP or best.agreement < _MIN_AGREEMENT:
            return None
        if self._is_self_similar(closure_state, keys):
            return None
        constraints = alignment.match_constraints(best)
        return PieceMatch(best.poses, constraints) if constraints else None

    def _begin_alignment(self, closure_state: LoopClosureState, number: int, keys: IntArray) -> Alignment:
        piece = self.pieces[number]
        known = KnownMap(piece.scans, piece.poses, np.arange(len(piece)), self._maps[number])
        return Alignment(self._alignment, closure_state, self._mapper, self._places, self._scorer, keys, known)

    def _is_self_similar(self, closure_state: LoopClosureState, keys: IntArray) -> bool:
        """Whether key scans (K,) also match their own map elsewhere."""
        poses = np.array(closure_state.graph.poses)
        own = Pyramid.of(build_map(self._mapper, closure_state.scans, keys, poses[keys]), 0)
        within = replace(_SEARCH, window_m=15.0, window_rad=0.35)
        ratios = []
        for key in keys[min(_QUERY_KEY_SCANS, len(keys)) - 1 :: max(len(keys) // 8, 1)].tolist():
            points = thin_points(collect_recent_points(closure_state, key, _QUERY_KEY_SCANS), _SEARCH.max_points)
            found = within.search(own, poses[key], None, points)
            ratios.append(0.0 if found is None else found.runner_up_score / found.score)
        return float(np.quantile(ratios, 0.75)) >= _SIMILAR

    def _is_searched(self, key: int) -> bool:
        """Whether a key scan is one of those that are searched."""
        interval = _SEARCH_INTERVAL * 2 ** min(key // _PATIENCE, 3)
        return bool((key + 1) % interval == 0)

    def _search(self, closure_state: LoopClosureState, number: int, key: int) -> list[SearchHit]:
        """The two best places of a key scan's points in a piece."""
        points = collect_recent_points(closure_state, key, _QUERY_KEY_SCANS)
        few = thin_points(points, _SEARCH.max_points)
        expected = None
        if self._begin is not None:
            poses = closure_state.graph.poses
            expected = compose(self._begin, between(poses[0], poses[key]))
        known = (number, key, few.tobytes(), b"" if expected is None else expected.tobytes())
        if known not in self._hits:
            found = (
                self._search_everywhere(number, key, few)
                if expected is None
                else self._search_near(number, key, few, expected)
            )
            self._hits[known] = list(found)
        return self._hits[known]

    def _search_near(self, number: int, key: int, points: FloatArray, expected: FloatArray) -> Iterator[SearchHit]:
        """Search a piece about the pose (3,) where the key scan is expected."""
        search = replace(_SEARCH, window_m=_NEAR_M, window_rad=_NEAR_RAD)
        found = search.search(self._pyramids[number], expected, None, points)
        if found is not None:
            yield SearchHit(key, found.pose, found.score)

    def _search_everywhere(self, number: int, key: int, points: FloatArray) -> Iterator[SearchHit]:
        """Search a piece square by square."""
        places: list[tuple[float, FloatArray]] = []
        search = _SEARCH
        for centre in self._centres(number):
            found = search.search(self._pyramids[number], centre, None, points)
            if found is not None:
                places.append((found.score, found.pose))
                if found.runner_up_pose is not None:
                    places.append((found.runner_up_score, found.runner_up_pose))
        places.sort(key=lambda place: -place[0])
        best: list[tuple[float, FloatArray]] = []
        for score, pose in places:  # squares overlap by nothing, but a place on their border may be found in both
            if not any(np.hypot(*(pose - other)[:2]) < search.runner_up_distance_m for _, other in best):
                best.append((score, pose))
        for score, pose in best[:2]:
            yield SearchHit(key, pose, score)

    def _centres(self, number: int) -> Iterator[FloatArray]:
        """Poses (3,) in the middle of the squares that cover a piece's map."""
        pyramid = self._pyramids[number]
        low = np.array(pyramid.corner)[::-1] * pyramid.resolution_m
        sides = np.array(pyramid.shape[::-1]) * pyramid.resolution_m
        across, up = np.ceil(sides / (2 * _WINDOW_M)).astype(int).tolist()
        for column in range(across):
            for row in range(up):
                yield np.append(low + sides * [(column + 0.5) / across, (row + 0.5) / up], 0.0)


def collect_recent_points(closure_state: LoopClosureState, key: int, scans: int) -> FloatArray:
    """Points (B, 2) of a key scan and those before it, `scans` in all at most, seen from it.

    Stops at a gap in the laser data.
    """
    graph = closure_state.graph
    keys = graph.select_without_gap(np.arange(max(key - scans + 1, 0), key + 1), key)
    tracked = graph.tracked_poses_from(key, keys)
    points = [
        transform_points(pose, closure_state.scans.key(k).ends) for k, pose in zip(keys.tolist(), tracked, strict=True)
    ]
    return np.concatenate(points)
