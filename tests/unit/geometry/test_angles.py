"""Angles: worked values and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import normalize_weights, wrap

TURN = 2 * math.pi


@pytest.mark.parametrize(
    ("angle", "want"),
    [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (TURN, 0.0), (4.0, 4.0 - TURN), (7, 7 - TURN)],
)
def test_wrap_of_known_angles(angle: float, want: float) -> None:
    assert wrap(angle) == want
    assert wrap(np.array([angle]))[0] == want


def test_wrap_keeps_shape_and_kind() -> None:
    assert type(wrap(4.0)) is float
    assert wrap(np.zeros((2, 0, 3))).shape == (2, 0, 3)
    assert wrap(np.array([4], dtype=np.int64)).dtype == np.float64
    # The float32 nearest to pi lies above pi; it is reduced in double precision.
    assert wrap(np.array([math.pi], dtype=np.float32))[0] == float(np.float32(math.pi)) - TURN


@pytest.mark.parametrize("most", [np.pi, 3 * np.pi, 100.0])
def test_many_angles_are_wrapped_as_each_by_itself(most: float) -> None:
    """Bit for bit, whichever way is taken; with angles at the ends of the interval, and next to them."""
    ends = np.array([k * np.pi for k in range(-4, 5)])
    ends = np.concatenate([ends, np.nextafter(ends, -9), np.nextafter(ends, 9)])
    angles = np.concatenate([np.random.default_rng(0).uniform(-most, most, 1000), ends[np.abs(ends) < most]])
    assert wrap(angles).tolist() == [wrap(angle) for angle in angles.tolist()]


def test_wrap_does_not_hide_nan() -> None:
    assert math.isnan(wrap(math.nan))
    assert np.isnan(wrap(np.array([math.nan]))).all()


def test_shares_sum_to_one_at_the_ends_of_the_number_range() -> None:
    np.testing.assert_allclose(normalize_weights([1e308, 1e308, 0]), [0.5, 0.5, 0])
    np.testing.assert_allclose(normalize_weights([5e-324, 1.5e-323]), [0.25, 0.75])


@pytest.mark.parametrize("weights", [[], [0.0, 0.0], [1.0, -1.0], [1.0, math.nan], [1.0, math.inf], 1.0])
def test_bad_weights_are_refused(weights: object) -> None:
    with pytest.raises(ArgumentError, match="weights"):
        normalize_weights(weights)
