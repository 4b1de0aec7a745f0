"""Full SLAM result: pose and covariance of every scan, pose graph and map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.checked import checked
from gridslam.geometry.se2 import between
from gridslam.geometry.single_pose import as_pose
from gridslam.grid.tiles import TiledGrid
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.full_trajectory import (
    TrackedScans,
    drift_covariances,
    full_trajectories,
    scan_covariances,
)
from gridslam.slam.full_slam.global_scan_refinement import RefinementResult, refine_trajectory
from gridslam.slam.full_slam.key_covariances import key_covariances
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import ConstraintSource, key_scan_pairs, select_shown_closures
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, OccupancyGrid


@final
@dataclass(frozen=True, slots=True, eq=False)
class LoopClosureSummary:
    """Summary of loop closure.

    Attributes
    ----------
    closures : (K, 2) int64
        Pairs of key scans (older, later) of recognized closures accepted by the final refinement, and of those that a
        person added.
    tracked_revisits : (R, 2) int64
        Key scans that were matched to an older place without search, the way to it being certain; older one first.
    removed : int
        Number of recognized closures that it rejected.
    rejected : Counter of RejectionReason
        Rejected candidates by reason.
    unsearched : int
        Submaps, 30 m of way each, that were not compared with some older ones that the drift model allows for: beyond
        the bound of the drift (see `SubmapRecognition`).
    constraints : Counter of ConstraintSource
        Key scans matched to submaps of another time while the robot drove, by how their place was known.
    refinement_constraints : int
        Pairs of key scans of different visits whose surfaces the final refinement matched.
    chi2 : float
        Of the graph after the final refinement.
    max_correction_m : float
        Largest correction of a key scan by the final refinement.
    candidates : dict of str to TrajectoryScore
        Candidate trajectories of the final refinement, by name (see `RefinementResult.scores`).
    selected : str
        Name of the one that, adjusted, is the answer.
    sharpness_m : float or None, m
        rms distance of the key scans' points to the surfaces that other visits have seen; None without such.
    """

    closures: IntArray
    tracked_revisits: IntArray
    removed: int
    rejected: Counter[RejectionReason]
    unsearched: int
    constraints: Counter[ConstraintSource]
    refinement_constraints: int
    chi2: float
    max_correction_m: float
    candidates: dict[str, TrajectoryScore]
    selected: str
    sharpness_m: float | None

    @property
    def count(self) -> int:
        """Number of loop closures: recognized ones and tracked revisits."""
        return len(self.closures) + len(self.tracked_revisits)

    @property
    def shown(self) -> IntArray:
        """The closures (K, 2) that pictures show."""
        return select_shown_closures(self.closures, self.tracked_revisits)

    def __repr__(self) -> str:
        """Return one line."""
        closures = len(self.closures)
        revisits = len(self.tracked_revisits)
        return f"LoopClosureSummary({closures} closures, {revisits} tracked revisits, selected: {self.selected})"


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
    tiled_map : TiledGrid
        The map, drawn from the key scans at these poses.
    loop_summary : LoopClosureSummary or None
        Summary of loop closure; None without loop closure.
    piece : MapPiece or None
        What a later drive can be found in and joined with: the key scans at these poses, with the constraints of the
        drive that were accepted; None without loop closure.
    """

    poses: FloatArray
    covariances: FloatArray
    graph: PoseGraph
    tiled_map: TiledGrid
    loop_summary: LoopClosureSummary | None
    piece: MapPiece | None

    @property
    def map(self) -> OccupancyGrid:
        """The map as one array, built at each access."""
        return self.tiled_map.whole()


@checked
def full_slam(
    state: GridFastSlamState,
    drives: Sequence[TrackedScans],
    mapper: OccupancyGridMapping,
    loop_closure: LoopClosure | None,
    on_progress: Callable[[], None] = lambda: None,
) -> FullSlam:
    """Compute the full SLAM result of the scans so far; `state` is not modified.

    With loop closure it is the result of the final refinement; without it, the trajectory of the best particle.

    Parameters
    ----------
    state
        The filter after the last scan.
    drives : sequence of TrackedScans
        The scans of the drives that the state is of, one or several that were joined, in the order of their key scans.
        All but the newest were refined before: revisits are searched for from its key scans.
    mapper, loop_closure
        Components of the run. Without loop closure the covariances are those of the default drift model.
    on_progress
        Called periodically during the final refinement.
    """
    closure = loop_closure or LoopClosure()
    trajectory = state.best_trajectory()
    if state.closure_state is not None:
        newest = int(drives[-1].keys[0])
        return _refine(state.closure_state, trajectory, drives, mapper, closure, on_progress, newest)
    graph = _build_odometry_graph(trajectory, drives, closure.drift)
    poses = full_trajectories(trajectory, drives)
    covariances = scan_covariances(graph, drift_covariances(graph), poses, drives, closure.drift)
    return FullSlam(poses, covariances, graph, state.maps.tiled(state.best), None, None)


