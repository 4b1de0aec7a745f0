"""Weights and resamplers: worked values and refusals; `tests/laws` holds the laws."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.particles import (
    Multinomial,
    ResamplingWheel,
    Residual,
    Stratified,
    Systematic,
    effective_sample_size,
    entropy,
    normalize,
)

RESAMPLERS = [ResamplingWheel(), Systematic(), Stratified(), Residual(), Multinomial()]


class Uniform(np.random.Generator):
    """A generator that gives the same uniform number each time."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.PCG64(0))
        self.value = value

    def random(self, size: int | None = None) -> float | np.ndarray:
        return self.value if size is None else np.full(size, self.value)


def test_known_weights() -> None:
    log_weights = np.log([1, 2, 1]) + 1000
    np.testing.assert_allclose(np.exp(normalize(log_weights)), [0.25, 0.5, 0.25])
    assert effective_sample_size(log_weights) == pytest.approx(1 / (1 / 16 + 1 / 4 + 1 / 16))
    assert entropy(log_weights) == pytest.approx(1.5 * math.log(2))


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


def test_stratified_by_hand() -> None:
    np.testing.assert_array_equal(Stratified()(np.array([1.0, 3.0]), 4, Uniform(0.5)), [0, 1, 1, 1])


def test_residual_by_hand() -> None:
    # Expected counts 2.5, 0.5, 1: two, none and one for certain; the fourth from remainders 0.5, 0.5, 0 at 0.75 * 1.
    np.testing.assert_array_equal(Residual()(np.array([2.5, 0.5, 1.0]), 4, Uniform(0.75)), [0, 0, 1, 2])


def test_wheel_by_hand() -> None:
    # Circumference 2 in units of the greatest weight; start at 1, steps of 1: stops at 2 = 0, 1, 0.
    np.testing.assert_array_equal(ResamplingWheel()(np.array([4.0, 2.0, 2.0]), 3, Uniform(0.5)), [0, 0, 1])


@pytest.mark.parametrize("resampler", RESAMPLERS, ids=lambda r: type(r).__name__)
@pytest.mark.parametrize("weights", [[], [[1.0]], [0.0, 0.0], [1.0, -1e-300], [1.0, math.nan], [1.0, math.inf]])
def test_weights_that_are_none_are_refused(resampler, weights: list[object]) -> None:
    with pytest.raises(ArgumentError, match="weights"):
        resampler(np.array(weights), 2, np.random.default_rng(0))
