"""Global scan refinement: alternating scan matching and graph optimization, then selection of the best trajectory."""

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
from gridslam.slam.full_slam.candidate_selection import Candidate, CandidateSelection
from gridslam.slam.full_slam.component_alignment import ComponentAlignment
from gridslam.slam.full_slam.full_trajectory import full_trajectory
from gridslam.slam.full_slam.key_scan_matching import KeyScanMatching
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore, TrajectoryScorer
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submaps import ROW
from gridslam.slam.pose_graph.cauchy import CauchyEstimator
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

__all__ = ["GlobalScanRefinement", "RefinementResult"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class RefinementResult:
    """Result of the final refinement.

    Attributes
    ----------
    best : Candidate
        The selected trajectory of the key scans with its graph.
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
class GlobalScanRefinement:
    """Alternates scan matching and graph optimization, selects the best candidate, and matches every scan to its map.

    Key scans are matched to the overlapping older and later submaps, rebuilt from the current trajectory. Submaps of
    the same visit are excluded: they only repeat the tracker's result. The refinement starts from the trajectory of the
    best particle, whose closures are evidence like recognized places; and, if it differs, from the tracked motion
    optimized with the online constraints. The result is the candidate with the best score. The unrefined trajectory of
    the best particle is one of the candidates, so the result never has a worse score than the filter.

    Parameters
    ----------
    max_rounds : int
        Maximum number of alternations of matching and optimization.
    stop_m : float, m
        Converged if no key scan moves farther than this.
    map_jump_m, map_jump_rad : float
        An increment of a particle that differs from the tracked motion by more than this is treated as an implicit loop
        closure and replaced by the tracked increment; the constraints decide whether the places coincide.
    key_scans : KeyScanMatching
        How key scans are matched to submaps.
    scan_inlier_ratio : float
        Minimum inlier ratio of a scan match; below it the interpolated pose is kept.
    scan_max_correction_m : float, m
        Maximum correction of a scan match.
    scan_prior_information : float
        Information that holds a scan to that trajectory, beside residuals in m: 1/m^2 and 1/rad^2.
    matcher : GaussNewton
        How scans are matched.
    distinct_candidate_m : float, m
        The online constraints form a separate candidate if they move a key scan farther than this.
    converged_m, converged_ratio : float
        Refinement is skipped if this fraction of the constraints is within this distance of the filter's trajectory,
        and that trajectory is the tracked one.
    max_searches : int
        So often at most the whole log is searched for places seen again, each time from what the last one has made of
        it.
    ambiguity_ratio, min_confirmations
        As in `PlaceRecognition`: at the end the score decides, too, so that fewer searches need to agree.
    component_alignment : ComponentAlignment
        Alignment of rigid components that are separated by gaps in the laser data.
    robust : CauchyEstimator
        Robust estimator of the graph.
    score : TrajectoryScorer
        How candidates are compared.
    """

    max_rounds: int = Field(default=2, ge=1)
    stop_m: float = Field(default=0.1, gt=0)
    map_jump_m: float = Field(default=0.1, gt=0)
    map_jump_rad: float = Field(default=0.03, gt=0)
    key_scans: KeyScanMatching = KeyScanMatching()
    scan_inlier_ratio: float = Field(default=0.6, gt=0, le=1)
    scan_max_correction_m: float = Field(default=0.15, gt=0)
    scan_prior_information: float = Field(default=5.0, gt=0)
    matcher: GaussNewton = GaussNewton()
    distinct_candidate_m: float = Field(default=0.3, gt=0)
    converged_m: float = Field(default=0.03, ge=0)
    converged_ratio: float = Field(default=0.9, gt=0, le=1)
    max_searches: int = Field(default=3, ge=0)
    ambiguity_ratio: float = Field(default=0.85, gt=0, le=1)
    min_confirmations: int = Field(default=3, ge=1)
    component_alignment: ComponentAlignment = ComponentAlignment()
    robust: CauchyEstimator = CauchyEstimator()
    score: TrajectoryScorer = TrajectoryScorer()

    @property
    def _solver(self) -> GraphSlam:
        return GraphSlam(first_guess="given", robust=self.robust)

    def __call__(
        self,
        closure_state: LoopClosureState,
        trajectory: FloatArray,
        keys: IntArray,
        key_from_base: FloatArray,
        mapper: OccupancyGridMapping,
        closure: LoopClosure,
        on_progress: Callable[[], None] = lambda: None,
    ) -> RefinementResult:
        """Refine the trajectory (T, 3) of the key scans and give every scan a pose.

        Parameters
        ----------
        closure_state
            Scans, and which places were recognized.
        trajectory : (T, 3) float64
            Of the key scans, as the filter has it.
        keys, key_from_base : (N,) int64, (N, 3) float64
            For each scan the key scan at or before it, and the tracked motion (see `full_trajectory`).
        closure
            Place recognition and outlier rejection.
        on_progress
            Progress callback; may raise to interrupt.
        """
        graph, scans = closure_state.graph, closure_state.scans
        selection = CandidateSelection(lambda poses: self.score(graph, scans, poses, mapper, on_progress))
        candidates = list(self._candidates(closure_state, trajectory, closure, mapper, on_progress))
        for candidate in candidates:
            selection.add(candidate)
        begins = [selection.best, *(c for c in candidates if c.name == "constraints" and c is not selection.best)]
        for begin in begins:
            self._search(selection, begin, closure_state, closure, mapper, on_progress)
        bent = full_trajectory(selection.best.graph.poses, keys, key_from_base)
        poses = self._match_scans(closure_state, bent, selection.maps, on_progress)
        return RefinementResult(selection.best, poses, selection.maps, selection.scores)

    def _search(
        self, selection: CandidateSelection, begin: Candidate, closure_state: LoopClosureState, closure: LoopClosure,
        mapper: OccupancyGridMapping, on_progress: Callable[[], None],
    ) -> None:  # fmt: skip
        """Repeatedly search the whole log for revisits, starting from a candidate, as long as the score improves."""
        best, reached = begin, selection.scores[begin.name].log_likelihood
        for _ in range(self.max_searches):
            name = f"closed {sum(name.startswith('closed') for name in selection.scores) + 1}"
            found = self._add_closures(name, best, closure_state, closure, mapper, on_progress)
            if found is None or (score := selection.add(found)) < reached:
                return
            best, reached = found, score

    def _add_closures(
        self, name: str, begin: Candidate, closure_state: LoopClosureState, closure: LoopClosure,
        mapper: OccupancyGridMapping, on_progress: Callable[[], None],
    ) -> Candidate | None:  # fmt: skip
        """Add newly found closures to a candidate; None if there are none.

        Robust least squares over all of them rejects the outliers.
        """
        known = closure_state.graph
        known.constraints = begin.accepted_constraints
        closure_state.correct(begin.graph.poses)
        recognition = replace(
            closure.recognition, ambiguity_ratio=self.ambiguity_ratio, min_confirmations=self.min_confirmations
        )
        new = recognition.search_whole_log(closure_state, mapper, begin.accepted_constraints, on_progress)
        new += self.component_alignment(closure_state, mapper, closure.recognition, self.score, on_progress)
        if not new:
            return None
        known.constraints = [*new, *begin.constraints]
        solver = replace(closure.solver, first_guess="either")  # a wide loop is not reached from where the poses are
        solution = solver.solve(known.graph(begin.increments))
        true = solution.weights[len(begin.increments) :][: len(new)] >= 0.5
        recognized = [constraint for constraint, is_true in zip(new, true.tolist(), strict=True) if is_true]
        closure_state.rejected[RejectionReason.IMPLAUSIBLE] += len(new) - len(recognized)
        if not recognized:
            return None
        recognized += begin.recognized_constraints
        known.poses, known.constraints = list(solution.poses), recognized
        constraints = [*recognized, *self.key_scans(closure_state, solution.poses, mapper, on_progress)]
        return self._refine(name, closure_state, recognized, constraints, begin.increments, mapper, on_progress)

    def _candidates(
        self,
        closure_state: LoopClosureState,
        trajectory: FloatArray,
        closure: LoopClosure,
        mapper: OccupancyGridMapping,
        on_progress: Callable[[], None],
    ) -> Iterator[Candidate]:
        """Yield the trajectory of the filter, and then those computed from it and from the online constraints."""
        known, found = closure_state.graph, closure_state.graph.constraints
        recognized = [constraint for constraint in found if constraint.source is ConstraintSource.RECOGNIZED]
        tracked = self._increments(closure_state, trajectory)
        constraints = [*recognized, *self.key_scans(closure_state, trajectory, mapper, on_progress)]
        known.poses, known.constraints = list(trajectory), constraints
        graph = known.graph(between(trajectory[:-1], trajectory[1:]))
        yield Candidate("filter", graph, constraints, self.robust.weights(graph))
        as_tracked = (graph.measurements[: len(tracked)] == tracked).all()
        if not (constraints or found) or (as_tracked and self._is_converged(graph, len(constraints))):
            return
        yield self._refine("refined", closure_state, recognized, constraints, tracked, mapper, on_progress)
        known.poses, known.constraints = list(trajectory), found
        start = closure.solver.solve(known.graph(tracked)).poses
        if np.hypot(*(start - trajectory)[:, :2].T).max() > self.distinct_candidate_m:
            known.poses = list(start)
            constraints = [*recognized, *self.key_scans(closure_state, start, mapper, on_progress)]
            yield self._refine("constraints", closure_state, recognized, constraints, tracked, mapper, on_progress)

    def _is_converged(self, graph: PoseGraph, constraints: int) -> bool:
        """Whether nearly all constraints are already satisfied, so that optimization would only average noise."""
        missed = graph.errors()[len(graph.edges) - constraints :, :2]
        near = np.hypot(missed[:, 0], missed[:, 1]) < self.converged_m
        return constraints > 0 and float(np.mean(near)) > self.converged_ratio

    def _refine(
        self, name: str, closure_state: LoopClosureState, recognized: list[Constraint], constraints: list[Constraint],
        increments: FloatArray, mapper: OccupancyGridMapping, on_progress: Callable[[], None],
    ) -> Candidate:  # fmt: skip
        """Alternate optimization and matching: constraints are recomputed at each solution of the graph."""
        known = closure_state.graph
        for last in range(self.max_rounds - 1, -1, -1):
            before, known.constraints = np.array(known.poses), constraints
            graph = known.graph(increments)
            solution = self._solver.solve(graph)
            known.poses = list(solution.poses)
            if not last or np.hypot(*(solution.poses - before)[:, :2].T).max() < self.stop_m:
                break
            constraints = [*recognized, *self.key_scans(closure_state, solution.poses, mapper, on_progress)]
        return Candidate(name, graph.with_poses(solution.poses), constraints, solution.weights)

    def _increments(self, closure_state: LoopClosureState, trajectory: FloatArray) -> FloatArray:
        """Increments (T - 1, 3) of the filter; tracked increments where scan matching moved it off the track."""
        tracked = np.array(closure_state.graph.tracked)
        moved, driven = between(tracked[:-1], tracked[1:]), between(trajectory[:-1], trajectory[1:])
        missed = between(moved, driven)
        jumped = (np.hypot(missed[:, 0], missed[:, 1]) > self.map_jump_m) | (np.abs(missed[:, 2]) > self.map_jump_rad)
        return np.where(jumped[:, None], moved, driven)

    def _match_scans(
        self, closure_state: LoopClosureState, poses: FloatArray, maps: TileMaps, on_progress: Callable[[], None]
    ) -> FloatArray:
        """Match every scan to the final map; a scan without stored beams moves with its predecessor."""
        matched, last = poses.copy(), 0
        prior = self.scan_prior_information * np.eye(3)[None]
        for scan in range(len(poses)):
            beams = closure_state.scans[scan]
            if len(beams) < self.matcher.min_beams:
                matched[scan] = compose(matched[last], between(poses[last], poses[scan]))
                continue
            last = scan
            if scan % 256 == 0:
                on_progress()
            match = self.matcher(maps, ROW, poses[scan : scan + 1], prior, beams)
            moved = np.hypot(*(match.poses[0] - poses[scan])[:2])
            if match.score[0] >= self.scan_inlier_ratio * len(beams) and moved <= self.scan_max_correction_m:
                matched[scan] = match.poses[0]
        return matched
