"""Laws of a batch: each job has exactly one row, and what is done is not done again."""

import shutil
import sqlite3
from collections import Counter

import pytest

from gridslam.batch import child
from gridslam.batch.engine import run_jobs
from gridslam.batch.journal import JOURNAL, read_rows
from gridslam.errors import ArgumentError, InputError, OutputError
from support.batch_jobs import PROGRAM, make_job


@pytest.fixture(autouse=True)
def program(monkeypatch):
    monkeypatch.setattr(child, "PROGRAM", PROGRAM)


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
    assert sorted(row["folder"] for row in read_rows(tmp_path / "out")) == sorted(job.folder for job in jobs)
    again = run(jobs, tmp_path / "out")
    assert [row["resumed"] for row in again] == 5 * [True] + [False]
    assert [row["document"] for row in again] == [row["document"] for row in rows]
    assert Counter(trace.read_text().split()) == {**{f"log{k}": 1 for k in range(5)}, "bad": 2}
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"runs.sqlite", *(f"log{k}" for k in range(5))}


def test_what_is_gone_is_done_again(tmp_path, trace):
    jobs = numbers(3, trace)
    run(jobs, tmp_path)
    shutil.rmtree(tmp_path / "log1")
    rows = run(jobs, tmp_path)
    assert [row["resumed"] for row in rows] == [True, False, True]
    assert Counter(trace.read_text().split()) == {"log0": 1, "log1": 2, "log2": 1}


def test_an_interrupt_ends_the_children_and_what_they_began(tmp_path, trace):
    def interrupt(row):
        raise KeyboardInterrupt

    jobs = [make_job("hang", "a"), *numbers(1, trace), make_job("hang", "b")]
    with pytest.raises(KeyboardInterrupt):
        run(jobs, tmp_path / "out", on_row=interrupt)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"runs.sqlite", "log0"}
    assert [row["folder"] for row in read_rows(tmp_path / "out")] == ["log0"]


def test_one_batch_at_a_time_runs_in_a_folder(tmp_path):
    def start_another(row):
        with pytest.raises(OutputError, match="another batch is running"):
            run([make_job("write_number", "b", number=1)], tmp_path)

    run([make_job("write_number", "a", number=1)], tmp_path, on_row=start_another)


def test_a_journal_of_another_form_is_refused(tmp_path):
    (tmp_path / JOURNAL).write_text("no database, but a text of some length " * 20)
    with pytest.raises(OutputError, match=r"runs.sqlite: cannot be written: file is not a database"):
        run([], tmp_path)
    (tmp_path / JOURNAL).unlink()
    with sqlite3.connect(tmp_path / JOURNAL) as database:
        database.execute("CREATE TABLE runs (a)")
    database.close()
    with pytest.raises(InputError, match="expected a journal of gridslam batch, got: no such column: key"):
        run([], tmp_path)


def test_limits_out_of_range_are_refused(tmp_path):
    with pytest.raises(ArgumentError, match="timeout_s"):
        run([], tmp_path, timeout_s=0)
    with pytest.raises(ArgumentError, match="a folder for each"):
        run([make_job("leave", "a"), make_job("leave", "a", b=1)], tmp_path)
    with pytest.raises(ArgumentError, match="workers"):
        run([], tmp_path, workers=0)
