"""Places that were driven by long ago: submaps of the way are matched with all older ones, and accepted in sets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose, rotate_covariances
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.parameters import bounded, parameters
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph, first_key_scan, submap_of
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submap_matching import DrawnSubmap, Submap, SubmapMatch, SubmapMatching
from gridslam.types import FloatArray, IntArray

__all__ = ["PlaceCandidate", "SubmapPairs", "SubmapRecognition"]

_FEWEST_KEY_SCANS = 5
_MOST_DRAWN = 8
"""Drawn submaps that are kept, 1 to 4 MB each."""
_MATCH_SIGMA_M = 0.25
_MATCH_SIGMA_RAD = 0.03
"""What two matches of overlapping submaps differ by: each is bent by its drift."""
_CHI2 = 11.34
"""99 % of the chi-squared distribution with three degrees of freedom."""
_BEND_SHARE = 1 / 3
"""Part of a submap's drift variance by which its middle is off: the match is about the mean of a random walk."""


@final
class PlaceCandidate(NamedTuple):
    """A match of two submaps of different visits, by their numbers."""

    older: int
    newer: int
    found: SubmapMatch


class SubmapPairs:
    """The submaps of a run, and their matches, each computed once.

    Submaps lie as they were tracked: what was matched holds whatever becomes of the trajectory.

    Parameters
    ----------
    submaps : list of Submap
        In the order of the way.
    matching : SubmapMatching
        How two of them are matched.
    """

    def __init__(self, submaps: list[Submap], matching: SubmapMatching) -> None:
        self.submaps = submaps
        self.anchors: IntArray = np.array([submap.anchor for submap in submaps], np.int64)
        self._matching = matching
        self._proposed: dict[tuple[int, int], list[tuple[FloatArray, int]]] = {}
        self._verified: dict[tuple[int, int, int], SubmapMatch | None] = {}
        self._drawn: dict[int, DrawnSubmap] = {}

    def match(self, older: int, newer: int, is_plausible: Callable[[FloatArray], bool]) -> Iterator[PlaceCandidate]:
        """Yield the distinct matches of two submaps at proposed poses (3,) that are plausible."""
        pair = (older, newer)
        if pair not in self._proposed:
            self._proposed[pair] = self._matching.propose(self.submaps[older], self.submaps[newer])
        found: list[FloatArray] = []
        for number, (pose, keypoints) in enumerate(self._proposed[pair]):
            if not is_plausible(pose):
                continue
            key = (*pair, number)
            if key not in self._verified:
                self._verified[key] = self._matching.verify(self._draw(older), self._draw(newer), pose, keypoints)
            match = self._verified[key]
            if match is not None and not any(self._matching.is_same_place(match.pose, other) for other in found):
                found.append(match.pose)
                yield PlaceCandidate(older, newer, match)

    def _draw(self, number: int) -> DrawnSubmap:
        """Draw a submap, or take it where it was drawn lately."""
        drawn = self._drawn.pop(number, None) or self.submaps[number].draw(self._matching.max_points)
        while len(self._drawn) >= _MOST_DRAWN:
            del self._drawn[next(iter(self._drawn))]
        self._drawn[number] = drawn  # the last used one comes last
        return drawn


@final
class _Prior(NamedTuple):
    """Where a submap is expected, seen from an older one: pose (3,), and how far it may be from there."""

    pose: FloatArray
    reach_m: float
    reach_rad: float

    def allows(self, pose: FloatArray) -> bool:
        """Whether the drift explains a pose (3,)."""
        x, y, turn = (pose - self.pose).tolist()
        return math.hypot(x, y) < self.reach_m and abs(wrap(turn)) < self.reach_rad


