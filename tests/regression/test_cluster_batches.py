"""Batches on a Dask cluster of processes of this machine; the long tier has one of full size."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gridslam.batch.engine import run_jobs
from gridslam.batch.pool import ProcessPool
from gridslam.errors import InputError, MissingDependencyError
from support.batch_jobs import check_same_results, make_job, map_job, write_logs

pytest.importorskip("distributed")

from gridslam.batch.cluster import DaskCluster
from support.dask_cluster import DaskCluster as LocalCluster

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")


def test_a_cluster_that_loses_workers_gives_the_same_results_as_this_machine(tmp_path):
    logs = write_logs(tmp_path / "logs", 5)
    jobs = [map_job(log, log.stem) for log in logs]
    trace = tmp_path / "trace"
    killer = make_job("kill_cluster_worker", "killer", trace=str(trace))
    with LocalCluster(tmp_path, 3) as local:
        cluster = DaskCluster(str(local.file))
        assert cluster.dashboard.startswith("http://127.0.0.1:")
        rows = run_jobs([jobs[0], killer, *jobs[1:]], tmp_path / "one", executor=cluster, retries=1)
        assert sum(worker.poll() is not None for worker in local.workers) == 2
        hanging = make_job("hang", "hanging", pids=str(tmp_path / "pids"))

        def interrupt():
            if (tmp_path / "pids").exists():
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            run_jobs([hanging], tmp_path / "three", executor=DaskCluster(local.address), on_poll=interrupt)
        assert [path.name for path in (tmp_path / "three").iterdir()] == ["runs.sqlite"]
        assert not any(Path(f"/proc/{pid}").exists() for pid in (tmp_path / "pids").read_text().split()[:1])
    assert [row["status"] for row in rows] == ["done", "failed", *4 * ["done"]]
    assert (rows[1]["error"], rows[1]["attempts"]) == ("lost worker", 2)
    assert all(row["attempts"] <= 2 for row in rows)
    assert trace.read_text().split() == ["killer", "killer"]
    assert {path.name for path in (tmp_path / "one").iterdir()} == {"runs.sqlite", *(log.stem for log in logs)}
    run_jobs(jobs, tmp_path / "two", executor=ProcessPool(1))
    check_same_results(tmp_path / "one", tmp_path / "two", [log.stem for log in logs])


def test_a_scheduler_that_does_not_answer_is_one_line_within_seconds(tmp_path):
    (tmp_path / "a.clf").touch()
    with socket.socket() as silent:  # it accepts, and answers nothing
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"127.0.0.1:{silent.getsockname()[1]}"
        arguments = "batch", tmp_path, "-o", tmp_path / "out", "--scheduler", address
        command = [sys.executable, "-m", "gridslam.cli.main", *map(str, arguments)]
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True)
        assert time.monotonic() - began < 30  # 5 s, and what the start of Python takes on a busy machine
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr == f"gridslam: --scheduler {address}: no Dask scheduler answers within 5 s\n"
    assert not (tmp_path / "out").exists()


def test_a_file_that_names_no_cluster_is_refused(tmp_path):
    (tmp_path / "a.json").write_text("{}")
    with pytest.raises(InputError, match=r"a\.json: expected a scheduler's file, with an address"):
        DaskCluster(str(tmp_path / "a.json"))


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'gridslam\[cluster\]'"):
        DaskCluster("tcp://127.0.0.1:1")
