"""Laws of a batch: each job has exactly one row, and what is done is not done again."""

import errno
import os
import shutil
import sqlite3
from collections import Counter
from dataclasses import replace

import pytest

from gridslam.batch.engine import run_jobs
from gridslam.batch.journal import JOURNAL
from gridslam.batch.runs import read_runs
from gridslam.errors import ArgumentError, OutputError
from support.batch_jobs import make_job


def read_rows(out):
    return sorted((run.row for run in read_runs(out)), key=lambda row: row["folder"])


def run(jobs, out, workers=2, **options):
    return run_jobs(jobs, out, workers=workers, **options)


@pytest.fixture
def trace(tmp_path):
    path = tmp_path / "trace"
    path.touch()
    return path


def numbers(count, trace):
    return [make_job("write_number", f"log{k}", number=k, trace=str(trace)) for k in range(count)]


def test_each_job_has_exactly_one_row_and_nothing_runs_twice(tmp_path, trace):
    jobs = [*numbers(5, trace), make_job("reject", "bad", trace=str(trace))]
    seen = []
    rows = run(jobs, tmp_path / "out", on_row=seen.append)
    assert [row["folder"] for row in rows] == [job.folder for job in jobs]
    assert [row["status"] for row in rows] == 5 * ["done"] + ["failed"]
    assert sorted(row["folder"] for row in seen) == sorted(job.folder for job in jobs)
    assert [row["folder"] for row in read_rows(tmp_path / "out")] == sorted(job.folder for job in jobs)
    again = run(jobs, tmp_path / "out")
    assert all(row["resumed"] for row in again)
    assert [row["document"] for row in again] == [row["document"] for row in rows]
    assert set(Counter(trace.read_text().split()).values()) == {1}
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"runs.sqlite", *(f"log{k}" for k in range(5))}


def test_what_was_done_is_known_without_the_journal_and_what_is_gone_is_done_again(tmp_path, trace):
    jobs = numbers(4, trace)
    before = run(jobs, tmp_path)
    (tmp_path / JOURNAL).unlink()
    rows = run(jobs, tmp_path)
    assert [row["document"] for row in rows] == [row["document"] for row in before]
    assert len(read_rows(tmp_path)) == 4
    shutil.rmtree(tmp_path / "log1")
    (tmp_path / "log2" / "run.json").write_text("{")
    rows = run(jobs, tmp_path)
    assert [row["resumed"] for row in rows] == [True, False, False, True]
    assert Counter(trace.read_text().split()) == {"log0": 1, "log1": 2, "log2": 2, "log3": 1}


def test_what_failed_for_the_machines_sake_is_tried_again(tmp_path, trace):
    jobs = [make_job("reject", "a", trace=str(trace)), make_job("leave", "b")]
    run(jobs, tmp_path)
    assert [row["resumed"] for row in run(jobs, tmp_path)] == [True, False]


def test_a_log_that_could_not_be_reached_or_read_is_tried_again(tmp_path):
    closed = make_job("reject", "closed", problem=f"cannot be opened: {os.strerror(errno.EACCES)}")
    remote = replace(make_job("reject", "remote", problem="connection cut"), log="s3://fleet/remote.clf")
    jobs = [make_job("reject", "broken"), closed, remote]
    run(jobs, tmp_path)
    assert [row["resumed"] for row in run(jobs, tmp_path)] == [True, False, False]


def test_a_log_that_kills_the_server_of_children_fails_alone_and_is_tried_again(tmp_path, trace):
    once = make_job("kill_server", "once", times=1, trace=str(trace))
    rows = run([once, *numbers(3, trace)], tmp_path / "out", workers=1)
    assert [row["status"] for row in rows] == ["failed", "done", "done", "done"]
    assert [row["status"] for row in run([once], tmp_path / "out")] == ["done"]


def test_a_full_disk_ends_the_batch_and_loses_nothing(tmp_path, trace):
    jobs = [*numbers(3, trace), make_job("fill_disk", "full"), *numbers(9, trace)[3:]]
    with pytest.raises(OutputError, match=r"No space left on device.*again"):
        run(jobs, tmp_path / "out", workers=1)
    rows = run([job for job in jobs if job.folder != "full"], tmp_path / "out")
    assert sum(row["resumed"] for row in rows) >= 3
    counts = Counter(trace.read_text().split())
    assert {counts[row["folder"]] for row in rows if row["resumed"]} == {1}  # another may have been killed as it began


def test_an_interrupt_ends_the_children_and_what_they_began(tmp_path, trace):
    def interrupt():
        if list(tmp_path.glob("out/.*.partial")):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run([make_job("hang", "a"), make_job("hang", "b")], tmp_path / "out", on_poll=interrupt)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["runs.sqlite"]
    assert read_rows(tmp_path / "out") == []


def test_one_batch_at_a_time_runs_in_a_folder(tmp_path):
    def start_another():
        with pytest.raises(OutputError, match="another batch is running"):
            run([make_job("write_number", "b", number=1)], tmp_path)

    run([make_job("write_number", "a", number=1)], tmp_path, on_poll=start_another)


def test_a_journal_of_another_form_is_refused(tmp_path):
    (tmp_path / JOURNAL).write_text("no database, but a text of some length " * 20)
    with pytest.raises(Exception, match="expected the journal of a batch"):
        run([], tmp_path)
    (tmp_path / JOURNAL).unlink()
    with sqlite3.connect(tmp_path / JOURNAL) as database:
        database.execute("CREATE TABLE runs (a)")
    database.close()
    with pytest.raises(Exception, match="expected a table runs with the columns key, log"):
        run([], tmp_path)


def test_limits_out_of_range_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match="timeout_s"):
        run([], tmp_path, timeout_s=0)
    with pytest.raises(ArgumentError, match="a folder for each"):
        run([make_job("leave", "a"), make_job("leave", "a", b=1)], tmp_path)
    with pytest.raises(ArgumentError, match="workers"):
        run([], tmp_path, workers=0)