@final
@parameters(frozen=True)
class SubmapRecognition:
    """Recognizes places by matching submaps, some tens of metres of the way each, with all older ones.

    One scan of a corridor or of a lawn fits in many places, tens of metres of way hardly ever do by chance. Where they
    do, as in rows of equal rooms, they do it again and again, but in several places: a match counts only in a set
    of matches that agree with each other and with the motion between them, and if no other set about the
    same part of the way is nearly as large.

    Parameters
    ----------
    length_m, step_m : float, m
        Way of a submap, and way from one to the next.
    apart_m : float, m
        Way between two submaps to be matched, at least.
    certain_sigma_m : float, m
        Standard deviation of the relative position below which a place needs no recognition.
    gate_sigmas : float
        Standard deviations of the drift that a match may need.
    margin_m, margin_rad : float
        What it may need besides.
    drift_m, drift_ratio, drift_rad : float
        Bounds of that, however uncertain the drift model is: metres, and metres for each metre of way; and
        radians. The logs that this was measured on drift by a twentieth.
    reach_m : float, m
        Way, in both visits, within which matches support each other.
    min_matches : int
        Matches of a set, at least.
    runner_up_ratio : float
        A set waits while another one that contradicts it has as large a part of its matches.
    beam_sigma_m : float, m
        Standard deviation of one point in a constraint, inflated for correlated points and cell size.
    matching : SubmapMatching
        How two submaps are matched.

    References
    ----------
    Mangelson et al., Pairwise consistent measurement set maximization for robust multi-robot map merging (ICRA 2018).
    """

    length_m: float = bounded(30.0, ge=1, le=1e6)
    step_m: float = bounded(10.0, ge=0.1, le=1e6)
    apart_m: float = bounded(40.0, ge=0.1, le=1e6)
    certain_sigma_m: float = bounded(0.3, ge=0, le=100)
    gate_sigmas: float = bounded(2.5, ge=0.01, le=1000)
    margin_m: float = bounded(2.0, ge=0, le=1e6)
    margin_rad: float = bounded(0.1, ge=0, le=100)
    drift_m: float = bounded(5.0, ge=0, le=1e6)
    drift_ratio: float = bounded(0.08, ge=0, le=10)
    drift_rad: float = bounded(0.5, ge=0, le=100)
    reach_m: float = bounded(60.0, ge=1, le=1e6)
    min_matches: int = bounded(3, ge=1, le=1000)
    runner_up_ratio: float = bounded(0.5, ge=0, le=100)
    beam_sigma_m: float = bounded(0.3, ge=1e-6, le=100)
    matching: SubmapMatching = SubmapMatching()

    def cut(self, graph: KeyGraph, scans: ScanArchive, mapper: OccupancyGridMapping) -> SubmapPairs:
        """Cut the way into submaps that overlap, none across a gap in the laser data."""
        way = graph.driven_m()
        labels = graph.label_gaps()
        submaps = []
        for label in np.unique(labels).tolist():
            own = np.flatnonzero(labels == label)
            begin, end = way[own[[0, -1]]].tolist()
            last = max(end - self.length_m, begin)
            for first in (*np.arange(begin, last, self.step_m).tolist(), last):
                keys = own[(way[own] >= first) & (way[own] <= first + self.length_m)]
                if len(keys) >= _FEWEST_KEY_SCANS:
                    submaps.append(Submap.of(graph, int(keys[len(keys) // 2]), keys, scans, mapper))
        return SubmapPairs(submaps, self.matching)

    def __call__(
        self, graph: KeyGraph, pairs: SubmapPairs, on_progress: Callable[[], None], searched: int = 0
    ) -> tuple[list[Constraint], int]:
        """Recognize places: constraints between the middles of submaps, and how many candidates were rejected.

        The graph's constraints determine how the parts of the way lie to each other. Submaps whose middles are among
        the first `searched` key scans are not compared with each other.
        """
        candidates = self._find_candidates(graph, pairs, on_progress, searched)
        if not candidates:
            return [], 0
        accepted = self.accept(graph, pairs.anchors, candidates).tolist()
        drift = np.cumsum(np.array(graph.variances), axis=0)
        recognized = [
            self._make_constraint(drift, pairs, candidate)
            for candidate, is_accepted in zip(candidates, accepted, strict=True)
            if is_accepted
        ]
        return recognized, len(candidates) - len(recognized)

    def _find_candidates(
        self, graph: KeyGraph, pairs: SubmapPairs, on_progress: Callable[[], None], searched: int
    ) -> list[PlaceCandidate]:
        """Match all pairs of submaps that may show the same place."""
        tracked = np.array(graph.tracked)
        way = graph.driven_m()
        labels = graph.label_rigid_components()
        radii = np.array([submap.radius_m for submap in pairs.submaps])
        candidates: list[PlaceCandidate] = []
        for newer, key in enumerate(pairs.anchors.tolist()):
            if not newer or key < searched:
                continue
            on_progress()
            anchors = pairs.anchors[:newer]
            poses, sigmas_m, sigmas_rad = _locate(graph, tracked, anchors, key)
            driven = way[key] - way[anchors]
            is_rigid = labels[anchors] == labels[key]
            reach_m = self.gate_sigmas * sigmas_m + self.margin_m
            reach_rad = self.gate_sigmas * sigmas_rad + self.margin_rad
            reach_m = np.where(is_rigid, np.minimum(reach_m, self.drift_m + self.drift_ratio * driven), reach_m)
            reach_rad = np.where(is_rigid, np.minimum(reach_rad, self.drift_rad), reach_rad)
            is_wanted = (sigmas_m >= self.certain_sigma_m) & ((driven >= self.apart_m) | ~is_rigid)
            is_wanted &= np.hypot(poses[:, 0], poses[:, 1]) < reach_m + radii[:newer] + radii[newer]
            for older in np.flatnonzero(is_wanted).tolist():
                prior = _Prior(poses[older], float(reach_m[older]), float(reach_rad[older]))
                candidates += pairs.match(older, newer, prior.allows)
        return candidates

    def accept(self, graph: KeyGraph, anchors: IntArray, candidates: Sequence[PlaceCandidate]) -> NDArray[np.bool_]:
        """Accept candidates (C,) that belong to a large set of consistent ones without a runner-up."""
        agree, support = self._compare(graph, anchors, candidates)
        sizes = np.array([_clique_size(support & agree, first) for first in range(len(candidates))])
        runners_up = np.where(support & ~agree, sizes, 0).max(axis=1)
        return np.asarray((sizes >= self.min_matches) & (runners_up < self.runner_up_ratio * sizes))

    def _compare(
        self, graph: KeyGraph, anchors: IntArray, candidates: Sequence[PlaceCandidate]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether each two candidates (C, C) agree with the motion between them, and whether that is to be expected.

        It is where the submaps of both are near each other, by metres driven, in both visits.
        """
        older = anchors[[candidate.older for candidate in candidates]]
        newer = anchors[[candidate.newer for candidate in candidates]]
        poses = np.array([candidate.found.pose for candidate in candidates])
        tracked = np.array(graph.tracked)
        way = graph.driven_m()
        drift = np.cumsum(np.array(graph.variances), axis=0)
        a, b = np.indices((len(candidates), len(candidates)))
        in_newer = between(tracked[newer[a]], tracked[newer[b]])
        in_older = between(tracked[older[a]], tracked[older[b]])
        error = between(compose(poses[a], in_newer), compose(in_older, poses[b]))
        variances = np.abs(drift[older[a]] - drift[older[b]]) + np.abs(drift[newer[a]] - drift[newer[b]])
        heading = 2 * _MATCH_SIGMA_RAD**2 + variances[..., 1]
        lever = np.hypot(in_newer[..., 0], in_newer[..., 1]) + np.hypot(in_older[..., 0], in_older[..., 1])
        position = 2 * _MATCH_SIGMA_M**2 + variances[..., 0] + heading * np.square(lever) / 3
        squared = np.square(error[..., :2]).sum(axis=-1) / position + np.square(error[..., 2]) / heading
        is_near = np.abs(way[newer[a]] - way[newer[b]]) < self.reach_m
        is_near &= np.abs(way[older[a]] - way[older[b]]) < self.reach_m
        return squared < _CHI2, is_near

    def _make_constraint(self, drift: FloatArray, pairs: SubmapPairs, candidate: PlaceCandidate) -> Constraint:
        """Constrain the middles of two submaps, as their match and their own drift determine it.

        `drift` (T, 2) are the variances of position and heading that the way up to each key scan adds.
        """
        older, newer, found = candidate
        ends = np.array([pairs.submaps[number].keys[[0, -1]] for number in (older, newer)])
        bend = _BEND_SHARE * (drift[ends[:, 1]] - drift[ends[:, 0]]).sum(axis=0)
        information = rotate_covariances(found.match.information[0], -found.pose[2]) / self.beam_sigma_m**2
        covariance = np.linalg.inv(information) + np.diag(bend[[0, 0, 1]])
        weight = np.asarray(np.linalg.inv(covariance), np.float64)
        from_, to = pairs.anchors[[older, newer]].tolist()
        return Constraint(from_, to, found.pose, weight, ConstraintSource.RECOGNIZED, True)


def _locate(
    graph: KeyGraph, tracked: FloatArray, anchors: IntArray, key: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses (A, 3) of a key scan seen from others, (A,), along the least uncertain ways, and their deviations (A,)."""
    nearby = graph.find_nearby_submaps(key, math.inf, len(graph))
    place = np.empty(submap_of(len(graph)) + 1, np.int64)
    place[nearby.submaps] = np.arange(len(nearby))
    submaps = submap_of(anchors)
    ways = place[submaps]
    poses = compose(between(tracked[anchors], tracked[first_key_scan(submaps)]), nearby.poses[ways])
    return poses, nearby.sigmas_m[ways], np.sqrt(nearby.covariances[ways, 2, 2])


def _clique_size(consistent: NDArray[np.bool_], first: int) -> int:
    """Size of a clique with `first`, found greedily: always the candidate that most of those left agree with."""
    left = np.flatnonzero(consistent[first] & (np.arange(len(consistent)) != first))
    size = 1
    while len(left):
        agreeing = consistent[np.ix_(left, left)]
        best = int(np.argmax(agreeing.sum(axis=1)))
        left = left[agreeing[best] & (np.arange(len(left)) != best)]
        size += 1
    return size
