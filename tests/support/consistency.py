"""Consistency of an estimator: its average NEES and the chi-square bounds of that."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.special import chdtri

from gridslam.errors import ArgumentError
from gridslam.evaluation import nees


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


def chi_square_quantile(probability, degrees):
    """Quantile of the chi-square distribution for `probability` in (0, 1) and `degrees` >= 1 of freedom.

    Raises ArgumentError where one of them is out of its range.
    """
    if not 0 < probability < 1:
        raise ArgumentError("probability", "a number between 0 and 1", probability)
    if degrees < 1:
        raise ArgumentError("degrees", "at least 1", degrees)
    return float(chdtri(degrees, 1 - probability))


def check_consistency(estimates, truths, covariances, *, confidence=0.95):
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
