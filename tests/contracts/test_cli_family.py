"""What landmarks, evaluate and simulate say of what they cannot use: by the option's own name, and nothing is lost."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.io.trajectories import write_tum
from gridslam.types import Trajectory


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["lop"], "WORLD: expected one of demo, loop, rooms, hall, corridor, random"),
        (["loop", "--fov", "0"], "'--fov': 0.0 is not in the range 0<x<=360"),
        (["loop", "--fov", "400"], "'--fov': 400.0 is not in the range 0<x<=360"),
        (["loop", "--fov", "nan"], "'--fov': expected a finite number, got nan"),
        (["loop", "--range-max", "inf"], "'--range-max': expected a finite number, got inf"),
        (["loop", "--rate", "0"], "'--rate': 0.0 is not in the range 0<x<=1000"),
        (["loop", "--rate", "1e9"], "'--rate': 1000000000.0 is not in the range 0<x<=1000"),
        (["loop", "--beams", "1"], "'--beams': 1 is not in the range x>=2"),
        (["loop", "--duration", "-1"], "--duration: expected 0 s or more, got -1"),
        (["loop", "--duration", "nan"], "'--duration': expected a finite number, got nan"),
    ],
)
def test_simulate_names_the_option(call, tmp_path, arguments, message):
    status, out, err = call("simulate", *arguments, "-o", tmp_path / "log.clf")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["log.bag", "log.csv", "log.mcap", "log.gz", "log"])
def test_simulate_writes_carmen_under_no_other_name(call, tmp_path, name):
    status, out, err = call("simulate", "rooms", "-o", tmp_path / name, "--duration", 1)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"{name}: expected a name that ends in .clf, .log or .carmen" in err
    assert list(tmp_path.iterdir()) == []


def test_each_simulated_log_has_a_truth_of_its_own(call, tmp_path):
    names = "run.1.clf", "run.2.clf.gz", "run.log"
    for name in names:
        assert call("simulate", "rooms", "-o", tmp_path / name, "--duration", 1, "--beams", 10)[0] == 0
    truths = {"run.1.truth.tum", "run.2.truth.tum", "run.truth.tum"}
    assert {file.name for file in tmp_path.iterdir()} == {*names, *truths}


def test_evaluate_names_the_option_where_a_path_is_short(call, tmp_path):
    path = tmp_path / "short.tum"
    write_tum(path, Trajectory(np.array([0, 10**9]), np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])))
    status, out, err = call("evaluate", path, path)
    assert (status, out) == (2, "")
    assert err == "gridslam: --distance: expected at most the path's 0.500 m, got 1.0\n"
    assert call("evaluate", path, path, "--distance", 0.5)[0] == 0


def test_landmarks_by_a_graph_that_is_not_told_which(call, tmp_path):
    log = tmp_path / "log.txt"
    log.write_text("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\nLANDMARK 1 7 1 0 1 0 1\n")
    status, out, err = call("landmarks", log, "-o", tmp_path / "out", "--method", "graph", "--unknown")
    assert (status, out) == (2, "")
    assert err == "gridslam: --unknown: GraphSLAM requires known correspondences\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("method", ["ekf", "fastslam1", "fastslam2", "graph"])
def test_landmarks_of_a_log_that_sees_none(call, tmp_path, method):
    log = tmp_path / "log.txt"
    log.write_text("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\n")
    status, out, err = call("landmarks", log, "-o", tmp_path / "out", "--method", method)
    assert (status, out) == (2, "")
    assert err == f"gridslam: {log}: expected landmark observations, got none\n"
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("particles", [0, 10**9])
def test_landmarks_by_particles_that_there_can_be(call, tmp_path, particles):
    status, out, err = call("landmarks", tmp_path / "log.txt", "-o", tmp_path / "out", "--particles", particles)
    assert (status, out) == (2, "")
    assert f"'--particles': {particles} is not in the range 1<=x<=100000" in err


def test_an_empty_path_is_no_path(call, tmp_path, monkeypatch):
    """A shell's variable that is not set; the current folder would be filled."""
    monkeypatch.chdir(tmp_path)
    status, _, error = call("simulate", "demo", "-o", "")
    assert (status, error) == (
        2,
        "gridslam: Invalid value for '-o' / '--out': expected a path, got an empty string "
        "(see gridslam simulate --help)\n",
    )
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("pose", ["1,2", "1,2,x", "1,2,inf", "1,2,3,4", ""])
def test_a_pose_is_three_numbers(call, tmp_path, pose):
    status, _, error = call("landmarks", tmp_path / "log.txt", "-o", tmp_path / "out", "--initial-pose", pose)
    assert status == 2
    assert f"--initial-pose': expected X,Y,THETA (m, rad), got {pose!r}" in error
