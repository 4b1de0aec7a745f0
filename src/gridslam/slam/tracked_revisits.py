"""Tying key scans to old submaps that need no search: the way there is certain, or the filter believes to be there."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam import place_checks as checks
from gridslam.slam.constraints import ConstraintSource
from gridslam.slam.key_graph import BLOCK, KeyGraph
from gridslam.slam.loop_closure_state import LoopClosureState, RejectionReason
from gridslam.slam.place_recognition_parameters import PlaceRecognitionParameters
from gridslam.slam.submaps import anchor_of
from gridslam.types import FloatArray

__all__ = ["tie_known_place"]


def tie_known_place(places: PlaceRecognitionParameters, memory: LoopClosureState, mapper: OccupancyGridMapping) -> bool:
    """Tie the newest key scan to an old submap where it is certain, or believed, to be; whether it is certain."""
    graph = memory.graph
    newest = len(graph) - 1
    oldest = newest // BLOCK - places.gap
    followed = _followed(places, graph, oldest)
    guess = followed or _believed(places, memory, oldest)
    if guess is None:
        return False
    most_m = 3 * places.known_m if followed is None else places.follow_m
    tie = places.match(memory, mapper, newest, *guess, most_m, ConstraintSource.KNOWN)
    if isinstance(tie, RejectionReason):
        return False
    if followed is None:
        way = graph.way_to(guess[0], newest, places.search.window_m, 256)
        if way is None:
            return False
        missed, far = checks.missed_by(graph, way, tie), places.believed_m
        if math.hypot(missed[0], missed[1]) > far or not places.is_plausible(way.covariance, missed):
            return False
        if way.sigma_m > places.known_m:
            if not tie.determined and way.sigma_m > 2 * places.known_m:
                return False
            tie = tie._replace(source=ConstraintSource.BELIEVED)
    graph.add(tie)
    return tie.source is ConstraintSource.KNOWN


def _followed(places: PlaceRecognitionParameters, graph: KeyGraph, oldest: int) -> tuple[int, FloatArray] | None:
    """The submap to which the robot has come from one to which it was tied, and its pose in that one's frame."""
    newest = len(graph) - 1
    known = (
        t for t in reversed(graph.ties[-places.follow :]) if t.determined and t.source is not ConstraintSource.BELIEVED
    )
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


def _believed(
    places: PlaceRecognitionParameters, memory: LoopClosureState, oldest: int
) -> tuple[int, FloatArray] | None:
    """The old submap nearest to where the filter has the robot, and the robot's pose in its frame."""
    anchors, here = np.array(memory.said[anchor_of(0) : anchor_of(oldest) + 1 : BLOCK]), memory.said[-1]
    away = np.hypot(*(anchors[:, :2] - here[:2]).T)
    block = int(away.argmin())
    return (block, between(anchors[block], here)) if away[block] < places.near_m else None
