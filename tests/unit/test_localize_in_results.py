"""`localize` takes the result of `map_log` or a grid in the place of a file."""

import numpy as np
import pytest

import gridslam
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between
from gridslam.io.carmen.writer import write_carmen
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    path = tmp_path_factory.mktemp("drive") / "rooms.clf"
    write_carmen(path, log.measurements[:60])
    return path, between(log.truth.poses[0], log.truth.poses[:60])


def test_a_result_and_its_grid_serve_as_the_map(drive):
    path, truth = drive
    mapped = gridslam.map_log(path, particles=2)
    start = np.zeros(3)
    by_result, by_grid = (gridslam.localize(path, known, pose=start) for known in (mapped, mapped.map))
    np.testing.assert_array_equal(by_result.trajectory.poses, by_grid.trajectory.poses)
    off = np.hypot(*(by_result.trajectory.poses - truth)[:, :2].T)
    assert off.max() < 0.15


def test_what_holds_no_map_is_named(drive):
    with pytest.raises(ArgumentError, match="map: expected str or Path or OccupancyGrid or KnownMap or MapResult, got"):
        gridslam.localize(drive[0], np.zeros((3, 3)))
