"""What a batch expects of its jobs before they are run."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gridslam.batch.cost import Estimator, find_work
from gridslam.batch.runs import read_runs
from gridslam.evaluation.cost import DEFAULT_COSTS
from support.journals import make_document, make_rows, write_journal


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


def test_what_has_run_before_is_learned(earlier, tmp_path):
    learned = Estimator.learn(earlier)
    assert learned.scans_per_byte[".clf"] == pytest.approx(1 / 500)
    known = learned.estimate("/data/3.clf", 0, 30)
    assert known.cpu_s == pytest.approx(earlier[3].row["cpu_s"], rel=1e-3)
    new = learned.estimate("/data/new.clf", 500 * 1000, 30)
    assert new.cpu_s > 1.5 * DEFAULT_COSTS.estimate(find_work(earlier[0])).cpu_s / 100
    few = Estimator.learn(earlier[:3])
    assert few.model is DEFAULT_COSTS
