"""Batches of full size: 100 logs with faults, and 20 kills."""

import numpy as np

from gridslam.batch.engine import run_jobs
from support.batch_jobs import check_faults, map_job, with_faults, write_logs
from support.batch_kills import kill_and_repeat


def test_of_100_logs_with_17_faults_83_are_mapped(tmp_path):
    logs = write_logs(tmp_path / "logs", 83)
    jobs = with_faults([map_job(log, log.stem) for log in logs], broken=10, hanging=3, greedy=3, crashing=1)
    rows = run_jobs(jobs, tmp_path / "out", workers=2, timeout_s=15.0)
    assert len(rows) == 100
    assert sum(row["status"] == "done" for row in rows) == 83
    check_faults(rows, tmp_path / "out", broken=10, hanging=3, greedy=3, crashing=1)


def test_a_batch_that_is_killed_20_times_ends_complete(tmp_path, record_property):
    write_logs(tmp_path / "logs", 60)
    counts = kill_and_repeat(tmp_path / "logs", tmp_path / "out", 20, np.random.default_rng(20), 6.0)
    record_property("done at each kill", counts)
    assert counts[-1] == 60
    assert len(set(counts)) > 3  # kills came between jobs that were done, on a busy machine, too
