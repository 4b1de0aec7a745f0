"""The median is NumPy's to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.median import median, medians


@pytest.mark.parametrize("count", range(1, 8))
def test_it_is_numpys_to_the_last_bit(count):
    rng = np.random.default_rng(count)
    for scale in (1e-300, 1.0, 1e300):
        numbers = scale * rng.normal(size=(count, 3))
        assert medians(numbers).tobytes() == np.median(numbers, axis=0).tobytes()
        assert median(numbers[:, 0]) == np.median(numbers[:, 0])
    assert median(rng.integers(0, 9, count)) in np.arange(0, 9, 0.5)


@pytest.mark.parametrize("special", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_count_as_in_numpys(special):
    numbers = np.array([[1.0, 2.0], [special, 3.0], [0.0, special], [5.0, 6.0]])
    np.testing.assert_array_equal(medians(numbers), np.median(numbers, axis=0))
