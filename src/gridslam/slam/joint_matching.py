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
from gridslam.slam.memory import Memory
from gridslam.slam.pose_graph import PoseGraph
from gridslam.slam.submaps import ROW, anchor_of, drawn, keys_of
from gridslam.slam.ties import Source, Tie, surveyed
from gridslam.types import FloatArray, IntArray

__all__ = ["JointMatching", "LastWord"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class LastWord:
    """What the end of a log tells of all of it.

    Attributes
    ----------
    graph : PoseGraph
        Key scans and what was measured between them; its poses (T, 3) are the solution.
    weights : (M,) float64
        How much each measurement was believed.
    poses : (N, 3) float64
        A pose for every scan.
    maps : TileMaps
        One map, drawn from the key scans.
    """

    graph: PoseGraph
    weights: FloatArray
    poses: FloatArray
    maps: TileMaps


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class JointMatching:
    """Match, solve, and match again, until nothing moves; then match every scan to the map of all key scans.

    Key scans are matched to the older and later submaps about them to which theirs are tied, drawn anew from the
    current trajectory. Matched to those of its own time a scan would only repeat what the tracker has made of it.

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
    solver : GraphSlam
        How the graph is solved.
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
    solver: GraphSlam = GraphSlam(first_guess="given", robust=Cauchy())

    def __call__(
        self,
        memory: Memory,
        trajectory: FloatArray,
        keys: IntArray,
        key_from_base: FloatArray,
        mapper: OccupancyGridMapping,
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
        tick
            Called now and then, so that progress can be shown and the work be interrupted.
        """
        known = memory.graph
        known.poses = list(trajectory)
        increments = self._increments(memory, trajectory)
        known.poses = list(self.solver.solve(known.graph(increments)).poses)
        kept = [tie for tie in known.ties if tie.source is Source.RECOGNIZED]
        for _ in range(self.rounds):
            before = np.array(known.poses)
            ties = list(self._ties(memory, before, mapper, tick))
            known.ties = kept + ties
            graph = known.graph(increments)
            solution = self.solver.solve(graph)
            known.poses = list(solution.poses)
            if np.hypot(*(solution.poses - before)[:, :2].T).max() < self.stop_m:
                break
        maps = drawn(mapper, memory.scans, np.arange(len(known)), solution.poses)
        bent = full_trajectory(solution.poses, keys, key_from_base)
        return LastWord(
            graph.with_poses(solution.poses), solution.weights, self._matched(memory, bent, maps, tick), maps
        )

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
            maps = drawn(mapper, memory.scans, keys_of(block), between(poses[anchor], poses[keys_of(block)]))
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

        allowed, blocks = _connected(memory), memory.graph.blocks
        wanted: list[list[int]] = [[] for _ in range(blocks)]
        tree = cKDTree(poses[:, :2])
        for key, near in enumerate(tree.query_ball_point(poses[:, :2], self.near_m)):
            others = np.array([k for k in near if k // BLOCK in allowed[key // BLOCK]], np.int64)
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


def _connected(memory: Memory) -> list[set[int]]:
    """For each submap those that ties lead to in one step or two, and their neighbours; none of its own time."""
    count, blocks = -(-len(memory.graph) // BLOCK), memory.graph.blocks
    near = [set(range(max(0, b - 3), min(blocks, b + 4))) for b in range(count)]
    tied: list[set[int]] = [set() for _ in range(count)]
    for tie in memory.graph.ties:
        a, b = tie.from_ // BLOCK, tie.to // BLOCK
        for one, other in ((a, b), (b, a)):
            for k in range(max(0, one - 1), min(count, one + 2)):
                tied[k] |= near[other]
    return [members.union(*(tied[other] for other in members)) - near[k] for k, members in enumerate(tied)]
