"""The test for changes beyond noise: exact where it can be counted, false alarms within the level, and its power."""

import itertools
import json
import math

import numpy as np
import pytest

from gridslam.evaluation.regression import find_changes
from measure import RESULTS

MARGINS = {"error_m": math.log(1.01), "error_rad": math.log(1.01), "cpu_s": math.log(1.1)}
SPREAD = MARGINS.keys()
RUNS = 300
MOST_ALARMS = 24
"""Of 300 runs at 5 %: with that probability more than 24 are alarms in 0.9 % of the cases (binomial)."""


@pytest.fixture(scope="module")
def spread():
    """Logarithms of the figures of ten seeds of each log, as committed."""
    runs = json.loads((RESULTS / "suite.json").read_text(encoding="utf-8"))["runs"]
    logs = {}
    for run in runs:
        if run["variant"] == "default" and "error_m" in run:
            logs.setdefault(run["log"], []).append([math.log(run[name]) for name in SPREAD])
    assert [len(seeds) for seeds in logs.values()] == [10, 10, 10]
    return {log: np.array(seeds) for log, seeds in logs.items()}


def other_seeds(spread, rng):
    """Differences of ten seeds and ten others, both from the real spread: of a log, by figure."""
    drawn = {log: [values[rng.integers(len(values), size=10)] for _ in range(2)] for log, values in spread.items()}
    return {log: dict(zip(SPREAD, (new - old).T, strict=True)) for log, (old, new) in drawn.items()}


def is_alarm(differences, margins=None):
    found = find_changes(differences, np.random.default_rng(0), margins=margins, together="all", permutations=1000)
    return any(change.p_worse <= 0.05 for change in found)


def test_one_figure_has_the_probability_of_all_its_signs():
    values = np.array([0.3, -0.1, 0.2, 0.5, 0.1, 0.4])
    (change,) = find_changes({"log": {"error": values}}, np.random.default_rng(0), permutations=50_000)
    signs = np.array(list(itertools.product([-1, 1], repeat=6)))  # with equal squares t grows with the mean
    exact = (signs @ values >= values.sum() - 1e-9).mean()
    assert change.p_worse == pytest.approx(exact, abs=5 * math.sqrt(exact / 50_000))
    assert change.p_better > 0.9
    assert change.mean == pytest.approx(values.mean())


@pytest.mark.parametrize("margins", [None, MARGINS], ids=["no margin", "margins"])
def test_the_same_with_other_seeds_alarms_in_at_most_one_of_twenty_runs(spread, margins):
    rng = np.random.default_rng(1)
    assert sum(is_alarm(other_seeds(spread, rng), margins) for _ in range(RUNS)) <= MOST_ALARMS


def test_false_alarms_stay_within_the_level_whatever_the_distribution():
    """Twelve figures with Cauchy's tails and spreads that differ by a million."""
    rng = np.random.default_rng(2)
    scales = np.logspace(-3, 3, 12)
    alarms = 0
    for _ in range(RUNS):
        alarms += is_alarm({f"log {k}": {"error": scale * rng.standard_cauchy(10)} for k, scale in enumerate(scales)})
    assert alarms <= MOST_ALARMS


@pytest.mark.parametrize("log", ["intel", "aces"])
@pytest.mark.parametrize("figure", ["error_m", "error_rad"])
def test_ten_percent_more_error_of_one_log_is_found(spread, log, figure):
    """In at least 90 % of the runs; by simulation from the real spread, whose sigma is about 1 %, in all of them."""
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(100):
        differences = other_seeds(spread, rng)
        differences[log][figure] = differences[log][figure] + math.log(1.1)
        found += is_alarm(differences, MARGINS)
    assert found >= 97  # of a true 90 % that many would be found in 0.8 % of the cases


def test_many_logs_of_one_seed_are_tested_together():
    rng = np.random.default_rng(4)
    logs = {f"log {k}": {"error": [0.1 + 0.05 * rng.normal()]} for k in range(20)}
    (change,) = find_changes(logs, rng, together="all")
    assert (change.group, change.pairs) == ("all", 20)
    assert change.p_worse < 0.001