@checked
def refine_piece(
    piece: MapPiece,
    drives: Sequence[TrackedScans],
    mapper: OccupancyGridMapping,
    closure: LoopClosure,
    on_progress: Callable[[], None] = lambda: None,
) -> FullSlam:
    """Compute the full SLAM result of a piece, such as one that was merged; the arguments are those of `full_slam`."""
    state = LoopClosureState(scans=piece.scans, graph=piece.graph)
    return _refine(state, piece.poses, drives, mapper, closure, on_progress)


def _refine(
    closure_state: LoopClosureState,
    trajectory: FloatArray,
    drives: Sequence[TrackedScans],
    mapper: OccupancyGridMapping,
    closure: LoopClosure,
    on_progress: Callable[[], None],
    searched: int = 0,
) -> FullSlam:
    """Refine the trajectory (T, 3) of the key scans; the state is not modified."""
    changed = closure_state.snapshot()
    refined = refine_trajectory(changed, trajectory, drives, mapper, closure, on_progress, searched)
    of_keys = key_covariances(refined.measured)
    covariances = scan_covariances(refined.graph, of_keys, refined.poses, drives, closure.drift, refined.information)
    loops = _summarize(closure_state, changed, refined, trajectory)
    piece = _make_piece(closure_state, refined)
    return FullSlam(refined.poses, covariances, refined.graph, refined.maps.tiled(0), loops, piece)


def _make_piece(driven: LoopClosureState, refined: RefinementResult) -> MapPiece:
    """Make a piece of the refined key scans.

    Constraints that the refinement has matched are left out: it matches them again whenever the piece is refined.
    """
    graph = driven.graph.snapshot()
    tracked = [c for c in graph.constraints if c.source is not ConstraintSource.RECOGNIZED]
    recognized = [c for c in refined.best.accepted_constraints if c.source is ConstraintSource.RECOGNIZED]
    graph.constraints = tracked + recognized
    graph.correct(refined.best.graph.poses)
    return MapPiece(driven.scans.snapshot(), graph)


def _build_odometry_graph(trajectory: FloatArray, drives: Sequence[TrackedScans], drift: DriftModel) -> PoseGraph:
    """Give the graph of the key scans (T, 3) that only the motion between them joins, as uncertain as tracked.

    Without loop closure no drives are joined: there is one.
    """
    ((keys, key_from_base, _),) = drives
    tracked = key_from_base[np.flatnonzero(np.diff(keys) > 0) + 1]
    information = np.linalg.inv(
        np.array([drift.covariance(as_pose(moved), first=not k) for k, moved in enumerate(tracked)]).reshape(-1, 3, 3)
    )
    edges = np.stack([np.arange(len(tracked)), np.arange(1, len(trajectory))], axis=1)
    return PoseGraph.of(trajectory, edges, between(trajectory[:-1], trajectory[1:]), information)


def _summarize(
    driven: LoopClosureState, closure_state: LoopClosureState, refined: RefinementResult, trajectory: FloatArray
) -> LoopClosureSummary:
    """Summarize online loop closure and the final refinement."""
    best = refined.best
    accepted = [c for c in best.accepted_constraints if c.source is ConstraintSource.RECOGNIZED]
    online = driven.graph.constraints
    return LoopClosureSummary(
        closures=key_scan_pairs(accepted),
        tracked_revisits=key_scan_pairs(c for c in online if c.source is ConstraintSource.TRACKED),
        removed=len(best.recognized_constraints) - len(accepted),
        rejected=closure_state.rejected,
        unsearched=closure_state.search.unsearched,
        constraints=Counter(constraint.source for constraint in online),
        refinement_constraints=refined.pairs,
        chi2=refined.graph.chi2(),
        max_correction_m=float(np.hypot(*(best.graph.poses - trajectory)[:, :2].T).max()),
        candidates=refined.scores,
        selected=best.name,
        sharpness_m=refined.sharpness_m,
    )
