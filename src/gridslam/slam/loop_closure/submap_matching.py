"""Matching of submaps: poses at which keypoints agree, refined and verified in both directions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, transform_points
from gridslam.geometry.single_pose import as_pose, is_within
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import thin_points
from gridslam.matching.gauss_newton import cauchy_weights, degenerate_direction
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submap_features import SubmapFeatures, extract_features, match_features
from gridslam.slam.loop_closure.submaps import ROW, build_map, match_points
from gridslam.slam.loop_closure.walls import find_walls
from gridslam.types import FloatArray, IntArray, Match

_REACH_M = 30.0
"""Beams beyond are far apart, and their ends move with the heading."""
_SAME_M = 0.5
"""Keypoints that agree are no farther apart: the cells of the image, and drift within the submap."""
_SAME_RAD = 0.6
"""So far the directions of matched keypoints may differ."""
_LEAST_BASE_M = 3.0
"""Two keypoints nearer to each other do not determine the heading."""
_MOST_PAIRS = 1500
_SAME_HEADING_RAD = 0.05
_DISTINCT_M = 1.5
_DISTINCT_RAD = 0.15
"""Poses nearer to each other in both are the same."""


@final
@dataclass(frozen=True, eq=False)
class Submap:
    """Key scans along some metres of the way, as tracked, seen from the one in their middle.

    Attributes
    ----------
    anchor : int
        The key scan in the middle, in whose frame everything is.
    keys : (K,) int64
        The key scans.
    poses : (K, 3) float64
        Theirs, seen from the anchor.
    scans : ScanArchive
        Where their beams are.
    mapper : OccupancyGridMapping
        How they are drawn.
    """

    anchor: int
    keys: IntArray
    poses: FloatArray
    scans: ScanArchive
    mapper: OccupancyGridMapping

    @classmethod
    def of(
        cls, graph: KeyGraph, anchor: int, keys: IntArray, scans: ScanArchive, mapper: OccupancyGridMapping
    ) -> Submap:
        """Take key scans (K,) as tracked about the anchor."""
        return cls(anchor, keys, graph.tracked_poses_from(anchor, keys), scans, mapper)

    def collect_points(self) -> FloatArray:
        """Ends (B, 2) of the beams that are not too long."""
        batch = self.scans.batch([self.scans.keys[key] for key in self.keys.tolist()])
        beams = np.diff(batch.starts)
        is_near = np.hypot(*(batch.ends - np.repeat(batch.origins, beams, axis=0)).T) < _REACH_M
        poses = np.repeat(self.poses, beams, axis=0)
        return transform_points(poses[is_near], batch.ends[is_near])

    @cached_property
    def walls(self) -> FloatArray:
        """Ends (B, 2) of the beams that end on walls."""
        scans = [self.scans.key(key) for key in self.keys.tolist()]
        ends = [find_walls(scan) for scan in scans]
        return np.concatenate([transform_points(pose, own) for pose, own in zip(self.poses, ends, strict=True)])

    @cached_property
    def features(self) -> SubmapFeatures:
        """Keypoints and descriptors."""
        return extract_features(self.collect_points())

    @cached_property
    def radius_m(self) -> float:
        """Distance from the anchor within which everything is."""
        return float(np.hypot(*self.poses[:, :2].T).max()) + 0.5 * _REACH_M

    def draw(self, most: int) -> DrawnSubmap:
        """Build the map, and take at most `most` of the points, spread evenly."""
        maps = build_map(self.mapper, self.scans, self.keys, self.poses)
        return DrawnSubmap(maps, thin_points(self.collect_points(), most))


@final
class DrawnSubmap(NamedTuple):
    """One map, drawn from a submap's key scans, and ends (B, 2) of their beams."""

    maps: TileMaps
    points: FloatArray


MAX_POINTS = 1500
"""Points of each submap that are matched, spread evenly."""
_MIN_KEYPOINTS = 5
"""Matched keypoints that agree on a pose, at least."""
_MAX_POSES = 4
"""Poses of a pair of submaps that are refined, best first."""
_MIN_POINTS = 300
"""Least number of points that lie in what the other submap knows, in both directions."""
_MIN_INFORMATION = 0.06
"""Least eigenvalue of the position's information, per agreeing point: bare corridors are left out."""
_INLIER_RATIO = 0.55
"""Least mean Cauchy weight of the points, in both directions."""
_INLIER_M = 0.2
"""Distance to the other's obstacles at which a point counts half."""
_MAX_CONTRADICTED = 0.2
"""Largest share of these that lie where the other saw free space."""


