"""What run.json says of the tracker: what it learned of the odometry and of the beams' times."""

import math
from dataclasses import replace

import numpy as np
import pytest

import gridslam
from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.csv import write_csv_log
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from support.faults import with_fault

EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
SPINNING = LidarConfig(beams=120, field_of_view_rad=math.tau, rate_hz=10.0, range_max_m=12.0, scan_time_s=0.1)


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(4)
    world = make_world("demo", rng)
    begin = World.of("begin", world.walls, world.route[:8])
    return simulate(begin, RobotConfig(), EXACT, SPINNING, rng).measurements[:400]


def told(path, measurements, configuration):
    write_csv_log(path / "log.csv", measurements)
    without_closures = replace(configuration, loop_closure=None)
    return map_log(path / "log.csv", configuration=without_closures, repair="none").document()["tracker"]


def test_the_errors_of_the_odometry_are_told(tmp_path, drive):
    tracker = told(
        tmp_path, list(with_fault(drive, "odometry_scale", np.random.default_rng(0), 0.1)), Configuration(particles=2)
    )
    errors = tracker["odometry"]
    assert errors["trusted"]
    assert errors["segments"] > 15
    assert errors["scale"] == pytest.approx(1 / 1.1, abs=0.03)
    assert errors["turn_scale"] == pytest.approx(1.0, abs=0.03)
    assert (tracker["stamps_reliable"], tracker["odometry_rejected"]) == (True, 0)
    assert tracker["beam_order"] == {"laser": "as reported"}


def fail(*arguments, **options):
    raise RuntimeError("injected")


@pytest.mark.parametrize(
    ("what", "problem"),
    [
        ("gridslam.slam.full_slam.full_slam.refine_trajectory", "the final refinement failed"),
        ("gridslam.api.mapping.draw_map", "map.png cannot be drawn"),
    ],
)
def test_what_was_mapped_is_written_whatever_fails_afterwards(tmp_path, drive, monkeypatch, what, problem):
    write_csv_log(tmp_path / "log.csv", drive[:100])
    monkeypatch.setattr(what, fail)
    result = map_log(tmp_path / "log.csv", configuration=Configuration(particles=2), repair="none")
    document = result.save(tmp_path / "out")
    assert len(document["failures"]) == 1
    assert document["failures"][0].startswith(f"{problem}: RuntimeError: injected (test_run_document.py, line")
    assert (tmp_path / "out" / "map.pgm").exists()
    assert len((tmp_path / "out" / "trajectory.tum").read_text().splitlines()) == 100


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    path = tmp_path_factory.mktemp("office") / "rooms.clf"
    write_carmen(path, log.measurements[:60])
    return path, between(log.truth.poses[0], log.truth.poses[:60])


def test_a_result_and_its_grid_serve_as_the_map(office):
    path, truth = office
    mapped = gridslam.map_log(path, particles=2)
    start = np.zeros(3)
    by_result, by_grid = (gridslam.localize(path, known, pose=start) for known in (mapped, mapped.map))
    np.testing.assert_array_equal(by_result.trajectory.poses, by_grid.trajectory.poses)
    off = np.hypot(*(by_result.trajectory.poses - truth)[:, :2].T)
    assert off.max() < 0.15


def test_what_holds_no_map_is_named(office):
    with pytest.raises(ArgumentError, match="map: expected str or Path or OccupancyGrid or KnownMap or MapResult, got"):
        gridslam.localize(office[0], np.zeros((3, 3)))
