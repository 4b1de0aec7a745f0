"""Robust GraphSLAM where measurements are not true or false, but better and worse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.slam.pose_graph.descent import DescentResult, descend, squared_mahalanobis
from gridslam.slam.pose_graph.incremental import Computation
from gridslam.slam.pose_graph.linear import BlockSystem
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import RobustEstimate
from gridslam.types import FloatArray

__all__ = ["CauchyEstimator"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
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

    Source: Holland and Welsch, Robust regression using iteratively reweighted least squares (1977).
    """

    scale: float = Field(default=2.0, gt=0)
    passes: int = Field(default=8, ge=1)
    stop_m: float = Field(default=1e-3, gt=0)

    def estimate(
        self, graph: PoseGraph, starts: Iterable[FloatArray], max_iterations: int, tolerance: float
    ) -> Computation[RobustEstimate]:
        """Find poses and weights from the first of the guesses; the rest is as for `descend`."""
        poses = next(iter(starts))
        system = BlockSystem(graph.edges, len(graph.poses), 3)
        weights, iterations = self.weights(graph, poses), 0
        for _ in range(self.passes):
            weighted, passes = _weighted(graph, weights), min(2, max_iterations)
            found: DescentResult = yield from descend(weighted, poses, system, passes, tolerance)
            iterations += found.iterations
            moved = float(np.abs(found.poses - poses)[:, :2].max())
            poses, weights = found.poses, self.weights(graph, found.poses)
            if moved < self.stop_m:
                break
        chi2 = float((weights * squared_mahalanobis(graph, graph.errors(poses))).sum())
        return RobustEstimate(replace(found, poses=poses, chi2=chi2, iterations=iterations), weights, chi2)

    def weights(self, graph: PoseGraph, poses: FloatArray | None = None) -> FloatArray:
        """How much each measurement counts (M,), in [0, 1], at poses (N, 3), by default the graph's own."""
        squared = squared_mahalanobis(graph, graph.errors(poses))
        return np.where(graph.trusted, 1.0, 1.0 / (1.0 + squared / self.scale**2))


def _weighted(graph: PoseGraph, weights: FloatArray) -> PoseGraph:
    return replace(graph, information=graph.information * weights[:, None, None])
