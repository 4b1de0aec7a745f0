"""Inputs as users have reported them, imitated from one simulated drive, and logs of robots that follow a person."""

import numpy as np
import pytest

from gridslam.api.evaluation import score_against_truth
from gridslam.api.mapping import map_log
from gridslam.doctor import diagnose
from gridslam.errors import InputError
from gridslam.evaluation import measure_self_consistency
from gridslam.io.log import open_log
from gridslam.io.trajectories import read_tum
from gridslam.live.replay import Replay
from gridslam.types import Trajectory

START_NS = 1_700_000_000_000_000_000


def reports(data_dir):
    folder = data_dir / "reports"
    if not folder.is_dir():
        pytest.skip("needs reports/ of the shared data")
    return folder


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("inc_half", r"angle_min -3\.14159 in steps of angle_increment 0\.00872665 .* not at angle_max 3\.14159"),
        ("inc_double", r"angle_min -3\.14159 in steps of angle_increment 0\.0349066 .* not at angle_max 3\.14159"),
        ("angles_deg", "the angles look like degrees"),
        ("deg_noodom", "the angles look like degrees"),
        ("inc0", "all point one way"),
        ("intensities_only", "expected ranges, got none, and 360 intensities"),
    ],
)
def test_scans_that_no_map_can_be_made_of_are_refused(data_dir, name, problem):
    with pytest.raises(InputError, match=problem):
        open_log(reports(data_dir) / name)


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("kidnapped", {"robot_carried"}),
        ("split_missing2", {"missing_files"}),
        ("scan_frame_unknown", {"missing_transform"}),
        ("empty_frame", {"missing_transform"}),
        ("odom_yawneg", {"odometry_mirrored"}),
        ("odom_mirror", {"reflected_laser"}),
        ("person_follower_gazebo", {"single_object"}),
    ],
)
def test_the_cause_is_named_and_nothing_else(data_dir, name, codes):
    diagnosis = diagnose(reports(data_dir) / name)
    assert {finding.code for finding in diagnosis.faults} == codes


@pytest.mark.parametrize(("name", "most_m"), [("odom_yawneg", 0.01), ("rostopic_p.csv", 0.03), ("points.csv", 0.03)])
def test_the_map_is_right(data_dir, name, most_m):
    """Of tables the path is the laser's, 0.1 m ahead of the base of the truth."""
    folder = reports(data_dir)
    result = map_log(folder / name)
    truth = read_tum(folder / "truth.tum")
    estimate = result.trajectory
    shift = START_NS if estimate.stamps_ns[0] >= START_NS else 0
    ahead = 0.1 * np.column_stack([np.cos(truth.poses[:, 2]), np.sin(truth.poses[:, 2]), 0 * truth.poses[:, 2]])
    poses = truth.poses + (ahead if name.endswith(".csv") else 0)
    scores = score_against_truth(estimate, Trajectory(truth.stamps_ns + shift, poses))
    assert scores["ate"]["n"] == len(estimate)
    assert scores["ate"]["trans_rmse_m"] < most_m


@pytest.mark.parametrize("name", ["gazebo_krish_person", "gazebo_mtong_person"])
def test_a_robot_that_follows_a_person_does_not_jump(data_dir, name):
    """The simulator's odometry is the truth, and is not said to contradict what the laser sees of the person."""
    path = data_dir / "neato" / name
    if not path.exists():
        pytest.skip("needs neato/ of the shared data")
    stamps, poses = zip(*((o.stamp_ns, o.pose) for o, _ in open_log(path) if o is not None), strict=True)
    result = map_log(path)
    scores = score_against_truth(result.trajectory, Trajectory(np.array(stamps), np.array(poses)))
    assert scores["ate"]["trans_max_m"] < 0.01
    assert not any("odometry" in warning for warning in result.warnings())


def test_a_carried_robot_is_found_again_in_its_own_map(data_dir, tmp_path):
    """It is carried after 100 scans, over 80 of the truth."""
    folder = reports(data_dir)
    result = map_log(folder / "kidnapped")
    truth = read_tum(folder / "truth.tum").poses[np.r_[0:100, 180:301]]
    assert result.found_again is not None
    assert [len(path) for path in result.trajectories.values()] == [100, 121]
    scores = score_against_truth(result.trajectory, Trajectory(result.trajectory.stamps_ns, truth))
    assert scores["ate"]["trans_rmse_m"] < 0.005
    result.save(tmp_path / "out")
    assert Replay(tmp_path / "out").found.grid is not None


@pytest.mark.parametrize(
    ("name", "most"),
    [
        ("soltan_square_hard", 0.95),
        ("soltan_obstacle", 0.9),
        ("keenan_wall", 0.9),
        ("yycho_person", 0.9),
        ("yycho_square", 0.9),
    ],
)
def test_logs_of_small_robots_agree_with_themselves_better_than_by_their_odometry(data_dir, name, most):
    """Of the first one 82 % of the beams are invalid, and it turns by up to 0.6 rad between scans."""
    path = data_dir / "neato" / f"neato_{name}.bag"
    if not path.exists():
        pytest.skip("needs neato/ of the shared data")
    measurements = [m for m in open_log(path) if m.odometry is not None]
    scans = [scan for _, scan in measurements]
    odometry = Trajectory(
        np.array([scan.stamp_ns for scan in scans]), np.array([odometry.pose for odometry, _ in measurements])
    )
    own = measure_self_consistency(map_log(path).trajectory, scans).nats_per_beam
    assert own < most * measure_self_consistency(odometry, scans).nats_per_beam
