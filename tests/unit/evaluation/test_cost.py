"""The model of cost: a fit finds its own coefficients, and the committed runs within 30 % of what they cost."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gridslam.evaluation.cost import DEFAULT_COSTS, Cost, Work, fit_costs
from measure import RESULTS


def some_work(count, seed=0):
    rng = np.random.default_rng(seed)
    scans = rng.uniform(100, 30_000, count)
    return [Work(s, s * rng.uniform(0.05, 0.9), int(rng.integers(5, 200)), rng.uniform(100, 20_000)) for s in scans]


@pytest.fixture(scope="module")
def committed():
    """Work and costs of the runs of benchmarks/results/costs.json."""
    runs = json.loads((RESULTS / "costs.json").read_text(encoding="utf-8"))["runs"]
    work = [Work(run["scans"], run["key_scans"], run["particles"], run["area_m2"]) for run in runs]
    costs = [Cost(run["cpu_s"], run["peak_memory_bytes"]) for run in runs]
    return work, costs


def test_a_fit_finds_the_coefficients_of_what_is_linear():
    work = some_work(40)
    costs = [DEFAULT_COSTS.estimate(each) for each in work]
    fitted = fit_costs(work, costs)
    for each in some_work(20, seed=1):
        assert fitted.estimate(each).cpu_s == pytest.approx(DEFAULT_COSTS.estimate(each).cpu_s, rel=1e-6)
        assert fitted.estimate(each).memory_bytes == pytest.approx(DEFAULT_COSTS.estimate(each).memory_bytes, rel=1e-6)


def test_the_defaults_are_those_of_the_committed_runs(committed):
    work, costs = committed
    off = [DEFAULT_COSTS.estimate(each).cpu_s / cost.cpu_s - 1 for each, cost in zip(work, costs, strict=True)]
    assert np.mean(np.abs(off) <= 0.3) >= 0.9
