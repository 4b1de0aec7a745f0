"""KLD-sampling: its bound, its table done one by one, and that it is fair."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import chdtri

from gridslam.localization.kld_sampling import KldSampling
from gridslam.particles import Systematic


@pytest.mark.parametrize("bins", [2, 3, 10, 100, 3000])
def test_the_bound_is_the_chi_square_quantile(bins):
    """n = chi^2_{k-1, 1-delta} / (2 eps), of which the formula is Wilson and Hilferty's approximation."""
    kld = KldSampling(error=0.02, z=2.3263478740408408)
    exact = chdtri(bins - 1, 0.01) / (2 * 0.02)
    assert kld.bound(np.array(bins)) == pytest.approx(exact, rel=0.02 if bins < 10 else 0.004, abs=1)


def test_one_bin_asks_for_nothing():
    assert KldSampling().bound(np.array([0, 1])).tolist() == [0, 0]


def one_by_one(kld: KldSampling, poses: np.ndarray, weights: np.ndarray, rng: np.random.Generator) -> int:
    """The loop of Table 8.4, as the book has it."""
    ends, full, m = np.cumsum(weights), set[int](), 0
    bins = kld.bins(poses)
    while True:
        drawn = min(int(ends.searchsorted(rng.random() * ends[-1], side="right")), len(bins) - 1)
        full.add(int(bins[drawn]))
        m += 1
        if m >= kld.particles_max or (m >= kld.bound(np.array(len(full))) and m >= kld.particles_min):
            return m


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 3.0))
@settings(max_examples=25, deadline=None)
def test_as_many_as_the_table_draws_one_by_one(seed, width):
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(400, 3)) * [width, width, 0.3]
    weights = rng.random(400) ** 4
    kld = KldSampling(particles_min=20, particles_max=1500)
    assert kld.size(poses, weights, np.random.default_rng(seed)) == one_by_one(
        kld, poses, weights, np.random.default_rng(seed)
    )


def test_resampling_is_unbiased():
    """Of M drawn a particle comes up M w times in the mean: 400 draws of 500 or so, by a sampler of low variance."""
    rng = np.random.default_rng(3)
    poses, weights = rng.normal(size=(50, 3)), rng.random(50)
    weights /= weights.sum()
    kld = KldSampling(particles_min=100, particles_max=2000)
    shares = []
    for seed in range(400):
        parents = kld(poses, weights, Systematic(), np.random.default_rng(seed))
        shares.append(np.bincount(parents, minlength=50) / len(parents))
    # A count is floor or ceil of M w: its share has a deviation of at most 0.5 / 100, its mean over 400 of 2.5e-4.
    np.testing.assert_allclose(np.mean(shares, axis=0), weights, atol=5 * 2.5e-4)
