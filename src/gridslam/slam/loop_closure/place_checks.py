"""Checks of loop-closure candidates: inlier ratio, beams through walls, consistency."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.key_graph import KeyGraph, SubmapDistance
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_index import anchor_of, first_key_scan
from gridslam.slam.loop_closure.submaps import ROW
from gridslam.types import BeamEnds, FloatArray

__all__ = [
    "collect_recent_points",
    "compute_inlier_ratio",
    "compute_through_walls_ratio",
    "constraint_innovation",
    "is_within_gate",
    "relative_error",
]

_MATCHING = np.diag([0.05, 0.05, 0.02]) ** 2
"""Variances of what two matches of one scan differ by (m^2, m^2, rad^2)."""

_WALL_M = 0.3
"""A beam that ends this far behind a mapped obstacle has passed through it."""


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


def compute_inlier_ratio(
    maps: TileMaps, pose: FloatArray, points: FloatArray, overlap: float, cauchy_m: float
) -> float:
    """Inlier ratio of points (B, 2) at a pose over known cells; 0 if fewer than `overlap` of them are known.

    An end that falls behind a wall's nearest cells, which no beam has seen, is known all the same.
    """
    away = maps.distances(ROW, pose[None], points)[0]
    known = maps.is_known(0, transform_points(pose, points)) | (away < cauchy_m)
    if np.mean(known) < overlap:
        return 0.0
    return float(np.mean(1 / (1 + np.square(away[known] / cauchy_m))))


def is_within_gate(covariance: FloatArray, missed: FloatArray, gate: float) -> bool:
    """Whether the drift explains what a match differs by (3,) from where the robot should be, map frame."""
    return float(missed @ np.linalg.solve(covariance + _MATCHING, missed)) < gate**2


def compute_through_walls_ratio(maps: TileMaps, pose: FloatArray, beams: BeamEnds) -> float:
    """Ratio of beams that, from a pose (3,), would pass through what the map knows as walls."""
    ways = beams.ends - beams.origin
    ranges = np.hypot(ways[:, 0], ways[:, 1])
    seen = maps.cast_rays(ROW, pose[None], beams.origin, ways / ranges[:, None], float(ranges.max()))[0]
    return float(np.mean(seen < ranges - _WALL_M))


def constraint_innovation(graph: KeyGraph, way: SubmapDistance, constraint: Constraint) -> FloatArray:
    """Innovation (3,) of a constraint with respect to the best path through the graph, map frame."""
    expected = between(
        between(graph.tracked[first_key_scan(way.submap)], graph.tracked[anchor_of(way.submap)]), way.pose
    )
    turn = graph.poses[-1][2] - expected[2]
    c, s = math.cos(turn), math.sin(turn)
    x, y = (constraint.measurement - expected)[:2].tolist()
    return np.array([c * x - s * y, s * x + c * y, between(expected, constraint.measurement)[2]])


def relative_error(graph: KeyGraph, earlier: Constraint, later: Constraint) -> FloatArray:
    """Difference (3,) between a later constraint and the prediction from an earlier one by tracked motion."""
    reached = compose(earlier.measurement, between(graph.tracked[earlier.to], graph.tracked[later.to]))
    return between(reached, compose(graph.relative_pose(earlier.from_, later.from_), later.measurement))
