"""What localization by landmarks writes and says."""

import json

import click
import numpy as np
import pytest
from PIL import Image

from gridslam import __version__
from gridslam.api.landmark_localization import localize_by_landmarks
from gridslam.api.landmarks import map_landmarks
from gridslam.cli.landmarks import landmarks_to_folder
from gridslam.cli.main import main
from gridslam.errors import ArgumentError, InputError
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_trajectory_csv, read_tum
from gridslam.localization.ekf import KnownLandmarks

LOCALIZE = {"method": "ekf-localization"}
FILES = {"trajectory.tum", "trajectory.csv", "landmarks.png", "run.json"}


@pytest.fixture(scope="session")
def mapped_park(park, tmp_path_factory):
    """A log in Victoria Park's form, the map that EKF SLAM makes of it, and the true poses."""
    (log, truth), folder = park, tmp_path_factory.mktemp("park")
    map_landmarks(log, "ekf").save(folder / "slam")
    return log, folder / "slam" / "landmarks.csv", truth


def test_files_and_figures(mapped_park, tmp_path, capsys):
    log, landmarks, truth = mapped_park
    landmarks_to_folder(log, tmp_path / "out", **LOCALIZE, landmarks=landmarks, as_json=True)
    document = json.loads(capsys.readouterr().out)
    assert {file.name for file in (tmp_path / "out").iterdir()} == FILES
    assert document == json.loads((tmp_path / "out" / "run.json").read_text())
    assert (document["schema"], document["version"]) == ("gridslam.landmark_localization/2", __version__)
    assert (document["method"], document["correspondences"]) == ("ekf-localization", "known")
    assert document["map"] == {"path": str(landmarks), "landmarks": 10}
    assert document["input"]["sha256"] == compute_digest(log)
    assert document["errors"] is None
    assert document["models"]["association"]["kind"] == "KnownCorrespondence"
    trajectory, covariances = read_trajectory_csv(tmp_path / "out" / "trajectory.csv")
    assert len(read_tum(tmp_path / "out" / "trajectory.tum")) == len(trajectory) == len(covariances) == 141
    # The map is SLAM's, off by some decimetres at its far side; within it the robot does not drift.
    assert np.hypot(*(trajectory.poses[1:] - truth)[:, :2].T).max() < 1.0
    assert np.sqrt(covariances[1:, 0, 0]).max() < 0.2
    with Image.open(tmp_path / "out" / "landmarks.png") as picture:
        assert min(picture.size) > 800


def test_the_command(mapped_park, tmp_path, capsys):
    log, landmarks, _ = mapped_park
    how = ["landmarks", str(log), "-o", str(tmp_path / "out"), "--method", "ekf-localization"]
    assert main([*how, "--landmarks", str(landmarks), "--initial-pose", "0,0,0.0", "--unknown", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["correspondences"], document["outliers"]) == ("unknown", 0)
    for more, said in (
        (["--particles", "5", "--landmarks", str(landmarks)], "--particles: expected none for ekf-localization, got 5"),
        (["--method", "ekf", "--landmarks", str(landmarks)], "only valid with --method ekf-localization"),
        ([], "expected true landmarks beside it, as no others are given"),
    ):
        assert main([*how[:3], str(tmp_path / "none"), *how[4:], *more]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
    assert not (tmp_path / "none").exists()


def test_what_is_refused(mapped_park, tmp_path):
    log, landmarks, _ = mapped_park
    with pytest.raises(InputError, match=r"ring.txt: expected true landmarks beside it, as no others are given"):
        localize_by_landmarks(log)
    bad = tmp_path / "bad.csv"
    bad.write_text(landmarks.read_text().replace("x_m", "x_cm", 1))
    with pytest.raises(InputError, match=r"bad.csv, line 1: expected the columns"):
        localize_by_landmarks(log, bad)
    bad.write_text("".join(line + "\n" for line in [*landmarks.read_text().splitlines(), "1100,0,0,1,0,1,1"]))
    with pytest.raises(InputError, match=r"bad.csv: names: expected each landmark once"):
        localize_by_landmarks(log, bad)
    with pytest.raises(InputError, match=r"ring.txt: expected observations of the landmarks in the map"):
        localize_by_landmarks(log, KnownLandmarks.of([1], [[0.0, 0.0]]))
    with pytest.raises(ArgumentError, match="pose: expected finite x, y, theta"):
        localize_by_landmarks(log, landmarks, pose=(0, 0, np.nan))
    with pytest.raises(click.ClickException, match="--initial-pose"):
        landmarks_to_folder(log, tmp_path / "out", **LOCALIZE, landmarks=landmarks, initial_pose=(0.0, 0.0, np.inf))
    assert not (tmp_path / "out").exists()
