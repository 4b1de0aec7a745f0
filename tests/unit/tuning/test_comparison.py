"""What is within the noise is not recommended, and what is beyond it is."""

import math

import numpy as np
import pytest

from gridslam.tuning.comparison import Pair, compare


def _pairs(rng, gain, logs, seeds, log_deviation=0.0, seed_deviation=0.1):
    """Logs differ in how hard they are and in what they gain; seeds are noise on top."""
    return [
        Pair(f"log{k}", seed, hard + seed_deviation * one, hard + gain + of_log + seed_deviation * other)
        for k, (hard, of_log) in enumerate(zip(rng.normal(0, 2, logs), rng.normal(0, log_deviation, logs), strict=True))
        for seed, (one, other) in enumerate(rng.standard_normal((seeds, 2)))
    ]


@pytest.mark.parametrize(("logs", "seeds"), [(1, 5), (3, 5), (6, 3), (12, 2)])
def test_without_a_gain_hardly_ever_one_is_claimed(logs, seeds):
    """The upper limit of a 95 % interval is below 1 in 2.5 % of such comparisons: more than 5 % of 200, 10, have a
    probability of 1 % for each case; the seeds are fixed."""
    claimed = sum(
        compare(_pairs(np.random.default_rng(seed), 0.0, logs, seeds, 0.2 if logs >= 4 else 0.0)).gains
        for seed in range(200)
    )
    assert claimed <= 10


@pytest.mark.parametrize(("logs", "seeds"), [(1, 5), (6, 3)])
def test_a_real_gain_is_found(logs, seeds):
    """20 % with seeds that differ by 5 %: three standard errors and more."""
    found = [
        compare(_pairs(np.random.default_rng(seed), math.log(0.8), logs, seeds, 0.02, 0.05)) for seed in range(100)
    ]
    assert sum(one.gains for one in found) >= 95
    assert np.median([one.ratio for one in found]) == pytest.approx(0.8, rel=0.02)
    assert np.median([one.seed_noise for one in found]) == pytest.approx(math.exp(0.05), rel=0.02)


def test_many_logs_count_as_logs():
    """One that gains much in all of its seeds is one observation, and proves nothing about others."""
    rng = np.random.default_rng(0)
    pairs = [Pair("a", seed, 0.0, -1.0) for seed in range(50)]
    others = [Pair(name, 0, 0.0, float(rng.normal(0, 0.1))) for name in "bcde"]
    found = compare(pairs + others)
    assert (found.units, found.observations) == ("logs", 5)
    assert not found.gains
    assert compare(pairs[:5]).units == "runs"


def test_failures_count_and_forbid():
    good = [Pair("a", seed, 0.0, -1.0 - 0.01 * seed) for seed in range(5)]
    assert compare(good).gains
    failed = compare([*good, Pair("a", 5, 0.0, math.inf)])
    assert failed.failed == 1
    assert not failed.gains
    rescued = compare([Pair("a", seed, math.inf, 0.01 * seed) for seed in range(5)])
    assert rescued.gains
    assert rescued.ratio == pytest.approx(0.1)
