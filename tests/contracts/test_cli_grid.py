"""What `gridslam grid` and `map_with_poses` write, say and return."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from PIL import Image

from gridslam import __version__
from gridslam.api.grid import map_with_poses
from gridslam.api.mapping import map_log
from gridslam.config import Configuration, override
from gridslam.errors import ArgumentError, ConfigurationError
from gridslam.io.log import LogOptions, open_log
from gridslam.io.maps import read_map
from gridslam.io.measurement import Measurement
from gridslam.io.text import compute_digest
from gridslam.io.trajectories import read_tum
from gridslam.types import Beams, Trajectory
from support.same_map import assert_same_map

FILES = {"map.yaml", "map.pgm", "map.png", "run.json"}


@pytest.fixture
def call(call):
    return partial(call, "grid")


@pytest.fixture
def truth(log):
    return log.with_name("truth.tum")


class _Kept:
    """A log in memory."""

    def __init__(self, log, measurements):
        self._log, self._measurements = log, list(measurements)
        self.path = log.path

    @property
    def statistics(self):
        return self._log.statistics

    def __iter__(self):
        return iter(self._measurements)


def test_files_and_figures(call, log, truth, tmp_path):
    out = tmp_path / "new" / "out"
    status, text, err = call(log, "--trajectory", truth, "-o", out)
    assert (status, err) == (0, "")
    assert {file.name for file in out.iterdir()} == FILES
    document = json.loads((out / "run.json").read_text())
    assert (document["schema"], document["version"]) == ("gridslam.grid/1", __version__)
    assert document["scans"] == {
        "read": 120,
        "used": 120,
        "skipped": {"outside the trajectory": 0, "in a gap of the trajectory": 0},
    }
    assert document["input"]["sha256"] == compute_digest(log)
    assert document["trajectory"]["sha256"] == compute_digest(truth)
    assert document["trajectory"]["poses"] == 120
    assert document["configuration"]["resolution_m"] == 0.05
    assert f"map, {document['map']['width_m']:.1f} m x {document['map']['height_m']:.1f} m: {out / 'map.png'}" in text
    grid = read_map(out / "map.yaml")
    assert (grid.log_odds[grid.known] > 0).sum() > 500
    assert (grid.log_odds[grid.known] < 0).sum() > 10_000
    with Image.open(out / "map.png") as picture:
        assert picture.mode == "RGB"


def test_json_is_all_that_is_printed(call, log, truth, tmp_path):
    status, text, err = call(log, "--trajectory", truth, "-o", tmp_path / "out", "--json", "--model", "counting")
    assert (status, err) == (0, "")
    document = json.loads(text)
    assert document == json.loads((tmp_path / "out" / "run.json").read_text())
    assert document["model"] == "counting"


def test_options_reach_the_map(call, log, truth, tmp_path):
    how = ("--resolution", 0.1, "--max-gap", 5, "--threads", 2, "--every", 3, "--repair", "none")
    how = (*how, "--no-deskew")
    status, text, _ = call(log, "--trajectory", truth, "-o", tmp_path, "--json", *how)
    document = json.loads(text)
    assert status == 0
    assert document["configuration"]["resolution_m"] == 0.1
    assert (document["trajectory"]["max_gap_s"], document["scans"]["used"], document["deskew"]) == (5.0, 40, False)
    assert read_map(tmp_path / "map.yaml").resolution_m == 0.1
    status, text, _ = call(log, "--trajectory", truth, "-o", tmp_path, "--json", "--laser", "hokuyo-urg-04lx")
    document = json.loads(text)
    assert document["configuration"]["range_max_m"] == 5.6
    assert document["configuration"]["resolution_m"] == 0.03


def test_it_is_the_map_of_slam_where_its_trajectory_is_known(log):
    """SLAM's map is made of its key scans; with one particle and clamps that nothing reaches it is their sum."""
    config = override(
        Configuration(particles=1, loop_closure=None),
        "key_scan_m=0.12",
        "key_scan_rad=0.12",
        "mapper.inverse_sensor.log_odds_min=-150",
        "mapper.inverse_sensor.log_odds_max=150",
    )
    slam = map_log(log, configuration=config)
    keys = set(slam.key_stamps_ns.tolist())
    assert len(keys) > 60
    kept = _Kept(open_log(log), (m for m in open_log(log) if m.scan.stamp_ns in keys))
    assert_same_map(map_with_poses(kept, slam.trajectory, configuration=config, repair="none").map, slam.map)


