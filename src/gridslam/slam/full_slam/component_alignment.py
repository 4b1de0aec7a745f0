"""Alignment of rigid components of the trajectory that are separated by gaps in the laser data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid, thin_points
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam.full_slam.alignment_hypotheses import AlignmentHypothesis, SearchHit, group_hits
from gridslam.slam.full_slam.trajectory_score import TrajectoryScorer
from gridslam.slam.loop_closure import place_checks as checks
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph, SubmapDistance
from gridslam.slam.loop_closure.place_recognition_parameters import PlaceRecognitionParameters
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_index import KEY_SCANS_PER_SUBMAP, anchor_of, first_key_scan
from gridslam.slam.loop_closure.submaps import ROW, build_map
from gridslam.types import FloatArray, IntArray

__all__ = ["ComponentAlignment"]

_LOOSE = np.full((1, 3, 3), 1e-6) * np.eye(3)

_MATCH_VARIANCES = np.square([0.02, 0.01])
"""Of a match, m^2 and rad^2, beside those of the motion."""

_MIN_OVERLAP = 0.4
"""Ratio of beams that must end in known cells for a key scan to be matched."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class ComponentAlignment:
    """Aligns a rigid component of the trajectory with the map of another one, using all its key scans.

    Within a component the robot was tracked, so that one pose aligns all of it. Every few key scans are searched in the
    map of the other component, and the two best poses of each search are kept. Hits that are consistent with the
    tracked motion form one hypothesis, which is tracked through the whole component. It is judged by the score by which
    trajectories are compared (see `TrajectoryScorer`): a single scan is often ambiguous, a whole component rarely. The
    best hypothesis is accepted if its log likelihood is high enough, no other hypothesis is comparable, it lies within
    the drift covariance, and the component is not self-similar (a self-similar component may match an aliased place).

    Parameters
    ----------
    search_interval : int
        Key scans between two searches.
    max_searches : int
        Upper limit of the searches in one call; if there were more, they are spread evenly.
    max_sigma_m : float, m
        Maximum standard deviation of the position of a key scan that is searched.
    max_hypotheses : int
        Maximum number of hypotheses, those with most hits first.
    tracking_gate_sigmas : float
        A match farther than this many standard deviations from the tracked motion is not used.
    min_log_likelihood : float, nats
        Minimum log likelihood of the best hypothesis.
    ambiguity_ratio : float
        Maximum log likelihood of any other hypothesis, as a fraction of the best.
    distinct_ambiguity_ratio : float
        The same if at least `min_constraints` searches of the best hypothesis were unambiguous by themselves.
    merge_m : float, m
        Hypotheses whose median distance is below this are the same.
    self_similarity_ratio : float
        A component is self-similar if, in its own map, the runner-up of a quarter of its key scans reaches this
        fraction of the best score.
    inlier_ratio : float
        Minimum inlier ratio of a key scan that gives a constraint.
    min_constraints : int
        Minimum number of constraints of an alignment.
    search : BranchAndBound
        How a key scan is searched for.
    matcher : GaussNewton
        How a component is tracked through the map.
    """

    search_interval: int = Field(default=3, ge=1)
    max_searches: int = Field(default=400, ge=1)
    max_sigma_m: float = Field(default=24.0, gt=0)
    max_hypotheses: int = Field(default=8, ge=1)
    tracking_gate_sigmas: float = Field(default=2.5, gt=0)
    min_log_likelihood: float = Field(default=12.0, gt=0)
    ambiguity_ratio: float = Field(default=0.15, ge=0, lt=1)
    distinct_ambiguity_ratio: float = Field(default=0.5, ge=0, lt=1)
    merge_m: float = Field(default=0.3, gt=0)
    self_similarity_ratio: float = Field(default=0.85, gt=0, le=1)
    inlier_ratio: float = Field(default=0.5, gt=0, le=1)
    min_constraints: int = Field(default=3, ge=1)
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate_sigmas=2.5, min_score=0.45)
    matcher: GaussNewton = GaussNewton()

    def __call__(
        self,
        closure_state: LoopClosureState,
        mapper: OccupancyGridMapping,
        places: PlaceRecognitionParameters,
        scorer: TrajectoryScorer,
        on_progress: Callable[[], None],
    ) -> list[Constraint]:
        """Align each component with the older ones; return the constraints of the accepted alignments.

        Parameters
        ----------
        closure_state
            Key scans, and the graph whose components are aligned.
        mapper
            How maps of components are built.
        places
            How key scans are matched, and what makes a place ambiguous.
        scorer
            How hypotheses are scored.
        on_progress
            Called once for each pair of components.
        """
        graph = closure_state.graph
        labels, poses = graph.label_rigid_components(), np.array(graph.poses)
        components = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        searches = [self._nearest_submaps(graph, keys, components[:k]) for k, keys in enumerate(components)]
        stride = -(-sum(len(ways) for of_older in searches for ways in of_older) // self.max_searches)
        found: list[Constraint] = []
        for keys, of_older in zip(components, searches, strict=True):
            own: Pyramid | None = None
            for old, ways in zip(components, of_older, strict=False):
                if not ways:
                    continue
                on_progress()
                near = self._select_key_scans(graph, old, ways)
                maps = build_map(mapper, closure_state.scans, near, poses[near])
                searched = dict(list(ways.items())[::stride])
                best = self._select_alignment(closure_state, places, scorer, maps, keys, searched)
                if best is None:
                    continue
                own = own or Pyramid.of(build_map(mapper, closure_state.scans, keys, poses[keys]), 0)
                if not self._is_self_similar(closure_state, places, own, keys):
                    constraints = self._make_constraints(closure_state, places, maps, keys, near, best)
                    found += constraints if len(constraints) >= self.min_constraints else []
        return found

    def _nearest_submaps(
        self, graph: KeyGraph, keys: IntArray, older: list[IntArray]
    ) -> list[dict[int, SubmapDistance]]:
        """For each older component the nearest of its submaps, in standard deviations, by key scan to be searched."""
        ways: list[dict[int, SubmapDistance]] = [{} for _ in older]
        if not older:
            return ways
        members = [set((old // KEY_SCANS_PER_SUBMAP).tolist()) for old in older]
        for key in keys[self.search_interval - 1 :: self.search_interval].tolist():
            nearby = graph.find_nearby_submaps(key, self.max_sigma_m, len(graph))
            for of_old, submaps in zip(ways, members, strict=True):
                near = [n for n in nearby if n.submap in submaps]
                if near:
                    of_old[key] = min(near, key=lambda n: float(np.hypot(*n.pose[:2])) / max(n.sigma_m, 1e-6))
        return ways

    def _select_key_scans(self, graph: KeyGraph, old: IntArray, ways: dict[int, SubmapDistance]) -> IntArray:
        """Key scans of an older component within reach of the searched ones."""
        guesses = np.array([self._guess(graph, way) for way in ways.values()])
        poses = np.array([graph.poses[key] for key in old.tolist()])
        away = np.hypot(*(poses[:, None, :2] - guesses[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
        near: IntArray = old[away < 2 * self.search.window_m]
        return near

    def _guess(self, graph: KeyGraph, way: SubmapDistance) -> FloatArray:
        return compose(graph.poses[first_key_scan(way.submap)], way.pose)

    def _select_alignment(
        self,
        closure_state: LoopClosureState,
        places: PlaceRecognitionParameters,
        scorer: TrajectoryScorer,
        maps: TileMaps,
        keys: IntArray,
        ways: dict[int, SubmapDistance],
    ) -> AlignmentHypothesis | None:
        """Return the best hypothesis if it is accepted."""
        groups = group_hits(closure_state.graph, self._search_hits(closure_state, places, Pyramid.of(maps, 0), ways))
        groups.sort(key=lambda group: -sum(hit.score for hit in group))
        groups = groups[: self.max_hypotheses]
        hypotheses = [self._track_component(closure_state, scorer, maps, keys, group) for group in groups]
        hypotheses.sort(key=lambda hypothesis: -hypothesis.log_likelihood)
        if not hypotheses or hypotheses[0].log_likelihood < self.min_log_likelihood or not hypotheses[0].plausible:
            return None
        best = hypotheses[0]
        others = (other.log_likelihood for other in hypotheses[1:] if best.distance_m(other) >= self.merge_m)
        ratio = self.distinct_ambiguity_ratio if best.distinct_hits >= self.min_constraints else self.ambiguity_ratio
        return best if max(others, default=0.0) <= ratio * best.log_likelihood else None

    def _search_hits(
        self,
        closure_state: LoopClosureState,
        places: PlaceRecognitionParameters,
        pyramid: Pyramid,
        ways: dict[int, SubmapDistance],
    ) -> list[SearchHit]:
        """Search key scans; keep the best place of each and the next best one."""
        hits = []
        beyond = np.square(
            np.diag([places.ambiguity_window_m, places.ambiguity_window_m, places.ambiguity_window_rad])
            / self.search.gate_sigmas
        )
        for key, way in ways.items():
            guess = self._guess(closure_state.graph, way)
            found = self.search.search(
                pyramid, guess, way.covariance + beyond, self._collect_points(closure_state, places, key)
            )
            if found is None:
                continue
            distinct = found.runner_up_score <= places.ambiguity_ratio * found.score
            two = (found.pose, found.score, distinct), (found.runner_up_pose, found.runner_up_score, False)
            for pose, score, distinct in two:
                if pose is not None:
                    missed = np.append((pose - guess)[:2], between(guess, pose)[2])
                    hits.append(SearchHit(key, pose, score, places.is_within_gate(way.covariance, missed), distinct))
        return hits

    def _collect_points(
        self, closure_state: LoopClosureState, places: PlaceRecognitionParameters, key: int
    ) -> FloatArray:
        return thin_points(
            checks.collect_recent_points(closure_state, key, places.query_key_scans), self.search.max_points
        )

    def _track_component(
        self,
        closure_state: LoopClosureState,
        scorer: TrajectoryScorer,
        maps: TileMaps,
        keys: IntArray,
        group: list[SearchHit],
    ) -> AlignmentHypothesis:
        """Track a component through a map from the best hit to both of its ends, correcting where a scan matches."""
        begin = max(group, key=lambda hit: hit.score)
        poses, log_likelihood, at = np.empty((len(keys), 3)), 0.0, int(np.searchsorted(keys, begin.key))
        for way in (range(at, len(keys)), range(at - 1, -1, -1)):
            pose, last = begin.pose, begin.key
            for index in way:
                key = int(keys[index])
                guess = compose(pose, between(closure_state.graph.tracked[last], closure_state.graph.tracked[key]))
                spread = np.array(closure_state.graph.variances[max(key, last)]) + _MATCH_VARIANCES
                pose = self._match_key_scan(closure_state, maps, key, guess, spread)
                poses[index] = pose
                last = key
                if len(closure_state.scans.key(key)) >= self.matcher.min_beams:
                    log_likelihood += scorer.score_scan(maps, pose, closure_state.scans.key(key).ends)
        return AlignmentHypothesis(
            poses, log_likelihood, any(hit.plausible for hit in group), sum(hit.distinct for hit in group)
        )

    def _match_key_scan(
        self, closure_state: LoopClosureState, maps: TileMaps, key: int, guess: FloatArray, spread: FloatArray
    ) -> FloatArray:
        """Pose (3,) of a key scan matched near a guess; the guess if it sees little of the map or moves too far."""
        beams = closure_state.scans.key(key)
        overlap = np.mean(maps.is_known(0, transform_points(guess, beams.ends))) if len(beams) else 0.0
        if len(beams) < self.matcher.min_beams or overlap < _MIN_OVERLAP:
            return guess
        match = self.matcher(maps, ROW, guess[None], _LOOSE, beams)
        x, y, turn = between(guess, match.poses[0]).tolist()
        within = (x * x + y * y) / spread[0] + turn * turn / spread[1] < self.tracking_gate_sigmas**2
        return match.poses[0] if within else guess

    def _is_self_similar(
        self, closure_state: LoopClosureState, places: PlaceRecognitionParameters, own: Pyramid, keys: IntArray
    ) -> bool:
        """Whether a component also matches its own map elsewhere (self-similarity)."""
        within = replace(self.search, window_m=self.search.window_m / 2, window_rad=0.35)
        ratios = []
        for key in keys[min(places.query_key_scans, len(keys)) - 1 :: max(len(keys) // 8, 1)].tolist():
            found = within.search(
                own, closure_state.graph.poses[key], None, self._collect_points(closure_state, places, key)
            )
            ratios.append(0.0 if found is None else found.runner_up_score / found.score)
        return float(np.quantile(ratios, 0.75)) >= self.self_similarity_ratio

    def _make_constraints(
        self,
        closure_state: LoopClosureState,
        places: PlaceRecognitionParameters,
        maps: TileMaps,
        keys: IntArray,
        old: IntArray,
        best: AlignmentHypothesis,
    ) -> list[Constraint]:
        """Constraints from key scans of an aligned component to the nearest submaps of the other."""
        graph, lenient, found = closure_state.graph, replace(places, inlier_ratio=self.inlier_ratio), list[Constraint]()
        submaps = np.unique(old // KEY_SCANS_PER_SUBMAP)
        submaps = submaps[np.isin(anchor_of(0) + submaps * KEY_SCANS_PER_SUBMAP, old)]
        anchors = np.array([graph.poses[anchor_of(submap)] for submap in submaps.tolist()]).reshape(-1, 3)
        for index in range(0, len(keys), self.search_interval):
            key, pose = int(keys[index]), best.poses[index]
            if not len(submaps) or len(closure_state.scans.key(key)) < self.matcher.min_beams:
                continue
            nearest = int(np.argmin(np.hypot(*(anchors[:, :2] - pose[:2]).T)))
            seen, anchor, submap = between(anchors[nearest], pose), anchors[nearest], int(submaps[nearest])
            constraint = lenient.match_to(
                maps, anchor, closure_state, key, submap, seen, places.certain_sigma_m, ConstraintSource.RECOGNIZED
            )
            if isinstance(constraint, Constraint) and constraint.determined:
                found.append(constraint)
        return found
