"""Checks of exercise 2: sensor models."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from feedback import expect
from numpy.typing import NDArray

from gridslam.models import BeamRangeFinder, LikelihoodField

FloatArray = NDArray[np.float64]


def beam_densities_sum_to_one(
    likelihoods: Callable[[BeamRangeFinder, FloatArray, FloatArray], FloatArray], expected: float, sigma: float
) -> None:
    """For a range expected in m and sigma_hit: the density below range_max and the probability of no return.

    The midpoint rule errs by half a step times the jumps of the density, that of the short readings at the expected
    range (at most 0.2 / 0.05 per metre) and that at the range 0 (none); gridslam's table of the normal by 2e-7.
    """
    model = BeamRangeFinder(z_hit=0.6, z_short=0.2, z_max=0.1, z_rand=0.1, sigma_hit_m=sigma, range_max_m=10.0)
    step = 10.0 / 100_000
    ranges = (np.arange(100_000) + 0.5) * step
    total = likelihoods(model, ranges, np.full(100_000, expected)).sum() * step
    total += likelihoods(model, np.array([10.0]), np.array([expected]))[0]
    assert abs(total - 1) < step / 2 * (0.2 / 0.05) + 1e-5, f"expected range {expected:.3g} m: the sum is {total:.6f}"


def _beam(model: BeamRangeFinder, ranges: FloatArray, expected: FloatArray, **other: bool) -> FloatArray:
    """Evaluate Table 6.1; `other` switches a part off or to a typical mistake."""
    sigma, rate, farthest = model.sigma_hit_m, model.lambda_short_per_m, model.range_max_m
    cumulative = np.vectorize(lambda x: 0.5 * math.erfc(-x / math.sqrt(2)))
    seen = np.ones_like(expected) if other.get("unnormalized_hit") else cumulative(expected / sigma)
    width = sigma**2 if other.get("squared") else sigma
    density = np.exp(-0.5 * ((ranges - expected) / sigma) ** 2) / (math.sqrt(math.tau) * width * seen)
    short = rate * np.exp(-rate * ranges)
    if not other.get("unnormalized_short"):
        short = short / -np.expm1(-rate * (expected if other.get("endless") else np.minimum(expected, farthest)))
    if not other.get("behind"):
        short = np.where(ranges <= expected, short, 0.0)
    uniform = model.z_rand / (1.0 if other.get("unscaled") else farthest)
    beyond = model.z_max + model.z_hit * cumulative((expected - farthest) / sigma) / seen
    if other.get("no_tail"):
        beyond = np.full_like(expected, model.z_max)
    mixed = model.z_hit * density + model.z_short * short + uniform
    if other.get("no_maximum"):
        return mixed
    value = np.where(ranges < farthest, mixed, beyond)
    return np.log(value) if other.get("logarithm") else value


_BEAM_MISTAKES = {
    "unnormalized_hit": "a range cannot be below 0: divide the normal density by the probability of a range above 0",
    "squared": "the normal density is divided by sigma, not by sigma squared",
    "unnormalized_short": "the density of short readings ends at the wall: divide by 1 - exp(-lambda z*)",
    "endless": "short readings end at range_max_m where the wall is farther away",
    "behind": "short readings are in front of the wall: none behind it",
    "unscaled": "random readings are uniform in [0, range_max_m): divide z_rand by range_max_m",
    "no_tail": "a hit beyond range_max_m is read as no return: add its probability to z_max",
    "no_maximum": "a reading at range_max_m or above has a probability, not a density",
    "logarithm": "expected densities, got their logarithms",
}


def beam_model(likelihoods: Callable[[BeamRangeFinder, FloatArray, FloatArray], FloatArray]) -> None:
    """Table 6.1, `likelihoods(model, ranges, expected)`: sums of 1, and densities by hand.

    At the expected range of 5 m: N(0) = 3.989423 per metre, and the exponential's e^-5 / (1 - e^-5) = 0.006783655. Two
    standard deviations behind the wall nothing is short any more.
    """
    parts = {"z_hit": 0.6, "z_short": 0.2, "z_max": 0.1, "z_rand": 0.1, "lambda_short_per_m": 0.2}
    wide = BeamRangeFinder(**parts, sigma_hit_m=0.5, range_max_m=10.0)
    z = np.array([0.1, 0.3, 0.9, 2.0, 2.5, 9.5, 10.0, 4.0, 11.0, 4.0])
    expected = np.array([0.3, 0.3, 0.3, 2.0, 2.0, 9.9, 9.9, math.inf, 12.0, 12.0])
    wrong = {sentence: _beam(wide, z, expected, **{name: True}) for name, sentence in _BEAM_MISTAKES.items()}
    expect("beam model", likelihoods(wide, z, expected), _beam(wide, z, expected), 1e-6, wrong)
    model = BeamRangeFinder(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit_m=0.1, range_max_m=30.0)
    got = likelihoods(model, np.array([5.0, 5.2, 40.0]), np.full(3, 5.0))
    by_hand = [0.8 * 3.989423 + 0.1 * 0.006783655 + 0.05 / 30, 0.8 * 0.5399097 + 0.05 / 30, 0.05]
    np.testing.assert_allclose(got, by_hand, rtol=1e-6)
    for wall in (0.05, 0.3, 2.0, 9.9, 10.0, 12.0, math.inf):
        for sigma in (0.02, 0.1, 0.5):
            beam_densities_sum_to_one(likelihoods, wall, sigma)


def likelihood_field(log_likelihoods: Callable[[LikelihoodField, FloatArray], FloatArray]) -> None:
    """Table 6.3, `log_likelihoods(model, distances)`: values in closed form; gridslam's are float32, hence 1e-5."""
    model = LikelihoodField(z_hit=0.7, z_rand=0.2, z_max=0.1, sigma_hit_m=0.1, range_max_m=20)
    d = np.array([0.0, 0.05, 0.1, 0.3, 0.7])
    bell = np.exp(-0.5 * (d / 0.1) ** 2)
    peak, uniform = 0.7 / (math.sqrt(math.tau) * 0.1), 0.2 / 20
    wanted = np.log(peak * bell + uniform)
    with np.errstate(divide="ignore"):
        wrong = {
            "the exponent is -d^2 / (2 sigma^2): a factor of 1/2 is missing": np.log(peak * bell**2 + uniform),
            "the exponent has the square of d / sigma": np.log(peak * np.exp(-0.5 * d / 0.1) + uniform),
            "the normal density is divided by sqrt(2 pi) sigma": np.log(0.7 * bell + uniform),
            "the normal density is divided by sqrt(2 pi) sigma ": np.log(0.7 / math.sqrt(math.tau) * bell + uniform),
            "random readings are uniform: add z_rand / range_max_m": np.log(peak * bell),
            "divide z_rand by range_max_m": np.log(peak * bell + 0.2),
            "expected log likelihoods, got likelihoods": peak * bell + uniform,
            "z_hit weighs the normal density": np.log(peak / 0.7 * bell + uniform),
            "z_max is no part of the field: readings at the maximum are left out": np.log(peak * bell + uniform + 0.1),
            "the logarithm is the natural one": wanted / math.log(10),
        }
    tolerance = 1e-5 * np.abs(wanted)
    expect("likelihood field", log_likelihoods(model, d.astype(np.float32)), wanted, tolerance, wrong)
