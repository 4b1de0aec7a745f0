"""Global scan refinement: scan matching, graph optimization, and selection of the best trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.sharpness import measure_sharpness
from gridslam.matching.surfaces import Surfaces
from gridslam.slam.full_slam.component_alignment import align_components
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectories
from gridslam.slam.full_slam.key_motion import weigh_odometry
from gridslam.slam.full_slam.key_scan_matching import match_key_scans
from gridslam.slam.full_slam.laser_errors import LaserErrors, estimate_laser_errors
from gridslam.slam.full_slam.surface_adjustment import LINE_REACH_M, adjust_key_scans, match_scans
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore, score_trajectory
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.loop_closure import SOLVER, LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import CauchyEstimator, scale_information
from gridslam.types import FloatArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A candidate trajectory.

    Attributes
    ----------
    name : str
        Where it comes from: "filter", the best particle's past; "refined", that past matched jointly; "constraints",
        what the constraints found while the robot drove make of the tracked motion; "closed 1", "closed 2", ..., with
        places that were found in a search of the whole log.
    graph : PoseGraph
        Key scans and what was measured between them; its poses (T, 3) are the trajectory.
    constraints : list of Constraint
        The last measurements in the graph: matches of key scans to submaps of another time.
    weights : (M,) float64
        Weight of each measurement in the robust estimate.
    """

    name: str
    graph: PoseGraph
    constraints: list[Constraint]
    weights: FloatArray

    @property
    def recognized_constraints(self) -> list[Constraint]:
        """Constraints found by place recognition."""
        return [constraint for constraint in self.constraints if constraint.source is ConstraintSource.RECOGNIZED]

    @property
    def accepted_constraints(self) -> list[Constraint]:
        """Constraints accepted by the robust estimate."""
        weights = self.weights[len(self.weights) - len(self.constraints) :].tolist()
        return [constraint for constraint, weight in zip(self.constraints, weights, strict=True) if weight >= 0.5]


