"""Relocalize the robot in maps of earlier drives, by its scans alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.component_alignment import (
    LENGTH_M,
    MIN_CONSTRAINTS,
    Alignment,
    Hypothesis,
    KnownMap,
    SearchHit,
    group_hits,
    match_submap,
)
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.map_search import MapSearch
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import FoundPiece, LoopClosureState
from gridslam.slam.loop_closure.submap_matching import Submap
from gridslam.types import FloatArray, IntArray

_NEAR_M = 5.0
_NEAR_RAD = 0.5
"""So far from a pose that was given the drive may begin."""

_FIRST_M = 5.0
"""A drive is not compared before this many metres: less of it looks alike in too many places."""

_LAST_M = 40.0
"""Last metres of a drive by which it is located: its way before may lie beyond the map."""

_COMPARED = 4
_COMPARED_AT_A_TIME = 2
_SHARES = 2 + _COMPARED // _COMPARED_AT_A_TIME
"""Hypotheses that are compared, and key scans over which the work is spread: one searches, in 20 ms, some compare two
hypotheses each, in 15 ms each, and the last one decides, in 40 ms."""

_EAGER_M = 22.0
_INTERVAL = 4 * _SHARES
"""Up to the first number of metres one search follows the other, later they begin this many key scans apart: even in
rooms that are all alike, searching then costs little more than mapping."""

_ALIGNED = 45
"""Key scans of a drive, spread evenly, that are laid on a piece."""

_MIN_LOG_LIKELIHOOD = 20.0
"""Nats. A whole floor has some ten million places to be, 16 nats, where a drift allows for few; in other buildings the
best place had -12 at most."""

_AMBIGUITY_RATIO = 0.5
"""Maximum evidence for any other place, as a fraction of the best."""

_MIN_OVERLAP = 0.4
"""Ratio of beams that end in known cells of the piece: beams that end outside of it contradict nothing. In other
buildings the best places had 0.16 to 0.22, all but off the map; right ones 0.77 to 0.99."""

_MIN_AGREEMENT = 0.9
"""Agreement (see `score_trajectory`) of those that do: on another floor of equal rooms 0.80, in right places from 0.93,
where people walk about, to 0.99."""


@final
class EarlierPieces:
    """Locates a drive in earlier pieces: submaps of its way are searched in their maps (see `MapSearch`).

    What is found is judged as with a component behind a gap in the laser data (see `align_components`), but nothing
    is known of the drift: the drive is laid on the piece's map at each place where submaps of it fit, and if
    only one of them explains it, it is found. While the robot drives, the work is spread over key scans by counts
    alone, and pieces take turns.

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
    begin : (3,) float64, optional
        Where the drive begins in the first piece, within 5 m and half a radian; it is searched for there alone.
    """

    def __init__(
        self,
        pieces: Sequence[MapPiece],
        mapper: OccupancyGridMapping,
        places: PlaceMatching,
        begin: FloatArray | None = None,
    ) -> None:
        self.pieces = list(pieces)
        self._mapper = mapper
        self._places = places
        self._begin = begin
        self._searches = [MapSearch(piece.build_map(mapper)) for piece in self.pieces]
        self._turns = len(self.pieces) if begin is None else 1
        self._hits: dict[tuple[int, int, bytes], list[SearchHit]] = {}
        self._known = b""  # key scans that are aligned at present
        self._work: Iterator[_Aligned | None] = iter(())
        self._done: list[_Aligned | None] = []  # what each share of the work has brought

    def locate(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Do the newest key scan's share of the search, and give the piece in which the drive so far is found."""
        way = closure_state.graph.driven_m()
        newest = len(way) - 1
        begins = _list_begins(way)
        if not begins:
            return None
        last = begins[-1]
        number = (len(begins) - 1) % self._turns
        keys = closure_state.graph.select_without_gap(_select_last(way[: last + 1], _LAST_M), last)
        known = _tracked_at(closure_state.graph, keys)
        if known != self._known:
            self._known, self._done = known, []
            self._work = self._align_in_shares(closure_state, number, keys)
        while len(self._done) <= newest - last:
            self._done.append(next(self._work, None))
        aligned = self._done[newest - last]
        return None if aligned is None else self._find(closure_state, number, aligned)

    def locate_whole(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Give the first piece in which a drive that has ended is found as a whole.

        In rooms that are all alike no part of a drive is certain, but as a whole it lies in one place alone.
        """
        keys = np.arange(len(closure_state.graph))
        found = (self.align(closure_state, number, keys) for number in range(self._turns))
        return next(filter(None, found), None)

    def align(self, closure_state: LoopClosureState, number: int, keys: IntArray) -> FoundPiece | None:
        """Align consecutive key scans (K,) of a drive with piece `number`; None if that is not certain.

        The match has the poses of all key scans of the drive.
        """
        aligned = next(filter(None, self._align_in_shares(closure_state, number, keys)), None)
        return None if aligned is None else self._find(closure_state, number, aligned)

    def _find(self, closure_state: LoopClosureState, number: int, aligned: _Aligned) -> FoundPiece:
        """Lay the key scans that were not aligned as they were tracked from the nearest one that was."""
        tracked = np.array(closure_state.graph.tracked)
        nearest = np.abs(np.arange(len(tracked))[:, None] - aligned.keys).argmin(axis=1)
        poses = compose(aligned.poses[nearest], between(tracked[aligned.keys[nearest]], tracked))
        match = PieceMatch(poses, aligned.constraints)
        return FoundPiece(number, self.pieces[number], self._searches[number].maps, match)

    def _align_in_shares(
        self, closure_state: LoopClosureState, number: int, keys: IntArray
    ) -> Iterator[_Aligned | None]:
        """Align key scans (K,) with a piece, one share of the work after the other."""
        graph, piece = closure_state.graph, self.pieces[number]
        begins = _list_begins(graph.driven_m()[: keys[-1] + 1])
        searched = [key for key in begins[number :: self._turns] if key >= keys[0]]
        hits = [hit for key in searched for hit in self._search(closure_state, number, key)]
        groups = group_hits(graph, [hit for hit in hits if hit.key >= keys[0]])
        yield None
        few = keys[:: -(-len(keys) // _ALIGNED)]
        known = KnownMap(piece.scans, piece.poses, np.arange(len(piece)), self._searches[number].maps)
        alignment = Alignment(closure_state, self._mapper, self._places, few, known)
        if self._begin is None:
            alignment = replace(alignment, min_log_likelihood=_MIN_LOG_LIKELIHOOD, ambiguity_ratio=_AMBIGUITY_RATIO)
        hypotheses: list[Hypothesis] = []
        for first in range(0, min(len(groups), _COMPARED), _COMPARED_AT_A_TIME):
            hypotheses += [alignment.lay_component(group) for group in groups[first : first + _COMPARED_AT_A_TIME]]
            yield None
        best = alignment.decide([each for each in hypotheses if _is_plausible(each)])
        if best is not None:
            constraints = alignment.match_constraints(best)
            is_enough = len(constraints) >= MIN_CONSTRAINTS
            if is_enough and any(constraint.determined for constraint in constraints):
                yield _Aligned(few, best.poses, constraints)

    def _search(self, closure_state: LoopClosureState, number: int, key: int) -> list[SearchHit]:
        """Search a piece for the submap that ends at a key scan: where most of its points agree."""
        graph = closure_state.graph
        keys = graph.select_without_gap(_select_last(graph.driven_m()[: key + 1], LENGTH_M), key)
        known = (number, key, _tracked_at(graph, keys))
        if known not in self._hits:
            submap = Submap.of(graph, int(keys[len(keys) // 2]), keys, closure_state.scans, self._mapper)
            moved = between(graph.tracked[0], graph.tracked[submap.anchor])
            near = None if self._begin is None else compose(self._begin, moved)
            self._hits[known] = match_submap(self._searches[number], submap, near, _NEAR_M, _NEAR_RAD)
        return self._hits[known]


@final
class _Aligned(NamedTuple):
    """Key scans (K,) of a drive, their poses (K, 3) in a piece, and their constraints."""

    keys: IntArray
    poses: FloatArray
    constraints: list[Constraint]


def _is_plausible(hypothesis: Hypothesis) -> bool:
    """Return whether a drive may lie there; a place that contradicts it is no alternative to another one, either."""
    return hypothesis.overlap >= _MIN_OVERLAP and hypothesis.agreement >= _MIN_AGREEMENT


def _tracked_at(graph: KeyGraph, keys: IntArray) -> bytes:
    """Return the tracked poses of key scans (K,), by which they are known."""
    return np.array([graph.tracked[key] for key in keys.tolist()]).tobytes()


def _select_last(way: FloatArray, metres: float) -> IntArray:
    """Select the key scans of the last metres of a way, given the metres driven (T,) up to each."""
    return np.flatnonzero(way >= way[-1] - metres)


def _list_begins(way: FloatArray) -> list[int]:
    """List the key scans at which a search begins, given the metres driven (T,) up to each."""
    first, late = np.searchsorted(way, [_FIRST_M, _EAGER_M]).tolist()
    return [*range(first, late, _SHARES), *range(late, len(way), _INTERVAL)]
