"""The full-SLAM answer, told from the end: a pose and its covariance for every scan, the graph and the map."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.grid.tiled_grid import TiledGrid
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.constraints import Constraint, ConstraintSource
from gridslam.slam.drift_model import DriftModel
from gridslam.slam.full_trajectory import full_trajectory
from gridslam.slam.global_scan_refinement import GlobalScanRefinement, RefinementResult
from gridslam.slam.graph_robust import scaled
from gridslam.slam.loop_closure import LoopClosure
from gridslam.slam.loop_closure_state import LoopClosureState, RejectionReason
from gridslam.slam.pose_covariances import drift_covariances, scan_covariances
from gridslam.slam.pose_graph import PoseGraph
from gridslam.slam.state import GridFastSlamState
from gridslam.slam.trajectory_score import TrajectoryScore
from gridslam.types import FloatArray, IntArray, OccupancyGrid

__all__ = ["FullSlam", "LoopClosureSummary", "full_slam"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class LoopClosureSummary:
    """What loop closure made of a run.

    Attributes
    ----------
    closures : (K, 2) int64
        Key scans that were recognized to show one place, older and later one, and that the last word believes.
    revisits : (R, 2) int64
        Key scans that were matched to an older place without search, the way to it being certain; older one first.
    doubted : int
        Recognized ones that it does not.
    rejected : Counter of RejectionReason
        Places that were found but not believed, by reason.
    ties : Counter of ConstraintSource
        Key scans matched to submaps of another time while the robot drove, by how their place was known.
    joint_ties : int
        Key scans matched to submaps of another time in the last word, besides the recognized ones.
    chi2 : float
        Of the graph after the last word.
    moved_m : float
        How far the last word moved a key scan at most.
    candidates : dict of str to TrajectoryScore
        Trajectories that were compared in the last word, by name (see `Candidate`).
    chosen : str
        Name of the one that is the answer.
    """

    closures: IntArray
    revisits: IntArray
    doubted: int
    rejected: Counter[RejectionReason]
    ties: Counter[ConstraintSource]
    joint_ties: int
    chi2: float
    moved_m: float
    candidates: dict[str, TrajectoryScore]
    chosen: str

    def __repr__(self) -> str:
        """Return one line."""
        closures, revisits = len(self.closures), len(self.revisits)
        return f"LoopClosureSummary({closures} closures, {revisits} tracked revisits, selected: {self.chosen})"


@final
@dataclass(frozen=True, slots=True, eq=False)
class FullSlam:
    """The full-SLAM answer of N scans, T of them key scans.

    Attributes
    ----------
    poses, covariances : (N, 3), (N, 3, 3) float64
        Of every scan, map frame; covariances by x, y in m and theta in rad, given that the first pose is exact.
    graph : PoseGraph
        The T key scans and what was measured between them, the information as it was weighed in the end.
    drawn : TiledGrid
        The map, drawn from the key scans at these poses.
    loops : LoopClosureSummary or None
        What loop closure made of the run; None for the filter alone.
    """

    poses: FloatArray
    covariances: FloatArray
    graph: PoseGraph
    drawn: TiledGrid
    loops: LoopClosureSummary | None

    @property
    def map(self) -> OccupancyGrid:
        """The map, unfolded anew at each access."""
        return self.drawn.whole()


def full_slam(
    state: GridFastSlamState,
    keys: IntArray,
    key_from_base: FloatArray,
    mapper: OccupancyGridMapping,
    closure: LoopClosure,
    last_word: GlobalScanRefinement,
    tick: Callable[[], None] = lambda: None,
) -> FullSlam:
    """Tell the answer as the scans so far have it; `state` is not changed, so that the run may go on.

    With loop closure at work it is the last word's: key scans matched jointly, the graph solved, every scan matched to
    the map of all. For the filter alone it is the past of the best particle.

    Parameters
    ----------
    state
        The filter after the last scan.
    keys, key_from_base : (N,) int64, (N, 3) float64
        For each scan the key scan at or before it, and the tracked motion (see `full_trajectory`).
    mapper, closure, last_word
        The parts of the run; of `closure` the filter alone needs the drift, for covariances.
    tick
        Called now and then while the last word is found.
    """
    trajectory = state.ancestry.trajectory(state.best)
    if state.memory is None:
        graph = _chain(trajectory, keys, key_from_base, closure.drift)
        poses, key_covariances = full_trajectory(trajectory, keys, key_from_base), drift_covariances(graph)
        maps: TileMaps = state.maps
        row, loops = state.best, None
    else:
        memory = state.memory.snapshot()  # the last word writes into it
        said = last_word(memory, trajectory, keys, key_from_base, mapper, closure, tick)
        graph, poses, maps, row = scaled(said.best.graph, said.best.weights), said.poses, said.maps, 0
        key_covariances = _marginals(graph)
        loops = _loops(state.memory, memory, said, trajectory)
    covariances = scan_covariances(graph, key_covariances, keys, key_from_base, closure.drift)
    return FullSlam(poses, covariances, graph, maps.tiled(row), loops)


def _marginals(graph: PoseGraph) -> FloatArray:
    """Covariances (T, 3, 3); where nothing is tied they need no algebra."""
    if len(graph.edges) < len(graph.poses):
        return drift_covariances(graph)
    from gridslam.slam.graph_marginals import marginal_covariances

    return marginal_covariances(graph)


def _chain(trajectory: FloatArray, keys: IntArray, key_from_base: FloatArray, drift: DriftModel) -> PoseGraph:
    """Give the graph of the key scans (T, 3) that only the motion between them joins, as uncertain as tracked."""
    tracked = key_from_base[np.flatnonzero(np.diff(keys) > 0) + 1]
    spread = [drift.variances(math.hypot(x, y), abs(turn)) for x, y, turn in tracked.tolist()]
    information = np.zeros((len(tracked), 3, 3))
    information[:, [0, 1, 2], [0, 1, 2]] = 1 / np.array(spread).reshape(-1, 2)[:, [0, 0, 1]]
    edges = np.stack([np.arange(len(tracked)), np.arange(1, len(trajectory))], axis=1)
    return PoseGraph.of(trajectory, edges, between(trajectory[:-1], trajectory[1:]), information)


def _loops(
    driven: LoopClosureState, memory: LoopClosureState, said: RefinementResult, trajectory: FloatArray
) -> LoopClosureSummary:
    """Sum up what was remembered while the robot drove, and in the last word."""
    closures = [tie for tie in said.best.believed if tie.source is ConstraintSource.RECOGNIZED]
    recognized = len(said.best.recognized)
    return LoopClosureSummary(
        closures=_ends(closures),
        revisits=_ends([tie for tie in driven.graph.ties if tie.source is ConstraintSource.KNOWN]),
        doubted=recognized - len(closures),
        rejected=memory.rejected,
        ties=Counter(tie.source for tie in driven.graph.ties),
        joint_ties=len(said.best.ties) - recognized,
        chi2=scaled(said.best.graph, said.best.weights).chi2(),
        moved_m=float(np.hypot(*(said.best.graph.poses - trajectory)[:, :2].T).max()),
        candidates=said.scores,
        chosen=said.best.name,
    )


def _ends(ties: list[Constraint]) -> IntArray:
    """Key scans (K, 2) that ties join."""
    return np.array([(tie.from_, tie.to) for tie in ties], np.int64).reshape(-1, 2)
