"""GraphSLAM: the most likely trajectory of a pose graph."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Literal, final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.parameters import Kind, bounded, parameters
from gridslam.slam.pose_graph.descent import Computation, DescentResult, descend, run_to_completion, squared_mahalanobis
from gridslam.slam.pose_graph.linear import BlockSystem, initial_guess, require_connected
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import CauchyEstimator, GraduatedNonConvexity, scale_information
from gridslam.types import FloatArray

_RETRY_RATIOS = (0.1, 0.001)
"""Weights of untrusted edges for first guesses: the best one depends on the false measurements."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class GraphSolution:
    """The solution of GraphSLAM.

    Attributes
    ----------
    graph : PoseGraph
        The measurements as they were given, about the solved poses, whose headings are in [-pi, pi).
    chi2_before, chi2_after : float
        Sum of w e' information e at the poses given and at those found, w the weights.
    iterations : int
        Linear systems solved.
    weights : (M,) float64
        How much each measurement counts, in [0, 1]; all 1 without robust estimation.
    converged : bool
        A minimum was found, within the iterations allowed.
    """

    graph: PoseGraph
    chi2_before: float
    chi2_after: float
    iterations: int
    weights: FloatArray
    converged: bool

    @property
    def poses(self) -> FloatArray:
        """The solved poses (N, 3)."""
        return self.graph.poses

    @property
    def weighted_graph(self) -> PoseGraph:
        """The solved graph as it was solved: information times weight, false measurements left out."""
        return scale_information(self.graph, self.weights)


@final
@checked
@parameters(frozen=True)
class GraphSlam:
    """Least squares over a pose graph: the poses of the least chi2, the first ones held.

    Parameters
    ----------
    first_guess : "given", "computed" or "either"
        Where the search begins: at the graph's own poses (for a graph that was solved before and grew: two or three
        iterations, one if `max_iterations` is 1), at `initial_guess` (for poses that mean nothing), or where chi2 is
        less, and again from the other where the first answer is doubtful: it turned some pose by more than a right
        angle from the computed guess, or its chi2 is greater than the measurements' noise explains.
    robust : GraduatedNonConvexity, CauchyEstimator or None
        Robust estimator of the measurements that are not trusted; None for plain least squares.
    max_iterations : int
        Linear systems solved at most from one guess.
    tolerance : float
        A minimum is where the quadratic model promises to lower chi2 by less than this share.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), chapter 11; Grisetti et al., A tutorial on graph-based
    SLAM (2010), algorithm 1.
    """

    first_guess: Literal["given", "computed", "either"] = "either"
    robust: Annotated[GraduatedNonConvexity | CauchyEstimator | None, Kind()] = None
    max_iterations: int = bounded(100, ge=1, le=1000)
    tolerance: float = bounded(1e-6, ge=1e-15, lt=1)

    def solve(self, graph: PoseGraph) -> GraphSolution:
        """Find the poses of least chi2.

        Raises
        ------
        ArgumentError
            The measurements do not join all poses, or their information matrices differ too much for 64-bit numbers.
        """
        return run_to_completion(self.solve_in_steps(graph))

    def solve_in_steps(self, graph: PoseGraph) -> Computation[GraphSolution]:
        """Solve as `solve` does, in steps of about one linear system each."""
        require_connected(graph.edges, len(graph.poses))
        weights = np.ones(len(graph.edges))
        if len(graph.poses) == graph.held:
            chi2 = graph.chi2()
            return GraphSolution(graph, chi2, chi2, 0, weights, True)
        if self.robust is None:
            found = yield from self._least_squares(graph)
        else:
            estimate = yield from self.robust.estimate(
                graph, self._initial_guesses(graph), self.max_iterations, self.tolerance
            )
            found = estimate.solution
            weights = estimate.weights
        if not math.isfinite(found.chi2):
            raise ArgumentError("graph", "measurements whose chi2 is a finite number", found.chi2)
        poses = found.poses.copy()
        poses[: graph.held] = graph.poses[: graph.held]  # to the last bit
        poses[:, 2] = wrap(poses[:, 2])
        before = float((weights * squared_mahalanobis(graph, graph.errors())).sum())
        return GraphSolution(graph.with_poses(poses), before, found.chi2, found.iterations, weights, found.converged)

    def _least_squares(self, graph: PoseGraph) -> Computation[DescentResult]:
        """Return the least chi2 met from the guesses there are."""
        system = BlockSystem(graph.edges, len(graph.poses), 3, graph.held)
        computed = graph.poses if self.first_guess == "given" else initial_guess(graph)
        starts = sorted((computed, graph.poses), key=graph.chi2) if self.first_guess == "either" else [computed]
        found = yield from descend(graph, starts[0], system, self.max_iterations, self.tolerance)
        if self.first_guess != "either" or not _doubtful(found, computed, len(graph.edges), graph.held):
            return found
        other = yield from descend(graph, starts[1], system, self.max_iterations, self.tolerance)
        best = min(found, other, key=lambda descent: descent.chi2)
        return replace(best, iterations=found.iterations + other.iterations)

    def _initial_guesses(self, graph: PoseGraph) -> Iterator[FloatArray]:
        """Guesses for a robust estimation: the graph's poses, and where the trusted measurements put them."""
        if self.first_guess != "computed":
            yield graph.poses
        if self.first_guess != "given":
            for weight in _RETRY_RATIOS:
                yield initial_guess(scale_information(graph, np.where(graph.trusted, 1.0, weight)))


def _doubtful(found: DescentResult, computed: FloatArray, measurements: int, held: int) -> bool:
    """Whether another guess may lead lower: see `GraphSlam`."""
    turned = np.abs(wrap(found.poses[:, 2] - computed[:, 2])).max()
    freedom = 3 * (measurements - len(computed) + held)
    return bool(turned > math.pi / 2 or found.chi2 > freedom + 5 * math.sqrt(2 * freedom))
