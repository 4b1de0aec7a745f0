"""`gridslam batch`: many logs by one command, what it prints, its exit status and bad input."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time

import pytest

from gridslam.io.trajectories import read_tum

SAME = "map.pgm", "map.yaml", "trajectory.tum", "trajectory.csv", "trajectory_online.tum", "graph.g2o"
FAST = "--", "--particles", "3", "--duration", "8"


@pytest.fixture
def logs(log, tmp_path):
    """Two logs and one that is broken."""
    folder = tmp_path / "logs"
    folder.mkdir()
    shutil.copy(log, folder / "a.clf.bz2")
    shutil.copy(log, folder / "b.clf.bz2")
    (folder / "broken.clf").write_text("FLASER 3 1 2\n")
    return folder


def read_rows(out):
    database = sqlite3.connect(out / "runs.sqlite")
    database.row_factory = sqlite3.Row
    rows = [dict(row) for row in database.execute("SELECT * FROM runs ORDER BY folder")]
    database.close()
    return rows


def test_each_log_is_mapped_as_by_map_and_the_broken_one_is_named(logs, tmp_path, call):
    status, out, err = call("batch", logs, "-o", tmp_path / "out", "--workers", 2, *FAST)
    assert status == 1
    assert "3 logs: 2 done, 1 failed" in out
    assert f"gridslam: {logs / 'broken.clf'}: bad input: {logs / 'broken.clf'}, line 1: " in err
    assert call("map", logs / "a.clf.bz2", "-o", tmp_path / "one", *FAST[1:])[0] == 0
    for name in SAME:
        assert (tmp_path / "out" / "a" / name).read_bytes() == (tmp_path / "one" / name).read_bytes(), name
    one, two = (json.loads((path / "run.json").read_text()) for path in (tmp_path / "one", tmp_path / "out" / "a"))
    # a history, which `map` records, holds tiles that it has yet to save
    assert two["filter"].pop("maps_bytes") <= one["filter"].pop("maps_bytes")
    changing = "time", "latency", "peak_memory_bytes"
    assert {k: v for k, v in one.items() if k not in changing} == {k: v for k, v in two.items() if k not in changing}
    rows = read_rows(tmp_path / "out")
    assert [(row["folder"], row["status"], row["error"]) for row in rows] == [
        ("a", "done", None),
        ("b", "done", None),
        ("broken", "failed", "bad input"),
    ]
    assert json.loads(rows[0]["document"])["schema"] == "gridslam.run/3"

    status, out, err = call("batch", logs, "-o", tmp_path / "out", "--json", *FAST)
    assert status == 1
    printed = [json.loads(line) for line in out.splitlines()]
    assert [(row["folder"], row["resumed"]) for row in printed] == [("a", True), ("b", True), ("broken", False)]
    assert err == ""

    status, out, _ = call("batch", logs / "a.clf.bz2", "-o", tmp_path / "out", *FAST, "--seed", 1)
    assert (status, "1 log: 1 done, in" in out) == (0, True)


def test_a_manifest_has_options_of_its_own(logs, tmp_path, call, log):
    shutil.copy(log.with_name("truth.tum"), tmp_path / "truth.tum")
    manifest = tmp_path / "fleet.csv"
    manifest.write_text(
        "log,name,seed,no-loop-closure,reference\n"
        "logs/a.clf.bz2,first,3,true,truth.tum\n"
        "logs/a.clf.bz2,second,,,\n"
        "logs/absent.clf,,,,\n"
    )
    status, _, err = call("batch", manifest, "-o", tmp_path / "out", "--workers", 1, *FAST)
    assert (status, err.count("\n")) == (1, 1)
    assert "absent.clf: no such file" in err
    first, second = (json.loads((tmp_path / "out" / name / "run.json").read_text()) for name in ("first", "second"))
    assert (first["seed"], first["loop_closure"], second["seed"]) == (3, False, 0)
    assert second["loop_closure"]
    documents = {row["folder"]: json.loads(row["document"] or "{}") for row in read_rows(tmp_path / "out")}
    assert documents["first"]["evaluation"]["ate"]["trans_rmse_m"] < 0.2
    assert "evaluation" not in documents["second"]


def test_doctor_and_localize_run_over_many_logs(logs, tmp_path, call):
    (logs / "broken.clf").unlink()
    (logs / "b.clf.bz2").unlink()
    maps = tmp_path / "maps"
    assert call("batch", logs, "-o", maps, *FAST)[0] == 0
    assert call("batch", logs, "-o", tmp_path / "doctor", "--command", "doctor", *FAST[:1], *FAST[3:])[0] == 0
    report = json.loads((tmp_path / "doctor" / "a" / "report.json").read_text())
    assert json.loads(read_rows(tmp_path / "doctor")[0]["document"]) == report

    arguments = "batch", logs, "-o", tmp_path / "mcl", "--command", "localize", "--"
    arguments = *arguments, "--map", maps / "a" / "map.yaml", "--initial-pose", "0,0,0", "--duration", "5"
    assert call(*arguments)[0] == 0
    assert len(read_tum(tmp_path / "mcl" / "a" / "trajectory.tum")) == 25

    image = maps / "a" / "map.pgm"
    content = image.read_bytes()
    image.write_bytes(content[:-1] + bytes([content[-1] ^ 205]))  # of another map the results are others
    assert "1 log: 1 done, in" in call(*arguments)[1]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["nothing/*.bag"], "nothing/*.bag: nothing matches this pattern"),
        (["empty"], "empty: no logs in this folder"),
        (["columns.csv"], "columns.csv, line 1: unknown column 'sed': expected log, name, reference or an option of "),
        (["short.csv"], "short.csv, line 2: expected 2 cells"),
        (["twice.csv"], "twice.csv, line 3: this log or its name is given twice; a column name in a manifest"),
        (["value.csv"], "value.csv, line 2: Invalid value for '--seed': 'x' is not a valid integer"),
        (["none.csv"], "none.csv: the manifest lists no logs"),
        (["a.clf", "--", "--partcles", "3"], "No such option '--partcles'"),
        (["a.clf", "--", "--set", "particles=0"], "particles: expected a number greater than or equal to 1, got 0"),
        (["a.clf", "--", "--live"], "No such option '--live'"),
        (["a.clf", "--command", "doctor", "--reference", "x"], "doctor has no use for a reference"),
        (["a.clf", "--reference", "{nme}.tum"], "expected a path with {name}, {stem} or {parent}"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(tmp_path, call, monkeypatch, arguments, problem):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    for name, text in {
        "columns": "log,sed\na.clf,1\n",
        "short": "log,seed\na.clf\n",
        "twice": "log,seed\na.clf,1\na.clf,2\n",
        "value": "log,seed\na.clf,x\n",
        "none": "log,seed\n",
    }.items():
        (tmp_path / f"{name}.csv").write_text(text)
    before = sorted(tmp_path.rglob("*"))
    logs, dashes, words = arguments[:1], arguments[1:], []
    if "--" in dashes:
        words = dashes[dashes.index("--") :]
        dashes = dashes[: dashes.index("--")]
    status, out, err = call("batch", *logs, "-o", "out", *dashes, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert problem in err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_log_that_cannot_be_opened_is_a_row_and_the_others_are_mapped(logs, tmp_path, call):
    odd = (
        "x" * 300 + ".clf",
        "http://bad/x.clf",
        "o\udcff.csv",
        "a\nb",
    )
    status, out, err = call("batch", logs / "a.clf.bz2", *odd, "-o", tmp_path / "out", "--workers", 2, *FAST)
    assert status == 1
    assert "5 logs: 1 done, 4 failed" in out
    assert len([line for line in err.splitlines() if "% " not in line]) == 4  # beside the progress of a slow machine
    failed = [row for row in read_rows(tmp_path / "out") if row["status"] == "failed"]
    assert [bool(row["message"]) for row in failed] == [True] * 4


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="the system does not say which processors there are")
def test_by_default_a_machine_of_many_processors_runs_as_many_logs_as_may_be(log, tmp_path, call, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(400))
    status, _, err = call("batch", log, "-o", tmp_path / "out", "--command", "doctor")
    assert status == 0, err


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")
def test_an_interrupt_ends_a_batch_cleanly_and_it_goes_on_later(logs, tmp_path):
    (logs / "broken.clf").unlink()
    out = tmp_path / "out"
    command = [sys.executable, "-m", "gridslam", "batch", str(logs), "-o", str(out), "--workers", "1", *FAST]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as run:
        while not list(out.glob(".*.partial")):
            assert run.poll() is None, run.communicate()
            time.sleep(0.01)
        os.killpg(run.pid, signal.SIGINT)  # as Ctrl-C does
        problem = run.communicate(timeout=60)[1]
    assert (run.returncode, problem.splitlines()[-1]) == (130, "gridslam: interrupted")
    assert "Traceback" not in problem
    done = {row["folder"] for row in read_rows(out)}
    assert {path.name for path in out.iterdir()} == {"runs.sqlite", *done}
    subprocess.run(command, check=True, capture_output=True)
    assert [row["folder"] for row in read_rows(out)] == ["a", "b"]
