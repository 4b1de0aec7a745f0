"""What speaks for a place or against it: points seen lately, beams through walls, what matches differ by."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.slam.key_graph import BLOCK, KeyGraph, Nearby
from gridslam.slam.memory import Memory
from gridslam.slam.submaps import ROW, anchor_of
from gridslam.slam.ties import Tie
from gridslam.types import BeamEnds, FloatArray

__all__ = ["agreement", "disagreement", "missed_by", "plausible", "recent_points", "through_walls"]

_MATCHING = np.diag([0.05, 0.05, 0.02]) ** 2
"""Variances of what two matches of one scan differ by (m^2, m^2, rad^2)."""

_WALL_M = 0.3
"""A beam that ends so much behind what the map knows has passed through it."""


def recent_points(memory: Memory, key: int, scans: int) -> FloatArray:
    """Points (B, 2) of a key scan and those before it, `scans` in all at most, seen from it.

    None from before the robot went on blindly.
    """
    graph = memory.graph
    keys = graph.unbroken(np.arange(max(key - scans + 1, 0), key + 1), key)
    tracked = graph.tracked_from(key, keys)
    points = [transform_points(pose, memory.scans.key(k).ends) for k, pose in zip(keys.tolist(), tracked, strict=True)]
    return np.concatenate(points)


def agreement(maps: TileMaps, pose: FloatArray, points: FloatArray, overlap: float, cauchy_m: float) -> float:
    """How well points (B, 2), seen from a pose, agree with what the map knows; 0 if it knows a lesser share of them.

    An end that falls behind a wall's nearest cells, which no beam has seen, is known all the same.
    """
    away = maps.distances(ROW, pose[None], points)[0]
    known = maps.is_known(0, transform_points(pose, points)) | (away < cauchy_m)
    if np.mean(known) < overlap:
        return 0.0
    return float(np.mean(1 / (1 + np.square(away[known] / cauchy_m))))


def plausible(covariance: FloatArray, missed: FloatArray, gate: float) -> bool:
    """Whether the drift explains what a match differs by (3,) from where the robot should be, map frame."""
    return float(missed @ np.linalg.solve(covariance + _MATCHING, missed)) < gate**2


def through_walls(maps: TileMaps, pose: FloatArray, beams: BeamEnds) -> float:
    """Share of the beams that, from a pose (3,), would pass through what the map knows as walls."""
    ways = beams.ends - beams.origin
    ranges = np.hypot(ways[:, 0], ways[:, 1])
    seen = maps.cast_rays(ROW, pose[None], beams.origin, ways / ranges[:, None], float(ranges.max()))[0]
    return float(np.mean(seen < ranges - _WALL_M))


def missed_by(graph: KeyGraph, way: Nearby, tie: Tie) -> FloatArray:
    """What a tie (3,) differs by from the way to its submap, turned to the map frame."""
    expected = between(between(graph.tracked[way.block * BLOCK], graph.tracked[anchor_of(way.block)]), way.pose)
    turn = graph.poses[-1][2] - expected[2]
    c, s = math.cos(turn), math.sin(turn)
    x, y = (tie.measurement - expected)[:2].tolist()
    return np.array([c * x - s * y, s * x + c * y, between(expected, tie.measurement)[2]])


def disagreement(graph: KeyGraph, earlier: Tie, later: Tie) -> FloatArray:
    """What the place of a later tie differs by (3,) from where the motion leads from the place of an earlier one."""
    reached = compose(earlier.measurement, between(graph.tracked[earlier.to], graph.tracked[later.to]))
    return between(reached, compose(graph.local(earlier.from_, later.from_), later.measurement))
