"""Alignment of rigid components of the trajectory that are separated by gaps in the laser data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid, thinned
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam import place_evidence as evidence
from gridslam.slam.key_graph import BLOCK, KeyGraph, Nearby
from gridslam.slam.memory import Memory
from gridslam.slam.place_parameters import PlaceParameters
from gridslam.slam.submaps import ROW, anchor_of, drawn
from gridslam.slam.ties import Source, Tie
from gridslam.types import FloatArray, IntArray

__all__ = ["PieceAlignment"]

_LOOSE = np.full((1, 3, 3), 1e-6) * np.eye(3)


@final
@dataclass(frozen=True, slots=True)
class _Hit:
    """Where a search found a key scan in the map of another piece."""

    key: int
    pose: FloatArray
    share: float
    plausible: bool
    alone: bool


@final
@dataclass(frozen=True, slots=True)
class _Alignment:
    """A piece followed through the map of another one from the best of the hits that agree.

    `poses` (K, 3) are those of all its key scans, `nats` their log likelihood; `alone` hits had no other place that
    fits nearly as well.
    """

    poses: FloatArray
    nats: float
    plausible: bool
    alone: int


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PieceAlignment:
    """Aligns a rigid component of the trajectory with the map of another one, using all its key scans.

    Within a piece the robot was tracked, so that one pose aligns all of it. Every few key scans are searched in the
    other piece's map, and the two best places of each search are kept. Hits that are consistent with the tracked motion
    form one hypothesis, which is tracked through the whole component. It is judged by the score by which trajectories
    are compared (see `JointMapScore`): a single scan is often ambiguous, a whole component rarely. The best hypothesis
    is accepted if its log likelihood is high enough, no other hypothesis is comparable, it lies within the drift
    covariance, and the component is not self-similar (a self-similar component may match an aliased place).

    Parameters
    ----------
    every : int
        Key scans between two searches.
    most_searches : int
        Upper limit of the searches in one call; if there were more, they are spread evenly.
    reach_m : float, m
        A key scan is searched for where the drift leaves its position this certain (standard deviation).
    hypotheses : int
        Maximum number of hypotheses, those with most hits first.
    follow_sigma : float
        A match farther from the motion since the last one than this many standard deviations is not followed.
    neutral, scale_m, tempering
        As in `JointMapScore`.
    least_nats : float, nats
        Minimum log likelihood of the best hypothesis.
    rival : float
        Maximum log likelihood of any other hypothesis, as a fraction of the best.
    rival_alone : float
        The same where enough of the searches, by themselves, found nothing else that fits nearly as well.
    same_m : float, m
        Hypotheses nearer than this, in the median of the key scans, are one.
    alike : float
        The piece looks alike in itself where, in its own map, the next best place of a quarter of its key scans fits
        this well, as a part of how the right one does.
    share : float
        Minimum inlier ratio of a key scan that gives a constraint.
    least : int
        Constraints that an alignment must give, and searches that must have found nothing else.
    search : BranchAndBound
        How a key scan is searched for.
    matcher : GaussNewton
        How a piece is followed.
    """

    every: int = Field(default=3, ge=1)
    most_searches: int = Field(default=400, ge=1)
    reach_m: float = Field(default=24.0, gt=0)
    hypotheses: int = Field(default=8, ge=1)
    follow_sigma: float = Field(default=2.5, gt=0)
    neutral: float = Field(default=0.7, gt=0, lt=1)
    scale_m: float = Field(default=0.1, gt=0)
    tempering: float = Field(default=0.03, gt=0, le=1)
    least_nats: float = Field(default=12.0, gt=0)
    rival: float = Field(default=0.15, ge=0, lt=1)
    rival_alone: float = Field(default=0.5, ge=0, lt=1)
    same_m: float = Field(default=0.3, gt=0)
    alike: float = Field(default=0.85, gt=0, le=1)
    share: float = Field(default=0.5, gt=0, le=1)
    least: int = Field(default=3, ge=1)
    search: BranchAndBound = BranchAndBound(window_m=30.0, window_rad=1.6, gate=2.5, floor=0.45)
    matcher: GaussNewton = GaussNewton()

    def __call__(
        self, memory: Memory, mapper: OccupancyGridMapping, places: PlaceParameters, tick: Callable[[], None]
    ) -> list[Tie]:
        """Align all pieces with the older ones; returns the constraints of those that are certain."""
        labels = memory.graph.pieces()
        pieces = [np.flatnonzero(labels == label) for label in np.unique(labels)]
        pairs = [
            (keys, old, ways)
            for later, keys in enumerate(pieces)
            for old in pieces[:later]
            if (ways := self._ways(memory.graph, keys, old))
        ]
        stride = -(-sum(len(ways) for _, _, ways in pairs) // self.most_searches)
        found: list[Tie] = []
        for keys, old, ways in pairs:
            tick()
            near = self._near(memory.graph, old, ways)
            maps = drawn(mapper, memory.scans, near, np.array(memory.graph.poses)[near])
            best = self._best(memory, places, maps, keys, dict(list(ways.items())[::stride]))
            if best is None:
                continue
            own = Pyramid.of(drawn(mapper, memory.scans, keys, np.array(memory.graph.poses)[keys]), 0)
            if not self._looks_alike(memory, places, own, keys):
                ties = self._ties(memory, places, maps, keys, near, best)
                found += ties if len(ties) >= self.least else []
        return found

    def _ways(self, graph: KeyGraph, keys: IntArray, old: IntArray) -> dict[int, Nearby]:
        """For key scans of a piece the submap of an older one that they would have to be moved least for."""
        ways, members = dict[int, Nearby](), set((old // BLOCK).tolist())
        for key in keys[self.every - 1 :: self.every].tolist():
            near = [n for n in graph.nearby(key, self.reach_m, len(graph)) if n.block in members]
            if near:
                ways[key] = min(near, key=lambda n: float(np.hypot(*n.pose[:2])) / max(n.sigma_m, 1e-6))
        return ways

    def _near(self, graph: KeyGraph, old: IntArray, ways: dict[int, Nearby]) -> IntArray:
        """Those key scans of an older piece that may show where the searched ones are."""
        guesses = np.array([self._guess(graph, way) for way in ways.values()])
        poses = np.array([graph.poses[key] for key in old.tolist()])
        away = np.hypot(*(poses[:, None, :2] - guesses[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
        near: IntArray = old[away < 2 * self.search.window_m]
        return near

    def _guess(self, graph: KeyGraph, way: Nearby) -> FloatArray:
        return compose(graph.poses[way.block * BLOCK], way.pose)

    def _best(
        self, memory: Memory, places: PlaceParameters, maps: TileMaps, keys: IntArray, ways: dict[int, Nearby]
    ) -> _Alignment | None:
        """Give the hypothesis that is certain, if one is."""
        groups = self._grouped(memory.graph, self._hits(memory, places, Pyramid.of(maps, 0), ways))
        groups.sort(key=lambda group: -sum(hit.share for hit in group))
        followed = [self._followed(memory, maps, keys, group) for group in groups[: self.hypotheses]]
        followed.sort(key=lambda alignment: -alignment.nats)
        if not followed or followed[0].nats < self.least_nats or not followed[0].plausible:
            return None
        best = followed[0]
        rivals = (other.nats for other in followed[1:] if not self._same(best, other))
        rival = self.rival_alone if best.alone >= self.least else self.rival
        return best if max(rivals, default=0.0) <= rival * best.nats else None

    def _same(self, one: _Alignment, other: _Alignment) -> bool:
        return float(np.median(np.hypot(*(one.poses - other.poses)[:, :2].T))) < self.same_m

    def _hits(self, memory: Memory, places: PlaceParameters, pyramid: Pyramid, ways: dict[int, Nearby]) -> list[_Hit]:
        """Search key scans; keep the best place of each and the next best one."""
        hits = []
        beyond = np.square(np.diag([places.unlike_m, places.unlike_m, places.unlike_rad]) / self.search.gate)
        for key, way in ways.items():
            guess = self._guess(memory.graph, way)
            found = self.search.search(pyramid, guess, way.covariance + beyond, self._points(memory, places, key))
            if found is None:
                continue
            alone = found.other_share <= places.other_share * found.share
            two = (found.pose, found.share, alone), (found.other_pose, found.other_share, False)
            for pose, share, alone in two:
                if pose is not None:
                    missed = np.append((pose - guess)[:2], between(guess, pose)[2])
                    hits.append(_Hit(key, pose, share, places.is_plausible(way.covariance, missed), alone))
        return hits

    def _points(self, memory: Memory, places: PlaceParameters, key: int) -> FloatArray:
        return thinned(evidence.recent_points(memory, key, places.query), self.search.points)

    def _grouped(self, graph: KeyGraph, hits: list[_Hit]) -> list[list[_Hit]]:
        """Put together hits that the tracked motion joins."""
        groups: list[list[_Hit]] = []
        for hit in hits:
            for group in groups:
                last = group[-1]
                moved = between(graph.tracked[last.key], graph.tracked[hit.key])
                x, y, turn = between(compose(last.pose, moved), hit.pose).tolist()
                if np.hypot(x, y) < 0.3 + 0.01 * (hit.key - last.key) and abs(turn) < 0.06:
                    group.append(hit)
                    break
            else:
                groups.append([hit])
        return groups

    def _followed(self, memory: Memory, maps: TileMaps, keys: IntArray, group: list[_Hit]) -> _Alignment:
        """Follow a piece from the best hit to both of its ends: as tracked, put right wherever a scan matches."""
        begin = max(group, key=lambda hit: hit.share)
        poses, nats, at = np.empty((len(keys), 3)), 0.0, int(np.searchsorted(keys, begin.key))
        for way in (range(at, len(keys)), range(at - 1, -1, -1)):
            pose, last = begin.pose, begin.key
            for index in way:
                key = int(keys[index])
                guess = compose(pose, between(memory.graph.tracked[last], memory.graph.tracked[key]))
                spread = np.array(memory.graph.variances[max(key, last)]) + np.square([0.02, 0.01])
                pose, said = self._matched(memory, maps, key, guess, spread)
                poses[index], last, nats = pose, key, nats + said
        return _Alignment(poses, nats, any(hit.plausible for hit in group), sum(hit.alone for hit in group))

    def _matched(
        self, memory: Memory, maps: TileMaps, key: int, guess: FloatArray, spread: FloatArray
    ) -> tuple[FloatArray, float]:
        """Match a key scan within the gate of the motion; return its pose and log likelihood (nats)."""
        beams, pose = memory.scans.key(key), guess
        if len(beams) < self.matcher.least_beams:
            return pose, 0.0
        if np.mean(maps.known(0, transform_points(guess, beams.ends))) >= 0.4:
            match = self.matcher(maps, ROW, guess[None], _LOOSE, beams)
            x, y, turn = between(guess, match.poses[0]).tolist()
            if (x * x + y * y) / spread[0] + turn * turn / spread[1] < self.follow_sigma**2:
                pose = match.poses[0]
        known = maps.known(0, transform_points(pose, beams.ends))
        away = maps.distances(ROW, pose[None], beams.ends)[0, known].astype(np.float64)
        agreeing = float(np.sum(1 / (1 + np.square(away / self.scale_m))))
        return pose, self.tempering * (agreeing - self.neutral * float(known.sum()))

    def _looks_alike(self, memory: Memory, places: PlaceParameters, own: Pyramid, keys: IntArray) -> bool:
        """Whether a component also matches its own map elsewhere (self-similarity)."""
        within = replace(self.search, window_m=self.search.window_m / 2, window_rad=0.35)
        ratios = []
        for key in keys[min(places.query, len(keys)) - 1 :: max(len(keys) // 8, 1)].tolist():
            found = within.search(own, memory.graph.poses[key], None, self._points(memory, places, key))
            ratios.append(0.0 if found is None else found.other_share / found.share)
        return float(np.quantile(ratios, 0.75)) >= self.alike

    def _ties(
        self, memory: Memory, places: PlaceParameters, maps: TileMaps, keys: IntArray, old: IntArray, best: _Alignment
    ) -> list[Tie]:
        """Constraints from every few key scans of an aligned piece to the submaps that they lie in."""
        graph, lenient, found = memory.graph, replace(places, share=self.share), list[Tie]()
        blocks = np.unique(old // BLOCK)
        blocks = blocks[np.isin(anchor_of(0) + blocks * BLOCK, old)]
        anchors = np.array([graph.poses[anchor_of(block)] for block in blocks.tolist()]).reshape(-1, 3)
        for index in range(0, len(keys), self.every):
            key, pose = int(keys[index]), best.poses[index]
            if not len(blocks) or len(memory.scans.key(key)) < self.matcher.least_beams:
                continue
            nearest = int(np.argmin(np.hypot(*(anchors[:, :2] - pose[:2]).T)))
            seen, anchor, block = between(anchors[nearest], pose), anchors[nearest], int(blocks[nearest])
            tie = lenient.match_to(maps, anchor, memory, key, block, seen, places.known_m, Source.RECOGNIZED)
            if isinstance(tie, Tie) and tie.determined:
                found.append(tie)
        return found
