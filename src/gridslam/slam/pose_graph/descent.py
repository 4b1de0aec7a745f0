"""Gauss-Newton with a Levenberg-Marquardt fallback: a local minimum of the sum of squares."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import TypeVar, final

import numpy as np

from gridslam.slam.pose_graph.linear import BlockSystem, linearize
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray

T = TypeVar("T")

Computation = Generator[None, None, T]
"""A long computation that runs a few steps per scan: yields after each of its steps, and returns its result."""

_PATIENCE = 3
"""Gauss-Newton steps that may raise chi2 before it is lower than ever: on long chains the first ones often do."""

_LIGHT = 1e-4
_HEAVY = 1e-2
_HOPELESS = 1e8
"""Initial damping; least damping at which a short step is no sign of convergence; damping at which the solver stops."""

_NEGLIGIBLE = 1e-6
"""A chi2 for each measurement that is rounding and no error."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class DescentResult:
    """Poses (N, 3) of the least chi2 met, that chi2, how many linear systems were solved, and whether it is least."""

    poses: FloatArray
    chi2: float
    iterations: int
    converged: bool


def squared_mahalanobis(graph: PoseGraph, errors: FloatArray) -> FloatArray:
    """Return squared Mahalanobis lengths (M,) of errors (M, 3): the chi2 of each measurement."""
    weighted = np.matmul(graph.information, errors[:, :, None])[:, :, 0]
    return np.asarray((errors * weighted).sum(axis=1))


def descend(
    graph: PoseGraph, poses: FloatArray, system: BlockSystem, max_iterations: int, tolerance: float
) -> Computation[DescentResult]:
    """Minimize chi2 from poses (N, 3), by steps on `system` (three unknowns for each pose), one linear system a step.

    Gauss-Newton steps are taken as long as they find a lower chi2, now and then after some that raise it (the watchdog
    technique of Chamberlain et al. 1982). If they do not, the search goes on from the best poses with Levenberg and
    Marquardt's damping, in proportion to the diagonal of H, until a step succeeds. It ends where the linear system
    promises to lower chi2 by no more than the share `tolerance`.
    """
    errors = graph.errors(poses)
    best = DescentResult(poses, float(squared_mahalanobis(graph, errors).sum()), 0, False)
    best_errors = errors
    damping = 0.0
    rises = 0
    for iteration in range(1, max_iterations + 1):
        matrix, gradient = system.assemble(linearize(graph, poses, errors))
        system.factorize(matrix, damping)
        step = system.solve(-gradient)
        # not by BLAS: waking its threads takes longer than all the rest
        promised = -float((gradient * step[system.held :].ravel()).sum())
        least = not rises and damping < _HEAVY and promised <= tolerance * (best.chi2 + _NEGLIGIBLE * len(errors))
        poses = poses + step
        errors = graph.errors(poses)
        chi2 = float(squared_mahalanobis(graph, errors).sum())
        if chi2 <= best.chi2:
            best = DescentResult(poses, chi2, iteration, least)
            best_errors = errors
            rises = 0
            damping = damping / 10 if damping > _LIGHT else 0.0
        elif damping == 0.0 and rises < _PATIENCE:
            rises += 1
        else:
            poses, errors, rises, damping = best.poses, best_errors, 0, max(10 * damping, _LIGHT)
        if least or damping > _HOPELESS:
            return replace(best, iterations=iteration, converged=least)
        yield
    return replace(best, iterations=max_iterations)


def advance(computation: Computation[T], steps: int) -> T | None:
    """Run up to `steps` steps; return the result if the computation finished, otherwise None (never a valid result)."""
    try:
        for _ in range(steps):
            next(computation)
    except StopIteration as end:
        result: T = end.value
        return result
    return None


def run_to_completion(computation: Computation[T]) -> T:
    """Run the computation to its end and return the result."""
    result = None
    while result is None:
        result = advance(computation, 1)
    return result
