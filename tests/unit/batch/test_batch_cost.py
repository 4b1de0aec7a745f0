"""What a batch expects of its jobs before they are run."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gridslam.batch.cost import Estimator, estimate, find_work, limit_memory
from gridslam.batch.job import Job
from gridslam.batch.runs import read_runs
from gridslam.evaluation.cost import DEFAULT_COSTS, Cost
from support.journals import make_document, make_rows, write_journal


def job(path, particles=30, command="map"):
    size = path.stat().st_size if path.exists() else None
    arguments = {"log": str(path), "bytes": size, "configuration": {"particles": particles}}
    return Job("a:b", arguments, str(path), path.name.replace(".", "_"), "0" * 64, command)


def write_logs(folder, sizes):
    for k, size in enumerate(sizes):
        (folder / f"{k}.clf").write_bytes(b"x" * size)
    return [job(folder / f"{k}.clf") for k in range(len(sizes))]


@pytest.fixture
def earlier(tmp_path):
    """Runs whose logs have 500 bytes a scan, on a machine that is twice as slow as the defaults."""
    rows = []
    for k, row in enumerate(make_rows(12)):
        document = make_document(np.random.default_rng(k))
        document["input"]["bytes"] = 500 * document["scans"]["read"]
        log = f"/data/{k}.clf"
        rows.append(row | {"log": log, "document": json.dumps(document)})
    write_journal(tmp_path / "old", rows)
    runs = list(read_runs(tmp_path / "old"))
    for run in runs:
        cost = DEFAULT_COSTS.estimate(find_work(run))
        run.row.update(cpu_s=2 * cost.cpu_s, peak_memory_bytes=round(cost.memory_bytes))
    return runs


def test_larger_logs_and_more_particles_are_expected_to_take_longer(tmp_path):
    jobs = write_logs(tmp_path, [10_000, 1_000_000, 100_000])
    seconds = [cost.cpu_s for cost in estimate(jobs, [])]
    assert sorted(seconds) == [seconds[0], seconds[2], seconds[1]]
    assert estimate([job(tmp_path / "1.clf", 300)], [])[0].cpu_s > seconds[1]
    assert estimate([job(tmp_path / "1.clf", command="doctor")], [])[0].cpu_s < seconds[1]


def test_a_log_that_is_not_there_is_as_large_as_the_others(tmp_path):
    costs = estimate([*write_logs(tmp_path, [50_000, 50_000]), job(tmp_path / "absent.clf")], [])
    assert costs[2] == costs[0]
    assert estimate([job(tmp_path / "absent.clf")], [])[0].cpu_s > 0


def test_what_has_run_before_is_learned(earlier, tmp_path):
    learned = Estimator.learn(earlier)
    assert learned.scans_per_byte[".clf"] == pytest.approx(1 / 500)
    known = learned.estimate("/data/3.clf", 0, 30)
    assert known.cpu_s == pytest.approx(earlier[3].row["cpu_s"], rel=1e-3)
    new = learned.estimate("/data/new.clf", 500 * 1000, 30)
    assert new.cpu_s > 1.5 * DEFAULT_COSTS.estimate(find_work(earlier[0])).cpu_s / 100
    few = Estimator.learn(earlier[:3])
    assert few.model is DEFAULT_COSTS


def test_limits_of_memory_are_generous():
    assert limit_memory(Cost(1.0, 1e8)) == 2_000_000_000
    assert limit_memory(Cost(1.0, 1e9)) == 4_000_000_000
