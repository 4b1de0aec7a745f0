"""Alignment of rigid components of the trajectory that are separated by gaps in the laser data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import thin_points
from gridslam.matching.gauss_newton import GaussNewton, weigh_known_beams
from gridslam.slam.full_slam.trajectory_score import SCALE_M, log_likelihood, weigh_same_side
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource, transform_match
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph, anchor_of, position_sigmas
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.map_search import MapSearch
from gridslam.slam.loop_closure.place_matching import PlaceMatching, squared_sigmas
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_matching import MAX_POINTS, Submap
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submaps import DIRECTIONS, ROW, build_map, match_points
from gridslam.slam.loop_closure.walls import MOST_BESIDE_M, leave_open
from gridslam.types import FloatArray, IntArray, Match, StoredScan

_CONSISTENT_M = 0.3
_CONSISTENT_M_PER_KEY_SCAN = 0.01
_CONSISTENT_RAD = 0.06
"""Hits are consistent if the tracked motion leads from one to the other this closely."""

_REACH_M = 30.0
"""A key scan farther away sees nothing of the same."""

_DENSE_M = 5.0
"""Within so far of the way of a few scans their beams meet the walls close together."""

_MOST_SCORED = 20
"""Key scans by which a hypothesis is scored, spread evenly, in either direction."""

LENGTH_M = 15.0
STEP_M = 5.0
"""Way of a submap, and way from one to the next."""
_MOST_SEARCHES = 400
"""Searches of submaps in the maps of components in one call at most, 10 ms each, spread evenly."""
SEARCH_SIGMAS = 2.5
MARGIN_M = 1.0
MARGIN_RAD = 0.1
"""Standard deviations of the drift within which a submap is searched for, and what is added, as it is bent itself."""
_MOST_EXPECTED = 50
"""Key scans of a component, spread evenly, of which the one determines where a submap is expected to which the way is
most certain."""
_MOST_HITS = 4
"""Places of a submap, best first."""
_GATE_SIGMAS = 2.0
"""Standard deviations of the drift that an alignment may need."""
_MAX_HYPOTHESES = 12
"""Maximum number of places of a component that are compared, those with most matches first."""
_MIN_LOG_LIKELIHOOD = 10.0
"""Least log likelihood (nats) of the best hypothesis, in either direction."""
_AMBIGUITY_RATIO = 0.6
"""Maximum evidence for any other hypothesis, as a fraction of the best."""
_MERGE_M = 0.3
"""Hypotheses whose median distance is below this are the same."""
_SHIFTS_M = 0.5, 1.5
"""The best one, shifted so far in any direction, is another: along bare corridors it fits as well at both."""
_INLIER_RATIO = 0.5
"""Minimum inlier ratio of a key scan that gives a constraint."""
_BEAM_SIGMA_M = 0.3
"""Standard deviation of one point in a constraint of all of a component, as in one of a key scan."""
_DEFERRED_RATIO = 0.4
"""Evidence for an alignment as a fraction of that for another one of either component, at least: what is much weaker
waits until the other one is known."""
_WIDE = np.diag(1 / np.square([1.5, 1.5, 0.05]))
"""Information (1/m^2, 1/rad^2) of a place that furniture alone distinguishes from those beside."""
_SURE = np.diag(1 / np.square([0.05, 0.05, 0.02]))
"""Information (1/m^2, 1/rad^2) of a place that is proposed: where a component starts from."""
_CONSTRAINT_INTERVAL = 3
"""Key scans from one constraint to the next."""
MIN_CONSTRAINTS = 3
"""Minimum number of constraints of an alignment; across a gap determined ones."""
_MIN_BEAMS = GaussNewton().min_beams
"""Least number of beams of a key scan that gives a constraint."""


def align_components(
    closure_state: LoopClosureState,
    mapper: OccupancyGridMapping,
    stretches: SubmapPairs,
    places: PlaceMatching,
    on_progress: Callable[[], None],
    aligned: int = 0,
) -> list[Constraint]:
    """Align each rigid component with the older ones, by all its key scans; return constraints that are accepted.

    Within a component the robot was tracked, so that one pose aligns all of it. Short submaps of it are searched for in
    the map of the other one, as far as the drift allows. Places that are consistent with the tracked motion form one
    hypothesis, in which the component lies as it was tracked. It is judged by the score by which trajectories
    are compared (see `score_trajectory`), in both directions: the component's scans given the map of the other one, and
    the scans of that one given the component's map; the lesser counts. A submap is often ambiguous, a whole component
    rarely.

    What the drift makes improbable counts less, by the squared distance in its standard deviations. The best hypothesis
    is accepted if there is enough evidence for it, it lies within the drift, and no other place has a comparable one.
    Where one within 1.5 m has, or walls alone leave one beside it, it is known to a metre or so. Much weaker ones of
    the same component are judged again with what is then known.

    Parameters
    ----------
    closure_state
        Key scans, and the graph whose components are aligned.
    mapper
        How maps of components are built.
    stretches
        Short submaps, cut so far; modified.
    places
        How key scans are matched.
    on_progress
        Called once for each pair of components.
    aligned
        Number of first key scans that were aligned with each other before, and are not again.
    """
    found: list[Constraint] = []
    aligned_pairs: list[tuple[float, int, int, list[Constraint]]] = []
    for old, new, alignment, hypotheses in _hypothesize(closure_state, mapper, stretches, places, on_progress, aligned):
        best = alignment.decide(hypotheses)
        if best is not None and (best.is_open or alignment.is_left_open(best)):
            found += alignment.constrain_as_one(best, is_certain=False)
        elif best is not None:
            determined = [each for each in alignment.match_constraints(best) if each.determined]
            if len(determined) < MIN_CONSTRAINTS:
                determined = alignment.constrain_as_one(best)
            aligned_pairs.append((-best.evidence, old, new, determined))
    taken: dict[int, float] = {}
    for less, old, new, constraints in sorted(aligned_pairs, key=lambda pair: pair[:3]):
        if -less >= _DEFERRED_RATIO * max(taken.get(old, 0.0), taken.get(new, 0.0)):
            found += constraints
            taken = {old: -less, new: -less} | taken
    return found


def propose_alignments(
    closure_state: LoopClosureState,
    mapper: OccupancyGridMapping,
    stretches: SubmapPairs,
    closure: LoopClosure,
    on_progress: Callable[[], None],
    aligned: int = 0,
) -> list[Constraint]:
    """Propose where each component lies in an older one: the likeliest place, however little they share.

    It may be wrong: a trajectory with what is proposed must have the better score. For the parameters see
    `align_components`; key scans are matched by the places of `closure`.
    """
    likeliest: dict[int, tuple[float, Constraint]] = {}
    for _, new, alignment, hypotheses in _hypothesize(
        closure_state, mapper, stretches, closure.places, on_progress, aligned
    ):
        best = max(hypotheses, key=lambda hypothesis: hypothesis.evidence, default=None)
        if best is not None and (new not in likeliest or best.evidence > likeliest[new][0]):
            likeliest[new] = best.evidence, alignment.place_as_one(best)
    return [constraint for _, constraint in likeliest.values()]


def _hypothesize(
    closure_state: LoopClosureState,
    mapper: OccupancyGridMapping,
    stretches: SubmapPairs,
    places: PlaceMatching,
    on_progress: Callable[[], None],
    aligned: int,
) -> Iterator[tuple[int, int, Alignment, list[Hypothesis]]]:
    """Yield pairs of rigid components, the older one first, with the places of the newer one in the other's map."""
    graph = closure_state.graph
    labels = graph.label_rigid_components()
    if not labels.any():
        return
    stretches.cut(graph, closure_state.scans, mapper, LENGTH_M, STEP_M, is_over=True)
    poses = np.array(graph.poses)
    wanted = _select_searches(graph, stretches.submaps, labels, aligned)
    for old in np.unique([search.old for search in wanted]).tolist():
        keys = np.flatnonzero(labels == old)
        known = KnownMap(closure_state.scans, poses, keys, build_map(mapper, closure_state.scans, keys, poses[keys]))
        search = MapSearch(known.maps)
        hits: dict[int, list[SearchHit]] = {}
        for of_old in [each for each in wanted if each.old == old]:
            hits.setdefault(int(labels[of_old.submap.anchor]), []).extend(of_old.run(graph, search))
        for new, of_new in sorted(hits.items()):
            on_progress()
            alignment = Alignment(closure_state, mapper, places, np.flatnonzero(labels == new), known)
            groups = group_hits(graph, of_new)[:_MAX_HYPOTHESES]
            yield old, new, alignment, [alignment.lay_component(group) for group in groups]


