"""The real bags do what is known of them, and no damage to a bag is anything but a log or a named error."""

from pathlib import Path

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.errors import InputError
from gridslam.evaluation.trajectory import absolute_errors
from gridslam.io.bags.bag import BagLog
from gridslam.io.log import LogOptions
from gridslam.types import Trajectory


@pytest.fixture(scope="session")
def bags(data_dir):
    return data_dir / "bags"


def read(path, **options):
    log = BagLog(path, LogOptions(**options))
    return list(log), log


def test_p3dx_trace0(bags):
    measurements, log = read(bags / "p3dx_trace0.bag")
    assert len(measurements) == 958
    assert {len(scan) for _, scan in measurements} == {726}
    assert log.statistics.odometry_source == "/odom"
    assert log.statistics.odometry_length_m == pytest.approx(31.7, abs=0.05)
    assert log.statistics.without_odometry == 1  # the last: no odometry comes after it
    np.testing.assert_allclose(log.statistics.mountings["/base_scan"].pose, [0.135, 0, 0])
    assert not log.statistics.moving_mountings


def test_p3dx_sim_truth_is_mapped_near_the_truth(bags):
    """0.10 m to 0.13 m by seed. Ranges jump by 4 cm, for the simulated walls are pixels, and the laser sees 5.6 m far.

    Where ranges scatter, maps of walls lie behind them, and the way ahead comes out 2 % long.
    """
    true, _ = read(bags / "p3dx_sim_truth.bag", odometry_topic="/base_pose_ground_truth")
    truth = Trajectory(np.array([s.stamp_ns for _, s in true]), np.array([o.pose for o, _ in true]))
    found = map_log(bags / "p3dx_sim_truth.bag").trajectory
    assert absolute_errors(found, truth).trans_rmse_m < 0.16


def test_turtlebot4_floor(bags):
    measurements, log = read(bags / "turtlebot4_floor")
    assert len(measurements) == 357
    assert log.statistics.odometry_length_m == pytest.approx(8.3, abs=0.1)
    assert log.statistics.mountings["/scan"].pose[2] == pytest.approx(np.pi / 2)
    assert log.statistics.without_odometry == 3  # two before the first odometry, the last
    assert all(scan.beam_times_s is not None for _, scan in measurements)
    assert log.statistics.no_return_beams > 0


def test_handheld_broken_index(bags):
    measurements, log = read(bags / "handheld_broken_index.bag")
    assert len(measurements) == 360
    assert {len(scan) for _, scan in measurements} == {681}
    assert log.statistics.odometry_source == ""
    assert log.statistics.without_odometry == 360
    assert not log.statistics.truncated  # of the index alone something is wrong


@pytest.mark.parametrize("name", ["p3dx_trace0.bag", "turtlebot4_floor/macfirst_floor_take_2_0.db3"])
def test_real_bags_cut_off(bags, name, tmp_path):
    data = (bags / name).read_bytes()
    path = tmp_path / Path(name).name
    for share in (0.05, 0.3, 0.999):
        path.write_bytes(data[: int(share * len(data))])
        outcome(path, keep_truncated=False)
        outcome(path, keep_truncated=True)


def outcome(path, **options):
    """Number of scans, or -1 where the bag is refused; anything else fails the test."""
    try:
        return sum(1 for _ in BagLog(path, LogOptions(**options)))
    except InputError as error:
        said = str(error)
    assert str(path) in said
    assert said.isprintable()  # one line
    return -1
