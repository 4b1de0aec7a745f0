"""Constraints to old submaps without a search: the relative pose is known from tracking or proposed by the filter."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.loop_closure import place_checks as checks
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.place_recognition_parameters import PlaceRecognitionParameters
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_index import KEY_SCANS_PER_SUBMAP, anchor_of, submap_of
from gridslam.types import FloatArray

__all__ = ["match_tracked_revisit"]


def match_tracked_revisit(
    places: PlaceRecognitionParameters, closure_state: LoopClosureState, mapper: OccupancyGridMapping
) -> bool:
    """Match the newest key scan to an old submap at its tracked or filtered pose; return whether that was certain."""
    graph = closure_state.graph
    newest = len(graph) - 1
    oldest = submap_of(newest) - places.recent_submaps
    tracked = _predict_from_last_constraint(places, graph, oldest)
    guess = tracked or _predict_from_filter(places, closure_state, oldest)
    if guess is None:
        return False
    max_correction_m = 3 * places.certain_sigma_m if tracked is None else places.tracked_max_correction_m
    constraint = places.match(closure_state, mapper, newest, *guess, max_correction_m, ConstraintSource.TRACKED)
    if isinstance(constraint, RejectionReason):
        return False
    if tracked is None:
        way = graph.find_distance_to(guess[0], newest, places.search.window_m, 256)
        if way is None:
            return False
        missed, far = checks.constraint_innovation(graph, way, constraint), places.filter_max_correction_m
        if math.hypot(missed[0], missed[1]) > far or not places.is_within_gate(way.covariance, missed):
            return False
        if way.sigma_m > places.certain_sigma_m:
            if not constraint.determined and way.sigma_m > 2 * places.certain_sigma_m:
                return False
            constraint = constraint._replace(source=ConstraintSource.PROXIMITY)
    graph.add(constraint)
    return constraint.source is ConstraintSource.TRACKED


def _predict_from_last_constraint(
    places: PlaceRecognitionParameters, graph: KeyGraph, oldest: int
) -> tuple[int, FloatArray] | None:
    """The submap reached by tracking from the last constraint, and the pose of the robot in its frame."""
    newest = len(graph) - 1
    known = (
        t
        for t in reversed(graph.constraints[-places.tracked_key_scans :])
        if t.determined and t.source is not ConstraintSource.PROXIMITY
    )
    last = next(known, None)
    if last is None or newest - last.to > places.tracked_key_scans:
        return None
    seen = compose(last.measurement, between(graph.tracked[last.to], graph.tracked[newest]))
    submap = submap_of(last.from_)
    near = [b for b in (submap - 1, submap, submap + 1) if 0 <= b <= oldest]
    poses = [between(graph.relative_pose(anchor_of(submap), anchor_of(b)), seen) for b in near]
    away = [math.hypot(pose[0], pose[1]) for pose in poses]
    best = int(np.argmin(away))
    return (near[best], poses[best]) if away[best] < places.max_distance_m else None


def _predict_from_filter(
    places: PlaceRecognitionParameters, closure_state: LoopClosureState, oldest: int
) -> tuple[int, FloatArray] | None:
    """The old submap nearest to the filter's pose, and that pose in its frame."""
    poses = closure_state.online_poses
    anchors = np.array(poses[anchor_of(0) : anchor_of(oldest) + 1 : KEY_SCANS_PER_SUBMAP])
    here = poses[-1]
    away = np.hypot(*(anchors[:, :2] - here[:2]).T)
    submap = int(away.argmin())
    return (submap, between(anchors[submap], here)) if away[submap] < places.max_distance_m else None
