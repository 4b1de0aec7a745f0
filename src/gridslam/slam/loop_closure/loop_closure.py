"""Loop closure: corrects the trajectory when a place is recognized, and rebuilds the map of the filter."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.geometry.se2 import between, compose
from gridslam.geometry.single_pose import Pose, as_pose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.parameters import bounded, parameters
from gridslam.slam.loop_closure.constraints import Constraint, key_scan_pairs
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.place_matching import PlaceMatching, squared_sigmas
from gridslam.slam.loop_closure.state import (
    Correction,
    FoundPiece,
    LoopClosureState,
    PendingConstraints,
)
from gridslam.slam.loop_closure.submap_recognition import SubmapRecognition
from gridslam.slam.loop_closure.submaps import insert_key_scans
from gridslam.slam.pose_graph.descent import advance
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity
from gridslam.tracking.state import TrackerState, UnmatchedMotion
from gridslam.types import BeamEnds, FloatArray, StepReport

SOLVER = GraphSlam(first_guess="given", robust=GraduatedNonConvexity())
"""How the graph is solved."""
LIBRARIES = "scipy.sparse.csgraph", "scipy.special", "qdldl"
"""Modules that closing a loop needs. They are imported at the first scan, so that no later one waits for an import."""


class FilterState(Protocol):
    """The interface to a particle filter that loop closure needs."""

    @property
    def tracker(self) -> TrackerState:
        """The tracker's state."""
        ...

    @property
    def key_pose(self) -> Pose:
        """The tracker's pose (3,) at the last key scan."""
        ...

    @property
    def best_pose(self) -> FloatArray:
        """Pose (3,) of the best particle at the last key scan, map frame."""
        ...

    @property
    def unmatched(self) -> UnmatchedMotion:
        """Of the motion that led to the last key scan."""
        ...

    @property
    def drift_covariance(self) -> FloatArray:
        """Covariance (3, 3) that the drift grew by since the key scan before, in the frame of the last one."""
        ...

    drift: FloatArray
    """Moments (9,) of the drift since the start (see `compute_moments`)."""

    closure_state: LoopClosureState | None
    """The state of loop closure."""

    def best_trajectory(self) -> FloatArray:
        """Poses (T, 3) of the best particle at all key scans."""
        ...

    def replace_trajectory(self, trajectory: FloatArray, maps: TileMaps) -> None:
        """Let all particles share one past, poses (T, 3), and the first of `maps`, with equal weights."""


