"""Found again: where the robot is in what earlier drives have left, from nothing but what it sees."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import thin_points
from gridslam.matching.gauss_newton import NO_PRIOR, weigh_known_beams
from gridslam.slam.full_slam.component_alignment import (
    Alignment,
    ComponentAlignment,
    Hypothesis,
    KnownMap,
    SearchHit,
    group_hits,
)
from gridslam.slam.full_slam.trajectory_score import TrajectoryScorer
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import FoundPiece, LoopClosureState
from gridslam.slam.loop_closure.submap_matching import Submap
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submaps import ROW
from gridslam.types import FloatArray, IntArray, StoredScan

__all__ = ["EarlierPieces"]

_NEAR_M = 5.0
_NEAR_RAD = 0.5
"""So far from a pose that was given the drive may begin."""

_SAME_M = 1.0
_SAME_RAD = 0.15
"""Proposed poses nearer to each other in both are the same place."""

_FIRST_KEY_SCANS = 12
"""A drive is not compared before it has this many key scans, about 5 m: less of it looks alike in too many places."""

_LAST_KEY_SCANS = 90
"""Key scans, about 40 m, by which a drive is located: what was driven before may lie where the map ends."""

_COMPARED_AT_A_TIME = 32
_MATCHED = 48
_MATCHED_AT_A_TIME = 16
_MATCHED_POINTS = 500
_TRACKED = 6
"""Submaps of a piece that one is compared with at a key scan; places, those on which most keypoints agree, to which
points of it are matched; and hypotheses that are tracked, each at a key scan of its own."""

_ALIGNED = 45
"""Key scans of a drive, spread evenly, that are tracked through a piece."""

_MIN_LOG_LIKELIHOOD = 20.0
"""Nats. A whole floor has some ten million places to be, 16 nats, where a drift allows for few; in other buildings the
best place had -12 at most."""

_AMBIGUITY_RATIO = 0.5
"""Maximum evidence for any other place, as a fraction of the best."""

_MIN_OVERLAP = 0.6
"""Ratio of beams that end in what the piece knows: beams that end outside of it contradict nothing. In other buildings
the best places had 0.16 to 0.22, all but off the map; right ones 0.77 to 0.99."""

_MIN_AGREEMENT = 0.9
"""Agreement (see `TrajectoryScorer`) of those that do: on another floor of equal rooms 0.80, in right places from 0.93,
where people walk about, to 0.99."""


@final
class EarlierPieces:
    """Locates a drive in earlier pieces, by submaps of its way that are matched with all submaps of a piece.

    It is as with a component behind a gap in the laser data (see `ComponentAlignment`), but nothing is known of the
    drift: the drive is tracked through the piece's map from each place where submaps match, and if only one of them
    explains it, it is found. While the robot drives, the work is spread over key scans by counts alone.

    What was searched is remembered by what was searched for, so that results depend on the drive alone: a state that
    was saved, or stepped again, is located at the same key scan.

    Parameters
    ----------
    pieces : sequence of MapPiece
        One or more, in frames that have nothing to do with each other.
    mapper : OccupancyGridMapping
        How their maps are drawn.
    places : PlaceMatching
        How key scans are matched in the end.
    alignment : ComponentAlignment
        How submaps are cut and matched, and what makes an alignment certain.
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
        certain = replace(alignment, min_log_likelihood=_MIN_LOG_LIKELIHOOD, ambiguity_ratio=_AMBIGUITY_RATIO)
        self._alignment = certain if begin is None else alignment
        self._scorer = scorer
        self._begin = begin
        self._maps = [piece.build_map(mapper) for piece in self.pieces]
        self._submaps = [self._cut(LoopClosureState(scans=piece.scans, graph=piece.graph)) for piece in self.pieces]
        for submap in (submap for submaps in self._submaps for submap in submaps):
            submap.describe()
        compared = sum(-(-len(submaps) // _COMPARED_AT_A_TIME) for submaps in self._submaps)
        self._interval = compared + len(self.pieces) * (_MATCHED // _MATCHED_AT_A_TIME + _TRACKED + 2)
        self._searches: dict[int, _Search] = {}

    def locate(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Do the newest key scan's share of the search, and give the first piece in which the drive so far is found."""
        newest = len(closure_state.graph) - 1
        if newest + 1 < _FIRST_KEY_SCANS:
            return None
        done = (newest + 1 - _FIRST_KEY_SCANS) % self._interval
        key = newest - done
        searched = range(key % self._interval, key + 1, self._interval)
        found = None
        for begun in [k for k in searched if k + 1 >= max(_FIRST_KEY_SCANS, key - _LAST_KEY_SCANS)]:
            submap = self._submap_ending(closure_state, begun)
            if begun not in self._searches or not self._searches[begun].is_for(submap):
                self._searches[begun] = _Search(submap, self._search(closure_state, begun, submap))
            found = self._searches[begun].advance(done + 1 if begun == key else self._interval)
        if found is None:
            return None
        return found

    def locate_whole(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Give the first piece in which a drive that has ended is found as a whole.

        In rooms that are all alike no part of a drive is certain, but as a whole it lies in one place alone.
        """
        for number, piece in enumerate(self.pieces):
            match = self.align(closure_state, number, np.arange(len(closure_state.graph)))
            if match is not None:
                return FoundPiece(number, piece, self._maps[number], match)
        return None

    def align(self, closure_state: LoopClosureState, number: int, keys: IntArray) -> PieceMatch | None:
        """Align consecutive key scans (K,) of a drive with piece `number`; None if that is not certain."""
        hits: list[SearchHit] = []
        for submap in self._cut(closure_state):
            if keys[0] <= submap.keys[0] and submap.keys[-1] <= keys[-1]:
                hits += list(self._match(closure_state, number, submap))[-1]
        *_, match = self._judge(closure_state, number, keys, hits, keys)
        return match

    def _cut(self, closure_state: LoopClosureState) -> list[Submap]:
        pairs = SubmapPairs()
        length_m, step_m = self._alignment.length_m, self._alignment.step_m
        pairs.cut(closure_state.graph, closure_state.scans, self._mapper, length_m, step_m, is_over=True)
        return pairs.submaps

    def _submap_ending(self, closure_state: LoopClosureState, key: int) -> Submap:
        graph = closure_state.graph
        keys = graph.select_without_gap(np.arange(max(0, key + 1 - _LAST_KEY_SCANS), key + 1), key)
        way = graph.driven_m()[keys]
        keys = keys[way >= way[-1] - self._alignment.length_m]
        return Submap.of(graph, int(keys[len(keys) // 2]), keys, closure_state.scans, self._mapper)

    def _search(self, closure_state: LoopClosureState, key: int, submap: Submap) -> Iterator[FoundPiece | None]:
        """Search for the submap that ends at a key scan, one share of the work after the other."""
        graph = closure_state.graph
        keys = graph.select_without_gap(np.arange(max(0, key + 1 - _LAST_KEY_SCANS), key + 1), key)
        for number in range(len(self.pieces) if self._begin is None else 1):
            for hits in self._match(closure_state, number, submap):
                self._searches[key].hits[number] = hits
                yield None
        for number, piece in enumerate(self.pieces):
            hits = [
                hit
                for begun, search in sorted(self._searches.items())
                for hit in search.hits.get(number, [])
                if begun <= key and keys[0] <= hit.key <= keys[-1]
            ]
            for match in self._judge(closure_state, number, keys, hits):
                yield None if match is None else FoundPiece(number, piece, self._maps[number], match)
                if match is not None:
                    return

    def _match(self, closure_state: LoopClosureState, number: int, submap: Submap) -> Iterator[list[SearchHit]]:
        """Match a submap with all of a piece: what was found so far after each share of the work."""
        matching, graph = self._alignment.matching, closure_state.graph
        piece, older = self.pieces[number], self._submaps[number]
        expected = (
            None if self._begin is None else compose(self._begin, graph.tracked_poses_from(0, submap.keys[:1])[0])
        )
        if expected is not None:
            expected = compose(expected, graph.tracked_poses_from(int(submap.keys[0]), np.array([submap.anchor]))[0])
        proposed: list[tuple[int, FloatArray]] = []
        for first in range(0, len(older), _COMPARED_AT_A_TIME):
            for old in older[first : first + _COMPARED_AT_A_TIME]:
                for pose, keypoints in matching.propose(old, submap):
                    there = compose(piece.graph.poses[old.anchor], pose)
                    if expected is None or _is_near(expected, there, _NEAR_M, _NEAR_RAD):
                        proposed.append((-keypoints, there))
            yield []
        places = _select_distinct(sorted(proposed, key=lambda proposal: proposal[0]), _MATCHED)
        maps = self._maps[number]
        points = StoredScan(thin_points(submap.collect_points(), _MATCHED_POINTS), np.zeros(2))
        hits: list[SearchHit] = []
        for first in range(0, len(places), _MATCHED_AT_A_TIME):
            some = places[first : first + _MATCHED_AT_A_TIME]
            rows = np.zeros(len(some), np.int32)
            priors = np.broadcast_to(NO_PRIOR, (len(some), 3, 3)).copy()
            found = matching.coarse(maps, rows, np.array([pose for _, pose in some]), priors, points)
            found = matching.fine(maps, rows, found.poses, priors, points)
            for (keypoints, _), pose in zip(some, found.poses, strict=True):
                weights = weigh_known_beams(maps, ROW, pose, points.ends, self._scorer.scale_m)
                if weights.mean(dtype=np.float64) > self._scorer.neutral:
                    hits.append(SearchHit(submap.anchor, pose, -keypoints))
            yield hits[:_TRACKED]

    def _judge(
        self,
        closure_state: LoopClosureState,
        number: int,
        keys: IntArray,
        hits: list[SearchHit],
        wanted: IntArray | None = None,
    ) -> Iterator[PieceMatch | None]:
        """Judge where key scans (K,) lie by hits of their submaps, one share of the work after the other.

        The match has the poses of those `wanted`, by default all of the drive.
        """
        graph = closure_state.graph
        piece = self.pieces[number]
        known = KnownMap(piece.scans, piece.poses, np.arange(len(piece)), self._maps[number])
        few = keys[:: -(-len(keys) // _ALIGNED)]
        alignment = Alignment(self._alignment, closure_state, self._mapper, self._places, self._scorer, few, known)
        hypotheses: list[Hypothesis] = []
        for group in group_hits(graph, hits)[:_TRACKED]:
            hypotheses.append(alignment.track_component(group))
            yield None
        best = alignment.decide(hypotheses)
        yield None
        if best is None or best.overlap < _MIN_OVERLAP or best.agreement < _MIN_AGREEMENT:
            return
        constraints = alignment.match_constraints(best)
        tracked = np.array(graph.tracked)
        every = np.arange(len(tracked)) if wanted is None else wanted
        nearest = np.abs(every[:, None] - few).argmin(axis=1)
        poses = compose(best.poses[nearest], between(tracked[few[nearest]], tracked[every]))
        yield PieceMatch(poses, constraints) if constraints else None


@final
class _Search:
    """A search for one submap that is done bit by bit: `hits` in each piece so far, by its number."""

    def __init__(self, submap: Submap, work: Iterator[FoundPiece | None]) -> None:
        self.hits: dict[int, list[SearchHit]] = {}
        self._submap = submap
        self._work = work
        self._done = 0
        self._found: FoundPiece | None = None

    def is_for(self, submap: Submap) -> bool:
        """Whether it is one for the same submap."""
        own = self._submap
        return np.array_equal(own.poses, submap.poses) and np.array_equal(own.collect_points(), submap.collect_points())

    def advance(self, steps: int) -> FoundPiece | None:
        """Go on until `steps` of the work are done, and return what was found by then."""
        while self._done < steps:
            self._found = next(self._work, self._found)
            self._done += 1
        return self._found


def _select_distinct(proposed: list[tuple[int, FloatArray]], most: int) -> list[tuple[int, FloatArray]]:
    """Select the first of proposals whose poses (3,) are not the same place as others before."""
    chosen: list[tuple[int, FloatArray]] = []
    for proposal in proposed:
        if len(chosen) == most:
            break
        if not any(_is_near(pose, proposal[1], _SAME_M, _SAME_RAD) for _, pose in chosen):
            chosen.append(proposal)
    return chosen


def _is_near(expected: FloatArray, pose: FloatArray, most_m: float, most_rad: float) -> bool:
    """Whether a pose (3,) is no farther than this from another."""
    x, y, turn = between(expected, pose).tolist()
    return math.hypot(x, y) < most_m and abs(turn) < most_rad