@final
class WantedSearch(NamedTuple):
    """A submap to be searched for in component `old`, where it is expected from that one's key scan `seen_from`.

    `expected` is its pose (3,) seen from there, `covariance` (3, 3) that of the drift, map frame.
    """

    submap: Submap
    old: int
    seen_from: int
    expected: FloatArray
    covariance: FloatArray

    @property
    def reach_m(self) -> float:
        """How far from there it is searched for."""
        return float(SEARCH_SIGMAS * position_sigmas(self.covariance[None])[0]) + MARGIN_M

    def run(self, graph: KeyGraph, search: MapSearch) -> list[SearchHit]:
        """Search the map of the component, within the drift."""
        guess = compose(graph.poses[self.seen_from], self.expected)
        reach_rad = SEARCH_SIGMAS * math.sqrt(self.covariance[2, 2]) + MARGIN_RAD
        return [
            hit._replace(squared_sigmas=squared_sigmas(self.covariance, wrap_headings(hit.pose - guess)))
            for hit in match_submap(search, self.submap, guess, self.reach_m, reach_rad)
        ]


def _select_searches(graph: KeyGraph, submaps: list[Submap], labels: IntArray, aligned: int) -> list[WantedSearch]:
    """Select submaps and older components that may lie where they are: the drift allows for it."""
    poses = np.array(graph.poses)
    wanted = []
    for submap in submaps:
        new = labels[submap.anchor]
        newest = np.flatnonzero(labels == new)[-1]
        for old in range(new):
            keys = np.flatnonzero(labels == old)
            if max(newest, keys[-1]) < aligned:
                continue
            few = keys[:: -(-len(keys) // _MOST_EXPECTED)]
            expected, covariances = graph.locate(submap.anchor, few)
            best = int(position_sigmas(covariances).argmin())
            search = WantedSearch(submap, old, int(few[best]), expected[best], covariances[best])
            x, y, _ = compose(poses[few[best]], expected[best]).tolist()
            if np.hypot(poses[keys, 0] - x, poses[keys, 1] - y).min() < search.reach_m + submap.radius_m:
                wanted.append(search)
    return wanted[:: max(1, -(-len(wanted) // _MOST_SEARCHES))]


def match_submap(
    search: MapSearch, submap: Submap, near: FloatArray | None, near_m: float, near_rad: float
) -> list[SearchHit]:
    """Search a map for a submap, near a pose (3,) if it is given; the places that its points speak for, best first."""
    hits = []
    poses, points = search(submap, near, near_m, near_rad)
    for pose in poses:
        weights = weigh_known_beams(search.maps, ROW, pose, points, SCALE_M)
        score = log_likelihood(float(weights.sum(dtype=np.float64)), len(weights))
        if score > 0:
            hits.append(SearchHit(submap.anchor, pose, score))
    return sorted(hits, key=lambda hit: -hit.score)[:_MOST_HITS]


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
    """A component laid on the map of another one from the best of the hits that agree.

    `poses` (K, 3) are those of all its key scans; `log_likelihood` (nats) is that of either direction, the lesser;
    `overlap` the ratio of the component's beams that end in what the map knows, `agreement` how well these agree; it
    `is_open` if others within `MOST_BESIDE_M` fit as well.
    """

    poses: FloatArray
    log_likelihood: float
    squared_sigmas: float
    overlap: float
    agreement: float
    is_open: bool = False

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

    def is_left_open(self, best: Hypothesis) -> bool:
        """Whether walls fit beside a hypothesis as well: furniture alone decides, see `leave_open`."""
        middle = len(self.keys) // 2
        component = self._as_submap(int(self.keys[middle]), between(best.poses[middle], best.poses))
        return leave_open(self.known.maps, component.walls, best.poses[middle])

    def decide(self, hypotheses: list[Hypothesis]) -> Hypothesis | None:
        """Return the best hypothesis if there is enough evidence for it and none farther off is comparable.

        One beside it leaves it open: both are one place, in which furniture was moved.
        """
        best = max(hypotheses, key=lambda hypothesis: hypothesis.evidence, default=None)
        if best is None or best.log_likelihood < self.min_log_likelihood:
            return None
        if best.squared_sigmas > _GATE_SIGMAS**2:
            return None
        limit = self.ambiguity_ratio * best.evidence
        rivals_m = [best.distance_m(other) for other in hypotheses if other.evidence > limit]
        own = build_map(self.mapper, self.closure_state.scans, self.keys, best.poses)
        limit += best.squared_sigmas
        for shift_m in _SHIFTS_M:
            shifts = shift_m * DIRECTIONS
            if any(self._score_both(best.poses + shift, own, shift, limit)[0] > limit for shift in shifts):
                rivals_m.append(shift_m)
        if max(rivals_m, default=0.0) >= MOST_BESIDE_M:
            return None
        return best._replace(is_open=max(rivals_m, default=0.0) >= _MERGE_M)

    def lay_component(self, group: list[SearchHit]) -> Hypothesis:
        """Lay a component on the map from the best hit, as one: it keeps the shape in which it was tracked."""
        begin = max(group, key=lambda hit: hit.score)
        shape = np.array(self.closure_state.graph.poses)
        own = between(shape[begin.key], shape[self.keys])
        (pose,) = self._match_points(self._as_submap(begin.key, own), begin.pose).poses
        poses = compose(pose, own)
        drawn = build_map(self.mapper, self.closure_state.scans, self.keys, poses)
        likelihood, overlap, agreement = self._score_both(poses, drawn)
        squared_sigmas = min(hit.squared_sigmas for hit in group)
        return Hypothesis(poses, likelihood, squared_sigmas, overlap, agreement)

    def _as_submap(self, key: int, own: FloatArray) -> Submap:
        """Return all key scans, at `own` (K, 3) seen from one of them."""
        return Submap(key, self.keys, own, self.closure_state.scans, self.mapper)

    def _match_points(self, component: Submap, pose: FloatArray) -> Match:
        """Match the points of a component from a pose (3,) of its frame on."""
        return match_points(self.known.maps, pose[None], thin_points(component.collect_points(), MAX_POINTS))

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
            if len(closure_state.scans.key(key)) < _MIN_BEAMS:
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
            if constraint is not None:
                found.append(constraint)
        return found

    def constrain_as_one(self, best: Hypothesis, *, is_certain: bool = True) -> list[Constraint]:
        """Constraint of the middle key scan, by the points of all: they leave no direction open, as a few scans do.

        None if the match moves away from the hypothesis. If it is not certain the place is within a metre or so, which
        determines nothing of other key scans.
        """
        place = self.place_as_one(best)
        (from_, key), begin = place.pair, self.known.poses[place.from_]
        pose = compose(begin, place.measurement)
        match = self._match_points(self._as_submap(key, between(pose, best.poses)), pose)
        x, y, _ = between(pose, match.poses[0]).tolist()
        if math.hypot(x, y) > _MERGE_M:
            return []
        seen = transform_match(begin, match)
        guess = place.measurement
        constraint = Constraint.from_match(from_, key, guess, seen, _BEAM_SIGMA_M, 0.0, ConstraintSource.RECOGNIZED)
        return [constraint if is_certain else constraint._replace(information=_WIDE, determined=False)]

    def place_as_one(self, best: Hypothesis) -> Constraint:
        """Constrain the middle key scan to the nearest one of the map as a hypothesis has it: nothing confirms it."""
        middle = len(self.keys) // 2
        key, pose = int(self.keys[middle]), best.poses[middle]
        _, old_poses, old, _ = self.known
        from_ = int(old[np.hypot(*(old_poses[old, :2] - pose[:2]).T).argmin()])
        measurement = between(old_poses[from_], pose)
        return Constraint(from_, key, measurement, _SURE, ConstraintSource.RECOGNIZED, True)


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
