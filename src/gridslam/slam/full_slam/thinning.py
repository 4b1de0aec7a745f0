"""Lifelong mapping: a piece forgets drives whose places newer ones have seen, so that the place bounds its size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.full_trajectory import TrackedScans
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.submaps import build_map
from gridslam.types import IntArray

_LEAST_SHARE = 0.15
"""A drive is kept for more than this share of the cells that it sees: single beams reach where no other one happened
to."""


@final
class ThinnedPiece(NamedTuple):
    """A piece without the drives that newer ones have superseded.

    Attributes
    ----------
    piece : MapPiece
        What is left of it, at the same poses.
    drives : list of TrackedScans
        Its drives, those that were forgotten without scans.
    key_scans, scans : (K,), (N,) int64
        Numbers that the key scans and the scans had before.
    """

    piece: MapPiece
    drives: list[TrackedScans]
    key_scans: IntArray
    scans: IntArray


def thin_piece(piece: MapPiece, drives: Sequence[TrackedScans], mapper: OccupancyGridMapping) -> ThinnedPiece:
    """Remove the drives of a piece all of whose cells two newer drives have seen since.

    One shows a place as it is now, and another one keeps it where the first saw it from one side only.
    A drive adds something if more than 15 % of the cells that it sees were seen in fewer than two later drives. Time
    does not matter: a place that is never visited again is never forgotten. Drives that hold others together are kept,
    too: what was one rigid component remains one. So the place bounds the size of a piece, however often it is visited.

    The poses of what is left do not move. Scans between key scans keep their beams in the newest drive alone: once a
    drive and the one after it were refined they are not matched again, and lie as tracked between the key scans.

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
    before = np.concatenate([np.zeros(0, np.int64), *(drive.keys for drive in drives[:-1])])
    bare = np.flatnonzero(np.diff(before, prepend=-1) == 0)
    key_of = np.searchsorted(piece.scans.keys, np.arange(len(piece.scans)), "right") - 1
    scans = np.flatnonzero(np.isin(key_of, kept))
    return ThinnedPiece(
        MapPiece(piece.scans.select(scans, bare), piece.graph.select(kept)),
        [_select_scans(drive, kept) for drive in drives],
        kept,
        scans,
    )


def _select_scans(drive: TrackedScans, kept: IntArray) -> TrackedScans:
    """The scans of a drive if its key scans are among those that are kept (K,), counted among these; none if not."""
    own = np.isin(drive.keys, kept)
    poses = None if drive.poses is None else drive.poses[own]
    return TrackedScans(np.searchsorted(kept, drive.keys[own]), drive.key_from_base[own], poses)


def _select_key_scans(piece: MapPiece, mapper: OccupancyGridMapping) -> IntArray:
    """Key scans (K,) of the drives that add something, and of those that hold others together."""
    graph = piece.graph
    drive_of = np.cumsum([graph.begins_drive(key) for key in range(len(graph))], dtype=np.int64)
    is_kept = _find_needed(piece, drive_of, mapper)
    whole = graph.label_rigid_components()
    for drive in np.flatnonzero(~is_kept).tolist():  # the oldest first
        kept = np.flatnonzero(is_kept[drive_of] | (drive_of > drive))
        parts = graph.select(kept).label_rigid_components()
        is_kept[drive] = len(np.unique(parts)) > len(np.unique(whole[kept]))
    return np.flatnonzero(is_kept[drive_of])


def _find_needed(piece: MapPiece, drive_of: IntArray, mapper: OccupancyGridMapping) -> NDArray[np.bool_]:
    """Whether each drive adds something to the newer ones, which are looked at first; `drive_of` each key scan (T,)."""
    needed = np.zeros(drive_of.max(initial=0) + 1, np.bool_)
    once = twice = np.empty(0, np.int64)
    for drive in range(len(needed) - 1, -1, -1):
        keys = np.flatnonzero(drive_of == drive)
        cells = _list_known_cells(build_map(mapper, piece.scans, keys, piece.poses[keys]))
        needed[drive] = drive == len(needed) - 1 or np.isin(cells, twice, invert=True).mean() > _LEAST_SHARE
        if needed[drive]:
            twice = np.union1d(twice, np.intersect1d(once, cells))
            once = np.union1d(once, cells)
    return needed


def _list_known_cells(maps: TileMaps) -> IntArray:
    """Numbers (K,) of the cells that the one map of `maps` knows, the same in all maps."""
    ids, corner = maps.tile_ids(0)
    places = np.argwhere(ids)
    tile, row, column = np.nonzero(maps.tiles(ids[tuple(places.T)]) != UNKNOWN)
    rows, columns = (TILE * (places + corner)[tile] + np.stack([row, column], axis=1)).T
    return np.asarray((rows << 32) + columns, np.int64)
