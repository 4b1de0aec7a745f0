"""What mapping landmarks writes and says, by every method."""

import json

import numpy as np
import pytest
from PIL import Image

from gridslam import __version__
from gridslam.api.landmarks import METHODS
from gridslam.cli.landmarks import landmarks_to_folder
from gridslam.io.landmarks import read_landmarks
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_trajectory_csv, read_tum

FILES = {"trajectory.tum", "trajectory.csv", "landmarks.csv", "landmarks.png", "run.json"}


@pytest.mark.parametrize("method", METHODS)
def test_files_and_figures(park, tmp_path, capsys, method):
    path, truth = park
    landmarks_to_folder(path, tmp_path / "out", method, as_json=True)
    document = json.loads(capsys.readouterr().out)
    online = set() if method == "graph" else {"trajectory_online.tum"}
    assert {file.name for file in (tmp_path / "out").iterdir()} == FILES | online
    assert document == json.loads((tmp_path / "out" / "run.json").read_text())
    assert (document["schema"], document["version"]) == ("gridslam.landmarks/2", __version__)
    assert (document["method"], document["correspondences"], document["landmarks"]) == (method, "known", 10)
    assert document["particles"] == {"fastslam1": 100, "fastslam2": 20}.get(method)
    assert document["input"]["sha256"] == compute_digest(path)
    assert (document["input"]["steps"], document["input"]["stamped"]) == (141, False)
    assert document["errors"] == {"trajectory": None, "landmarks": None}
    assert document["models"]["sensor"]["kind"] == "RelativePosition"
    found = read_landmarks(tmp_path / "out" / "landmarks.csv")
    assert sorted(found.names.tolist()) == list(range(1100, 1110))
    assert found.observations.sum() == document["input"]["observations"]
    assert (np.linalg.eigvalsh(found.covariances) > 0).all()
    trajectory, covariances = read_trajectory_csv(tmp_path / "out" / "trajectory.csv")
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == len(trajectory) == len(covariances) == 141
    # Half a metre at the end of a ring of 25 m: dead reckoning is off by several.
    assert np.hypot(*(trajectory.poses[-1] - truth[-1])[:2]) < 2.5
    with Image.open(tmp_path / "out" / "landmarks.png") as picture:
        assert min(picture.size) > 800


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
        (["loop", "--duration", "-1"], "'--duration': -1.0 is not in the range"),
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


@pytest.mark.parametrize("pose", ["1,2", "1,2,x", "1,2,inf", "1,2,3,4", ""])
def test_a_pose_is_three_numbers(call, tmp_path, pose):
    status, _, error = call("landmarks", tmp_path / "log.txt", "-o", tmp_path / "out", "--initial-pose", pose)
    assert status == 2
    assert f"--initial-pose': expected X,Y,THETA (m, rad), got {pose!r}" in error
