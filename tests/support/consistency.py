"""Consistency of an estimator: its average NEES and the chi-square bounds of that."""

from typing import NamedTuple

from scipy.special import chdtri

from gridslam.evaluation import nees


class Consistency(NamedTuple):
    """Average NEES, whose expectation is 3, and where it lies with 95 % if the covariances tell the truth."""

    average_nees: float
    lower: float
    upper: float


def check_consistency(estimates, truths, covariances):
    """Compare the average NEES of N independent runs with its bounds (Bar-Shalom, Li, Kirubarajan 2001, 5.4.2).

    The errors along one run are correlated and do not count as independent: take one pose from each of N runs.
    """
    n = len(estimates)
    average = float(nees(estimates, truths, covariances).mean())
    return Consistency(average, float(chdtri(3 * n, 0.975)) / n, float(chdtri(3 * n, 0.025)) / n)
