"""Weights and resamplers: worked values and refusals; `tests/laws` holds the laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.particles import (
    Systematic,
    effective_sample_size,
    entropy,
    normalize,
)


class Uniform(np.random.Generator):
    """A generator that gives the same uniform number each time."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.PCG64(0))
        self.value = value

    def random(self, size: int | None = None) -> float | np.ndarray:
        return self.value if size is None else np.full(size, self.value)


def test_extreme_weights() -> None:
    assert effective_sample_size(np.zeros(7)) == 7
    assert effective_sample_size(np.array([0.0, -math.inf, -1e9])) == 1
    assert entropy(np.array([0.0, -math.inf])) == 0
    np.testing.assert_array_equal(normalize(np.array([5.0, -math.inf])), [0, -math.inf])


@pytest.mark.parametrize("function", [normalize, effective_sample_size, entropy])
@pytest.mark.parametrize("bad", [[], [[0.0]], [-math.inf, -math.inf], [0.0, math.nan], [0.0, math.inf]])
def test_an_empty_or_broken_belief_is_refused(function, bad: list[object]) -> None:
    with pytest.raises(ArgumentError, match="log_weights"):
        function(np.array(bad))


def test_systematic_by_hand() -> None:
    # Points at 0.1, 0.35, 0.6, 0.85 of the line; slots end at 0.5, 0.5, 0.6 and 1.
    drawn = Systematic()(np.array([0.5, 0.0, 0.125, 0.375]), 4, Uniform(0.4))
    np.testing.assert_array_equal(drawn, [0, 0, 2, 3])
