"""Places that were driven by long ago: submaps of the way are matched with all older ones, and accepted in sets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import between, compose, rotate_covariances
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.parameters import bounded, parameters
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource, key_scan_pairs
from gridslam.slam.loop_closure.key_graph import KeyGraph, position_sigmas
from gridslam.slam.loop_closure.place_matching import squared_sigmas
from gridslam.slam.loop_closure.state import LoopClosureState, SubmapPrior
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.types import FloatArray, IntArray, Match

_MATCH_SIGMA_M = 0.25
_MATCH_SIGMA_RAD = 0.03
"""Difference of two matches of overlapping submaps: each is bent by its drift."""
_CHI2 = 11.34
"""99 % of the chi-squared distribution with three degrees of freedom."""
_BEND_SHARE = 1 / 3
"""Part of a submap's drift variance by which its middle is off: the match is about the mean of a random walk."""
_DESCRIBED_AT_A_TIME = 2
_COMPARED_AT_A_TIME = 16
"""Submaps, 15 ms each, and pairs of them, 0.5 ms each, at a key scan; one pair that fits is verified, in 30 ms."""
_GATE_SIGMAS = 2.5
"""Standard deviations of the drift that a match may need."""
_MARGIN_M = 2.0
_MARGIN_RAD = 0.1
"""Margin added to these, m and rad."""
_DRIFT_M = 5.0
_DRIFT_RATIO = 0.08
_DRIFT_RAD = 0.5
"""Bounds of that, however uncertain the drift model is: metres, and metres for each metre of way; and radians. The
logs that this was measured on drift by a twentieth."""
_REACH_M = 60.0
"""Way, in both visits, within which matches support each other."""
_BEAM_SIGMA_M = 0.3
"""Standard deviation of one point in a constraint, inflated for correlated points and cell size."""


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
    min_matches : int
        Matches of a set, at least.
    runner_up_ratio : float
        A set waits while another one that contradicts it has as large a part of its matches.

    References
    ----------
    Mangelson et al., Pairwise consistent measurement set maximization for robust multi-robot map merging (ICRA 2018).
    """

    length_m: float = bounded(30.0, ge=1, le=1e6)
    step_m: float = bounded(10.0, ge=0.1, le=1e6)
    apart_m: float = bounded(40.0, ge=0.1, le=1e6)
    certain_sigma_m: float = bounded(0.3, ge=0, le=100)
    min_matches: int = bounded(3, ge=1, le=1000)
    runner_up_ratio: float = bounded(0.5, ge=0, le=100)

    def search(self, closure_state: LoopClosureState, mapper: OccupancyGridMapping) -> None:
        """Do one key scan's share of the comparison of submaps: candidates are added to those of the state.

        What is done at a key scan depends on counts alone: results do not depend on time, and no scan waits for long.
        """
        graph, search, pairs = closure_state.graph, closure_state.search, closure_state.pairs
        pairs.cut(graph, closure_state.scans, mapper, self.length_m, self.step_m)
        if search.described < len(pairs.submaps):
            last = min(search.described + _DESCRIBED_AT_A_TIME, len(pairs.submaps))
            for submap in pairs.submaps[search.described : last]:
                _ = submap.features  # are kept
            search.described = last
            return
        if not search.left and search.compared < len(pairs.submaps):
            if pairs.submaps[search.compared].anchor >= search.first_key:
                search.left, left_out = self._expect(graph, pairs, search.compared)
                search.unsearched += left_out > 0
            search.compared += 1
        for _ in range(_COMPARED_AT_A_TIME):
            if not search.left:
                return
            prior = search.left.pop(0)
            newer = search.compared - 1
            allowed = self._propose(pairs, prior, newer)
            if allowed:
                found = self._verify(graph, pairs, prior, newer, allowed)
                search.candidates += found
                search.is_undecided |= bool(found)
                return

    def decide(self, closure_state: LoopClosureState) -> tuple[list[Constraint], list[Constraint]]:
        """Accept and reject candidates about the newest part of the way: those of either kind.

        None is rejected for want of those that support it but are older than that part.
        """
        graph = closure_state.graph
        candidates = closure_state.search.candidates
        way = graph.driven_m()
        newest_m = way[candidates[-1].to]
        recent = [c for c in candidates if way[c.to] > newest_m - 2 * _REACH_M]
        are_accepted = self.accept(graph, recent).tolist()
        accepted = [c for c, is_accepted in zip(recent, are_accepted, strict=True) if is_accepted]
        others = [c for c, is_accepted in zip(recent, are_accepted, strict=True) if not is_accepted]
        return accepted, [c for c in others if way[c.to] > newest_m - _REACH_M]

    def search_all(
        self,
        closure_state: LoopClosureState,
        mapper: OccupancyGridMapping,
        pairs: SubmapPairs,
        on_progress: Callable[[], None],
        searched: int = 0,
    ) -> tuple[list[Constraint], int]:
        """Compare all submaps of a completed drive: accepted closures, and the number of rejected candidates.

        How many submaps were not compared with all that the drift model allows for is counted in the state's search.

        The graph's constraints determine how the parts of the way lie to each other. Submaps whose middles are among
        the first `searched` key scans are not compared with each other.
        """
        graph = closure_state.graph
        pairs.cut(graph, closure_state.scans, mapper, self.length_m, self.step_m, is_over=True)
        candidates: list[Constraint] = []
        closure_state.search.unsearched = 0
        for newer, submap in enumerate(pairs.submaps):
            if submap.anchor < searched:
                continue
            on_progress()
            expected, left_out = self._expect(graph, pairs, newer)
            closure_state.search.unsearched += left_out > 0
            for prior in expected:
                allowed = self._propose(pairs, prior, newer)
                candidates += self._verify(graph, pairs, prior, newer, allowed)
        accepted = self.accept(graph, candidates).tolist() if candidates else []
        recognized = [candidate for candidate, is_accepted in zip(candidates, accepted, strict=True) if is_accepted]
        return recognized, len(candidates) - len(recognized)

    def _expect(self, graph: KeyGraph, pairs: SubmapPairs, newer: int) -> tuple[list[SubmapPrior], int]:
        """Expect older submaps that may show the same place, and count those that the bound of the drift leaves out."""
        if not newer:
            return [], 0
        anchors = np.array([submap.anchor for submap in pairs.submaps[:newer]], np.int64)
        key = pairs.submaps[newer].anchor
        way = graph.driven_m()
        labels = graph.label_rigid_components()
        radii = np.array([submap.radius_m for submap in pairs.submaps[: newer + 1]])
        poses, covariances = graph.locate(key, anchors)
        sigmas_m, sigmas_rad = position_sigmas(covariances), np.sqrt(covariances[:, 2, 2])
        driven = way[key] - way[anchors]
        is_rigid = labels[anchors] == labels[key]
        explained_m = _GATE_SIGMAS * sigmas_m + _MARGIN_M
        reach_rad = _GATE_SIGMAS * sigmas_rad + _MARGIN_RAD
        bound_m = np.where(is_rigid, _DRIFT_M + _DRIFT_RATIO * driven, np.inf)
        reach_rad = np.where(is_rigid, np.minimum(reach_rad, _DRIFT_RAD), reach_rad)
        reach_m = np.minimum(explained_m, bound_m)
        away_m = np.hypot(poses[:, 0], poses[:, 1]) - radii[:-1] - radii[-1]
        is_wanted = (sigmas_m >= self.certain_sigma_m) & ((driven >= self.apart_m) | ~is_rigid)
        left_out = int(np.count_nonzero(is_wanted & (away_m >= reach_m) & (away_m < explained_m)))
        chosen = np.flatnonzero(is_wanted & (away_m < reach_m)).tolist()
        return [SubmapPrior(k, poses[k], float(reach_m[k]), float(reach_rad[k])) for k in chosen], left_out

    def _propose(self, pairs: SubmapPairs, prior: SubmapPrior, newer: int) -> list[int]:
        """Propose poses of a submap in an older one, by their numbers, that the drift explains."""
        return [number for number, pose in enumerate(pairs.propose(prior.older, newer)) if prior.allows(pose)]

    def _verify(
        self, graph: KeyGraph, pairs: SubmapPairs, prior: SubmapPrior, newer: int, allowed: list[int]
    ) -> list[Constraint]:
        """Verify proposed poses.

        Across a gap in the laser data the shape of the drift must explain them, too, and walls leave no place beside.
        """
        found = [
            self._make_constraint(graph, pairs, prior.older, newer, match)
            for match in pairs.verify(prior.older, newer, allowed)
        ]
        if not found:
            return []
        labels = graph.label_rigid_components()
        from_, to = found[0].pair
        if labels[from_] == labels[to]:
            return found
        return [
            it
            for it in found
            if drift_distance(graph, from_, to, it.measurement) < _GATE_SIGMAS**2
            and not pairs.leave_open(prior.older, newer, it.measurement)
        ]

    def accept(self, graph: KeyGraph, candidates: Sequence[Constraint]) -> NDArray[np.bool_]:
        """Accept candidates (C,) that belong to a large set of consistent ones without a runner-up.

        Only those without a runner-up of their own count in a set: a match that agrees equally with two places is
        evidence for neither. Across a gap in the laser data drift excludes few places, and a set is not accepted while
        any match contradicts it: such a match shows that the place looks like others, which may not be mapped yet.
        """
        agree, support = self._compare(graph, candidates)
        consistent = support & agree
        sizes = _clique_sizes(consistent)
        runners_up = np.where(support & ~agree, sizes, 0).max(axis=1)
        ends = graph.label_gaps()[key_scan_pairs(candidates)]
        ratios = np.where(ends[:, 0] == ends[:, 1], self.runner_up_ratio, 0.0)
        is_clear = (runners_up == 0) | (runners_up < ratios * sizes)
        return np.asarray(is_clear & (_clique_sizes(consistent & is_clear) >= self.min_matches))

    def _compare(
        self, graph: KeyGraph, candidates: Sequence[Constraint]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Whether each two candidates (C, C) agree with the motion between them, and whether that is to be expected.

        It is where the submaps of both are near each other, by metres driven, in both visits.
        """
        older, newer = key_scan_pairs(candidates).T
        poses = np.array([candidate.measurement for candidate in candidates])
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
        is_near = np.abs(way[newer[a]] - way[newer[b]]) < _REACH_M
        is_near &= np.abs(way[older[a]] - way[older[b]]) < _REACH_M
        return squared < _CHI2, is_near

    def _make_constraint(self, graph: KeyGraph, pairs: SubmapPairs, older: int, newer: int, found: Match) -> Constraint:
        """Constrain the middles of two submaps, as their match and their own drift determine it."""
        steps = [np.array(graph.variances)[pairs.submaps[number].keys[1:]] for number in (older, newer)]
        bend = _BEND_SHARE * np.concatenate(steps).sum(axis=0)
        (pose,) = found.poses
        information = rotate_covariances(found.information[0], -pose[2]) / _BEAM_SIGMA_M**2
        covariance = np.linalg.inv(information) + np.diag(bend[[0, 0, 1]])
        weight = np.asarray(np.linalg.inv(covariance), np.float64)
        from_, to = (pairs.submaps[number].anchor for number in (older, newer))
        return Constraint(from_, to, pose, weight, ConstraintSource.RECOGNIZED, True)


def drift_distance(graph: KeyGraph, older: int, key: int, pose: FloatArray) -> float:
    """Squared Mahalanobis distance of a key scan's pose (3,), seen from an older one, from where it is expected."""
    (expected,), (covariance,) = graph.locate(key, np.array([older]))
    here, there = compose(graph.poses[older], np.stack([expected, pose]))
    return squared_sigmas(covariance, wrap_headings(there - here))


def _clique_sizes(consistent: NDArray[np.bool_]) -> IntArray:
    """Sizes (C,) of cliques with each candidate, found greedily: always the one that most of those left agree with."""
    sizes = np.ones(len(consistent), np.int64)
    for first in range(len(consistent)):
        left = np.flatnonzero(consistent[first] & (np.arange(len(consistent)) != first))
        while len(left):
            agreeing = consistent[np.ix_(left, left)]
            best = int(np.argmax(agreeing.sum(axis=1)))
            left = left[agreeing[best] & (np.arange(len(left)) != best)]
            sizes[first] += 1
    return sizes
