"""Laws of importance weights. Sums of at most 20 terms below 1 lose less than 20 * 2^-53 = 2e-15; 1e-12 is ample."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gridslam.particles import effective_sample_size, entropy, normalize

moderate = st.lists(st.floats(-50, 50), min_size=1, max_size=20).map(np.array)
any_range = (
    st.lists(st.one_of(st.floats(allow_nan=False, max_value=1e308), st.just(-math.inf)), min_size=1, max_size=20)
    .map(np.array)
    .filter(lambda log_weights: log_weights.max() > -math.inf)
)


@given(any_range)
@example(np.array([-1e308, 1e308]))
@example(np.array([-1e5, -1e5 - 1, -math.inf]))
@example(np.array([1e5, 1e5 + 1]))
def test_normalized_weights_sum_to_one(log_weights: np.ndarray) -> None:
    log_normalized = normalize(log_weights)
    assert np.exp(log_normalized).sum() == pytest.approx(1, abs=1e-12)
    assert (log_normalized <= 1e-12).all()
    in_order = log_normalized[np.argsort(log_weights)]
    assert (in_order[1:] >= in_order[:-1]).all()


@given(moderate)
def test_normalize_agrees_with_the_definition_and_keeps_ratios(log_weights: np.ndarray) -> None:
    weights = np.exp(log_weights)
    np.testing.assert_allclose(np.exp(normalize(log_weights)), weights / weights.sum(), rtol=1e-12)
    np.testing.assert_allclose(np.diff(normalize(log_weights)), np.diff(log_weights), atol=1e-12)


@given(moderate)
def test_normalize_is_idempotent(log_weights: np.ndarray) -> None:
    once = normalize(log_weights)
    np.testing.assert_allclose(normalize(once), once, atol=1e-12)


@given(moderate)
def test_size_and_entropy_agree_with_their_definitions(log_weights: np.ndarray) -> None:
    weights = np.exp(log_weights) / np.exp(log_weights).sum()
    assert effective_sample_size(log_weights) == pytest.approx(1 / np.sum(weights**2), rel=1e-12)
    assert entropy(log_weights) == pytest.approx(-np.sum(weights * np.log(weights)), abs=1e-12)


@given(any_range)
def test_size_and_entropy_stay_within_their_bounds(log_weights: np.ndarray) -> None:
    count = len(log_weights)
    assert effective_sample_size(log_weights) >= 1 - 1e-12
    assert effective_sample_size(log_weights) <= count * (1 + 1e-12)
    assert -1e-12 <= entropy(log_weights) <= math.log(count) + 1e-12
    # Renyi entropies fall with their order: that of order 2 is log N_eff, Shannon's has order 1.
    assert math.log(effective_sample_size(log_weights)) <= entropy(log_weights) + 1e-12


@given(moderate, st.floats(-1e3, 1e3))
def test_a_common_factor_changes_nothing(log_weights: np.ndarray, shift: float) -> None:
    # Adding a shift of 1e3 rounds each log weight by 1e-13 at most.
    np.testing.assert_allclose(normalize(log_weights + shift), normalize(log_weights), atol=1e-12)
    assert effective_sample_size(log_weights + shift) == pytest.approx(effective_sample_size(log_weights), rel=1e-11)
    assert entropy(log_weights + shift) == pytest.approx(entropy(log_weights), abs=1e-10)
