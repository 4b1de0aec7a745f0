"""Convert a known map to a map piece by simulated scans."""

from __future__ import annotations

import math

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import transform_points
from gridslam.geometry.single_pose import as_pose
from gridslam.localization.known_map import KnownMap
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.types import FloatArray, OccupancyGrid, StoredScan

_SPACING_M = 1.0
_CLEARANCE_M = 0.15
"""Clearance of simulated poses from obstacles, m; a robot's radius would miss structure in narrow gaps."""
_BEAMS = 720
_SURE_M2 = 1e-6
_SURE_RAD2 = 1e-8
"""A given map is as it is: its places are known from each other."""


def piece_of_map(grid: OccupancyGrid, range_max_m: float = 30.0) -> MapPiece:
    """Convert a known map, such as `gridslam.io.maps.read_map` reads, to a piece in which drives are relocalized.

    Its key scans are cast in the map, 720 beams from a place in each square metre of free space, in an order in which
    neighbours follow one another. A beam ends at the first occupied cell; one that leaves the known map before is left
    out, as are walls that are seen from no free place.

    Parameters
    ----------
    grid : OccupancyGrid
        The map; free below probability 0.196, occupied above 0.65.
    range_max_m : float, m, > 0
        Farthest end of a beam.

    Raises
    ------
    ArgumentError
        No cell is free or none is occupied, or no free place sees an obstacle.
    """
    if not range_max_m > 0:
        raise ArgumentError("range_max_m", "a range above 0 m", range_max_m)
    known = KnownMap(grid)
    occupied = KnownMap(_block_unknown(grid, known))
    angles = math.tau / _BEAMS * np.arange(_BEAMS)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    scans = ScanArchive()
    graph = KeyGraph()
    for place in _order(known.lattice(_SPACING_M, _CLEARANCE_M)):
        pose = np.append(place, 0.0)
        ranges = occupied.cast_rays(np.zeros(1, np.int32), pose[None], np.zeros(2), directions, range_max_m)[0]
        ends = directions * ranges[:, None].astype(np.float64)
        hits = ends[(ranges < range_max_m) & _is_occupied(grid, known, transform_points(pose, ends))]
        if len(hits):
            scans.append(StoredScan(hits, np.zeros(2)), as_pose(pose), is_key=True)
            graph.extend(pose, pose, (_SURE_M2, _SURE_RAD2))
    if not len(graph):
        raise ArgumentError("map", "a free place from which an obstacle is seen", "none")
    return MapPiece(scans, graph)


def _block_unknown(grid: OccupancyGrid, known: KnownMap) -> OccupancyGrid:
    """Return the map with every cell that is not free as an obstacle, so that no beam crosses unknown cells."""
    log_odds = np.where(known.free, -10.0, 10.0).astype(np.float32)
    return OccupancyGrid(log_odds, np.ones_like(known.free), grid.resolution_m, grid.origin)


def _is_occupied(
    grid: OccupancyGrid, known: KnownMap, points: FloatArray
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return whether points (B, 2) of the map lie in occupied cells."""
    column, row = np.floor((points - grid.origin) / grid.resolution_m).astype(np.int64).T
    height, width = grid.shape
    inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
    return np.asarray(inside & known.occupied[np.where(inside, row, 0), np.where(inside, column, 0)])


def _order(places: FloatArray) -> FloatArray:
    """Order places (N, 2) by a walk that always continues to the nearest one left."""
    left = places.copy()
    walk = np.empty_like(places)
    here = left.min(axis=0) if len(left) else np.zeros(2)
    for step in range(len(walk)):
        nearest = int(np.square(left[: len(left) - step] - here).sum(axis=1).argmin())
        here = walk[step] = left[nearest].copy()
        left[nearest] = left[len(left) - step - 1]
    return walk
