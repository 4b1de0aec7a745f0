"""Robust GraphSLAM: measurements that are true or false by graduated non-convexity, better and worse by Cauchy's."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from gridslam.parameters import bounded, parameters
from gridslam.slam.pose_graph.descent import Computation, DescentResult, descend, squared_mahalanobis
from gridslam.slam.pose_graph.linear import BlockSystem, find_parts, initial_guess
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray

_LEAST_WEIGHT = 1e-8
"""Keeps the linear system regular where poses are only constrained by rejected measurements."""

_ROUNDS = 5
_REFITS = 8
"""At most; they end where the cost falls no more, which is after one to three."""

_PASSES = 2
_ROUGH = 1e-3
"""Linear systems for one degree of non-convexity, and the share of chi2 that is left to the next."""

_ENOUGH = 20
_FINE = 1e-5
"""The same, for the classification into inliers and outliers."""

_SAME = 1e-4
"""Costs that differ by less than this share are of the same minimum."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class RobustEstimate:
    """A solution, its weights (M,), 0 or 1, and its truncated cost."""

    solution: DescentResult
    weights: FloatArray
    cost: float


@final
@parameters(frozen=True)
class CauchyEstimator:
    """Cauchy's M-estimator, by iteratively reweighted least squares from the graph's poses.

    A measurement whose error is s standard deviations counts 1 / (1 + (s / scale)^2). Thousands of matches against
    submaps, each a little wrong in its own way, are not a matter of inliers and outliers; closures are (see
    `GraduatedNonConvexity`).

    Parameters
    ----------
    scale : float
        Standard deviations at which a measurement counts half.
    passes : int
        Reweightings at most.
    stop_m : float, m
        A pass that moves no pose farther is the last.

    References
    ----------
    Holland and Welsch, Robust regression using iteratively reweighted least squares (1977).
    """

    scale: float = bounded(2.0, ge=1e-6, le=1e6)
    passes: int = bounded(8, ge=1, le=1000)
    stop_m: float = bounded(1e-3, ge=1e-6, le=1e6)

    def estimate(
        self, graph: PoseGraph, starts: Iterable[FloatArray], max_iterations: int, tolerance: float
    ) -> Computation[RobustEstimate]:
        """Find poses and weights from the first of the guesses; the rest is as for `descend`."""
        poses = next(iter(starts))
        system = BlockSystem(graph.edges, len(graph.poses), 3, graph.held)
        weights = self.weights(graph, poses)
        iterations = 0
        for _ in range(self.passes):
            weighted = replace(graph, information=graph.information * weights[:, None, None])
            found: DescentResult = yield from descend(weighted, poses, system, min(2, max_iterations), tolerance)
            iterations += found.iterations
            moved = float(np.abs(found.poses - poses)[:, :2].max())
            poses = found.poses
            weights = self.weights(graph, poses)
            if moved < self.stop_m:
                break
        chi2 = float((weights * squared_mahalanobis(graph, graph.errors(poses))).sum())
        return RobustEstimate(replace(found, poses=poses, chi2=chi2, iterations=iterations), weights, chi2)

    def weights(self, graph: PoseGraph, poses: FloatArray | None = None) -> FloatArray:
        """How much each measurement counts (M,), in [0, 1], at poses (N, 3), by default the graph's own."""
        squared = squared_mahalanobis(graph, graph.errors(poses))
        return np.where(graph.trusted, 1.0, 1.0 / (1.0 + squared / self.scale**2))


@final
@parameters(frozen=True)
class GraduatedNonConvexity:
    """Truncated least squares: a squared error counts at most c^2, which a true measurement hardly exceeds.

    The cost has many minima. It is reached through a family of costs, from one that is nearly convex to the truncated
    one, minimized in turn by weighted least squares. The inliers are then solved again from their own initial guess,
    without the outliers that distorted the graph, and classified again, as long as the cost falls. Both together are a
    round. Rounds start from several guesses until two agree, and are repeated from the best.

    Parameters
    ----------
    probability : float
        Share of the true measurements whose squared error is less than c^2, the quantile of chi2 with three degrees of
        freedom: right as far as the information matrices are.
    growth : float
        Factor from one degree of non-convexity to the next. The paper's 1.4 takes four times as long; on real graphs
        with ten percent of false closures it does no better than 4 once rounds are repeated.

    References
    ----------
    Yang, Antonante, Tzoumas, Carlone, Graduated non-convexity for robust spatial perception (2020), algorithm 1
    with the truncated least squares of proposition 4 and remark 5.
    """

    probability: float = bounded(0.999, ge=0.01, lt=1)
    growth: float = bounded(4.0, gt=1, le=1e6)

    @property
    def bound(self) -> float:
        """c^2, the truncation threshold: the largest squared error of an inlier."""
        from scipy.special import chdtri  # only who closes loops pays for its import

        return float(chdtri(3, 1 - self.probability))

    def estimate(
        self, graph: PoseGraph, starts: Iterable[FloatArray], max_iterations: int, tolerance: float
    ) -> Computation[RobustEstimate]:
        """Find poses and weights from one or more guesses (N, 3); the rest is as for `descend`."""
        search = _Search(graph, self.bound, self.growth)
        best = RobustEstimate(DescentResult(graph.poses, np.inf, 0, False), np.ones(len(graph.edges)), np.inf)
        for start in starts:
            found = yield from search.round(start)
            agreed = abs(found.cost - best.cost) <= _SAME * found.cost
            best = min(best, found, key=lambda estimate: estimate.cost)
            if agreed:
                break
        else:
            for _ in range(_ROUNDS):
                found = yield from search.round(best.solution.poses)
                if found.cost >= (1.0 - _SAME) * best.cost:
                    break
                best = found
        return (yield from search.finish(best, max_iterations, tolerance))


