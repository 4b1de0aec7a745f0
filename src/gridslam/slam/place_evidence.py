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

__all__ = ["disagreement", "missed_by", "recent_points", "through_walls"]

_WALL_M = 0.3
"""A beam that ends so much behind what the map knows has passed through it."""


def recent_points(memory: Memory, scans: int) -> FloatArray:
    """Points (B, 2) of so many last key scans, seen from the newest one."""
    graph, newest = memory.graph, len(memory.graph) - 1
    keys = np.arange(newest - scans + 1, newest + 1)
    tracked = graph.tracked_from(newest, keys)
    points = [transform_points(pose, memory.scans.key(k).ends) for k, pose in zip(keys.tolist(), tracked, strict=True)]
    return np.concatenate(points)


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
