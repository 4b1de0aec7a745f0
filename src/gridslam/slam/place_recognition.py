"""Recognizing old places by scan matching, and believing it only when nothing speaks against it."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound, Found, thinned
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam import place_evidence as evidence
from gridslam.slam.key_graph import BLOCK, KeyGraph, Nearby
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.submaps import ROW, anchor_of
from gridslam.slam.ties import Source, Tie, surveyed
from gridslam.types import FloatArray

__all__ = ["PlaceRecognition"]


_FEW, _MOST_SUBMAPS = 12, 24
"""Submaps in which a place is searched for, and those from which it must be told."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceRecognition:
    """Ties key scans to older submaps: those it still knows its way to, and those it recognizes.

    A place is recognized when the points of the last key scans fit the old map somewhere within what the drift allows
    (branch and bound), nowhere else within it as well, in all directions, without looking through walls, and when the
    next searches say the same.

    Parameters
    ----------
    gap : int
        Submaps this recent are no old place.
    near_m : float, m
        Two key scans this close see enough in common to be matched.
    overlap : float
        Share of the points that must lie in what the old map knows: where it knows nothing, nothing can agree.
    share : float
        Share of those that must agree with the old map.
    known_m : float, m
        Where the position relative to a submap is this certain (standard deviation), its scans are tied without search.
    follow : int
        Key scans for which the robot is followed from one that was tied in all directions.
    follow_m : float, m
        A match farther from where the robot was followed to is not believed, since it contradicts the motion from tie
        to tie: what it fits has moved, or it slid along a wall.
    believed_m : float, m
        Where the filter has the robot farther than this from where it was tracked to, its belief is not taken over: a
        map that repeats itself may have drawn it there.
    every : int
        Key scans between two searches.
    query : int
        Key scans whose points are searched together.
    other_share : float
        A second place with this share of the best one's agreement makes it ambiguous.
    unlike_m, unlike_rad : float
        Not only within the drift: where the map repeats itself this near, the next room may be one never seen.
    through : float
        Share of the beams that may pass through what the old map knows as walls: doors and furniture move.
    confirmations : int
        Searches in a row that must agree.
    agree_m, agree_rad : float
        How far they may differ.
    least_information : float
        Least eigenvalue of the position's information, per agreeing beam: along a corridor whose doors are shut nothing
        is recognized.
    beam_sigma_m : float, m
        Standard deviation of what one beam says about a tie, beams being correlated and walls a cell thick.
    search : BranchAndBound
        How a place is searched for.
    matcher : GaussNewton
        How a match is refined.
    """

    gap: int = Field(default=3, ge=1)
    near_m: float = Field(default=4.0, gt=0)
    overlap: float = Field(default=0.6, gt=0, le=1)
    share: float = Field(default=0.75, gt=0, le=1)
    known_m: float = Field(default=0.15, gt=0)
    follow: int = Field(default=12, ge=1)
    follow_m: float = Field(default=0.2, gt=0)
    believed_m: float = Field(default=1.2, gt=0)
    every: int = Field(default=6, ge=1)
    query: int = Field(default=16, ge=1)
    other_share: float = Field(default=0.8, gt=0, le=1)
    unlike_m: float = Field(default=10.0, ge=0)
    unlike_rad: float = Field(default=0.2, ge=0)
    through: float = Field(default=0.2, ge=0, le=1)
    confirmations: int = Field(default=3, ge=1)
    agree_m: float = Field(default=0.25, gt=0)
    agree_rad: float = Field(default=0.05, gt=0)
    least_information: float = Field(default=0.06, ge=0)
    beam_sigma_m: float = Field(default=0.3, gt=0)
    search: BranchAndBound = BranchAndBound(window_m=30.0, gate=2.5, floor=0.45)
    matcher: GaussNewton = GaussNewton()

    def __call__(self, memory: Memory, mapper: OccupancyGridMapping) -> list[Tie]:
        """Look at the newest key scan; returns the ties of a place just recognized, which are in the graph, too."""
        graph = memory.graph
        newest = len(graph) - 1
        if newest // BLOCK < self.gap or len(memory.scans.key(newest)) < self.matcher.least_beams:
            return []
        if self._tie_known(memory, mapper):
            memory.hypotheses.clear()
            return []
        if newest < memory.next_search:
            return []
        found = self._recognize(memory, mapper)
        if found is None:
            return []
        if isinstance(found, Rejection):
            self._reject(memory, found)
            return []
        agreeing = [h for h in memory.hypotheses if newest - h.to <= 6 * self.every and self._agree(graph, h, found)]
        if memory.hypotheses and not agreeing:
            memory.rejected[Rejection.INCONSISTENT] += 1
        memory.hypotheses = [*agreeing, found]
        memory.failures, memory.next_search = 0, newest + self.every // 2
        if len(memory.hypotheses) < self.confirmations:
            return []
        ties, memory.hypotheses = memory.hypotheses, []
        for tie in ties:
            graph.add(tie)
        return ties

    def _reject(self, memory: Memory, reason: Rejection) -> None:
        """Count a place that was not believed; what fits nowhere is searched for less and less often."""
        memory.rejected[reason] += 1
        memory.failures = memory.failures + 1 if reason is Rejection.POOR else 0
        if reason is not Rejection.POOR:
            memory.hypotheses.clear()
        memory.next_search = len(memory.graph) - 1 + self.every * max(1, min(memory.failures, 4))

    def _tie_known(self, memory: Memory, mapper: OccupancyGridMapping) -> bool:
        """Tie the newest key scan to an old submap where it is certain, or believed, to be; whether it is certain."""
        graph = memory.graph
        oldest = (len(graph) - 1) // BLOCK - self.gap
        followed = self._followed(graph, oldest)
        guess = followed or self._believed(memory, oldest)
        if guess is None:
            return False
        most_m = 3 * self.known_m if followed is None else self.follow_m
        tie = self._match(memory, mapper, *guess, most_m, Source.KNOWN)
        if isinstance(tie, Rejection):
            return False
        if followed is None:
            way = next((n for n in graph.nearby(self.search.window_m, 256) if n.block == guess[0]), None)
            if way is None:
                return False
            missed, far = evidence.missed_by(graph, way, tie), self.believed_m
            if math.hypot(missed[0], missed[1]) > far or not self._plausible(way.covariance, missed):
                return False
            if way.sigma_m > self.known_m:
                if not tie.determined and way.sigma_m > 2 * self.known_m:
                    return False
                tie = tie._replace(source=Source.BELIEVED)
        graph.add(tie)
        return tie.source is Source.KNOWN

    def _plausible(self, covariance: FloatArray, missed: FloatArray) -> bool:
        return evidence.plausible(covariance, missed, self.search.gate)

    def _beyond(self) -> FloatArray:
        """What widens the search to all places that must be unlike the one found."""
        return np.square(np.diag([self.unlike_m, self.unlike_m, self.unlike_rad]) / self.search.gate)

    def _followed(self, graph: KeyGraph, oldest: int) -> tuple[int, FloatArray] | None:
        """The submap to which the robot has come from one to which it was tied, and its pose in that one's frame."""
        newest = len(graph) - 1
        known = (t for t in reversed(graph.ties[-self.follow :]) if t.determined and t.source is not Source.BELIEVED)
        last = next(known, None)
        if last is None or newest - last.to > self.follow:
            return None
        seen = compose(last.measurement, between(graph.tracked[last.to], graph.tracked[newest]))
        block = last.from_ // BLOCK
        near = [b for b in (block - 1, block, block + 1) if 0 <= b <= oldest]
        places = [between(graph.local(anchor_of(block), anchor_of(b)), seen) for b in near]
        away = [math.hypot(place[0], place[1]) for place in places]
        best = int(np.argmin(away))
        return (near[best], places[best]) if away[best] < self.near_m else None

    def _believed(self, memory: Memory, oldest: int) -> tuple[int, FloatArray] | None:
        """The old submap nearest to where the filter has the robot, and the robot's pose in its frame."""
        anchors, here = np.array(memory.said[anchor_of(0) : anchor_of(oldest) + 1 : BLOCK]), memory.said[-1]
        away = np.hypot(*(anchors[:, :2] - here[:2]).T)
        block = int(away.argmin())
        return (block, between(anchors[block], here)) if away[block] < self.near_m else None

    def _match(
        self, memory: Memory, mapper: OccupancyGridMapping, block: int, guess: FloatArray, most_m: float, source: Source
    ) -> Tie | Rejection:
        """Match the newest key scan to a submap, within `most_m` of a guess (3,) in its frame."""
        newest = len(memory.graph) - 1
        beams = memory.scans.key(newest)
        maps = memory.submaps(block, mapper, memory.scans, memory.graph)
        match = self.matcher(maps, ROW, guess[None], np.full((1, 3, 3), 1e-9) * np.eye(3), beams)
        match = surveyed(match, maps, ROW, beams)
        pose = match.poses[0]
        moved = between(guess, pose)
        if math.hypot(moved[0], moved[1]) > most_m or not self._agrees(maps, pose, beams.ends):
            return Rejection.POOR
        return Tie.of(anchor_of(block), newest, guess, match, self.beam_sigma_m, self.least_information, source)

    def _agrees(self, maps: TileMaps, pose: FloatArray, points: FloatArray) -> bool:
        """Whether enough of points (B, 2), seen from a pose, lie in what the map knows, and agree with it."""
        return evidence.agreement(maps, pose, points, self.overlap, self.matcher.cauchy_m) >= self.share

    def _recognize(self, memory: Memory, mapper: OccupancyGridMapping) -> Tie | Rejection | None:
        """Search the newest key scans in the old submaps where the robot may be, and then in all it must be told from.

        Where the map to search in has to be drawn first, that is all for now: no scan shall wait for both.
        """
        graph = memory.graph
        candidates = self._candidates(graph)
        if not candidates:
            return None
        way, blocks = candidates[0], tuple(n.block for n in candidates)
        guess = compose(graph.poses[way.block * BLOCK], way.pose)
        points = thinned(evidence.recent_points(memory, self.query), self.search.points)
        if set(blocks[:_FEW]) <= set(memory.wide):
            found = self._told_apart(memory, mapper, guess, way.covariance, points)
            memory.wide = () if isinstance(found, Rejection) else memory.wide
            return found
        near = [n.block for n in candidates if self._away(n) < self.search.gate][:_FEW]
        if not set(near[:6]) <= set(memory.area):
            oldest = (len(graph) - 1) // BLOCK - self.gap
            seen_too = {b for block in near for b in range(block - 1, block + 2)}  # what is seen reaches farther
            memory.area = tuple(sorted(b for b in seen_too if 0 <= b <= oldest))
            memory.submaps.joint(memory.area, mapper, memory.scans, graph)
            return None
        pyramid = memory.submaps.pyramid(memory.area, mapper, memory.scans, graph)
        maps = memory.submaps.joint(memory.area, mapper, memory.scans, graph)
        near_place = self.search.search(pyramid, guess, way.covariance, points)
        if near_place is None or not self._agrees(maps, near_place.pose, points):
            return Rejection.POOR
        memory.wide = tuple(sorted(blocks))
        memory.submaps.joint(memory.wide, mapper, memory.scans, graph)
        return None

    def _told_apart(
        self, memory: Memory, mapper: OccupancyGridMapping, guess: FloatArray, spread: FloatArray, points: FloatArray
    ) -> Tie | Rejection:
        """Search in all the places that the one found must be told from."""
        graph, blocks = memory.graph, memory.wide
        pyramid = memory.submaps.pyramid(blocks, mapper, memory.scans, graph)
        maps = memory.submaps.joint(blocks, mapper, memory.scans, graph)
        found = self.search.search(pyramid, guess, spread + self._beyond(), points)
        if found is None:
            return Rejection.POOR
        if not self._plausible(spread, np.append((found.pose - guess)[:2], between(guess, found.pose)[2])):
            return Rejection.IMPLAUSIBLE
        if rejection := self._judged(found, maps, points, memory):
            return rejection
        anchors = np.array([graph.poses[anchor_of(b)] for b in blocks])
        block = blocks[int(np.argmin(np.hypot(*(anchors[:, :2] - found.pose[:2]).T)))]
        seen = between(graph.poses[anchor_of(block)], found.pose)
        tie = self._match(memory, mapper, block, seen, 3 * self.known_m, Source.RECOGNIZED)
        return tie if isinstance(tie, Rejection) or tie.determined else Rejection.UNDETERMINED

    def _candidates(self, graph: KeyGraph) -> list[Nearby]:
        """Old submaps that the robot may be in, the one that it would have to be moved least for first."""
        oldest = (len(graph) - 1) // BLOCK - self.gap
        found = []
        for nearby in graph.nearby(self.search.window_m / self.search.gate, len(graph)):
            if nearby.block > oldest:
                continue
            away = self._away(nearby)
            if away * nearby.sigma_m < self.search.gate * nearby.sigma_m + self.unlike_m:
                found.append((away, nearby.block, nearby))
        found.sort(key=lambda f: f[:2])
        near = found and found[0][0] < self.search.gate
        return [nearby for _, _, nearby in found[:_MOST_SUBMAPS]] if near else []

    def _away(self, nearby: Nearby) -> float:
        """By how many standard deviations the robot would have to be elsewhere to be in a submap."""
        return max(math.hypot(nearby.pose[0], nearby.pose[1]) - self.near_m, 0.0) / nearby.sigma_m

    def _judged(self, found: Found, maps: TileMaps, points: FloatArray, memory: Memory) -> Rejection | None:
        """What speaks against a place that was found."""
        if not self._agrees(maps, found.pose, points):
            return Rejection.POOR
        if found.other_share > self.other_share * found.share:
            return Rejection.AMBIGUOUS
        beams = memory.scans.key(len(memory.graph) - 1)
        return Rejection.THROUGH_WALLS if evidence.through_walls(maps, found.pose, beams) > self.through else None

    def _agree(self, graph: KeyGraph, earlier: Tie, later: Tie) -> bool:
        """Whether the motion between two key scans leads from the one place to the other."""
        missed = evidence.disagreement(graph, earlier, later)
        return math.hypot(missed[0], missed[1]) < self.agree_m and abs(missed[2]) < self.agree_rad
