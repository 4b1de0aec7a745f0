"""Place recognition by scan matching, with rejection of ambiguous and inconsistent matches."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import thin_points
from gridslam.parameters import parameters
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import (
    KEY_SCANS_PER_SUBMAP,
    KeyGraph,
    SubmapDistance,
    anchor_of,
    first_key_scan,
    submap_of,
)
from gridslam.slam.loop_closure.place_matching import PlaceMatching, collect_recent_points
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason, SearchPhase
from gridslam.slam.loop_closure.submaps import ROW
from gridslam.types import BeamEnds, FloatArray

__all__ = ["PlaceRecognition"]

_SEARCH_SUBMAPS = 12
_AMBIGUITY_SUBMAPS = 24
"""Maximum number of submaps in the search and in the ambiguity check."""

_WALL_M = 0.3
"""A beam that ends this far behind a mapped obstacle has passed through it."""


@final
@parameters(frozen=True)
class PlaceRecognition(PlaceMatching):
    """Adds constraints from key scans to older submaps: tracked revisits and recognized places.

    A place is recognized if the points of the last key scans match the old map within the pose uncertainty (branch and
    bound), the match is unique, has no degenerate direction, passes no beams through walls, and is confirmed by the
    next searches.
    """

    def __call__(self, closure_state: LoopClosureState, mapper: OccupancyGridMapping) -> list[Constraint]:
        """Process the newest key scan; return the constraints of a newly recognized place, also added to the graph."""
        graph = closure_state.graph
        newest = len(graph) - 1
        if submap_of(newest) < self.recent_submaps or len(closure_state.scans.key(newest)) < self.matcher.min_beams:
            return []
        if self.match_tracked_revisit(closure_state, mapper):
            closure_state.unconfirmed.clear()
            return []
        search = closure_state.search
        if newest < search.next_key_scan:
            return []
        components = self._find_candidate_submaps(graph, newest)
        if not components:
            search.forget()
            return []
        found = self._search(closure_state, mapper, newest, components[search.failures % len(components)])
        if found is None:
            return []
        if isinstance(found, RejectionReason):
            closure_state.rejected[found] += 1
            search.failures = search.failures + 1 if found is RejectionReason.LOW_INLIER_RATIO else 0
            # after repeated failures the search interval grows
            search.next_key_scan = newest + self.search_interval * 2 ** min(max(search.failures - 1, 0), 3)
            return []
        search.failures = 0
        search.next_key_scan = newest + self.search_interval
        recent = [*(h for h in closure_state.unconfirmed if newest - h.to <= 6 * self.search_interval), found]
        agreeing = [h for h in recent if self._are_consistent(graph, h, found)]
        closure_state.unconfirmed = recent
        if len(agreeing) < len(recent):
            closure_state.rejected[RejectionReason.INCONSISTENT] += 1
        if not self._is_confirmed(agreeing, recent):
            return []
        closure_state.unconfirmed = []
        for constraint in agreeing:
            graph.add(constraint)
        return agreeing

    def _search(
        self,
        closure_state: LoopClosureState,
        mapper: OccupancyGridMapping,
        key: int,
        candidates: list[SubmapDistance],
    ) -> Constraint | RejectionReason | None:
        """Match the points up to a key scan against old submaps within its uncertainty, one phase of the search.

        `candidates` are one of `_find_candidate_submaps`. Returns None if another phase follows.
        """
        search = closure_state.search
        way = candidates[0]
        guess = compose(closure_state.graph.poses[first_key_scan(way.submap)], way.pose)
        submaps = [nearby.submap for nearby in candidates]
        gate_sigmas = self.search.gate_sigmas
        near = [nearby.submap for nearby in candidates if self._mahalanobis_distance(nearby) < gate_sigmas]
        near = near[:_SEARCH_SUBMAPS]
        phase = search.phase(near[:6], submaps[:_SEARCH_SUBMAPS])
        if phase is SearchPhase.MAP_BUILDING:
            oldest = submap_of(key) - self.recent_submaps
            in_sight = {b for submap in near for b in range(submap - 1, submap + 2)}  # within the range of the sensor
            search.near_submaps = tuple(sorted(b for b in in_sight if 0 <= b <= oldest))
            closure_state.joint_map(search.near_submaps, mapper)
            return None
        points = thin_points(collect_recent_points(closure_state, key, self.query_key_scans), self.search.max_points)
        if phase is SearchPhase.AMBIGUITY_CHECK:
            found = self._check_ambiguity(closure_state, mapper, key, guess, way.covariance, points)
            if isinstance(found, RejectionReason):
                search.ambiguity_submaps = ()
            return found
        joint = closure_state.joint_map(search.near_submaps, mapper)
        match = self.search.search(joint.pyramid, guess, way.covariance, points)
        if match is None or not self.is_inlier_match(joint.maps, match.pose, points):
            return RejectionReason.LOW_INLIER_RATIO
        search.ambiguity_submaps = tuple(sorted(submaps))
        closure_state.joint_map(search.ambiguity_submaps, mapper)
        return None

    def _check_ambiguity(
        self,
        closure_state: LoopClosureState,
        mapper: OccupancyGridMapping,
        key: int,
        guess: FloatArray,
        covariance: FloatArray,
        points: FloatArray,
    ) -> Constraint | RejectionReason:
        """Check that no other place matches as well."""
        graph = closure_state.graph
        submaps = closure_state.search.ambiguity_submaps
        joint = closure_state.joint_map(submaps, mapper)
        widened = covariance + self.ambiguity_covariance(self.search.gate_sigmas)
        least = max(self.search.min_runner_up_ratio, self.ambiguity_ratio)  # a lower runner-up changes nothing
        search = replace(self.search, min_runner_up_ratio=least)
        found = search.search(joint.pyramid, guess, widened, points)
        if found is None:
            return RejectionReason.LOW_INLIER_RATIO
        if not self.is_within_gate(covariance, np.append((found.pose - guess)[:2], between(guess, found.pose)[2])):
            return RejectionReason.IMPLAUSIBLE
        if not self.is_inlier_match(joint.maps, found.pose, points):
            return RejectionReason.LOW_INLIER_RATIO
        if found.runner_up_score > self.ambiguity_ratio * found.score:
            return RejectionReason.AMBIGUOUS
        if _through_walls_ratio(joint.maps, found.pose, closure_state.scans.key(key)) > self.max_through_walls_ratio:
            return RejectionReason.THROUGH_WALLS
        anchors = np.array([graph.poses[anchor_of(submap)] for submap in submaps])
        submap = submaps[int(np.argmin(np.hypot(*(anchors[:, :2] - found.pose[:2]).T)))]
        anchor = graph.poses[anchor_of(submap)]
        max_correction_m = 3 * self.certain_sigma_m
        constraint = self.match(
            closure_state,
            joint.maps,
            key,
            submap,
            between(anchor, found.pose),
            max_correction_m,
            ConstraintSource.RECOGNIZED,
            anchor,
        )
        if isinstance(constraint, Constraint) and not constraint.determined:
            return RejectionReason.DEGENERATE
        return constraint

    def _find_candidate_submaps(self, graph: KeyGraph, key: int) -> list[list[SubmapDistance]]:
        """Candidate submaps by rigid component; first those that require the smallest correction of the robot's pose.

        Submaps separated by a gap in the laser data do not form a consistent map; each rigid component is searched on
        its own.
        """
        oldest = submap_of(key) - self.recent_submaps
        gate_sigmas = self.search.gate_sigmas
        nearby = graph.find_nearby_submaps(key, self.search.window_m / gate_sigmas, len(graph))
        nearby = nearby.select(nearby.submaps <= oldest)
        sigmas_m = nearby.sigmas_m
        away = np.maximum(np.hypot(nearby.poses[:, 0], nearby.poses[:, 1]) - self.max_distance_m, 0.0) / sigmas_m
        candidates = np.flatnonzero(away * sigmas_m < gate_sigmas * sigmas_m + self.ambiguity_window_m)
        candidates = candidates[np.lexsort((nearby.submaps[candidates], away[candidates]))]
        labels = graph.label_rigid_components()[anchor_of(0) + KEY_SCANS_PER_SUBMAP * nearby.submaps[candidates]]
        components = [candidates[labels == label] for label in dict.fromkeys(labels.tolist())]
        return [
            [nearby[k] for k in component[:_AMBIGUITY_SUBMAPS].tolist()]
            for component in components
            if away[component[0]] < gate_sigmas
        ]

    def _mahalanobis_distance(self, nearby: SubmapDistance) -> float:
        """Distance to a submap in standard deviations of the relative pose."""
        return max(math.hypot(nearby.pose[0], nearby.pose[1]) - self.max_distance_m, 0.0) / nearby.sigma_m

    def _is_confirmed(self, group: list[Constraint], found: list[Constraint]) -> bool:
        """Whether a group has enough members, and a majority of the candidates in its interval."""
        meanwhile = sum(group[0].to <= constraint.to <= group[-1].to for constraint in found)
        return len(group) >= max(self.min_confirmations, 2 * (meanwhile - len(group)) + 1)

    def _are_consistent(self, graph: KeyGraph, earlier: Constraint, later: Constraint) -> bool:
        """Whether two candidates are consistent with the tracked motion between their key scans."""
        reached = compose(earlier.measurement, between(graph.tracked[earlier.to], graph.tracked[later.to]))
        measured = compose(graph.relative_pose(earlier.from_, later.from_), later.measurement)
        x, y, turn = between(reached, measured).tolist()
        return math.hypot(x, y) < self.consistency_m and abs(turn) < self.consistency_rad


def _through_walls_ratio(maps: TileMaps, pose: FloatArray, beams: BeamEnds) -> float:
    """Ratio of beams that, from a pose (3,), would pass through what the map knows as walls."""
    ways = beams.ends - beams.origin
    ranges = np.hypot(ways[:, 0], ways[:, 1])
    seen = maps.cast_rays(ROW, pose[None], beams.origin, ways / ranges[:, None], float(ranges.max()))[0]
    return float(np.mean(seen < ranges - _WALL_M))
