"""Pairs of landmarks and their errors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.evaluation.maps import landmark_errors, pair_by_position
from gridslam.geometry.se2 import inverse, transform_points

TRUTH = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.3], [0.0, 5.0], [-3.0, 1.0]])


@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2), turn=st.floats(-0.05, 0.05))
def test_pairs_by_place_are_found_from_a_near_guess_and_surplus_is_told(x, y, turn):
    """0.2 m and 0.05 rad move no landmark by more than 0.6 m; the nearest two are 0.3 m apart."""
    map_from_true = np.array([x, y, turn])
    positions = np.concatenate([transform_points(map_from_true, TRUTH[[3, 2, 1, 4]]), [[20.0, 20.0]]])
    ours, theirs = pair_by_position(positions, TRUTH, inverse(np.zeros(3)), reach_m=0.8)
    errors = landmark_errors(positions, TRUTH, (ours, theirs))
    assert (errors.found, errors.missing, errors.surplus) == (4, 1, 1)
    if np.hypot(x, y) + 5 * abs(turn) < 0.15:  # then each is nearest to its own
        assert dict(zip(ours.tolist(), theirs.tolist(), strict=True)) == {0: 3, 1: 2, 2: 1, 3: 4}
        assert errors.rmse_m < 1e-9


def test_errors_after_alignment():
    moved = transform_points(np.array([5.0, -2.0, 1.0]), TRUTH)
    everyone = np.arange(5), np.arange(5)
    assert landmark_errors(moved, TRUTH, everyone).max_m < 1e-12
    # A square's corners pushed outward by d are off by d each, however they are aligned.
    square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
    found = landmark_errors(1.1 * square, square, (np.arange(4), np.arange(4)))
    assert found.rmse_m == pytest.approx(0.1 * np.sqrt(2))
    assert found.max_m == pytest.approx(0.1 * np.sqrt(2))
