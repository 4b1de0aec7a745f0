"""The benchmarks of the score and of the search: what they draw, and what they compare."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import samplers
import self_consistency
import tuning
from gridslam.config import Configuration, override
from gridslam.evaluation.trajectory import relation_errors
from gridslam.io.carmen.reader import CarmenLog
from gridslam.types import Trajectory

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


def test_configurations_are_valid_and_the_first_is_the_default():
    drawn = self_consistency.draw_configurations()
    assert len(drawn) == 30
    assert drawn[0] == []
    assert len({override(Configuration(), *one) for one in drawn}) == 30


def test_relations_of_a_path_are_true_of_it():
    rng = np.random.default_rng(0)
    path = Trajectory(np.arange(200) * 10**8, np.column_stack([rng.uniform(0, 4, (200, 2)), rng.uniform(-3, 3, 200)]))
    relations = self_consistency.draw_relations(path)
    assert len(relations.from_ns) == 3000
    assert relation_errors(path, relations).trans_max_m < 1e-9


def test_rank_correlation_has_its_interval():
    errors = np.arange(30.0)
    assert self_consistency.rank_correlation(np.exp(errors), errors) == pytest.approx((1.0, 1.0, 1.0))
    found, low, high = self_consistency.rank_correlation(errors + np.random.default_rng(0).normal(0, 8, 30), errors)
    assert low < found < high < 1


def test_the_search_beats_its_start_on_the_toy():
    pairs = [(samplers.search(seed, 60)[0], samplers.toy(seed)[0](np.full(12, 0.5))) for seed in range(5)]
    assert np.median([found for found, _ in pairs]) < 0.7 * np.median([start for _, start in pairs])


def test_simulated_logs_have_their_truth_beside_them(tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "_SCANS", 20)
    (path,) = tuning.simulate_logs(tuning.LIDARS["60 degrees"], [1], tmp_path)
    assert path.with_name("world1.truth.tum").is_file()
    assert sum(1 for _ in CarmenLog(path)) == 20


@pytest.mark.parametrize("log", ["intel", "aces", "freiburg-every2", *(f"world{seed}" for seed in range(1, 7))])
def test_the_committed_rank_correlation_is_at_least_0_7(log):
    found = json.loads((RESULTS / "self_consistency.json").read_text())["logs"][log]["spearman"]["self-consistency"]
    assert found["relations_m"][0] >= 0.7
