"""Lifelong mapping: a piece forgets parts that newer drives have seen, so that its size is bounded by the place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.se2 import between
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import UNKNOWN
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.full_trajectory import TrackedScans
from gridslam.slam.full_slam.marginalization import marginalize
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.submaps import build_map
from gridslam.types import IntArray

_DRIVES = 2
"""Number of newest drives kept per cell: one shows the place as it is now, and another one keeps it where the first saw
it from one side only."""

_LEAST_SHARE = 0.15
"""A submap is kept for more than this share of the cells that it sees: single beams reach where no other one happened
to."""


@final
class ThinnedPiece(NamedTuple):
    """A piece without the parts that newer drives have seen.

    Attributes
    ----------
    piece : MapPiece
        What is left of it, at the same poses.
    drives : list of TrackedScans
        What is left of the drives, those of which nothing is left included.
    key_scans, scans : (K,), (N,) int64
        Numbers that the key scans and the scans had before.
    """

    piece: MapPiece
    drives: list[TrackedScans]
    key_scans: IntArray
    scans: IntArray


def thin_piece(piece: MapPiece, drives: Sequence[TrackedScans], mapper: OccupancyGridMapping) -> ThinnedPiece:
    """Remove the submaps of a piece whose cells two newer drives have seen since.

    A submap, of ten consecutive key scans, adds something if more than 15 % of the cells that it sees were seen in
    fewer than two later drives. Time does not matter: a place that is never visited again is never forgotten. Submaps
    that hold others together are kept, too: what was one rigid component remains one. So the size of a piece is that of
    two drives through all that was ever seen, however often it is visited.

    The poses of what is left do not move, nor is anything known of them that was not known before (see `marginalize`).
    Scans between key scans keep their beams in the newest drive alone: once a drive and the one after it were refined
    they are not matched again, and lie as tracked between the key scans.

    Parameters
    ----------
    piece : MapPiece
        Refined: its poses are final until a later drive is joined with it. It is not modified.
    drives : sequence of TrackedScans
        The scans of its drives, in the order of their key scans.
    mapper : OccupancyGridMapping
        How its map is drawn.

    References
    ----------
    Kretzschmar, Stachniss, Information-theoretic compression of pose graphs for laser-based SLAM (2012): scans are left
    out by what they add to the map. Biber, Duckett, Experimental analysis of sample-based maps for long-term SLAM
    (2009), of samples that recent visits replace.
    """
    kept = _select_key_scans(piece, mapper)
    bare = _find_bare(drives)
    if len(kept) == len(piece) and not len(bare):
        return ThinnedPiece(piece, list(drives), kept, np.arange(len(piece.scans)))
    graph = marginalize(piece.graph, kept)
    key_of = np.searchsorted(piece.scans.keys, np.arange(len(piece.scans)), "right") - 1
    scans = np.flatnonzero(np.isin(key_of, kept))
    return ThinnedPiece(
        MapPiece(piece.scans.select(scans, bare), graph),
        [_select_scans(drive, kept, graph) for drive in drives],
        kept,
        scans,
    )


def _find_bare(drives: Sequence[TrackedScans]) -> IntArray:
    """Scans between the key scans of all drives but the newest."""
    keys = np.concatenate([np.zeros(0, np.int64), *(drive.keys for drive in drives[:-1])])
    return np.flatnonzero(np.diff(keys, prepend=-1) == 0)


def _select_key_scans(piece: MapPiece, mapper: OccupancyGridMapping) -> IntArray:
    """Key scans (K,) of the submaps that add something, and of those that hold others together."""
    submap = np.arange(len(piece)) // KEY_SCANS_PER_SUBMAP
    is_kept = _find_needed(piece, mapper)
    while True:
        kept = np.flatnonzero(is_kept[submap])
        missing = [] if is_kept.all() else _find_bridge(piece.graph, kept)
        if not missing:
            return kept
        is_kept[submap[missing]] = True


def _find_needed(piece: MapPiece, mapper: OccupancyGridMapping) -> NDArray[np.bool_]:
    """Whether each submap adds something to the newer ones, which are looked at first."""
    graph = piece.graph
    drive = np.cumsum([graph.begins_drive(key) for key in range(len(graph))])
    count = -(-len(piece) // KEY_SCANS_PER_SUBMAP)
    needed = np.zeros(count, np.bool_)
    sights = _Sights()
    poses = piece.poses
    for number in range(count - 1, -1, -1):
        keys = np.arange(number * KEY_SCANS_PER_SUBMAP, min((number + 1) * KEY_SCANS_PER_SUBMAP, len(piece)))
        maps = build_map(mapper, piece.scans, keys, poses[keys])
        needed[number] = sights.add(maps, int(drive[keys[len(keys) // 2]])) or number == count - 1
    return needed


@final
class _Sights:
    """For each cell the number of drives that saw it, newest first, and the last of them."""

    def __init__(self) -> None:
        self._tiles: dict[tuple[int, int], tuple[NDArray[np.int32], NDArray[np.int32]]] = {}

    def add(self, maps: TileMaps, drive: int) -> bool:
        """Add the cells that are known to the one map of `maps`, of a drive, if that is needed.

        It is if enough of them were seen in fewer than two other drives among what was added before, which is newer.
        """
        ids, (tile_row, tile_column) = maps.tile_ids(0)
        places = np.argwhere(ids)
        cells = maps.tiles(ids[tuple(places.T)]) != UNKNOWN
        own = []
        needed = 0
        for (row, column), known in zip((places + np.array([tile_row, tile_column])).tolist(), cells, strict=True):
            drives, last = self._tiles.setdefault(
                (row, column), (np.zeros(known.shape, np.int32), np.full(known.shape, -1, np.int32))
            )
            is_another = known & (last != drive)
            others = np.where(is_another, drives, drives - 1)
            needed += int(np.count_nonzero(known & (others < _DRIVES)))
            own.append((drives, last, known, is_another))
        if needed <= _LEAST_SHARE * np.count_nonzero(cells):
            return False
        for drives, last, known, is_another in own:
            drives[is_another] += 1
            last[known] = drive
        return True


def _find_bridge(graph: KeyGraph, kept: IntArray) -> list[int]:
    """Key scans between two parts of one rigid component that fall apart if only `kept` (K,) are; none if none do."""
    whole = graph.label_rigid_components()
    parts = marginalize(graph, kept).label_rigid_components()
    first_part: dict[int, int] = {}
    for label, part in zip(whole[kept].tolist(), parts.tolist(), strict=True):
        if first_part.setdefault(label, part) != part:
            begin = kept[parts == part].tolist()
            ends = set(kept[(parts != part) & (whole[kept] == label)].tolist())
            return _find_way(graph, begin, ends)
    return []


def _find_way(graph: KeyGraph, begin: list[int], ends: set[int]) -> list[int]:
    """The fewest key scans that lead from some to others, over increments without a gap and closures; breadth first."""
    labels = graph.label_gaps()
    joined: dict[int, list[int]] = {}
    for constraint in graph.constraints:
        if constraint.determined and constraint.source is not ConstraintSource.PROXIMITY:
            joined.setdefault(constraint.from_, []).append(constraint.to)
            joined.setdefault(constraint.to, []).append(constraint.from_)
    came_from = dict.fromkeys(begin, -1)
    queue = begin
    while queue:
        following = []
        for key in queue:
            if key in ends:
                way = [key]
                while came_from[way[-1]] >= 0:
                    way.append(came_from[way[-1]])
                return way
            chain = [k for k in (key - 1, key + 1) if 0 <= k < len(labels) and labels[k] == labels[key]]
            for other in chain + joined.get(key, []):
                if other not in came_from:
                    came_from[other] = key
                    following.append(other)
        queue = following
    return []


def _select_scans(drive: TrackedScans, kept: IntArray, graph: KeyGraph) -> TrackedScans:
    """The scans of a drive that key scans of `kept` (K,) are followed by, counted in the graph of these."""
    own = np.isin(drive.keys, kept)
    keys = np.searchsorted(kept, drive.keys[own])
    moved = drive.key_from_base[own].copy()
    arrivals = np.flatnonzero(np.diff(keys, prepend=-1) > 0)
    before = keys[arrivals] - 1
    is_joined = (before >= 0) & (kept[keys[arrivals]] - kept[np.maximum(before, 0)] > 1)
    is_joined[:1] = False  # the first scan of a drive
    tracked = np.array(graph.tracked)
    joined = keys[arrivals[is_joined]]
    moved[arrivals[is_joined]] = between(tracked[joined - 1], tracked[joined])
    return TrackedScans(keys, moved, None if drive.poses is None else drive.poses[own])
