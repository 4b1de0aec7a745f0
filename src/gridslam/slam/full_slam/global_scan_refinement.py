"""Global scan refinement: selection of the best trajectory, whose scans are then matched to each other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.sharpness import measure_sharpness
from gridslam.matching.surfaces import Surfaces
from gridslam.slam.full_slam.component_alignment import align_components, propose_alignments
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectories
from gridslam.slam.full_slam.key_motion import weigh_odometry
from gridslam.slam.full_slam.revisits_within_drift import propose_revisits
from gridslam.slam.full_slam.surface_adjustment import LINE_REACH_M, adjust_key_scans, match_scans
from gridslam.slam.full_slam.trajectory_score import NEUTRAL, TrajectoryScore, score_trajectory
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph
from gridslam.slam.loop_closure.loop_closure import SOLVER, LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import CauchyEstimator, scale_information
from gridslam.types import FloatArray, IntArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A candidate trajectory.

    Attributes
    ----------
    name : str
        Where it comes from: "filter", the best particle's past; "closed 1", "closed 2", ..., the tracked motion with
        places that were found in a search of the whole log; "placed 1" and "placed 2", with components where they fit
        best, as tracked and as adjusted; "revisits", returned to where its last metres fit.
    graph : PoseGraph
        Key scans and what was measured between them; its poses (T, 3) are the trajectory.
    constraints : list of Constraint
        The last measurements in the graph: places that were recognized, and what was known of others.
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
class Adjusted(NamedTuple):
    """A candidate whose key scans were moved until their surfaces fit each other.

    Attributes
    ----------
    graph : PoseGraph
        All that determines the poses: the candidate's graph, with the weights of the robust estimate, and then the
        matched surfaces of pairs of key scans.
    pairs : (P, 2) int64
        Which key scans these are.
    variance : float, m^2
        Of a point that is hit head on.
    score : TrajectoryScore
        How probable the poses are. Before they were adjusted, the filter's would be favoured: they are fitted to cells.
    maps : TileMaps
        One map, drawn from them.
    """

    graph: PoseGraph
    pairs: IntArray
    variance: float
    score: TrajectoryScore
    maps: TileMaps


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
    information : (N, 3, 3) float64
        Of those that are not key scans, given these: what was matched besides the motion; see `match_scans`.
    maps : TileMaps
        One map, drawn from the key scans.
    scores : dict of str to TrajectoryScore
        Of the best candidate and of those that contradict it, by name; its log likelihood is the greatest.
    measured : PoseGraph
        All that determines the best trajectory, by which its poses are uncertain (see `Adjusted`).
    graph : PoseGraph
        The same without pairs of one visit, which the tracked motion joins, pairs across a gap in the laser data that
        nothing else joins, which are no evidence, and those that the answer contradicts.
    pairs : int
        Number of pairs in `graph`, its last measurements.
    sharpness_m : float or None, m
        See `measure_sharpness`.
    """

    best: Candidate
    poses: FloatArray
    information: FloatArray
    maps: TileMaps
    scores: dict[str, TrajectoryScore]
    measured: PoseGraph
    graph: PoseGraph
    pairs: int
    sharpness_m: float | None


