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
