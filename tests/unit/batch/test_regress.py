"""gridslam regress: two journals beside each other."""

import json
import math

import numpy as np
import pytest

from gridslam.batch.regress import ALL_LOGS, compare_batches
from gridslam.cli.main import main
from gridslam.evaluation.regression import find_changes
from measure import RESULTS
from support.journals import make_document, make_rows, write_journal


def write_suite(out, version=0, errors=1.0, cost=1.0, failing=(), seeds=10):
    """A suite of two logs with the spread of the real ones: errors 1 %, CPU time 5 %; another version, other noise."""
    rng = np.random.default_rng(version)
    rows = []
    for log in ("intel", "aces"):
        for seed in range(seeds):
            folder = f"{log}-default-seed{seed}"
            factor = errors if log == "aces" else 1.0
            document = make_document(rng, seed, 0.03 * factor * float(np.exp(rng.normal(0, 0.01))))
            row = make_rows(1)[0] | {"key": folder, "log": f"/data/{log}.clf", "folder": folder}
            row["cpu_s"] = 10 * cost * float(np.exp(rng.normal(0, 0.05)))
            row["peak_memory_bytes"] = round(1e8 * float(np.exp(rng.normal(0, 0.05))))
            if seed in failing:
                row |= {"status": "failed", "error": "SIGSEGV", "document": None}
            else:
                row["document"] = json.dumps(document)
            rows.append(row)
    write_journal(out, rows)
    return out


@pytest.fixture
def old(tmp_path):
    return write_suite(tmp_path / "old")


def test_the_same_run_is_not_worse(old, capsys):
    assert main(["regress", str(old), str(old)]) == 0
    assert capsys.readouterr().out.startswith("nothing is worse beyond noise (20 pairs")


def test_more_error_of_one_log_is_found_and_named(old, tmp_path, capsys):
    new = write_suite(tmp_path / "new", version=100, errors=1.1)
    assert main(["regress", str(old), str(new), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "gridslam.regression/2"
    worse = {(c["log"], c["figure"]) for c in document["changes"] if c["p_worse"] <= 0.05}
    assert {("aces-default", "error_m"), ("aces-default", "error_rad")} <= worse
    assert not any(log.startswith("intel") or figure.startswith(("cpu", "peak")) for log, figure in worse)
    assert main(["regress", str(new), str(old)]) == 0
    assert "better: aces-default: error -9" in capsys.readouterr().out


def test_more_cpu_time_is_found_beyond_its_margin(old, tmp_path):
    new = write_suite(tmp_path / "new", cost=1.3)
    found = compare_batches(old, new)
    assert {change.figure for change in found.worse} == {"cpu_s"}
    assert found.worse[0].mean == pytest.approx(np.log(1.3))  # the seeds are the same, and so their noise
    assert not compare_batches(old, new, cost_margin=0.5).worse


def test_failures_are_found_and_one_alone_is_only_named(old, tmp_path):
    found = compare_batches(old, write_suite(tmp_path / "new", failing=range(8)))
    assert {change.figure for change in found.worse} == {"failed"}
    one = compare_batches(old, write_suite(tmp_path / "one", failing=[4]))
    assert one.worse == []
    assert "fails now: aces-default-seed4, intel-default-seed4" in one.lines()


def test_runs_without_a_counterpart_are_listed(old, tmp_path):
    found = compare_batches(old, write_suite(tmp_path / "new", seeds=9))
    assert found.pairs == 18
    assert found.unpaired == {"old": ["aces-default-seed9", "intel-default-seed9"], "new": []}


def test_too_few_runs_are_no_gate_that_cannot_fail(old, tmp_path, capsys):
    new = write_suite(tmp_path / "new", seeds=2)
    assert main(["regress", str(old), str(new)]) == 2
    assert "expected at least 5 runs" in capsys.readouterr().err


MARGINS = {"error_m": math.log(1.01), "error_rad": math.log(1.01), "cpu_s": math.log(1.1)}
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
            logs.setdefault(run["log"], []).append([math.log(run[name]) for name in MARGINS])
    assert [len(seeds) for seeds in logs.values()] == [10, 10, 10]
    return {log: np.array(seeds) for log, seeds in logs.items()}


def other_seeds(spread, rng):
    """Differences of ten seeds and ten others, both from the real spread, by log and figure."""
    found = {}
    for log, values in spread.items():
        new, old = (values[rng.integers(len(values), size=10)] for _ in range(2))
        found |= {(log, figure): difference for figure, difference in zip(MARGINS, (new - old).T, strict=True)}
    return found


def is_alarm(differences, margins):
    return any(change.p_worse <= 0.05 for change in find_changes(differences, margins))


@pytest.mark.parametrize("margins", [dict.fromkeys(MARGINS, 0.0), MARGINS], ids=["no margin", "margins"])
def test_the_same_with_other_seeds_alarms_in_at_most_one_of_twenty_runs(spread, margins):
    rng = np.random.default_rng(1)
    assert sum(is_alarm(other_seeds(spread, rng), margins) for _ in range(RUNS)) <= MOST_ALARMS


def test_false_alarms_stay_within_the_level_with_heavy_tails():
    """Twelve figures with Cauchy's tails and spreads that differ by a million."""
    rng = np.random.default_rng(2)
    scales = np.logspace(-3, 3, 12)
    alarms = 0
    for _ in range(RUNS):
        differences = {(f"log {k}", "error_m"): scale * rng.standard_cauchy(10) for k, scale in enumerate(scales)}
        alarms += is_alarm(differences, {"error_m": 0.0})
    assert alarms <= MOST_ALARMS


@pytest.mark.parametrize("log", ["intel", "aces"])
@pytest.mark.parametrize("figure", ["error_m", "error_rad"])
def test_ten_percent_more_error_of_one_log_is_found(spread, log, figure):
    """In at least 90 % of the runs; by simulation from the real spread, whose sigma is about 1 %, in all of them."""
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(100):
        differences = other_seeds(spread, rng)
        differences[log, figure] = differences[log, figure] + math.log(1.1)
        found += is_alarm(differences, MARGINS)
    assert found >= 97  # of a true 90 % that many would be found in 0.8 % of the cases


def test_many_logs_of_one_seed_are_tested_together():
    rng = np.random.default_rng(4)
    differences = {(ALL_LOGS, "error_m"): 0.1 + 0.05 * rng.normal(size=20), ("a", "error_m"): [0.1]}
    (change,) = find_changes(differences, MARGINS)
    assert (change.log, change.pairs) == (ALL_LOGS, 20)
    assert change.p_worse < 0.001