_MAX_SEARCHES = 3
"""Maximum number of whole-log searches for revisited places, each with the trajectory of the one before, besides those
that join components."""
_CELLS_LEFT = 0.01
"""Of the information of a match to cells, beside that of surfaces."""
_MOST_SQUARED = 25.0
"""Normalized square of what a tracked increment misses the selected trajectory by; beyond, the tracker was wrong."""
_AGREE_M, _AGREE_RAD = 0.3, 0.05
"""Trajectories are the same if no key scan is farther from where the other has it; a pair that is farther from the
answer is an outlier."""
_BARE_MENTION = 1.0
"""Nats, odds of e to 1: less evidence is not worth more than a bare mention. Kass and Raftery, Bayes factors (1995)."""
_TORN = 0.1
"""Loss of agreement that shows a failed adjustment: key scans that belong together were torn apart."""
_SAME_VISIT = 3 * KEY_SCANS_PER_SUBMAP
"""Key scans that are not farther apart belong to one visit."""
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

    The whole log is searched for places, beginning with the trajectory of the best particle. Those that agree with it
    become constraints; where some contradict it, what they make of the tracked motion is another candidate. The key
    scans of each are moved until their surfaces fit each other, and the one with the best score is selected. Every
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
    graph.constraints = leave_to_search(graph, searched)
    frozen = [c for c in graph.constraints if max(c.pair) < graph.frozen]
    known = [c for c in graph.constraints if c.source is ConstraintSource.TRACKED]
    known += [c for c in frozen if c.source is ConstraintSource.PROXIMITY]
    scans = closure_state.scans
    batch = scans.batch(scans.keys)
    threads = closure_state.threads
    surfaces, fives = Surfaces.of(batch, LINE_REACH_M, threads), Surfaces.of(batch, threads=threads)
    on_progress()
    refinement = _Refinement(
        closure_state,
        surfaces,
        fives,
        mapper,
        closure,
        on_progress,
        known,
        max(searched, graph.frozen),
        closure_state.pairs.copy(),
        SubmapPairs(),
    )
    best = refinement.select(trajectory)
    measured, matched, variance, _, maps = refinement.adjust(best)
    key_poses = measured.poses
    graph.constraints = best.constraints
    count = len(measured.edges) - len(matched)
    errors = np.abs(measured.errors()[count:])
    is_shown = np.diff(graph.label_rigid_components()[matched])[:, 0] == 0
    is_shown &= np.diff(matched)[:, 0] > _SAME_VISIT
    is_shown &= (np.hypot(errors[:, 0], errors[:, 1]) < _AGREE_M) & (errors[:, 2] < _AGREE_RAD)
    shown = measured.select(np.append(np.ones(count, np.bool_), is_shown))
    graph.poses = list(key_poses)
    poses = full_trajectories(key_poses, drives)
    first = sum(len(drive.keys) for drive in drives if int(drive.keys[-1]) < graph.frozen)
    keys = np.concatenate([drive.keys for drive in drives])[first:]
    information = np.zeros((len(poses), 3, 3))
    poses[first:], information[first:] = match_scans(poses[first:], keys, scans, surfaces, key_poses, variance, threads)
    sharpness_m = measure_sharpness(fives, key_poses)
    best = replace(best, graph=best.graph.with_poses(key_poses))
    scores = {name: adjusted.score for name, adjusted in refinement.adjusted.items()}
    pairs = int(is_shown.sum())
    return RefinementResult(best, poses, information, maps, scores, measured, shown, pairs, sharpness_m)


