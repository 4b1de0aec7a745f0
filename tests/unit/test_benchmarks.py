"""The benchmarks run: every piece on a tiny simulated log."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import accuracy
import kernels
import landmarks
import logs
import measure
import run
import scaling
from gridslam.geometry.se2 import between
from gridslam.grid import tiles
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


def test_cost_of_a_process():
    """A process that burns 0.3 s of CPU is charged for it and its start, and not for its sleep."""
    burn = "import time\ntime.sleep(0.3)\nwhile time.process_time() < 0.3: pass"
    cost = measure.timed([sys.executable, "-c", burn])
    assert cost.wall_s > 0.6
    assert 0.3 <= cost.cpu_s < cost.wall_s
    assert cost.yardsticks == pytest.approx(cost.cpu_s / cost.yardstick_s)
    assert cost.yardstick_s > 0.01


def test_a_command_that_fails_says_why(quick_yardstick, tmp_path):
    with pytest.raises(RuntimeError, match=r"absent\.clf"):
        measure.map_timed(tmp_path / "absent.clf")


def test_accuracy_of_a_log_with_relations_and_of_one_without(quick_yardstick, data, tmp_path):
    (log,) = logs.find(data)
    report = Report()
    accuracy.accuracy([log, logs.Log("bare", log.path)], (0, 1), report, tmp_path / "pictures")
    named = {target.name: target.value for target in report.targets}
    assert 0 < named["tiny: worst single relation"] < 0.2
    assert named["tiny: share of relations without a pose of their own"] == 0
    assert named["bare: scans without a pose"] == 0
    assert sorted(path.name for path in (tmp_path / "pictures").iterdir()) == ["bare-0.png", "bare-1.png"]
    assert len(report.sections) == 2
    assert "| 40 |" in report.sections[1]


def test_scaling(quick_yardstick, data, tmp_path):
    (log,) = logs.find(data)
    report = Report()
    scaling.particles(logs.first_scans(log, 12, tmp_path), (2, 4), report)
    scaling.threads(log, (1, 2), report, count=5)
    scaling.beams((90,), tmp_path, report, scans=20)
    scaling.map_size((14.0, 15.0), tmp_path, report)
    assert [section.partition(":")[0] for section in report.sections] == [
        "## Particles",
        "## Threads",
        "## Beams",
        report.sections[3].partition(":")[0],
    ]
    assert "**NO**" not in report.sections[1]
    assert report.targets[0].name == "cost of a scan, 15 m over 14 m map"
    assert report.targets[0].value > 0


def test_one_command_writes_the_report(quick_yardstick, data, tmp_path, capsys):
    out = tmp_path / "reports"
    path = run.main(["--quick", "--data", str(data), "--only", "start", "-o", str(out)])
    text = path.read_text(encoding="utf-8")
    for part in ("commit", "NumPy", "first scan of tiny processed", "gridslam --help", "particles = 30"):
        assert part in text
    assert str(path) in capsys.readouterr().out


def test_kernels_are_replayed_as_they_were_called():
    situation = kernels.record(particles=3, scans=15)
    assert tiles.backend is kernels.backend
    assert set(situation.work) == set(situation.calls) == set(kernels.reference.__all__) - kernels.ELSEWHERE
    assert set(kernels.reference.__all__) >= kernels.ELSEWHERE
    call = situation.calls["update"]
    again = kernels.backend.update(*(np.array(a) if isinstance(a, np.ndarray) else a for a in call.arguments))
    assert again[:3] == call.result[:3]
    assert again[2] > 0
    assert kernels.fork_join_us(2, repeats=10) < 10_000
    text = kernels.kernel_times(situation, repeats=1)
    assert all(name in text for name in situation.work)


def test_tables_and_targets():
    assert table(["a", "b"], [[1, 0.123456], ["x", 12345.6]]).splitlines()[2:] == ["| 1 | 0.1235 |", "| x | 12346 |"]
    report = Report()
    report.targets += [Target("low", 1.0, 2.0, unit="s"), Target("high", 3.0, 2.0, "peer", "other")]
    low, high = report.summary().splitlines()[2:]
    assert low == "| low | 1 s | <= 2 s | yes |  |  |"
    assert high == "| high | 3 | <= 2 | **NO** | peer | other |"


def test_cost_of_landmark_slam_without_real_logs(tmp_path):
    """The time of a step has its target, the only one that needs no real log."""
    report = Report()
    landmarks.landmarks(report, tmp_path, (0,), steps=1)
    (target,) = report.targets
    assert target.name.startswith("FastSLAM 2.0, 1000 particles")
    assert target.value > 0
    assert len(report.sections) == 3
