"""A job in a child process: whatever becomes of it is a row with a name."""

import multiprocessing
import os
import threading
import time

import pytest

from gridslam.batch import child as child_module
from gridslam.batch.child import run_job
from gridslam.batch.journal import COLUMNS
from gridslam.slam.loop_closure.loop_closure import LIBRARIES
from support.batch_jobs import PROGRAM, make_job

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")


@pytest.fixture(autouse=True)
def program(monkeypatch):
    monkeypatch.setattr(child_module, "PROGRAM", PROGRAM)


@pytest.fixture
def run(tmp_path):
    def run(function, *, timeout_s=30.0, **arguments):
        job = make_job(function, "a", **arguments)
        return run_job(job, tmp_path, threading.Event(), timeout_s=timeout_s)

    return run


def is_alive(pid):
    """Whether there is such a process that is no zombie of another's."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(condition, seconds=10.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_job_that_is_done_has_its_document_its_files_and_its_costs(run, tmp_path):
    row = run("write_number", number=3)
    assert (row["status"], row["error"], row["exit_status"]) == ("done", None, 0)
    assert row["document"]["number"] == 3
    assert (row["command"], row["log"], row["folder"]) == ("test", "a.clf", "a")
    assert row["output_tail"] == "a line of output\n"
    assert set(row) == set(COLUMNS)
    assert row["wall_s"] > 0
    assert row["cpu_s"] > 0
    assert 10e6 < row["peak_memory_bytes"] < 1e9
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["number.txt", "square.txt"]


@pytest.mark.skipif("forkserver" not in multiprocessing.get_all_start_methods(), reason="needs fork")
def test_a_child_begins_with_all_that_it_needs_and_its_time_is_its_own(run):
    run("write_number", number=3)  # by then there is the server
    began_s = time.perf_counter()
    document = run("describe_process")["document"]
    assert {*child_module._PRELOADED, *LIBRARIES} <= set(document["modules"])
    assert document["start_s"] >= began_s


@pytest.mark.parametrize(
    ("function", "error", "message"),
    [
        ("reject", "bad input", "broken.clf, line 3: expected a scan"),
        ("fail", "failed", "ValueError: two"),
        ("want_memory", "out of memory", "out of memory"),
        ("leave_out_scans", "out of memory", "2 scans failed: MemoryError"),
        ("segfault", "SIGSEGV", "ended by SIGSEGV"),
        ("kill_itself", "SIGKILL", "ended by SIGKILL"),
        ("leave", "exit", "ended with status 7 and without a result"),
    ],
)
def test_each_end_has_a_name(run, tmp_path, function, error, message):
    row = run(function)
    assert (row["status"], row["error"], row["document"]) == ("failed", error, None)
    assert message in row["message"]
    assert "\n" not in row["message"]
    assert not list(tmp_path.glob("**/half.txt"))
    assert not list(tmp_path.glob(".*.partial"))


def test_a_job_that_hangs_is_killed_with_its_children(run, tmp_path):
    row = run("hang", timeout_s=4.0, pids=str(tmp_path / "pids"))  # on a busy machine it takes two to begin
    assert (row["error"], row["message"]) == ("timeout", "killed after 4 s")
    assert row["output_tail"] == "now it hangs\n"
    child, grandchild, _ = map(int, (tmp_path / "pids").read_text().split())
    wait_until(lambda: not is_alive(child) and not is_alive(grandchild))
    assert not list(tmp_path.glob("**/half.txt"))


def test_a_job_whose_batch_has_ended_is_killed(tmp_path):
    job = make_job("hang", "a", pids=str(tmp_path / "pids"))
    stopped = threading.Event()

    def end_batch():
        wait_until(lambda: (tmp_path / "pids").exists())
        stopped.set()

    thread = threading.Thread(target=end_batch)
    thread.start()
    assert run_job(job, tmp_path, stopped)["status"] == "failed"
    thread.join()
    pids = [*map(int, (tmp_path / "pids").read_text().split()[:2])]
    wait_until(lambda: not any(map(is_alive, pids)))