def leave_to_search(graph: KeyGraph, searched: int) -> list[Constraint]:
    """Return the constraints but those that the search of the whole log decides: places recognized across a gap.

    While the robot drove they were recognized without what was mapped later, which can show that they look like others.
    What was tracked across a gap after the first of them rests on it. Drives, and the first `searched` key scans, were
    joined otherwise.
    """
    gaps, kept, rests_on_place = graph.label_gaps().tolist(), [], False
    drives = np.cumsum([graph.begins_drive(key) for key in range(len(graph))]).tolist()
    for constraint in graph.constraints:
        a, b = constraint.pair
        is_searched = max(a, b) >= max(searched, graph.frozen) and gaps[a] != gaps[b] and drives[a] == drives[b]
        rests_on_place = rests_on_place or (is_searched and constraint.source is ConstraintSource.RECOGNIZED)
        if not (is_searched and rests_on_place):
            kept.append(constraint)
    return kept


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Refinement:
    """One run of the refinement; it goes from candidate to candidate in the key graph of its state.

    `surfaces` and `fives` are those of the key scans, of longer lines and of five beams; `known` are revisits that the
    robot knew of while it drove, and matches of frozen key scans; the first `searched` key
    scans are not searched for again; `pairs` are submaps of all of the way, `stretches` short ones, of stretches
    without a gap in the laser data; `adjusted` are the candidates that were compared.
    """

    closure_state: LoopClosureState
    surfaces: Surfaces
    fives: Surfaces
    mapper: OccupancyGridMapping
    closure: LoopClosure
    on_progress: Callable[[], None]
    known: list[Constraint]
    searched: int
    pairs: SubmapPairs
    stretches: SubmapPairs
    adjusted: dict[str, Adjusted] = field(default_factory=dict)

    @property
    def graph(self) -> KeyGraph:
        """The key graph."""
        return self.closure_state.graph

    def select(self, trajectory: FloatArray) -> Candidate:
        """Select the best candidate, beginning with the trajectory (T, 3) of the filter.

        More places are recognized as long as they are better than a trajectory that they change, or join components:
        one that is joined shows where others belong. A trajectory that is better than what changes it takes over the
        places that agree with it, if most of them do and it is not clearly worse with them; the others are rejected.
        """
        recognized = [c for c in self.graph.constraints if c.source is ConstraintSource.RECOGNIZED]
        last = best = self._keep_trajectory("filter", trajectory, recognized)
        driven = self._optimize("constraints", trajectory, best.constraints)
        if _moved_m(driven, best) > _AGREE_M and self._log_likelihood(driven) > self._log_likelihood(best):
            last = best = driven
        search = joining = 0
        while search - joining < _MAX_SEARCHES:
            components = len(np.unique(self.graph.label_rigid_components()))
            search += 1
            found = self._add_closures(f"closed {search}", last)
            if found is None:
                break
            recognized = found.recognized_constraints
            adjusted = self.adjust(last)  # what the filter reports is off by what it has drifted
            contradicted = self.closure.find_contradicted(recognized, adjusted.graph.poses)
            agrees = best is last and not contradicted.any() and _moved_m(self.adjust(found), adjusted) <= _AGREE_M
            is_better = not agrees and self._log_likelihood(found) > self._log_likelihood(best)
            if agrees or is_better:
                best = found
            elif best is last and 2 * contradicted.sum() < len(recognized):
                agreeing = [c for c, is_not in zip(recognized, contradicted, strict=True) if not is_not]
                found = best = self._take_over(last, agreeing)
                kept = len(best.recognized_constraints)
                self.closure_state.rejected[RejectionReason.IMPLAUSIBLE] += len(recognized) - kept
            # by what is kept: a joining place that was rejected would be found and rejected again for ever
            is_joined = len(np.unique(self.graph.label_rigid_components())) < components
            joining += is_joined
            if not (is_better or is_joined):
                break
            last = found
        if self.graph.label_rigid_components(best.constraints).any():
            tracked = SOLVER.solve(self._graph(best.graph.poses, best.constraints)).poses
            best = self._start_from("placed 1", best, propose_alignments, tracked)
            best = self._start_from("placed 2", best, propose_alignments, self.adjust(best).graph.poses)
        return self._start_from("revisits", best, propose_revisits, self.adjust(best).graph.poses)

    def adjust(self, candidate: Candidate) -> Adjusted:
        """Move the key scans of a candidate until their surfaces fit; the same again where that was done before.

        Where no constraint joins components, their surfaces are matched to each other in one trial and not in another;
        the one with the better score is returned. Key scans stay where they are if they agreed much better there: of a
        few beams surfaces show too little.
        """
        if candidate.name not in self.adjusted:
            components = self.graph.label_rigid_components(candidate.constraints)
            measured = self._measured(candidate)
            found = [self._adjust(measured, candidate.graph.poses, np.zeros_like(components))]
            if components.any():
                found.append(self._adjust(measured, candidate.graph.poses, components))
            best = max(found, key=lambda adjusted: adjusted.score.log_likelihood)
            self.adjusted[candidate.name] = self._undo_if_torn(best, measured.with_poses(candidate.graph.poses))
        return self.adjusted[candidate.name]

    def _adjust(self, measured: PoseGraph, before: FloatArray, components: IntArray) -> Adjusted:
        """Move key scans from poses (T, 3); those of different components (T,) are not matched to each other."""
        threads = self.closure_state.threads
        graph, variance = adjust_key_scans(measured, self.surfaces, self.fives, components, threads)
        graph = place_components(graph, before, components)
        score, maps = self._score(graph.poses)
        return Adjusted(graph, graph.edges[len(measured.edges) :], variance, score, maps)

    def _undo_if_torn(self, adjusted: Adjusted, before: PoseGraph) -> Adjusted:
        """Return the graph from before, without pairs, if its key scans agreed much better; else the adjusted one."""
        if adjusted.score.agreement >= NEUTRAL:
            return adjusted
        score, maps = self._score(before.poses)
        if score.agreement <= adjusted.score.agreement + _TORN:
            return adjusted
        return Adjusted(before, np.empty((0, 2), np.int64), adjusted.variance, score, maps)

    def _score(self, poses: FloatArray) -> tuple[TrajectoryScore, TileMaps]:
        return score_trajectory(self.graph, self.closure_state.scans, poses, self.mapper, self.on_progress)

    def _log_likelihood(self, candidate: Candidate) -> float:
        return self.adjust(candidate).score.log_likelihood

    def _measured(self, best: Candidate) -> PoseGraph:
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

    def _add_closures(self, name: str, begin: Candidate) -> Candidate | None:
        """Add newly found closures to a candidate; None if there are none.

        Robust least squares over all of them rejects the outliers.
        """
        closure_state = self.closure_state
        known = begin.constraints
        self.graph.constraints = known
        self.graph.correct(begin.graph.poses)
        found, rejected = self.closure.recognition.search_all(
            closure_state, self.mapper, self.pairs, self.on_progress, self.searched
        )
        closure_state.rejected[RejectionReason.INCONSISTENT] += rejected
        pairs = {constraint.pair for constraint in known}
        new = [constraint for constraint in found if constraint.pair not in pairs]
        if self.graph.label_rigid_components().any():
            # the filter's poses are drawn at random, and off for some key scans after a gap: components have tracked
            # shapes
            self.graph.correct(SOLVER.solve(self._graph(begin.graph.poses, known)).poses)
            new += align_components(
                closure_state,
                self.mapper,
                self.stretches,
                self.closure.places,
                self.on_progress,
                self.searched,
            )
        new = [c for c in new if c.determined or c.pair not in pairs]
        if not new:
            return None
        solver = replace(SOLVER, first_guess="either")  # a wide loop is not reached from where poses are
        solution = solver.solve(self._graph(begin.graph.poses, [*new, *known]))
        weights = solution.weights[len(begin.graph.poses) - 1 :].tolist()
        recognized = [constraint for constraint, weight in zip(new, weights, strict=False) if weight >= 0.5]
        closure_state.rejected[RejectionReason.IMPLAUSIBLE] += len(new) - len(recognized)
        if not recognized:
            return None
        return self._optimize(name, solution.poses, [*recognized, *known])

    def _take_over(self, candidate: Candidate, recognized: list[Constraint]) -> Candidate:
        """Return a candidate with recognized places that agree with it; without, where it is clearly worse with them.

        Where its pieces share nothing, places that join some of them wrongly bend the others.
        """
        without = self.adjusted.pop(candidate.name)
        joined = self._keep_trajectory(candidate.name, without.graph.poses, recognized)
        if self._log_likelihood(joined) >= without.score.log_likelihood - _BARE_MENTION:
            return joined
        self.adjusted[candidate.name] = without
        self.graph.constraints = candidate.constraints
        return candidate

    def _start_from(
        self, name: str, best: Candidate, propose: Callable[..., list[Constraint]], drawn: FloatArray
    ) -> Candidate:
        """Let a candidate start from places that are proposed in a map drawn from poses (T, 3); return the better one.

        What fits is no constraint, but where surfaces are matched from.
        """
        known = best.constraints
        self.graph.constraints = known
        self.graph.correct(drawn)
        found = propose(self.closure_state, self.mapper, self.stretches, self.closure, self.on_progress, self.searched)
        if not found:
            return best
        poses = SOLVER.solve(self._graph(best.graph.poses, [*found, *known])).poses
        other = self._keep_trajectory(name, poses, best.recognized_constraints)
        if _moved_m(other, self.adjust(best)) <= _AGREE_M:
            return best
        return max(best, other, key=self._log_likelihood)

    def _optimize(self, name: str, poses: FloatArray, constraints: list[Constraint]) -> Candidate:
        """Make a candidate of the tracked motion and constraints, beginning at poses (T, 3)."""
        solution = GraphSlam(first_guess="given", robust=_ROBUST).solve(self._graph(poses, constraints))
        return Candidate(name, solution.graph, constraints, solution.weights)

    def _keep_trajectory(self, name: str, poses: FloatArray, recognized: list[Constraint]) -> Candidate:
        """Make a candidate of poses (T, 3) that stay where they are, whatever was recognized."""
        constraints = [*recognized, *self.known]
        graph = self._graph(poses, constraints, between(poses[:-1], poses[1:]))
        return Candidate(name, graph, constraints, _ROBUST.weights(graph))

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


