"""Search for loop-closure candidates in old submaps, and check for ambiguity."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import LatticeMatch, thin_points
from gridslam.slam.loop_closure import place_checks as checks
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph, SubmapDistance
from gridslam.slam.loop_closure.place_recognition_parameters import PlaceRecognitionParameters
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_index import anchor_of, first_key_scan, submap_of
from gridslam.types import FloatArray

__all__ = ["find_candidate_submaps", "search_place"]

_SEARCH_SUBMAPS, _AMBIGUITY_SUBMAPS = 12, 24
"""Maximum number of submaps in the search and in the ambiguity check."""


def search_place(
    places: PlaceRecognitionParameters,
    closure_state: LoopClosureState,
    mapper: OccupancyGridMapping,
    key: int,
    candidates: list[SubmapDistance],
) -> Constraint | RejectionReason | None:
    """Match the points up to a key scan against old submaps within its uncertainty: one of `find_candidate_submaps`.

    If the joint map must be built first, only that is done and None is returned, so that no scan waits for both.
    """
    graph, oldest = closure_state.graph, submap_of(key) - places.recent_submaps
    way, submaps = candidates[0], tuple(n.submap for n in candidates)
    guess = compose(graph.poses[first_key_scan(way.submap)], way.pose)
    points = thin_points(
        checks.collect_recent_points(closure_state, key, places.query_key_scans), places.search.max_points
    )
    if set(submaps[:_SEARCH_SUBMAPS]) <= set(closure_state.ambiguity_submaps):
        found = _check_ambiguity(places, closure_state, mapper, key, guess, way.covariance, points)
        closure_state.ambiguity_submaps = () if isinstance(found, RejectionReason) else closure_state.ambiguity_submaps
        return found
    near = [n.submap for n in candidates if _mahalanobis_distance(places, n) < places.search.gate_sigmas][
        :_SEARCH_SUBMAPS
    ]
    if not set(near[:6]) <= set(closure_state.search_submaps):
        seen_too = {b for submap in near for b in range(submap - 1, submap + 2)}  # within the range of the sensor
        closure_state.search_submaps = tuple(sorted(b for b in seen_too if 0 <= b <= oldest))
        closure_state.submap_cache.joint_map(closure_state.search_submaps, mapper, closure_state.scans, graph)
        return None
    pyramid = closure_state.submap_cache.pyramid(closure_state.search_submaps, mapper, closure_state.scans, graph)
    maps = closure_state.submap_cache.joint_map(closure_state.search_submaps, mapper, closure_state.scans, graph)
    near_place = places.search.search(pyramid, guess, way.covariance, points)
    if near_place is None or not places.is_inlier_match(maps, near_place.pose, points):
        return RejectionReason.LOW_INLIER_RATIO
    closure_state.ambiguity_submaps = tuple(sorted(submaps))
    closure_state.submap_cache.joint_map(closure_state.ambiguity_submaps, mapper, closure_state.scans, graph)
    return None


def _check_ambiguity(
    places: PlaceRecognitionParameters, closure_state: LoopClosureState, mapper: OccupancyGridMapping, key: int,
    guess: FloatArray, spread: FloatArray, points: FloatArray,
) -> Constraint | RejectionReason:  # fmt: skip
    """Check that no other place matches as well."""
    graph, submaps = closure_state.graph, closure_state.ambiguity_submaps
    pyramid = closure_state.submap_cache.pyramid(submaps, mapper, closure_state.scans, graph)
    maps = closure_state.submap_cache.joint_map(submaps, mapper, closure_state.scans, graph)
    beyond = np.square(
        np.diag([places.ambiguity_window_m, places.ambiguity_window_m, places.ambiguity_window_rad])
        / places.search.gate_sigmas
    )
    found = places.search.search(pyramid, guess, spread + beyond, points)
    if found is None:
        return RejectionReason.LOW_INLIER_RATIO
    if not places.is_within_gate(spread, np.append((found.pose - guess)[:2], between(guess, found.pose)[2])):
        return RejectionReason.IMPLAUSIBLE
    if rejection := _find_rejection(places, found, maps, points, closure_state, key):
        return rejection
    anchors = np.array([graph.poses[anchor_of(b)] for b in submaps])
    submap = submaps[int(np.argmin(np.hypot(*(anchors[:, :2] - found.pose[:2]).T)))]
    anchor = graph.poses[anchor_of(submap)]
    in_submap = between(anchor, found.pose)
    max_correction_m = 3 * places.certain_sigma_m
    constraint = places.match_to(
        maps, anchor, closure_state, key, submap, in_submap, max_correction_m, ConstraintSource.RECOGNIZED
    )
    if isinstance(constraint, Constraint) and not constraint.determined:
        return RejectionReason.DEGENERATE
    return constraint


def find_candidate_submaps(places: PlaceRecognitionParameters, graph: KeyGraph, key: int) -> list[list[SubmapDistance]]:
    """Candidate submaps by rigid component; first those that require the smallest correction of the robot's pose.

    Submaps separated by a gap in the laser data do not form a consistent map; each rigid component is searched on its
    own.
    """
    oldest, labels = submap_of(key) - places.recent_submaps, graph.label_rigid_components()
    found: dict[int, list[tuple[float, SubmapDistance]]] = {}
    for nearby in graph.find_nearby_submaps(key, places.search.window_m / places.search.gate_sigmas, len(graph)):
        if nearby.submap > oldest:
            continue
        away, sigma_m = _mahalanobis_distance(places, nearby), nearby.sigma_m
        if away * sigma_m < places.search.gate_sigmas * sigma_m + places.ambiguity_window_m:
            found.setdefault(int(labels[anchor_of(nearby.submap)]), []).append((away, nearby))
    for component in found.values():
        component.sort(key=lambda f: (f[0], f[1].submap))
    near = sorted(
        (component for component in found.values() if component[0][0] < places.search.gate_sigmas),
        key=lambda p: p[0][0],
    )
    return [[nearby for _, nearby in component[:_AMBIGUITY_SUBMAPS]] for component in near]


def _mahalanobis_distance(places: PlaceRecognitionParameters, nearby: SubmapDistance) -> float:
    """Distance to a submap in standard deviations of the relative pose."""
    return max(math.hypot(nearby.pose[0], nearby.pose[1]) - places.max_distance_m, 0.0) / nearby.sigma_m


def _find_rejection(
    places: PlaceRecognitionParameters,
    found: LatticeMatch,
    maps: TileMaps,
    points: FloatArray,
    closure_state: LoopClosureState,
    key: int,
) -> RejectionReason | None:
    """Return the reason to reject a candidate, or None."""
    if not places.is_inlier_match(maps, found.pose, points):
        return RejectionReason.LOW_INLIER_RATIO
    if found.runner_up_score > places.ambiguity_ratio * found.score:
        return RejectionReason.AMBIGUOUS
    through = checks.compute_through_walls_ratio(maps, found.pose, closure_state.scans.key(key))
    return RejectionReason.THROUGH_WALLS if through > places.max_through_walls_ratio else None
