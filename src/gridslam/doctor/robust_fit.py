"""Robust linear least squares, with standard deviations that do not trust the noise to be as assumed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gridslam.types import FloatArray

__all__ = ["Fit", "robust_fit"]

_CAUCHY = 2.385  # 95 % efficient for normal noise
_PASSES = 15
_MEDIAN_NORM = (0.6745, 1.1774)  # of a standard normal number, and of a vector of two
_BLOCKS = 25


class Fit(NamedTuple):
    """Parameters (P,), their covariance (P, P), and the norm of each residual (N,) in fitted standard deviations."""

    parameters: FloatArray
    covariance: FloatArray
    scores: FloatArray


def robust_fit(design: FloatArray, response: FloatArray, least_spread: float = 1e-9) -> Fit:
    """Fit response (N, D) = design (N, D, P) x parameters, D = 1 or 2, by Cauchy's M-estimator.

    The noise of each of the N terms has unit variance up to a common factor, which is estimated from the residuals by
    their median norm; it is `least_spread` at the least, or what a first bad guess leaves out might stay out. The
    covariance sums the scores of consecutive terms before it squares them, in `_BLOCKS` blocks, so that it holds
    whatever the true variances are and however neighbours correlate; parameters without any term have the variance of
    `least_spread`.

    Source: Huber and Ronchetti, Robust Statistics (2009), section 7; the sandwich with clusters is Liang and Zeger's
    (1986).
    """
    count, width, unknowns = design.shape
    weights = np.ones(count)
    for _ in range(_PASSES):
        normal = np.einsum("n,ndp,ndq->pq", weights, design, design)
        regular = normal + 1e-12 * np.trace(normal) * np.eye(unknowns) + 1e-300 * np.eye(unknowns)
        parameters = np.linalg.solve(regular, np.einsum("n,ndp,nd->p", weights, design, response))
        residuals = response - design @ parameters
        norms = np.sqrt(np.square(residuals).sum(axis=1))
        spread = max(float(np.median(norms)) / _MEDIAN_NORM[width - 1], least_spread)
        scores = norms / spread
        weights = 1 / (1 + np.square(scores / _CAUCHY))
    pulls = np.einsum("n,ndp,nd->np", weights, design, residuals)
    blocks = np.add.reduceat(pulls, np.arange(0, count, max(1, count // _BLOCKS)))
    flatter = max(float((weights * (2 * weights - 1)).sum() / weights.sum()), 0.3)
    inverse = np.linalg.inv(regular * flatter)
    sandwich = inverse @ (blocks.T @ blocks) @ inverse
    return Fit(parameters, sandwich + least_spread**2 * np.linalg.inv(regular), scores)
