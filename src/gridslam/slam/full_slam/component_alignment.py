"""Alignment of rigid components of the trajectory that are separated by gaps in the laser data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.se2 import between, compose, inverse, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import thin_points
from gridslam.matching.gauss_newton import NO_PRIOR, GaussNewton
from gridslam.slam.full_slam.trajectory_score import log_likelihood, weigh_same_side
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph, anchor_of
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_matching import COARSE, FINE, MAX_POINTS, Submap, SubmapMatching
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submap_recognition import drift_distance
from gridslam.slam.loop_closure.submaps import ROW, build_map
from gridslam.types import BeamEnds, FloatArray, IntArray, StoredScan

_CONSISTENT_M = 0.3
_CONSISTENT_M_PER_KEY_SCAN = 0.01
_CONSISTENT_RAD = 0.06
"""Hits are consistent if the tracked motion leads from one to the other this closely."""

_LOOSE = np.full((1, 3, 3), 1e-6) * np.eye(3)

_MATCH_VARIANCES = np.square([0.02, 0.01])
"""Of a match, m^2 and rad^2, beside those of the motion."""

_MIN_OVERLAP = 0.4
"""Ratio of beams that must end in cells known from the same side for a key scan to be matched."""

_MIN_AGREEMENT = 0.7
"""And how well these must agree: from the next room walls are seen from behind, and pull where nothing is."""

_REACH_M = 30.0
"""A key scan farther away sees nothing of the same."""

_DENSE_M = 5.0
"""Within so far of the way of a few scans their beams meet the walls close together."""

_MOST_SCORED = 20
"""Key scans by which a hypothesis is scored, spread evenly, in either direction."""

_SHIFTS = np.column_stack([np.cos(np.arange(8) * math.pi / 4), np.sin(np.arange(8) * math.pi / 4), np.zeros(8)])
"""Directions (8, 3) in which the best hypothesis is shifted."""
LENGTH_M = 15.0
_STEP_M = 5.0
"""Way of a submap, and way from one to the next."""
_MAX_COMPARISONS = 4000
_MAX_MATCHES = 200
"""Pairs of submaps that are compared in one call at most, spread evenly, and proposed poses that are refined, those on
which most keypoints agree."""
_GATE_SIGMAS = 2.0
"""Standard deviations of the drift that an alignment may need."""
_MAX_HYPOTHESES = 12
"""Maximum number of hypotheses for two components, those with most matches first."""
_TRACKING_GATE_SIGMAS = 2.5
"""A match of a key scan farther than this many standard deviations from the tracked motion is not used."""
_MIN_LOG_LIKELIHOOD = 10.0
"""Least log likelihood (nats) of the best hypothesis, in either direction."""
_AMBIGUITY_RATIO = 0.6
"""Maximum evidence for any other hypothesis, as a fraction of the best."""
_MERGE_M = 0.3
"""Hypotheses whose median distance is below this are the same."""
_SHIFT_M = 0.5
"""The best one, shifted so far in any direction, is another: along bare corridors it fits as well."""
_INLIER_RATIO = 0.5
"""Minimum inlier ratio of a key scan that gives a constraint."""
_CONSTRAINT_INTERVAL = 3
"""Key scans from one constraint to the next."""
MIN_CONSTRAINTS = 3
"""Minimum number of constraints of an alignment; across a gap determined ones."""
_MATCHING = SubmapMatching(min_keypoints=3, max_poses=6, min_points=100, min_information=0.0)
"""How submaps are matched: loosely, as the evidence of all key scans decides."""
_MATCHER = GaussNewton()
"""How a component is tracked through the map."""


def align_components(
    closure_state: LoopClosureState,
    mapper: OccupancyGridMapping,
    pairs: SubmapPairs,
    places: PlaceMatching,
    on_progress: Callable[[], None],
    aligned: int = 0,
) -> list[Constraint]:
    """Align each rigid component with the older ones, by all its key scans; return constraints that are accepted.

    Within a component the robot was tracked, so that one pose aligns all of it. Short submaps of both are matched with
    each other over the full turn. Matches that are consistent with the tracked motion form one hypothesis, which is
    tracked through all key scans of the component. It is judged by the score by which trajectories are compared (see
    `score_trajectory`), in both directions: the component's scans given the map of the other one, and the scans of that
    one given the component's map; the lesser counts. A submap is often ambiguous, a whole component rarely.

    What the drift makes improbable counts less, by the squared distance in its standard deviations. The best hypothesis
    is accepted if there is enough evidence for it, it lies within the drift, and no other place, found or half a metre
    beside, has a comparable one.

    Parameters
    ----------
    closure_state
        Key scans, and the graph whose components are aligned.
    mapper
        How maps of components are built.
    pairs
        Short submaps, and their matches so far; modified.
    places
        How key scans are matched.
    on_progress
        Called once for each pair of components.
    aligned
        Number of first key scans that were aligned with each other before, and are not again.
    """
    graph = closure_state.graph
    labels = graph.label_rigid_components()
    if not labels.any():
        return []
    pairs.cut(graph, closure_state.scans, mapper, LENGTH_M, _STEP_M, is_over=True)
    poses = np.array(graph.poses)
    found: list[Constraint] = []
    for (old, new), hits in _search(graph, pairs, labels, aligned).items():
        on_progress()
        keys = np.flatnonzero(labels == old)
        known = KnownMap(closure_state.scans, poses, keys, build_map(mapper, closure_state.scans, keys, poses[keys]))
        alignment = Alignment(closure_state, mapper, places, np.flatnonzero(labels == new), known)
        best = alignment.select_hypothesis(hits)
        if best is not None:
            determined = [each for each in alignment.match_constraints(best) if each.determined]
            found += determined if len(determined) >= MIN_CONSTRAINTS else []
    return found


def _search(
    graph: KeyGraph, pairs: SubmapPairs, labels: IntArray, aligned: int
) -> dict[tuple[int, int], list[SearchHit]]:
    """Match submaps of different components; the hits by the labels of the older and the newer one."""
    anchors = pairs.anchors
    of_submaps = labels[anchors]
    last = np.array([np.flatnonzero(labels == label)[-1] for label in of_submaps])
    first, second = np.triu_indices(len(anchors), 1)
    is_wanted = of_submaps[first] != of_submaps[second]
    is_wanted &= np.where(of_submaps[first] < of_submaps[second], last[second], last[first]) >= aligned
    first, second = first[is_wanted], second[is_wanted]
    stride = max(1, -(-len(first) // _MAX_COMPARISONS))
    compared = list(zip(first[::stride].tolist(), second[::stride].tolist(), strict=True))
    proposed = [
        (-keypoints, pair, number)
        for pair in compared
        for number, (_, keypoints) in enumerate(pairs.propose(_MATCHING, *pair))
    ]
    matched: dict[tuple[int, int], list[int]] = {}
    for _, pair, number in sorted(proposed)[:_MAX_MATCHES]:
        matched.setdefault(pair, []).append(number)
    hits: dict[tuple[int, int], list[SearchHit]] = {}
    for a, b in sorted(matched):
        is_forward = of_submaps[a] < of_submaps[b]
        old, new = (a, b) if is_forward else (b, a)
        key = int(anchors[new])
        for match in pairs.verify(_MATCHING, a, b, matched[a, b]):
            seen = match.pose if is_forward else inverse(match.pose)
            pose = compose(graph.poses[int(anchors[old])], seen)
            distance = drift_distance(graph, int(anchors[old]), key, seen)
            hit = SearchHit(key, pose, match.inlier_ratio, distance)
            hits.setdefault((int(of_submaps[old]), int(of_submaps[new])), []).append(hit)
    return dict(sorted(hits.items(), key=lambda item: item[0][::-1]))


@final
class KnownMap(NamedTuple):
    """The map to align a component with: key scans `keys` (L,) of `scans`, at `poses` (T, 3) of all, and their map."""

    scans: ScanArchive
    poses: FloatArray
    keys: IntArray
    maps: TileMaps


@final
class SearchHit(NamedTuple):
    """Pose (3,) of a key scan at which a submap about it matches one of another component.

    `score` is the inlier ratio, `squared_sigmas` the squared Mahalanobis distance from where the drift expects it.
    """

    key: int
    pose: FloatArray
    score: float
    squared_sigmas: float = 0.0


@final
class Hypothesis(NamedTuple):
    """A component tracked through the map of another one from the best of the hits that agree.

    `poses` (K, 3) are those of all its key scans; `log_likelihood` (nats) is that of either direction, the lesser;
    `overlap` the ratio of the component's beams that end in what the map knows, `agreement` how well these agree.
    """

    poses: FloatArray
    log_likelihood: float
    squared_sigmas: float
    overlap: float
    agreement: float

    @property
    def evidence(self) -> float:
        """Log likelihood less the improbability by the drift, nats: its covariances are generous."""
        return self.log_likelihood - self.squared_sigmas

    def distance_m(self, other: Hypothesis) -> float:
        """Median distance of the key scans from where another hypothesis has them."""
        return float(np.median(np.hypot(*(self.poses - other.poses)[:, :2].T)))


@final
@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Alignment of a component, key scans `keys` (K,), with the map of an older one.

    The best hypothesis is accepted from `min_log_likelihood` (nats) in either direction, if any other one has at most
    `ambiguity_ratio` of its evidence.
    """

    closure_state: LoopClosureState
    mapper: OccupancyGridMapping
    places: PlaceMatching
    keys: IntArray
    known: KnownMap
    min_log_likelihood: float = _MIN_LOG_LIKELIHOOD
    ambiguity_ratio: float = _AMBIGUITY_RATIO

    def select_hypothesis(self, hits: list[SearchHit]) -> Hypothesis | None:
        """Return the best hypothesis that the hits lead to, if it is accepted."""
        groups = group_hits(self.closure_state.graph, hits)[:_MAX_HYPOTHESES]
        return self.decide([self.track_component(group) for group in groups])

    def decide(self, hypotheses: list[Hypothesis]) -> Hypothesis | None:
        """Return the best hypothesis if there is enough evidence for it and no other hypothesis is comparable."""
        best = max(hypotheses, key=lambda hypothesis: hypothesis.evidence, default=None)
        if best is None or best.log_likelihood < self.min_log_likelihood:
            return None
        if best.squared_sigmas > _GATE_SIGMAS**2:
            return None
        limit = self.ambiguity_ratio * best.evidence
        if any(other.evidence > limit for other in hypotheses if best.distance_m(other) >= _MERGE_M):
            return None
        own = self._draw(best.poses)
        limit += best.squared_sigmas
        shifts = _SHIFT_M * _SHIFTS
        is_comparable = any(self._score_both(best.poses + shift, own, shift, limit)[0] > limit for shift in shifts)
        return None if is_comparable else best

    def track_component(self, group: list[SearchHit]) -> Hypothesis:
        """Lay a component on the map from the best hit: as one, or tracked to both of its ends, whichever fits better.

        A short one is rigid, and few of its key scans see enough of the map; a long one has drifted.
        """
        begin = max(group, key=lambda hit: hit.score)
        squared_sigmas = min(hit.squared_sigmas for hit in group)
        start, as_one = self._match_as_one(begin)
        found = []
        for poses in (as_one, self._track(begin.key, start)):
            likelihood, overlap, agreement = self._score_both(poses, self._draw(poses))
            found.append(Hypothesis(poses, likelihood, squared_sigmas, overlap, agreement))
        return max(found, key=lambda hypothesis: hypothesis.log_likelihood)

    def _match_as_one(self, begin: SearchHit) -> tuple[FloatArray, FloatArray]:
        """Poses (3,) of a hit's key scan and (K, 3) of the component, which keeps its shape, matched from there."""
        graph = self.closure_state.graph
        shape = np.array(graph.poses)
        own = between(shape[begin.key], shape[self.keys])
        component = Submap(begin.key, self.keys, own, self.closure_state.scans, self.mapper)
        points = StoredScan(thin_points(component.collect_points(), MAX_POINTS), np.zeros(2))
        pose = begin.pose
        for matcher in (COARSE, FINE):
            (pose,) = matcher(self.known.maps, ROW, pose[None], NO_PRIOR[None], points).poses
        return pose, compose(pose, own)

    def _track(self, begin: int, pose: FloatArray) -> FloatArray:
        """Poses (K, 3) of the component from that (3,) of key scan `begin` on, corrected where a scan matches."""
        graph = self.closure_state.graph
        poses = np.empty((len(self.keys), 3))
        at = int(np.searchsorted(self.keys, begin))
        start = pose
        for way in (range(at, len(self.keys)), range(at - 1, -1, -1)):
            pose = start
            last = begin
            for index in way:
                key = int(self.keys[index])
                guess = compose(pose, between(graph.poses[last], graph.poses[key]))
                steps = np.array(graph.variances[min(key, last) + 1 : max(key, last) + 1]).reshape(-1, 2)
                variances = steps.sum(axis=0) + _MATCH_VARIANCES
                pose = self._match_key_scan(self.closure_state.scans.key(key), guess, variances)
                poses[index] = pose
                last = key
        return poses

    def _match_key_scan(self, beams: BeamEnds, guess: FloatArray, variances: FloatArray) -> FloatArray:
        """Pose (3,) of a key scan matched near a guess; the guess if it sees little of the map or moves too far."""
        if len(beams) < _MATCHER.min_beams:
            return guess
        if np.mean(self.known.maps.is_known(0, beams.ends, guess)) < _MIN_OVERLAP:
            return guess
        match = _MATCHER(self.known.maps, ROW, guess[None], _LOOSE, beams)
        x, y, turn = between(guess, match.poses[0]).tolist()
        squared = (x * x + y * y) / variances[0] + turn * turn / variances[1]
        if squared >= _TRACKING_GATE_SIGMAS**2:
            return guess
        weights = weigh_same_side(self.known.maps, match.poses[0], beams)
        is_match = len(weights) >= _MIN_OVERLAP * len(beams) and weights.mean() >= _MIN_AGREEMENT
        return match.poses[0] if is_match else guess

    def _draw(self, poses: FloatArray) -> TileMaps:
        """Build the map of the component's key scans at poses (K, 3)."""
        return build_map(self.mapper, self.closure_state.scans, self.keys, poses)

    def _score_both(
        self, poses: FloatArray, own: TileMaps, shift: FloatArray | float = 0.0, least: float = -math.inf
    ) -> tuple[float, float, float]:
        """Log likelihood at poses (K, 3), the lesser of both directions; overlap and agreement of the component.

        `own` is the component's map, in the frame of the other one but for a `shift` (3,). What is not above `least`
        in one direction is not scored in the other.
        """
        scans, old_poses, old, maps = self.known
        likelihood, overlap, agreement = self._score(maps, poses, self.closure_state.scans, self.keys)
        if likelihood <= least:
            return likelihood, overlap, agreement
        way = poses[:: KEY_SCANS_PER_SUBMAP // 2, :2]
        away = np.min([np.hypot(*(old_poses[old, :2] - place).T) for place in way], axis=0)
        near = old[away < _REACH_M]
        moved = old_poses[near] - shift
        back, _, _ = self._score(own, moved, scans, near, way - np.atleast_1d(shift)[:2])
        return min(likelihood, back), overlap, agreement

    def _score(
        self, maps: TileMaps, poses: FloatArray, scans: ScanArchive, keys: IntArray, way: FloatArray | None = None
    ) -> tuple[float, float, float]:
        """Log likelihood of key scans (K,) at poses (K, 3) given a map, and their overlap and agreement with it.

        Beams that end farther than some metres from a `way` (P, 2) are left out: beams there are far apart in its map.
        """
        stride = max(1, -(-len(keys) // _MOST_SCORED))
        agreeing, known, beams = 0.0, 0, 0
        for key, pose in zip(keys[::stride].tolist(), poses[::stride], strict=True):
            scan = scans.key(key)
            ends = scan.ends
            if way is not None and len(ends):
                away = transform_points(pose, ends)[:, None] - way
                ends = ends[(np.square(away).sum(axis=2) < _DENSE_M**2).any(axis=1)]
            if len(ends):
                weights = weigh_same_side(maps, pose, StoredScan(ends, scan.origin))
                agreeing += float(weights.sum(dtype=np.float64))
                known += len(weights)
                beams += len(ends)
        likelihood = stride * log_likelihood(agreeing, known)
        return likelihood, known / max(beams, 1), agreeing / max(known, 1)

    def match_constraints(self, best: Hypothesis) -> list[Constraint]:
        """Constraints from key scans of an aligned component to the nearest submaps of the other."""
        closure_state = self.closure_state
        _, old_poses, old, maps = self.known
        lenient = replace(self.places, inlier_ratio=_INLIER_RATIO)
        submaps = np.unique(old // KEY_SCANS_PER_SUBMAP)
        submaps = submaps[np.isin(anchor_of(0) + submaps * KEY_SCANS_PER_SUBMAP, old)]
        if not len(submaps):
            return []
        anchors = old_poses[[anchor_of(submap) for submap in submaps.tolist()]]
        found = []
        for index in range(0, len(self.keys), _CONSTRAINT_INTERVAL):
            key = int(self.keys[index])
            pose = best.poses[index]
            if len(closure_state.scans.key(key)) < _MATCHER.min_beams:
                continue
            nearest = int(np.argmin(np.hypot(*(anchors[:, :2] - pose[:2]).T)))
            anchor = anchors[nearest]
            constraint = lenient.match(
                closure_state,
                maps,
                key,
                int(submaps[nearest]),
                between(anchor, pose),
                self.places.certain_sigma_m,
                ConstraintSource.RECOGNIZED,
                anchor,
            )
            if isinstance(constraint, Constraint):
                found.append(constraint)
        return found


def group_hits(graph: KeyGraph, hits: list[SearchHit]) -> list[list[SearchHit]]:
    """Group hits that are consistent with the tracked motion, those of the greatest sum of scores first."""
    groups: list[list[SearchHit]] = []
    tracked = np.array(graph.tracked)
    keys = np.empty(len(hits), np.int64)  # of each group the newest hit
    poses = np.empty((len(hits), 3))
    for hit in sorted(hits, key=lambda hit: hit.key):
        newest = keys[: len(groups)]
        moved = between(tracked[newest], tracked[hit.key])
        error = between(compose(poses[: len(groups)], moved), hit.pose)
        reach_m = _CONSISTENT_M + _CONSISTENT_M_PER_KEY_SCAN * (hit.key - newest)
        agrees = (np.hypot(error[:, 0], error[:, 1]) < reach_m) & (np.abs(error[:, 2]) < _CONSISTENT_RAD)
        number = int(agrees.argmax()) if agrees.any() else len(groups)
        if number == len(groups):
            groups.append([])
        groups[number].append(hit)
        keys[number], poses[number] = hit.key, hit.pose
    return sorted(groups, key=lambda group: -sum(hit.score for hit in group))
