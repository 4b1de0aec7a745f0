"""Candidate trajectories and the selection of the best by score."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from gridslam.grid.tiles import TileMaps
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray

__all__ = ["Candidate", "CandidateSelection"]


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
    def increments(self) -> FloatArray:
        """Measured motion (T - 1, 3) between the key scans."""
        return self.graph.measurements[: len(self.graph.poses) - 1]

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
    """Keeps the best of the candidates that are added, its map, and the scores of all by name.

    Parameters
    ----------
    score : callable
        Gets poses (T, 3), gives their score and the map drawn from them.
    """

    __slots__ = ("_best", "_maps", "_score", "scores")

    def __init__(self, score: Callable[[FloatArray], tuple[TrajectoryScore, TileMaps]]) -> None:
        """Begin without a candidate."""
        self._score = score
        self._best: Candidate | None = None
        self._maps: TileMaps | None = None
        self.scores: dict[str, TrajectoryScore] = {}

    def add(self, candidate: Candidate) -> float:
        """Compare a candidate with the best so far, which remains the best where both are equal; log likelihood."""
        score, maps = self._score(candidate.graph.poses)
        if all(score.log_likelihood > other.log_likelihood for other in self.scores.values()):
            self._best, self._maps = candidate, maps
        self.scores[candidate.name] = score
        return score.log_likelihood

    @property
    def best(self) -> Candidate:
        """The best candidate; there must be one."""
        assert self._best is not None
        return self._best

    @property
    def maps(self) -> TileMaps:
        """The map drawn from it."""
        assert self._maps is not None
        return self._maps