def test_beams_are_deskewed_by_the_trajectory(log, truth, simulated, monkeypatch):
    """Times of beams reach the deskewing, with the twist that the trajectory has over the scan."""
    twists = []
    monkeypatch.setattr(Beams, "deskew", lambda self, twist: (twists.append(twist), self)[1])
    whole = read_tum(truth)
    scans = [
        Measurement(odometry, replace(scan, beam_times_s=np.linspace(-0.1, 0.1, len(scan))))
        for odometry, scan in simulated.measurements[:30]
    ]
    map_with_poses(_Kept(open_log(log), scans), truth, repair="none")
    assert len(twists) == 30
    map_with_poses(_Kept(open_log(log), scans), truth, repair="none", deskew=False)
    assert len(twists) == 30
    moved = np.hypot(*(whole.poses[20] - whole.poses[19])[:2]) + np.hypot(*(whole.poses[21] - whole.poses[20])[:2])
    seconds = (whole.stamps_ns[21] - whole.stamps_ns[19]) * 1e-9
    assert np.hypot(*twists[20][:2]) == pytest.approx(moved / seconds, rel=0.2)


@pytest.mark.parametrize(
    ("how", "problem"),
    [
        (("--trajectory", "nowhere.tum"), "nowhere.tum: no such file"),
        (("--resolution", "0"), "--resolution: expected above 0, at most 1 m, got 0.0"),
        (("--max-gap", "-1"), "--max-gap: expected a finite time above 0 s, got -1.0"),
        (("--laser", "sick"), "laser: expected sick-lms"),
        (("--odom", "/odom"), "topics and frames are chosen in bags alone"),
    ],
)
def test_what_is_refused(call, log, truth, tmp_path, how, problem):
    status, text, err = call(log, "--trajectory", truth, "-o", tmp_path / "out", *how)
    assert (status, text) == (2, "")
    (line,) = err.splitlines()
    assert problem in line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        ("500 0 0 0 0 0 0 1\n", "expected a trajectory of this log, but it lasts from 500.000 to 500.000 s and the"),
        ("1 2 3\n", "line 1"),
        ("0 0 0 0 0 0 0 1\n1 1e7 1e6 0 0 0 0 1\n", "expected poses whose map has at most 3e+08 cells, got 1000"),
        (
            "0 1.2e8 0 0 0 0 0 1\n30 1.2e8 0 0 0 0 0 1\n",
            "expected poses within 5.37e+07 m of the origin, for",
        ),
        ("", "empty"),
    ],
)
def test_trajectories_that_are_none_of_the_log(call, log, tmp_path, rows, problem):
    (tmp_path / "t.tum").write_text(rows)
    status, _, err = call(log, "--trajectory", tmp_path / "t.tum", "-o", tmp_path / "out")
    (line,) = (line for line in err.splitlines() if "%" not in line)
    assert status == 2
    assert str(tmp_path / "t.tum") in line
    assert problem in line
    assert not (tmp_path / "out").exists()


def test_bad_calls(log, truth):
    with pytest.raises(ArgumentError, match="model: expected bayes or counting"):
        map_with_poses(log, truth, model="dempster")
    with pytest.raises(ArgumentError, match="at least one pose"):
        map_with_poses(log, Trajectory(np.empty(0, np.int64), np.empty((0, 3))))
    with pytest.raises(ConfigurationError, match="laser"):
        map_with_poses(log, truth, laser="none")


def test_a_real_log_with_jittering_stamps_gets_every_pose(data_dir):
    """Intel's stamps go backwards, and the trajectory has them all: no scan is left out, and none is moved."""
    log = open_log(data_dir / "intel.clf.bz2", LogOptions(duration_s=60.0))
    driven = [(scan.stamp_ns, odometry.pose) for odometry, scan in log]
    trajectory = Trajectory(np.array([s for s, _ in driven]), np.array([pose for _, pose in driven]))
    result = map_with_poses(log, trajectory, repair="none")
    np.testing.assert_array_equal(result.trajectory.poses, trajectory.poses)
