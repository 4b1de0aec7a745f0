"""The benchmarks run: every piece on a tiny simulated log."""

from __future__ import annotations

import numpy as np
import pytest

import logs
import measure
import run
from gridslam.geometry.se2 import between
from report import Report, Target, table


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder with a log of 40 scans, and its relations, which are the truth between scans."""
    folder = tmp_path_factory.mktemp("data")
    log = logs.simulated("rooms", folder, scans=40)
    log.path.rename(folder / "tiny.clf")
    seconds, poses = log.truth.stamps_ns / 1e9, log.truth.poses
    steps = between(poses[:-10], poses[10:])
    zeros = np.zeros(len(steps))
    rows = [seconds[:-10], seconds[10:], steps[:, 0], steps[:, 1], zeros, zeros, zeros, steps[:, 2]]
    np.savetxt(folder / "tiny.relations", np.column_stack(rows), fmt="%.9f")
    return folder


@pytest.fixture
def quick_yardstick(monkeypatch):
    monkeypatch.setattr(measure, "yardstick_s", lambda: 0.25)


def test_a_command_that_fails_says_why(quick_yardstick, tmp_path):
    with pytest.raises(RuntimeError, match=r"absent\.clf"):
        measure.map_timed(tmp_path / "absent.clf")


def test_one_command_writes_the_report(quick_yardstick, data, tmp_path, capsys):
    out = tmp_path / "reports"
    path = run.main(["--quick", "--data", str(data), "--only", "start", "-o", str(out)])
    text = path.read_text(encoding="utf-8")
    for part in ("commit", "NumPy", "first scan of tiny processed", "gridslam --help", "particles = 30"):
        assert part in text
    assert str(path) in capsys.readouterr().out


def test_tables_and_targets():
    assert table(["a", "b"], [[1, 0.123456], ["x", 12345.6]]).splitlines()[2:] == ["| 1 | 0.1235 |", "| x | 12346 |"]
    report = Report()
    report.targets += [Target("low", 1.0, 2.0, unit="s"), Target("high", 3.0, 2.0, "peer", "other")]
    low, high = report.summary().splitlines()[2:]
    assert low == "| low | 1 s | <= 2 s | yes |  |  |"
    assert high == "| high | 3 | <= 2 | **NO** | peer | other |"
