"""gridslam localize: what it writes and says, and what it refuses in one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gridslam.api.localization import BELIEF_HEADER
from gridslam.cli.main import main
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.maps import write_map
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_trajectory_csv, read_tum
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import box
from gridslam.types import OccupancyGrid
from support.localization_world import drive, flat_map

FILES = {"trajectory.tum", "trajectory.csv", "belief.csv", "history.npz", "localization.png", "run.json"}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with flat.yaml, a drive through that flat, and one through another house."""
    folder = tmp_path_factory.mktemp("flat")
    write_map(folder / "flat.yaml", flat_map())
    write_carmen(folder / "flat.clf", drive(1, OdometryNoise()).measurements)
    rng = np.random.default_rng(0)
    other = simulate(make_world("hall", rng), RobotConfig(), OdometryNoise(), LidarConfig(rate_hz=2), rng)
    write_carmen(folder / "hall.clf", other.measurements[:100])
    return folder


def run(capsys, *arguments) -> tuple[int, str, str]:
    status = main(["localize", *map(str, arguments)])
    said = capsys.readouterr()
    return status, said.out, said.err


def test_files_and_figures(place, tmp_path, capsys):
    out = tmp_path / "out"
    status, text, _ = run(capsys, place / "flat.clf", "--map", place / "flat.yaml", "-o", out, "--json", "--seed", 3)
    assert status == 0
    document = json.loads(text)
    assert document == json.loads((out / "run.json").read_text())
    assert {file.name for file in out.iterdir()} == FILES
    assert (document["schema"], document["seed"]) == ("gridslam.localization/2", 3)
    assert document["initial_pose"] == "global"
    assert document["input"]["sha256"] == compute_digest(place / "flat.clf")
    assert document["configuration"]["kld"]["particles_min"] == 2000
    trajectory, covariances = read_trajectory_csv(out / "trajectory.csv")
    truth = drive(1).truth.poses
    assert len(read_tum(out / "trajectory.tum")) == len(trajectory) == len(truth) == document["scans"]["read"]
    assert (np.linalg.eigvalsh(covariances) > 0).all()
    rows = (out / "belief.csv").read_text().splitlines()
    assert rows[0] == BELIEF_HEADER
    lost = np.array([row.split(",")[1] == "1" for row in rows[1:]])
    assert lost.sum() == document["scans"]["lost"] > 0
    assert np.hypot(*(trajectory.poses - truth)[~lost, :2].T).max() < 0.3
    first, second, *_ = document["intervals"]
    assert (first["lost"], second["lost"]) == (True, False)
    assert 0 < second["driven_m"] < 5
    with Image.open(out / "localization.png") as picture:
        assert max(picture.size) >= 1400


def test_a_parameter_file_of_nav2(place, tmp_path, capsys):
    """Taken as it is; one line names what is ignored, and --set overrides it."""
    x, y, yaw = drive(1).truth.poses[0]
    (tmp_path / "nav2.yaml").write_text(
        f"""
amcl:
  ros__parameters:
    max_particles: 900
    min_particles: 300
    recovery_alpha_fast: 0.0
    recovery_alpha_slow: 0.0
    tf_broadcast: true
    set_initial_pose: true
    initial_pose: {{x: {x}, y: {y}, z: 0.0, yaw: {yaw}}}
bt_navigator:
  ros__parameters: {{rate: 1}}
"""
    )
    arguments = (place / "flat.clf", "--map", place / "flat.yaml", "--config", tmp_path / "nav2.yaml", "--json")
    status, text, warned = run(capsys, *arguments, "--set", "recovery_alpha_fast=0.", "--set", "max_beams=50")
    assert status == 0
    document = json.loads(text)
    configuration = document["configuration"]
    assert (configuration["kld"]["particles_max"], configuration["max_beams"]) == (900, 50)
    assert document["initial_pose"] == pytest.approx([x, y, yaw])
    assert "tf_broadcast, initial_pose.z, /bt_navigator: not supported, ignored" in warned
    (tmp_path / "nav2.yaml").write_text("amcl: {ros__parameters: {max_beams: none}}")
    status, _, problem = run(capsys, *arguments)
    assert (status, problem.count("\n")) == (2, 1)
    assert "nav2.yaml: max_beams: expected" in problem


@pytest.mark.parametrize(("grey", "missing"), [(0, "free"), (254, "occupied")])
def test_a_map_in_which_nobody_can_be_localized_is_named(place, tmp_path, capsys, grey, missing):
    Image.new("L", (50, 40), grey).save(tmp_path / "flat.pgm")
    (tmp_path / "flat.yaml").write_text((place / "flat.yaml").read_text())
    status, _, problem = run(capsys, place / "flat.clf", "--map", tmp_path / "flat.yaml", "-o", tmp_path / "out")
    assert (status, problem.count("\n")) == (2, 1), problem
    assert f"{tmp_path / 'flat.yaml'}" in problem
    assert f"at least one {missing} cell" in problem
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--initial-pose", "1,2", "X,Y,THETA"),
        ("--initial-pose", "1,2,nan", "X,Y,THETA"),
        ("--initial-pose", "1e9,0,0", "--initial-pose: expected a place in the map, x from "),
        ("--set", "max_beams=0", "max_beams"),
        ("--set", "min_particle=3", "did you mean"),
        ("--preset", "magic", "magic"),
        ("--particles", "0", "particles"),
    ],
)
def test_bad_usage(place, capsys, option, value, said):
    status, _, problem = run(capsys, place / "flat.clf", "--map", place / "flat.yaml", option, value)
    assert status == 2
    assert said in problem


def test_strict_thresholds(place, tmp_path, capsys):
    """A free_thresh of 0.25 makes 205 free to who reads literally."""
    (tmp_path / "flat.pgm").write_bytes((place / "flat.pgm").read_bytes())
    loose = (place / "flat.yaml").read_text().replace("0.196", "0.25")
    (tmp_path / "loose.yaml").write_text(loose)
    assert "0.25" in loose
    _, _, warned = run(capsys, place / "flat.clf", "--map", tmp_path / "loose.yaml")
    assert "pixel 205 free" in warned
    assert "--strict-thresholds" in warned
    _, _, quiet = run(capsys, place / "flat.clf", "--map", tmp_path / "loose.yaml", "--strict-thresholds")
    assert "205" not in quiet


def test_a_room_whose_ends_are_alike_is_no_error(tmp_path, capsys):
    """It fits the map, though nobody can tell which of the two places it is."""
    cells = np.full((100, 160), -4.0, np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 4.0
    write_map(tmp_path / "room.yaml", OccupancyGrid(cells, np.ones(cells.shape, bool), 0.05, (0.0, 0.0)))
    world = World.of("room", box(0.05, 0.05, 7.95, 4.95), [(1.5, 1.5), (6.5, 1.0), (6.5, 3.5), (1.5, 4.0)])
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(rate_hz=3.0), np.random.default_rng(0))
    write_carmen(tmp_path / "room.clf", log.measurements)
    status, text, said = run(capsys, tmp_path / "room.clf", "--map", tmp_path / "room.yaml", "--json")
    assert status == 0
    assert "the map is ambiguous" in said
    scans = json.loads(text)["scans"]
    assert scans["lost"] == scans["read"]
