"""What other commands than `map` left is shown as their files tell it."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from gridslam.api.grid import map_with_poses
from gridslam.api.localization import BELIEF_HEADER, localize
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.landmarks import write_landmarks
from gridslam.io.maps import read_map, write_map
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.live.monitor import LOST
from gridslam.live.replay import Replay
from gridslam.sim import OdometryNoise
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.types import Trajectory
from support.landmark_world import drive as landmark_drive
from support.landmark_world import ring
from support.localization_world import drive, flat_map
from support.page_client import PageClient


def looking(replay):
    viewer, client = replay.add_viewer(lambda: None), PageClient()
    client.catch_up(viewer)
    return viewer, client


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A flat's map, a drive in it, and what localization said of that."""
    folder = tmp_path_factory.mktemp("flat")
    write_map(folder / "flat.yaml", flat_map())
    write_carmen(folder / "flat.clf", drive(1, OdometryNoise()).measurements)
    result = localize(folder / "flat.clf", folder / "flat.yaml", seed=2)
    result.save(folder / "out")
    return folder, result


def test_a_localization_is_shown_at_each_scan(place):
    folder, result = place
    viewer, client = looking(Replay(folder / "out"))
    assert client.sees(read_map(folder / "flat.yaml"))
    assert (client.run_info["title"], client.run_info["step"]) == ("flat.clf", "scan")
    assert set(client.run_info["layers"]) == {"map", "path", "n_eff", "lost_probability"}
    weighed = [report.n_eff for report in result.reports if report.skipped is None]
    told = client.series[~np.isnan(client.series[:, 1])]
    np.testing.assert_allclose(told[:, 1], weighed, atol=0.06)  # as written, one decimal
    assert (told[:, 1] <= told[:, 4]).all()
    np.testing.assert_array_equal(client.series[:, 3], LOST * result.lost)
    assert 0 < result.lost.sum() < len(result.lost)
    for at in (len(result.reports) // 2, 3, len(result.reports) - 1):
        viewer.command({"do": "seek", "at": at})
        client.catch_up(viewer)
        status, report = client.status, result.reports[at]
        np.testing.assert_allclose(status["pose"], report.pose, atol=1e-8)
        np.testing.assert_allclose(status["covariance"], report.covariance, rtol=1e-6, atol=1e-12)
        assert (status["lost"], status["particles"]) == (report.lost, report.particles)
        assert status["lost_probability"] == pytest.approx(report.lost_probability, abs=1e-5)
        assert status["inlier_ratio"] == pytest.approx(report.inlier_ratio, abs=1e-4)
        assert (status["scans"], len(client.path)) == (at + 1, at + 1)
        np.testing.assert_array_equal(np.isnan(client.path[:, 0]), result.lost[: at + 1])


def replace_parameters(out, tmp_path, name, text):
    folder = tmp_path / "changed"
    shutil.copytree(out, folder)
    (folder / name).write_text(text)
    return folder


def test_without_its_map_the_way_is_shown_and_that_is_said(place, tmp_path):
    folder, _ = place
    document = json.loads((folder / "out" / "run.json").read_text())
    document["input"]["map"] = str(tmp_path / "gone.yaml")
    replay = Replay(replace_parameters(folder / "out", tmp_path, "run.json", json.dumps(document)))
    _, client = looking(replay)
    assert "gone.yaml" in replay.results.missing
    assert client.status["message"] == replay.results.missing
    assert "map" not in client.run_info["layers"]
    assert len(client.path)
    assert replay.channel_map(0) is None


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("stamp_s,lost\n", "expected the columns stamp_s,lost,lost_probability"),
        (f"{BELIEF_HEADER}\n1,0,x,0,1,,0\n", "line 2: expected numbers"),
        (f"{BELIEF_HEADER}\n1,0\n", "expected seven numbers"),
        (f"{BELIEF_HEADER}\n1,0,0,0,1,,0\n", r"expected \d+ scans, got 1"),
    ],
)
def test_a_belief_that_is_none_is_told(place, tmp_path, text, says):
    with pytest.raises(InputError, match=says):
        Replay(replace_parameters(place[0] / "out", tmp_path, "belief.csv", text))


def test_landmarks_are_shown_with_the_way(tmp_path):
    landmarks = ring(10)
    _, truth = landmark_drive(landmarks, 50, np.random.default_rng(1))
    covariances = np.tile(np.diag([0.04, 0.01, 0.001]), (50, 1, 1))
    spread = np.tile([[0.04, 0.01], [0.01, 0.09]], (10, 1, 1))
    found = LandmarkMap(np.arange(10), landmarks, spread, np.ones(10, np.int64))
    trajectory = Trajectory(np.arange(50) * 10**9, truth)
    write_trajectory_csv(tmp_path / "trajectory.csv", trajectory, covariances)
    (tmp_path / "run.json").write_text(json.dumps({"schema": "gridslam.landmarks/2", "input": {"path": "a/park.txt"}}))
    viewer, client = looking(Replay(tmp_path))  # of landmarks that were known none are written
    assert client.run_info["layers"] == ["path"]
    write_landmarks(tmp_path / "landmarks.csv", found)
    viewer, client = looking(Replay(tmp_path))
    assert client.run_info["title"] == "park.txt"
    np.testing.assert_allclose(client.arrays["landmarks"][:, :2], landmarks, atol=1e-6)
    np.testing.assert_allclose(client.arrays["landmarks"][:, 2:], np.tile([0.04, 0.01, 0.09], (10, 1)), atol=1e-6)
    viewer.command({"do": "seek", "at": 20})
    client.catch_up(viewer)
    np.testing.assert_allclose(client.status["pose"], truth[20], atol=1e-8)
    assert (client.status["keys"], client.status["landmarks"], len(client.path)) == (21, 10, 21)


def test_a_map_with_known_poses_stands_still(place, tmp_path):
    log = drive(1)
    write_tum(tmp_path / "truth.tum", log.truth)
    write_carmen(tmp_path / "flat.clf", log.measurements)
    map_with_poses(tmp_path / "flat.clf", tmp_path / "truth.tum").save(tmp_path / "out")
    viewer, client = looking(Replay(tmp_path / "out"))
    grid = read_map(tmp_path / "out" / "map.yaml")
    assert client.sees(grid)
    assert (client.run_info["mode"], client.run_info["layers"], client.status["last"]) == ("still", ["map"], 0)
    for command in ({"do": "resume"}, {"do": "step"}, {"do": "seek", "at": 5}):
        viewer.command(command)
        client.catch_up(viewer)
        assert client.status["at"] == 0
