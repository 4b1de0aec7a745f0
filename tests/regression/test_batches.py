"""Batches with faults and kills, small; the long tier has those of full size."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from gridslam.batch.engine import run_jobs
from support.batch_jobs import check_faults, make_job, with_faults, write_logs
from support.batch_kills import kill_and_repeat

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of memory, and /proc")


def test_a_fleet_with_faults_loses_only_the_faulty_logs(tmp_path):
    healthy = [make_job("write_number", f"log{k}", number=k) for k in range(10)]
    jobs = with_faults(healthy, broken=2, hanging=1, greedy=1, crashing=1)
    limits = {"timeout_s": 4.0, "memory_bytes": 2 * 10**9}
    rows = run_jobs(jobs, tmp_path / "out", workers=2, **limits)
    check_faults(rows, tmp_path / "out", broken=2, hanging=1, greedy=1, crashing=1)


def test_a_batch_that_is_killed_three_times_ends_complete(tmp_path):
    write_logs(tmp_path / "logs", 5)
    counts = kill_and_repeat(tmp_path / "logs", tmp_path / "out", 3, np.random.default_rng(3), 2.5)
    assert counts[-1] == 5