@final
@checked
@parameters(frozen=True)
class LoopClosure:
    """Store, recognize, optimize, rebuild the map, merge.

    When the graph, solved with a place just recognized, puts the robot elsewhere than the filter does, the filter's
    past is replaced: all particles are reseeded on the graph's most likely trajectory, with equal weights and the one
    map drawn from it. This is Laplace's approximation of p(x_1:t | z_1:t, u_1:t) with the closure among the
    measurements, collapsed to its mode: given a map drawn from the corrected past, the newest pose is certain within a
    matcher's basin (the closure was matched), and the motion model spreads the particles again. Particles that differ
    only in how they would have closed this loop have nothing left to be weighed by, hence equal weights.

    The graph is solved incrementally, some linear systems at each new scan, and then the corrected map is built,
    `scans_per_step` key scans at each new one, so that no scan waits for either: the map is merged a number of scans
    after the closure was found that depends on counts alone, never on time.

    Parameters
    ----------
    places : PlaceMatching
        How key scans are matched where the way back to an old place is certain.
    recognition : SubmapRecognition
        How other places are recognized.
    drift : DriftModel
        How uncertain tracked motion is.
    disagree_sigmas : float
        The filter is not corrected if its trajectory satisfies the new constraints within this many of their standard
        deviations: 99 % of right ones are within 3.4, in three dimensions.
    scans_per_step : int
        Key scans inserted into the corrected map at each new scan, 0.3 ms each.
    poses_per_scan : int
        Poses solved for at each new scan, 1 us each; never less than one linear system of them all.
    """

    places: PlaceMatching = PlaceMatching()
    recognition: SubmapRecognition = SubmapRecognition()
    drift: DriftModel = DriftModel()
    disagree_sigmas: float = bounded(3.4, ge=1e-6, le=1e6)
    scans_per_step: int = bounded(60, ge=2, le=1_000_000)
    poses_per_scan: int = bounded(8000, ge=1, le=10_000_000)

    def init(self, state: FilterState, beams: BeamEnds) -> LoopClosureState:
        """Begin with the filter's first scan."""
        for name in LIBRARIES:
            import_module(name)
        closure_state = LoopClosureState()
        closure_state.scans.append(beams, state.tracker.pose, is_key=True)
        closure_state.online_poses.append(state.best_pose)
        closure_state.graph.extend(
            np.array(state.key_pose),
            state.best_pose,
            self.drift.variances(0.0, 0.0),
            odometry=state.tracker.odometry,
        )
        return closure_state

    def __call__(
        self,
        state: FilterState,
        closure_state: LoopClosureState,
        report: StepReport,
        beams: BeamEnds,
        mapper: OccupancyGridMapping,
        threads: int,
    ) -> StepReport:
        """Process a scan after the filter; may correct `state`, which the report indicates."""
        closure_state.threads = threads
        closure_state.scans.append(beams, state.tracker.pose, is_key=report.skipped is None)
        pending = closure_state.pending_constraints
        constraints = [] if pending is None else self._solve_pending(closure_state, pending, mapper, threads)
        closures = tuple(constraint.pair for constraint in constraints)
        if closure_state.correction is not None:
            self._draw_corrected_map(closure_state, closure_state.correction)
        if report.skipped is not None:
            return replace(report, closures=closures) if closures else report
        self._add_key_scan(closure_state, state)
        self.places.match_tracked_revisit(closure_state, mapper)
        self.recognition.search(closure_state, mapper)
        is_busy = closure_state.pending_constraints is not None or closure_state.correction is not None
        if closure_state.search.is_undecided and not closure_state.search.left and not is_busy:
            self._decide(closure_state, state.best_trajectory())
        corrected = self._merge_corrected_map(closure_state, state)
        located = None if closure_state.earlier is None else closure_state.earlier.locate(closure_state)
        if located is not None:
            closure_state = self.join(state, closure_state, located)
            corrected = True
        state.drift = closure_state.graph.drift
        pose = state.best_pose if corrected else report.pose
        return replace(report, pose=pose, closures=closures, corrected=corrected)

    def join(
        self,
        state: FilterState,
        closure_state: LoopClosureState,
        found: FoundPiece,
    ) -> LoopClosureState:
        """Put an earlier piece in front of the drive so far, which was found in it; give the state of both.

        As after a loop closure, all particles share one past from then on: the piece's key scans, and the drive's where
        they were found. Their map is that of the piece, with the drive's key scans drawn into it.
        """
        joined = closure_state.join(found)
        trajectory = np.array(joined.graph.poses)
        maps = found.maps.snapshot()
        new = range(len(found.piece), len(trajectory))
        insert_key_scans(maps, joined.scans, new, trajectory, joined.graph)
        state.replace_trajectory(trajectory, maps)
        state.closure_state = joined
        return joined

    def _add_key_scan(self, closure_state: LoopClosureState, state: FilterState) -> None:
        """Add the newest key scan, where it was tracked to."""
        graph = closure_state.graph
        key_pose = np.array(state.key_pose)
        moved = between(graph.tracked[-1], key_pose)
        increment = as_pose(moved)
        unmatched = state.unmatched
        graph.extend(
            key_pose,
            compose(graph.poses[-1], moved),
            self.drift.bounds(increment, unmatched),
            self.drift.covariance(increment, unmatched, state.key_pose[2], first=len(graph) == 1),
            state.drift_covariance,
            state.tracker.odometry,
        )
        closure_state.online_poses.append(state.best_pose)

    def _decide(self, closure_state: LoopClosureState, trajectory: FloatArray) -> None:
        """Add recognized closures to the graph and remove withdrawn ones; solve it if the filter disagrees.

        Where the filter's trajectory (T, 3) agrees with all that is new it stays as it is. The graph still needs them:
        else the next correction, which knows of tracked motion alone, opens the loops that the filter has closed.
        """
        graph = closure_state.graph
        closure_state.search.is_undecided = False
        accepted, rejected = self.recognition.decide(closure_state)
        known = {constraint.identity for constraint in graph.constraints}
        new = [c for c in accepted if c.identity not in known]
        refuted = known.intersection(constraint.identity for constraint in rejected)
        if refuted:
            graph.constraints = [constraint for constraint in graph.constraints if constraint.identity not in refuted]
            graph.correct(np.array(graph.poses))
        for constraint in new:
            graph.add(constraint)
        if refuted or (new and self.find_contradicted(new, trajectory).any()):
            closure_state.pending_constraints = PendingConstraints(len(graph), len(graph.constraints), len(new))

    def find_contradicted(self, constraints: list[Constraint], trajectory: FloatArray) -> NDArray[np.bool_]:
        """Which constraints (C,) a trajectory (T, 3) of the key scans, such as the best particle's, contradicts.

        The trajectory rests on matches, too: their variances count beside those of the constraint.
        """
        from_, to = key_scan_pairs(constraints).T
        measured = np.array([constraint.measurement for constraint in constraints])
        missed = between(measured, between(trajectory[from_], trajectory[to]))
        covariances = np.linalg.inv([constraint.information for constraint in constraints])
        squared = [squared_sigmas(covariance, own) for covariance, own in zip(covariances, missed, strict=True)]
        return np.asarray(np.array(squared) > self.disagree_sigmas**2)

    def _solve_pending(
        self,
        closure_state: LoopClosureState,
        pending: PendingConstraints,
        mapper: OccupancyGridMapping,
        threads: int,
    ) -> list[Constraint]:
        """Advance the graph solver; when it has finished, start the correction and return the accepted constraints.

        Returns none before the solver has finished, and none if it rejects them.
        """
        graph = closure_state.graph
        if pending.computation is None:
            pending.computation = SOLVER.solve_in_steps(graph.graph(keys=pending.keys, constraints=pending.constraints))
            advance(pending.computation, pending.steps)
        steps = max(1, min(8, self.poses_per_scan // pending.keys))
        pending.steps += steps
        solution = advance(pending.computation, steps)
        if solution is None:
            return []
        closure_state.pending_constraints = None
        poses = graph.extend_with_tracked(solution.poses)
        new = slice(pending.constraints - pending.new, pending.constraints)
        weights = solution.weights[len(solution.weights) - pending.new :].tolist()
        constraints = [c for c, weight in zip(graph.constraints[new], weights, strict=True) if weight >= 0.5]
        if pending.new and 2 * len(constraints) <= pending.new:  # most of the new constraints were rejected
            constraints = []
        closure_state.reject(graph.constraints[new], constraints)
        graph.constraints[new] = constraints
        if constraints or not pending.new:
            closure_state.correction = Correction(poses, mapper.empty(1, threads))
        closure_state.graph.correct(poses)
        return constraints

    def _draw_corrected_map(self, closure_state: LoopClosureState, correction: Correction) -> None:
        """Continue to rebuild the map."""
        last = min(correction.inserted + self.scans_per_step, len(correction.poses))
        keys = range(correction.inserted, last)
        insert_key_scans(correction.maps, closure_state.scans, keys, correction.poses, closure_state.graph)
        correction.inserted = last

    def _merge_corrected_map(self, closure_state: LoopClosureState, state: FilterState) -> bool:
        """Move the filter to the corrected map when that is complete, up to the newest key scan."""
        correction = closure_state.correction
        if correction is None:
            return False
        correction.poses = closure_state.graph.extend_with_tracked(correction.poses)
        if len(correction.poses) - correction.inserted > self.scans_per_step:
            return False
        self._draw_corrected_map(closure_state, correction)
        poses = correction.poses
        closure_state.graph.correct(poses)
        closure_state.online_poses = list(poses)
        state.replace_trajectory(poses, correction.maps)
        closure_state.correction = None
        return True
