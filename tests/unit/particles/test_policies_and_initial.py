"""Policies, and how the particles are first drawn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm

from gridslam.particles import (
    AlwaysResample,
    EffectiveSampleSizeBelow,
    MotionThreshold,
    NeverResample,
    ResamplingPolicy,
    UpdatePolicy,
    kld_bound,
    sample_gaussian,
)


def test_resampling_policies() -> None:
    assert all(
        isinstance(policy, ResamplingPolicy)
        for policy in (AlwaysResample(), NeverResample(), EffectiveSampleSizeBelow())
    )
    assert AlwaysResample()(30.0, 30, 30)
    assert not NeverResample()(1.0, 30, 8)
    assert EffectiveSampleSizeBelow()(14.9, 30, 30)
    assert not EffectiveSampleSizeBelow()(15.0, 30, 30)
    assert EffectiveSampleSizeBelow(fraction=0.6)(15.0, 30, 30)
    assert EffectiveSampleSizeBelow()(14.9, 15, 30), "more are needed"
    assert EffectiveSampleSizeBelow()(30.0, 30, 14), "fewer are needed"
    assert not EffectiveSampleSizeBelow()(30.0, 30, 15)


def test_update_policy() -> None:
    moved = MotionThreshold(translation_m=0.5, rotation_rad=0.5)
    assert isinstance(moved, UpdatePolicy)
    assert moved == MotionThreshold()
    assert not moved(0.49, 0.49)
    assert moved(0.5, 0.0)
    assert moved(0.0, 0.5)
    assert moved(0.0, -0.5)
    assert not MotionThreshold(translation_m=math.inf)(1e9, 0.0)


def test_spread_has_the_given_moments() -> None:
    # N = 20000. The mean errs by sigma / sqrt(N) and an entry of the covariance by at most sqrt(2 / N) = 0.01 times the
    # two sigmas; five of each is a false alarm for one seed in 10^5.
    count = 20000
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.005], [0.0, -0.005, 0.01]])
    poses = sample_gaussian(count, [1, -2, 3.1], covariance, np.random.default_rng(3))
    assert ((poses[:, 2] >= -math.pi) & (poses[:, 2] < math.pi)).all()
    poses[:, 2] %= 2 * math.pi
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(poses.mean(axis=0) - [1, -2, 3.1]), 5 * sigma / math.sqrt(count))
    np.testing.assert_array_less(np.abs(np.cov(poses.T) - covariance), 0.05 * np.outer(sigma, sigma))


def test_spread_keeps_a_certain_coordinate_and_repeats_with_its_seed() -> None:
    poses = sample_gaussian(50, [1, 2, 3], np.diag([0.0, 1.0, 0.0]), np.random.default_rng(0))
    np.testing.assert_array_equal(poses[:, [0, 2]], [[1, 3]] * 50)
    assert np.ptp(poses[:, 1]) > 1
    np.testing.assert_array_equal(
        poses, sample_gaussian(50, [1, 2, 3], np.diag([0.0, 1.0, 0.0]), np.random.default_rng(0))
    )
    # Rank one, as J P J^T of a single uncertain parameter gives it: rounding must not make it indefinite.
    direction = np.array([0.1, 0.7, 0.3])
    offsets = sample_gaussian(50, [0, 0, 0], np.outer(direction, direction), np.random.default_rng(0)) / direction
    np.testing.assert_allclose(np.ptp(offsets, axis=1), 0, atol=1e-6)


@pytest.mark.parametrize("bins", [2, 5, 20, 300])
@pytest.mark.parametrize("error", [0.05, 0.3])
def test_the_bound_is_the_quantile_of_chi_square(bins, error):
    exact = chi2.ppf(norm.cdf(2.33), bins - 1) / (2 * error)
    assert kld_bound(np.array(bins), error, 2.33) == pytest.approx(exact, rel=0.03, abs=1)
