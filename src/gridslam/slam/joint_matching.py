"""The last word: key scans matched again to all submaps they see, the graph solved again, every scan matched again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam.candidates import Candidate, Contest
from gridslam.slam.full_trajectory import full_trajectory
from gridslam.slam.graph_cauchy import Cauchy
from gridslam.slam.graph_slam import GraphSlam
from gridslam.slam.key_scan_matching import KeyScanMatching
from gridslam.slam.loop_closure import LoopClosure
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.piece_alignment import PieceAlignment
from gridslam.slam.pose_graph import PoseGraph
from gridslam.slam.submaps import ROW
from gridslam.slam.ties import Source, Tie
from gridslam.slam.trajectory_score import JointMapScore, TrajectoryScore
from gridslam.types import FloatArray, IntArray

__all__ = ["JointMatching", "LastWord"]


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
    key_scans : KeyScanMatching
        How key scans are matched to submaps.
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
    other_share, confirmations
        As in `PlaceRecognition`: at the end the score decides, too, so that fewer searches need to agree.
    pieces : PieceAlignment
        How pieces between which the robot went on blindly are aligned.
    robust : Cauchy
        How the graph is solved, and what a measurement counts that is off.
    score : JointMapScore
        How candidates are compared.
    """

    rounds: int = Field(default=2, ge=1)
    stop_m: float = Field(default=0.1, gt=0)
    drawn_off_m: float = Field(default=0.1, gt=0)
    drawn_off_rad: float = Field(default=0.03, gt=0)
    key_scans: KeyScanMatching = KeyScanMatching()
    scan_share: float = Field(default=0.6, gt=0, le=1)
    scan_m: float = Field(default=0.15, gt=0)
    scan_prior: float = Field(default=5.0, gt=0)
    matcher: GaussNewton = GaussNewton()
    another_m: float = Field(default=0.3, gt=0)
    settled_m: float = Field(default=0.03, ge=0)
    settled_share: float = Field(default=0.9, gt=0, le=1)
    searches: int = Field(default=3, ge=0)
    other_share: float = Field(default=0.85, gt=0, le=1)
    confirmations: int = Field(default=3, ge=1)
    pieces: PieceAlignment = PieceAlignment()
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
        graph, scans = memory.graph, memory.scans
        contest = Contest(lambda poses: self.score(graph, scans, poses, mapper, tick))
        candidates = list(self._candidates(memory, trajectory, closure, mapper, tick))
        for candidate in candidates:
            contest.add(candidate)
        begins = [contest.best, *(c for c in candidates if c.name == "constraints" and c is not contest.best)]
        for begin in begins:
            self._search(contest, begin, memory, closure, mapper, tick)
        bent = full_trajectory(contest.best.graph.poses, keys, key_from_base)
        poses = self._matched(memory, bent, contest.maps, tick)
        return LastWord(contest.best, poses, contest.maps, contest.scores)

    def _search(
        self, contest: Contest, begin: Candidate, memory: Memory, closure: LoopClosure, mapper: OccupancyGridMapping,
        tick: Callable[[], None],
    ) -> None:  # fmt: skip
        """Search the whole log for places seen again, from a candidate on, as long as that makes it better."""
        best, reached = begin, contest.scores[begin.name].log_likelihood
        for _ in range(self.searches):
            name = f"closed {sum(name.startswith('closed') for name in contest.scores) + 1}"
            found = self._closed(name, best, memory, closure, mapper, tick)
            if found is None or (score := contest.add(found)) < reached:
                return
            best, reached = found, score

    def _closed(
        self, name: str, begin: Candidate, memory: Memory, closure: LoopClosure, mapper: OccupancyGridMapping,
        tick: Callable[[], None],
    ) -> Candidate | None:  # fmt: skip
        """Add the places that are found to a candidate; None if there is none.

        Which of them are true is decided by all together: by least squares that tell false measurements from true ones.
        """
        known = memory.graph
        known.ties = begin.believed
        memory.correct(begin.graph.poses)
        recognition = replace(closure.recognition, other_share=self.other_share, confirmations=self.confirmations)
        new = recognition.search_all(memory, mapper, begin.believed, tick)
        new += self.pieces(memory, mapper, closure.recognition, tick)
        if not new:
            return None
        known.ties = [*new, *begin.ties]
        solver = replace(closure.solver, first_guess="either")  # a wide loop is not reached from where the poses are
        solution = solver.solve(known.graph(begin.increments))
        true = solution.weights[len(begin.increments) :][: len(new)] >= 0.5
        recognized = [tie for tie, is_true in zip(new, true.tolist(), strict=True) if is_true]
        memory.rejected[Rejection.IMPLAUSIBLE] += len(new) - len(recognized)
        if not recognized:
            return None
        recognized += begin.recognized
        known.poses, known.ties = list(solution.poses), recognized
        ties = [*recognized, *self.key_scans(memory, solution.poses, mapper, tick)]
        return self._refined(name, memory, recognized, ties, begin.increments, mapper, tick)

    def _candidates(
        self, memory: Memory, trajectory: FloatArray, closure: LoopClosure, mapper: OccupancyGridMapping,
        tick: Callable[[], None],
    ) -> Iterator[Candidate]:
        """Give the filter's own past first, and then what can be made of it and of the constraints found on the way."""
        known, found = memory.graph, memory.graph.ties
        recognized = [tie for tie in found if tie.source is Source.RECOGNIZED]
        tracked = self._increments(memory, trajectory)
        ties = [*recognized, *self.key_scans(memory, trajectory, mapper, tick)]
        known.poses, known.ties = list(trajectory), ties
        graph = known.graph(between(trajectory[:-1], trajectory[1:]))
        yield Candidate("filter", graph, ties, self.robust.weights(graph))
        as_tracked = (graph.measurements[: len(tracked)] == tracked).all()
        if not (ties or found) or (as_tracked and self._is_settled(graph, len(ties))):
            return
        yield self._refined("refined", memory, recognized, ties, tracked, mapper, tick)
        known.poses, known.ties = list(trajectory), found
        start = closure.solver.solve(known.graph(tracked)).poses
        if np.hypot(*(start - trajectory)[:, :2].T).max() > self.another_m:
            known.poses = list(start)
            ties = [*recognized, *self.key_scans(memory, start, mapper, tick)]
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
            ties = [*recognized, *self.key_scans(memory, solution.poses, mapper, tick)]
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