def verify_pose(old: DrawnSubmap, new: DrawnSubmap, pose: FloatArray) -> Match | None:
    """Refine a proposed pose (3,) of the new submap's frame in the old one's, and verify it in both directions.

    Returns the match of the new one's points in the old one's map; None where it does not fit.
    """
    match = match_points(old.maps, pose[None], new.points)
    (refined,) = match.poses
    if degenerate_direction(match.information[0], float(match.score[0]), _MIN_INFORMATION) is not None:
        return None
    there = _fits(old.maps, refined, new.points)
    return match if there and _fits(new.maps, between(refined, np.zeros(3)), old.points) else None


def is_same_place(pose: FloatArray, other: FloatArray) -> bool:
    """Whether two poses (3,) that were refined are one."""
    return is_within(as_pose(pose), as_pose(other), _INLIER_M, _SAME_HEADING_RAD)


def _fits(maps: TileMaps, pose: FloatArray, points: FloatArray) -> bool:
    """Whether points (B, 2) at a pose (3,) lie on obstacles of a map, many in what it knows, few where it is free."""
    away = maps.distances(ROW, pose[None], points)[0]
    known = away[maps.is_known(0, points, pose) | (away < _INLIER_M)]
    if len(known) < _MIN_POINTS or cauchy_weights(known, _INLIER_M).mean() < _INLIER_RATIO:
        return False
    return bool((known >= 0.9 * maps.reach_m).mean() <= _MAX_CONTRADICTED)


def propose_poses(old: SubmapFeatures, new: SubmapFeatures) -> list[FloatArray]:
    """Propose poses (3,) of one submap in another, with which matched keypoints agree, those of most agreement first.

    Each two matches whose distance is the same in both submaps give one.
    """
    pairs = match_features(old, new)
    rough = poses_of_pairs(old, new, pairs, _MOST_PAIRS)
    a, b = old.points[pairs[:, 0]], new.points[pairs[:, 1]]
    agree = np.square(transform_points(rough[:, None], b) - a).sum(axis=2) < _SAME_M**2
    counts = agree.sum(axis=1)
    taken: list[int] = []
    for place in np.argsort(-counts, kind="stable").tolist():
        if counts[place] < _MIN_KEYPOINTS or len(taken) >= _MAX_POSES:
            break
        pose = as_pose(rough[place])
        if not any(is_within(pose, as_pose(rough[other]), _DISTINCT_M, _DISTINCT_RAD) for other in taken):
            taken.append(place)
    return [_fit(a[agree[place]], b[agree[place]]) for place in taken]


def poses_of_pairs(old: SubmapFeatures, new: SubmapFeatures, pairs: IntArray, most: int) -> FloatArray:
    """Return at most `most` poses (K, 3) that lay two keypoints, of the same distance, on those that they match.

    The directions of the keypoints must agree with it, too.
    """
    a = old.points[pairs[:, 0]]
    b = new.points[pairs[:, 1]]
    turns = wrap(old.headings[pairs[:, 0]] - new.headings[pairs[:, 1]])
    apart_m = _distances(a)
    is_same = np.abs(apart_m - _distances(b)) < _SAME_M
    first, second = np.nonzero(np.triu(is_same & (apart_m > _LEAST_BASE_M)))
    in_old, in_new = a[second] - a[first], b[second] - b[first]
    headings = wrap(np.arctan2(in_old[:, 1], in_old[:, 0]) - np.arctan2(in_new[:, 1], in_new[:, 0]))
    away = np.abs(wrap(headings - turns[np.stack([first, second])]))
    chosen = np.flatnonzero((away < _SAME_RAD).all(axis=0))
    chosen = chosen[:: max(1, -(-len(chosen) // most))]
    first, second = first[chosen], second[chosen]
    poses = np.column_stack([np.zeros((len(chosen), 2)), headings[chosen]])
    poses[:, :2] = 0.5 * (a[first] + a[second]) - transform_points(poses, 0.5 * (b[first] + b[second]))
    return poses


def _distances(points: FloatArray) -> FloatArray:
    """Distances (K, K) of points (K, 2) from each other."""
    x, y = (np.subtract.outer(along, along) for along in points.T)
    return np.asarray(np.sqrt(x * x + y * y))


def _fit(a: FloatArray, b: FloatArray) -> FloatArray:
    """Pose (3,) that lays points `b` (K, 2) on `a` (K, 2) in the least squares."""
    middle_a = a.mean(axis=0)
    middle_b = b.mean(axis=0)
    (xx, xy), (yx, yy) = ((b - middle_b).T @ (a - middle_a)).tolist()
    turn = math.atan2(xy - yx, xx + yy)
    return np.append(middle_a - transform_points(np.array([0.0, 0.0, turn]), middle_b[None])[0], turn)
