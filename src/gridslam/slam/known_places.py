"""Constraints to old submaps without a search: the relative pose is known from tracking or proposed by the filter."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam import place_evidence as evidence
from gridslam.slam.key_graph import BLOCK, KeyGraph
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.place_parameters import PlaceParameters
from gridslam.slam.submaps import anchor_of
from gridslam.slam.ties import Source
from gridslam.types import FloatArray

__all__ = ["tie_known_place"]


def tie_known_place(places: PlaceParameters, memory: Memory, mapper: OccupancyGridMapping) -> bool:
    """Match the newest key scan to an old submap at its tracked or filtered pose; return whether that was certain."""
    graph = memory.graph
    newest = len(graph) - 1
    oldest = newest // BLOCK - places.gap
    followed = _followed(places, graph, oldest)
    guess = followed or _believed(places, memory, oldest)
    if guess is None:
        return False
    most_m = 3 * places.known_m if followed is None else places.follow_m
    tie = places.match(memory, mapper, newest, *guess, most_m, Source.KNOWN)
    if isinstance(tie, Rejection):
        return False
    if followed is None:
        way = graph.way_to(guess[0], newest, places.search.window_m, 256)
        if way is None:
            return False
        missed, far = evidence.missed_by(graph, way, tie), places.believed_m
        if math.hypot(missed[0], missed[1]) > far or not places.is_plausible(way.covariance, missed):
            return False
        if way.sigma_m > places.known_m:
            if not tie.determined and way.sigma_m > 2 * places.known_m:
                return False
            tie = tie._replace(source=Source.BELIEVED)
    graph.add(tie)
    return tie.source is Source.KNOWN


def _followed(places: PlaceParameters, graph: KeyGraph, oldest: int) -> tuple[int, FloatArray] | None:
    """The submap reached by tracking from the last constraint, and the pose of the robot in its frame."""
    newest = len(graph) - 1
    known = (t for t in reversed(graph.ties[-places.follow :]) if t.determined and t.source is not Source.BELIEVED)
    last = next(known, None)
    if last is None or newest - last.to > places.follow:
        return None
    seen = compose(last.measurement, between(graph.tracked[last.to], graph.tracked[newest]))
    block = last.from_ // BLOCK
    near = [b for b in (block - 1, block, block + 1) if 0 <= b <= oldest]
    poses = [between(graph.local(anchor_of(block), anchor_of(b)), seen) for b in near]
    away = [math.hypot(pose[0], pose[1]) for pose in poses]
    best = int(np.argmin(away))
    return (near[best], poses[best]) if away[best] < places.near_m else None


def _believed(places: PlaceParameters, memory: Memory, oldest: int) -> tuple[int, FloatArray] | None:
    """The old submap nearest to the filter's pose, and that pose in its frame."""
    anchors, here = np.array(memory.said[anchor_of(0) : anchor_of(oldest) + 1 : BLOCK]), memory.said[-1]
    away = np.hypot(*(anchors[:, :2] - here[:2]).T)
    block = int(away.argmin())
    return (block, between(anchors[block], here)) if away[block] < places.near_m else None
