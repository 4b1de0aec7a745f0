"""What mapping landmarks writes and says, by every method."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from gridslam import __version__
from gridslam.api.landmarks import METHODS, map_landmarks
from gridslam.cli.landmarks import landmarks_to_folder
from gridslam.cli.main import main
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


def test_the_same_seed_gives_the_same_bytes(park, tmp_path):
    for name in ("a", "b"):
        map_landmarks(park[0], "fastslam1", seed=5, particles=10).save(tmp_path / name)
    for file in ("trajectory.csv", "landmarks.csv"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        ("ODOMETRY 0 1 1 0 0 1 0 0 1\n", [], "bad.txt, line 1: expected 'ODOMETRY from to x_m"),
        ("ODOMETRY 0 1 1 0 x 1 0 0 1 0 1\n", [], "bad.txt, line 1: expected 'ODOMETRY from to x_m"),
        ("nothing of the kind\n", [], "got a line that begins with 'nothing'"),
        (None, [], "bad.txt"),
        ("ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\n", ["--method", "magic"], "'magic' is not one of"),
    ],
)
def test_bad_input_is_one_line_and_status_2(tmp_path, capsys, text, options, said):
    log = tmp_path / "bad.txt"
    if text is not None:
        log.write_text(text)
    status = main(["landmarks", str(log), "-o", str(tmp_path / "out"), *options])
    stdout, stderr = capsys.readouterr()
    assert (status, stdout) == (2, "")
    assert said in stderr.splitlines()[-1]
    assert "Traceback" not in stderr
    assert not (tmp_path / "out").exists()
