from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.evaluation import nees
from support.consistency import check_consistency, chi_square_quantile


# Printed tables of the chi-square distribution.
@pytest.mark.parametrize(
    ("probability", "degrees", "quantile"),
    [
        (0.95, 1, 3.84146),
        (0.025, 3, 0.21580),
        (0.5, 3, 2.36597),
        (0.95, 3, 7.81473),
        (0.975, 3, 9.34840),
        (0.01, 10, 2.55821),
        (0.05, 10, 3.94030),
        (0.95, 10, 18.30704),
        (0.99, 10, 23.20925),
        (0.025, 100, 74.22193),
        (0.975, 100, 129.56120),
    ],
)
def test_quantiles_of_the_tables(probability, degrees, quantile):
    assert chi_square_quantile(probability, degrees) == pytest.approx(quantile, rel=3e-5)


# With two degrees the distribution is exponential: 1 - exp(-x / 2). With many it tends to the normal's quantiles.
def test_quantiles_in_closed_form():
    for probability in (1e-6, 0.3, 0.999999):
        assert chi_square_quantile(probability, 2) == pytest.approx(-2 * math.log1p(-probability), rel=1e-9)
    assert chi_square_quantile(0.975, 30_000) == pytest.approx(30_000 + 1.959964 * math.sqrt(60_000), rel=1e-4)


def test_nees_by_hand():
    # Standard deviations 0.1, 0.2, 0.05 and errors of 1, 2 and 3 of them, the heading's across the seam.
    covariance = np.diag([0.01, 0.04, 0.0025])[None]
    got = nees(np.array([[1.1, 2.4, 0.1 - math.pi]]), np.array([[1.0, 2.0, math.pi - 0.05]]), covariance)
    assert got == pytest.approx([1 + 4 + 9])
    # Correlated: P = [[2, 1], [1, 2]] has the inverse [[2, -1], [-1, 2]] / 3, so e = (1, 1) gives 2/3.
    correlated = np.array([[[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]])
    assert nees(np.array([[1.0, 1.0, 0.0]]), np.zeros((1, 3)), correlated) == pytest.approx([2 / 3])


def runs(claimed_share, n=200):
    """Errors drawn from a covariance, of which only a share is claimed."""
    rng = np.random.default_rng(11)
    root = np.array([[0.1, 0.0, 0.0], [0.05, 0.2, 0.0], [0.01, -0.02, 0.03]])
    truths = rng.uniform(-3, 3, (n, 3))
    estimates = truths + rng.standard_normal((n, 3)) @ root.T
    return check_consistency(estimates, truths, np.tile(claimed_share * root @ root.T, (n, 1, 1)))


def test_the_true_covariance_is_consistent():
    got = runs(1.0)
    assert got.consistent
    assert (got.lower, got.upper) == pytest.approx((2.6702, 3.3489), rel=1e-3)  # chi-square of 600 degrees, by 200


# Claiming 70 % scales the average, 3 +- 0.17 (sqrt(6/200)), by 1.43 to 4.3: six deviations beyond the upper bound.
@pytest.mark.parametrize(("share", "verdict"), [(0.7, "overconfident"), (1.5, "cautious")])
def test_a_false_covariance_is_found_out(share, verdict):
    got = runs(share)
    assert not got.consistent
    assert (got.average_nees > got.upper) == (verdict == "overconfident")


def test_claims_that_are_no_covariance_raise():
    with pytest.raises(ArgumentError, match="positive definite"):
        nees(np.zeros((1, 3)), np.zeros((1, 3)), np.diag([1.0, 1.0, -1.0])[None])
    with pytest.raises(ArgumentError, match="at least one"):
        check_consistency(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    with pytest.raises(ArgumentError, match="probability"):
        check_consistency(np.zeros((1, 3)), np.zeros((1, 3)), np.eye(3)[None], confidence=1.0)