@final
class CandidateSelection:
    """The best of the candidates so far, its map, and the scores of all by name.

    Parameters
    ----------
    score : callable
        Gets poses (T, 3), gives their score and the map drawn from them.
    first : Candidate
        The first candidate.
    """

    def __init__(self, score: Callable[[FloatArray], tuple[TrajectoryScore, TileMaps]], first: Candidate) -> None:
        self._score = score
        self.best = first
        first_score, self.maps = score(first.graph.poses)
        self.scores = {first.name: first_score}

    def add(self, candidate: Candidate) -> float:
        """Compare a candidate with the best so far, which remains the best where both are equal; log likelihood."""
        score, maps = self._score(candidate.graph.poses)
        if score.log_likelihood > self.scores[self.best.name].log_likelihood:
            self.best = candidate
            self.maps = maps
        self.scores[candidate.name] = score
        return score.log_likelihood

    def adjust_best(self, poses: FloatArray) -> None:
        """Move the best candidate to poses (T, 3), whose score is that of "adjusted".

        It decides nothing: the cells of the score are coarser than the adjustment, and the filter has fitted its poses
        to them. Agreement is up to 0.02 less where poses are better by two thirds.
        """
        self.scores["adjusted"], self.maps = self._score(poses)
        self.best = replace(self.best, graph=self.best.graph.with_poses(poses))


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
        Of all candidates, by name, of which the first of the greatest log likelihood is the best; and of that one as it
        was moved, "adjusted".
    measured : PoseGraph
        All that determines the best trajectory, by which its poses are uncertain: its graph, with the weights of the
        robust estimate and the surfaces.
    sharpness_m : float or None, m
        See `measure_sharpness`.
    laser_errors : LaserErrors or None
        See `estimate_laser_errors`.
    """

    best: Candidate
    poses: FloatArray
    maps: TileMaps
    scores: dict[str, TrajectoryScore]
    measured: PoseGraph
    sharpness_m: float | None
    laser_errors: LaserErrors | None


_DISTINCT_CANDIDATE_M = 0.3
"""The online constraints form a separate candidate if they move a key scan farther than this."""
_MAX_SEARCHES = 3
"""Maximum number of whole-log searches for revisited places, each with the trajectory of the one before, besides those
that join components."""
_CELLS_LEFT = 0.01
"""Of the information of a match to cells, beside that of surfaces."""
_MOST_SQUARED = 25.0
"""Normalized square of what a tracked increment misses the selected trajectory by; beyond, the tracker was wrong."""
_ROBUST = CauchyEstimator()
"""Robust estimator of the graph."""


def refine_trajectory(
    closure_state: LoopClosureState,
    trajectory: FloatArray,
    drives: Sequence[TrackedScans],
    mapper: OccupancyGridMapping,
    closure: LoopClosure,
    on_progress: Callable[[], None] = lambda: None,
    searched: int = 0,
) -> RefinementResult:
    """Refine the trajectory (T, 3) of the key scans and give every scan a pose.

    Key scans are matched to the overlapping older and later submaps, rebuilt from the trajectory, and the graph is
    solved. Submaps of the same visit are excluded: they only repeat the tracker's result. The refinement starts from
    the trajectory of the best particle, whose closures are evidence like recognized places; and, if it differs, from
    the tracked motion optimized with the online constraints. The candidate with the best score is selected; one of them
    is the trajectory of the best particle. Then its key scans are moved until their surfaces fit each other, and every
    other scan is matched to the surfaces about it.

    Parameters
    ----------
    closure_state
        Scans, and which places were recognized; modified.
    trajectory : (T, 3) float64
        Of the key scans, as the filter has it.
    drives : sequence of TrackedScans
        The scans, by drives in the order of their key scans. Those of a drive that is frozen are not matched.
    closure
        Place recognition and outlier rejection.
    on_progress
        Progress callback; may raise to interrupt.
    searched : int
        Number of first key scans that an earlier refinement has searched for revisits among each other: drives that
        the newest one was joined with. What is frozen is not searched for either.
    """
    graph = closure_state.graph
    frozen = [c for c in graph.constraints if max(c.pair) < graph.frozen]
    by_hand = [c for c in graph.constraints if c.source is ConstraintSource.BY_HAND]
    matched = (ConstraintSource.PROXIMITY, ConstraintSource.TRACKED)
    known = [c for c in frozen if c.source in matched] + by_hand
    refinement = _Refinement(
        closure_state,
        mapper,
        closure,
        on_progress,
        known,
        max(searched, graph.frozen),
        [c for c in graph.constraints if c.source is ConstraintSource.TRACKED] + by_hand,
        closure_state.pairs.copy(),
        SubmapPairs(),
    )
    selection = refinement.select(trajectory)
    scans = closure_state.scans
    batch = scans.batch(scans.keys)
    surfaces = Surfaces.of(batch, LINE_REACH_M)
    on_progress()
    measured = refinement.measured(selection.best)
    adjusted = adjust_key_scans(measured, surfaces)
    laser_errors = estimate_laser_errors(surfaces, adjusted.poses, adjusted.edges[len(measured.edges) :])
    selection.adjust_best(adjusted.poses)
    key_poses = selection.best.graph.poses
    graph.poses = list(key_poses)
    poses = full_trajectories(key_poses, drives)
    first = sum(len(drive.keys) for drive in drives if int(drive.keys[-1]) < graph.frozen)
    keys = np.concatenate([drive.keys for drive in drives])[first:]
    poses[first:] = match_scans(poses[first:], keys, scans, surfaces, key_poses)
    sharpness_m = measure_sharpness(Surfaces.of(batch), key_poses)
    best, maps, scores = selection.best, selection.maps, selection.scores
    return RefinementResult(best, poses, maps, scores, adjusted, sharpness_m, laser_errors)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Refinement:
    """One run of the refinement; it goes from candidate to candidate in the key graph of its state.

    `known` are constraints between frozen key scans, which are not matched again, and those that a person added; the
    first `searched` key scans are not searched for again; `tracked` are revisits that the robot knew of while it drove,
    and those of the person, too; `pairs` are submaps of all of
    the way, `stretches` short ones, of stretches without a gap in the laser data.
    """

    closure_state: LoopClosureState
    mapper: OccupancyGridMapping
    closure: LoopClosure
    on_progress: Callable[[], None]
    known: list[Constraint]
    searched: int
    tracked: list[Constraint]
    pairs: SubmapPairs
    stretches: SubmapPairs

    @property
    def graph(self) -> KeyGraph:
        """The key graph."""
        return self.closure_state.graph

    def select(self, trajectory: FloatArray) -> CandidateSelection:
        """Compare the candidates, beginning with the trajectory (T, 3) of the filter."""
        first, *others = self._candidates(trajectory)
        selection = CandidateSelection(
            lambda poses: score_trajectory(self.graph, self.closure_state.scans, poses, self.mapper, self.on_progress),
            first,
        )
        for candidate in others:
            selection.add(candidate)
        self._close_loops(selection)
        return selection

    def measured(self, best: Candidate) -> PoseGraph:
        """Graph of a candidate whose key scans are to be matched to each other.

        The increments are the tracked ones, also of the filter, whose own are rough, and those of the odometry (see
        `weigh_odometry`); but across a gap in the laser data these are odometry alone, and the candidate's stay. Of
        matches to cells so much is left as a map needs that nothing else joins, as surfaces of the same scans determine
        the same more exactly.
        """
        tracked = np.array(self.graph.tracked)
        measurements = best.graph.measurements.copy()
        count = len(tracked) - 1
        smooth = measurements.copy()
        smooth[:count] = between(tracked[:-1], tracked[1:])
        errors = replace(best.graph, measurements=smooth).errors()[:count]
        squares = np.einsum("ki,kij,kj->k", errors, best.graph.information[:count], errors)
        is_seen = np.diff(self.graph.label_gaps()) == 0
        is_followed = is_seen & (squares < _MOST_SQUARED)
        measurements[:count][is_followed] = smooth[:count][is_followed]
        graph = weigh_odometry(replace(best.graph, measurements=measurements), self.graph, is_seen)
        weights = best.weights.copy()
        is_of_cells = [c.source in (ConstraintSource.PROXIMITY, ConstraintSource.TRACKED) for c in best.constraints]
        weights[len(weights) - len(is_of_cells) :][is_of_cells] *= _CELLS_LEFT
        return scale_information(graph, weights)

    def _close_loops(self, selection: CandidateSelection) -> None:
        """Repeatedly recognize more places, starting from the best candidate.

        As long as the score improves, or components are joined: one that is joined shows where others belong. Where it
        does not improve, the best candidate keeps its trajectory and takes over the places that agree with it, if most
        of them do; the others are rejected.
        """
        last = selection.best
        search = joining = 0
        while search - joining < _MAX_SEARCHES:
            components = len(np.unique(self.graph.label_rigid_components()))
            search += 1
            found = self._add_closures(f"closed {search}", last)
            if found is None:
                return
            selection.add(found)
            is_joined = len(np.unique(self.graph.label_rigid_components())) < components
            joining += is_joined
            recognized = found.recognized_constraints
            contradicted = self.closure.find_contradicted(recognized, last.graph.poses)
            is_better = selection.best is found
            if selection.best is last and 2 * contradicted.sum() < len(recognized):
                agreeing = [
                    c for c, is_contradicted in zip(recognized, contradicted, strict=True) if not is_contradicted
                ]
                self.closure_state.rejected[RejectionReason.IMPLAUSIBLE] += len(recognized) - len(agreeing)
                found = selection.best = self._keep_trajectory(last.name, last.graph.poses, agreeing)
            if not (is_better or is_joined):
                return
            last = found

    def _add_closures(self, name: str, begin: Candidate) -> Candidate | None:
        """Add newly found closures to a candidate; None if there are none.

        Robust least squares over all of them rejects the outliers.
        """
        closure_state = self.closure_state
        known = [*self.tracked, *begin.recognized_constraints]
        self.graph.constraints = known
        closure_state.correct(begin.graph.poses)
        found, rejected = self.closure.recognition.search_all(
            closure_state, self.mapper, self.pairs, self.on_progress, self.searched
        )
        closure_state.rejected[RejectionReason.INCONSISTENT] += rejected
        pairs = {constraint.pair for constraint in known}
        new = [constraint for constraint in found if constraint.pair not in pairs]
        # the filter's poses are drawn at random, and off for some key scans after a gap: components have tracked shapes
        closure_state.correct(SOLVER.solve(self._graph(begin.graph.poses, known)).poses)
        new += align_components(
            closure_state,
            self.mapper,
            self.stretches,
            self.closure.places,
            self.on_progress,
            self.searched,
        )
        new = [c for c in new if self.graph.allows(c) and (c.determined or c.pair not in pairs)]
        if not new:
            return None
        solver = replace(SOLVER, first_guess="either")  # a wide loop is not reached from where poses are
        solution = solver.solve(self._graph(begin.graph.poses, [*new, *known]))
        weights = solution.weights[len(begin.graph.poses) - 1 :].tolist()
        recognized = [constraint for constraint, weight in zip(new, weights, strict=False) if weight >= 0.5]
        closure_state.rejected[RejectionReason.IMPLAUSIBLE] += len(new) - len(recognized)
        if not recognized:
            return None
        recognized += begin.recognized_constraints
        constraints = self._match_key_scans(recognized, solution.poses)
        return self._refine(name, solution.poses, constraints)

    def _candidates(self, trajectory: FloatArray) -> Iterator[Candidate]:
        """Yield the trajectory of the filter, and then those computed from it and from the online constraints."""
        found = self.graph.constraints
        recognized = [constraint for constraint in found if constraint.source is ConstraintSource.RECOGNIZED]
        filtered = self._keep_trajectory("filter", trajectory, recognized)
        constraints = filtered.constraints
        yield filtered
        if not (constraints or found):
            return
        yield self._refine("refined", trajectory, constraints)
        tracked = np.array(self.graph.tracked)
        start = SOLVER.solve(self._graph(trajectory, found, between(tracked[:-1], tracked[1:]))).poses
        if _max_distance_m(start, trajectory) > _DISTINCT_CANDIDATE_M:
            constraints = self._match_key_scans(recognized, start)
            yield self._refine("constraints", start, constraints)

    def _refine(self, name: str, poses: FloatArray, constraints: list[Constraint]) -> Candidate:
        """Optimize from poses (T, 3) and the constraints matched there."""
        graph = self._graph(poses, constraints)
        solution = GraphSlam(first_guess="given", robust=_ROBUST).solve(graph)
        return Candidate(name, solution.graph, constraints, solution.weights)

    def _keep_trajectory(self, name: str, poses: FloatArray, recognized: list[Constraint]) -> Candidate:
        """Make a candidate of poses (T, 3) that stay where they are, whatever is matched at them."""
        constraints = self._match_key_scans(recognized, poses)
        graph = self._graph(poses, constraints, between(poses[:-1], poses[1:]))
        return Candidate(name, graph, constraints, _ROBUST.weights(graph))

    def _match_key_scans(self, recognized: list[Constraint], poses: FloatArray) -> list[Constraint]:
        """Recognized and known constraints, and those from matching key scans at poses (T, 3) to the submaps about."""
        self.graph.constraints = [*self.tracked, *recognized]
        matched = match_key_scans(self.closure_state, poses, self.mapper, self.on_progress)
        return [*recognized, *self.known, *filter(self.graph.allows, matched)]

    def _graph(
        self, poses: FloatArray, constraints: list[Constraint], increments: FloatArray | None = None
    ) -> PoseGraph:
        """Pose graph of poses (T, 3) and constraints, which the key graph takes over; increments as tracked if None.

        Across a gap in the laser data tracked motion is odometry alone: where no constraint joins what it separates,
        components stay where the poses have them, which a filter has matched to its map.
        """
        self.graph.poses = list(poses)
        self.graph.constraints = constraints
        graph = self.graph.graph(increments)
        information = graph.information.copy()
        information[: len(poses) - 1] = np.linalg.inv(np.array(self.graph.covariances[1:]).reshape(-1, 3, 3))
        measurements = graph.measurements.copy()
        if increments is None:
            apart = np.flatnonzero(np.diff(self.graph.label_rigid_components()))
            measurements[apart] = between(poses[apart], poses[apart + 1])
        return replace(graph, information=information, measurements=measurements)


def _max_distance_m(poses: FloatArray, others: FloatArray) -> float:
    """Greatest distance between poses (T, 3) and others."""
    return float(np.hypot(*(poses - others)[:, :2].T).max())
