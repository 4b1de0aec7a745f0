"""A run with autosave is killed at fifty random moments; the same command ends with identical files each time."""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np
import pytest

from gridslam.io.carmen.writer import write_carmen
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

KILLS = 50
FILES = ("trajectory.tum", "map.pgm", "graph.g2o", "trajectory_online.tum")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("kills") / "day.clf"
    rng = np.random.default_rng(1)
    write_carmen(
        path, simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng).measurements
    )
    return path


def test_it_goes_on_after_every_kill(log, tmp_path):
    command = [sys.executable, "-m", "gridslam.cli.main", "map", str(log), "--autosave", "0.003", "-o"]
    begin = time.perf_counter()
    subprocess.run([*command, str(tmp_path / "whole")], check=True, capture_output=True)
    seconds = time.perf_counter() - begin
    whole = [(tmp_path / "whole" / name).read_bytes() for name in FILES]
    rng = np.random.default_rng(3)
    resumed = 0
    for kill in range(KILLS):
        out = tmp_path / f"out{kill}"
        process = subprocess.Popen([*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(rng.uniform(0.3, 1.0) * seconds)
        process.kill()
        process.wait()
        ended = subprocess.run([*command, str(out)], check=False, capture_output=True, text=True)
        assert ended.returncode == 0, ended.stderr
        resumed += "resumed from an interrupted run" in ended.stderr
        assert [(out / name).read_bytes() for name in FILES] == whole, kill
        assert {path.name for path in out.iterdir()}.isdisjoint({"autosave.gridslam"})
        assert not [path for path in tmp_path.iterdir() if path.name.endswith(".partial")]
    assert resumed > KILLS / 3  # the others were killed before the first autosave, or had ended
