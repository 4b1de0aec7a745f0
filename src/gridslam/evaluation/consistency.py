"""Consistency of an estimator: the normalized estimation error squared (NEES)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.types import FloatArray

__all__ = ["Consistency", "check_consistency", "chi_square_quantile", "nees"]


@final
@dataclass(frozen=True, slots=True)
class Consistency:
    """Average NEES of `n` independent estimates, and where it lies with the given confidence if they are consistent.

    Attributes
    ----------
    n : int
        Number of estimates.
    average_nees : float
        Its expectation is the dimension, 3.
    lower, upper : float
        Two-sided chi-square bounds: above is overconfident, below is cautious.
    """

    n: int
    average_nees: float
    lower: float
    upper: float

    @property
    def consistent(self) -> bool:
        """Whether the average lies within the bounds."""
        return self.lower <= self.average_nees <= self.upper


def nees(estimates: FloatArray, truths: FloatArray, covariances: FloatArray) -> FloatArray:
    """Normalized estimation error squared e' P^-1 e of each pose, e = [dx, dy, dtheta] in the world frame.

    Parameters
    ----------
    estimates, truths : (N, 3) float64
        Poses in one frame.
    covariances : (N, 3, 3) float64
        What the estimator claims, positive definite.

    Returns
    -------
    (N,) float64
        Chi-square distributed with 3 degrees of freedom where the claim is true.

    Raises
    ------
    ArgumentError
        A covariance is not positive definite.

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2.
    """
    errors = estimates - truths
    errors[:, 2] = wrap(errors[:, 2])
    try:
        roots = np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        raise ArgumentError("covariances", "positive definite matrices", "one that is not") from None
    whitened = np.linalg.solve(roots, errors[:, :, None])
    squares: FloatArray = np.square(whitened[:, :, 0]).sum(axis=1)
    return squares


def _chi_square_cdf(x: float, degrees: int) -> float:
    """Distribution function by the power series of the incomplete gamma function, whose terms are all positive."""
    shape, half = degrees / 2, x / 2
    term = total = 1.0
    divisor = shape
    while term > 1e-17 * total:
        divisor += 1
        term *= half / divisor
        total += term
    return total * math.exp(shape * math.log(half) - half - math.lgamma(shape + 1)) if x > 0 else 0.0


def chi_square_quantile(probability: float, degrees: int) -> float:
    """Quantile of the chi-square distribution for `probability` in (0, 1) and `degrees` >= 1 of freedom.

    Raises ArgumentError where one of them is out of its range.

    Source: Abramowitz and Stegun, Handbook of Mathematical Functions (1964), 6.5 and 26.4, inverted by bisection.
    """
    if not 0 < probability < 1:
        raise ArgumentError("probability", "a number between 0 and 1", probability)
    if degrees < 1:
        raise ArgumentError("degrees", "at least 1", degrees)
    low, high = 0.0, float(degrees)
    while _chi_square_cdf(high, degrees) < probability:
        low, high = high, 2 * high
    while high - low > 1e-12 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if _chi_square_cdf(middle, degrees) < probability else (low, middle)
    return high


def check_consistency(
    estimates: FloatArray, truths: FloatArray, covariances: FloatArray, *, confidence: float = 0.95
) -> Consistency:
    """Test the average NEES of N >= 1 independent runs against its chi-square bounds.

    The errors along one run are correlated and do not count as independent: take one pose from each of N runs.

    Parameters
    ----------
    estimates, truths, covariances : (N, 3), (N, 3), (N, 3, 3) float64
        As for `nees`.
    confidence : float, (0, 1)
        Probability that a consistent estimator lies within the bounds.

    Raises
    ------
    ArgumentError
        No estimate, a covariance that is not positive definite, or a confidence outside (0, 1).

    Source: Y. Bar-Shalom, X. Li, T. Kirubarajan (2001), 5.4.2.
    """
    n = len(estimates)
    if n == 0:
        raise ArgumentError("estimates", "at least one pose", "none")
    tail = (1 - confidence) / 2
    lower, upper = (chi_square_quantile(p, 3 * n) / n for p in (tail, 1 - tail))
    return Consistency(n, float(nees(estimates, truths, covariances).mean()), lower, upper)
