"""The last word: key scans matched again to all submaps they see, the graph solved again, every scan matched again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam.full_trajectory import full_trajectory
from gridslam.slam.graph_cauchy import Cauchy
from gridslam.slam.graph_slam import GraphSlam
from gridslam.slam.key_graph import BLOCK
from gridslam.slam.loop_closure import LoopClosure
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.pose_graph import PoseGraph
from gridslam.slam.submaps import ROW, anchor_of, drawn, keys_of
from gridslam.slam.ties import Source, Tie, surveyed
from gridslam.slam.trajectory_score import JointMapScore, TrajectoryScore
from gridslam.types import FloatArray, IntArray

__all__ = ["Candidate", "JointMatching", "LastWord"]

_OWN = 3
"""Submaps so near in time show what the tracker has matched already."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A trajectory that may be the answer.

    Attributes
    ----------
    name : str
        Where it comes from: "filter", the best particle's past; "refined", that past matched jointly; "constraints",
        what the constraints found while the robot drove make of the tracked motion.
    graph : PoseGraph
        Key scans and what was measured between them; its poses (T, 3) are the trajectory.
    ties : list of Tie
        The last measurements in the graph: matches of key scans to submaps of another time.
    weights : (M,) float64
        How much each measurement is believed.
    """

    name: str
    graph: PoseGraph
    ties: list[Tie]
    weights: FloatArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class LastWord:
    """What the end of a log tells of all of it.

    Attributes
    ----------
    best : Candidate
        The key scans' trajectory, and what is known of it.
    poses : (N, 3) float64
        A pose for every scan.
    maps : TileMaps
        One map, drawn from the key scans.
    scores : dict of str to TrajectoryScore
        Of all candidates, by name; the first of the greatest log likelihood is the best.
    """

    best: Candidate
    poses: FloatArray
    maps: TileMaps
    scores: dict[str, TrajectoryScore]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class JointMatching:
    """Match, solve, and match again, until nothing moves; choose; then match every scan to the map of all key scans.

    Key scans are matched to the older and later submaps about them, drawn anew from the current trajectory. Matched to
    those of its own time a scan would only repeat what the tracker has made of it. This is begun from the past of the
    best particle, whose closures are evidence like recognized places; and, where that is another one, from the
    trajectory that the constraints found on the way make of the tracked motion. The answer is the candidate of the best
    score, and that past as it is is one of them: nothing that the particles knew is forgotten for a worse map.

    Parameters
    ----------
    rounds : int
        At most so many times are the key scans matched and the graph solved.
    stop_m : float, m
        A round that moves no key scan farther is the last.
    drawn_off_m, drawn_off_rad : float
        A particle that its map moved by more than this in one step, off the track, has closed a loop, rightly or not:
        whether the two places are one is for the ties to say.
    near_m : float, m
        A key scan is matched to submaps with a key scan this near.
    submaps : int
        The nearest of them.
    share : float
        Share of the beams that must agree.
    least_information : float
        Least eigenvalue of the position's information, per agreeing beam.
    most_m : float, m
        A match that moves a key scan farther is not believed.
    beam_sigma_m : float, m
        Standard deviation of what one beam says, beams being correlated and walls a cell thick.
    scan_share : float
        A scan with which fewer of its beams agree stays where the trajectory of the key scans has it.
    scan_m : float, m
        So does one that would move farther.
    scan_prior : float
        Information that holds a scan to that trajectory, beside residuals in m: 1/m^2 and 1/rad^2.
    matcher : GaussNewton
        How scans are matched.
    another_m : float, m
        The constraints found on the way make a candidate of their own where they move a key scan farther.
    settled_m, settled_share : float
        Where so large a share of the ties is nearer than this to where the filter's own past has them, and that past is
        the tracked one, nothing is refined.
    searches : int
        So often at most the whole log is searched for places seen again, each time from what the last one has made of
        it.
    robust : Cauchy
        How the graph is solved, and what a measurement counts that is off.
    score : JointMapScore
        How candidates are compared.
    """

    rounds: int = Field(default=2, ge=1)
    stop_m: float = Field(default=0.1, gt=0)
    drawn_off_m: float = Field(default=0.1, gt=0)
    drawn_off_rad: float = Field(default=0.03, gt=0)
    near_m: float = Field(default=3.0, gt=0)
    submaps: int = Field(default=3, ge=1)
    share: float = Field(default=0.7, gt=0, le=1)
    least_information: float = Field(default=0.1, ge=0)
    most_m: float = Field(default=0.4, gt=0)
    beam_sigma_m: float = Field(default=0.3, gt=0)
    scan_share: float = Field(default=0.6, gt=0, le=1)
    scan_m: float = Field(default=0.15, gt=0)
    scan_prior: float = Field(default=5.0, gt=0)
    matcher: GaussNewton = GaussNewton()
    another_m: float = Field(default=0.3, gt=0)
    settled_m: float = Field(default=0.03, ge=0)
    settled_share: float = Field(default=0.9, gt=0, le=1)
    searches: int = Field(default=3, ge=0)
    robust: Cauchy = Cauchy()
    score: JointMapScore = JointMapScore()

    @property
    def _solver(self) -> GraphSlam:
        return GraphSlam(first_guess="given", robust=self.robust)

    def __call__(
        self,
        memory: Memory,
        trajectory: FloatArray,
        keys: IntArray,
        key_from_base: FloatArray,
        mapper: OccupancyGridMapping,
        closure: LoopClosure,
        tick: Callable[[], None] = lambda: None,
    ) -> LastWord:
        """Refine the trajectory (T, 3) of the key scans and give every scan a pose.

        Parameters
        ----------
        memory
            Scans, and which places were recognized.
        trajectory : (T, 3) float64
            Of the key scans, as the filter has it.
        keys, key_from_base : (N,) int64, (N, 3) float64
            For each scan the key scan at or before it, and the tracked motion (see `full_trajectory`).
        closure
            How places are recognized, and told true from false.
        tick
            Called now and then, so that progress can be shown and the work be interrupted.
        """
        scores: dict[str, TrajectoryScore] = {}
        best, maps = None, None
        for candidate in self._candidates(memory, trajectory, closure, mapper, tick):
            score, joint = self.score(memory.graph, memory.scans, candidate.graph.poses, mapper, tick)
            if best is None or score.log_likelihood > scores[best.name].log_likelihood:
                best, maps = candidate, joint
            scores[candidate.name] = score
        assert best is not None  # the filter's own past
        assert maps is not None
        for search in range(1, self.searches + 1):
            closed = self._closed(f"closed {search}", memory, best, closure, mapper, tick)
            if closed is None:
                break
            score, joint = self.score(memory.graph, memory.scans, closed.graph.poses, mapper, tick)
            scores[closed.name] = score
            if score.log_likelihood < scores[best.name].log_likelihood:
                break
            best, maps = closed, joint
        bent = full_trajectory(best.graph.poses, keys, key_from_base)
        return LastWord(best, self._matched(memory, bent, maps, tick), maps, scores)

    def _closed(
        self, name: str, memory: Memory, best: Candidate, closure: LoopClosure, mapper: OccupancyGridMapping,
        tick: Callable[[], None],
    ) -> Candidate | None:  # fmt: skip
        """Search the whole log for places seen again that the best candidate does not know of; None if there is none.

        Which of them are true is decided by all together: by least squares that tell false measurements from true ones.
        """
        known, count = memory.graph, len(best.graph.poses)
        known.ties = best.ties
        memory.correct(best.graph.poses)
        groups = closure.recognition.search_all(memory, mapper, best.ties, tick)
        new = [tie for group in groups for tie in group]
        if not new:
            return None
        increments, known.ties = best.graph.measurements[: count - 1], [*new, *best.ties]
        solution = closure.solver.solve(known.graph(increments))
        true = solution.weights[count - 1 :][: len(new)] >= 0.5
        recognized = [tie for tie, is_true in zip(new, true.tolist(), strict=True) if is_true]
        memory.rejected[Rejection.IMPLAUSIBLE] += len(new) - len(recognized)
        if not recognized:
            return None
        recognized += [tie for tie in best.ties if tie.source is Source.RECOGNIZED]
        known.poses = list(solution.poses)
        ties = [*recognized, *self._ties(memory, solution.poses, mapper, tick)]
        return self._refined(name, memory, recognized, ties, increments, mapper, tick)

    def _candidates(
        self, memory: Memory, trajectory: FloatArray, closure: LoopClosure, mapper: OccupancyGridMapping,
        tick: Callable[[], None],
    ) -> Iterator[Candidate]:
        """Give the filter's own past first, and then what can be made of it and of the constraints found on the way."""
        known, found = memory.graph, memory.graph.ties
        recognized = [tie for tie in found if tie.source is Source.RECOGNIZED]
        tracked = self._increments(memory, trajectory)
        ties = [*recognized, *self._ties(memory, trajectory, mapper, tick)]
        known.poses, known.ties = list(trajectory), ties
        graph = known.graph(between(trajectory[:-1], trajectory[1:]))
        yield Candidate("filter", graph, ties, self.robust.weights(graph))
        if not (ties or found) or (
            self._is_settled(graph, len(ties)) and (graph.measurements[: len(tracked)] == tracked).all()
        ):
            return
        yield self._refined("refined", memory, recognized, ties, tracked, mapper, tick)
        known.poses, known.ties = list(trajectory), found
        start = closure.solver.solve(known.graph(tracked)).poses
        if np.hypot(*(start - trajectory)[:, :2].T).max() > self.another_m:
            known.poses = list(start)
            ties = [*recognized, *self._ties(memory, start, mapper, tick)]
            yield self._refined("constraints", memory, recognized, ties, tracked, mapper, tick)

    def _is_settled(self, graph: PoseGraph, ties: int) -> bool:
        """Whether nearly all ties are where the graph's poses have them: solving would only average their noise."""
        missed = graph.errors()[len(graph.edges) - ties :, :2]
        return ties > 0 and float(np.mean(np.hypot(missed[:, 0], missed[:, 1]) < self.settled_m)) > self.settled_share

    def _refined(
        self, name: str, memory: Memory, recognized: list[Tie], ties: list[Tie], increments: FloatArray,
        mapper: OccupancyGridMapping, tick: Callable[[], None],
    ) -> Candidate:  # fmt: skip
        """Solve the graph with ties found at its poses, find them anew at the solution, and so on."""
        known = memory.graph
        for last in range(self.rounds - 1, -1, -1):
            before, known.ties = np.array(known.poses), ties
            graph = known.graph(increments)
            solution = self._solver.solve(graph)
            known.poses = list(solution.poses)
            if not last or np.hypot(*(solution.poses - before)[:, :2].T).max() < self.stop_m:
                break
            ties = [*recognized, *self._ties(memory, solution.poses, mapper, tick)]
        return Candidate(name, graph.with_poses(solution.poses), ties, solution.weights)

    def _increments(self, memory: Memory, trajectory: FloatArray) -> FloatArray:
        """Increments (T - 1, 3) as the filter has them; where its map drew it off the track, as tracked."""
        tracked = np.array(memory.graph.tracked)
        moved, driven = between(tracked[:-1], tracked[1:]), between(trajectory[:-1], trajectory[1:])
        missed = between(moved, driven)
        drawn_off = (np.hypot(missed[:, 0], missed[:, 1]) > self.drawn_off_m) | (
            np.abs(missed[:, 2]) > self.drawn_off_rad
        )
        return np.where(drawn_off[:, None], moved, driven)

    def _ties(
        self, memory: Memory, poses: FloatArray, mapper: OccupancyGridMapping, tick: Callable[[], None]
    ) -> Iterator[Tie]:
        """Match key scans to the submaps about them."""
        wanted = self._wanted(memory, poses)
        loose = np.full((1, 3, 3), 1e-6) * np.eye(3)
        for block, members in enumerate(wanted):
            if not members:
                continue
            tick()
            anchor = anchor_of(block)
            keys = keys_of(block, memory.graph)
            maps = drawn(mapper, memory.scans, keys, between(poses[anchor], poses[keys]))
            for key in members:
                beams = memory.scans.key(key)
                if len(beams) < self.matcher.least_beams:
                    continue
                guess = between(poses[anchor], poses[key])
                match = surveyed(self.matcher(maps, ROW, guess[None], loose, beams), maps, ROW, beams)
                moved = between(guess, match.poses[0])
                score = float(match.score[0])
                if score < max(self.share * len(beams), 1.0) or np.hypot(moved[0], moved[1]) > self.most_m:
                    continue
                yield Tie.of(anchor, key, guess, match, self.beam_sigma_m, self.least_information, Source.BELIEVED)

    def _wanted(self, memory: Memory, poses: FloatArray) -> list[list[int]]:
        """For each submap the key scans to match to it."""
        from scipy.spatial import cKDTree  # only who closes loops pays for its import

        blocks, pieces = memory.graph.blocks, memory.graph.pieces()
        wanted: list[list[int]] = [[] for _ in range(blocks)]
        tree, complete = cKDTree(poses[:, :2]), blocks * BLOCK
        for key, near in enumerate(tree.query_ball_point(poses[:, :2], self.near_m)):
            block = key // BLOCK
            others = np.array([k for k in near if k < complete and abs(k // BLOCK - block) > _OWN], np.int64)
            others = others[pieces[others] == pieces[key]]
            away = np.hypot(*(poses[others, :2] - poses[key, :2]).T) + 0.5 * np.abs(
                wrap(poses[others, 2] - poses[key, 2])
            )
            nearest = dict.fromkeys((others[np.lexsort((others, away))] // BLOCK).tolist())
            for block in list(nearest)[: self.submaps]:
                wanted[block].append(key)
        return wanted

    def _matched(self, memory: Memory, poses: FloatArray, maps: TileMaps, tick: Callable[[], None]) -> FloatArray:
        """Match every scan to the map of all; one of which nothing was kept moves with the last one before it."""
        matched, last = poses.copy(), 0
        prior = self.scan_prior * np.eye(3)[None]
        for scan in range(len(poses)):
            beams = memory.scans[scan]
            if len(beams) < self.matcher.least_beams:
                matched[scan] = compose(matched[last], between(poses[last], poses[scan]))
                continue
            last = scan
            if scan % 256 == 0:
                tick()
            match = self.matcher(maps, ROW, poses[scan : scan + 1], prior, beams)
            moved = np.hypot(*(match.poses[0] - poses[scan])[:2])
            if match.score[0] >= self.scan_share * len(beams) and moved <= self.scan_m:
                matched[scan] = match.poses[0]
        return matched
