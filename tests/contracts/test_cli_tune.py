"""gridslam tune: what it writes, that it goes on where it was, and what it refuses."""

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from gridslam.cli import tune as tune_module
from gridslam.cli.main import main
from gridslam.config import Configuration, load, override
from gridslam.geometry.se2 import between
from gridslam.io.trajectories import read_trajectory

PAGE = (Path(__file__).parents[2] / "docs" / "tuning.md").read_text(encoding="utf-8")
SHOWN = PAGE[PAGE.index("$ gridslam simulate rooms -o one.clf") :].partition("```")[0]
START = override(Configuration(), "particles=3")
FEW = "--particles", "2", "--trials", "3", "--judging-seeds", "2", "--no-loop-closure"


@pytest.fixture(scope="module")
def shown():
    """The commands of the page: two logs are simulated, a search, and a map by its configuration."""
    simulated, other, tuned, mapped = (shlex.split(line) for line in re.findall(r"^\$ gridslam (.*)$", SHOWN, re.M))
    return [simulated, other], tuned, mapped


@pytest.fixture(scope="module")
def logs(shown, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in shown[0]:
            assert main(command) == 0
    return folder


def test_it_writes_a_configuration_and_a_document(shown, logs, tmp_path, monkeypatch, capsys):
    """And an interrupted search goes on to the same bytes and does nothing twice.

    An interrupt leaves the rows and folders of what was done; here two trials are not yet.
    """
    _, arguments, mapped = shown
    monkeypatch.chdir(tmp_path)
    for log in logs.iterdir():
        shutil.copy(log, tmp_path)
    capsys.readouterr()
    assert main(arguments) == 0
    told = capsys.readouterr().out
    assert [line for line in SHOWN.splitlines() if not line.startswith(("$", "..."))] == [
        line for line in told.splitlines() if line.startswith(("tried", "best.toml"))
    ]
    shutil.copy("one.clf", mapped[1])
    assert main(mapped) == 0
    out = tmp_path / "best.toml"
    folder = out.with_suffix(".tune")
    document = json.loads((folder / "tune.json").read_text())
    assert document["schema"] == "gridslam.tuning/4"
    assert [log["held_out"] for log in document["logs"]] == [False, True]
    assert document["logs"][0]["reference"] == str(tmp_path / "one.truth.tum")
    assert len(document["trials"]) == 3
    assert document["start"]["particles"] == 3
    configuration = load(out)
    assert configuration.particles == 3
    assert document["recommended"] is (configuration != START)
    if document["comparison"]:
        assert document["comparison"]["observations"] == 2
        assert {pair["log"] for pair in document["pairs"]} == {"other"}
    assert (folder / "runs.sqlite").is_file()

    before = out.read_bytes(), (folder / "tune.json").read_bytes()
    out.unlink()
    (folder / "tune.json").unlink()
    for removed in sorted(folder.glob("one-*"))[:2]:
        shutil.rmtree(removed)
    rows = []
    original = tune_module.run_jobs

    def interrupted(jobs, *rest, **options):
        rows.extend(original(jobs, *rest, **options))
        raise KeyboardInterrupt

    def recorded(jobs, *rest, **options):
        found = original(jobs, *rest, **options)
        rows.extend(found)
        return found

    monkeypatch.setattr(tune_module, "run_jobs", interrupted)
    assert main(arguments) == 130
    assert not out.exists()
    monkeypatch.setattr(tune_module, "run_jobs", recorded)
    assert main(arguments) == 0
    assert (out.read_bytes(), (folder / "tune.json").read_bytes()) == before
    assert sum(not row["resumed"] for row in rows) == 2


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["none*.clf"], "nothing matches this pattern"),
        (["none.clf"], "none.clf: no such file"),
        (["LOG", "--tune", "particles"], "particles: cannot be tuned; expected one of resolution_m"),
        (["LOG", "--held-out", "LOG"], "given twice"),
        (["LOG", "--set", "noise_m=-1"], "motion.sigma_xy_m"),
        (["LOG", "-o", "best.tune"], "best.tune: expected the name of a file to write"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(logs, tmp_path, capsys, words, expected):
    out = tmp_path / "best.toml"
    named = [str(logs / "one.clf") if word == "LOG" else word for word in words]
    assert main(["tune", "-o", str(out), *named, "--particles", "2"]) == 2
    error = capsys.readouterr().err
    assert re.search(re.escape(expected), error), error
    assert "small" in expected or list(tmp_path.iterdir()) == []


def test_relations_count_within_the_time_that_is_read(tmp_path, capsys):
    """Of the second one the truth is 1 m off: it counts only where the log is read to its time."""
    log = tmp_path / "log.clf"
    assert main(["simulate", "rooms", "-o", str(log), "--seed", "1", "--duration", "8", "--beams", "60"]) == 0
    truth = read_trajectory(tmp_path / "log.truth.tum")
    begin, middle, end = np.searchsorted(truth.stamps_ns, truth.stamps_ns[0] + np.array([0, 3, 7]) * 1_000_000_000)
    lines = []
    for to, off_m in ((middle, 0.0), (end, 1.0)):
        x, y, theta = between(truth.poses[begin], truth.poses[to])
        times = f"{truth.stamps_ns[begin] / 1e9:.9f} {truth.stamps_ns[to] / 1e9:.9f}"
        lines.append(f"{times} {x + off_m} {y} 0 0 0 {theta}\n")
    (tmp_path / "log.relations").write_text("".join(lines))
    relations = str(log.with_suffix(".relations"))
    for duration, least, most in (("5", 0.0, 0.2), ("8", 0.4, 0.7)):
        words = "--particles", "2", "--no-loop-closure", "--repair", "none", "--duration", duration
        assert main(["map", str(log), "-o", str(tmp_path / "out"), *words]) == 0
        capsys.readouterr()
        assert main(["evaluate", str(tmp_path / "out" / "trajectory.tum"), relations, "--part", "--json"]) == 0
        assert least < json.loads(capsys.readouterr().out)["relations"]["trans_mean_m"] < most
    assert main(["tune", str(log), "-o", str(tmp_path / "best.toml"), *FEW, "--duration", "2"]) == 2
    assert "expected a relation within the time that was mapped, got none" in capsys.readouterr().err


def test_a_log_is_no_reference(logs, tmp_path, capsys):
    out = tmp_path / "best.toml"
    other = str(logs / "other.clf")
    assert main(["tune", str(logs / "one.clf"), "-o", str(out), "--reference", other, *FEW]) == 2
    error = capsys.readouterr().err
    assert f"{other}: expected a trajectory or relations, got a log\n" in error
    assert error.count("\n") == 1


def test_a_place_that_cannot_be_written_is_bad_usage(logs, tmp_path, capsys):
    (tmp_path / "best.tune").touch()
    assert main(["tune", str(logs / "one.clf"), "-o", str(tmp_path / "best.toml"), *FEW]) == 2
    place = tmp_path / "best.tune" / "runs.sqlite"
    assert capsys.readouterr().err == f"gridslam: {place}: cannot be written: File exists\n"


def test_without_the_library_the_extra_is_named_before_anything_runs(logs, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert main(["tune", str(logs / "one.clf"), "-o", str(tmp_path / "best.toml")]) == 1
    assert "pip install 'gridslam[tune]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
