"""Consistency of an estimator: the normalized estimation error squared (NEES)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.checked import checked
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


@checked
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

    References
    ----------
    Y. Bar-Shalom, X. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2.
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


@checked
def chi_square_quantile(probability: float, degrees: int) -> float:
    """Quantile of the chi-square distribution for `probability` in (0, 1) and `degrees` >= 1 of freedom.

    Raises ArgumentError where one of them is out of its range.
    """
    if not 0 < probability < 1:
        raise ArgumentError("probability", "a number between 0 and 1", probability)
    if degrees < 1:
        raise ArgumentError("degrees", "at least 1", degrees)
    from scipy.special import chdtri  # only consistency tests pay for its import

    return float(chdtri(degrees, 1 - probability))


@checked
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

    References
    ----------
    Y. Bar-Shalom, X. Li, T. Kirubarajan (2001), 5.4.2.
    """
    n = len(estimates)
    if n == 0:
        raise ArgumentError("estimates", "at least one pose", "none")
    tail = (1 - confidence) / 2
    average = float(nees(estimates, truths, covariances).mean())
    return Consistency(n, average, chi_square_quantile(tail, 3 * n) / n, chi_square_quantile(1 - tail, 3 * n) / n)
