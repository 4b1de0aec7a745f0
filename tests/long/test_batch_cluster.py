"""Batches on Dask clusters of full size: four workers, two of which are killed at random moments."""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
import pytest

from gridslam.batch.engine import run_jobs
from gridslam.batch.pool import ProcessPool
from support.batch_jobs import check_same_results, map_job, write_logs

pytest.importorskip("distributed")

from gridslam.batch.cluster import DaskCluster
from support.dask_cluster import DaskCluster as LocalCluster

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="kills processes")


@pytest.mark.parametrize("seed", range(3))
def test_every_log_has_its_row_where_two_of_four_workers_are_killed(tmp_path, seed, record_property):
    rng = np.random.default_rng(seed)
    logs = write_logs(tmp_path / "logs", 24)
    jobs = [map_job(log, log.stem) for log in logs]
    with LocalCluster(tmp_path, 4) as local:
        begun = threading.Event()
        killed_s = []

        def kill():
            begun.wait()
            began = time.monotonic()
            for number in rng.permutation(4)[:2]:
                time.sleep(rng.uniform(0, 3))
                local.kill_worker(number)
                killed_s.append(round(time.monotonic() - began, 2))

        thread = threading.Thread(target=kill)
        thread.start()
        cluster = DaskCluster(local.address)
        rows = run_jobs(jobs, tmp_path / "one", executor=cluster, retries=2, on_row=lambda row: begun.set())
        thread.join()
    attempts = [row["attempts"] for row in rows]
    record_property("killed after s", killed_s)
    record_property("attempts", sum(attempts))
    assert [row["status"] for row in rows] == 24 * ["done"]
    assert max(attempts) <= 3
    run_jobs(jobs, tmp_path / "two", executor=ProcessPool(2))
    check_same_results(tmp_path / "one", tmp_path / "two", [job.folder for job in jobs])
