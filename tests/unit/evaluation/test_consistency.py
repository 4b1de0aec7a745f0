import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.evaluation import nees


def test_nees_by_hand():
    # Standard deviations 0.1, 0.2, 0.05 and errors of 1, 2 and 3 of them, the heading's across the seam.
    covariance = np.diag([0.01, 0.04, 0.0025])[None]
    got = nees(np.array([[1.1, 2.4, 0.1 - math.pi]]), np.array([[1.0, 2.0, math.pi - 0.05]]), covariance)
    assert got == pytest.approx([1 + 4 + 9])
    # Correlated: P = [[2, 1], [1, 2]] has the inverse [[2, -1], [-1, 2]] / 3, so e = (1, 1) gives 2/3.
    correlated = np.array([[[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]])
    assert nees(np.array([[1.0, 1.0, 0.0]]), np.zeros((1, 3)), correlated) == pytest.approx([2 / 3])


def test_claims_that_are_no_covariance_raise():
    with pytest.raises(ArgumentError, match="positive definite"):
        nees(np.zeros((1, 3)), np.zeros((1, 3)), np.diag([1.0, 1.0, -1.0])[None])
