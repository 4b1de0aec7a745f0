"""Merging: pieces of several robots or days become one map where they show the same places."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.se2 import between, compose, inverse
from gridslam.geometry.single_pose import as_pose, is_within
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.types import FloatArray, IntArray

_WINDOW = 90
"""Key scans that are aligned together, about 40 m: as many as locate a drive while it is driven."""
_STRIDE = 45
_GOLDEN_RATIO = 0.618
"""Windows are aligned in an order by it, so that the first few are spread over the piece."""
_ENOUGH = 3
"""Number of agreeing windows that join two pieces; the final refinement finds further overlaps."""
_MOST_WINDOWS = 12
"""Number of windows of an earlier piece that are aligned with a later one, 0.1 s each."""
_AGREE_M = 1.0
_AGREE_RAD = 0.1
"""Windows agree if they have one piece's frame in the other this close together; drives bend by less in 40 m."""


@final
class MergedPiece(NamedTuple):
    """A piece that was merged from some of those given.

    Attributes
    ----------
    members : tuple of int
        Their places among those given, in the order of their key scans.
    piece : MapPiece
        The piece, in the frame of the first member; not refined yet.
    """

    members: tuple[int, ...]
    piece: MapPiece


@final
class _Link(NamedTuple):
    """Two pieces that show the same places: the frame of `to` (3,) in that of `from_`, and the constraints."""

    from_: int
    to: int
    frame: FloatArray
    constraints: list[Constraint]


def merge_pieces(
    pieces: Sequence[MapPiece],
    mapper: OccupancyGridMapping,
    closure: LoopClosure,
    on_progress: Callable[[], None] = lambda: None,
) -> list[MergedPiece]:
    """Merge pieces that show the same places; the others stay apart.

    Each piece is searched in each one before it, or that one in it. Links of two pieces are taken in the order of how
    many constraints they have; those that contradict what is joined already are left out.

    Parameters
    ----------
    pieces : sequence of MapPiece
        In an order that does not depend on chance: frames and numbers follow it.
    mapper, closure
        As in the runs.
    on_progress
        Called once for each pair of pieces.

    Returns
    -------
    list of MergedPiece
        Those with the first given pieces first.
    """
    links: list[_Link] = []
    for to, later in enumerate(pieces):
        for from_, earlier in enumerate(pieces[:to]):
            on_progress()
            link = _link(earlier, later, mapper, closure.places)
            if link is not None:
                links.append(_Link(from_, to, *link))
    links.sort(key=lambda link: (-len(link.constraints), link.from_, link.to))
    frames = _lay_out(len(pieces), links)
    merged = []
    for root in sorted({root for root, _ in frames}):
        members = tuple(k for k, (own, _) in enumerate(frames) if own == root)
        merged.append(MergedPiece(members, _append(pieces, members, frames, links)))
    return merged


def _link(
    earlier: MapPiece, later: MapPiece, mapper: OccupancyGridMapping, places: PlaceMatching
) -> tuple[FloatArray, list[Constraint]] | None:
    """Find the frame (3,) of a piece in another one's, and constraints between them; None if that is not certain.

    The later one is located in the map of the earlier one, or else that one in its map: where people walk about in one
    of the drives its scans contradict the other's map, whereas the other's scans fit its own.
    """
    link = _locate(earlier, later, _windows(later), mapper, places)
    if link is None:
        link = _locate(later, earlier, islice(_windows(earlier), _MOST_WINDOWS), mapper, places)
        link = link and (inverse(link[0]), [constraint.reverse() for constraint in link[1]])
    return link


def _locate(
    earlier: MapPiece,
    later: MapPiece,
    windows: Iterable[IntArray],
    mapper: OccupancyGridMapping,
    places: PlaceMatching,
) -> tuple[FloatArray, list[Constraint]] | None:
    """Locate windows (K,) of a piece in the map of another one; most of those that are found must agree."""
    located = EarlierPieces([earlier], mapper, places)
    state = LoopClosureState(scans=later.scans, graph=later.graph)
    poses = later.poses
    groups: list[list[tuple[FloatArray, list[Constraint]]]] = []
    for window in windows:
        found = located.align(state, 0, window)
        if found is None:
            continue
        match = found.match
        middle = len(window) // 2
        frame = compose(match.poses[window[middle]], inverse(poses[window[middle]]))
        for group in groups:
            if _agree(group[0][0], frame, poses[window[middle]]):
                group.append((frame, match.constraints))
                break
        else:
            groups.append([(frame, match.constraints)])
        groups.sort(key=len, reverse=True)
        if len(groups[0]) >= _ENOUGH + sum(map(len, groups[1:])):
            break
    if not groups or len(groups[0]) <= 2 * sum(map(len, groups[1:])):
        whole = located.align(state, 0, np.arange(len(later)))
        if whole is None:
            return None
        return compose(whole.match.poses[0], inverse(poses[0])), whole.match.constraints
    joined = {constraint.pair: constraint for _, constraints in groups[0] for constraint in constraints}
    return groups[0][0][0], list(joined.values())


def _windows(piece: MapPiece) -> Iterator[IntArray]:
    """Consecutive key scans without a gap, from all over the piece in turn."""
    labels = piece.graph.label_gaps()
    windows = []
    for label in np.unique(labels):
        keys = np.flatnonzero(labels == label)
        starts = range(0, max(len(keys) - _WINDOW, 0) + _STRIDE, _STRIDE)
        windows += [keys[max(0, min(start, len(keys) - _WINDOW)) :][:_WINDOW] for start in starts]
    for number in sorted(range(len(windows)), key=lambda number: number * _GOLDEN_RATIO % 1):
        yield windows[number]


def _agree(frame: FloatArray, other: FloatArray, pose: FloatArray) -> bool:
    """Whether two frames of a piece have a pose (3,) of it at nearly the same place."""
    here, there = (as_pose(compose(each, pose)) for each in (frame, other))
    return is_within(here, there, _AGREE_M, _AGREE_RAD)


def _lay_out(count: int, links: Sequence[_Link]) -> list[tuple[int, FloatArray]]:
    """For each piece the first one that it is joined with, and its frame (3,) in that one's."""
    frames = [(k, np.zeros(3)) for k in range(count)]
    for link in links:
        (root, at), (other, there) = frames[link.from_], frames[link.to]
        if root == other:
            continue
        moved = compose(compose(at, link.frame), inverse(there))  # the other root's frame in this root's
        if other < root:
            root, other, moved = other, root, inverse(moved)
        frames = [(root, compose(moved, frame)) if own == other else (own, frame) for own, frame in frames]
    return frames


def _append(
    pieces: Sequence[MapPiece],
    members: Sequence[int],
    frames: Sequence[tuple[int, FloatArray]],
    links: Sequence[_Link],
) -> MapPiece:
    """Join pieces in their order, with the constraints of all links that do not contradict where they lie."""
    whole = pieces[members[0]]
    firsts = {members[0]: 0}
    for member in members[1:]:
        firsts[member] = len(whole)
        own = []
        for link in links:
            if link.to != member or link.from_ not in firsts:
                continue
            expected = between(frames[link.from_][1], frames[member][1])
            if _agree(expected, link.frame, pieces[member].poses[link.constraints[0].to]):
                own += [c._replace(from_=firsts[link.from_] + c.from_) for c in link.constraints]
        whole = whole.append(pieces[member], PieceMatch(compose(frames[member][1], pieces[member].poses), own))
    return whole
