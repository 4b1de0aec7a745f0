"""Search of a whole map for where a submap lies in it, over the full turn."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap_headings
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE
from gridslam.matching.branch_and_bound import thin_points
from gridslam.matching.gauss_newton import cauchy_weights
from gridslam.slam.loop_closure.submap_features import extract_features, match_nearest_features
from gridslam.slam.loop_closure.submap_matching import Submap, poses_of_pairs
from gridslam.slam.loop_closure.submaps import match_points
from gridslam.types import FloatArray

_NEAREST = 5
"""Keypoints of the map that one of a submap is matched with: in a building many look alike."""
_MOST_COMPARED = 2000
_RANKED_POINTS = 200
_REFINED = 32
_REFINED_POINTS = 500
"""Poses that are compared with the map by some points, and of these the best ones, refined with more of them."""
_RANK_M = 0.3
_DISTINCT_M = 0.5
_DISTINCT_RAD = 0.15
"""Poses nearer to each other in both are the same place."""


@final
class MapSearch:
    """Searches a map for submaps: any two keypoints that match in both propose a pose, and the map decides.

    As between two submaps (see `propose_poses`), but the map may be of any size and origin: what is known of it is
    where its obstacles are. A keypoint is matched with several of the map's, and poses are not ranked by how many
    keypoints agree, but by how many points of the submap lie on obstacles.

    Parameters
    ----------
    maps : TileMaps
        One map.
    """

    def __init__(self, maps: TileMaps) -> None:
        self.maps = maps
        self._features = extract_features(_occupied_points(maps), most=100_000)

    def __call__(
        self, submap: Submap, near: FloatArray | None = None, near_m: float = math.inf, near_rad: float = math.inf
    ) -> tuple[FloatArray, FloatArray]:
        """Return the poses (K, 3) where a submap may lie, and the points (B, 2) of it by which they were refined.

        All of them, or those near a pose (3,).
        """
        pairs = match_nearest_features(self._features, submap.features, _NEAREST)
        poses = poses_of_pairs(self._features, submap.features, pairs, _MOST_COMPARED)
        if near is not None:
            away = np.abs(wrap_headings(poses - near))
            poses = poses[(np.hypot(away[:, 0], away[:, 1]) < near_m) & (away[:, 2] < near_rad)]
        if not len(poses):
            return poses, np.empty((0, 2))
        points = submap.collect_points()
        rows = np.zeros(len(poses), np.int32)
        away_m = self.maps.distances(rows, poses, thin_points(points, _RANKED_POINTS))
        poses = _select_distinct(poses, cauchy_weights(away_m, _RANK_M).mean(axis=1))
        few = thin_points(points, _REFINED_POINTS)
        return match_points(self.maps, poses, few).poses, few


def _occupied_points(maps: TileMaps) -> FloatArray:
    """Centres (K, 2) of the occupied cells of the one map, m."""
    fields, ids, corner = maps.field_tiles(0, most_cells=2**16)
    tiles = np.argwhere(ids)
    number, row, column = np.nonzero(fields[ids[ids > 0]] == 255)
    cells = tiles[number] * TILE + np.stack([row, column], axis=1) + corner
    return np.asarray((cells[:, ::-1] + 0.5) * maps.resolution_m, np.float64)


def _select_distinct(poses: FloatArray, weights: NDArray[np.float32]) -> FloatArray:
    """Select the best of poses (K, 3), no two of them the same place."""
    left = poses[np.argsort(-weights, kind="stable")]
    chosen: list[FloatArray] = []
    while len(left) and len(chosen) < _REFINED:
        chosen.append(left[0])
        away = np.abs(wrap_headings(left - left[0]))
        left = left[(np.hypot(away[:, 0], away[:, 1]) >= _DISTINCT_M) | (away[:, 2] >= _DISTINCT_RAD)]
    return np.array(chosen)
