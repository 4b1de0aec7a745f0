"""How many particles there are: as many as their spread needs, and the filter goes on with them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm

from gridslam.errors import ConfigurationError
from gridslam.particles import FixedNumber, KldNumber, kld_bound

CENTRE = np.array([3.0, -2.0, 3.1])


def even(poses):
    return np.full(len(poses), -math.log(len(poses)))


def cloud(count, spread, seed=0):
    """Poses that are scattered evenly over a square of that side (m) and as many radians."""
    poses = CENTRE + np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)) * spread
    poses[:, 2] = np.remainder(poses[:, 2] + np.pi, 2 * np.pi) - np.pi  # some lie beyond pi
    return poses


@pytest.mark.parametrize("bins", [2, 5, 20, 300])
@pytest.mark.parametrize("error", [0.05, 0.3])
def test_the_bound_is_the_quantile_of_chi_square(bins, error):
    exact = chi2.ppf(norm.cdf(2.33), bins - 1) / (2 * error)
    assert kld_bound(np.array(bins), error, 2.33) == pytest.approx(exact, rel=0.03, abs=1)


def test_a_fixed_number_is_that_of_the_particles():
    assert FixedNumber()(cloud(17, 3.0), even(cloud(17, 3.0)), 30) == 17


def test_bins_are_counted_wherever_the_particles_are():
    number = KldNumber()
    assert number.count_bins(cloud(30, 0.03), even(cloud(30, 0.03))) == 1
    apart = np.concatenate([cloud(15, 0.01), cloud(15, 0.01) + np.array([0.6, 0, 0])])
    assert number.count_bins(apart, even(apart)) == 2
    turned = np.concatenate([cloud(15, 0.01), cloud(15, 0.01) + np.array([0, 0, 0.2])])
    turned[:, 2] = np.remainder(turned[:, 2] + np.pi, 2 * np.pi) - np.pi
    assert number.count_bins(turned, even(turned)) == 2


def test_a_bin_of_next_to_no_weight_does_not_count():
    poses = np.concatenate([cloud(29, 0.01), CENTRE[None] + np.array([0.5, 0, 0])])
    weights = np.append(np.full(29, 0.99 / 29), 0.01)
    assert KldNumber().count_bins(poses, even(poses)) == 2
    assert KldNumber().count_bins(poses, np.log(weights)) == 1


def test_more_spread_needs_more_particles():
    numbers = [KldNumber()(cloud(30, spread), even(cloud(30, spread)), 1000) for spread in (0.02, 0.2, 0.5, 2.0)]
    assert numbers == sorted(numbers)
    assert numbers[0] == KldNumber().particles_min
    assert numbers[-1] > 30


def test_no_more_than_asked_for_and_no_less_than_the_least():
    assert KldNumber()(cloud(20, 5.0), even(cloud(20, 5.0)), 30) == 30
    assert KldNumber()(cloud(30, 0.01), even(cloud(30, 0.01)), 30) == 8
    assert KldNumber()(cloud(3, 0.01), even(cloud(3, 0.01)), 3) == 3


def test_a_small_change_is_not_worth_a_resampling():
    number = KldNumber(particles_min=8)
    assert number(cloud(11, 0.01), even(cloud(11, 0.01)), 30) == 11
    assert number(cloud(12, 0.01), even(cloud(12, 0.01)), 30) == 8


@pytest.mark.parametrize("wrong", [{"particles_min": 0}, {"error": 0.6}, {"bin_m": 0.0}, {"bin_rad": 7.0}, {"z": -1.0}])
def test_parameters_out_of_bounds_are_refused(wrong):
    with pytest.raises(ConfigurationError, match=next(iter(wrong))):
        KldNumber(**wrong)
