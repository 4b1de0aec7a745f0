"""Nodes that go on from one another, and merges that are killed, at fifty moments: identical files each time."""

import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import gridslam
from gridslam.io.sessions.session_file import read_session
from support.interrupted import SCANS, make_building, run_node

KILLS = 50
SUFFIXES = (".tum", ".csv", ".pgm", ".g2o")


@pytest.fixture(scope="module")
def building(tmp_path_factory):
    folder = tmp_path_factory.mktemp("building")
    make_building(folder)
    return folder


def test_a_node_gives_the_same_bytes_wherever_it_was_ended(building, tmp_path):
    whole = run_node(building, tmp_path / "whole")
    for number, scan in enumerate(np.linspace(1, SCANS - 1, KILLS).astype(int).tolist()):
        assert run_node(building, tmp_path / str(scan), [scan], autosaved=bool(number % 2)) == whole, scan


def test_a_merge_that_was_killed_leaves_nothing_and_gives_the_same_bytes(building, tmp_path):
    days = [building / "days.gridslam", tmp_path / "tuesday.gridslam"]
    session = gridslam.Session.open(days[0])
    session = gridslam.Session(session.configuration)
    session.add(building / "tuesday.csv")
    session.save(days[1])

    def command(out):
        merge = [sys.executable, "-m", "gridslam", "merge", *days, "-o", out / "out"]
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