@final
class _Search:
    """The steps of one robust estimation; counts the linear systems that it solves."""

    def __init__(self, graph: PoseGraph, bound: float, growth: float) -> None:
        self.graph = graph
        self.bound = bound
        self.growth = growth
        self.iterations = 0

    def round(self, poses: FloatArray) -> Computation[RobustEstimate]:
        """Graduate from poses (N, 3), then fit the inliers and reclassify in turn until the cost stops decreasing."""
        poses, weights = yield from self._graduate(poses)
        best = RobustEstimate(DescentResult(poses, np.inf, 0, False), weights, np.inf)
        for _ in range(_REFITS):
            found = yield from self._refit(weights, best)
            if found.cost >= best.cost:
                break
            best = found
            weights = np.where(self.graph.trusted | (self._squared(best.solution.poses) < self.bound), 1.0, 0.0)
            if (weights == best.weights).all():
                break
        return best

    def _refit(self, weights: FloatArray, best: RobustEstimate) -> Computation[RobustEstimate]:
        """Fit the inliers, from their own initial guess; from the best poses so far if that does not help."""
        found = best
        for start in (initial_guess(scale_information(self.graph, weights)), best.solution.poses):
            solution = yield from self._fit(weights, start, _ENOUGH, _FINE)
            found = RobustEstimate(solution, weights, self._cost(solution.poses))
            if found.cost < best.cost:
                break
        return found

    def finish(self, found: RobustEstimate, max_iterations: int, tolerance: float) -> Computation[RobustEstimate]:
        """Descend to the minimum, with the weights as they are."""
        solution = yield from self._fit(found.weights, found.solution.poses, max_iterations, tolerance)
        return replace(found, solution=replace(solution, iterations=self.iterations))

    def _graduate(self, poses: FloatArray) -> Computation[tuple[FloatArray, FloatArray]]:
        """Return poses (N, 3) and weights (M,), almost all 0 or 1, at the end of the family of costs."""
        doubted = ~self.graph.trusted
        weights = np.ones(len(self.graph.edges))
        squared = self._squared(poses)[doubted]
        worst = 2.0 * float(squared.max(initial=0.0)) - self.bound
        if worst <= 0.0:
            return poses, weights
        degree = self.bound / worst
        while ((weights > 0.0) & (weights < 1.0)).any() or degree == self.bound / worst:
            scale = np.sqrt(self.bound * degree * (degree + 1.0) / np.maximum(squared, 1e-300))
            weights[doubted] = np.clip(scale - degree, 0.0, 1.0)
            poses = (yield from self._fit(weights, poses, _PASSES, _ROUGH)).poses
            squared = self._squared(poses)[doubted]
            degree *= self.growth
        return poses, weights

    def _fit(
        self, weights: FloatArray, poses: FloatArray, max_iterations: int, tolerance: float
    ) -> Computation[DescentResult]:
        yield
        counted = scale_information(self.graph, weights)
        system = BlockSystem(counted.edges, len(poses), 3, counted.held)
        found = yield from descend(counted, poses, system, max_iterations, tolerance)
        self.iterations += found.iterations
        return found

    def _squared(self, poses: FloatArray) -> FloatArray:
        return squared_mahalanobis(self.graph, self.graph.errors(poses))

    def _cost(self, poses: FloatArray) -> float:
        squared = self._squared(poses)
        return float(np.where(self.graph.trusted, squared, np.minimum(squared, self.bound)).sum())


def scale_information(graph: PoseGraph, weights: FloatArray) -> PoseGraph:
    """Return the graph with information times weights (M,), without edges of weight 0 if it stays connected."""
    counts = weights > 0.0
    if find_parts(graph.edges[counts], len(graph.poses)).any():
        counts, weights = np.ones(len(weights), np.bool_), np.maximum(weights, _LEAST_WEIGHT)
    return replace(graph, information=graph.information * weights[:, None, None]).select(counts)
