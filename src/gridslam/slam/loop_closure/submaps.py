"""Submaps: local maps of consecutive key scans, built on demand."""

from __future__ import annotations

import math

import numpy as np

from gridslam.grid.cells import LOG_ODDS_UNIT
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import NO_PRIOR, GaussNewton
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph, anchor_of
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.types import FloatArray, Int32Array, IntArray, Match, StoredScan

ROW: Int32Array = np.array([0], np.int32)
"""The one row of a submap."""

_COARSE = GaussNewton(cauchy_m=0.3, max_iterations=20, point_to_line=False)
_FINE = GaussNewton(cauchy_m=0.15)
DIRECTIONS = np.column_stack([np.cos(np.arange(8) * math.pi / 4), np.sin(np.arange(8) * math.pi / 4), np.zeros(8)])
"""Directions (8, 3) in which places lie beside one."""

_CHANGED = 0.05
"""Share of the cells of a place that change from one drive to the next: furniture and doors, hardly ever walls."""
_CERTAIN = math.log((1 - _CHANGED) / _CHANGED)
_LEAST_ABOVE = 0.4
"""Nats by which an obstacle stays above any threshold: one beam through it."""


def key_scans_of(submap: int, graph: KeyGraph) -> IntArray:
    """Key scans of a submap that no gap in the laser data separates from its anchor."""
    first = submap * KEY_SCANS_PER_SUBMAP
    return graph.select_without_gap(np.arange(first, first + KEY_SCANS_PER_SUBMAP), anchor_of(submap))


def match_points(maps: TileMaps, poses: FloatArray, points: FloatArray) -> Match:
    """Match points (B, 2) to the one map of `maps` from each of some poses (K, 3): coarsely, then finely from there."""
    scan = StoredScan(points, np.zeros(2))
    rows = np.zeros(len(poses), np.int32)
    priors = np.broadcast_to(NO_PRIOR, (len(poses), 3, 3)).copy()
    match = _COARSE(maps, rows, poses, priors, scan)
    return _FINE(maps, rows, match.poses, priors, scan)


def insert_key_scans(
    maps: TileMaps,
    scans: ScanArchive,
    keys: range,
    poses: FloatArray,
    graph: KeyGraph,
) -> None:
    """Draw some of the key scans, all of which are at poses (T, 3), into the one map of `maps`, drive by drive.

    What earlier drives have drawn is no longer certain when the next one begins: a cell may have changed in between,
    with probability p. A binary Markov chain leaves at most log((1 - p) / p) of its log-odds then, 2.9 nats: what has
    gone is free after 11 beams through it, and what is new stands after three that end there. So the map fades by
    visits, however much time there is between them; what is not seen again stays as it is.

    References
    ----------
    Meyer-Delius, Beinhofer, Burgard, Occupancy grid models for robot mapping in changing environments (2012); Yguel,
    Aycard, Laugier, Update policy of dense maps (2008), of the limit.
    """
    for key in keys:
        if graph.begins_drive(key):
            fade(maps)
        maps.update(ROW, poses[key : key + 1], scans.key(key))


def fade(maps: TileMaps) -> None:
    """Limit the log-odds of a map to those at the start of the next drive; see `insert_key_scans`."""
    maps.limit(max(_CERTAIN, maps.evidence.occupied_above * LOG_ODDS_UNIT + _LEAST_ABOVE))


def build_map(mapper: OccupancyGridMapping, scans: ScanArchive, keys: IntArray, poses: FloatArray) -> TileMaps:
    """Build a map of key scans `keys` (K,) at poses (K, 3)."""
    maps = mapper.empty(1)
    for key, pose in zip(keys.tolist(), poses, strict=True):
        maps.update(ROW, pose[None], scans.key(key))
    return maps


def draw_submap(submap: int, mapper: OccupancyGridMapping, scans: ScanArchive, graph: KeyGraph) -> TileMaps:
    """Draw a submap that is complete, in the frame of its anchor: its scans lie as tracked, whatever is corrected."""
    keys = key_scans_of(submap, graph)
    anchor = anchor_of(submap)
    return build_map(mapper, scans, keys, graph.tracked_poses_from(anchor, keys))