def _moved_m(candidate: Candidate | Adjusted, other: Candidate | Adjusted) -> float:
    """Return the greatest distance (m) of a key scan from where another candidate has it."""
    return float(np.hypot(*(candidate.graph.poses - other.graph.poses)[:, :2].T).max())


def place_components(graph: PoseGraph, before: FloatArray, components: IntArray) -> PoseGraph:
    """Place the components that nothing joins where most of their poses were, seen from the one before the gap.

    Parameters
    ----------
    graph : PoseGraph
        Its first T - 1 measurements are the increments; those that join two components become what the poses have.
    before : (T, 3) float64
        The poses. After a gap some can be off, as a filter's are until they are matched to the map.
    components : (T,) int64
        Rigid component of each.
    """
    poses, measurements = graph.poses.copy(), graph.measurements.copy()
    is_first = components[1:] > np.maximum.accumulate(components[:-1])
    for gap in np.flatnonzero(is_first[graph.held - 1 :]) + graph.held - 1:
        own = components == components[gap + 1]
        wanted = compose(poses[gap], between(before[gap], before[own]))
        turn = np.median(wrap(wanted[:, 2] - poses[own, 2]))
        turned = compose(np.array([0.0, 0.0, turn]), poses[own])
        shift = np.append(np.median(wanted[:, :2] - turned[:, :2], axis=0), 0.0)
        poses[own] = turned + shift
    gaps = np.flatnonzero(np.diff(components))
    measurements[gaps] = between(poses[gaps], poses[gaps + 1])
    return replace(graph, poses=poses, measurements=measurements)
