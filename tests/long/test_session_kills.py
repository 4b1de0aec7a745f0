"""A run with autosave is killed at fifty random moments; the same command ends with identical files each time."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import gridslam
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.sessions.session_file import read_session
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.interrupted import (
    SCANS,
    SCENARIOS,
    interrupt_amid_an_autosave,
    make_building,
    resume_after,
    run_node,
    run_whole,
)

KILLS = 50
FILES = ("trajectory.tum", "map.pgm", "graph.g2o", "trajectory_online.tum")
SUFFIXES = (".tum", ".csv", ".pgm", ".g2o")


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


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    make_building(folder)
    return folder


MOMENTS = np.linspace(1, SCANS, KILLS).astype(int).tolist()


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_run_that_goes_on_from_others_gives_the_same_bytes_wherever_it_is_killed(building, tmp_path, scenario):
    whole, found = run_whole(scenario, building, tmp_path / "whole")
    assert MOMENTS[1] < found < MOMENTS[-10]
    assert all(resume_after(scan, scenario, building, tmp_path / str(scan)) == whole for scan in MOMENTS)


def test_a_node_gives_the_same_bytes_wherever_it_was_ended(building, tmp_path):
    whole = run_node(building, tmp_path / "whole")
    for number, scan in enumerate(np.linspace(1, SCANS - 1, KILLS).astype(int).tolist()):
        assert run_node(building, tmp_path / str(scan), [scan], autosaved=bool(number % 2)) == whole, scan


def test_a_merge_that_was_killed_leaves_nothing_and_gives_the_same_bytes(building, tmp_path):
    """It has no autosave: the same command begins again."""
    days = [building / "days.gridslam", tmp_path / "tuesday.gridslam"]
    session = gridslam.Session.open(days[0])
    session = gridslam.Session(session.configuration)
    session.add(building / "tuesday.csv")
    session.save(days[1])

    def command(out):
        merge = [sys.executable, "-m", "gridslam.cli.main", "merge", *days, "-o", out / "out"]
        return [*map(str, merge), "--save", str(out / "all.gridslam")]

    def read(out):
        arrays = replace(read_session(out / "all.gridslam"), written="").dump()
        files = {path.name: path.read_bytes() for path in (out / "out").iterdir() if path.suffix in SUFFIXES}
        return files | {name: np.asarray(values).tobytes() for name, values in arrays.items()}

    (tmp_path / "whole").mkdir()
    begin = time.perf_counter()
    subprocess.run(command(tmp_path / "whole"), check=True, capture_output=True)
    seconds = time.perf_counter() - begin
    whole = read(tmp_path / "whole")
    for kill, share in enumerate(np.linspace(0.2, 1.1, KILLS)):
        out = tmp_path / f"out{kill}"
        out.mkdir()
        process = subprocess.Popen(command(out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(share * seconds)
        process.kill()
        process.wait()
        assert not (out / "out").exists() or (out / "out" / "run.json").exists(), kill
        subprocess.run(command(out), check=True, capture_output=True)
        assert read(out) == whole, kill
        assert sorted(path.name for path in out.iterdir()) == ["all.gridslam", "out"]
        assert not [path for path in (out / "out").iterdir() if path.name.endswith(".partial")]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_amid_an_autosave_leaves_no_half_file(log, tmp_path, number):
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("this process was started to ignore the signal, as by nohup: so are those that it starts")
    out = tmp_path / "out"
    amid = 0
    for kill in range(KILLS):
        amid += interrupt_amid_an_autosave(log, out, number, delay_s=0.001 * (kill % 10))
        assert not [path for path in out.iterdir() if path.name.endswith(".partial")], kill
    assert amid > KILLS / 2
