"""Laws of the resamplers: unbiased, and right at every edge."""

from __future__ import annotations

import math

import checks
import numpy as np
import pytest
from checks import z_scores
from hypothesis import example, given
from hypothesis import strategies as st

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
every_resampler = pytest.mark.parametrize("resampler", RESAMPLERS, ids=lambda r: type(r).__name__)

weights_of_any_size = (
    st.lists(
        st.one_of(st.just(0.0), st.floats(0, 1e308), st.floats(0, 1), st.just(5e-324), st.floats(0, 1e-310)),
        min_size=1,
        max_size=20,
    )
    .map(np.array)
    .filter(lambda weights: weights.max() > 0)
)
sizes = st.integers(0, 40)
seeds = st.integers(0, 2**32 - 1)


def counts_of(resampler, weights: np.ndarray, size: int, seed: int) -> np.ndarray:
    return np.bincount(resampler(weights, size, np.random.default_rng(seed)), minlength=len(weights))


def expected_counts(weights: np.ndarray, size: int) -> np.ndarray:
    relative = weights / weights.max()
    return size * relative / relative.sum()


@every_resampler
@pytest.mark.parametrize(("weights", "size"), checks.RESAMPLING_CASES)
def test_expected_counts_are_size_times_weight(resampler, weights: list[float], size: int) -> None:
    checks.counts_are_expected(resampler, weights, size)


def taught_wheel(weights: np.ndarray, size: int, rng: np.random.Generator) -> list[int]:
    """The wheel as lectures give it, started at the beginning of a slot drawn uniformly."""
    index, rest, stops = int(rng.integers(len(weights))), 0.0, []
    for _ in range(size):
        rest += rng.random() * 2.0 * weights.max()
        while rest > weights[index]:
            rest -= weights[index]
            index = (index + 1) % len(weights)
        stops.append(index)
    return stops


def test_the_wheel_as_usually_taught_is_biased() -> None:
    # The first stop is in the slot of weight 1/10 with probability 1/12 (derived in ResamplingWheel's docstring). The
    # standard error of 20000 repetitions is sqrt(1/12 * 11/12 / 20000) = 0.00195: 1/10 is 8.5 of them away. The sum s
    # of two steps has the density s / 1.8^2 up to 1.8 and (3.6 - s) / 1.8^2 beyond: from the beginning of the first
    # slot the second stop is in the second one with probability 0.325 / 3.24, from that of the second with
    # 0.32 / 3.24, so both draws together have 1/12 + 0.645 / 6.48. Its standard error is below
    # sqrt(2 / 12 / 20000) = 0.0029, and 1/5 is 5.9 of them away.
    rng = np.random.default_rng(21)
    weights = np.array([0.9, 0.1])
    for size, expected in ((1, 1 / 12), (2, 1 / 12 + 0.645 / 6.48)):

        def draw(size: int = size) -> np.ndarray:
            return np.bincount(taught_wheel(weights, size, rng), minlength=2)

        assert np.abs(z_scores(draw, np.array([size - expected, expected]), 20000)).max() < 4
        assert np.abs(z_scores(draw, size * weights, 20000)).max() > 5


@pytest.mark.parametrize("size", [1, 4, 9])
def test_multinomial_counts_have_the_multinomial_covariance(size: int) -> None:
    # An entry of the sample covariance from R draws errs by less than sqrt(2 / R) * size / 4 * (1 + O(1/size)), 0.0056
    # * size for R = 4000; five of them are 0.028 * size.
    rng = np.random.default_rng(22)
    weights = np.array([0.1, 0.2, 0.3, 0.4])
    counts = [np.bincount(Multinomial()(weights, size, rng), minlength=4) for _ in range(4000)]
    want = size * (np.diag(weights) - np.outer(weights, weights))
    np.testing.assert_allclose(np.cov(np.transpose(counts)), want, atol=0.028 * size)


@every_resampler
@given(weights=weights_of_any_size, size=sizes, seed=seeds)
@example(weights=np.array([5e-324, 0.0, 5e-324]), size=3, seed=0)
@example(weights=np.array([1e308] * 5), size=5, seed=0)
@example(weights=np.array([0.0, 1.0, 0.0]), size=4, seed=0)
@example(weights=np.array([0.1] * 10 + [0.0]), size=11, seed=0)
def test_contract(resampler, weights: np.ndarray, size: int, seed: int) -> None:
    drawn = resampler(weights, size, np.random.default_rng(seed))
    assert drawn.shape == (size,)
    assert drawn.dtype == np.int64
    assert (np.diff(drawn) >= 0).all()
    assert ((drawn >= 0) & (drawn < len(weights))).all()
    assert (weights[drawn] > 0).all()


@every_resampler
@given(weights=st.lists(st.floats(1e-3, 1), min_size=1, max_size=10).map(np.array), size=sizes, seed=seeds)
def test_only_ratios_of_weights_matter(resampler, weights: np.ndarray, size: int, seed: int) -> None:
    drawn = resampler(weights, size, np.random.default_rng(seed))
    for scale in (2.0**900, 2.0**-1000):  # powers of two scale without rounding
        np.testing.assert_array_equal(resampler(weights * scale, size, np.random.default_rng(seed)), drawn)


@given(weights_of_any_size, sizes, seeds)
def test_counts_stay_near_their_expectation(weights: np.ndarray, size: int, seed: int) -> None:
    # 1e-9 lets a point fall to either side of a slot's end where it differs by rounding only.
    expected = expected_counts(weights, size)
    systematic = counts_of(Systematic(), weights, size, seed)
    assert (systematic >= np.floor(expected - 1e-9)).all()
    assert (systematic <= np.ceil(expected + 1e-9)).all()
    # A slot covers all of the sections inside it and parts of at most two more.
    assert (np.abs(counts_of(Stratified(), weights, size, seed) - expected) < 2 + 1e-9).all()
    assert (counts_of(Residual(), weights, size, seed) >= np.floor(expected - 1e-9)).all()


@pytest.mark.parametrize("resampler", [Systematic(), Stratified(), Residual()], ids=lambda r: type(r).__name__)
@given(count=st.integers(1, 200), weight=st.floats(5e-324, 1e308), seed=seeds)
def test_equal_weights_keep_every_particle(resampler, count: int, weight: float, seed: int) -> None:
    drawn = resampler(np.full(count, weight), count, np.random.default_rng(seed))
    np.testing.assert_array_equal(drawn, np.arange(count))


class ExtremeGenerator(np.random.Generator):
    """A generator whose uniform numbers in [0, 1) are all the least or all the greatest possible."""

    def __init__(self, value: float) -> None:
        super().__init__(np.random.PCG64(0))
        self.value = value

    def random(self, size: int | None = None) -> float | np.ndarray:
        return self.value if size is None else np.full(size, self.value)


@every_resampler
@pytest.mark.parametrize("value", [0.0, math.nextafter(1.0, 0.0)])
@pytest.mark.parametrize(
    "weights", [[0.1] * 10 + [0.0] * 3, [0.0, 0.3, 0.0, 0.7, 0.0], [1e-300, 1.0, 1e-300], [0.0, 1.0]]
)
def test_the_ends_of_the_unit_interval_hit_no_empty_slot(resampler, value: float, weights: list[float]) -> None:
    for size in (1, 2, 3, 10, 13, 1000):
        drawn = resampler(np.array(weights), size, ExtremeGenerator(value))
        assert drawn.shape == (size,)
        assert (np.array(weights)[drawn] > 0).all()


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
