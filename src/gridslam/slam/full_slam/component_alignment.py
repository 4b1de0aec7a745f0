"""Alignment of rigid components of the trajectory that are separated by gaps in the laser data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid, thin_points
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.parameters import bounded, parameters
from gridslam.slam.full_slam.trajectory_score import TrajectoryScorer
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import (
    KEY_SCANS_PER_SUBMAP,
    KeyGraph,
    SubmapDistance,
    anchor_of,
    first_key_scan,
)
from gridslam.slam.loop_closure.place_matching import PlaceMatching, collect_recent_points
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submaps import ROW, build_map
from gridslam.types import BeamEnds, FloatArray, IntArray

__all__ = ["Alignment", "ComponentAlignment", "Hypothesis", "SearchHit", "group_hits"]

_CONSISTENT_M = 0.3
_CONSISTENT_M_PER_KEY_SCAN = 0.01
_CONSISTENT_RAD = 0.06
"""Hits are consistent if the tracked motion leads from one to the other this closely."""

_LOOSE = np.full((1, 3, 3), 1e-6) * np.eye(3)

_MATCH_VARIANCES = np.square([0.02, 0.01])
"""Of a match, m^2 and rad^2, beside those of the motion."""

_MIN_OVERLAP = 0.4
"""Ratio of beams that must end in known cells for a key scan to be matched."""


@final
@parameters(frozen=True)
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
    query_key_scans : int
        Number of key scans whose points are matched together.
    same_place_ratio : float
        A place is not distinct if another pose reaches this fraction of its score ...
    margin_m, margin_rad : float
        ... within this margin of the search window, since the true place may be an unmapped neighbour that looks alike.
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

    search_interval: int = bounded(3, ge=1, le=1_000_000)
    query_key_scans: int = bounded(8, ge=1, le=1000)
    same_place_ratio: float = bounded(0.85, ge=1e-6, le=1)
    margin_m: float = bounded(10.0, ge=0, le=1e6)
    margin_rad: float = bounded(0.2, ge=0, le=100)
    max_searches: int = bounded(400, ge=1, le=100_000)
    max_sigma_m: float = bounded(24.0, ge=1e-6, le=100)
    max_hypotheses: int = bounded(8, ge=1, le=10_000)
    tracking_gate_sigmas: float = bounded(2.5, ge=0.01, le=1000)
    min_log_likelihood: float = bounded(12.0, ge=1e-6, le=1e6)
    ambiguity_ratio: float = bounded(0.15, ge=0, lt=1)
    distinct_ambiguity_ratio: float = bounded(0.5, ge=0, lt=1)
    merge_m: float = bounded(0.3, ge=1e-6, le=1e6)
    self_similarity_ratio: float = bounded(0.85, ge=1e-6, le=1)
    inlier_ratio: float = bounded(0.5, ge=1e-6, le=1)
    min_constraints: int = bounded(3, ge=1, le=1_000_000)
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate_sigmas=2.5, min_score=0.45)
    matcher: GaussNewton = GaussNewton()

    def __call__(
        self,
        closure_state: LoopClosureState,
        mapper: OccupancyGridMapping,
        places: PlaceMatching,
        scorer: TrajectoryScorer,
        on_progress: Callable[[], None],
        aligned: int = 0,
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
        aligned
            Number of first key scans that were aligned with each other before, and are not again.
        """
        graph = closure_state.graph
        labels = graph.label_rigid_components()
        poses = np.array(graph.poses)
        components = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        searches = [self._nearest_submaps(graph, keys, components[:k]) for k, keys in enumerate(components)]
        total = sum(len(ways) for of_older in searches for ways in of_older)
        stride = max(1, -(-total // self.max_searches))
        found: list[Constraint] = []
        count = 0
        for keys, of_older in zip(components, searches, strict=True):
            own: Pyramid | None = None
            for old, ways in zip(components, of_older, strict=False):
                searched = list(ways)[-count % stride :: stride]
                count += len(ways)
                if not searched or keys[-1] < aligned:
                    continue
                on_progress()
                guesses = {key: compose(graph.poses[first_key_scan(way.submap)], way.pose) for key, way in ways.items()}
                near = self._select_key_scans(poses, old, np.array(list(guesses.values())))
                maps = build_map(mapper, closure_state.scans, near, poses[near])
                alignment = Alignment(self, closure_state, places, scorer, keys, maps)
                hits = alignment.search_hits({key: (guesses[key], ways[key]) for key in searched})
                best = alignment.select_hypothesis(hits)
                if best is None:
                    continue
                own = own or Pyramid.of(build_map(mapper, closure_state.scans, keys, poses[keys]), 0)
                if not alignment.is_self_similar(own):
                    found += alignment.match_constraints(best, poses, near)
        return found

    def _nearest_submaps(
        self, graph: KeyGraph, keys: IntArray, older: list[IntArray]
    ) -> list[dict[int, SubmapDistance]]:
        """For each older component the nearest of its submaps, in standard deviations, by key scan to be searched."""
        ways: list[dict[int, SubmapDistance]] = [{} for _ in older]
        if not older:
            return ways
        members = [np.unique(old // KEY_SCANS_PER_SUBMAP) for old in older]
        for key in keys[self.search_interval - 1 :: self.search_interval].tolist():
            nearby = graph.find_nearby_submaps(key, self.max_sigma_m, len(graph))
            away = np.hypot(nearby.poses[:, 0], nearby.poses[:, 1]) / np.maximum(nearby.sigmas_m, 1e-6)
            for of_old, submaps in zip(ways, members, strict=True):
                near = np.flatnonzero(np.isin(nearby.submaps, submaps))
                if len(near):
                    of_old[key] = nearby[int(near[np.argmin(away[near])])]
        return ways

    def _select_key_scans(self, poses: FloatArray, old: IntArray, guesses: FloatArray) -> IntArray:
        """Key scans of an older component within reach of the guesses (K, 3) of the searched ones."""
        away = np.hypot(*(poses[old, None, :2] - guesses[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
        near: IntArray = old[away < 2 * self.search.window_m]
        return near


@final
class SearchHit(NamedTuple):
    """Pose (3,) at which a search found a key scan in the map of another component.

    `score` is that of the search, `plausible` whether the drift permits the pose, `distinct` whether no other pose
    scored nearly as high.
    """

    key: int
    pose: FloatArray
    score: float
    plausible: bool
    distinct: bool


@final
class Hypothesis(NamedTuple):
    """A component tracked through the map of another one from the best of the hits that agree.

    `poses` (K, 3) are those of all its key scans, `log_likelihood` is theirs; `distinct_hits` had no other place that
    fits nearly as well.
    """

    poses: FloatArray
    log_likelihood: float
    plausible: bool
    distinct_hits: int

    def distance_m(self, other: Hypothesis) -> float:
        """Median distance of the key scans from where another hypothesis has them."""
        return float(np.median(np.hypot(*(self.poses - other.poses)[:, :2].T)))


@final
@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Alignment of a component with the map of an older one.

    Attributes
    ----------
    keys : (K,) int64
        Key scans of the component.
    maps : TileMaps
        The map of the older one.
    """

    parameters: ComponentAlignment
    closure_state: LoopClosureState
    places: PlaceMatching
    scorer: TrajectoryScorer
    keys: IntArray
    maps: TileMaps

    def select_hypothesis(self, hits: list[SearchHit]) -> Hypothesis | None:
        """Return the best hypothesis that the hits lead to, if it is accepted."""
        parameters = self.parameters
        groups = group_hits(self.closure_state.graph, hits)
        groups.sort(key=lambda group: -sum(hit.score for hit in group))
        hypotheses = [self.track_component(group) for group in groups[: parameters.max_hypotheses]]
        hypotheses.sort(key=lambda hypothesis: -hypothesis.log_likelihood)
        best = hypotheses[0] if hypotheses else None
        if best is None or best.log_likelihood < parameters.min_log_likelihood or not best.plausible:
            return None
        others = (other.log_likelihood for other in hypotheses[1:] if best.distance_m(other) >= parameters.merge_m)
        is_distinct = best.distinct_hits >= parameters.min_constraints
        ratio = parameters.distinct_ambiguity_ratio if is_distinct else parameters.ambiguity_ratio
        return best if max(others, default=0.0) <= ratio * best.log_likelihood else None

    def search_hits(self, ways: dict[int, tuple[FloatArray, SubmapDistance]]) -> list[SearchHit]:
        """Search key scans, by guess and nearest submap; keep the best place of each and the next best one."""
        search = self.parameters.search
        margins = np.diag([self.parameters.margin_m, self.parameters.margin_m, self.parameters.margin_rad])
        margin = np.square(margins / search.gate_sigmas)
        pyramid = Pyramid.of(self.maps, 0)
        hits = []
        for key, (guess, way) in ways.items():
            found = search.search(pyramid, guess, way.covariance + margin, self._collect_points(key))
            if found is None:
                continue
            is_distinct = found.runner_up_score <= self.parameters.same_place_ratio * found.score
            two = (found.pose, found.score, is_distinct), (found.runner_up_pose, found.runner_up_score, False)
            for pose, score, distinct in two:
                if pose is not None:
                    innovation = np.append((pose - guess)[:2], between(guess, pose)[2])
                    plausible = self.places.is_within_gate(way.covariance, innovation)
                    hits.append(SearchHit(key, pose, score, plausible, distinct))
        return hits

    def _collect_points(self, key: int) -> FloatArray:
        points = collect_recent_points(self.closure_state, key, self.parameters.query_key_scans)
        return thin_points(points, self.parameters.search.max_points)

    def track_component(self, group: list[SearchHit]) -> Hypothesis:
        """Track a component through the map from the best hit to both of its ends, correcting where a scan matches."""
        graph = self.closure_state.graph
        begin = max(group, key=lambda hit: hit.score)
        poses = np.empty((len(self.keys), 3))
        log_likelihood = 0.0
        at = int(np.searchsorted(self.keys, begin.key))
        for way in (range(at, len(self.keys)), range(at - 1, -1, -1)):
            pose = begin.pose
            last = begin.key
            for index in way:
                key = int(self.keys[index])
                beams = self.closure_state.scans.key(key)
                guess = compose(pose, between(graph.tracked[last], graph.tracked[key]))
                pose = self._match_key_scan(beams, guess, np.array(graph.variances[max(key, last)]) + _MATCH_VARIANCES)
                poses[index] = pose
                last = key
                if len(beams) >= self.parameters.matcher.min_beams:
                    log_likelihood += self.scorer.score_scan(self.maps, pose, beams.ends)
        plausible = any(hit.plausible for hit in group)
        return Hypothesis(poses, log_likelihood, plausible, sum(hit.distinct for hit in group))

    def _match_key_scan(self, beams: BeamEnds, guess: FloatArray, variances: FloatArray) -> FloatArray:
        """Pose (3,) of a key scan matched near a guess; the guess if it sees little of the map or moves too far."""
        if len(beams) < self.parameters.matcher.min_beams:
            return guess
        if np.mean(self.maps.is_known(0, beams.ends, guess)) < _MIN_OVERLAP:
            return guess
        match = self.parameters.matcher(self.maps, ROW, guess[None], _LOOSE, beams)
        x, y, turn = between(guess, match.poses[0]).tolist()
        squared = (x * x + y * y) / variances[0] + turn * turn / variances[1]
        return match.poses[0] if squared < self.parameters.tracking_gate_sigmas**2 else guess

    def evidence(self, hypothesis: Hypothesis) -> tuple[float, float]:
        """Ratio of the beams of all key scans that end in what the map knows, and how well these agree with it."""
        known = beams = 0
        for key, pose in zip(self.keys.tolist(), hypothesis.poses, strict=True):
            ends = self.closure_state.scans.key(key).ends
            known += int(np.count_nonzero(self.maps.is_known(0, ends, pose))) if len(ends) else 0
            beams += len(ends)
        scorer = self.scorer
        agreement = hypothesis.log_likelihood / (scorer.tempering * max(known, 1)) + scorer.neutral
        return known / max(beams, 1), agreement

    def is_self_similar(self, own: Pyramid) -> bool:
        """Whether a component also matches its own map elsewhere (self-similarity)."""
        search = self.parameters.search
        within = replace(search, window_m=search.window_m / 2, window_rad=0.35)
        keys = self.keys
        ratios = []
        for key in keys[min(self.parameters.query_key_scans, len(keys)) - 1 :: max(len(keys) // 8, 1)].tolist():
            found = within.search(own, self.closure_state.graph.poses[key], None, self._collect_points(key))
            ratios.append(0.0 if found is None else found.runner_up_score / found.score)
        return float(np.quantile(ratios, 0.75)) >= self.parameters.self_similarity_ratio

    def match_constraints(self, best: Hypothesis, old_poses: FloatArray, old_keys: IntArray) -> list[Constraint]:
        """Constraints from key scans of an aligned component to the nearest submaps of the other; none of too few.

        `old_keys` (L,) are the key scans of the other that are in the map, and `old_poses` (T, 3) has their poses.
        """
        closure_state = self.closure_state
        lenient = replace(self.places, inlier_ratio=self.parameters.inlier_ratio)
        submaps = np.unique(old_keys // KEY_SCANS_PER_SUBMAP)
        submaps = submaps[np.isin(anchor_of(0) + submaps * KEY_SCANS_PER_SUBMAP, old_keys)]
        if not len(submaps):
            return []
        anchors = old_poses[[anchor_of(submap) for submap in submaps.tolist()]]
        found = []
        for index in range(0, len(self.keys), self.parameters.search_interval):
            key = int(self.keys[index])
            pose = best.poses[index]
            if len(closure_state.scans.key(key)) < self.parameters.matcher.min_beams:
                continue
            nearest = int(np.argmin(np.hypot(*(anchors[:, :2] - pose[:2]).T)))
            anchor = anchors[nearest]
            constraint = lenient.match(
                closure_state,
                self.maps,
                key,
                int(submaps[nearest]),
                between(anchor, pose),
                self.places.certain_sigma_m,
                ConstraintSource.RECOGNIZED,
                anchor,
            )
            if isinstance(constraint, Constraint) and constraint.determined:
                found.append(constraint)
        return found if len(found) >= self.parameters.min_constraints else []


def group_hits(graph: KeyGraph, hits: list[SearchHit]) -> list[list[SearchHit]]:
    """Group hits that are consistent with the tracked motion."""
    groups: list[list[SearchHit]] = []
    for hit in hits:
        for group in groups:
            last = group[-1]
            moved = between(graph.tracked[last.key], graph.tracked[hit.key])
            x, y, turn = between(compose(last.pose, moved), hit.pose).tolist()
            reach_m = _CONSISTENT_M + _CONSISTENT_M_PER_KEY_SCAN * (hit.key - last.key)
            if np.hypot(x, y) < reach_m and abs(turn) < _CONSISTENT_RAD:
                group.append(hit)
                break
        else:
            groups.append([hit])
    return groups
